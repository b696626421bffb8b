"""Independent constraint rows, the dependences of the others, and whether the equations have a unique solution."""

from math import sqrt

import numpy as np

from ..engine.pivots import pivoted
from ..errors import SingularSystemError
from .joint_constraints import Drive
from .names import joints_in

RANK_TOLERANCE = 1e-8
"""Relative to the largest pivot. Independent rows of real robots have at least 1e-5, redundant rows below 1e-12."""
SIX_DIGITS = 1e-6  # m or rad: the error of numbers with six digits
ROUNDING = 1e-11
"""m or rad: if all rows are shorter, they are rounding errors, those of coordinates up to some kilometres."""
MASSLESS = 1e-14  # inertia of a free motion, relative to the largest, below which it counts as zero
ROUNDED_ROWS = 2e-5
"""Relative singular value below which rows are independent only because numbers of a file are rounded.

Measured: 4e-6 and 3e-7 at the shins of ``cassie``. The smallest values of well-determined forces are 1.7e-4, at a foot
of ``cassie_reduced``, 4e-4 at a foot of ``cassie_v2``, 7e-4 in ``kangaroo_like`` and 1e-2 in ``digit_like``.
"""
HELD = 1e-6  # share of a motor in the free motions below which it cannot move


def row_scales(J, turns) -> np.ndarray:
    """Natural size of each row: 1 for rows in rad (`turns`); for rows in m their largest norm, the loops' size."""
    longest = sqrt(np.einsum("ij,ij->i", J, J).max(where=~turns, initial=0.0))
    return np.where(turns, 1.0, longest) if longest > ROUNDING else np.ones(len(J))


class Ranking:
    """The rows of J in the order of a pivoted QR factorisation of Jᵀ, and how independent each one is.

    `turns` marks the rows in rad; they and the rows in m are scaled first, so that the choice does not depend on the
    size of the mechanism. ``kept`` has the ascending indices of a maximal set of well-conditioned independent rows.
    There are none where all rows are rounding errors, like those of the second hinge of a door.
    """

    def __init__(self, J, turns):
        self.scales, self._pivots, self._by = row_scales(J, turns), np.zeros(0, int), np.zeros(0)
        if J.size:
            self._pivots, self._by = pivoted(J / self.scales[:, None])
        self._rank = np.count_nonzero(self._by > max(ROUNDING, RANK_TOLERANCE * self._by.max(initial=0.0)))
        self.kept = np.sort(self._pivots[: self._rank])

    def weak(self, labels) -> dict[tuple[str, str], float]:
        """The rows whose distance from a combination of the others is below 1e-6, and that distance, m or rad."""
        rows = self._pivots[: self._rank]
        sizes = self._by[: self._rank] * self.scales[rows]
        return {labels[row]: size for row, size in zip(rows.tolist(), sizes.tolist(), strict=True) if size < SIX_DIGITS}


def independent_rows(J, turns) -> np.ndarray:
    """Ascending indices of a maximal set of well-conditioned independent rows of J, see :class:`Ranking`."""
    return Ranking(J, turns).kept


def free_motions(J, turns) -> np.ndarray:
    """Orthonormal basis of the velocities that rows with Jacobian J allow, as columns, shape (nv, n)."""
    return null_space(J[independent_rows(J, turns)])


def null_space(J) -> np.ndarray:
    """Orthonormal basis of the velocities that independent rows J allow, as columns, shape (nv, n)."""
    return np.linalg.svd(J)[2][len(J) :].T if len(J) else np.eye(J.shape[1])


def dependencies(J, kept) -> dict[int, dict[int, float]]:
    """For each dropped row, the kept rows that it is a combination of, with coefficients ({} for a zero row)."""
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
    """Raise SingularSystemError if the equations of a MechanismSystem have no unique solution at `q`.

    Either there are more drives than free motions; or some motion that the loops allow has no inertia; or `q` is a
    singular configuration: some rows are dependent here but independent at closed configurations nearby, and the motion
    branches. The last configuration that passed is remembered, as many runs start there.
    """
    known = system.rows.regular
    place = q.tobytes()
    if system.rows.pure and place in known:
        return
    _look_for_singularity(system, q)
    if system.rows.pure:
        known.clear()
        known.add(place)


def _look_for_singularity(system, q) -> None:
    rows, name = system.rows, system.mechanism.name
    drives = [loop.name for loop in rows.loops if isinstance(loop, Drive)]
    others = [row for row, (loop, _) in enumerate(rows.labels) if loop not in drives]
    if drives and system.nc < len(independent_rows(system.loop_rows(q)[1][others], rows.turns[others])) + len(drives):
        raise SingularSystemError(
            f"{name}: the drives {', '.join(drives)} are more than the motions that the loops leave free (or at a dead "
            "centre, where they cannot move the mechanism), so they contradict each other. Drive fewer joints",
            names=tuple(drives),
        )
    M = system.mass_matrix(q)
    if system.dropped_are_zero:
        inertia = np.linalg.eigvalsh(M)  # bounds for the inertias of the free motions
        if inertia[0] > MASSLESS * inertia[-1]:
            return
    free = null_space(system.loop_rows(q)[1][system.kept])
    inertia, motions = np.linalg.eigh(free.T @ M @ free)
    massless = inertia <= MASSLESS * inertia.max(initial=0.0)
    if massless.any():
        why = ": the mass matrix is singular, and the loops allow these motions"
        raise without_inertia(system.mechanism, free @ motions[:, massless], why)
    rank = 0 if system.dropped_are_zero else system.rank_nearby(q, free)
    if rank > system.nc:
        loops = tuple(dict.fromkeys(loop for loop, _ in rows.labels))
        raise SingularSystemError(
            f"{name}: a singular configuration: the loops ({', '.join(loops)}) have rank {system.nc} here and {rank} "
            "nearby, so that the motion branches and the forces are not determined. Start a little away from it; "
            "passing through it during a run is no problem",
            names=loops,
        )


def without_inertia(mechanism, motions, why) -> SingularSystemError:
    """The error for motions without inertia, columns (nv, k); `why` is appended to the message."""
    names = joints_in(mechanism, motions)
    which = f"{{{names[0]!r}: 1e-6}}" if len(names) == 1 else "dict.fromkeys(error.names, 1e-6)"
    return SingularSystemError(
        f"{mechanism.name}: joints {', '.join(names)} can move without any inertia{why}. Give the massless links an "
        f"inertia, or add rotor inertia, mechanism.with_armature({which}), or in a loop file: "
        f"joints: {{{names[0]}: {{armature: 1e-6}}{', …' * (len(names) > 1)}}}",
        names=names,
    )
