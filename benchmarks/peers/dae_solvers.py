"""Solvers of general DAEs, F(t, y, y') = 0: SUNDIALS IDA through scikit-sundae, and solve_dae, which is pure Python.

GGL (Gear, Gupta, Leimkuhler 1985), index 2, y = (q, v, λ, μ):  q' - v - Jᵀμ,  f(t, q, v, v') - Jᵀλ,  Φ,  J v + Φ_t.
Index 1, semi-explicit, y = (q, v, λ, a):  q' - v,  v' - a,  J a + γ,  f(t, q, v, a) - Jᵀλ.
"""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from pinconsist.paper.index1 import acceleration

from .problem import Peer, Rows, SolverFailed

IGNORED = 1e6
"""Absolute tolerance that takes a multiplier out of the error test, as SUNDIALS advises for index 2."""
MOST_STEPS = 10_000_000


class Equations:
    """A problem in the form "GGL" or "index 1": ``residual(t, y, yp, out)`` fills `out`; y and y' at its start."""

    def __init__(self, problem, form):
        self.system, self.form = problem.system, form
        self.n, self.m = self.system.nv, self.system.nc
        a, lam = acceleration(self.system, problem.span[0], problem.q0, problem.v0)
        last = np.zeros(self.m) if form == "GGL" else a
        self.y0 = np.concatenate((problem.q0, problem.v0, lam, last))
        self.yp0 = np.concatenate((problem.v0, a, np.zeros(self.m + len(last))))
        self.algebraic = np.arange(2 * self.n, len(self.y0))
        self.residual = self._ggl if form == "GGL" else self._index1

    def split(self, y):
        """Views of q, v, λ and the rest, of vectors or of rows."""
        n, end = self.n, 2 * self.n + self.m
        return y[..., :n], y[..., n : 2 * n], y[..., 2 * n : end], y[..., end:]

    def _ggl(self, t, y, yp, out):
        n, (q, v, lam, mu), parts = self.n, self.split(y), self.split(out)
        f, parts[2][:], G, parts[3][:] = self.system.evaluate(t, q, v, yp[n : 2 * n])
        parts[0][:], parts[1][:] = yp[:n] - v - G.dot(mu), f - G.dot(lam)

    def _index1(self, t, y, yp, out):
        n, (q, v, lam, a), parts = self.n, self.split(y), self.split(out)
        f, _, G, _ = self.system.evaluate(t, q, v, a)
        parts[0][:], parts[1][:] = yp[:n] - v, yp[n : 2 * n] - a
        parts[2][:], parts[3][:] = G.T.dot(a) + self.system.acceleration_bias(t, q, v), f - G.dot(lam)

    def jacobian(self, t, y, yp):
        """(∂F/∂y, ∂F/∂y') of the GGL form, without the derivative of Jᵀμ, since μ is near zero."""
        n, m, system = self.n, self.m, self.system
        (q, v, lam, _), a = self.split(y), yp[n : 2 * n]
        _, _, G, rho = system.evaluate(t, q, v, a)
        M, by_v, by_q = system.matrices(t, q, v, a)
        by_y, by_yp = np.zeros((len(y), len(y))), np.zeros((len(y), len(y)))
        by_yp[:n, :n], by_yp[n : 2 * n, n : 2 * n] = np.eye(n), M
        by_y[:n, n : 2 * n], by_y[:n, 2 * n + m :] = -np.eye(n), -G
        by_y[n : 2 * n, :n] = by_q - system.force_gradient(t, q, v, lam)
        by_y[n : 2 * n, n : 2 * n], by_y[n : 2 * n, 2 * n : 2 * n + m] = by_v, -G
        by_y[2 * n : 2 * n + m, :n] = by_y[2 * n + m :, n : 2 * n] = G.T
        step = 1e-7
        by_y[2 * n + m :, :n] = np.column_stack(
            [(system.constraint(t, q + step * unit, v)[1] - rho) / step for unit in np.eye(n)]
        )
        return by_y, by_yp

    def tolerances(self, tol):
        """Absolute tolerances: `tol` for q and v, none for the multipliers of the index-2 form."""
        atol = np.full(len(self.y0), tol)
        if self.form == "GGL":
            atol[self.algebraic] = IGNORED
        return atol


class _DaeSolver(Peer):
    form = "GGL"

    def prepare(self, problem, tol):
        equations = Equations(problem, self.form)

        def read(sol, thin):
            if not sol.success:
                raise SolverFailed(sol.message)
            rows = thin(len(sol.t))
            q, v, lam, _ = equations.split(self.rows(sol)[rows])
            return Rows(sol.t[rows], q, v, problem.multipliers(q, lam))

        return self.solver(problem, equations, tol), read

    @abstractmethod
    def solver(self, problem, equations, tol):
        """The function that is timed."""

    @abstractmethod
    def rows(self, sol) -> np.ndarray:
        """y at each time of its result, (n, len(y))."""


class SolveDae(_DaeSolver):
    """solve_dae (scipy_dae before): its "BDF" or "Radau" IIA with the Jacobian, as its documentation advises."""

    package = module = "solve_dae"

    def __init__(self, method):
        self.method, self.name = method, f"solve_dae {method}, GGL"

    def solver(self, problem, equations, tol):
        from solve_dae.integrate import solve_dae

        def residual(t, y, yp):
            out = np.empty_like(y)
            equations.residual(t, y, yp, out)
            return out

        options = {"method": self.method, "rtol": tol, "atol": equations.tolerances(tol), "jac": equations.jacobian}
        return lambda: solve_dae(residual, problem.span, equations.y0, equations.yp0, **options)

    def rows(self, sol):
        return sol.y.T


class Ida(_DaeSolver):
    """IDA with its dense solver, on one of the two forms; for index 1 with its own difference-quotient Jacobian."""

    package, module = "scikit-sundae", "sksundae"

    def __init__(self, form):
        self.form, self.name = form, f"IDA (scikit-sundae), {form}"

    def solver(self, problem, equations, tol):
        from sksundae.ida import IDA

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
        return lambda: solver.solve(np.array(problem.span), equations.y0, equations.yp0)

    def rows(self, sol):
        return sol.y
