"""Scaled modified Newton on the KKT block matrix: what stands between a predictor and a converged step.

Unknowns of one step are v and λ; the position follows from v by p = base ⊕ (ψ_ξ + c U). The residuals

    r₁ = c (f(t, p, v, (v - ψ_v)/c) - G λ),        r₂ = Φ(t, p)/c

belong to the matrix

    K = [ A  -c G ]      A = M + c ∂f/∂v + c² ∂f/∂p
        [ W    0  ]

whose condition, once its last columns are scaled, does not depend on the step size (the raw index-3 matrix grows like
h⁻³); elimination with row pivots does not see the scale of a column.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, sqrt

import numpy as np
from scipy.linalg.lapack import dgesv, dgetrs

from .foresight import CLOSED, HIDDEN, Foresight
from .reuse import Reuse
from .sizes import EPS, largest, rms, weighted_size

MAX_ITERATIONS = 10
CLOSINGS = 4  # of the loops after a step, each a look at the constraint alone
FRESH_RATE = 0.4  # a slower contraction asks for a new and complete matrix
STALE_FACTOR = 0.3  # of the stopping size for a kept matrix: what linear convergence leaves is felt by the multipliers
STAGNATED, LAST = 1e-9, 1e-12  # relative to the velocities: increments that may be noise, and after the last iteration
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
    change : ndarray or None
        y minus its prediction.
    size : float
        :func:`weighted_size` of the change.
    failure : str
        Empty, or why there is no solution.
    """

    y: np.ndarray
    p: np.ndarray
    change: np.ndarray | None = None
    size: float = 0.0
    failure: str = ""


class KKT:
    """The block matrix [[A, -c G], [W, 0]] of one system: workspace, factors, solutions.

    Attributes
    ----------
    A : ndarray
        The upper left block, to be filled before :meth:`solve_new`.
    W : ndarray
        The lower left block that is factorised.
    """

    def __init__(self, nv: int, nc: int):
        # By itself: arithmetic on part of a matrix takes four times as long as copying there.
        self.A = np.zeros((nv, nv))
        self._K = np.zeros((nv + nc, nv + nc), order="F")
        self._upper_left, self._minus_cG, self.W = self._K[:nv, :nv], self._K[:nv, nv:], self._K[nv:, :nv]

    def solve_new(self, G, W, c, rhs):
        """Fill in A, c G and W, factorise and solve as :meth:`solve`; None where the matrix is singular."""
        self._upper_left[:], self._minus_cG[:], self.W[:] = self.A, G * -c, W
        self._lu, self._pivots, x, info = dgesv(self._K, rhs)
        self._c = c
        return x if info == 0 else None

    def solve(self, rhs, c):
        """K⁻¹ rhs with the last factors; rhs has shape (nv+nc,) or (nv+nc, columns).

        With another c than the factors', the unknowns that K multiplies with c G are scaled to it.
        """
        x = dgetrs(self._lu, self._pivots, rhs)[0]
        if c != self._c:
            x[len(self.A) :] *= self._c / c
        return x


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
        self._parts = np.array([[1.0, 1.0], [1.0, 0.0], [0.0, 1.0]])  # of the three solutions in p, and in v and λ
        if not correct:
            self._parts[2, 1] = 0.0
        self._foresight, self._reuse = Foresight(), Reuse(nv)

    def forget(self) -> None:
        """The last steps say nothing of the next: one was rejected, or the run begins anew."""
        self._foresight.forget()
        self._reuse.forget()

    def attempt(self, t, base, psi, predicted, c, weight, tol) -> Attempt:
        """Solve one step.

        One factorisation serves three right-hand sides: (r₁, 0) for the dynamics, (0, r₂) for the constraint, whose
        rounding noise eps/c is judged only by the position change it makes, and (0, ρ) for the correction. What
        :class:`~pinconsist.dae.foresight.Foresight` remembers of the last steps may promise that one iteration is
        enough; then only the constraint is evaluated once more, and closed, or nothing at all. Large systems go on with
        the matrix of an earlier step as long as :class:`~pinconsist.dae.reuse.Reuse` finds that it pays.

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
        system, kkt, foresight, reuse = self.system, self._kkt, self._foresight, self._reuse
        nx, nv = system.nx, system.nv
        psi_x, parts = psi[:nx], self._parts
        parts[1, 0] = 1.0 / c  # the second column is solved for positions, c times the velocities
        if not self.correct:
            parts[1, 1] = parts[1, 0]
        x = predicted[nx:]
        v, lam = x[:nv], x[nv:]
        last, rate, slow = 0.0, 0.0, False
        a = (v - psi[nx : nx + nv]) / c
        p, xi = system.position(t, base, psi_x, c, v)
        stale = reuse.pays(c)
        for iteration in range(1, MAX_ITERATIONS + 1):
            f, phi, G, rho = system.evaluate(t, p, v, a)
            f -= G.dot(lam)
            np.multiply(f, c, self._dynamics)
            self._constraint[:] = phi
            self._hidden[:] = rho
            self.nfev += 1
            was_stale = stale
            if slow or not (stale or iteration > 1):
                W = system.linearize(t, p, v, a, lam, c, kkt.A)
                if slow and not stale:  # the turning of the constraint forces, left out at first, slows Newton down
                    kkt.A -= c**2 * system.force_gradient(t, p, v, lam)
                stale = False
                reuse.made(c)
                self.njev += 1
                self.nlu += 1
                steps = kkt.solve_new(G, W, c, self._rhs)
                if steps is None:
                    return Attempt(predicted, p, failure="the KKT matrix is singular")
            else:
                steps = kkt.solve(self._rhs, c)
            reuse.iterated()
            moves = steps.dot(parts)
            raw = v - moves[:nv, 0]
            p, xi = system.position(t, base, psi_x, c, raw)
            y = np.concatenate((xi, x - moves[:, 1]))
            if iteration == 1:
                change = y - predicted
                size = weighted_size(change, weight, nv)
                if self.correct and not stale and foresight.one_is_enough(size, c, tol):
                    if not foresight.stays_closed(size, c, tol):
                        y, p = self._close(t, base, psi_x, c, p, raw, y, weight, change, size)
                        change = y - predicted
                    return Attempt(y, p, change, size)
            increments = (steps[:nv, :2] * _paired(weight, nx, nv)).ravel("K")
            size = sqrt(increments.dot(increments) / nv)
            if iteration > 1:
                rate = size / last
            if not isfinite(size):
                whose = culprits(system, t, base, v)
                return Attempt(predicted, p, failure=f"the residual is not finite{whose}")
            if iteration == 2 and not stale:
                foresight.measured(rate, c)
            to_come = size if iteration == 1 else size * rate / (1.0 - rate) if rate < 1.0 else np.inf
            settled = min(size, to_come) <= (STALE_FACTOR * tol if stale else tol)
            noise = STAGNATED if rate > STAGNANT else LAST if iteration == MAX_ITERATIONS else 0.0
            if settled or (noise and not stale and _at_floor(steps[:nv], v, psi[nx : nx + nv], p, noise)):
                change = y - predicted
                whole = weighted_size(change, weight, nv)
                # an old matrix takes ρ out only but for a part that is about as large as the rate
                hidden = stale and rate * rms(steps[:nv, 2] * weight[nx:]) > HIDDEN * tol
                closing = rate if iteration > 1 else 1.0
                if self.correct and (hidden or closing * largest(phi) > CLOSED * (1.0 + largest(p))):
                    y, p = self._close(t, base, psi_x, c, p, raw, y, weight, rate=closing)
                    change = y - predicted
                return Attempt(y, p, change, whole)
            if rate > 2.0 and iteration > 2 and not was_stale:  # else a new matrix comes next
                return Attempt(predicted, p, failure="Newton diverged")
            slow = rate > FRESH_RATE or size * rate ** (MAX_ITERATIONS - iteration) > tol
            last = size
            x = x - steps.dot(parts[:, 0])
            v, lam = x[:nv], x[nv:]
            a = (v - psi[nx : nx + nv]) / c
        return Attempt(predicted, p, failure="Newton did not converge")

    def _close(self, t, base, psi_x, c, p, raw, y, weight, change=None, size=0.0, rate=None):
        """(y, p) with the loops closed at the new position and ρ taken out: the dynamics need no second look.

        After one iteration, what its `change`, of weighted `size`, leaves is measured for Foresight; after several, the
        `rate` at which they contracted is known.
        """
        system, foresight, nx, nv = self.system, self._foresight, self.system.nx, self.system.nv
        for _ in range(CLOSINGS):
            v = y[nx : nx + nv]
            phi, rho = system.constraint(t, p, system.rate(t, p, v))
            self._constraint[:], self._hidden[:] = phi, rho
            steps = self._kkt.solve(self._rhs[:, 1:], c)
            self._reuse.iterated()
            gap = largest(phi) / (1.0 + largest(p))
            if rate is None:
                foresight.looked(gap, steps[:nv, 1] * weight[nx:], v * weight[nx:], size, c)
                rate = foresight.closing_rate(size, c, largest(change[:nx]))
            raw = raw - steps[:nv, 0] / c
            p, xi = system.position(t, base, psi_x, c, raw)
            y = np.concatenate((xi, y[nx:] - steps[:, 1]))
            if gap * rate <= CLOSED:
                break
        return y, p


def _paired(weight, nx, nv):
    """(nv, 2): weights of the velocities, and of the positions that the constraint's increments move."""
    if nx == nv:
        return weight.reshape(2, nv)[::-1].T
    return np.column_stack((weight[nx:], np.full(nv, weight[:nx].max(initial=0.0))))


def _at_floor(steps, v, psi_v, p, noise) -> bool:
    """Whether the increments are what rounding leaves, so that more iterations or a smaller step cannot help."""
    step, moved = (largest(steps[:, i]) for i in (0, 1))
    scale = largest(v) + largest(psi_v) + step  # v = ψ_v + c v' may be a small difference of larger numbers
    return step <= noise * scale and moved <= 1e4 * EPS * (1.0 + largest(p))


def culprits(system, t, p, v) -> str:
    """The forces that are not finite at a state, for a message, where the system can tell."""
    tell = getattr(system, "not_finite", None)
    names = tell(t, p, v) if tell else ()
    return f" ({', '.join(map(repr, names))} at t = {t:.9g})" if names else ""


def rounding_weights(system, y):
    """Weight and tolerance with which Newton runs down to rounding: increments relative to the state's size."""
    p, v = y[: system.nx], y[system.nx : system.nx + system.nv]
    size_v = largest(v) or 1.0
    size_x = 1.0 + largest(p)
    return np.concatenate((np.full(system.nx, 1.0 / size_x), np.full(system.nv, 1.0 / size_v))), 2.0 * EPS
