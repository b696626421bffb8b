"""Closing loops from nearby and distant guesses, and moving joints while the loops stay closed."""

import numpy as np
import pinocchio as pin

from ..errors import InputError
from .custom import Constraint
from .joint_constraints import Drive
from .lie import difference, integrate
from .rank import HELD, RANK_TOLERANCE, Ranking, free_motions, row_scales
from .rows import LoopRows, Workspace, mass_matrix

EXACT_GAP = 1e-14  # m or rad: rounding, which further iterations would only change
CLOSED_GAP = 1e-10  # m or rad; rounding errors are far below
# Accepted with a warning: redundant loops contradict each other slightly if a file's numbers are rounded.
NEARLY_CLOSED = 1e-8
MAX_ITERATIONS = 200
RESTARTS = 8
MAX_CORRECTIONS = 30
STRIDE = 0.1  # rad or m: step size of the prescribed joints
SHORTEST_STRIDE = STRIDE / 64
MOST_STRIDES = 400
LEAP = 0.5  # rad or m: largest change of another joint in one step
PARTED = 1e-7  # relative to Φ_θ: largest part that no motion can compensate


def steady(loops) -> list:
    """The loops that do not depend on time."""
    return [loop for loop in loops if not (isinstance(loop, Drive) or (isinstance(loop, Constraint) and loop.moving))]


class LoopSolver:
    """Closes the loops of a mechanism at a fixed time. `free` is a mask of the velocities that may change."""

    def __init__(self, mechanism, t: float = 0.0):
        self.t = t
        self.model, self.workspace = mechanism.model, Workspace(mechanism.model)
        self.mechanism, self.loop_rows = mechanism, LoopRows.of(mechanism)
        self.warned = False  # by an assembly

    @property
    def data(self) -> pin.Data:
        """Pinocchio's data."""
        return self.workspace.data

    def rows(self, q):
        """Φ and J at a configuration."""
        return self.loop_rows.at(q, self.t)

    def mass_matrix(self, q):
        """M(q), shape (nv, nv)."""
        return mass_matrix(self.model, q, self.workspace)

    def ranking(self, q) -> Ranking:
        """The independent rows at a configuration."""
        J, ranked = self.rows(q)[1], self.loop_rows.ranked
        if (known := ranked.get(place := J.tobytes())) is None:
            ranked.clear()
            known = ranked[place] = Ranking(J, self.loop_rows.turns)
        return known

    def kept(self, q) -> np.ndarray:
        """Indices of independent rows at a configuration."""
        return self.ranking(q).kept

    def size(self, q) -> float:
        """Largest |Φ|, m or rad."""
        return float(np.abs(self.rows(q)[0]).max(initial=0.0))

    def gaps(self, q) -> dict:
        """Largest |Φ| of each loop, m or rad."""
        phi, _ = self.rows(q)
        return {name: float(np.abs(phi[rows]).max()) for name, rows in self.loop_rows.slices.items()}

    def free_columns(self, held=()) -> np.ndarray:
        """Mask of the velocities that may move when these joints are held."""
        free = np.ones(self.model.nv, dtype=bool)
        for joint in held:
            free[self.mechanism.columns(joint)] = False
        return free

    def close(self, guess, free=None):
        """The best configuration reached from a guess, and the iterations; tries perturbed guesses if it gets stuck."""
        free = self.free_columns() if free is None else free
        closed, place = self.loop_rows.closed, (self.t, guess.tobytes(), free.tobytes())
        known = closed.get(place)
        if known is not None and self.size(known[0]) <= known[2]:  # many runs start from the same guess
            return known[0].copy(), known[1]
        if self.size(guess) <= EXACT_GAP:
            return guess.copy(), 0
        best, total = self._closed(guess, free)
        if (size := self.size(best)) <= NEARLY_CLOSED:
            closed.clear()
            closed[place] = best.copy(), total, size
        return best, total

    def _closed(self, guess, free):
        best, total = self.descend(guess, free)
        rng = np.random.default_rng(0)
        for _ in range(RESTARTS):
            if self.size(best) <= NEARLY_CLOSED:
                break
            nudge = np.where(free, rng.uniform(-0.5, 0.5, self.model.nv), 0.0)
            other, iterations = self.descend(integrate(self.model, guess, nudge), free)
            total += iterations
            if self.size(other) < 0.5 * self.size(best):
                best = other
        return best, total

    def descend(self, q, free=None, enough=0.0):
        """Reduce the gaps, to at most `enough` if possible; return the configuration and the number of iterations.

        Levenberg-Marquardt, dx = -Jᵀ (J Jᵀ + μ 1)⁻¹ Φ with |dx| ≤ 1, and μ ~ |Φ|² near the solution. It needs no mass
        matrix and converges even with redundant rows.
        """
        free = self.free_columns() if free is None else free
        phi, J = self.rows(q)
        value, damping = phi @ phi, 1.0
        for iteration in range(MAX_ITERATIONS):
            if np.max(np.abs(phi), initial=0.0) <= enough or not free.any():
                return q, iteration
            J = np.where(free, J, 0.0)
            mu = damping * min(value, 1e-2)
            dx = -J.T @ np.linalg.lstsq(J @ J.T + mu * np.eye(len(phi)), phi, rcond=1e-14)[0]
            dx *= min(1.0, 1.0 / max(np.linalg.norm(dx), 1e-300))
            new_q = integrate(self.model, q, dx)
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

    def moved(self, q, goal, free):
        """Move the joints that are not free to their values in `goal`, in small steps from a closed configuration.

        The loops are closed at each step by Newton's method, so that the assembly mode stays the same. Returns None if
        the path is blocked: at the end of the workspace, at a singular configuration, or because the loops do not allow
        these joints to move that way together.
        """
        way = np.where(free, 0.0, difference(self.model, q, goal))
        length = np.abs(way).max(initial=0.0)
        if self.size(q) > CLOSED_GAP or not 0.0 < length <= MOST_STRIDES * STRIDE:
            return None
        share, left = min(1.0, STRIDE / length), 1.0
        while left > 0.0:
            share = min(share, left)
            following = self._small_step(q, share * way, free)
            if following is not None:
                q, left = following, left - share
            elif (share := share / 2) * length < SHORTEST_STRIDE:
                return None
        return q

    def _small_step(self, q, step, free):
        """The configuration after a small step of some joints; None if others would jump or the loops do not close."""
        _, J = self.rows(q)
        dx = step - np.linalg.lstsq(np.where(free, J, 0.0), J @ step, rcond=RANK_TOLERANCE)[0]
        if np.abs(dx).max() > LEAP:
            return None
        reached = newton(self.rows, self.model, self.loop_rows.turns, integrate(self.model, q, dx), LEAP, free)
        leaps = reached is not None and np.abs(difference(self.model, q, reached)).max() > LEAP
        return None if leaps else reached


def newton(rows, model, turns, q, longest, free=True, tolerance=RANK_TOLERANCE):
    """The closed configuration reached from a nearby `q` by Gauss-Newton steps; None if they do not converge.

    `rows` is a function q → (Φ, J), `turns` marks its rows in rad, and `longest` bounds the entries of one step.
    Singular values of J below `tolerance`, relative to the largest, count as zero.
    """
    last = np.inf
    for _ in range(MAX_CORRECTIONS):
        phi, J = rows(q)
        scales = row_scales(J, turns)
        size = np.max(np.abs(phi) / scales, initial=0.0)
        if size <= 1e-15 or (size <= tolerance and size > 0.5 * last):  # dependent rows may stay open by this much
            return q
        dq = np.linalg.lstsq(np.where(free, J, 0.0) / scales[:, None], -phi / scales, rcond=tolerance)[0]
        if not (np.isfinite(dq).all() and np.max(np.abs(dq) / longest) < 1.0):
            return None
        q, last = integrate(model, q, dq), size
    return None


def held_motors(mechanism, q) -> list[str]:
    """The motorised joints that cannot move independently at a closed configuration; drives are not considered."""
    from scipy.linalg import qr

    solver = LoopSolver(mechanism.with_loops(*(loop for loop in mechanism.loops if not isinstance(loop, Drive))))
    every = range(mechanism.nv)
    columns = [(column, joint) for joint in mechanism.actuated for column in every[mechanism.columns(joint)]]
    free, able = free_motions(solver.rows(q)[1], solver.loop_rows.turns)[[column for column, _ in columns]], []
    if free.size:
        R, pivots = qr(free.T, mode="r", pivoting=True)
        able = pivots[: np.count_nonzero(np.abs(np.diagonal(R)) > HELD)]
    return list(dict.fromkeys(joint for i, (_, joint) in enumerate(columns) if i not in able))


def check_closing(name, left, rate) -> None:
    """Raise InputError if varying a parameter opens the loops: no motion compensates `left`, a part of their `rate`."""
    if np.abs(left).max(initial=0.0) > PARTED * np.abs(rate).max(initial=1e-3):
        raise InputError(
            f"the parameter {name!r} cannot vary alone, because the loops would open. The lengths of an "
            "overconstrained loop depend on each other; vary them together, by one parameter of build()"
        )
