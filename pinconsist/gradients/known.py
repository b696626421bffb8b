"""Derivatives of the equations that are known exactly: by numbers of bodies, by gravity, by numbers of one force.

Such a parameter changes f = M a + nle - τ alone, in which masses, first moments and inertias about joints are linear,
and so is gravity. Each is a system whose f is r_θ and whose rows are zero, so that it stands where other parameters
have the weighted residuals of mechanisms beside.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from ..errors import InputError
from ..mechanism.parameters import Parameter

OF_STEPS = {-1: -1 / 2, 1: 1 / 2}
OF_STEPS_AHEAD = {0: -3 / 2, 1: 2.0, 2: -1 / 2}
CLOSE = 0.1  # of the step of others: laws of forces are smooth, and most of them linear in their numbers


@dataclass
class Inertial:
    """By the ten numbers of a joint's body in Pinocchio's regressor: their rates."""

    joint: int
    rates: np.ndarray

    def force(self, model, data, t, q, v, a):
        """r_θ at a state."""
        columns = slice(10 * self.joint - 10, 10 * self.joint)
        return pin.computeJointTorqueRegressor(model, data, q, v, a)[:, columns] @ self.rates

    def hand_over(self, twin) -> None:
        """Add it to a compiled system."""
        twin.add_inertia(self.joint, self.rates)


@dataclass
class Gravity:
    """By gravity in a direction."""

    rates: np.ndarray

    def force(self, model, data, t, q, v, a):
        """r_θ at a state."""
        still, there = np.zeros(model.nv), model.copy()
        there.gravity = pin.Motion(self.rates, np.zeros(3))
        return pin.rnea(there, data, q, still, still)

    def hand_over(self, twin) -> None:
        """Add it to a compiled system."""
        twin.add_gravity(self.rates)


@dataclass
class Pull:
    """The torques of one force, with a number of it a little larger or smaller."""

    bound: Any

    def force(self, model, data, t, q, v, a):
        """Its part of f at a state."""
        return -self.bound.torque(t, q, v)

    def hand_over(self, twin) -> None:
        """Add it to a compiled system."""
        if not self.bound.hand_over(twin):
            twin.add_python_force(self.bound)


class Known:
    """One of these as a system, with zeros for the rows of the system `like`; `data` is shared with others."""

    def __init__(self, part, like, data):
        self.part, self.model, self.nv, self.nc = part, like.model, like.nv, like.nc
        self._data = data

    def evaluate(self, t, p, v, a):
        """f, Φ, G and ρ at a state."""
        zero = np.zeros(self.nc)
        return self.part.force(self.model, self._data, t, p, v, a), zero, np.zeros((self.nv, self.nc)), zero

    def acceleration_bias(self, t, p, v):
        """That of its rows, (nc,)."""
        return np.zeros(self.nc)


def parts_of(parameter: Parameter, model, step) -> list[tuple[float, Any]]:
    """(weight, part) whose sum is the derivative by a parameter, if it is known; else none."""
    if parameter.part is None:
        return []
    step = CLOSE * step
    for weights, sign in ((OF_STEPS, 1), (OF_STEPS_AHEAD, 1), (OF_STEPS_AHEAD, -1)):
        changes = {sign * m * step: sign * weight / step for m, weight in weights.items()}
        try:
            each = [(weight, parameter.part(parameter.value + change)) for change, weight in changes.items()]
        except InputError:  # at a bound
            continue
        kind = each[0][1][0]
        if kind == "force":
            return [(weight, Pull(record.bind(model))) for weight, (_, record) in each]
        rates = sum(weight * part[-1] for weight, part in each)
        return [(1.0, Gravity(rates) if kind == "gravity" else Inertial(each[0][1][1], rates))]
    return []
