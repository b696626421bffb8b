"""The steps of Radau IIA from one start to the next: their derivatives forwards, and back.

A step has no history: S is [s_p | s_v] where it begins, one row for each parameter. A time inside a step is reached by
the step made again up to there; rows there have the order of the method, and need no formulas of their own.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..dae.dense import RadauSegment
from ..dae.index1 import Index1, project_position, project_velocity
from ..dae.radau import StageNewton, Stages
from ..dae.rounding import rounding_weights
from ..errors import PinconsistError
from .stages import Motion, Multipliers

AT_ONCE = 1e-6  # of a step: times so near to its end are there, as shorter steps would be rounding


@dataclass
class StageLeg:
    """The steps of a run from one start to the next; answers what :class:`~pinconsist.gradients.forward.Leg` does.

    `tables`, (1+n, 1, P, nx+nv), are S at the start and after each step.
    """

    steps: list[RadauSegment]
    tables: Any = None
    _parameters: list = field(default_factory=list)

    def __post_init__(self):
        if _is_cut(last := self.steps[-1]):
            self.steps = [*self.steps[:-1], self._again(last, last.end)]

    start = property(lambda self: self.steps[0])
    t = property(lambda self: np.array([step.end for step in self.steps]))

    @property
    def system(self):
        """The system, with the constraint rows that were kept in these steps."""
        return self.start.system

    @property
    def span(self):
        """(from, to), s."""
        return self.start.t_old, self.steps[-1].end

    def step_at(self, t, sign):
        """(start, size) of the step that holds a time."""
        step = self.steps[self._holder(t, sign)]
        return step.t_old, step.h

    def _holder(self, t, sign):
        return min(int(np.searchsorted(sign * self.t, sign * t)), len(self.steps) - 1)

    def _place(self, t, sign):
        """(n, None) at the end of the step n - 1, with n = 0 the start; else (n, the step n made again up to `t`)."""
        i = self._holder(t, sign)
        step = self.steps[i]
        if abs(t - step.t_old) <= AT_ONCE * abs(step.h):
            return i, None
        if abs(t - step.end) <= AT_ONCE * abs(step.h):
            return i + 1, None
        return i, self._again(step, t)

    def _again(self, step, t) -> RadauSegment:
        """A step up to another time, solved to rounding."""
        system, h = step.system, t - step.t_old
        W = step.table.values(h / step.h * step.table.c) @ step.W
        stages = Stages(system, step.table, step.t_old, step.p0, step.v0, h, W)
        y = np.concatenate((step.p0 if system.vector_like else np.zeros(system.nx), step.v0))
        StageNewton().solve(stages, *rounding_weights(system, y))
        if stages.failure:
            raise PinconsistError(f"the step to t = {t:.6g} could not be made again: {stages.failure}")
        p = project_position(system, t, stages.P[-1], stages.V[-1])
        v = project_velocity(system, t, p, stages.V[-1])
        return replace(step, end=t, h=h, W=stages.W, U=stages.U, p=p, v=v)

    def _state(self, n, step):
        """(t, p, v) at a place."""
        if step is None:
            step = self.steps[max(n - 1, 0)]
            if n == 0:
                return step.t_old, step.p0, step.v0
        return step.end, step.p, step.v

    def states(self, times, sign):
        """p and [ξ | v | λ] at times, with ξ = 0."""
        system, p, y = self.system, [], []
        for t in times:
            state = self._state(*self._place(t, sign))
            p.append(state[1])
            y.append(np.concatenate((np.zeros(system.nx), state[2], Index1(system).acceleration(*state)[1])))
        return np.array(p).reshape(-1, system.npos), np.array(y).reshape(len(p), -1)

    def initial(self, index1, p, v):
        """[ξ | v] where the leg begins, as one row of a table, of another run that begins at (p, v)."""
        return np.concatenate((self.system.difference(self.start.p0, p), v))[None]

    @staticmethod
    def table(rows):
        """S of the derivatives of :meth:`initial`."""
        return rows

    def at(self, times, sign):
        """p, [ξ | v | λ] and the derivatives s, (n, P, nx+nv+nc), tangent at p, at times inside the leg."""
        p, y = self.states(times, sign)
        rows = []
        for t in times:
            n, step = self._place(t, sign)
            s = self.tables[n, 0]
            if step is not None:
                s = _moved(step, s, self._parameters)
            of = Multipliers(self.system, *self._state(n, step)).linearize()
            rows.append(np.hstack((s, of.forward(s, of.rates(self._parameters)))))
        return p, y, np.array(rows).reshape(len(p), self.tables.shape[2], y.shape[1])

    def follow(self, index1, residuals, S) -> None:
        """Fill `tables` from S at the start; `residuals`, for each parameter, is a list of (weight, Index1)."""
        self._parameters, tables = residuals, [S]
        for step in self.steps:
            tables.append(_moved(step, tables[-1][0], residuals)[None])
        self.tables = np.array(tables)

    def seeds(self):
        """What :meth:`sow` adds to: derivatives of a number by s, in each place, and by S at the start."""
        return [np.zeros((1, self.system.nx + self.system.nv)), []]

    def sow(self, times, derivatives, seeds, sign) -> None:
        """Add derivatives of a number by s at times, (n, nx+nv+nc), to `seeds`."""
        seeds[1] += [(*self._place(t, sign), bar) for t, bar in zip(times, derivatives, strict=True)]

    def follow_back(self, index1, residuals, seeds):
        """What the parameters change of a number in the steps, (P,); `seeds[0]` becomes its derivative by S there."""
        split, total = self.system.nx + self.system.nv, np.zeros(len(residuals))
        bars = np.zeros((1 + len(self.steps), split))

        def back(point, bar):
            bar, weights = point.linearize().backward(bar)
            total[:] += point.rates(residuals) @ weights
            return bar

        for n, step, bar in seeds[1]:
            moved = bar[:split]
            if bar[split:].any():
                moved = moved + back(Multipliers(self.system, *self._state(n, step)), bar[split:])
            bars[n] += moved if step is None else back(Motion(step), moved)
        for i in reversed(range(len(self.steps))):
            bars[i] += back(Motion(self.steps[i]), bars[i + 1])
        seeds[0][:] = bars[0]
        return total


def _moved(step, s, parameters):
    of = Motion(step).linearize()
    return of.forward(s, of.rates(parameters))


def _is_cut(step) -> bool:
    """Whether a step is used only up to a time inside of it."""
    return abs(step.t_old + step.h - step.end) > 8.0 * np.spacing(max(abs(step.t_old), abs(step.end)))


def stage_legs(curve) -> list[list[RadauSegment]]:
    """The steps of a curve of Radau IIA, parted where one does not go on from the one before."""
    legs: list[list] = []
    for i in range(len(curve.ends)):
        step, last = curve.plain(i), legs[-1][-1] if legs else None
        if (
            last is not None
            and not _is_cut(last)
            and np.array_equal(last.p, step.p0)
            and np.array_equal(last.v, step.v0)
        ):
            legs[-1].append(step)
        else:
            legs.append([step])
    return legs
