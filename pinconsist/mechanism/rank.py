"""Which constraint rows are independent, what the others depend on, and whether equations have one solution."""

from math import sqrt

import numpy as np
from scipy.linalg.lapack import dgeqp3

from ..errors import SingularSystemError
from .names import joints_in

RANK_TOLERANCE = 1e-8
"""Relative to the largest pivot. Ratios of real robots go down to 1e-5, redundant rows stay below 1e-12."""
ROUNDED = 1e-6  # m or rad: the error of numbers with six digits
NO_LENGTH = 1e-13  # m; rows that are all shorter are rounding
MASSLESS = 1e-14  # inertia of a free motion, relative to the largest, below which it counts as zero
HELD = 1e-6  # share of a motor in the free motions below which it cannot move


def row_scales(J, turns) -> np.ndarray:
    """Natural size of each row: 1 where `turns` (rad), else the largest norm of the rows in m, the loops' size."""
    longest = sqrt(np.einsum("ij,ij->i", J, J).max(where=~turns, initial=0.0))
    return np.where(turns, 1.0, longest) if longest > NO_LENGTH else np.ones(len(J))


class Ranking:
    """The rows of J in the order in which pivoted QR of Jᵀ takes them, and by how much each one is independent.

    `turns` marks the rows in rad; they and the rows in m are brought to one scale first, so that the choice does not
    depend on the size of the mechanism. ``kept`` has the indices, ascending, of a largest set of well-conditioned
    independent rows.
    """

    def __init__(self, J, turns):
        self.scales, self._pivots, self._by = row_scales(J, turns), np.zeros(0, int), np.zeros(0)
        if J.size:  # qr(J.T, mode="r", pivoting=True) checks and copies for longer than it works
            R, pivots, *_ = dgeqp3((J / self.scales[:, None]).T)
            self._pivots, self._by = pivots - 1, np.abs(R.diagonal())
        self._rank = np.count_nonzero(self._by > RANK_TOLERANCE * self._by.max(initial=0.0))
        self.kept = np.sort(self._pivots[: self._rank])

    def weak(self, labels) -> dict[tuple[str, str], float]:
        """The rows that are independent of the others by less than 1e-6, and by how much, m or rad."""
        by = zip(self._pivots.tolist(), self._by[: self._rank].tolist(), strict=False)
        return {labels[row]: size for row, pivot in by if (size := pivot * float(self.scales[row])) < ROUNDED}


def independent_rows(J, turns) -> np.ndarray:
    """Indices, ascending, of a largest set of well-conditioned independent rows of J, see :class:`Ranking`."""
    return Ranking(J, turns).kept


def free_motions(J, turns) -> np.ndarray:
    """Orthonormal basis of the velocities that rows with Jacobian J allow, as columns, shape (nv, n)."""
    return null_space(J[independent_rows(J, turns)])


def null_space(J) -> np.ndarray:
    """Orthonormal basis of the velocities that independent rows J allow, as columns, shape (nv, n)."""
    return np.linalg.svd(J)[2][len(J) :].T if len(J) else np.eye(J.shape[1])


def dependencies(J, kept) -> dict[int, dict[int, float]]:
    """For each dropped row, the kept rows it is a combination of and their coefficients ({} for a zero row)."""
    dropped = [row for row in range(len(J)) if row not in set(kept)]
    if not len(kept):
        return {row: {} for row in dropped}
    shares = np.linalg.lstsq(J[kept].T, J[dropped].T, rcond=None)[0].T
    shares[np.abs(J[dropped]).max(axis=1) <= RANK_TOLERANCE * np.abs(J).max()] = 0.0
    return {
        row: {int(kept[i]): float(share[i]) for i in np.flatnonzero(np.abs(share) > 1e-9)}
        for row, share in zip(dropped, shares, strict=True)
    }


def weak_text(weak) -> str:
    rows = [f"{loop} {row}" for loop, row in list(weak)[:4]] + ["…"] * (len(weak) > 4)
    return f"{', '.join(rows)} are independent of the other rows by {max(weak.values()):.1e} m or rad at most"


def require_nonsingular(system, q) -> None:
    """Raise SingularSystemError where the equations of a MechanismSystem have no unique solution at `q`.

    There are more drives than free motions; or some motion that the loops allow has no inertia; or `q` is a singular
    position: rows that depend on others here do not in closed configurations nearby, and the motion branches.
    """
    rows, name = system.rows, system.mechanism.name
    drives = [loop.name for loop in rows.loops if loop.kind == "drive"]
    others = [row for row, (loop, _) in enumerate(rows.labels) if loop not in drives]
    if drives and system.nc < len(independent_rows(system.loop_rows(q)[1][others], rows.turns[others])) + len(drives):
        raise SingularSystemError(
            f"{name}: the drives {', '.join(drives)} are more than the loops leave free (or a dead centre, where they "
            "cannot move it): their motions contradict each other. Drive fewer joints",
            names=tuple(drives),
        )
    M = system.mass_matrix(q)
    if system.dropped_are_zero:
        inertia = np.linalg.eigvalsh(M)  # that of the motions that the loops leave free is within these bounds
        if inertia[0] > MASSLESS * inertia[-1]:
            return
    free = null_space(system.loop_rows(q)[1][system.kept])
    inertia, motions = np.linalg.eigh(free.T @ M @ free)
    weightless = inertia <= MASSLESS * inertia.max(initial=0.0)
    if weightless.any():
        why = ": the mass matrix is singular and the loops do not make up for it"
        raise without_inertia(system.mechanism, free @ motions[:, weightless], why)
    rank = 0 if system.dropped_are_zero else system.rank_nearby(q, free)
    if rank > system.nc:
        loops = tuple(dict.fromkeys(loop for loop, _ in rows.labels))
        raise SingularSystemError(
            f"{name}: a singular position: the loops ({', '.join(loops)}) have rank {system.nc} here and {rank} "
            "nearby, so that the motion branches and the forces are not determined. Start a little away from it; "
            "running through one is no problem",
            names=loops,
        )


def without_inertia(mechanism, motions, why) -> SingularSystemError:
    """The error about motions, columns (nv, k), that have no inertia; `why` that matters."""
    names = joints_in(mechanism, motions)
    return SingularSystemError(
        f"{mechanism.name}: joints {', '.join(names)} can move without any inertia{why}. Give the massless links an "
        f"inertia, or add rotor inertia, mechanism.with_armature({{{names[0]!r}: 1e-6}})",
        names=names,
    )
