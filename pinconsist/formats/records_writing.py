"""A Mechanism's loops and forces → plain data for a loop file: the other way round of loop and force records."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

from ..errors import InputError
from ..mechanism.constraints.coupling import Coupling
from ..mechanism.constraints.drive import Drive
from ..mechanism.constraints.loop import Loop
from ..mechanism.constraints.motion import Motion
from ..mechanism.forces import JointDamping, JointFriction, JointTorque
from .force_records import KINDS as FORCES

_BY_JOINT = {JointDamping: "coefficients", JointFriction: "coefficients", JointTorque: "torques"}


def loop_entries(mechanism) -> list[dict]:
    """The records under ``loops``.

    Raises
    ------
    InputError
        A drive along a user's function, or a user's own constraint.
    """
    return [_loop(mechanism, loop) for loop in mechanism.loops]


def force_entries(mechanism) -> list[dict]:
    """The records under ``forces``.

    Raises
    ------
    InputError
        A user's own law, or a function of time that is no Motion.
    """
    return [_force(mechanism, force) for force in mechanism.forces]


def _loop(mechanism, loop):
    what = f"{mechanism.name}: {loop.kind} {loop.name!r}"
    if isinstance(loop, Loop):
        return _fields(loop, what)
    if isinstance(loop, Coupling):
        return {"name": loop.name, "kind": loop.kind} | _fields(loop, what)
    if isinstance(loop, Drive) and isinstance(loop.curve, Motion) and not (loop.rate or loop.acceleration):
        return {"name": loop.name, "kind": loop.kind, "joint": loop.joint} | _motion(loop.curve)
    if isinstance(loop, Drive):
        raise InputError(f"{what} follows a function of yours, which a file cannot hold; a Motion it can")
    raise InputError(f"{what} is a function of yours, which a file cannot hold; leave it out by with_loops()")


def _force(mechanism, force):
    what = f"{mechanism.name}: the force {getattr(force, 'label', type(force).__name__)!r}"
    kind = next((kind for kind, make in FORCES.items() if type(force) is make), None)
    if kind is None:
        raise InputError(f"{what} is a function of yours, which a file cannot hold; leave it out")
    field = _BY_JOINT.get(type(force))
    if field and not isinstance(getattr(force, field), Mapping):
        force = dataclasses.replace(force, **{field: _by_joint(mechanism, getattr(force, field))})
    return {"kind": kind} | _fields(force, what)


def _by_joint(mechanism, values):
    """Joint → its numbers, from a number for each velocity of the whole mechanism."""
    shares = {joint: values[mechanism.columns(joint)] for joint in mechanism.joints}
    return {joint: share[0] if len(share) == 1 else share for joint, share in shares.items() if any(share)}


def _fields(record, what):
    """The fields of a record that differ from their defaults."""
    return {
        each.name: _plain(value, f"{what}: {each.name}")
        for each in dataclasses.fields(record)
        if (value := getattr(record, each.name)) != each.default
    }


def _motion(motion):
    return _fields(motion, "") or {"start": 0.0}


def _plain(value, what):
    if isinstance(value, Motion):
        return _motion(value)
    if isinstance(value, Mapping):
        return {joint: _plain(each, f"{what}: {joint}") for joint, each in value.items()}
    if isinstance(value, str):
        return value
    if callable(value):
        raise InputError(f"{what} is a function of yours, which a file cannot hold; a Motion it can")
    return [float(each) for each in value] if isinstance(value, tuple) else float(value)
