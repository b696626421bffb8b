"""SUNDIALS IDA through scikit-sundae."""

from __future__ import annotations

import numpy as np

from .equations import Equations
from .problem import Peer, Rows, SolverFailed

MOST_STEPS = 10_000_000


class Ida(Peer):
    """IDA with its own difference-quotient Jacobian and dense solver, its defaults.

    Parameters
    ----------
    form : {"GGL", "index 1"}
    """

    package, module = "scikit-sundae", "sksundae"

    def __init__(self, form):
        self.form, self.name = form, f"IDA (scikit-sundae), {form}"

    def prepare(self, problem, tol):
        from sksundae.ida import IDA

        equations = Equations(problem, self.form)
        n, m = equations.n, equations.m

        def jacobian(t, y, yp, res, cj, JJ):
            by_y, by_yp = equations.jacobian(t, y, yp)
            JJ[:] = by_y + cj * by_yp

        solver = IDA(
            equations.residual,
            rtol=tol,
            atol=equations.tolerances(tol),
            algebraic_idx=equations.algebraic,
            max_num_steps=MOST_STEPS,
            jacfn=jacobian if self.form == "GGL" else None,
        )

        def solve():
            return solver.solve(np.array(problem.span), equations.y0, equations.yp0)

        def read(sol, thin):
            if not sol.success:
                raise SolverFailed(sol.message)
            rows = thin(len(sol.t))
            q, v, lam = np.split(sol.y[rows][:, : 2 * n + m], (n, 2 * n), axis=1)
            return Rows(sol.t[rows], q, v, problem.multipliers(q, lam))

        return solve, read
