"""How far each motor can go: to a joint's limit, or to a singular position."""

from dataclasses import dataclass
from math import inf, tau

import numpy as np

from ..mechanism.names import beyond_limits, joints_in, velocity_units

STRIDE = 0.05  # rad, or lengths of the mechanism, in which a motor is led
MOST_STRIDES = 400  # for a sliding motor
HALVINGS = 40


@dataclass(frozen=True)
class MotorRange:
    """How far a motor can go, the others held.

    Attributes
    ----------
    motor : str
        Its name.
    lower, upper : float
        The positions at its ends, rad or m; infinite if it can turn all the way round, or if no end was found.
    lower_by, upper_by : str
        What ends it: the joint that is at its limit, ``"singular"``, or ``"nothing"``.
    lower_condition, upper_condition : float
        :meth:`Actuation.condition` at the ends.
    lower_moves, upper_moves : tuple of str
        Joints that can move with all motors held in the singular position at the end.
    """

    motor: str
    lower: float
    upper: float
    lower_by: str
    upper_by: str
    lower_condition: float
    upper_condition: float
    lower_moves: tuple[str, ...]
    upper_moves: tuple[str, ...]

    def __str__(self):
        return (
            f"{self.motor}: {self.lower:.6g} ({self.lower_by}, condition {self.lower_condition:.2g}) … "
            f"{self.upper:.6g} ({self.upper_by}, condition {self.upper_condition:.2g})"
        )


def ranges(act, q) -> list[MotorRange]:
    """What :meth:`Actuation.limits` returns."""
    chosen, found, units = act._chosen, [], velocity_units(act.mechanism.model)
    for k in range(chosen.n_motors):
        column = chosen.columns[k]
        stride, most = STRIDE * chosen.sizes[column], tau if units[column] == "rad" else inf
        name, start = act.motors[chosen.own[k]], act.positions(q)[chosen.own[k]]
        ends = [_end(act, q, k, start, sign * stride, most) for sign in (-1.0, 1.0)]
        found.append(MotorRange(name, *(each for pair in zip(*ends, strict=True) for each in pair)))
    return found


def _end(act, q, k, start, stride, most):
    """(position, what ends it, condition, joints that can move there) of one motor in one direction."""
    chosen, begun, gone = act._chosen, q, 0.0
    unit = np.zeros(len(chosen.columns))
    unit[k] = stride

    def beyond(there):
        """The joint that is farthest outside of its limits, or an empty string."""
        found = beyond_limits(act.mechanism, (0.0, 1.0), np.array([begun, there]))
        return max(found, key=lambda one: max(one.value - one.upper, one.lower - one.value)).joint if found else ""

    by = beyond(q)
    while not by and abs(gone) < most and abs(gone) < MOST_STRIDES * abs(stride):
        there, share = chosen.follower.follow(q, unit)
        if by := beyond(there):
            low, high = 0.0, share
            for _ in range(HALVINGS):
                middle = 0.5 * (low + high)
                inside = not (joint := beyond(chosen.follower.follow(q, middle * unit)[0]))
                by, low, high = joint or by, middle if inside else low, high if inside else middle
            there, share = chosen.follower.follow(q, low * unit)[0], low
        q, gone = there, gone + share * stride
        if share < 1.0:
            by = by or "singular"
    sizes, motions = chosen.weakest(q)
    n = chosen.n_motors
    moves = joints_in(act.mechanism, motions[:, n - 1]) if by == "singular" else ()
    end = start + gone if by else np.sign(stride) * inf
    return float(end), by or "nothing", float(sizes[n - 1]), moves
