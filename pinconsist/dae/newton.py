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

import numpy as np
from scipy.linalg.lapack import dgetrf, dgetrs

from ..errors import SingularSystemError

EPS = np.finfo(float).eps
MAX_ITERATIONS = 10
FRESH_RATE = 0.4  # a slower contraction asks for a new matrix
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
    """The block matrix [[A, -G], [W, 0]], factorised."""

    def __init__(self, A, G, W):
        nv, nc = G.shape
        K = np.zeros((nv + nc, nv + nc), order="F")
        K[:nv, :nv] = A
        K[:nv, nv:] = -G
        K[nv:, :nv] = W
        self.lu, self.pivots, info = dgetrf(K, overwrite_a=1)
        diagonal = np.abs(np.diagonal(self.lu))
        self.singular = info != 0 or not np.isfinite(diagonal).all()

    def solve(self, rhs):
        """K⁻¹ rhs; rhs has shape (nv+nc,) or (nv+nc, columns)."""
        return dgetrs(self.lu, self.pivots, rhs)[0]


class Newton:
    """Solves the steps of one system, and counts the work.

    Parameters
    ----------
    system : Index3System
    corrections : int
        How often to take ρ out of each solution, the every-step correction of :mod:`pinconsist.dae.consistency`:
        once leaves |ρ| times the predictor's error, twice leaves rounding, 0 leaves the raw formula.
    """

    def __init__(self, system, corrections: int):
        self.system, self.corrections = system, corrections
        self.nfev = self.njev = self.nlu = 0

    def attempt(self, t, base, psi, predicted, c, weight_x, weight_v, tol) -> Attempt:
        """Solve one step.

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
        weight_x, weight_v : ndarray
            Reciprocal tolerances of position and velocity; `tol` is compared with root mean squares of weighted
            increments.
        tol : float
            Stop when the remaining error is estimated below this.
        """
        system = self.system
        nx, nv = system.nx, system.nv
        psi_x, psi_v = psi[:nx], psi[nx : nx + nv]
        v, m = predicted[nx : nx + nv].copy(), c * predicted[nx + nv :]
        rhs = np.zeros((nv + system.nc, 2), order="F")
        kkt, last, rate, failure = None, 0.0, 0.0, "Newton did not converge"
        p, xi = system.position(t, base, psi_x, c, v)
        for iteration in range(1, MAX_ITERATIONS + 1):
            a = (v - psi_v) / c
            f, phi, G = system.evaluate(t, p, v, a)
            self.nfev += 1
            if kkt is None or rate > FRESH_RATE:
                A, W = system.linearize(t, p, v, a, m, c)
                kkt = KKT(A, G, W)
                self.njev += 1
                self.nlu += 1
                if kkt.singular:
                    return Attempt(predicted, p, iteration, "the KKT matrix is singular")
            rhs[:nv, 0] = c * f - G @ m
            rhs[nv:, 1] = phi / c
            steps = kkt.solve(rhs)
            v = v - steps[:nv, 0] - steps[:nv, 1]
            m = m - steps[nv:, 0] - steps[nv:, 1]
            p, xi = system.position(t, base, psi_x, c, v)
            # Φ/c carries rounding noise of size eps/c: its increment is judged as the position change it makes
            size_v, size_x = _rms(steps[:nv, 0] * weight_v), abs(c) * _rms(steps[:nv, 1] * weight_x)
            size = size_v + size_x
            if not np.isfinite(size):
                failure = "the residual is not finite"
                break
            rate = size / last if iteration > 1 else 0.0
            settled = size <= tol or (iteration > 1 and rate < 1.0 and size * rate / (1.0 - rate) <= tol)
            if settled or (rate > STAGNANT and self._at_floor(steps, v, m, p, c)):
                return self._finish(t, base, psi_x, p, xi, v, m, c, kkt, iteration)
            if rate > 2.0 and iteration > 2:
                failure = "Newton diverged"
                break
            last = size
        return Attempt(predicted, p, iteration, failure)

    def _at_floor(self, steps, v, m, p, c) -> bool:
        """Whether the increments are what rounding leaves, so that more iterations or a smaller step cannot help."""
        nv = self.system.nv
        scale = np.max(np.abs(v), initial=0.0) + np.max(np.abs(steps[:nv, 0]), initial=0.0)
        moved = abs(c) * np.max(np.abs(steps[:nv, 1]), initial=0.0)
        return (
            np.max(np.abs(steps[:nv, 0]), initial=0.0) <= 1e-9 * scale
            and moved <= 1e4 * EPS * (1.0 + np.max(np.abs(p), initial=0.0))
        )

    def _finish(self, t, base, psi_x, p, xi, v, m, c, kkt, iterations) -> Attempt:
        nv = self.system.nv
        for _ in range(self.corrections if self.system.nc else 0):
            rho = self.system.velocity_residual(t, p, self.system.rate(t, p, v))
            step = kkt.solve(np.concatenate((np.zeros(nv), rho)))
            v, m = v - step[:nv], m - step[nv:]
        return Attempt(np.concatenate((xi, v, m / c)), p, iterations)


def rounding_weights(system, y):
    """Weights and tolerance with which Newton runs down to rounding: increments relative to the state's size."""
    p, v = y[: system.nx], y[system.nx : system.nx + system.nv]
    size_v = np.max(np.abs(v), initial=0.0) or 1.0
    size_x = 1.0 + np.max(np.abs(p), initial=0.0)
    return np.full(system.nx, 1.0 / size_x), np.full(system.nv, 1.0 / size_v), 2.0 * EPS


def solve_acceleration(system, t, p, v):
    """The index-1 equations: acceleration and multiplier of the differential equation itself at a state.

    Solves [[M, -G], [W, 0]] [a; λ] = [-f₀; -γ]; M alone may be singular (massless links).

    Returns
    -------
    a : ndarray, shape (nv,)
    lam : ndarray, shape (nc,)
    """
    f0, _, G = system.evaluate(t, p, v, np.zeros(system.nv))
    A, W = system.linearize(t, p, v, np.zeros(system.nv), np.zeros(system.nc), 0.0)
    kkt = KKT(A, G, W)
    if kkt.singular:
        raise SingularSystemError(f"the equations of motion are singular at t = {t:.6g} ([[M, -G], [W, 0]])")
    x = kkt.solve(np.concatenate((-f0, -system.acceleration_bias(t, p, v))))
    return x[: system.nv], x[system.nv :]


def _rms(x) -> float:
    return float(np.sqrt(x @ x / max(len(x), 1)))
