"""Forces that jump, or have a kink, at known times: steps end there."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, floor
from operator import ge, gt
from typing import Any

import numpy as np

from ...errors import InputError
from ..breakpoints import jump_offset
from ..checks import finite_array, number, put
from .force import BoundForce, BoundLaw, Differentiated, ForceRecord, UserForce, as_force, bound_force, label_of
from .held import BEHIND

UNBOUNDED = float(np.finfo(float).max) / 2.0  # in place of infinity: its differences are finite


class BoundPiecewise(BoundForce):
    """A force on a model; during a run it stays in the interval that `change` has entered."""

    changes = True

    def __init__(self, record, force):
        self._force, self._times, self._period = force, record.times, record.period
        self._backwards, self._here = False, None
        self._begun: tuple | None = None  # the start of a run that is over, and the interval that begins there
        self.smooth, self.by_time, self.stores = force.smooth, force.by_time, force.stores

    def stored(self, q, v):
        return self._force.stored(q, v)

    def torque(self, t, q, v):
        return self._force.torque(self._inside(t), q, v)

    def derivatives(self, t, q, v):
        return self._force.derivatives(self._inside(t), q, v)

    def loads(self, t, q, v):
        return self._force.loads(self._inside(t), q, v)

    def element(self, t, q, v):
        return self._force.element(self._inside(t), q, v)

    def start(self, t, backwards) -> None:
        self._backwards, self._here = backwards, None
        self._here = self._around(t)

    def on_steps(self, run, t, backwards) -> None:
        """Act as in a run from `t` that is over: a step that ends at a jump has the force before it."""
        self.start(t, backwards)
        self._begun, self._backwards, self._here = (t, self._here), not backwards, None

    def times_between(self, low, high) -> list[float]:
        """The times at which it jumps, inside an interval."""
        if not self._period:
            return [t for t in self._times if low < t < high]
        first, last = floor(low / self._period), ceil(high / self._period)
        return [n * self._period for n in range(first, last + 1) if low < n * self._period < high]

    def differentiate(self, integrate) -> None:
        """Complete the derivatives of a user's force by differences."""
        if isinstance(self._force, BoundLaw | UserForce):
            self._force = Differentiated(self._force, integrate)

    def next_change(self, t) -> float:
        return self._here[0] if self._backwards else self._here[1]

    def change(self, t, q, v) -> bool | None:
        due, sign = self.next_change(t), -1.0 if self._backwards else 1.0
        if sign * (due - t) > jump_offset(t):
            return None
        self._here = self._around(due)
        return True

    def _around(self, t):
        """The interval between jumps that contains `t`; at a jump, the next one in the direction of the run."""
        if self._period:
            n, reached = floor(t / self._period), gt if self._backwards else ge
            if not reached(t, n * self._period):  # the quotient is rounded
                n -= 1
            elif reached(t, (n + 1) * self._period):
                n += 1
            return n * self._period, (n + 1) * self._period
        i = (bisect_left if self._backwards else bisect_right)(self._times, t)
        return self._times[i - 1] if i else -UNBOUNDED, self._times[i] if i < len(self._times) else UNBOUNDED

    def _inside(self, t):
        """The nearest time inside the interval, excluding its ends."""
        here = self._interval(t)
        return float(min(max(t, here[0] + jump_offset(here[0])), here[1] - jump_offset(here[1])))

    def _interval(self, t):
        if self._begun is not None:
            begun, first = self._begun
            before = t + (-BEHIND if self._backwards else BEHIND) * jump_offset(t)
            return first if abs(t - begun) <= jump_offset(t) else self._around(before)
        here = self._here
        if here is None or (t > here[1] if self._backwards else t < here[0]):  # a time before the current interval
            return self._around(t)
        return here


@dataclass(frozen=True, eq=False)
class Piecewise(ForceRecord):
    """A force that jumps, or has a kink, at known times. Steps end there; the next step uses the force after the jump.

    Otherwise a step that contains a jump is repeated with smaller and smaller sizes until it passes the error test.

    Parameters
    ----------
    force : force
        Any force that :func:`simulate` accepts in ``forces``. At the times themselves it may have either value: it is
        evaluated slightly before and after them.
    times : sequence of float, optional
        The times, s, in ascending order.
    period : float, optional
        Instead of times: the force jumps at all multiples of this time, s.

    Raises
    ------
    InputError
        Invalid numbers, times that are not ascending, neither or both of times and a period, a force that is sampled
        or held.
    """

    force: Any
    times: Sequence[float] = ()
    period: float | None = None

    _kind = "piecewise"

    @property
    def label(self) -> str:
        """The name of the force in energy reports and messages: that of the force itself."""
        return label_of(self.force)

    def __post_init__(self):
        times = finite_array(self.times, "Piecewise: times")
        if times.ndim != 1 or (np.diff(times) <= 0.0).any():
            raise InputError(f"Piecewise: times must increase, got {self.times!r}")
        if (len(times) == 0) == (self.period is None):
            raise InputError("Piecewise needs either times or a period at which the force jumps")
        period = None if self.period is None else number(self.period, "Piecewise: period", above=0.0)
        put(self, force=as_force(self.force), times=tuple(times.tolist()), period=period)

    def bind(self, model) -> Any:
        force = bound_force(model, self.force, self.label)
        if force.changes:
            raise InputError(f"Piecewise: {self.label!r} already has times of its own at which steps end")
        return BoundPiecewise(self, force)
