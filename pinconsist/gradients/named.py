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
    own = {i: parameter(mechanism, name) for i, name in enumerate(names) if starts[name] is None}
    theta = [own[i].value if i in own else starts[name][2] for i, name in enumerate(names)]

    def started(which, given):
        ours = {i: starts[name][1] for i, name in enumerate(names) if starts[name] and starts[name][0] == which}
        if not ours:
            return given
        return lambda values: {**(given or {}), **{joint: float(values[i]) for i, joint in ours.items()}}

    return Named(mechanism, own), names, np.array(theta), started("q0", q0), started("v0", v0)


class Named:
    """``build(theta)`` of a mechanism and `parameters` of it, by their indices in theta."""

    def __init__(self, mechanism, parameters):
        self.mechanism, self.parameters = mechanism, parameters
        self._last: tuple = (), mechanism

    def __call__(self, values):
        wanted = tuple((i, values[i]) for i, each in self.parameters.items() if values[i] != each.value)
        if wanted != self._last[0]:  # parameters of the start leave the mechanism the same object
            built = self.mechanism
            for i, value in wanted:
                built = self.parameters[i].put(built, value)
            self._last = wanted, built
        return self._last[1]


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
