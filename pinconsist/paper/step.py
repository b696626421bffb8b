"""One step of BDF on the index-3 equations: Newton's iteration on the visible KKT matrix.

The unknowns of a step are v and λ at the new time; the position follows from p = b ⊕ (ψ_ξ + c U(t, p, v)), and the
acceleration is a = (v - ψ_v)/c. The equations of a step are

    c (f(t, p, v, a) - G λ) = 0,        Φ(t, p)/c = 0        (f = M a + f₀)

and, as ∂p/∂v = c U_v, their matrix is

    K = [ A  -c G ]        A = M + c ∂f/∂v + c² ∂(f - Gλ)/∂p
        [ W    0  ]        W = Φ_p U_v

Once its last columns are divided by c, its condition does not depend on the step size. That of the raw equations in
(p, v, λ) grows like h⁻³.

Rotations: a step uses the chart centred at the predicted position b, into which the past positions are converted. Then
ξ_{n+1} = O(hᵏ⁺¹), and the derivative of the exponential map may be left out without loss of order.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lu_factor, lu_solve

from ..errors import PinconsistError, SingularSystemError
from .formula import derivative_weights, history_weights, prediction_weights

ITERATIONS = 30  # of Newton, at most
CONVERGED = 1e-15  # relative increment that is rounding
STAGNATION = 1e-7  # relative increment below which an iteration that no longer converges is at rounding


@dataclass
class State:
    """A state of a run: time, position, velocity, multipliers; and the factorised K of the step that led to it."""

    t: float
    p: np.ndarray
    v: np.ndarray
    lam: np.ndarray
    factors: tuple | None = None


def kkt_matrix(A, G, W, c: float = 1.0) -> np.ndarray:
    """The matrix K, shape (nv+nc, nv+nc), of A (nv, nv), G (nv, nc) and W (nc, nv)."""
    nc = len(W)
    return np.block(
        [
            [A, -c * G],
            [W, np.zeros((nc, nc))],
        ]
    )


def factorised(K, t):
    """The LU factors of K; SingularSystemError if it has no inverse."""
    if not np.isfinite(K).all():
        raise PinconsistError(f"the equations are not finite at t = {t:.6g}")
    factors = lu_factor(K, check_finite=False)
    if not np.diagonal(factors[0]).all():
        raise SingularSystemError(f"the equations of motion are singular at t = {t:.6g} ([[M, -G], [W, 0]])")
    return factors


def solved(factors, upper, lower):
    """(x, y) with K [x; y] = [upper; lower]."""
    solution = lu_solve(factors, np.concatenate((upper, lower)), check_finite=False)
    return solution[: len(upper)], solution[len(upper) :]


def bdf_step(system, history, h: float, k: int) -> State:
    """The state at the next time by BDF of order k, iterated to rounding, uncorrected.

    Parameters
    ----------
    system : Index3System
    history : sequence of State
        The last states at distance `h`, newest first, at least k.
    h, k : float, int
        Step, s (negative backwards in time), and order.

    Raises
    ------
    PinconsistError
        Newton's iteration does not converge.
    SingularSystemError
        Its matrix is singular.
    """
    t = history[0].t + h
    c = h / derivative_weights(k)[0]
    base, psi_x, v, lam = _prediction(system, history[: k + 1], k)
    psi_v = history_weights(k) @ [each.v for each in history[:k]]
    last = np.inf
    for _ in range(ITERATIONS):
        p, _ = system.position(t, base, psi_x, c, v)
        a = (v - psi_v) / c
        f, phi, G, _ = (np.array(part) for part in system.evaluate(t, p, v, a))
        A = np.empty((system.nv, system.nv))
        W = np.array(system.linearize(t, p, v, a, lam, c, A))
        A -= c**2 * system.force_gradient(t, p, v, lam)
        factors = factorised(kkt_matrix(A, G, W, c), t)
        dv, dlam = solved(factors, c * (f - G @ lam), phi / c)
        v = v - dv
        lam = lam - dlam
        size = _largest(dv) / (1.0 + _largest(v)) + c**2 * _largest(dlam) / (1.0 + c**2 * _largest(lam))
        if size <= CONVERGED or (size <= STAGNATION and size >= 0.5 * last):
            p, _ = system.position(t, base, psi_x, c, v)
            return State(t, p, v, lam, factors)
        last = size
    raise PinconsistError(
        f"Newton's iteration does not converge at t = {t:.6g} with the step {h:.3g} s: take a smaller step"
    )


def _prediction(system, history, k):
    """(chart centre b, ψ_ξ in its chart, predicted v, predicted λ)."""
    weights = prediction_weights(len(history))
    newest = history[0].p
    b = system.integrate(newest, weights @ [system.difference(newest, each.p) for each in history])
    if system.vector_like:
        b = np.zeros(system.nx)  # positions are their own coordinates
    psi_x = history_weights(k) @ [_coordinates(system, b, each.p) for each in history[:k]]
    return b, psi_x, weights @ [each.v for each in history], weights @ [each.lam for each in history]


def _coordinates(system, base, p):
    return p if system.vector_like else system.difference(base, p)


def _largest(x) -> float:
    return np.abs(x).max(initial=0.0)
