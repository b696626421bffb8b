"""What the methods are measured against: scipy's DOP853 on the index-1 equations, dense."""

from __future__ import annotations

from functools import partial

import numpy as np
from scipy.integrate import solve_ivp

from pinconsist import PinconsistError
from pinconsist.engine.charts import chart_point, fastest_turn, turning_coordinates
from pinconsist.paper.index1 import acceleration, right_hand_side

from .peers.problem import Problem

TOLERANCES = (1e-9, 1e-11, 1e-13)
MAX_STEPS = 100_000
"""Evaluations at the first tolerance."""
WORTH_IT = 10
"""A finer tolerance, for which an order of 8 needs twice the work, is given up at so many times that of the coarser:
it is then below the noise of the accelerations, as in long chains."""
FEW = 500
"""Evaluations that are always granted."""
FARTHEST = 3.0
"""rad that a body may turn from its start; the chart there ends at half a turn."""


class DenseReference:
    """The solution of a problem at any time.

    `dense` is t → (q, v) at the finest tolerance that rounding allows, `uncertainty` its largest difference in q to the
    tolerance before it. Configurations that are not vectors are followed in the chart at the start. Raises
    PinconsistError where scipy fails, for instance where the rows of the loops that are kept at the start become
    dependent on the way, and where a body turns out of that chart.
    """

    def __init__(self, problem: Problem):
        self.problem, self.system = problem, problem.system
        found, most = [], MAX_STEPS
        for tol in TOLERANCES:
            run, spent = self._dense(tol, most)
            if run is None:
                break
            found.append(run)
            most = max(FEW, WORTH_IT * spent)
        if len(found) < 2:
            raise PinconsistError(
                f"{problem.name}: no reference: at a tolerance of {tol:g} scipy's DOP853 takes too many steps. Some "
                "position on the way is singular, or nearly, or the motion is too fast for its length; try an earlier "
                "end"
            )
        coarse, self.dense = found[-2:]
        n, times = self.system.nx, np.linspace(*problem.span, 200)
        self.uncertainty = float(np.abs(self.dense(times)[:n] - coarse(times)[:n]).max())
        turned = fastest_turn(turning_coordinates(self.system, problem.q0), self.dense(times)[:n].T)
        if turned > FARTHEST:
            raise PinconsistError(f"{problem.name}: no reference: a body turns by {turned:.3g} rad; try an earlier end")
        q, v, lam = self.at(times)
        self._largest = [_size(part) for part in (v, lam, self._forces(times, q, lam))]

    def _dense(self, rtol, most):
        """(dense output, evaluations), or (None, evaluations) where that many are not enough."""
        problem, system = self.problem, self.system
        f = right_hand_side(system, problem.q0, partial(acceleration, system))
        count = 0

        def counted(t, y):
            nonlocal count
            count += 1
            if count > most:
                raise _TooMany
            return f(t, y)

        xi0 = problem.q0 if system.vector_like else np.zeros(system.nx)
        y0 = np.concatenate((xi0, problem.v0))
        try:
            run = solve_ivp(counted, problem.span, y0, "DOP853", rtol=rtol, atol=rtol, dense_output=True)
        except _TooMany:
            return None, count
        if not run.success:
            raise PinconsistError(f"{problem.name}: no reference: {run.message}")
        return run.sol, count

    def at(self, times):
        """(q, v, λ of all rows) at times."""
        y = self.dense(times).T
        q = np.array([chart_point(self.system, self.problem.q0, xi) for xi in y[:, : self.system.nx]])
        v = y[:, self.system.nx :]
        kept = np.array([acceleration(self.system, *row)[1] for row in zip(times, q, v, strict=True)])
        return q, v, self.problem.multipliers(q, kept)

    def _forces(self, *stacks):
        """Jᵀλ of stacks of t, q, λ."""
        return np.array([self.system.loop_rows(q, t)[1].T @ lam for t, q, lam in zip(*stacks, strict=True)])

    def errors(self, rows) -> tuple[float, ...]:
        """(q, v, λ, q at the end, λ in the first row, λ at the method's own first step, Jᵀλ).

        All but these three the largest; v, λ and Jᵀλ in parts of their largest in the run.
        """
        q, v, lam = self.at(np.clip(rows.t, *self.problem.span))
        off = np.array([self.system.difference(*pair) for pair in zip(q, rows.q, strict=True)])
        parts = rows.v - v, rows.lam - lam, self._forces(rows.t, rows.q, rows.lam) - self._forces(rows.t, q, lam)
        by_q, by_v, by_lam, by_force = (np.abs(part).max(axis=1) for part in (off, *parts))
        of_v, of_lam, of_force = self._largest
        relative = by_lam / of_lam  # the start is given, not computed
        first = relative[1], relative[rows.first]
        return (by_q.max(), by_v.max() / of_v, relative[1:].max(), by_q[-1], *first, by_force[1:].max() / of_force)


def _size(values):
    """The largest magnitude, or 1 where nothing moves."""
    size = np.abs(values).max(initial=0.0)
    return size if size > 1e-12 else 1.0


class _TooMany(Exception):
    """Evaluations of the right-hand side."""
