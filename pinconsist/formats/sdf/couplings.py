"""Gearboxes and mimicked joints of SDF → couplings of two joints."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...errors import FormatError
from ...mechanism.constraints.coupling import Coupling
from ..reading import near
from .joints import Joint

_ALONG = 1e-3
"""Sine of the angle up to which an axis of a gearbox counts as that of the joint."""


def coupled_joints(joints: Sequence[Joint]) -> set[str]:
    """Names of the joints that gearboxes and followers speak of."""
    names = {axis.follows.joint for joint in joints for axis in joint.axes if axis.follows}
    for gearbox in joints:
        if gearbox.kind == "gearbox":
            names |= {_between(joints, gearbox, body).name for body in (gearbox.parent, gearbox.child)}
    return names


def couplings(joints: Sequence[Joint]) -> list[Coupling]:
    """The couplings of a scene's joints.

    A gearbox holds θ₂ = -ratio θ₁, with θ₁ the angle from its reference body to its parent about its first axis, and
    θ₂ that to its child about the second. A follower holds position = multiplier (leader - reference) + offset.

    Raises
    ------
    FormatError
        Joints that are not there, or have no such axis.
    """
    made, by_name = [], {joint.name: joint for joint in joints}
    for joint in joints:
        if joint.kind == "gearbox":
            made.append(_gear(joints, joint))
            continue
        for part, axis in zip(joint.parts, joint.axes, strict=False):
            if axis.follows:
                made.append(_follow(by_name, joint, part, axis.follows))
    return made


def _gear(joints, gearbox):
    first, second = (_between(joints, gearbox, body) for body in (gearbox.parent, gearbox.child))
    sides = (_side(gearbox, 0, first, gearbox.parent), _side(gearbox, 1, second, gearbox.child))
    return Coupling(gearbox.name, second.name, first.name, ratio=-gearbox.ratio * sides[0] * sides[1])


def _between(joints, gearbox, body):
    """The hinge between a gearbox's reference body and one of its ends."""
    ends = {gearbox.reference, body}
    found = [joint for joint in joints if joint.kind == "revolute" and {joint.parent, joint.child} == ends]
    if len(found) != 1:
        raise FormatError(
            f"one revolute joint between its reference body {gearbox.reference!r} and {body!r} is needed, there are "
            f"{len(found)}",
            element=f"joint {gearbox.name!r}",
        )
    return found[0]


def _side(gearbox, number, joint, body) -> float:
    """+1 where the angle of a joint is that of the gearbox, -1 where it is the opposite."""
    axis = gearbox.pose.rotation @ gearbox.axes[number].direction
    own = joint.pose.rotation @ joint.axes[0].direction
    if np.linalg.norm(np.cross(axis, own)) > _ALONG:
        raise FormatError(
            f"its {'axis' if number == 0 else 'axis2'} is not along that of joint {joint.name!r}",
            element=f"joint {gearbox.name!r}",
        )
    return np.sign(axis @ own) * (1.0 if joint.child == body else -1.0)


def _follow(by_name, joint, part, follower):
    element = f"joint {joint.name!r}: mimic"
    leader = by_name.get(follower.joint)
    if leader is None:
        raise FormatError(f"there is no joint {follower.joint!r}{near(follower.joint, by_name)}", element=element)
    if leader.kind in ("gearbox", "ball") or follower.axis >= len(leader.axes):
        raise FormatError(f"joint {leader.name!r} has no such axis", element=element)
    other = leader.parts[follower.axis]
    if other == part:
        raise FormatError("a joint cannot follow itself", element=element)
    offset = follower.offset - follower.multiplier * follower.reference
    return Coupling(f"{part} mimic", part, other, ratio=follower.multiplier, offset=offset)
