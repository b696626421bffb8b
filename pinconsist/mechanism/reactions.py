"""Reactions of loops on their bodies: force and moment, torque, and joint forces, from the multipliers."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin

from ..errors import InputError
from .checks import near, read_only
from .loops import Loop
from .mechanism import Mechanism
from .rank import Ranking
from .rows import KeptRows, LoopRows, Workspace

AXES = ("world", "anchor")
NEARLY = 2e-5
"""Relative singular value below which rows are independent only because numbers of a file are rounded.

Measured: 4e-6 and 3e-7 at the shins of ``cassie``. The smallest values of well-determined forces are 1.7e-4, at a foot
of ``cassie_reduced``, 4e-4 at a foot of ``cassie_v2``, 7e-4 in ``kangaroo_like`` and 1e-2 in ``digit_like``.
"""
SHARE = 0.1  # smallest share of a loop in a dependence that it belongs to; unrelated loops of Cassie have 5e-4
SAMPLES = 5  # rows of a run at which dependences are searched for


@dataclass(frozen=True, eq=False)
class Reaction:
    """The forces of one loop over a run. Rows are the rows of the solution; arrays are read-only.

    Attributes
    ----------
    loop, kind : str
        Name and kind of the loop.
    axes : str
        ``"world"``, or ``"anchor"``: the axes of anchor 1, in which the loop's rows are written.
    t : ndarray, shape (n,)
        Times, s.
    force, moment : ndarray, shape (n, 3), or None
        Force on body 2 (that of ``frame2``) at anchor 2, N, and moment about it, N·m; the opposite acts on body 1 at
        the same point. None for drives, couplings and user-defined constraints, which have no anchors.
    torque : ndarray, shape (n,), or None
        For a drive, the motor torque on its joint, positive along the joint's velocity, N·m (N if it slides). For a
        coupling, the torque on `joint`; the torque on `other` is -dq_joint/dq_other times it.
    joint_forces : ndarray, shape (n, nv)
        Jᵀλ, the term of the loop on the right-hand side of the equations of motion; for all kinds.
    dependence : float or None
        None if the reaction is well determined. Otherwise the loop's rows are independent of the others' only because
        numbers of a file are rounded, and this is the degree of independence, from 0 to 1: force, moment and torque are
        then meaningless, but the sum of the joint forces of all loops is not.
    """

    loop: str
    kind: str
    axes: str
    t: np.ndarray = field(repr=False)
    force: np.ndarray | None = field(repr=False)
    moment: np.ndarray | None = field(repr=False)
    torque: np.ndarray | None = field(repr=False)
    joint_forces: np.ndarray = field(repr=False)
    dependence: float | None = None

    def __str__(self):
        parts = {"force [N]": self.force, "moment [N·m]": self.moment, "torque [N·m or N]": self.torque}
        largest = [
            f"{name} up to {np.linalg.norm(np.atleast_2d(part.T), axis=0).max(initial=0.0):.4g}"
            for name, part in parts.items()
            if part is not None
        ]
        size = np.abs(self.joint_forces).max(initial=0.0)
        text = f"{self.kind} {self.loop!r}: {', '.join(largest) or f'joint forces up to {size:.4g}'}"
        warning = "; not determined: its rows depend on others to"
        return text if self.dependence is None else f"{text}{warning} {self.dependence:.0e}"


class HasReactions:
    """Base of results that have a ``mechanism``, states ``t``, ``q`` and multipliers ``lam``."""

    mechanism: Mechanism
    t: Any
    q: np.ndarray
    lam: np.ndarray

    def reaction(self, loop: str, *, axes: str = "world") -> Reaction:
        """The reaction of a loop on its bodies, one row for each of the n times; one row in an equilibrium.

        `loop` is the name of a loop, drive, coupling or constraint. Force and moment are expressed in `axes`: "world",
        or "anchor" for those of the loop's anchor 1. Raises InputError for other names and axes.
        """
        states = np.atleast_1d(self.t), np.atleast_2d(self.q), np.atleast_2d(self.lam)
        return reaction(self.mechanism, loop, *states, axes)


def reaction(mechanism: Mechanism, name: str, t, q, lam, axes: str = "world", workspace=None) -> Reaction:
    """The reaction of one loop at given states; `lam`, (n, nc), are the multipliers of all rows."""
    if axes not in AXES:
        raise InputError(f"reaction: axes={axes!r} is not one of {', '.join(map(repr, AXES))}")
    names = [loop.name for loop in mechanism.loops]
    if name not in names:
        others = near(name, names) or (f"; the loops are {', '.join(names)}" if names else "; it has none")
        raise InputError(f"{mechanism.name}: no loop {name!r}{others}")
    return reactions(mechanism, [name], t, q, lam, axes, workspace)[0]


def reactions(mechanism: Mechanism, names, t, q, lam, axes: str = "world", workspace=None) -> list[Reaction]:
    """The reactions of several loops at the same states."""
    rows, workspace, out = LoopRows.of(mechanism), workspace or Workspace(mechanism.model), []
    doubtful = undetermined(mechanism, t, q, workspace.data, rows)
    for closure in (each for each in rows.closures if each.loop.name in names):
        loop, its = closure.loop, lam[:, rows.slices[closure.loop.name]]
        anchored = isinstance(loop, Loop)
        wrenches, joint_forces = _measured(rows, closure, t, q, its, axes, workspace)
        found = Reaction(
            loop=loop.name,
            kind=loop.kind,
            axes=axes,
            t=read_only(t),
            force=read_only(wrenches[:, :3]) if anchored else None,
            moment=read_only(wrenches[:, 3:]) if anchored else None,
            torque=read_only(its[:, 0].copy()) if loop.kind in ("drive", "coupling") else None,
            joint_forces=read_only(joint_forces),
            dependence=doubtful.get(loop.name),
        )
        out.append(found)
    return out


def undetermined(mechanism: Mechanism, t, q, data=None, rows=None) -> dict[str, float]:
    """Loops whose multipliers are meaningless, with the small relative singular value of their rows.

    This value must be small at all examined times: while a singular position is passed, forces are large but real.
    Exactly dependent rows share their load at minimum norm, and are not included.
    """
    data, rows, samples = data or mechanism.model.createData(), rows or LoopRows.of(mechanism), []
    if not rows.nc or not len(t):
        return {}
    for i in dict.fromkeys(k * (len(t) - 1) // (SAMPLES - 1) for k in range(SAMPLES)):
        samples.append(_nearly_dependent(rows, rows.at(data, q[i], t[i])[1]))
        if not samples[-1]:
            return {}
    return {name: max(each[name] for each in samples) for name in samples[0] if all(name in each for each in samples)}


def _nearly_dependent(rows: LoopRows, J) -> dict[str, float]:
    ranking = Ranking(J, rows.turns)
    if not len(kept := ranking.kept):
        return {}
    scaled = (J / ranking.scales[:, None])[kept]
    if (sizes := np.linalg.svd(scaled, compute_uv=False))[-1] >= NEARLY * sizes[0]:
        return {}
    shares, sizes, _ = np.linalg.svd(scaled)
    found: dict[str, float] = {}
    for k in np.flatnonzero(sizes < NEARLY * sizes[0])[::-1]:
        for name, part in rows.slices.items():
            its = (kept >= part.start) & (kept < part.stop)
            if np.linalg.norm(shares[its, k]) > SHARE:
                found.setdefault(name, float(sizes[k] / sizes[0]))
    return found


def not_determined(found: dict[str, float]) -> str:
    ends = dict.fromkeys(f"{end(found.values()):.0e}" for end in (min, max))
    return f"the forces of {', '.join(found)} are not determined: their rows depend on others to {' … '.join(ends)}"


def _measured(rows, closure, t, q, lam, axes, workspace):
    """[force, moment] on body 2, zero without anchors, and Jᵀλ of one loop at several states."""
    anchored, model, twin = isinstance(closure.loop, Loop), rows.model, workspace.compiled()
    if twin is not None:
        own = rows.slices[closure.loop.name]
        KeptRows(model, rows, range(own.start, own.stop)).hand_over(twin)
        joint_forces = twin.residuals(t, q, np.zeros((len(t), model.nv)), lam)[2]
        if not anchored:
            return np.zeros((len(t), 6)), joint_forces
        if not twin.calls_python:  # rows in Python have no wrench there
            return twin.wrenches(t, q, lam, *closure.ends(), axes == "world"), joint_forces
    data, wrenches, joint_forces = workspace.data, np.zeros((len(t), 6)), np.empty((len(t), model.nv))
    for i in range(len(t)):
        pin.computeJointJacobians(model, data, q[i])
        joint_forces[i] = closure.evaluate(data, q[i], t[i])[1].T @ lam[i]
        if anchored:
            J, pose1, _ = closure.by_twist(data)
            turn = pose1.rotation if axes == "world" else np.eye(3)
            wrenches[i] = ((J.T @ lam[i]).reshape(2, 3) @ turn.T).ravel()
    return wrenches, joint_forces
