"""Rounding: to what size it is iterated, when an error is rounding, and when a run makes no headway."""

from __future__ import annotations

import numpy as np

from ..errors import SingularSystemError
from . import tuning
from .kkt import kkt_at
from .norms import EPS, largest


def shortest_step(*times) -> float:
    """A step below this cannot be told from zero at these times, s."""
    return tuning.SMALLEST_STEP * float(np.spacing(max(map(abs, times))))


def rounding_weights(system, y):
    """Weight and tolerance with which Newton runs down to rounding: increments relative to the state's size."""
    size_x, size_v = 1.0 + largest(y[: system.nx]), largest(y[system.nx : system.nx + system.nv]) or 1.0
    return np.repeat((1.0 / size_x, 1.0 / size_v), (system.nx, system.nv)), 2.0 * EPS


def is_noise(dv, moved, v, psi_v, p, noise, closed=False) -> bool:
    """Whether Newton's increments are what rounding leaves, so that more iterations or a smaller step cannot help.

    `dv` are increments of the velocity by the dynamics, `moved` of the position by the constraint; `noise` is the size
    relative to the velocities that may be rounding. Where the loops are `closed` to rounding and yet are moved far,
    the position is beside a singular one.
    """
    step = largest(dv)
    scale = largest(v) + largest(psi_v) + step  # v = ψ_v + c v' may be a small difference of larger numbers
    return step <= noise * scale and largest(moved) <= (tuning.HALF if closed else 1e4 * EPS) * (1.0 + largest(p))


def rounding_gap(p, W) -> float:
    """The gap that rounding leaves in closed loops, from the position and from W or G."""
    return tuning.GAP * (1.0 + largest(p)) * (1.0 + largest(W))


def velocity_rounding(system, t, p, v) -> float:
    """Velocity that eps in v and in Φ brings about: positions move by eps/σ, W turns with them, v by eps/σ² |v|.

    0 where loops are open: more than rounding is wrong there.
    """
    nv, nc = system.nv, system.nc
    size, reach = EPS * largest(v), 1.0 + largest(p)
    if not nc:
        return size
    _, phi, G, _ = system.evaluate(t, p, v, np.zeros(nv))
    if largest(phi) > rounding_gap(p, G):
        return 0.0
    try:
        kkt, _, _, W = kkt_at(system, t, p, v)
    except SingularSystemError:
        return np.inf
    inverse = kkt.solve(np.vstack((np.zeros((nv, nc)), np.eye(nc))))[:nv]
    s, turn = (np.abs(matrix).sum(axis=1).max() for matrix in (inverse, W))
    return size * (1.0 + reach * s**2 * turn)


def error_of_rounding(system, t, p, v, k):
    """[ξ | v] of what rounding leaves in ∇ᵏ⁺¹y, which smaller steps cannot lower; and whether it is much.

    It is much beside singular positions alone. More than half of the digits are never taken to be spoilt.
    """
    size, speed = velocity_rounding(system, t, p, v), largest(v)
    noise = 2.0 ** (k + 1) * min(size, tuning.HALF * speed)
    return np.repeat((0.0, noise), (system.nx, system.nv)), size >= tuning.BESIDE * speed


class RoundingTest:
    """Whether it is rounding that fails the error test, which a shorter step would show as much.

    Only tolerances near rounding ask. And it has to show: a longer step, tried from the same point, had no error to
    match its order. For a while steps up to that length are then believed at once, as far as the bound allows. Beside
    singular positions, where the bound is far above the error, nothing has to show: the run would creep towards them
    in steps that pass by chance.
    """

    def __init__(self):
        self.restart()

    def restart(self) -> None:
        """Believe nothing."""
        self._believed, self._steps_left = 0.0, 0  # up to which step rounding has shown itself, and for how long

    def passes(self, control, h, k, error, tried, bound) -> bool:
        """Whether the `error` of a step h of order k is rounding.

        `tried` are the length of the step that failed the error test last and its error, or zeros; ``bound()`` is the
        largest error that rounding explains, and whether the position is beside a singular one.
        """
        h = abs(h)
        longer, its_error = tried
        if control.tightest[0] > tuning.NEAR_ROUNDING:
            return False
        shown = h < longer and error >= its_error * (h / longer) ** (tuning.SLOW * (k + 1))
        known = self._steps_left > 0 and h <= self._believed
        explained, singular = bound()
        if error > explained or not (shown or known or (singular and error * tuning.SURE <= explained)):
            return False
        if shown:
            self._believed, self._steps_left = max(self._believed if known else 0.0, longer), tuning.REMEMBERED
        return True

    def accepted(self) -> None:
        """A step was accepted: one step less of what is believed."""
        self._steps_left -= 1


class Headway:
    """Counts failed tries, and forgets them when the run has advanced."""

    def __init__(self):
        self.restart(0.0, 0.0)

    def restart(self, start, t) -> None:
        """The run begins, or begins again, at `start`; its history ends at `t`."""
        self._start, self._counted_from, self._setbacks = start, t, 0

    def setback(self) -> bool:
        """A try failed; whether the run has made no headway in too many of them."""
        self._setbacks += 1
        return self._setbacks > tuning.SETBACKS

    def reached(self, t) -> None:
        """A step was accepted that ends at `t`."""
        if abs(t - self._counted_from) > tuning.PROGRESS * abs(t - self._start):
            self._counted_from, self._setbacks = t, 0


class Pace:
    """Looks at the last steps now and then, and finds runs that would not end, as forces chatter in them.

    A relay that switches against the motion leaves no solution to any step that is worth its name: Newton fails again
    and again. Long runs are not stopped for being long, nor steep forces for being steep.
    """

    def __init__(self, control, t, steps=0):
        self._control, self._t, self._steps = control, t, steps
        self._failed = control.reasons.get("newton")

    def lost(self, steps, t, t_end, jumping) -> bool:
        """Whether the run would not end after its `steps` until `t`; ``jumping()`` says whether a force jumps there."""
        made, gone = steps - self._steps, abs(t - self._t)
        if made < tuning.WINDOW or self._failed is None:  # with a fixed step nothing fails twice
            return False
        failed = self._control.reasons["newton"] - self._failed
        self._t, self._steps, self._failed = t, steps, self._control.reasons["newton"]
        to_come = made * abs(t_end - t) / gone if gone else np.inf
        if failed <= tuning.CHATTER * made:
            return False
        return to_come > tuning.ENDLESS or (to_come > tuning.LONG and bool(jumping()))
