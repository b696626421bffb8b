"""The solver that closes loops.

Levenberg-Marquardt on the configuration manifold, dx = -Jᵀ (J Jᵀ + μ 1)⁻¹ Φ with |dx| ≤ 1 and μ ~ |Φ|² near the end;
it needs no mass matrix and does not mind redundant rows.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from .constraints.loops import LoopRows

CLOSED = 1e-10  # m or rad; what rounding leaves is far below
MAX_ITERATIONS = 200
RESTARTS = 8
STRIDE = 0.1  # rad or m, of the joints that are led, in one step
SHORTEST = STRIDE / 64
MOST_STRIDES = 400
LEAP = 0.5  # rad or m: no other joint moves farther in one step
CORRECTIONS = 6  # of Newton in one step; more mean that it is not near
REGULAR = 1e-8  # singular values of J below it, relative to the largest, count as none


class LoopSolver:
    """Levenberg-Marquardt on the loops of one mechanism."""

    def __init__(self, mechanism, t: float = 0.0):
        self.t = t
        self.model, self.data = mechanism.model, mechanism.model.createData()
        self.mechanism, self.loop_rows = mechanism, LoopRows(mechanism.model, mechanism.loops)

    def rows(self, q):
        pin.computeJointJacobians(self.model, self.data, q)
        phi, J = self.loop_rows.evaluate(self.data, q, self.t)
        return np.array(phi), np.array(J)

    def size(self, q) -> float:
        return float(np.max(np.abs(self.rows(q)[0]), initial=0.0))

    def gaps(self, q) -> dict:
        phi, _ = self.rows(q)
        return {name: float(np.abs(phi[rows]).max()) for name, rows in self.loop_rows.slices.items()}

    def free_columns(self, names) -> np.ndarray:
        """Mask of the velocities that may move."""
        free = np.ones(self.model.nv, dtype=bool)
        for joint in names:
            free[self.mechanism.columns(joint)] = False
        return free

    def close(self, guess, free):
        """The best configuration reached from the guess, and the iterations; a few nudged starts where it sticks."""
        best, total = self._descend(guess, free)
        rng = np.random.default_rng(0)
        for _ in range(RESTARTS):
            if self.size(best) <= CLOSED:
                break
            nudge = np.where(free, rng.uniform(-0.5, 0.5, self.model.nv), 0.0)
            other, iterations = self._descend(pin.integrate(self.model, guess, nudge), free)
            total += iterations
            if self.size(other) < 0.5 * self.size(best):
                best = other
        return best, total

    def led(self, q, goal, free):
        """From a closed configuration to one where the joints that are not free stand as in `goal`, in small steps.

        Each step is closed by Newton, so that the mode of assembly stays what it is. None where the way is blocked: by
        an end of reach, a singular position, or joints that the loops do not let go that way together.
        """
        way = np.where(free, 0.0, pin.difference(self.model, q, goal))
        length = np.abs(way).max(initial=0.0)
        if self.size(q) > CLOSED or not 0.0 < length <= MOST_STRIDES * STRIDE:
            return None
        share, left = min(1.0, STRIDE / length), 1.0
        while left > 0.0:
            share = min(share, left)
            following = self._followed(q, share * way, free)
            if following is not None:
                q, left = following, left - share
            elif (share := share / 2) * length < SHORTEST:
                return None
        return q

    def _followed(self, q, step, free):
        """The other joints follow a small step of some; None where they would leap, or do not close."""
        start, (_, J) = q, self.rows(q)
        dx = step + self._correction(J, J @ step, free)
        for _ in range(CORRECTIONS):
            if np.abs(dx).max() > LEAP:
                return None
            q = pin.integrate(self.model, q, dx)
            phi, J = self.rows(q)
            if np.max(np.abs(phi), initial=0.0) <= CLOSED:
                return q if np.abs(pin.difference(self.model, start, q)).max() <= LEAP else None
            dx = self._correction(J, phi, free)
        return None

    def _correction(self, J, phi, free):
        """The smallest motion of the free joints that takes Φ away."""
        return -np.linalg.lstsq(np.where(free, J, 0.0), phi, rcond=REGULAR)[0]

    def _descend(self, q, free):
        phi, J = self.rows(q)
        value, damping = phi @ phi, 1.0
        for iteration in range(MAX_ITERATIONS):
            if value == 0.0 or not free.any():
                return q, iteration
            J = np.where(free, J, 0.0)
            mu = damping * min(value, 1e-2)
            dx = -J.T @ np.linalg.lstsq(J @ J.T + mu * np.eye(len(phi)), phi, rcond=1e-14)[0]
            dx *= min(1.0, 1.0 / max(np.linalg.norm(dx), 1e-300))
            new_q = pin.integrate(self.model, q, dx)
            new_phi, new_J = self.rows(new_q)
            new_value = new_phi @ new_phi
            if new_value < value:
                improved = value - new_value
                q, phi, J, value, damping = new_q, new_phi, new_J, new_value, max(damping / 4, 1e-6)
                if np.max(np.abs(phi)) < 1e-15 or improved < 1e-12 * value:
                    return q, iteration + 1
            elif np.max(np.abs(phi)) < 1e-13 or damping > 1e12:
                return q, iteration + 1
            else:
                damping = max(damping * 8, 1e-3)
        return q, MAX_ITERATIONS
