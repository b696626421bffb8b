"""URDF's ``<mimic>``: a joint that follows another, q = multiplier·q_other + offset."""

from __future__ import annotations

from xml.etree.ElementTree import Element

from ..errors import FormatError
from ..mechanism.constraints.coupling import Coupling
from .reading import near
from .xml_reading import numbers

_ONE_COORDINATE = ("revolute", "continuous", "prismatic")


def couplings(robot: Element) -> tuple[Coupling, ...]:
    """The couplings of a parsed ``<robot>``, each named like the joint that follows.

    The angle of a ``continuous`` joint counts its turns here, so that any multiplier is right. A joint may follow one
    that follows a third.

    Raises
    ------
    FormatError
        A joint that has no single coordinate, an unknown joint to follow, joints that follow themselves.
    """
    joints = {joint.get("name"): joint for joint in robot.findall("joint")}
    found = {}
    for name, joint in joints.items():
        nodes = joint.findall("mimic")
        element = f"joint {name!r}: mimic"
        if len(nodes) > 1:
            raise FormatError("a joint can follow one other only", element=element)
        if nodes:
            _require_one_coordinate(joint, "follow another", element)
            found[name] = _coupling(name, nodes[0], joints, element)
    for name in found:
        _refuse_cycle(name, found)
    return tuple(found.values())


def _coupling(name, node, joints, element):
    other = node.get("joint", "")
    if other not in joints:
        raise FormatError(f"there is no joint {other!r} to follow{near(other, joints)}", element=element)
    _require_one_coordinate(joints[other], "be followed", element)
    if other == name:
        raise FormatError("the joint follows itself", element=element)
    ratio = numbers(node, "multiplier", element, 1, (1.0,))[0]
    offset = numbers(node, "offset", element, 1, (0.0,))[0]
    return Coupling(name, name, other, ratio, offset)


def _require_one_coordinate(joint, what, element):
    kind = joint.get("type")
    if kind not in _ONE_COORDINATE:
        raise FormatError(
            f"joint {joint.get('name')!r} is {kind} and cannot {what}; only {', '.join(_ONE_COORDINATE)} joints can",
            element=element,
        )


def _refuse_cycle(name, found):
    path = [name]
    while (following := found.get(path[-1])) is not None:
        path.append(following.other)
        if path.count(path[-1]) > 1:
            raise FormatError(f"joints follow each other in a circle: {' → '.join(path)}", element=f"joint {name!r}")
