"""Radau IIA on the index-3 equations: the stage equations by Newton in the null space of the constraints.

The unknowns of a step from (t₀, p₀, v₀) are accelerations W_i at the times t₀ + c_i h, i = 1 … s. They give

    V_i = v₀ + h Σ_j a_ij W_j,    P_i = p₀ ⊕ ξ_i,    ξ_i = h Σ_j a_ij U_j

with U_j the rate of ξ at stage j (V_j itself where positions are vectors), and solve, with multipliers L_i,

    f(t_i, P_i, V_i, W_i) = G_i L_i,    Φ(t_i, P_i) = 0.

Newton moves the stage *positions* by dP_i. The constraint then is one of each stage alone, J_i dP_i = -Φ_i, and

    dP_i = Z_i y_i - N_i Φ_i,    J_i Z_i = 0,    J_i N_i = 1,

leaves s (nv - nc) unknowns y. The multipliers vanish in the rows Y_iᵀ, Y_iᵀ G_i = 0 (Y_i = Z_i for rigid bodies), and
are neither predicted nor iterated:

    Y_iᵀ Σ_j (b²_ij M_i + b_ij h D_i + δ_ij h² K_i) dP_j = -h² Y_iᵀ f_i,    D = ∂f/∂v, K = ∂f/∂p,

where b = A⁻¹ and b² = A⁻², as dV = A⁻¹ dP/h and dW = A⁻¹ dV/h. In a chart, U = T V, dξ = T dP, and with the bracket of
the group δv = (δp)' + [v, δp]: dV_i = T_i⁻¹ (Σ_j b_ij T_j dP_j/h - T'_i dP_i) + [V_i, dP_i].

References
----------
E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, sections IV.5, IV.8, VII.4.
"""

from dataclasses import dataclass
from math import isfinite

import numpy as np
from scipy.linalg.lapack import dgetrf, dgetrs

from .charts import chart_matrix
from .newton import culprits, to_come, tolerated
from .norms import EPS, largest
from .problem import Index3System
from .radau_table import Table
from .rounding import is_noise, per_position, rounding_gap
from .tuning import CLOSED, FAILURES, FRESH_RATE, MAX_STAGE_ITERATIONS, MAX_SWEEPS


@dataclass(slots=True)
class Stages:
    """The stages of one step: its start (t, p, v), and arrays with a row for each stage."""

    system: Index3System
    table: Table
    t: float
    p: np.ndarray
    v: np.ndarray
    h: float
    W: np.ndarray  # accelerations, (s, nv)
    V: np.ndarray = None  # velocities, (s, nv)
    xi: np.ndarray = None  # positions p ⊕ ξ in the chart at p, (s, nx)
    U: np.ndarray = None  # rates of ξ, (s, nx)
    P: list = None  # positions
    rate: float = 0.0  # contraction of Newton's iteration, 0 if one was enough
    iterations: int = 0
    failure: str = ""
    end_matrices: tuple = ()  # M, ∂f/∂v and ∂f/∂p at the last stage, as in Newton's matrix

    def __post_init__(self):
        self.xi = np.zeros((self.table.s, self.system.nx))
        self.failure = "" if self.move() else FAILURES["diverged"]

    @property
    def times(self):
        """The times of the stages."""
        return self.t + self.h * self.table.c

    @np.errstate(over="ignore", invalid="ignore")  # in steps that are too long
    def move(self, dW=0.0) -> bool:
        """Velocities and positions of the accelerations W + dW; returns whether there are any.

        Rates that depend on positions are found by fixed-point iteration, starting from the current ξ.
        """
        system, A, h = self.system, self.table.A, self.h
        self.W = self.W + dW
        self.V = self.v + h * A @ self.W
        for _ in range(MAX_SWEEPS):
            self.P = [system.integrate(self.p, xi) for xi in self.xi]
            self.U = np.array([system.rate(*point) for point in zip(self.times, self.P, self.V, strict=True)])
            if not system.vector_like:
                self.U = np.array([chart_matrix(system, xi) @ rate for xi, rate in zip(self.xi, self.U, strict=True)])
            before, self.xi = self.xi, h * A @ self.U
            if not (moved := largest(self.xi - before) / (1.0 + largest(self.xi))) > 4.0 * EPS:
                break
        return bool(moved < EPS**0.5 and np.isfinite(self.P).all())


class StageNewton:
    """Solves the stage equations of a run, and counts what it evaluates."""

    def __init__(self):
        self.nfev = self.njev = self.nlu = 0

    def solve(self, stages: Stages, weight, tol) -> Stages:
        """Iterate from the accelerations of `stages` to the solution; `failure` says why there is none.

        `weight` are reciprocal tolerances of [ξ | v]; it ends when the remaining increments are estimated below `tol`.
        """
        system, table, h, last, matrix, failure = stages.system, stages.table, stages.h, 0.0, None, "not_converged"
        floor = 20.0 * EPS * table.s**2 / abs(h)
        if stages.failure:
            return stages
        for iteration in range(1, MAX_STAGE_ITERATIONS + 1):
            stages.iterations = iteration
            f, phi, G, J = self._residuals(stages)
            if matrix is None or stages.rate > FRESH_RATE:
                matrix = StageMatrix(stages, f, G, J, slow=matrix is not None)
                self.njev += table.s
                self.nlu += 1
                stages.end_matrices = matrix.at_end
                if matrix.singular:
                    failure = "singular"
                    break
            dP, closing = matrix.solve(f, phi, G, J)
            dV = matrix.velocities(dP)
            size = _size(dP, dV, weight, system)
            if not isfinite(size):
                failure = "not_finite"
                break
            if iteration > 1:
                stages.rate = size / last
            left = size if iteration == 1 else to_come(size, stages.rate)
            before = stages.V
            if not stages.move(table.inverse @ dV / h):
                failure = "diverged"
                break
            reach = largest(stages.P[-1])
            noise = tolerated(stages.rate, iteration, MAX_STAGE_ITERATIONS)
            if min(size, left) <= tol or largest(dV) <= floor * (1.0 + reach):
                return stages
            if noise:
                free, rates = matrix.velocities(dP - closing), per_position(h / table.s**2, tol)
                closed = largest(phi) <= rounding_gap(stages.P[-1], G[-1])
                if is_noise(free, closing, before, stages.v, stages.P[-1], noise, rates, closed):
                    return stages
            if stages.rate > 2.0 and iteration > 2:
                failure = "diverged"
                break
            last = size
        culprit = culprits(system, stages.times[-1], stages.p, stages.v) if failure == "not_finite" else ""
        stages.failure = FAILURES[failure] + culprit
        return stages

    def _residuals(self, stages):
        """f, Φ, G and J of every stage."""
        system = stages.system
        self.nfev += stages.table.s
        points = list(zip(stages.times, stages.P, stages.V, strict=True))
        rows = [system.evaluate(*point, w) for point, w in zip(points, stages.W, strict=True)]
        f, phi, G = (np.array([row[i] for row in rows]) for i in range(3))
        # loops closed to rounding are not closed further: if rows are nearly dependent, the position would move far
        phi[[largest(gap) <= CLOSED * (1.0 + largest(p)) for gap, p in zip(phi, stages.P, strict=True)]] = 0.0
        J = np.array([system.velocity_jacobian(*point, g) for point, g in zip(points, G, strict=True)])
        return f, phi, G, J


class StageMatrix:
    """The matrix of the stage equations in the null space of the constraints, factorised."""

    def __init__(self, stages, f, G, J, slow):
        system, table, h = stages.system, stages.table, stages.h
        s, nv = table.s, system.nv
        self._B, self._h, self._T, self.at_end = table.inverse, h, None, ()
        if not system.vector_like:
            self._T = np.array([chart_matrix(system, xi) for xi in stages.xi])
            self._turn = np.array([system.bracket(rate) for rate in map(system.rate, stages.times, stages.P, stages.V)])
        self._right = [dependent_columns(j) for j in J]
        self._left = [dependent_columns(g.T) for g in G]
        self.singular = any(len(columns) < system.nc for columns in (*self._right, *self._left))
        if self.singular:
            return
        self._blocks = np.zeros((s, nv, s, nv))
        unit = np.eye(s * nv).reshape(s, nv, s * nv)
        dV = self._along(unit).reshape(s, nv, s, nv)  # h dV and h² dW by dP
        dW = np.einsum("ij,jakb->iakb", table.inverse, dV)
        for i, (t, p, v, w) in enumerate(zip(stages.times, stages.P, stages.V, stages.W, strict=True)):
            M, D, K = system.matrices(t, p, v, w)
            if slow:  # the derivative of G λ was neglected at first: without it, Newton is slow
                rows = self._left[i]
                K = K - system.force_gradient(t, p, v, np.linalg.solve(G[i][rows], f[i][rows]))
            self._blocks[i] = np.tensordot(M, dW[i], 1) + h * np.tensordot(D, dV[i], 1)
            self._blocks[i, :, i] += h**2 * K
        self.at_end = M, D, K
        Z, _ = self._null_spaces(J, self._right)
        Y, _ = self._null_spaces(G.swapaxes(1, 2), self._left)
        reduced = np.einsum("iab,iajc,jcd->ibjd", Y, self._blocks, Z)
        size = s * Z.shape[2]
        self._lu, self._pivots, info = dgetrf(reduced.reshape(size, size)) if size else (None, None, 0)
        self.singular = info != 0

    def solve(self, f, phi, G, J):
        """dP of all stages with the constraint directions of this iteration, and its part that closes the loops."""
        Z, N = self._null_spaces(J, self._right)
        Y, _ = self._null_spaces(G.swapaxes(1, 2), self._left)
        closing = -np.einsum("iab,ib->ia", N, phi)
        if not Z.shape[2]:
            return closing, closing
        rhs = -np.einsum("iab,ia->ib", Y, self._h**2 * f + np.einsum("iajc,jc->ia", self._blocks, closing))
        y = dgetrs(self._lu, self._pivots, rhs.ravel())[0]
        return np.einsum("iab,ib->ia", Z, y.reshape(rhs.shape)) + closing, closing

    def velocities(self, dP):
        """dV of all stages, shape (s, nv)."""
        return self._along(dP) / self._h

    def _along(self, dP):
        """h dV_i: Σ_j b_ij dP_j, in a chart with T, its change along the step, and [v, dP]."""
        rates = np.einsum("ij,j...->i...", self._B, dP)
        if self._T is None:
            return rates
        rates = np.einsum("ij,jab,jb...->ia...", self._B, self._T, dP)
        T_rate = np.einsum("ij,jab->iab", self._B, self._T - np.eye(dP.shape[1]))
        rates -= np.einsum("iab,ib...->ia...", T_rate, dP)
        rates = np.einsum("iab,ib...->ia...", np.linalg.inv(self._T), rates)
        return rates + self._h * np.einsum("iab,ib...->ia...", self._turn, dP)

    @staticmethod
    def _null_spaces(J, columns):
        """(Z, N) of every stage: Z spans the null space of J and is 1 in its free columns, J N = 1."""
        s, nc, nv = J.shape
        Z, N = np.zeros((s, nv, nv - nc)), np.zeros((s, nv, nc))
        for i, dependent in enumerate(columns):
            free = np.setdiff1d(np.arange(nv), dependent)
            inverse = np.linalg.inv(J[i][:, dependent])
            N[i, dependent] = inverse
            Z[i, dependent] = -inverse @ J[i][:, free]
            Z[i, free] = np.eye(nv - nc)
        return Z, N


def dependent_columns(J):
    """The columns of J that follow from the others, by complete pivoting; fewer than rows if its rank is smaller."""
    rest, chosen = np.array(J), []
    for _ in range(len(J)):
        row, column = np.unravel_index(np.argmax(np.abs(rest)), rest.shape)
        if not abs(rest[row, column]) > EPS * largest(J):
            break
        chosen.append(int(column))
        rest = rest - np.outer(rest[:, column] / rest[row, column], rest[row])
        rest[row], rest[:, column] = 0.0, 0.0
    return chosen


def _size(dP, dV, weight, system) -> float:
    """Root mean square over the stages of the weighted increments."""
    nx, nv = system.nx, system.nv
    parts = dV * weight[nx:], dP * (weight[:nx] if nx == nv else weight[:nx].max(initial=0.0))
    return float(np.sqrt(sum((part**2).sum() for part in parts) / max(1, dV.size)))
