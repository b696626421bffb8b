"""The linear equations of one accepted step.

With r = M a + nle - τ - G λ, c = h/α_k and a = (v - ψ_v)/c, all at the accepted state, the derivatives
s = (s_ξ, s_v, s_λ) by a parameter θ follow from those of ψ, which are known from the steps before:

    K (s_v', s_λ') = -(c r_θ + c (f_x - F) E s_ψξ - M s_ψv,  (Φ_θ + W E s_ψξ)/c)
    s_ξ            = E (s_ψξ + c s_v')
    σ              = ρ_θ + H s_ξ + W s_v'
    (s_v, s_λ)     = (s_v', s_λ') - K⁻¹ (0, σ)

    K = [ M + c f_v + c² (f_x - F) E   -c G ]     F = ∂(G λ)/∂ξ,  H = ∂ρ/∂ξ,
        [ W E                            0  ]     E = (1 - c L)⁻¹

σ is the hidden residual of s itself: as every step of the run is put on the hidden constraint, so is every step of its
derivatives, and s_λ has the order of the method (without, one less, and jumps at each change of step). L s is the
derivative of the rate of chart coordinates at their centre, ½ [s, v]; it is zero where no joint has rotations of three
degrees of freedom. For values it is of higher order than the method, for derivatives it is not.
"""

import numpy as np

from ..dae import bdf
from ..dae.kkt import KKT

NUDGE = 3e-5  # rad or m: of the differences of rows; exact to 2e-10 of their size


class Point:
    """A place at which residuals by θ are wanted; what a subclass calls `residuals` is one flat array."""

    def rates(self, parameters):
        """Derivatives of the residuals by each parameter, (P, size); a parameter is a list of (weight, index1)."""
        rates = [sum((w * self.residuals(other) for w, other in terms), np.zeros(self.size)) for terms in parameters]
        return np.array(rates).reshape(len(parameters), self.size)


class Step(Point):
    """The linear equations of one accepted step of order `k` and size `h` to `t`, where `Z` is the table.

    `residuals`, for each parameter, is a list of (weight, :class:`~pinconsist.dae.index1.Index1`): r_θ, Φ_θ and ρ_θ
    are the weighted sums of the residuals of their systems at the accepted state.
    """

    def __init__(self, system, t, h, k, base, Z, residuals):
        nx, nv = system.nx, system.nv
        self.nv, self.c = nv, (c := h / bdf.alpha(k))
        p = Z[0, :nx] if system.vector_like else system.integrate(base, Z[0, :nx])
        v, lam = np.split(Z[0, nx:], [nv])
        a = (1.0 / np.arange(1, k + 1)) @ Z[1 : k + 1, nx : nx + nv] / h
        _, _, G, _ = (np.array(each) for each in system.evaluate(t, p, v, a))
        self.M, f_v, f_x = system.matrices(t, p, v, a)
        F, self.H = row_gradients(system, t, p, v, lam)
        self.E = np.eye(nx)
        if not system.vector_like:
            self.E = np.linalg.inv(self.E + 0.5 * c * system.bracket(v))
        self.W, self.WE = G.T, G.T @ self.E
        self.B = c * (f_x - F) @ self.E
        self.kkt = KKT(self.M + c * f_v + c * self.B, G, self.WE, c)
        self.state, self.size = (t, p, v, a, lam), nv + 2 * len(lam)
        self.r, self.phi, self.rho = np.split(self.rates(residuals), [nv, nv + len(lam)], axis=1)

    def residuals(self, index1):
        """(r, Φ, ρ) of the system of `index1`."""
        *state, lam = self.state
        f, phi, G, rho = index1.system.evaluate(*state)
        return np.concatenate((f - G @ lam, phi, rho))

    def forward(self, psi):
        """(s_ξ, s_v, s_λ), shape (P, nx+nv+nc), from the derivatives `psi` of ψ, shape (P, ≥ nx+nv)."""
        nv, c = self.nv, self.c
        x, v = psi[:, :nv], psi[:, nv : 2 * nv]
        right = np.hstack((c * self.r + x @ self.B.T - v @ self.M, (self.phi + x @ self.WE.T) / c))
        s = -self.kkt.solve(right.T).T
        s_x = (x + c * s[:, :nv]) @ self.E.T
        hidden = self.rho + s_x @ self.H.T + s[:, :nv] @ self.W.T
        s -= self.kkt.solve(np.hstack((np.zeros_like(x), hidden)).T).T
        return np.hstack((s_x, s))

    def backward(self, s):
        """(psi, rates): the transpose of :meth:`forward`, of one row `s`, (nx+nv+nc,).

        `psi`, (nx+nv,), is the derivative of a number by ψ, where `s` is that by the step's own values, and `rates`,
        (P,), is what comes of it by r_θ, Φ_θ and ρ_θ.
        """
        nv, c = self.nv, self.c
        hidden = self.kkt.solve_transposed(-s[nv:])[nv:]
        x = self.E.T @ (s[:nv] + self.H.T @ hidden)
        up, low = np.split(self.kkt.solve_transposed(s[nv:] + np.append(self.W.T @ hidden + c * x, 0.0 * hidden)), [nv])
        psi = np.append(x - self.B.T @ up - self.WE.T @ low / c, self.M.T @ up)
        return psi, self.rho @ hidden - c * self.r @ up - self.phi @ low / c


def row_gradients(system, t, p, v, lam):
    """(F, H) = (∂(G λ)/∂ξ, ∂ρ/∂ξ), by central differences of the rows as they are used in the run."""
    zero = np.zeros(system.nv)

    def at(xi):
        _, _, G, rho = system.evaluate(t, system.integrate(p, xi), v, zero)
        return np.concatenate((G @ lam, rho))

    both = [(at(e) - at(-e)) / (2.0 * NUDGE) for e in NUDGE * np.eye(system.nx)]
    return np.split(np.column_stack(both), [system.nv])
