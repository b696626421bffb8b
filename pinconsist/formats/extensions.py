"""What readers of extensions share: names of bodies and joints, and values that files write in several ways."""

from collections.abc import Iterable
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from ..errors import warn
from ..mechanism.joint_constraints import JointConstraint
from ..mechanism.loops import GROUND, Loop
from .closures import Closure
from .reading import Node, floats, log_left_out, require_known, shown

_NAMED_BY = ("link", "name", "joint", "value", "frame", "body")
LOOP_TAGS = ("loop_joint", "loop", "constraint", "loop_closure", "loop_constraint")
"""Elements of a URDF that close a loop."""
_PARTS = ("link", "joint", "model", "frame")  # of the robot itself, which no program leaves out
WORLDS = ("world", "World", "::world", "map", GROUND)


class Names:
    """The names of a robot's file, as its extensions use them.

    `frames` are those that only extensions refer to: name → (link, place on it). `fixed` are joints that do not move.
    """

    def __init__(self, title: str, links: Iterable[str], joints: Iterable[str], frames=None, fixed=()):
        self.title, self.links, self.joints = title, tuple(links), tuple(joints)
        self.frames, self.fixed = dict(frames or {}), frozenset(fixed)

    def link(self, name: str, element: str) -> str:
        """The frame of a link; the ground for the world. Names may have the model's as a prefix."""
        name = name.strip()
        if name in self.links:
            return name
        short = name.rpartition("::")[2]
        if short in self.links:
            return short
        if name in WORLDS or short == "world":
            return GROUND
        require_known(name, self.links, f"there is no link {name!r}", element)
        return name

    def joint(self, name: str, element: str) -> str:
        name = name.strip()
        short = name if name in self.joints else name.rpartition("::")[2]
        require_known(short, self.joints, f"there is no movable joint {short!r}", element)
        return short

    def place(self, name: str, element: str) -> tuple[str, pin.SE3]:
        """The link and the place on it of a link or a frame."""
        if name in self.frames:
            link, place = self.frames[name]
            return self.link(link, element), place
        return self.link(name, element), pin.SE3.Identity()


def word(node: Node, *tags: str, default: str | None = None) -> str:
    """The name in the first of these children, or in the attribute of this name."""
    for tag in tags:
        if child := node.child(tag):
            for text in (child.text(), *(child.get(key) for key in _NAMED_BY)):
                if text:
                    return text
        if own := node.get(tag):
            return own
    if default is None:
        raise node.error(f"<{shown(tags[0])}> is missing, or has no name")
    return default


def values(node: Node, tag: str, count: int, default=None) -> tuple[float, ...]:
    """The numbers of a child: its text, or an attribute ``value`` or ``xyz``; or those of an attribute."""
    child = node.child(tag)
    if child:
        text = child.text() or child.get("value") or child.get("xyz")
    else:
        text = node.get(tag)
    if text:
        return floats(text, count, child.name if child else f"{node.name}: {tag}")
    if default is None:
        raise node.error(f"<{shown(tag)}> is missing, or has no numbers")
    return default


def value(node: Node, tag: str, default: float | None = None) -> float:
    return values(node, tag, 1, None if default is None else (default,))[0]


def pose(xyz, rpy) -> pin.SE3:
    return pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array(xyz, float))


def sorted_records(records: Iterable) -> tuple[tuple, tuple, tuple]:
    """The loops, the couplings and drives, and the forces among records."""
    loops, couplings, forces = [], [], []
    for record in records:
        if not isinstance(record, Loop | Closure | JointConstraint):
            forces.append(record)
            continue
        (loops if isinstance(record, Loop | Closure) else couplings).append(record)
    return tuple(loops), tuple(couplings), tuple(forces)


def left_out(holders: Iterable[tuple[str, Element]], ignore: Iterable[str]) -> None:
    """Remove the children of (prefix of tags, element) that `ignore` names, by tag or name."""
    ignore = set(ignore)
    for prefix, holder in holders if ignore else ():
        for child in list(holder):
            tag, name = tag_of(child), child.get("name", "")
            if not prefix and tag in _PARTS:
                continue
            if tag == "plugin":
                tag = f"plugin {name.rpartition('::')[2]}"
            names = {tag, f"{prefix}{tag}", tag.rpartition(":")[2], name} - {""}
            if names & ignore:
                log_left_out(f"{prefix}{tag}", name)
                holder.remove(child)


def tag_of(element: Element) -> str:
    """The tag of an element in messages, see :func:`.reading.shown`."""
    return shown(str(element.tag))


def unique(name: str, taken) -> str:
    """The name, with a number if it is taken."""
    number, found = 1, name
    while found in taken:
        number += 1
        found = f"{name} ({number})"
    return found


def warn_without_effect(node: Node, *tags: str) -> None:
    for tag in tags:
        if node.child(tag):
            warn(f"{node.name}: <{tag}> does not act on a joint that closes a loop")
