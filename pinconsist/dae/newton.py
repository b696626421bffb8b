"""Scaled Newton iteration on the KKT block matrix: from a predictor to the solution of one step.

Unknowns of one step are v and λ; the position follows from v by p = base ⊕ (ψ_ξ + c U). The residuals

    r₁ = c (f(t, p, v, (v - ψ_v)/c) - G λ),        r₂ = Φ(t, p)

belong, the second divided by c, to the matrix

    K = [ A  -c G ]      A = M + c ∂f/∂v + c² ∂f/∂p
        [ W    0  ]

whose condition, once its last columns are scaled, does not depend on the step size (the raw index-3 matrix grows like
h⁻³); elimination with row pivots is not affected by the scale of a column.

One factorisation serves two right-hand sides: (r₁, 0) for the dynamics, and (0, r₂) for the constraint, whose rounding
noise eps/c is judged only by the change of position that it causes.
"""

from dataclasses import dataclass
from math import isfinite, sqrt

import numpy as np

from .kkt import KKT, columns
from .norms import largest
from .rounding import is_noise, per_position, rounding_gap
from .tuning import FAILURES, FRESH_RATE, LAST, MAX_ITERATIONS, STAGNANT, STAGNATED


@dataclass(slots=True)
class Attempt:
    """Outcome of one call of :meth:`Newton.attempt`: the uncorrected solution, or the reason for its failure."""

    t: float
    c: float  # h/α_k, s
    base: np.ndarray  # centre of the chart
    psi_x: np.ndarray  # ψ of the position
    p: np.ndarray
    xi: np.ndarray  # p = base ⊕ ξ
    v: np.ndarray
    lam: np.ndarray
    kkt: KKT | None = None  # the matrix with which it was found
    rate: float = 1.0  # contraction of the last iteration, 1 if there was only one
    failure: str = ""

    @property
    def y(self):
        """[ξ | v | λ]."""
        return np.concatenate((self.xi, self.v, self.lam))


class Newton:
    """Solves the steps of a run, and counts residual evaluations, Newton matrices and factorisations."""

    def __init__(self):
        self.nfev = self.njev = self.nlu = 0

    def attempt(self, system, t, base, psi, predicted, c, weight, tol) -> Attempt:
        """Solve one step.

        Parameters
        ----------
        system : Index3System
        t, c : float
            The new time, and h/α_k, s.
        base, psi, predicted : ndarray
            Centre of the chart (the predicted position), ψ and the predicted [ξ | v | λ], shape (nx+nv+nc,).
        weight : ndarray, shape (nx+nv,)
            Reciprocal tolerances of position and velocity.
        tol : float
            Stop when the root mean squares of the weighted increments to come are estimated below this.
        """
        nx, nv, nc = system.nx, system.nv, system.nc
        psi_x, psi_v = psi[:nx], psi[nx : nx + nv]
        v, lam = predicted[nx : nx + nv], predicted[nx + nv :]
        p, xi = system.position(t, base, psi_x, c, v)
        last, rate, slow, failure = 0.0, 1.0, False, "not_converged"
        for iteration in range(1, MAX_ITERATIONS + 1):
            a = (v - psi_v) / c
            f, phi, G, _ = system.evaluate(t, p, v, a)
            rhs = columns(nv, nc, (c * (f - G @ lam), 0.0), (0.0, phi))
            self.nfev += 1
            if iteration == 1 or slow:
                A = np.empty((nv, nv))
                W = system.linearize(t, p, v, a, lam, c, A)
                if slow:  # the derivative of G λ was neglected at first: without it, Newton is slow
                    A -= c**2 * system.force_gradient(t, p, v, lam)
                kkt = KKT(A, G, W, c)
                self.njev += 1
                self.nlu += 1
                if kkt.singular:
                    failure = "singular"
                    break
            dynamics, constraint = kkt.solve(rhs).T
            dv, moved = dynamics[:nv], constraint[:nv]
            size = _size(dv * weight[nx:], moved * _moved_weight(weight, nx, nv))
            if not isfinite(size):
                failure = "not_finite"
                break
            rate = size / last if iteration > 1 else rate
            left = size if iteration == 1 else to_come(size, rate)
            before, v, lam = v, v - dv - moved / c, lam - dynamics[nv:] - constraint[nv:] / c
            p, xi = system.position(t, base, psi_x, c, v)
            noise = tolerated(rate, iteration, MAX_ITERATIONS)
            closed = noise and largest(phi) <= rounding_gap(p, G)
            found = min(size, left) <= tol
            if found or (noise and is_noise(dv, moved, before, psi_v, p, noise, per_position(c, tol), closed)):
                return Attempt(t, c, base, psi_x, p, xi, v, lam, kkt, rate)
            if rate > 2.0 and iteration > 2:
                failure = "diverged"
                break
            slow = iteration > 1 and (rate > FRESH_RATE or size * rate ** (MAX_ITERATIONS - iteration) > tol)
            last = size
        why = FAILURES[failure] + (culprits(system, t, base, v) if failure == "not_finite" else "")
        return Attempt(t, c, base, psi_x, p, xi, v, lam, failure=why)


def to_come(size, rate) -> float:
    """The sum of all increments after one of a given size, if each is `rate` times the previous one."""
    return size * rate / (1.0 - rate) if rate < 1.0 else np.inf


def tolerated(rate, iteration, most) -> float:
    """The increments, relative to the velocities, that count as noise if Newton stagnates or at its last iteration."""
    if iteration > 1 and rate > STAGNANT:
        return STAGNATED
    return LAST if iteration == most else 0.0


def _size(*parts) -> float:
    """Root of the sum of the mean squares."""
    return sqrt(sum(part.dot(part) for part in parts) / len(parts[0]))


def _moved_weight(weight, nx, nv):
    """Weights of the positions that the increments of the constraint move, shape (nv,)."""
    return weight[:nx] if nx == nv else weight[:nx].max(initial=0.0)


def culprits(system, t, p, v) -> str:
    """The forces that are not finite at a state, for a message, if the system knows them."""
    names, step = system.not_finite(t, p, v), 1e-9 * (1.0 + largest(p)) / (1.0 + largest(v))
    for side in (step, -step):  # at the edge of a domain, neighbouring states are tried
        names = names or system.not_finite(t, system.integrate(p, side * system.rate(t, p, v)), v)
    return f" ({', '.join(map(repr, names))} at t = {t:.9g})" if names else ""
