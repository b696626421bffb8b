"""The linear equations of one step of Radau IIA, and of the multipliers at a state.

A step from (p₀, v₀) has stages (P_i, V_i, W_i) with multipliers L_i, see :mod:`pinconsist.dae.radau`. With the
derivatives s_p, s_v of its start by a parameter θ and dξ_i = T_i (dP_i - Ad_i s_p), Ad_i = 1 - T_i⁻¹ ad ξ_i,

    dV_i = T_i⁻¹ (Σ_j b_ij dξ_j/h - N_i dξ_i),   N_i = ∂(T_i V_i)/∂ξ_i,      dW_i = Σ_j b_ij (dV_j - s_v)/h,
    M_i dW_i + D_i dV_i + (K_i - F_i) dP_i + r_θi = G_i dL_i,    J_i dP_i + Φ_θi = 0,    r = f - G L,  F = ∂(G L)/∂ξ.

As in the run, dP_i = Z_i y_i - N_i Φ_θi, and Zᵀ G = 0 leaves s (nv - nc) unknowns y. Here T and N are exact: what is
differentiated is the step itself, and its derivatives have its order, 2s - 1.

The end is dP_s put on Φ, and dV_s on the hidden constraint, by [[M, -G], [J, 0]] at (p₁, v₁). The velocity was moved by
δ = v₁ - V_s = M⁻¹ G ν, in the metric of a place that moves with θ, too:

    M (s_v1 - dV_s) - G dν + q_θ + ∂q/∂ξ s_p1 = 0,    q = M δ - G ν,      J s_v1 + H s_p1 + ρ_θ = 0.

Without q, which is of the order of V_s, the order of the derivatives is that of the unprojected stages. No history is
needed; the multipliers are those of the differential equation, at any state.
"""

import numpy as np

from ..dae.charts import chart_matrix, chart_rate_gradient
from ..dae.index1 import solve_acceleration
from ..dae.kkt import KKT
from ..dae.radau import Stages
from ..mechanism.rank import null_space
from .linear import NUDGE, Point, row_gradients


class Motion(Point):
    """The derivatives of the end of a step, a :class:`~pinconsist.dae.segments.RadauSegment`, by those of its start."""

    def __init__(self, step):
        self.system = system = step.system
        self.of = of = Stages(system, step.table, step.t_old, step.p0, step.v0, step.h, step.W)
        self.t, self.p, self.v, self.gap = step.end, step.p, step.v, step.v - of.V[-1]
        self.still = np.zeros(system.nv)
        self.stages = list(zip(of.times, of.P, of.V, of.W, strict=True))
        self.size = of.table.s * (system.nv + system.nc) + 2 * system.nc + system.nv
        self.L, self.nu = [], None
        self._carry()
        self._stage_matrix()
        self._end()

    def _carry(self):
        """X leads dP - Ad s_p of all stages to dV, both (s nv)."""
        of, system = self.of, self.system
        s, nx, b = of.table.s, system.nx, of.table.inverse / of.h
        if system.vector_like:
            self.Ad, self.X = np.tile(np.eye(nx), (s, 1)), np.kron(b, np.eye(nx))
            return
        T = [chart_matrix(system, xi) for xi in of.xi]
        back = list(map(np.linalg.inv, T))
        self.Ad = np.vstack([np.eye(nx) - T_inv @ system.bracket(xi) for T_inv, xi in zip(back, of.xi, strict=True)])
        blocks = [[b[i, j] * back[i] @ T[j] for j in range(s)] for i in range(s)]
        for i in range(s):
            blocks[i][i] = blocks[i][i] - back[i] @ chart_rate_gradient(system, of.xi[i], of.V[i]) @ T[i]
        self.X = np.block(blocks)

    def _stage_matrix(self):
        """Zᵀ of the equations of all stages, by dP and by s_p and s_v."""
        system, b, h = self.system, self.of.table.inverse, self.of.h
        s, nv, nd = len(b), system.nv, system.nv - system.nc
        dW = np.kron(b, np.eye(nv)) / h @ self.X
        self.Z, self.N = np.zeros((s * nv, s * nd)), np.zeros((s * nv, s * system.nc))
        self.by_p, self.by_v, stiffness = np.zeros((s * nd, s * nv)), np.zeros((s * nd, nv)), np.zeros((s * nd, s * nv))
        for i, (t, p, v, w) in enumerate(self.stages):
            f, _, G, _ = system.evaluate(t, p, v, w)
            rows, free, bound = (slice(i * n, (i + 1) * n) for n in (nv, nd, system.nc))
            Z, N = null_space(G.T), np.linalg.pinv(G.T)  # J Z = 0, J N = 1
            self.Z[rows, free], self.N[rows, bound] = Z, N
            self.L.append(N.T @ f)
            M, D, K = system.matrices(t, p, v, w)
            F, _ = row_gradients(system, t, p, v, self.L[-1])
            self.by_p[free] = Z.T @ (M @ dW[rows] + D @ self.X[rows])
            self.by_v[free] = Z.T @ M * (b[i].sum() / h)
            stiffness[free, rows] = Z.T @ (K - F)
        self.by_P = self.by_p + stiffness
        self.matrix = self.by_P @ self.Z

    def _end(self):
        """The last stage is put on the constraints."""
        system, state = self.system, (self.t, self.p, self.v)
        _, _, G, _ = system.evaluate(*state, self.still)
        self.J = G.T.copy()
        self.M, _, K = system.matrices(*state, self.still)
        self.kkt = KKT(self.M, G, self.J)
        nv = system.nv
        self.nu = self.kkt.solve(np.concatenate((np.zeros(nv), self.J @ self.gap)))[nv:]
        F, self.H = row_gradients(system, *state, self.nu)
        self.q = system.matrices(*state, self.gap)[2] - K - F

    def forward(self, s, rates):
        """[s_p | s_v] at the end, (P, nx+nv), from that at the start; `rates` as of :meth:`Point.rates`."""
        nv, carried = self.system.nv, s[:, : self.system.nv] @ self.Ad.T
        r, closing, (phi, rho, q) = self._split(rates)
        closing = -closing @ self.N.T
        rhs = carried @ self.by_p.T + s[:, nv:] @ self.by_v.T - r @ self.Z - closing @ self.by_P.T
        dP = np.linalg.solve(self.matrix, rhs.T).T @ self.Z.T + closing
        dV = (dP - carried) @ self.X[-nv:].T
        s_p, zero = dP[:, -nv:], np.zeros_like(dV)
        s_p = s_p - self.kkt.solve(np.hstack((zero, phi + s_p @ self.J.T)).T).T[:, :nv]
        upper, lower = dV @ self.M - q - s_p @ self.q.T, -rho - s_p @ self.H.T
        return np.hstack((s_p, self.kkt.solve(np.hstack((upper, lower)).T).T[:, :nv]))

    def backward(self, s):
        """([s_p | s_v], weights of the residuals): the transpose of :meth:`forward`, of one row."""
        nv, nc = self.system.nv, self.system.nc
        up, low = np.split(self.kkt.solve_transposed(np.append(s[nv:], np.zeros(nc))), [nv])
        s_p = s[:nv] - self.q.T @ up - self.H.T @ low
        phi = -self.kkt.solve_transposed(np.append(s_p, np.zeros(nc)))[nv:]
        of_v = self.X[-nv:].T @ (self.M @ up)
        dP = of_v.copy()
        dP[-nv:] += s_p + self.J.T @ phi
        y = np.linalg.solve(self.matrix.T, self.Z.T @ dP)
        carried, closing = self.by_p.T @ y - of_v, dP - self.by_P.T @ y
        s = len(self.stages)
        stages = np.hstack([(-self.Z @ y).reshape(s, nv), (-self.N.T @ closing).reshape(s, nc)])
        weights = np.concatenate((stages.ravel(), phi, -low, -up))
        return np.append(self.Ad.T @ carried, self.by_v.T @ y), weights

    def residuals(self, index1):
        """(r, Φ) of the stages and (Φ, ρ, q) of the end, of the system of `index1`."""
        system, nu = index1.system, self.nu
        parts = []
        for state, L in zip(self.stages, self.L, strict=True):
            f, phi, G, _ = system.evaluate(*state)
            parts += [f - G @ L, phi]
        f, phi, G, rho = (part.copy() for part in system.evaluate(self.t, self.p, self.v, self.still))
        moved = system.evaluate(self.t, self.p, self.v, self.gap)[0]
        return np.concatenate((*parts, phi, rho, moved - f - G @ nu))

    def _split(self, rates):
        """r, Φ of the stages, each (P, s ·), and Φ, ρ, q of the end."""
        s, nv, nc = self.of.table.s, self.system.nv, self.system.nc
        stages = rates[:, : s * (nv + nc)].reshape(len(rates), s, nv + nc)
        r, phi = (part.reshape(len(rates), -1) for part in np.split(stages, [nv], axis=2))
        return r, phi, np.split(rates[:, s * (nv + nc) :], [nc, 2 * nc], axis=1)


class Multipliers(Point):
    """The derivatives of λ at a state by those of the state: M a + f₀ = G λ and β = J a + γ = 0, differentiated."""

    def __init__(self, system, t, p, v):
        self.system, self.t, self.p, self.v = system, t, p, v
        self.a, self.lam = solve_acceleration(system, t, p, v)
        self.size, a = system.nv + system.nc, self.a
        G = system.evaluate(t, p, v, a)[2].copy()
        M, self.D, K = system.matrices(t, p, v, a)
        self.kkt = KKT(M, G, G.T)
        self.K = K - row_gradients(system, t, p, v, self.lam)[0]
        e, size = np.eye(system.nv), 1.0 + np.abs(v).max(initial=0.0)
        nudged = [[_beta(system, t, system.integrate(p, way), v, a) for way in (x, -x)] for x in NUDGE * e]
        pushed = [[_beta(system, t, p, v + way, a) for way in (x, -x)] for x in size * e]  # γ is quadratic in v
        self.by_p, self.by_v = (
            np.array([one - other for one, other in pairs]).reshape(system.nv, system.nc).T / (2.0 * step)
            for pairs, step in ((nudged, NUDGE), (pushed, size))
        )

    def linear(self):
        """a, λ and their derivatives by p and v, (nv+nc, nx+nv)."""
        return self.a, self.lam, -self.kkt.solve(np.block([[self.K, self.D], [self.by_p, self.by_v]]))

    def forward(self, s, rates):
        """s_λ, (P, nc), from [s_p | s_v]."""
        s_p, s_v = np.hsplit(s, [self.system.nx])
        r, beta = np.hsplit(rates, [self.system.nv])
        rhs = np.hstack((r + s_p @ self.K.T + s_v @ self.D.T, beta + s_p @ self.by_p.T + s_v @ self.by_v.T))
        return -self.kkt.solve(rhs.T).T[:, self.system.nv :]

    def backward(self, lam):
        """([s_p | s_v], weights of the residuals): the transpose of :meth:`forward`, of one row."""
        nv = self.system.nv
        weights = -self.kkt.solve_transposed(np.append(np.zeros(nv), lam))
        up, low = np.split(weights, [nv])
        return np.append(self.K.T @ up + self.by_p.T @ low, self.D.T @ up + self.by_v.T @ low), weights

    def residuals(self, index1):
        """(r, β) of the system of `index1`."""
        f, _, G, _ = index1.system.evaluate(self.t, self.p, self.v, self.a)
        r = f - G @ self.lam
        return np.append(r, _beta(index1.system, self.t, self.p, self.v, self.a))


def _beta(system, t, p, v, a):
    """J a + γ: what remains of the constraints of acceleration."""
    G = system.evaluate(t, p, v, a)[2]
    change = G.T @ a
    return change + system.acceleration_bias(t, p, v)
