"""The steps of Radau IIA from one start to the next: their derivatives, forwards and backwards.

A step has no history: S is [s_p | s_v] at its start, one row for each parameter. For a time inside a step, a shorter
step to this time is solved; its result has the order of the method, and needs no formulas of its own.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..engine.index1 import Index1
from ..run.propagator import Propagator, Step

AT_ONCE = 1e-6  # of a step: times nearer than this to an end count as equal, as shorter steps would be rounding


@dataclass
class Leg:
    """The steps of a run from one start to the next.

    `index1_of` returns the index-1 equations of a system. `tables`, (1+n, P, nx+nv), are S at the start and after each
    step.
    """

    system: Any
    steps: list[Step]
    index1_of: Callable
    tables: Any = None
    _propagator: Any = field(default=None, repr=False)

    def __post_init__(self):
        self._propagator = Propagator(self.index1_of(self.system), [])
        if _is_cut(last := self.steps[-1]):
            self.steps = [*self.steps[:-1], *self._propagator.again([last.ending_at(last.end)])]

    start = property(lambda self: self.steps[0])
    t = property(lambda self: np.array([step.end for step in self.steps]))
    span = property(lambda self: (self.start.t_old, self.steps[-1].end))

    def close(self) -> None:
        self._propagator = None

    def step_at(self, t):
        """(start, size) of the step that contains a time."""
        step = self.steps[self._holders(np.array([t]))[0]]
        return step.t_old, step.h

    def _holders(self, times):
        sign = 1.0 if self.t[-1] >= self.start.t_old else -1.0
        return np.minimum(np.searchsorted(sign * self.t, sign * times), len(self.steps) - 1)

    def _placed(self, times):
        """(n, inside, steps): times are after n steps; those with indices `inside` at the ends of shorter `steps`."""
        n = self._holders(times)
        starts, sizes = np.array([(self.steps[i].t_old, self.steps[i].h) for i in n]).reshape(-1, 2).T
        part = (times - starts) / sizes
        at_end = np.abs(part - 1.0) <= AT_ONCE
        n[at_end] += 1
        inside = np.flatnonzero(~at_end & (np.abs(part) > AT_ONCE))
        return n, inside, self._propagator.again([self.steps[n[i]].ending_at(float(times[i])) for i in inside])

    def _states(self, n, inside, steps):
        """t, p and v at the times of :meth:`_placed`."""
        states = [(step.end, step.p, step.v) for step in (self.steps[i - 1] for i in n)]
        for i in np.flatnonzero(n == 0):
            states[i] = self.start.t_old, self.start.p0, self.start.v0
        for i, step in zip(inside, steps, strict=True):
            states[i] = step.end, step.p, step.v
        t, p, v = zip(*states, strict=True) if states else ((), (), ())
        p, v = np.reshape(p, (len(n), self.system.npos)), np.reshape(v, (len(n), self.system.nv))
        return np.array(t, float), p, v

    def states(self, times):
        """p and [ξ | v | λ] at times, with ξ = 0."""
        t, p, v = self._states(*self._placed(times))
        index1 = self.index1_of(self.system)
        lam = [index1.acceleration(*state)[1] for state in zip(t, p, v, strict=True)]
        return p, np.hstack((0.0 * v, v, np.array(lam).reshape(len(t), self.system.nc)))

    def at(self, times):
        """p, [ξ | v | λ] and the derivatives s, (n, P, nx+nv+nc), tangent at p, at times inside the leg."""
        n, inside, steps = self._placed(times)
        t, p, v = self._states(n, inside, steps)
        s = self.tables[n]
        ends = np.empty((len(inside), *s.shape[1:]))
        self._propagator.forward(steps, s[inside], ends)
        s[inside] = ends
        lam, of_lam = self._propagator.multipliers(t, p, v, s)
        return p, np.hstack((0.0 * v, v, lam)), np.concatenate((s, of_lam), axis=2)

    def follow(self, index1, residuals, S) -> None:
        """Fill `tables` from S at the start; `residuals`, for each parameter, is a list of (weight, Index1)."""
        self._propagator = Propagator(index1, residuals)
        self.tables = np.empty((1 + len(self.steps), *S.shape))
        self.tables[0] = S
        self._propagator.forward(self.steps, self.tables[:-1], self.tables[1:])

    def seeds(self):
        """The object that :meth:`add_seeds` adds to: derivatives of a number by s at times."""
        return []

    def add_seeds(self, times, derivatives, seeds) -> None:
        """Add derivatives of a number by s at times, (n, nx+nv+nc), to `seeds`."""
        if len(times):
            seeds.append((times, np.array(derivatives)))

    def follow_back(self, index1, residuals, seeds):
        """The derivatives of a number by S at the start, (nx+nv,), and by the parameters in the steps, (P,)."""
        self._propagator = Propagator(index1, residuals)
        split = self.system.nx + self.system.nv
        bars = np.zeros((1 + len(self.steps), split))
        total = np.zeros(len(residuals))
        for times, derivatives in seeds:
            n, inside, steps = self._placed(times)
            state = self._states(n, inside, steps)
            by_s = np.array(derivatives[:, :split])
            with_lam = derivatives[:, split:].any(axis=1)
            by_state = np.zeros((with_lam.sum(), split))
            total += self._propagator.multipliers_back(
                *(x[with_lam] for x in state), derivatives[with_lam, split:], by_state
            )
            by_s[with_lam] += by_state
            own = np.zeros((len(inside), split))
            total += self._propagator.backward(steps, by_s[inside], own)
            by_s[inside] = own
            np.add.at(bars, n, by_s)
        total += self._propagator.backward(self.steps, bars[1:], bars[:-1])
        return bars[0], total


def _is_cut(step) -> bool:
    """Whether a step is used only up to a time inside it."""
    return abs(step.t_old + step.h - step.end) > 8.0 * np.spacing(max(abs(step.t_old), abs(step.end)))


def legs_of(dense, index1_of=Index1) -> list[Leg]:
    """The legs of a run from its dense output; `index1_of` returns the index-1 equations of a system."""
    return [Leg(curve.system, steps, index1_of) for curve in dense.curves for steps in _parts(curve)]


def _parts(curve) -> list[list[Step]]:
    """The steps of a curve, split at steps that do not continue the previous one."""
    legs: list[list] = []
    for i in range(len(curve.ends)):
        step = Step.of(curve, i)
        last = legs[-1][-1] if legs else None
        if step.end == step.t_old:  # an event where it begins
            continue
        goes_on = last is not None and np.array_equal(last.p, step.p0) and np.array_equal(last.v, step.v0)
        if goes_on and not _is_cut(last):
            legs[-1].append(step)
        else:
            legs.append([step])
    return legs
