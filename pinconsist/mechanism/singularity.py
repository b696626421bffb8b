"""Whether a mechanism's equations have one solution at a position: drives, massless motions, singular positions."""

import numpy as np
import pinocchio as pin
from scipy.linalg import qr

from ..errors import SingularSystemError
from .closing import LoopSolver
from .names import joints_in
from .rank import free_motions, independent_rows, null_space

NEARBY = 1e-3  # rad and m: how far around a position with dependent rows the rank of the loops is checked
HELD = 1e-6  # share of a motor in the free motions below which it cannot move
MASSLESS = 1e-14  # inertia of a free motion, relative to the largest, below which it counts as zero


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
    rank = 0 if system.dropped_are_zero else rank_nearby(system, q, free)
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


def held_motors(mechanism, q) -> list[str]:
    """The motorised joints that the loops, drives apart, do not let move by themselves at a closed configuration."""
    solver = LoopSolver(mechanism.with_loops(*(loop for loop in mechanism.loops if loop.kind != "drive")))
    every = range(mechanism.nv)
    columns = [(column, joint) for joint in mechanism.actuated for column in every[mechanism.columns(joint)]]
    free, able = free_motions(solver.rows(q)[1], solver.loop_rows.turns)[[column for column, _ in columns]], []
    if free.size:
        R, pivots = qr(free.T, mode="r", pivoting=True)
        able = pivots[: np.count_nonzero(np.abs(np.diagonal(R)) > HELD)]
    return list(dict.fromkeys(joint for i, (_, joint) in enumerate(columns) if i not in able))


def rank_nearby(system, q, free) -> int:
    """The highest rank of the loops at three closed configurations near `q`, by motions in the columns `free`, or 0."""
    if not free.size:
        return 0
    solver, rng, highest = LoopSolver(system.mechanism, system.chosen_at), np.random.default_rng(0), 0
    for _ in range(3):
        motion = free @ rng.standard_normal(free.shape[1])
        nearby, _ = solver.close(pin.integrate(system.model, q, NEARBY * motion / np.linalg.norm(motion)))
        highest = max(highest, len(solver.kept(nearby)))
    return highest
