"""Residual and Newton matrix of the equations of motion as general DAE solvers want them: F(t, y, y') = 0.

GGL (Gear, Gupta, Leimkuhler 1985), index 2, y = (q, v, λ, μ):  q' - v - Jᵀμ,  f(t, q, v, v') - Jᵀλ,  Φ,  J v + Φ_t.
Index 1, semi-explicit, y = (q, v, λ, a):  q' - v,  v' - a,  J a + γ,  f(t, q, v, a) - Jᵀλ.
"""

from __future__ import annotations

import numpy as np

from pinconsist.dae.acceleration import solve_acceleration

IGNORED = 1e6
"""Absolute tolerance that takes a multiplier out of the error test, as SUNDIALS advises for index 2."""


class Equations:
    """A problem in one of the two forms: ``residual(t, y, yp, out)`` fills `out`; y and y' at its start.

    Parameters
    ----------
    problem : Problem
    form : {"GGL", "index 1"}
    """

    def __init__(self, problem, form):
        self.system, self.form = problem.system, form
        self.n, self.m = self.system.nv, self.system.nc
        a, lam = solve_acceleration(self.system, problem.span[0], problem.q0, problem.v0)
        last = np.zeros(self.m) if form == "GGL" else a
        self.y0 = np.concatenate((problem.q0, problem.v0, lam, last))
        self.yp0 = np.concatenate((problem.v0, a, np.zeros(self.m + len(last))))
        self.algebraic = np.arange(2 * self.n, len(self.y0))
        self.residual = self._ggl if form == "GGL" else self._index1

    def _ggl(self, t, y, yp, out):
        n, m = self.n, self.m
        v = y[n : 2 * n]
        f, phi, G, rho = self.system.evaluate(t, y[:n], v, yp[n : 2 * n])
        out[:n] = yp[:n] - v - G.dot(y[2 * n + m :])
        out[n : 2 * n] = f - G.dot(y[2 * n : 2 * n + m])
        out[2 * n : 2 * n + m], out[2 * n + m :] = phi, rho

    def _index1(self, t, y, yp, out):
        n, m = self.n, self.m
        q, v, a = y[:n], y[n : 2 * n], y[2 * n + m :]
        f, _, G, _ = self.system.evaluate(t, q, v, a)
        out[:n], out[n : 2 * n] = yp[:n] - v, yp[n : 2 * n] - a
        out[2 * n + m :] = f - G.dot(y[2 * n : 2 * n + m])
        out[2 * n : 2 * n + m] = G.T.dot(a) + self.system.acceleration_bias(t, q, v)

    def jacobian(self, t, y, yp):
        """(∂F/∂y, ∂F/∂y') of the GGL form, without the derivative of Jᵀμ, since μ is near zero."""
        n, m, system = self.n, self.m, self.system
        q, v, lam, a = y[:n], y[n : 2 * n], y[2 * n : 2 * n + m], yp[n : 2 * n]
        _, _, G, rho = system.evaluate(t, q, v, a)
        A = [np.empty((n, n)) for _ in range(3)]
        for matrix, c in zip(A, (0.0, 1.0, -1.0), strict=True):
            system.linearize(t, q, v, a, lam, c, matrix)  # M + c ∂f/∂v + c² ∂f/∂q
        M, plus, minus = A
        by_y, by_yp = np.zeros((len(y), len(y))), np.zeros((len(y), len(y)))
        by_yp[:n, :n], by_yp[n : 2 * n, n : 2 * n] = np.eye(n), M
        by_y[:n, n : 2 * n], by_y[:n, 2 * n + m :] = -np.eye(n), -G
        by_y[n : 2 * n, :n] = (plus + minus) / 2 - M - system.force_gradient(t, q, v, lam)
        by_y[n : 2 * n, n : 2 * n], by_y[n : 2 * n, 2 * n : 2 * n + m] = (plus - minus) / 2, -G
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
