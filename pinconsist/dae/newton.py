"""Scaled modified Newton on the KKT block matrix: what stands between a predictor and a converged step.

Unknowns of one step are v and m = c λ; the position follows from v by p = base ⊕ (ψ_ξ + c U). The residuals

    r₁ = c f(t, p, v, (v - ψ_v)/c) - G m,        r₂ = Φ(t, p)/c

belong to the matrix

    K = [ A  -G ]      A = M + c ∂f/∂v + c² ∂f/∂p
        [ W   0 ]

whose condition does not depend on the step size (the raw index-3 matrix grows like h⁻³).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, sqrt

import numpy as np
from scipy.linalg.lapack import dgetrf, dgetrs

from ..errors import PinconsistError, SingularSystemError

EPS = np.finfo(float).eps
MAX_ITERATIONS = 10
FRESH_RATE = 0.4  # a slower contraction asks for a new and complete matrix
TRUST = 10  # steps for which a measured contraction is believed
STAGNANT = 0.7  # and a slower one than this, close to the solution, is rounding


@dataclass(slots=True)
class Attempt:
    """Outcome of one call of :meth:`Newton.attempt`.

    Attributes
    ----------
    y : ndarray
        [ξ | v | λ] at the new time, ξ in the chart at `base`; corrected where asked.
    p : ndarray
        The position itself.
    failure : str
        Empty, or why there is no solution.
    """

    y: np.ndarray
    p: np.ndarray
    iterations: int
    failure: str = ""


class KKT:
    """The block matrix [[A, -G], [W, 0]] of one system: workspace, factors, solutions.

    Attributes
    ----------
    A : ndarray
        The upper left block, to be filled before :meth:`factorise`.
    """

    def __init__(self, nv: int, nc: int):
        self.A = np.zeros((nv, nv))
        self._K = np.zeros((nv + nc, nv + nc), order="F")
        self._A, self._minus_G, self._W = self._K[:nv, :nv], self._K[:nv, nv:], self._K[nv:, :nv]

    def factorise(self, G, W) -> bool:
        """Fill in G and W and factorise; False where the matrix is singular."""
        self._A[:] = self.A
        np.negative(G, out=self._minus_G)
        self._W[:] = W
        self._lu, self._pivots, info = dgetrf(self._K)
        return info == 0

    def solve(self, rhs):
        """K⁻¹ rhs; rhs has shape (nv+nc,) or (nv+nc, columns)."""
        return dgetrs(self._lu, self._pivots, rhs)[0]


class Newton:
    """Solves the steps of one system, and counts the work.

    Parameters
    ----------
    system : Index3System
    correct : bool
        Take the hidden velocity residual ρ out of each solution: the every-step correction of
        :mod:`pinconsist.dae.consistency`.
    """

    def __init__(self, system, correct: bool):
        self.system, self.correct = system, correct
        self.nfev = self.njev = self.nlu = 0
        nv, nc = system.nv, system.nc
        self._kkt = KKT(nv, nc)
        self._rhs = np.zeros((nv + nc, 3), order="F")
        self._dynamics, self._constraint, self._hidden = self._rhs[:nv, 0], self._rhs[nv:, 1], self._rhs[nv:, 2]
        self._raw = np.array([1.0, 1.0, 0.0])
        self._contraction, self._measured_at, self._trust = 1.0, 1.0, 0

    def attempt(self, t, base, psi, predicted, c, weight, tol) -> Attempt:
        """Solve one step.

        One factorisation serves three right-hand sides: (r₁, 0) for the dynamics, (0, r₂) for the constraint, whose
        rounding noise eps/c is judged only by the position change it makes, and (0, ρ) for the correction. Where the
        contraction measured lately promises that one iteration is enough for the dynamics, only the constraint is
        evaluated once more, and closed.

        Parameters
        ----------
        t : float
            The new time, s.
        base : ndarray
            Centre of the chart (the predicted position).
        psi, predicted : ndarray
            ψ and the predicted [ξ | v | λ], shape (nx+nv+nc,).
        c : float
            h/α_k, s.
        weight : ndarray, shape (nx+nv,)
            Reciprocal tolerances of position and velocity.
        tol : float
            Stop when the root mean squares of the weighted increments to come are estimated below this.
        """
        system, kkt = self.system, self._kkt
        nx, nv = system.nx, system.nv
        psi_x, psi_v = psi[:nx], psi[nx : nx + nv]
        weights = _paired(weight, nx, nv)
        raw = self._raw
        raw[1] = 1.0 / c  # the second column is solved for positions, c times the velocities
        x = predicted[nx:].copy()
        v, m = x[:nv], x[nv:]
        m *= c
        last, rate, slow = 0.0, 0.0, False
        p, xi = system.position(t, base, psi_x, c, v)
        for iteration in range(1, MAX_ITERATIONS + 1):
            a = v - psi_v
            a /= c
            f, phi, G, rho = system.evaluate(t, p, v, a)
            np.multiply(f, c, out=self._dynamics)
            self._dynamics -= G.dot(m)
            self._constraint[:] = phi
            self._hidden[:] = rho
            self.nfev += 1
            if iteration == 1 or slow:
                W = system.linearize(t, p, v, a, m, c, kkt.A)
                if slow:  # the turning of the constraint forces, left out at first, is what slows Newton down
                    kkt.A -= c * system.force_gradient(t, p, v, m)
                self.njev += 1
                self.nlu += 1
                if not kkt.factorise(G, W):
                    return Attempt(predicted, p, iteration, "the KKT matrix is singular")
            steps = kkt.solve(self._rhs)
            before, x = x, x - steps.dot(raw)
            v, m = x[:nv], x[nv:]
            sizes = steps[:nv, :2] * weights
            sizes = sizes.ravel("K")
            size = sqrt(sizes.dot(sizes) / nv)
            if not isfinite(size):
                return Attempt(predicted, p, iteration, "the residual is not finite")
            p, xi = system.position(t, base, psi_x, c, v)
            if iteration == 1 and self._is_enough(size, c, tol):
                return self._close(t, base, psi_x, c, p, x)
            if iteration > 1:
                rate = size / last
            if iteration == 2:
                self._contraction = max(rate, 0.3 * self._contraction)
                self._measured_at, self._trust = c, TRUST
            settled = size <= tol or (iteration > 1 and rate < 1.0 and size * rate / (1.0 - rate) <= tol)
            if settled or (rate > STAGNANT and _at_floor(steps[:nv], v, p)):
                if self.correct:  # in place of W⁻¹Φ/c the step that leaves ρ = 0
                    x = before - steps.dot(_CORRECTED)
                x[nv:] /= c
                return Attempt(np.concatenate((xi, x)), p, iteration)
            if rate > 2.0 and iteration > 2:
                return Attempt(predicted, p, iteration, "Newton diverged")
            slow = rate > FRESH_RATE or size * rate ** (MAX_ITERATIONS - iteration) > tol
            last = size
        return Attempt(predicted, p, iteration, "Newton did not converge")

    def _is_enough(self, size, c, tol) -> bool:
        """Whether the contraction, which grows like c², promises that the first increment was the last that counts."""
        self._trust -= 1
        return self.correct and self._trust >= 0 and self._contraction * (c / self._measured_at) ** 2 * size <= tol

    def _close(self, t, base, psi_x, c, p, x) -> Attempt:
        """Close the loops at the new position and take ρ out: the dynamics need no second look."""
        system, nv = self.system, self.system.nv
        self._constraint[:], self._hidden[:] = system.constraint(t, p, system.rate(t, p, x[:nv]))
        steps = self._kkt.solve(self._rhs[:, 1:])
        p, xi = system.position(t, base, psi_x, c, x[:nv] - steps[:nv, 0] / c)
        x -= steps[:, 1]
        x[nv:] /= c
        return Attempt(np.concatenate((xi, x)), p, 1)


_CORRECTED = np.array([1.0, 0.0, 1.0])


def _paired(weight, nx, nv):
    """(nv, 2): weights of the velocities, and of the positions that the constraint's increments move."""
    if nx == nv:
        return weight.reshape(2, nv)[::-1].T
    return np.column_stack((weight[nx:], np.full(nv, weight[:nx].max(initial=0.0))))


def _at_floor(steps, v, p) -> bool:
    """Whether the increments are what rounding leaves, so that more iterations or a smaller step cannot help."""
    step, moved = (np.max(np.abs(steps[:, i]), initial=0.0) for i in (0, 1))
    scale = np.max(np.abs(v), initial=0.0) + step
    return step <= 1e-9 * scale and moved <= 1e4 * EPS * (1.0 + np.max(np.abs(p), initial=0.0))


def rounding_weights(system, y):
    """Weight and tolerance with which Newton runs down to rounding: increments relative to the state's size."""
    p, v = y[: system.nx], y[system.nx : system.nx + system.nv]
    size_v = np.max(np.abs(v), initial=0.0) or 1.0
    size_x = 1.0 + np.max(np.abs(p), initial=0.0)
    return np.concatenate((np.full(system.nx, 1.0 / size_x), np.full(system.nv, 1.0 / size_v))), 2.0 * EPS


def solve_acceleration(system, t, p, v):
    """The index-1 equations: acceleration and multiplier of the differential equation itself at a state.

    Solves [[M, -G], [W, 0]] [a; λ] = [-f₀; -γ]; M alone may be singular (massless links).

    Returns
    -------
    a : ndarray, shape (nv,)
    lam : ndarray, shape (nc,)
    """
    f0, _, G, _ = system.evaluate(t, p, v, np.zeros(system.nv))
    kkt = KKT(system.nv, system.nc)
    W = system.linearize(t, p, v, np.zeros(system.nv), np.zeros(system.nc), 0.0, kkt.A)
    rhs = -np.concatenate((f0, system.acceleration_bias(t, p, v)))
    if not np.isfinite(rhs).all():
        raise PinconsistError(
            f"the equations of motion are not finite at t = {t:.6g}: "
            "a force or a user's function returns NaN or infinity"
        )
    if not kkt.factorise(G, W):
        raise SingularSystemError(f"the equations of motion are singular at t = {t:.6g} ([[M, -G], [W, 0]])")
    x = kkt.solve(rhs)
    return x[: system.nv], x[system.nv :]
