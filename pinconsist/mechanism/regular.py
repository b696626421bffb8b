"""Whether a mechanism's equations have one solution at a position: drives, massless motions, singular positions."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ..errors import SingularSystemError
from .constraints.rank import independent_rows
from .loop_solver import LoopSolver

NEARBY = 1e-3
"""How far, in rad and m, the rank of the loops is looked at from a position with dependent rows."""
MASSLESS = 1e-14
"""Inertia of a free motion, relative to the largest, below which it counts as none."""


def require_regular(system, q) -> None:
    """Raise SingularSystemError where the equations of a MechanismSystem have no unique solution at `q`.

    There are more drives than free motions; or some motion that the loops allow has no inertia; or `q` is a singular
    position: rows that depend on others here do not in closed configurations nearby, and the motion branches.
    """
    _require_free_drives(system, q)
    free = _null_space(system.loop_rows(q)[1][system.kept])
    inertia, motions = np.linalg.eigh(free.T @ system.mass_matrix(q) @ free)
    weightless = inertia <= MASSLESS * inertia.max(initial=0.0)
    if not weightless.any():
        _require_lasting_rank(system, q, free)
        return
    names = _joints_in(system.mechanism, free @ motions[:, weightless])
    raise SingularSystemError(
        f"{system.mechanism.name}: joints {', '.join(names)} can move without any inertia: the mass matrix is "
        "singular and the loops do not cure it. Give the massless links an inertia, or add rotor inertia, "
        f"mechanism.with_armature({{{names[0]!r}: 1e-6}})",
        names=names,
    )


def _require_free_drives(system, q) -> None:
    rows = system.rows
    drives = [loop.name for loop in rows.loops if loop.kind == "drive"]
    if not drives:
        return
    J = system.loop_rows(q)[1]
    anchored = [row for row, (name, _) in enumerate(rows.labels) if name not in drives]
    if system.nc < len(independent_rows(J[anchored], rows.turns[anchored])) + len(drives):
        raise SingularSystemError(
            f"{system.mechanism.name}: the drives {', '.join(drives)} are more than the loops leave free (or a dead "
            "centre, where they cannot move it): their motions contradict each other. Drive fewer joints",
            names=tuple(drives),
        )


def _require_lasting_rank(system, q, free) -> None:
    if system.dropped_are_zero or not free.size:
        return
    rows, model = system.rows, system.model
    solver, everything = LoopSolver(system.mechanism, system.chosen_at), np.ones(system.nv, dtype=bool)
    rng = np.random.default_rng(0)
    for _ in range(3):
        motion = free @ rng.standard_normal(free.shape[1])
        nearby, _ = solver.close(pin.integrate(model, q, NEARBY * motion / np.linalg.norm(motion)), everything)
        rank = len(independent_rows(system.loop_rows(nearby)[1], rows.turns))
        if rank > system.nc:
            loops = tuple(dict.fromkeys(loop for loop, _ in rows.labels))
            raise SingularSystemError(
                f"{system.mechanism.name}: a singular position: the loops ({', '.join(loops)}) have rank {system.nc} "
                f"here and {rank} nearby, so that the motion branches and the forces are not determined. Start a "
                "little away from it; running through one is no problem",
                names=loops,
            )


def _joints_in(mechanism, motion):
    share = np.abs(motion).max(axis=1)
    least = 0.1 * share.max()
    return tuple(j for j in mechanism.joints if share[mechanism.columns(j)].max(initial=0.0) > least)


def _null_space(J):
    if not len(J):
        return np.eye(J.shape[1])
    _, s, Vt = np.linalg.svd(J)
    return Vt[np.count_nonzero(s > 1e-10 * s[0]) :].T
