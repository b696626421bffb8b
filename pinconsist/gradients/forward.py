"""The recursion of sensitivities over the accepted BDF steps of a run.

Just as the run's table holds the backward differences of [ξ | v | λ], a table S of shape (ROWS, P, nx+nv+nc) holds
those of s = [s_ξ | s_v | s_λ] for each parameter. Prediction, change of step and update are linear, so they are the
same for S.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from .._core.gradients import Follower
from ..dae import bdf
from ..dae.charts import chart_matrix
from ..dae.dense import Tables
from ..dae.index1 import Index1
from ..dae.radau_table import table
from ..dae.segments import RadauSegment
from .stage_leg import StageLeg, stage_legs

STAGES_OF_START = 5  # order 9
COLUMNS = ("t_old", "ends", "t", "h", "k", "base", "Z", "changes")  # fields of Tables


@dataclass
class Leg:
    """The `steps` of a run from one start to the next, as arrays; the first entry is the starting history.

    `tables`, (1+n, ROWS, P, nx+nv+nc), are the tables S after the history and after each step.
    """

    steps: Tables
    tables: Any = None

    start = property(lambda self: self.steps.segment(0))
    t = property(lambda self: self.steps.t[1:])
    changes = property(lambda self: self.steps.changes[1:])
    system = property(lambda self: self.steps.system)
    span = property(lambda self: (float(self.steps.start), float(self.steps.ends[-1])))

    def step_at(self, t):
        """(start, size) of the step that contains a time."""
        i = int(self.steps.holders(t))
        return float(self.steps.t_old[i]), float(self.steps.h[i])

    def curve(self):
        """t, h, k, chart centre and table of all steps, the history first."""
        steps = self.steps
        return steps.t, steps.h, steps.k, steps.base, steps.Z

    def close(self) -> None:
        """Do nothing: there are no compiled systems to release."""

    def _history(self, index1):
        """The points of the history as a leg of Radau IIA, their times, the columns of ξ in charts, and T there.

        The history solves the index-1 equations; steps of such a high order do not limit its accuracy.
        """
        first, system, formula = self.start, self.system, table(STAGES_OF_START)
        y = (bdf.differences(first.k) @ first.Z[: first.k + 1])[::-1]
        times = first.t_old + first.h * np.arange(first.k + 1)
        states = [first(t)[:2] for t in times]
        steps = []
        for t, end, (p, v), (q, w) in zip(times[:-1], times[1:], states[:-1], states[1:], strict=True):
            stages = [(at, *first(at)[:2]) for at in t + first.h * formula.c]
            W = np.array([index1.acceleration(*stage)[0] for stage in stages])
            steps.append(RadauSegment(t, end, first.h, formula, p, v, W, None, q, w, system))
        return StageLeg(steps, lambda _: index1), times, self._charts(y)

    def begin(self, variants, base, s):
        """S of the history, from the derivatives `s`, (P, nx+nv), of the state at the start of the leg."""
        history, times, (turning, T) = self._history(index1 := base.index1(self.system))
        history.follow(index1, variants.residuals(self.system), s[None])
        rows = history.at(times)[2]
        rows[..., turning] = rows[..., turning] @ T.transpose(0, 2, 1)
        S = np.zeros((bdf.ROWS, *rows.shape[1:]))
        S[: len(rows)] = np.tensordot(bdf.differences(len(rows) - 1), rows[::-1], 1)
        return S

    def begin_back(self, variants, base, seed):
        """The transpose: from the derivative of a number by S, those by `s`, (nx+nv,), and by the parameters, (P,)."""
        history, times, (turning, T) = self._history(index1 := base.index1(self.system))
        rows = (bdf.differences(len(times) - 1).T @ seed[: len(times)])[::-1]
        rows[:, turning] = np.einsum("nj,nji->ni", rows[:, turning], T)
        history.add_seeds(times, rows, seeds := history.seeds())
        own = history.follow_back(index1, variants.residuals(self.system), seeds)
        return seeds[0][0], own

    def follow(self, index1, residuals, S) -> None:
        """Fill `tables` from S of the history; `residuals`, for each parameter, is a list of (weight, Index1)."""
        Follower(index1, residuals).forward(self, S)

    def seeds(self):
        """Zeros to which :meth:`add_seeds` adds: the derivatives of a number by each of the tables S."""
        return np.zeros(self.steps.Z.shape)

    def follow_back(self, index1, residuals, seeds):
        """The derivative of a number by the parameters in the steps, (P,); `seeds[0]` becomes that by the first S."""
        return Follower(index1, residuals).backward(self, seeds)

    def at(self, times):
        """p, [ξ | v | λ] and the derivatives s, (n, P, nx+nv+nc), tangent at p, at times inside the leg."""
        p, y, i, basis = self.states(times)
        s = np.einsum("nj,njpy->npy", basis, self.tables[i, : basis.shape[1]])
        turning, T = self._charts(y)
        s[..., turning] = s[..., turning] @ np.linalg.inv(T).transpose(0, 2, 1)
        return p, y, s

    def _charts(self, y):
        """The columns of joints in charts, and T of these at rows of ξ, (n, ·, ·)."""
        system = self.system
        if system.vector_like:
            return np.zeros(0, int), np.zeros((len(y), 0, 0))
        turning = np.flatnonzero(system.bracket(np.arange(1.0, 1.0 + system.nx)).any(axis=0))
        return turning, chart_matrix(system, y[:, : system.nx], turning)

    def states(self, times):
        """p, [ξ | v | λ], the indices of the tables for the times, 0 for the history, and the weights of their rows."""
        t, h, k, base, Z = self.curve()
        i = self.steps.holders(times)
        basis = bdf.interpolate(highest := int(k.max()), (times - t[i]) / h[i])
        basis[np.arange(highest + 1) > k[i, None]] = 0.0
        y = np.einsum("nj,njy->ny", basis, Z[i, : highest + 1])
        xi = y[:, : self.system.nx]
        if self.system.vector_like:
            return xi, y, i, basis
        return np.array([self.system.integrate(*pair) for pair in zip(base[i], xi, strict=True)]), y, i, basis

    def add_seeds(self, times, derivatives, seeds) -> None:
        """Add to `seeds` the derivatives of a number by s at times, (n, nx+nv+nc)."""
        (_, y, holders, basis), rows = self.states(times), np.array(derivatives)
        turning, T = self._charts(y)
        rows[:, turning] = np.einsum("nj,nji->ni", rows[:, turning], np.linalg.inv(T))
        for i, weights, s in zip(holders, basis, rows, strict=True):
            seeds[i, : len(weights)] += np.outer(weights, s)


def legs_of(dense, index1_of=Index1) -> list[Leg] | list[StageLeg]:
    """The legs of a run from its dense output; `index1_of` returns the index-1 equations of a system."""
    if not hasattr(dense.curves[0].plain(0), "changes"):
        return [StageLeg(steps, index1_of) for curve in dense.curves for steps in stage_legs(curve)]
    legs: list[list[Tables]] = []
    for curve in dense.curves:
        begun = [i for i, changes in enumerate(curve.changes) if changes is None]
        for i, end in pairwise(sorted({0, *begun, len(curve.changes)})):
            part = replace(curve, **{name: getattr(curve, name)[i:end] for name in COLUMNS})
            if curve.changes[i] is None:
                legs.append([part])
            else:  # continues the previous curve
                legs[-1].append(part)
    return [Leg(first.with_others(others)) for first, *others in legs]
