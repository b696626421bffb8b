"""``<loop_joint>``: joints that close loops, written in the URDF itself.

::

    <loop_joint name="tip" type="revolute">
      <link1 link="left" xyz="1 0 0" rpy="0 0 0"/>
      <link2 link="right" xyz="1 0 0" rpy="0 0 0"/>
      <axis xyz="0 1 0"/>
    </loop_joint>

URDF itself has no such element; it comes from Drake's former reader (no type: origins together, axes aligned) and from
Isaac Sim's (``type``; it reads ``spherical`` only). Both are read here. ``xyz`` and ``rpy`` place an anchor in its
link; in a closed loop the anchors coincide, up to the motion that the type leaves free. ``axis`` has the same
components in both anchors and is URDF's default, x, where it is missing.

==================== ============================= =========
type                 leaves free                   kind
==================== ============================= =========
fixed                nothing                       frame
revolute, continuous the angle about the axis      hinge
(no type)            the same                      hinge
prismatic            the way along the axis        slider
planar               the plane normal to the axis  plane
spherical, ball      all angles                    point
==================== ============================= =========

Limits, damping and friction of a loop joint do not act; where they are given, a warning says so.
"""

from __future__ import annotations

import logging
from xml.etree.ElementTree import Element

from ..errors import FormatError, InputError
from ..mechanism.constraints.loops import Loop
from .reading import near
from .xml_reading import child, named, numbers

_KINDS = {
    "fixed": "frame",
    "revolute": "hinge",
    "continuous": "hinge",
    "prismatic": "slider",
    "planar": "plane",
    "spherical": "point",
    "ball": "point",
}
_WITH_AXIS = ("hinge", "slider", "plane")
_FOREIGN = ("loop", "coupling", "constraint")
_log = logging.getLogger(__name__)


def loop_joints(robot: Element) -> tuple[Loop, ...]:
    """The loops of a parsed ``<robot>``.

    Raises
    ------
    FormatError
        Unknown types or links, missing parts; or another extension that closes loops, which would be lost.
    """
    for tag in _FOREIGN:
        if robot.find(tag) is not None:
            raise FormatError(
                f"<{tag}> is an extension that is not read, and what it joins would come apart; say the same by "
                "<loop_joint>, <mimic> or in a loop file",
                element=f"{tag} {robot.find(tag).get('name', '')!r}",
            )
    if robot.find("gazebo/joint") is not None:
        _log.warning("a <joint> inside <gazebo> is not read; if it closes a loop, write it as <loop_joint>")
    links = {link.get("name") for link in robot.findall("link")}
    return tuple(_loop(name, node, links) for name, node in named(robot, "loop_joint").items())


def _loop(name, node, links):
    element = f"loop_joint {name!r}"
    kind = node.get("type", "revolute")
    if kind not in _KINDS:
        raise FormatError(f"type {kind!r} is not one of {', '.join(_KINDS)}", element=element)
    for tag in ("limit", "dynamics", "mimic"):
        if node.find(tag) is not None:
            _log.warning("%s: <%s> does not act on a joint that closes a loop", element, tag)
    ends = {}
    for number in (1, 2):
        end = child(node, f"link{number}", element)
        where = f"{element}: link{number}"
        link = end.get("link", "")
        if link not in links:
            raise FormatError(f"there is no link {link!r}{near(link, links)}", element=where)
        ends[f"frame{number}"] = link
        for key in ("xyz", "rpy"):
            ends[f"{key}{number}"] = numbers(end, key, where, 3, (0.0, 0.0, 0.0))
    if ends["frame1"] == ends["frame2"]:
        raise FormatError(f"both ends are on the link {ends['frame1']!r}", element=element)
    if _KINDS[kind] in _WITH_AXIS:
        axis = node.find("axis")
        x_axis = (1.0, 0.0, 0.0)
        ends["axis"] = x_axis if axis is None else numbers(axis, "xyz", f"{element}: axis", 3, x_axis)
        if not any(ends["axis"]):
            raise FormatError("the axis is the zero vector", element=element)
    try:
        return Loop(name, _KINDS[kind], **ends)
    except InputError as error:
        raise FormatError(str(error).removeprefix(f"loop {name!r}: "), element=element) from error
