"""The steps of Radau IIA from one start to the next: their derivatives, forwards and backwards.

A step has no history: S is [s_p | s_v] at its start, one row for each parameter. For a time inside a step, a shorter
step to this time is solved; its result has the order of the method, and needs no formulas of its own.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from ..engine.index1 import Index1
from ..mechanism.breakpoints import jump_offset
from ..mechanism.forces.held import sided
from ..run.propagator import Propagator, Step
from .laws import WithTorques

NEAR_END = 1e-6  # of a step: times nearer than this to an end count as equal, as shorter steps would be rounding


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
    torques: list | None = field(default=None, repr=False)  # the derivatives of sampled torques, (m, P), in each step
    _propagator: Any = field(default=None, repr=False)

    def __post_init__(self):
        self._propagator = Propagator(self.index1_of(self.system), [])
        if _is_cut(last := self.steps[-1]):
            self.steps = [*self.steps[:-1], *self._propagator.again([last.ending_at(last.end)])]

    sign = property(lambda self: 1.0 if self.span[1] >= self.span[0] else -1.0)
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
        sign = self.sign
        return np.minimum(np.searchsorted(sign * self.t, sign * times), len(self.steps) - 1)

    def _placed(self, times):
        """(n, inside, steps): times are after n steps; those with indices `inside` at the ends of shorter `steps`."""
        n = self._holders(times)
        starts, sizes = np.array([(self.steps[i].t_old, self.steps[i].h) for i in n]).reshape(-1, 2).T
        part = (times - starts) / sizes
        at_end = np.abs(part - 1.0) <= NEAR_END
        n[at_end] += 1
        inside = np.flatnonzero(~at_end & (np.abs(part) > NEAR_END))
        return n, inside, self._propagator.again([self.steps[n[i]].ending_at(float(times[i])) for i in inside])

    def _states(self, times, n, inside, steps):
        """t, p and v at times, from :meth:`_placed`."""
        states = [(step.end, step.p, step.v) for step in (self.steps[i - 1] for i in n)]
        for i in np.flatnonzero(n == 0):
            states[i] = self.start.t_old, self.start.p0, self.start.v0
        for i, step in zip(inside, steps, strict=True):
            states[i] = step.end, step.p, step.v
        t, p, v = zip(*states, strict=True) if states else ((), (), ())
        t = np.array(t, float)
        if len(t) > 1 and (np.diff(times) == 0.0).any():
            t += self._sides(times)
        p, v = np.reshape(p, (len(n), self.system.npos)), np.reshape(v, (len(n), self.system.nv))
        return t, p, v

    def _sides(self, times):
        """The shifts of times by which, of two rows where forces jump, one is before and one behind."""
        jumps = [*self.system.times_of_changes(*sorted(self.span)), *self.system.breakpoints.ends]
        near = np.abs(np.subtract.outer(times, jumps)) <= jump_offset(times)[:, None]
        return np.where(near.any(axis=1), sided(times, False) - times, 0.0)

    def states(self, times):
        """p and [ξ | v | λ] at times, with ξ = 0."""
        t, p, v = self._states(times, *self._placed(times))
        index1 = self.index1_of(self.system)
        lam = [index1.acceleration(*state)[1] for state in zip(t, p, v, strict=True)]
        return p, np.hstack((0.0 * v, v, np.array(lam).reshape(len(t), self.system.nc)))

    def at(self, times):
        """p, [ξ | v | λ] and the derivatives s, (n, P, nx+nv+nc), tangent at p, at times inside the leg."""
        n, inside, steps = self._placed(times)
        t, p, v = self._states(times, n, inside, steps)
        s = self.tables[n]
        if len(inside):
            s[inside] = self._through(steps, s[inside], n[inside])
        with_torques = self._with_torques(s)
        lam, of_lam = self._propagator.multipliers(t, p, v, with_torques)
        of_lam = self._joined(of_lam, self._acting(t, n, inside))
        return p, np.hstack((0.0 * v, v, lam)), np.concatenate((s, of_lam), axis=2)

    def follow(self, index1, residuals, S, laws=None) -> None:
        """Fill `tables` from S at the start; `residuals`, for each parameter, is a list of (weight, Index1).

        With `laws`, torques that are sampled depend on S.
        """
        self._propagator = Propagator(index1, residuals if laws is None else WithTorques(residuals, laws))
        self.tables = np.empty((1 + len(self.steps), *S.shape))
        self.tables[0] = S
        if laws is None:
            self._propagator.forward(self.steps, self.tables[:-1], self.tables[1:])
            return
        self.torques = []
        for first, last in pairwise(laws.cuts(self)):
            step = self.steps[first]
            self.torques += [laws.rates(step.t_old, step.p0, step.v0, self.tables[first])] * (last - first)
            tables = self._with_torques(np.empty((1 + last - first, *S.shape)))
            tables[0, : len(S)] = self.tables[first]
            self._propagator.forward(self.steps[first:last], tables[:-1], tables[1:])
            self.tables[first + 1 : last + 1] = self._joined(tables[1:], np.arange(first, last))

    def _with_torques(self, s):
        """S with rows for the derivatives by sampled torques."""
        if not self.torques:
            return s
        return np.concatenate((s, np.zeros((len(s), len(self.torques[0]), s.shape[2]))), axis=1)

    def _joined(self, s, steps):
        """S of the parameters alone, from rows that are in these `steps`."""
        if self.torques is None:
            return s
        n = self.tables.shape[1]
        rates = np.array([self.torques[i] for i in steps]).reshape(len(s), -1, n)
        return s[:, :n] + np.einsum("kmp,kmx->kpx", rates, s[:, n:])

    def _through(self, steps, s, numbers):
        """S at the ends of shorter steps, which are parts of those with these numbers."""
        s = self._with_torques(s)
        ends = np.empty_like(s)
        self._propagator.forward(steps, s, ends)
        return self._joined(ends, numbers)

    def _acting(self, t, n, inside):
        """The numbers of the steps whose torques act at times, which are after n steps unless they are `inside`."""
        numbers = np.maximum(n - 1, 0)
        numbers[inside] = n[inside]
        behind = (n > 0) & (n < len(self.steps)) & (self.sign * t > self.sign * self.t[np.maximum(n - 1, 0)])
        numbers[behind] = n[behind]
        return numbers

    def seeds(self):
        """The object that :meth:`add_seeds` adds to: derivatives of a number by s at times."""
        return []

    def add_seeds(self, times, derivatives, seeds) -> None:
        """Add derivatives of a number by s at times, (n, nx+nv+nc), to `seeds`."""
        if len(times):
            seeds.append((times, np.array(derivatives)))

    def follow_back(self, index1, residuals, seeds, laws=None):
        """The derivatives of a number by S at the start, (nx+nv,), and by the parameters in the steps, (P,)."""
        n_own = len(residuals)
        self._propagator = Propagator(index1, residuals if laws is None else WithTorques(residuals, laws))
        split = self.system.nx + self.system.nv
        bars = np.zeros((1 + len(self.steps), split))
        total = np.zeros(n_own)
        cuts = [0, len(self.steps)] if laws is None else laws.cuts(self)
        placed = [self._seeded(each, bars, cuts) for each in seeds]
        for k, (first, last) in reversed([*enumerate(pairwise(cuts))]):
            rates = self._propagator.backward(self.steps[first:last], bars[first + 1 : last + 1], bars[first:last])
            rates = rates + sum(each[k] for each in placed)
            total += rates[:n_own]
            if laws is not None:
                step = self.steps[first]
                laws.add_bars(step.t_old, rates[n_own:])
                of_state, own = laws.pull_back(step.t_old, step.p0, step.v0)
                bars[first] += of_state
                total += own
        return bars[0], total

    def _seeded(self, seed, bars, cuts):
        """Add the derivatives of a number at times to `bars`; return its rates by parameters between the cuts."""
        times, derivatives = seed
        split = bars.shape[1]
        n, inside, steps = self._placed(times)
        t, p, v = self._states(times, n, inside, steps)
        part = np.searchsorted(cuts, self._acting(t, n, inside), side="right") - 1
        rates = np.zeros((len(cuts) - 1, len(self._propagator.parameters)))
        by_s = np.array(derivatives[:, :split])
        own = np.zeros((len(inside), split))
        for k in np.unique(part):
            rows = np.flatnonzero((part == k) & derivatives[:, split:].any(axis=1))
            by_state = np.zeros((len(rows), split))
            rates[k] += self._propagator.multipliers_back(
                t[rows], p[rows], v[rows], derivatives[rows, split:], by_state
            )
            by_s[rows] += by_state
            within = np.flatnonzero(part[inside] == k)
            found = own[within]
            made = [steps[i] for i in within]
            rates[k] += self._propagator.backward(made, by_s[inside[within]], found)
            own[within] = found
        by_s[inside] = own
        np.add.at(bars, n, by_s)
        return rates


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
