"""MJCF's equality constraints → loops, couplings and drives that hold a joint.

Source: "XML Reference" of the MuJoCo documentation, equality. Where a constraint does not say where its second anchor
is, it holds what the reference configuration shows.
"""

from __future__ import annotations

import logging
import math
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from ...errors import FormatError, InputError
from ...mechanism.joint_constraints import Coupling, Drive
from ...mechanism.loops import GROUND, Loop
from ...mechanism.motion import Motion
from ..reading import near, shown
from .document import check_attributes, sections
from .settings import Defaults, Option
from .tree import Tree
from .values import flag, named, number, rotation, vector

_REFUSED = ("tendon", "flex", "flexvert", "flexstrain", "distance")
_log = logging.getLogger(__name__)


def closures(root: Element, tree: Tree, defaults: Defaults, option: Option) -> tuple:
    """What the active equality constraints close, in their order; those that are not active are told of.

    Raises
    ------
    FormatError
        Unknown or refused kinds, names that do not exist, values that are wrong.
    """
    off = sorted(option.disabled & {"equality", "constraint"})
    names, found = set(), []
    reference = _Reference(tree)
    for number_, node in enumerate(sections(root, "equality"), start=1):
        name = node.get("name", "") or f"{node.tag}{number_}"
        element = f"equality {name!r}"
        if name in names:
            raise FormatError("another equality has this name", element=element)
        names.add(name)
        if node.tag not in (*_READ, *_REFUSED):
            raise FormatError(f"{node.tag!r} is not known{near(node.tag, _READ)}", element=element)
        given = defaults.of(node, element, kind="equality")
        if off or not flag(given, "active", element, default=True):
            reason = f"the option's flag {off[0]} is disabled" if off else "it is not active"
            _log.warning("%s: left out, %s", element, reason)
            continue
        if node.tag in _REFUSED:
            what = "tendons" if node.tag == "tendon" else node.tag
            raise FormatError(
                f"equality of {what} is not computed here; remove it or set active=false", element=element
            )
        check_attributes(node, element, "equality joint" if node.tag == "joint" else None)
        try:
            found.append(_READ[node.tag](name, given, tree, reference, element))
        except InputError as error:
            raise FormatError(str(error), element=element) from error
    return tuple(found)


class _Reference:
    """Where the frames of bodies stand in the reference configuration."""

    def __init__(self, tree):
        self._tree, self._data = tree, None

    def between(self, frame1, frame2) -> pin.SE3:
        """The pose of the second frame in the first."""
        model = self._tree.model
        if self._data is None:
            self._data = model.createData()
            pin.framesForwardKinematics(model, self._data, pin.normalize(model, self._tree.reference))
        pose1, pose2 = (self._data.oMf[model.getFrameId(frame)] for frame in (frame1, frame2))
        return pose1.actInv(pose2)


def _ends(given, tree, element, by_body):
    """The two frames that a constraint joins: of bodies, the ground if there is no second, or of sites."""
    if by_body:
        first = named(tree.names.bodies, given, "body1", element)
        second = named(tree.names.bodies, given, "body2", element) if "body2" in given else GROUND
        return first, second
    if not {"site1", "site2"} <= given.keys():
        needed = "body1 and anchor" if "relpose" not in given else "body1"
        raise FormatError(f"{needed}, or site1 and site2 are needed", element=element)
    return tuple(named(tree.names.sites, given, key, element) for key in ("site1", "site2"))


def _loop(name, kind, frames, place1=None, place2=None):
    place1, place2 = place1 or pin.SE3.Identity(), place2 or pin.SE3.Identity()
    places = {}
    for end, place in (("1", place1), ("2", place2)):
        places[f"xyz{end}"] = tuple(place.translation)
        places[f"rpy{end}"] = tuple(pin.rpy.matrixToRpy(place.rotation))
    return Loop(name, kind, *frames, **places)


def _connect(name, given, tree, reference, element):
    by_body = "body1" in given and "anchor" in given
    frames = _ends(given, tree, element, by_body)
    if not by_body:
        return _loop(name, "point", frames)
    anchor = pin.SE3(np.eye(3), vector(given, "anchor", element, 3))
    return _loop(name, "point", frames, anchor, reference.between(*frames[::-1]) * anchor)


def _weld(name, given, tree, reference, element):
    kind = "frame" if number(given, "torquescale", element, default=1.0, least=0.0) else "point"
    by_body = "body1" in given
    frames = _ends(given, tree, element, by_body)
    if not by_body:
        return _loop(name, kind, frames)
    anchor = pin.SE3(np.eye(3), vector(given, "anchor", element, 3, (0.0, 0.0, 0.0)))
    pose = vector(given, "relpose", element, 7, (0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    if not pose[3:].any():  # as in the reference configuration
        return _loop(name, kind, frames, reference.between(*frames) * anchor, anchor)
    return _loop(name, kind, frames, pin.SE3(rotation(pose[3:], f"{element}: relpose"), pose[:3]), anchor)


def _joint(name, given, tree, reference, element):
    """q1 - ref1 = Σ a_i (q2 - ref2)^i, multiplied out; without a second joint, the first is held at ref1 + a_0."""
    joint1 = _scalar(tree, given, "joint1", element)
    first = vector(given, "polycoef", element, (1, 5), (0.0,))  # the others keep their defaults
    coefficients = np.array([*first, *[0.0, 1.0, 0.0, 0.0, 0.0][len(first) :]])
    ref1 = tree.joints[joint1].ref
    if "joint2" not in given:
        return Drive(name, joint1, Motion(start=ref1 + coefficients[0]))
    joint2 = _scalar(tree, given, "joint2", element)
    ref2 = tree.joints[joint2].ref
    law = [
        sum(coefficients[i] * math.comb(i, power) * (-ref2) ** (i - power) for i in range(power, 5))
        for power in range(5)
    ]
    while len(law) > 2 and law[-1] == 0.0:
        law.pop()
    return Coupling(name, joint1, joint2, ratio=law[1], offset=ref1 + law[0], higher=tuple(law[2:]))


def _scalar(tree, given, key, element):
    joint = given.get(key, "")
    kind = named(tree.joints, given, key, element).kind
    if kind not in ("hinge", "slide"):
        raise FormatError(f"{key}={shown(joint)} is a {kind} joint; hinges and slides can be coupled", element=element)
    return joint


_READ = {"connect": _connect, "weld": _weld, "joint": _joint}
