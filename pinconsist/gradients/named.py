"""Parameters by name, as functions of their values."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..errors import InputError
from ..mechanism.parameters import parameter

SPEED = "_speed"


def named_start(mechanism, names, q0, v0):
    """(build, names, theta, q0, v0) of a mechanism and names of its parameters, as functions of theta."""
    if isinstance(names, str) or not all(isinstance(name, str) for name in names):
        raise InputError(f"of a mechanism, parameters are given by their names, got {names!r}")
    names = tuple(names)
    starts = {name: _start_of(mechanism, name, q0, v0) for name in names}
    own = {i: name for i, name in enumerate(names) if starts[name] is None}
    theta = [parameter(mechanism, name).value if starts[name] is None else starts[name][2] for name in names]
    parameters, last = [parameter(mechanism, name) for name in own.values()], [None, mechanism]

    def build(values):
        wanted = tuple(values[i] for i in own)
        if wanted == tuple(theta[i] for i in own):
            return mechanism
        if wanted != last[0]:  # parameters of the start leave the mechanism the same object
            built = mechanism
            for value, each in zip(wanted, parameters, strict=True):
                if value != each.value:
                    built = each.put(built, value)
            last[:] = wanted, built
        return last[1]

    def started(which, given):
        ours = {i: starts[name][1] for i, name in enumerate(names) if starts[name] and starts[name][0] == which}
        if not ours:
            return given
        return lambda values: {**(given or {}), **{joint: float(values[i]) for i, joint in ours.items()}}

    return build, names, np.array(theta), started("q0", q0), started("v0", v0)


def _start_of(mechanism, name, q0, v0):
    """("q0" or "v0", joint, value) where the parameter is one of the start; else None."""
    for joint, which, given in ((name, "q0", q0), (name.removesuffix(SPEED), "v0", v0)):
        if joint not in mechanism.joints or (which == "v0" and joint == name):
            continue
        columns = mechanism.columns(joint)
        if columns.stop - columns.start != 1:
            raise InputError(f"{name} cannot be a parameter: joint {joint!r} has several degrees of freedom")
        if not (given is None or isinstance(given, Mapping)):
            raise InputError(f"{name} is a parameter: give {which}= as a mapping joint name → value, not an array")
        value = 0.0 if which == "v0" else _guessed(mechanism, joint)
        return which, joint, float((given or {}).get(joint, value))
    return None


def _guessed(mechanism, joint) -> float:
    model, i = mechanism.model, mechanism.joint_index(joint)
    numbers = mechanism.guess[model.idx_qs[i] : model.idx_qs[i] + model.nqs[i]]
    return float(numbers[0]) if len(numbers) == 1 else float(np.arctan2(numbers[1], numbers[0]))
