"""solve_dae (called scipy_dae before), pure Python, on the GGL form."""

from __future__ import annotations

import numpy as np

from .equations import Equations
from .problem import Peer, Rows, SolverFailed


class SolveDae(Peer):
    """Its BDF or Radau IIA with the Jacobian, as its documentation advises.

    Parameters
    ----------
    method : {"BDF", "Radau"}
    """

    package = module = "solve_dae"

    def __init__(self, method):
        self.method, self.name = method, f"solve_dae {method}, GGL"

    def prepare(self, problem, tol):
        from solve_dae.integrate import solve_dae

        equations = Equations(problem, "GGL")
        n, m = equations.n, equations.m

        def residual(t, y, yp):
            out = np.empty_like(y)
            equations.residual(t, y, yp, out)
            return out

        options = {"method": self.method, "rtol": tol, "atol": equations.tolerances(tol), "jac": equations.jacobian}

        def solve():
            return solve_dae(residual, problem.span, equations.y0, equations.yp0, **options)

        def read(sol, thin):
            if not sol.success:
                raise SolverFailed(sol.message)
            rows = thin(len(sol.t))
            q, v, lam, _ = np.split(sol.y.T[rows], (n, 2 * n, 2 * n + m), axis=1)
            return Rows(sol.t[rows], q, v, problem.multipliers(q, lam))

        return solve, read
