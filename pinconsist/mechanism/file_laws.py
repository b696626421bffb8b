"""What the file of a mechanism has besides its loops: position limits as stops, and dry friction that holds."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np

from .checks import choice
from .contacts import DryFriction, Stop, limits_of
from .joint_constraints import Drive

LIMITS = ("watch", "stops", "off")
FRICTION = ("smooth", "exact")
# Lines in the list of what has no effect
WATCHED = "limits of {} (watched, not enforced)"
COLLISIONS, COLLIDING, PAIR, FLOOR = "collision shape", "colliding geom", "contact pair", "floor"
FREE_FRICTION = "free joint with frictionloss"
STATIC = f"static {COLLISIONS}"
ESSENTIAL = (FLOOR, STATIC, COLLIDING, PAIR, FREE_FRICTION)  # without them the motion is another one
_LINE = re.compile("^" + re.escape(WATCHED).replace(r"\{\}", r"(\d+) joints?") + "$")


def essential(lines) -> list[str]:
    """Those of the lines about what has no effect without which the motion is another one: bodies fall through."""
    return [line for line in lines if any(noun in line for noun in ESSENTIAL)]


def with_limits(mech, limits):
    """The mechanism with the position limits of its joints as :class:`Stop` (``"stops"``), or without any (``"off"``).

    With ``"watch"`` it is returned as it is: certificates name the joints that leave their limits. Joints that have a
    stop keep it; joints of several degrees of freedom are only watched.
    """
    if choice(limits, LIMITS, "limits") == "watch":
        return mech
    if limits == "off":
        model = mech.model.copy()
        model.lowerPositionLimit[:], model.upperPositionLimit[:] = -np.inf, np.inf
        lines = tuple(line for line in mech.ignored if not _LINE.match(line))
        return replace(mech, model=model, ignored=lines)
    stopped = {each.joint for each in mech.contacts if isinstance(each, Stop)}
    driven = {loop.joint for loop in mech.loops if isinstance(loop, Drive)}
    names = {each.name for each in (*mech.contacts, *mech.loops)}
    stops = [
        Stop(joint, name="" if joint not in names else f"{joint} stop")
        for joint in mech.joints
        if joint not in stopped | driven and limits_of(mech.model, joint) != (None, None)
    ]
    if not stops:
        return mech
    return replace(mech.add_contacts(*stops), ignored=without_stopped(mech.ignored, mech.model, stops))


def without_stopped(lines, model, contacts) -> tuple[str, ...]:
    """The lines about what has no effect, without the limits of joints that now have a stop."""
    stopped = {each.joint for each in contacts if isinstance(each, Stop)}
    count = sum(model.existJointName(joint) and limits_of(model, joint) != (None, None) for joint in stopped)
    return tuple(filter(None, (_fewer(line, count) for line in lines)))


def _fewer(line, count) -> str:
    """The line about limits without those that act now."""
    found = _LINE.match(line)
    if not found:
        return line
    left = int(found[1]) - count
    return WATCHED.format(f"{left} joint{'s' * (left > 1)}") if left > 0 else ""


def with_dry_friction(mech, dry_friction):
    """The mechanism with the dry friction of its file as :class:`DryFriction` (``"exact"``), or smoothed as it is.

    Exact are joints of one degree of freedom.
    """
    if choice(dry_friction, FRICTION, "dry_friction") == "smooth":
        return mech
    model, found = mech.model.copy(), []
    for joint in mech.joints:
        i = model.getJointId(joint)
        v = model.idx_vs[i]
        size = float(model.upperDryFrictionLimit[v]) if model.nvs[i] == 1 else 0.0
        if size > 0.0:
            found.append(DryFriction(joint, size))
            model.upperDryFrictionLimit[v] = model.lowerDryFrictionLimit[v] = 0.0
    return replace(mech, model=model).add_contacts(*found) if found else mech
