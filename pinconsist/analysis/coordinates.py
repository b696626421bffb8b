"""The velocity columns that describe what the loops leave free: those of motors first, then those that stay free."""

from functools import partial

import numpy as np
from scipy.linalg import qr

from .._core import load
from .._core.compiled_system import compiled_system
from ..mechanism.rank import HELD, free_motions, null_space
from ..mechanism.system import MechanismSystem
from .following import NUMBERS, Follower
from .variations import step_sizes

SINGULAR = 1e-10  # 1 / (|B| |B⁻¹|) below which a position counts as singular


class Coordinates:
    """Coordinates of the mechanism of a LoopSolver, chosen at a closed `q`, and what depends on the choice.

    ``columns`` are ``n_motors`` independent ones of the columns `motors`, by their numbers ``own``, then the free ones.
    ``p`` are all other columns, as many as there are independent rows.
    """

    def __init__(self, solver, motors, q):
        self._solver, self._motors = solver, motors
        self.system = system = MechanismSystem(solver.mechanism, q, solver.t, solver)
        self.sizes = step_sizes(system, q)
        free = null_space(system.loop_rows(q)[1][system.kept])
        moved = free[motors]
        R, pivots = qr(moved.T, mode="r", pivoting=True) if moved.size else (np.zeros((0, 0)), np.zeros(0, int))
        self.n_motors = np.count_nonzero(np.abs(np.diagonal(R)) > HELD)
        self.own = np.sort(pivots[: self.n_motors])
        rest = free @ null_space(moved[self.own])
        rest[motors] = 0.0
        others = qr(rest.T, mode="r", pivoting=True)[1][: rest.shape[1]] if rest.size else np.zeros(0, int)
        self.columns = np.array([*motors[self.own], *np.sort(others)], dtype=int)
        self.p = np.setdiff1d(np.arange(system.nv), self.columns)
        self._compiled = compiled_system(system) if load()[0] is not None else None
        if self._compiled is not None:
            self.follower = load()[0].ClosureFollower(self._compiled, self.columns.tolist(), self.sizes, list(NUMBERS))
            self.rows = self._compiled.rows
        else:
            self.rows = partial(_rows, system)
            self.follower = Follower(self.rows, system.integrate, self.columns, self.sizes)

    def dynamics(self, t, q, v):
        """M, the inertial forces and weights less τ of the forces, J and J̇ v at a state."""
        if self._compiled is not None:
            return self._compiled.dynamics(t, q, v)
        f, _, G, _ = self.system.evaluate(t, q, v, np.zeros(self.system.nv))
        return self.system.mass_matrix(q), f, G.T, self.system.acceleration_bias(t, q, v)

    def basis(self, J):
        """(Z, B⁻¹): the velocities of unit ones of the coordinates, as columns, shape (nv, n); None where singular."""
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

    def weakest(self, q):
        """(singular values, velocities) of how the motors see what the loops leave free at `q`, the weakest last.

        The values are of an orthonormal basis of the free velocities: 1 where a free motion is one of the motors alone,
        0 where motors stand still in it. The columns of the velocities (nv, n) belong to them.
        """
        free = free_motions(self._solver.rows(q)[1], self._solver.loop_rows.turns)
        _, sizes, Vt = np.linalg.svd(free[self._motors])
        return np.append(sizes, np.zeros(len(Vt) - len(sizes))), free @ Vt.T


def _rows(system, q):
    phi, _ = system.constraint(0.0, q, np.zeros(system.nv))
    return phi, system.evaluate(0.0, q, np.zeros(system.nv), np.zeros(system.nv))[2].T
