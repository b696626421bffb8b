"""The steps of Radau IIA from one start to the next: their derivatives, forwards and backwards.

A step has no history: S is [s_p | s_v] at its start, one row for each parameter. For a time inside a step, a shorter
step to this time is solved; its result has the order of the method, and needs no formulas of its own.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from .._core.compiled_gradient import CompiledStagePropagator
from .._core.compiled_system import CompiledIndex1
from ..dae.index1 import project_position, project_velocity
from ..dae.radau import StageNewton, Stages
from ..dae.rounding import rounding_weights
from ..dae.segments import RadauSegment, not_made_again
from .linear import Motion, Multipliers

AT_ONCE = 1e-6  # of a step: times nearer than this to an end count as equal, as shorter steps would be rounding


class StagePropagator:
    """Propagates derivatives along steps, forwards and backwards, in Python, one step after another.

    Steps are :class:`~pinconsist.dae.segments.RadauSegment`. Each of the `parameters` is a list of (weight, Index1);
    the weighted sum of their residuals is the derivative of the residual by the parameter.
    """

    def __init__(self, system, parameters=()):
        self.system, self.parameters = system, parameters

    def again(self, steps):
        """Solve steps to rounding that are not solved yet, see ``RadauSegment.ending_at``."""
        return list(map(self._again, steps))

    def _again(self, step):
        system, t = step.system, step.end
        stages = Stages(system, step.table, step.t_old, step.p0, step.v0, step.h, step.W)
        y = np.concatenate((step.p0 if system.vector_like else np.zeros(system.nx), step.v0))
        if StageNewton().solve(stages, *rounding_weights(system, y)).failure:
            raise not_made_again(t)
        p = project_position(system, t, stages.P[-1], stages.V[-1])
        return replace(step, W=stages.W, U=stages.U, p=p, v=project_velocity(system, t, p, stages.V[-1]))

    def forward(self, steps, S, ends) -> None:
        """Write the derivatives at the ends of steps to `ends`, from those at their starts, `S`, which may overlap."""
        for step, begin, end in zip(steps, S, ends, strict=True):
            of = Motion(step)
            end[:] = of.forward(begin, of.rates(self.parameters))

    def backward(self, steps, given, bars):
        """The transpose, from the last step to the first: add to `bars`; return the derivative by parameters, (P,)."""
        return self._back(map(Motion, steps[::-1]), given[::-1], bars[::-1])

    def multipliers(self, t, p, v, s):
        """λ at states, (n, nc), and its derivatives, (n, P, nc), from those of the states."""
        points = list(map(partial(Multipliers, self.system), t, p, v))
        found = [of.forward(row, of.rates(self.parameters)) for of, row in zip(points, s, strict=True)]
        lam, nc = [of.lam for of in points], self.system.nc
        return np.reshape(lam, (len(t), nc)), np.reshape(found, (*s.shape[:2], nc))

    def multipliers_back(self, t, p, v, lam, bars):
        """The transpose for one number: add to `bars`, (n, nx+nv); return the derivative by the parameters, (P,)."""
        return self._back(map(partial(Multipliers, self.system), t, p, v), lam, bars)

    def _back(self, points, given, bars):
        total = np.zeros(len(self.parameters))
        for of, own, bar in zip(points, given, bars, strict=True):
            change, weights = of.backward(own)
            bar += change
            total += of.rates(self.parameters) @ weights
        return total


def propagator_of(index1, parameters) -> StagePropagator | CompiledStagePropagator:
    """The propagator for steps of the system of `index1`, compiled if possible."""
    if isinstance(index1, CompiledIndex1):
        return CompiledStagePropagator(index1, parameters)
    return StagePropagator(index1.system, parameters)


@dataclass
class StageLeg:
    """The steps of a run from one start to the next, with the methods of :class:`~pinconsist.gradients.forward.Leg`.

    `index1_of` returns the index-1 equations of a system. `tables`, (1+n, 1, P, nx+nv), are S at the start and after
    each step.
    """

    steps: list[RadauSegment]
    index1_of: Callable
    tables: Any = None
    _propagator: Any = field(default=None, repr=False)

    def __post_init__(self):
        self._propagator = propagator_of(self.index1_of(self.system), [])
        if _is_cut(last := self.steps[-1]):
            self.steps = [*self.steps[:-1], *self._propagator.again([last.ending_at(last.end)])]

    start = property(lambda self: self.steps[0])
    t = property(lambda self: np.array([step.end for step in self.steps]))
    system = property(lambda self: self.start.system)
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

    @staticmethod
    def begin(variants, base, s):
        """S at the start, from the derivatives of the state there."""
        return s[None]

    @staticmethod
    def begin_back(variants, base, seed):
        """The transpose, and the derivative by the parameters, which is zero."""
        return seed[0], 0.0

    def at(self, times):
        """p, [ξ | v | λ] and the derivatives s, (n, P, nx+nv+nc), tangent at p, at times inside the leg."""
        n, inside, steps = self._placed(times)
        t, p, v = self._states(n, inside, steps)
        s = self.tables[n, 0]
        ends = np.empty((len(inside), *s.shape[1:]))
        self._propagator.forward(steps, s[inside], ends)
        s[inside] = ends
        lam, of_lam = self._propagator.multipliers(t, p, v, s)
        return p, np.hstack((0.0 * v, v, lam)), np.concatenate((s, of_lam), axis=2)

    def follow(self, index1, residuals, S) -> None:
        """Fill `tables` from S at the start; `residuals`, for each parameter, is a list of (weight, Index1)."""
        self._propagator = propagator_of(index1, residuals)
        self.tables = np.empty((1 + len(self.steps), *S.shape))
        self.tables[0] = S
        self._propagator.forward(self.steps, self.tables[:-1, 0], self.tables[1:, 0])

    def seeds(self):
        """The object that :meth:`add_seeds` adds to: derivatives of a number by S at the start, and by s elsewhere."""
        return [np.zeros((1, self.system.nx + self.system.nv)), []]

    def add_seeds(self, times, derivatives, seeds) -> None:
        """Add derivatives of a number by s at times, (n, nx+nv+nc), to `seeds`."""
        if len(times):
            seeds[1].append((times, np.array(derivatives)))

    def follow_back(self, index1, residuals, seeds):
        """The derivative of a number by the parameters in the steps, (P,); `seeds[0]` becomes that by the first S."""
        self._propagator, split = propagator_of(index1, residuals), self.system.nx + self.system.nv
        bars, total = np.zeros((1 + len(self.steps), split)), np.zeros(len(residuals))
        for times, derivatives in seeds[1]:
            n, inside, steps = self._placed(times)
            state, given = self._states(n, inside, steps), np.array(derivatives[:, :split])
            with_lam = derivatives[:, split:].any(axis=1)
            by_state = np.zeros((with_lam.sum(), split))
            total += self._propagator.multipliers_back(
                *(x[with_lam] for x in state), derivatives[with_lam, split:], by_state
            )
            given[with_lam] += by_state
            own = np.zeros((len(inside), split))
            total += self._propagator.backward(steps, given[inside], own)
            given[inside] = own
            np.add.at(bars, n, given)
        total += self._propagator.backward(self.steps, bars[1:], bars[:-1])
        seeds[0][:] = bars[0]
        return total


def _is_cut(step) -> bool:
    """Whether a step is used only up to a time inside it."""
    return abs(step.t_old + step.h - step.end) > 8.0 * np.spacing(max(abs(step.t_old), abs(step.end)))


def stage_legs(curve) -> list[list[RadauSegment]]:
    """The steps of a curve of Radau IIA, split at steps that do not continue the previous one."""
    legs: list[list] = []
    for i in range(len(curve.ends)):
        step, last = curve.plain(i), legs[-1][-1] if legs else None
        if step.end == step.t_old:  # an event where it begins
            continue
        goes_on = last is not None and np.array_equal(last.p, step.p0) and np.array_equal(last.v, step.v0)
        if goes_on and not _is_cut(last):
            legs[-1].append(step)
        else:
            legs.append([step])
    return legs
