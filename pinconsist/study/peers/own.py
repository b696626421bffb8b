"""The package's own methods."""

from __future__ import annotations

from ...simulation import integrate
from .problem import Peer, Rows, SolverFailed


class Own(Peer):
    """Index-3 BDF of variable step with the every-step correction.

    Parameters
    ----------
    method : {"BDF", "ImplicitEuler"}
    order : int
        Highest order.
    """

    package = module = "pinconsist"

    def __init__(self, method, order):
        self.method, self.order = method, order
        self.name = f"pinconsist {method}" + (f" ≤ {order}" if 1 < order < 5 else "")

    def can(self, problem):
        return None

    def prepare(self, problem, tol):
        system = problem.system
        options = {"method": self.method, "max_order": self.order, "rtol": tol, "atol": tol}

        def solve():
            return integrate(system, problem.span, problem.q0, problem.v0, **options)

        def read(sol, thin):
            if not sol.success:
                raise SolverFailed(sol.message)
            rows = thin(len(sol.t))
            return Rows(sol.t[rows], sol.q[rows], sol.v[rows], sol.lam[rows])

        return solve, read
