"""The linearised equations of one step of BDF or Radau IIA, and of the multipliers at a state.

BDF. With r = M a + nle - τ - G λ, c = h/α_k and a = (v - ψ_v)/c, all at the accepted state, the derivatives
s = (s_ξ, s_v, s_λ) by a parameter θ follow from those of ψ, which are known from the previous steps:

    K (s_v', s_λ') = -(c r_θ + c (f_x - F) E s_ψξ - M s_ψv,  (Φ_θ + W E s_ψξ)/c)
    s_ξ            = E (s_ψξ + c s_v')
    σ              = ρ_θ + H s_ξ + W s_v'
    (s_v, s_λ)     = (s_v', s_λ') - K⁻¹ (0, σ)

    K = [ M + c f_v + c² (f_x - F) E   -c G ]     F = ∂(G λ)/∂ξ,  H = ∂ρ/∂ξ,
        [ W E                            0  ]     E = (1 - c L)⁻¹

σ is the hidden residual of s itself. Every step of the run is put on the hidden constraint, and so is every step of its
derivatives. Therefore s_λ has the order of the method (otherwise it would have one order less, and jump at each change
of step). L s = ½ [s, v] is the derivative of the rate of chart coordinates at their centre; it is zero if no joint
rotates with three degrees of freedom. For values this term is of higher order than the method; for derivatives it is
not.

Radau IIA. A step from (p₀, v₀) has stages (P_i, V_i, W_i) with multipliers L_i, see :mod:`pinconsist.dae.radau`. With
the derivatives s_p, s_v of its start by θ, and dξ_i = T_i (dP_i - Ad_i s_p), Ad_i = 1 - T_i⁻¹ ad ξ_i,

    dV_i = T_i⁻¹ (Σ_j b_ij dξ_j/h - N_i dξ_i),   N_i = ∂(T_i V_i)/∂ξ_i,      dW_i = Σ_j b_ij (dV_j - s_v)/h,
    M_i dW_i + D_i dV_i + (K_i - F_i) dP_i + r_θi = G_i dL_i,    J_i dP_i + Φ_θi = 0,    r = f - G L,  F = ∂(G L)/∂ξ.

As in the run, dP_i = Z_i y_i - N_i Φ_θi, and Zᵀ G = 0 leaves s (nv - nc) unknowns y. Here T and N are exact, because
the step itself is differentiated; the derivatives have its order, 2s - 1.

At the end of the step, dP_s is projected onto Φ, and dV_s onto the hidden constraint, by [[M, -G], [J, 0]] at (p₁, v₁).
The run moves the velocity by δ = v₁ - V_s = M⁻¹ G ν, with M at a configuration that also depends on θ:

    M (s_v1 - dV_s) - G dν + q_θ + ∂q/∂ξ s_p1 = 0,    q = M δ - G ν,      J s_v1 + H s_p1 + ρ_θ = 0.

Without q, whose size is of the order of V_s, the derivatives would have the order of the unprojected stages. No history
is needed; the multipliers are those of the index-1 equations, at any state.
"""

from functools import cached_property

import numpy as np

from ..dae import bdf
from ..dae.charts import chart_matrix, chart_rate_gradient
from ..dae.index1 import solve_acceleration
from ..dae.kkt import KKT
from ..dae.radau import Stages
from ..mechanism.rank import null_space

NUDGE = 3e-5  # rad or m: step of the differences of rows, which are exact to 2e-10 of their size


class Point:
    """Linear equations at a point of a run: derivatives there, from derivatives (P, `starts`) and rates of residuals.

    A subclass has the residuals of a system, ``residuals(index1)``, as a flat array (`size`,), and a linear map
    ``solved(s, rates)``. The forward and the backward pass use the same matrix of this map, so that they are transposes
    of each other to rounding.
    """

    starts: int
    size: int

    def rates(self, parameters):
        """Derivatives of the residuals by each parameter, (P, size); a parameter is a list of (weight, index1)."""
        rates = [sum((w * self.residuals(other) for w, other in terms), np.zeros(self.size)) for terms in parameters]
        return np.array(rates).reshape(len(parameters), self.size)

    @cached_property
    def map(self):
        units = np.eye(self.starts + self.size)
        return self.solved(*np.hsplit(units, [self.starts])).T

    def forward(self, s, rates):
        """Derivatives at the point, (P, ·), from those at the start and the rates of residuals."""
        return np.hstack((s, rates)) @ self.map.T

    def backward(self, bar):
        """The transpose, for one row: (derivative by the start, weights of the residuals)."""
        return np.split(self.map.T @ bar, [self.starts])


class Step(Point):
    """The map from ψ to s in one accepted step of BDF, of order `k` and size `h`, to time `t` with table `Z`."""

    def __init__(self, system, t, h, k, base, Z):
        nx, nv = system.nx, system.nv
        self.nv, self.starts, self.c = nv, nx + nv, (c := h / bdf.alpha(k))
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

    def residuals(self, index1):
        """(r, Φ, ρ) of the system of `index1`."""
        *state, lam = self.state
        f, phi, G, rho = index1.system.evaluate(*state)
        return np.concatenate((f - G @ lam, phi, rho))

    def solved(self, psi, rates):
        """(s_ξ, s_v, s_λ), shape (P, nx+nv+nc), from the derivatives `psi` of ψ, shape (P, nx+nv)."""
        nv, c = self.nv, self.c
        x, v = np.hsplit(psi, [nv])
        r, phi, rho = np.split(rates, [nv, nv + len(self.W)], axis=1)
        right = np.hstack((c * r + x @ self.B.T - v @ self.M, (phi + x @ self.WE.T) / c))
        s = -self.kkt.solve(right.T).T
        s_x = (x + c * s[:, :nv]) @ self.E.T
        hidden = rho + s_x @ self.H.T + s[:, :nv] @ self.W.T
        s -= self.kkt.solve(np.hstack((np.zeros_like(x), hidden)).T).T
        return np.hstack((s_x, s))


def row_gradients(system, t, p, v, lam):
    """(F, H) = (∂(G λ)/∂ξ, ∂ρ/∂ξ), by central differences of the rows that the run uses."""
    zero = np.zeros(system.nv)

    def at(xi):
        _, _, G, rho = system.evaluate(t, system.integrate(p, xi), v, zero)
        return np.concatenate((G @ lam, rho))

    both = [(at(e) - at(-e)) / (2.0 * NUDGE) for e in NUDGE * np.eye(system.nx)]
    return np.split(np.column_stack(both), [system.nv])


class Motion(Point):
    """The map from derivatives at the start of a :class:`~pinconsist.dae.segments.RadauSegment` to those at its end."""

    def __init__(self, step):
        self.system = system = step.system
        self.of = of = Stages(system, step.table, step.t_old, step.p0, step.v0, step.h, step.W)
        self.t, self.p, self.v, self.gap = step.end, step.p, step.v, step.v - of.V[-1]
        self.still = np.zeros(system.nv)
        self.stages = list(zip(of.times, of.P, of.V, of.W, strict=True))
        self.starts, self.size = 2 * system.nv, of.table.s * (system.nv + system.nc) + 2 * system.nc + system.nv
        self.L, self.nu = [], None
        self._carry()
        self._stage_matrix()
        self._end()

    def _carry(self):
        """X maps dP - Ad s_p of all stages to dV, both (s nv)."""
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
        """The equations of all stages, multiplied by Zᵀ: their coefficients of dP, s_p and s_v."""
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
        """The matrices of the projection of the last stage onto the constraints."""
        system, state = self.system, (self.t, self.p, self.v)
        _, _, G, _ = system.evaluate(*state, self.still)
        self.J = G.T.copy()
        self.M, _, K = system.matrices(*state, self.still)
        self.kkt = KKT(self.M, G, self.J)
        nv = system.nv
        self.nu = self.kkt.solve(np.concatenate((np.zeros(nv), self.J @ self.gap)))[nv:]
        F, self.H = row_gradients(system, *state, self.nu)
        self.q = system.matrices(*state, self.gap)[2] - K - F

    def solved(self, s, rates):
        """[s_p | s_v] at the end, (P, nx+nv), from that at the start; `rates` as in :meth:`Point.rates`."""
        nv, carried = self.system.nv, s[:, : self.system.nv] @ self.Ad.T
        ends = np.cumsum([len(self.Z), self.N.shape[1], len(self.J), len(self.J)])
        r, closing, phi, rho, q = np.split(rates, ends, axis=1)
        closing = -closing @ self.N.T
        rhs = carried @ self.by_p.T + s[:, nv:] @ self.by_v.T - r @ self.Z - closing @ self.by_P.T
        dP = np.linalg.solve(self.matrix, rhs.T).T @ self.Z.T + closing
        dV = (dP - carried) @ self.X[-nv:].T
        s_p, zero = dP[:, -nv:], np.zeros_like(dV)
        s_p = s_p - self.kkt.solve(np.hstack((zero, phi + s_p @ self.J.T)).T).T[:, :nv]
        upper, lower = dV @ self.M - q - s_p @ self.q.T, -rho - s_p @ self.H.T
        return np.hstack((s_p, self.kkt.solve(np.hstack((upper, lower)).T).T[:, :nv]))

    def residuals(self, index1):
        """r and Φ of the stages, and Φ, ρ and q at the end, of the system of `index1`."""
        system, nu, r, closing = index1.system, self.nu, [], []
        for state, L in zip(self.stages, self.L, strict=True):
            f, phi, G, _ = system.evaluate(*state)
            r.append(f - G @ L)
            closing.append(phi.copy())
        f, phi, G, rho = (part.copy() for part in system.evaluate(self.t, self.p, self.v, self.still))
        moved = system.evaluate(self.t, self.p, self.v, self.gap)[0]
        return np.concatenate((*r, *closing, phi, rho, moved - f - G @ nu))


class Multipliers(Point):
    """The derivatives of λ at a state from those of the state: M a + f₀ = G λ and β = J a + γ = 0, differentiated."""

    def __init__(self, system, t, p, v):
        self.system, self.t, self.p, self.v = system, t, p, v
        self.a, self.lam = solve_acceleration(system, t, p, v)
        self.starts, self.size, a = 2 * system.nv, system.nv + system.nc, self.a
        G = system.evaluate(t, p, v, a)[2].copy()
        M, self.D, K = system.matrices(t, p, v, a)
        self.kkt = KKT(M, G, G.T)
        self.K = K - row_gradients(system, t, p, v, self.lam)[0]

        def by(way, step):
            pairs = ((_beta(system, t, *way(e), a), _beta(system, t, *way(-e), a)) for e in step * np.eye(system.nv))
            return np.array([one - other for one, other in pairs]).reshape(system.nv, system.nc).T / (2.0 * step)

        self.by_p = by(lambda e: (system.integrate(p, e), v), NUDGE)
        self.by_v = by(lambda e: (p, v + e), 1.0 + np.abs(v).max(initial=0.0))  # γ is quadratic in v

    def solved(self, s, rates):
        """s_λ, (P, nc), from [s_p | s_v]."""
        s_p, s_v = np.hsplit(s, [self.system.nx])
        r, beta = np.hsplit(rates, [self.system.nv])
        rhs = np.hstack((r + s_p @ self.K.T + s_v @ self.D.T, beta + s_p @ self.by_p.T + s_v @ self.by_v.T))
        return -self.kkt.solve(rhs.T).T[:, self.system.nv :]

    def residuals(self, index1):
        """(r, β) of the system of `index1`."""
        f, _, G, _ = index1.system.evaluate(self.t, self.p, self.v, self.a)
        return np.append(f - G @ self.lam, _beta(index1.system, self.t, self.p, self.v, self.a))


def _beta(system, t, p, v, a):
    """J a + γ, the residual of the acceleration constraints."""
    return system.evaluate(t, p, v, a)[2].T @ a + system.acceleration_bias(t, p, v)
