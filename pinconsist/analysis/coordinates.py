"""Independent coordinates of a closed mechanism, and paths along them within one assembly mode.

The coordinates y are as many velocity columns as the loops leave free: those of the motors first, then others if the
motors leave motions free. The remaining columns p are dependent. Each step of a path is predicted along the tangent,
δp = -B⁻¹ J_y δy with B = J_p, and closed by Newton's method in p. A step is accepted if the prediction is good,
Newton's corrections decrease at once, and det B keeps its sign: det B vanishes in the singular configurations, where
assembly modes meet, and only there. In C++: ``engine/closure.hpp``.
"""

from functools import cached_property

import numpy as np
from scipy.linalg import qr

from ..engine import required
from ..engine.systems import blank_system, compiled_system
from ..mechanism.rank import HELD, free_motions, null_space
from ..mechanism.rows import KeptRows, LoopRows
from ..mechanism.system import MechanismSystem
from .variations import step_sizes

SINGULAR = 1e-10  # 1 / (|B| |B⁻¹|) below which a position counts as singular
LONGEST_MOTION = 0.6  # rad, or lengths of the mechanism: largest motion of a joint in a step
SHORTEST_STEP = 1e-8  # of the coordinates: shortest step, unless it leads away from a singular configuration
OUTWARD = 1e-4  # relative to that: shortest step away from a singular configuration
MISS = 0.25  # relative to the step: largest first correction of the prediction
SHRINK = 0.25  # largest ratio of successive corrections
AIM = 0.5  # relative to MISS: first correction that the next step size aims at
LEAST, FURTHER = 0.1, 4.0  # smallest and largest ratio of successive step sizes
ENOUGH = 3e-9  # rad, or lengths: after such a correction, Newton's error is rounding
CORRECTIONS = 8  # corrections
TRIES = 400  # steps; paths that need more follow a singular configuration
NUMBERS = (LONGEST_MOTION, SHORTEST_STEP, MISS, SHRINK, AIM, LEAST, FURTHER, ENOUGH, CORRECTIONS)


class Coordinates:
    """Coordinates of the mechanism of a LoopSolver, chosen at a closed `q`, and functions that depend on the choice.

    ``columns`` are ``n_motors`` independent columns of `motors`, whose indices among the motors are ``own``, then the
    `free` columns: those that are passed, or else the best ones at `q`. ``p`` are all other columns, as many as there
    are independent rows.
    """

    def __init__(self, solver, motors, q, free=None):
        self._solver, self._motors, self.chosen_at = solver, motors, q
        self.system = system = MechanismSystem(solver.mechanism, q, solver.t, solver)
        self.sizes = step_sizes(system, q)
        motions = null_space(system.loop_rows(q)[1][system.kept])
        moved = motions[motors]
        R, pivots = qr(moved.T, mode="r", pivoting=True) if moved.size else (np.zeros((0, 0)), np.zeros(0, int))
        self.n_motors = np.count_nonzero(np.abs(np.diagonal(R)) > HELD)
        self.own = np.sort(pivots[: self.n_motors])
        if free is None:
            rest = motions @ null_space(moved[self.own])
            rest[motors] = 0.0
            free = qr(rest.T, mode="r", pivoting=True)[1][: rest.shape[1]] if rest.size else np.zeros(0, int)
        self.columns = np.array([*motors[self.own], *np.sort(free)], dtype=int)
        self.p = np.setdiff1d(np.arange(system.nv), self.columns)
        self._compiled = compiled_system(system)
        self.rows = self._compiled.rows

    @cached_property
    def follower(self):
        """The follower of paths along these coordinates."""
        return required().ClosureFollower(self._compiled, self.columns.tolist(), self.sizes, list(NUMBERS))

    def dynamics(self, t, q, v):
        """M, the inertial forces and weights minus τ of the forces, J, and J̇ v at a state."""
        return self._compiled.dynamics(t, q, v)

    def basis(self, J):
        """(Z, B⁻¹), or None if B is singular; columns of Z (nv, n) are velocities for unit coordinate velocities."""
        B = J[:, self.p]
        try:
            inverse = np.linalg.inv(B)
        except np.linalg.LinAlgError:
            return None
        if not np.linalg.norm(B) * np.linalg.norm(inverse) < 1.0 / SINGULAR:
            return None
        Z = np.zeros((J.shape[1], len(self.columns)))
        Z[self.columns, np.arange(len(self.columns))] = 1.0
        Z[self.p] = -inverse @ J[:, self.columns]
        return Z, inverse

    def gap(self, q) -> float:
        """The largest |Φ| of all rows, m or rad."""
        if self.system.dropped_are_zero:
            return float(np.abs(self.rows(q)[0]).max(initial=0.0))
        return float(np.abs(self.system.loop_rows(q)[0]).max(initial=0.0))

    def weakest(self, q, columns=None):
        """(singular values, velocities) of the map from the motions that the loops allow to the motors, smallest last.

        The map is taken in an orthonormal basis of these motions: a value is 1 if the motion consists of motor
        velocities only, and 0 if the motors stand still in it. The columns of the velocities (nv, n) are the singular
        vectors. With `columns`, the map is that to these velocities instead of the motors.
        """
        free = free_motions(self._solver.rows(q)[1], self._solver.loop_rows.turns)
        _, sizes, Vt = np.linalg.svd(free[self._motors if columns is None else columns])
        return np.append(sizes, np.zeros(len(Vt) - len(sizes))), free @ Vt.T


def all_rows_of(mechanism):
    """The compiled rows of all loops, without forces: ``rows(q)`` returns Φ and J, near closed configurations."""
    rows, compiled = LoopRows.of(mechanism), blank_system(mechanism.model)
    KeptRows(rows, np.arange(rows.nc)).hand_over(compiled)
    return compiled
