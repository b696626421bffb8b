"""Constraints and forces of Drake in URDF and SDF: in URDF an attribute ``name`` or ``value`` has what SDF has as text.

* ``ball_constraint``: the points p_AP of body_A and p_BQ of body_B coincide.
* ``distance_constraint``: their distance is kept; with a finite stiffness it is a spring and damper.
* ``weld_constraint``: two frames coincide.
* ``tendon_constraint``: Σ a q + offset stays between its limits. Equal limits are a coupling; others are counted, as
  limits of joints are.
* ``linear_spring_damper``: a spring and damper between two points.
* ``linear_bushing_rpy``: a spring and damper of six directions between two frames.
* ``mimic`` of a joint.
* ``joint``: the types planar, ball, universal and screw.

Source: Drake's "Parsing Models for Multibody Systems".
"""

import math
from collections.abc import Iterator
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from ..mechanism.forces import Bushing, SpringDamper
from ..mechanism.joint_constraints import Coupling
from ..mechanism.loops import Loop, anchor
from .extensions import Names, value, values, word
from .reading import DRAKE, Node

ZERO = (0.0, 0.0, 0.0)


def joined(holder: Node, names: Names, ignored) -> Iterator:
    """The loops, couplings and forces of Drake's elements of a ``<robot>`` or model."""
    for tag, read in _READERS.items():
        for number, node in enumerate(holder.children(DRAKE + tag), start=1):
            label = node.get("name") or (tag if number == 1 else f"{tag} {number}")
            node.name = f"drake:{tag} {label!r}"
            yield from read(_Prefixed(node, tag), names, label, ignored)


class _Prefixed:
    """An element whose children begin with its own tag: ``ball_constraint_body_A``."""

    def __init__(self, node, prefix):
        self.node, self._prefix = node, prefix

    def _tag(self, tag):
        for each in (f"{DRAKE}{self._prefix}_{tag}", f"{DRAKE}{tag}", f"{self._prefix}_{tag}", tag):
            if self.node.child(each):
                return each
        return f"{DRAKE}{self._prefix}_{tag}"

    def word(self, *tags):
        found = next((self._tag(tag) for tag in tags if self.node.child(self._tag(tag))), self._tag(tags[0]))
        return word(self.node, found)

    def values(self, tag, count, default=None):
        return values(self.node, self._tag(tag), count, default)

    def value(self, tag, default):
        """A number, which may be infinite."""
        child = self.node.child(self._tag(tag))
        text = (child.text() or child.get("value") or "").strip().lower() if child else ""
        if text.lstrip("+-") in ("inf", "infinity"):
            return math.copysign(math.inf, -1.0 if text.startswith("-") else 1.0)
        return value(self.node, self._tag(tag), default)

    def children(self, tag):
        return self.node.children(f"{DRAKE}{self._prefix}_{tag}") or self.node.children(f"{self._prefix}_{tag}")


def _ends(node, names, bodies=("body_A", "body_B"), points=("p_AP", "p_BQ")):
    frames, offsets = [], []
    for body, point in zip(bodies, points, strict=True):
        link, place = names.place(node.word(body), node.node.name)
        frames.append(link)
        offsets.append(tuple(place.act(np.array(node.values(point, 3, ZERO))).tolist()))
    return frames, offsets


def _ball(node, names, label, ignored):
    frames, (xyz1, xyz2) = _ends(node, names)
    yield Loop(label, "point", *frames, xyz1=xyz1, xyz2=xyz2)


def _distance(node, names, label, ignored):
    frames, (xyz1, xyz2) = _ends(node, names)
    length, stiffness = node.value("distance", None), node.value("stiffness", math.inf)
    if math.isinf(stiffness):
        yield Loop(label, "distance", *frames, xyz1=xyz1, xyz2=xyz2, length=length)
    else:
        yield SpringDamper(*frames, stiffness, length, node.value("damping", 0.0), xyz1, xyz2)


def _spring(node, names, label, ignored):
    frames, (xyz1, xyz2) = _ends(node, names)
    numbers = [node.value(tag, None) for tag in ("stiffness", "free_length")]
    yield SpringDamper(*frames, *numbers, node.value("damping", 0.0), xyz1, xyz2)


def _weld(node, names, label, ignored):
    fields, frames = {}, []
    for end, tags in enumerate((("parent", "frame_A", "body_A"), ("child", "frame_B", "body_B")), start=1):
        link, place = names.place(node.word(*tags), node.node.name)
        frames.append(link)
        fields |= anchor(end, place)
    yield Loop(label, "frame", *frames, **fields)


def _tendon(node, names, label, ignored):
    shares = {}
    for child in node.children("joint"):
        joint = names.joint(child.get("name") or child.text() or word(child, "name"), child.name)
        tag = "a" if child.child("a") or child.get("a") else f"{DRAKE}a"
        shares[joint] = shares.get(joint, 0.0) + value(child, tag)
    if not shares:
        raise node.node.error("it names no joint")
    lower, upper = node.value("lower_limit", -math.inf), node.value("upper_limit", math.inf)
    if lower != upper:
        ignored.add("limited tendon")
        return
    first, *others = shares
    total, scale = lower - node.value("offset", 0.0), shares[first]
    if not scale:
        raise node.node.error(f"the factor of joint {first!r} is zero")
    if not others:
        raise node.node.error(f"its equal limits hold joint {first!r} at {total / scale:g}: make the joint fixed")
    factors = {joint: -shares[joint] / scale for joint in others}
    if len(factors) == 1:
        ((other, ratio),) = factors.items()
        yield Coupling(label, first, other, ratio, total / scale)
    else:
        yield Coupling(label, first, factors, 1.0, total / scale)


def _bushing(node, names, label, ignored):
    fields, frames = {}, []
    for end, tag in enumerate(("bushing_frameA", "bushing_frameC"), start=1):
        link, place = names.place(node.word(tag), node.node.name)
        frames.append(link)
        fields |= anchor(end, place)
    stiffness = *node.values("bushing_force_stiffness", 3), *node.values("bushing_torque_stiffness", 3)
    damping = *node.values("bushing_force_damping", 3, ZERO), *node.values("bushing_torque_damping", 3, ZERO)
    yield Bushing(*frames, stiffness=stiffness, damping=damping, **fields)


_READERS = {
    "ball_constraint": _ball,
    "distance_constraint": _distance,
    "weld_constraint": _weld,
    "tendon_constraint": _tendon,
    "linear_spring_damper": _spring,
    "linear_bushing_rpy": _bushing,
}
TAGS = tuple(f"drake:{tag}" for tag in _READERS)

TYPES = {"planar": "", "ball": "SPHERICAL", "universal": "UJOINT_XY", "screw": "HELICAL"}
"""Types of ``<drake:joint>`` → how a joint of URDF is replaced."""


def joints_in_urdf(robot: Element) -> dict[str, str]:
    """Replace each ``<drake:joint>`` by a ``<joint>``; return the types that replace them in the model.

    So is ``spherical`` replaced, a type that MuJoCo and Bullet read.
    """
    types: dict[str, str] = {}
    for joint in (each for each in robot.findall("joint") if each.get("type") == "spherical"):
        joint.set("type", "continuous")
        for axis in joint.findall("axis"):
            joint.remove(axis)
        types[joint.get("name", "")] = TYPES["ball"]
    for element in robot.findall(DRAKE + "joint"):
        node = Node(element, f"drake:joint {element.get('name')!r}")
        kind = element.get("type", "")
        if kind not in TYPES:
            raise node.error(f"type {kind[:40]!r} is not one of {', '.join(TYPES)}")
        for each in element.iter():
            each.tag = str(each.tag).removeprefix(DRAKE)
        element.tag = "joint"
        element.set("type", "planar" if kind == "planar" else "continuous")
        if kind in ("planar", "ball", "universal"):
            for axis in element.findall("axis"):
                element.remove(axis)
            SubElement(element, "axis", xyz="0 0 1")
        if TYPES[kind]:
            replaced = TYPES[kind]
            if kind == "screw":
                replaced += f" {value(node, 'screw_thread_pitch') / (2.0 * math.pi)!r}"
            types[element.get("name", "")] = replaced
    return types
