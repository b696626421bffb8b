"""Reactions of loops on their bodies: force and moment, torque, and joint forces, from the multipliers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pinocchio as pin

from ..errors import InputError
from .checks import choice, near, read_only
from .checks import name as checked_name
from .custom import Constraint
from .forces.force import ForceRecord, label_of
from .forces.piecewise import Piecewise
from .joint_constraints import JointConstraint
from .loops import Loop
from .mechanism import Mechanism
from .peaks import HasPeaks
from .rank import ROUNDED_ROWS, Ranking
from .rows import LoopRows, Workspace
from .self_stress import (
    JOINT,
    LOOP,
    STRESS_ROUNDING,
    WAYS,
    Member,
    compliances,
    over_samples,
    relaxed,
    sampled,
    self_stress,
    wrenches_of,
)
from .wrenches import Transmission, loop_wrenches

AXES = ("world", "anchor")
JOINT_AXES = ("world", "joint")
LOOP_SHARE = 0.1  # smallest share of a loop in a dependence that it belongs to; unrelated loops of Cassie have 5e-4


def listed(names, most: int = 4) -> str:
    """The first of several names of loops and joints, and how many more there are."""
    more = len(names) - most
    return ", ".join(list(names)[:most]) + (f" and {more} more" if more > 0 else "")


class _Wrench(HasPeaks):
    """What a reaction and a joint force have in common."""

    force: np.ndarray | None
    moment: np.ndarray | None
    not_unique: tuple[str, ...]
    shared_with: tuple[str, ...]

    def _sizes(self) -> list[str]:
        return [
            f"{name} up to {np.linalg.norm(np.atleast_2d(part.T), axis=0).max(initial=0.0):.4g}"
            for name, part in self._parts().items()
            if part is not None
        ]

    def _parts(self) -> dict[str, np.ndarray | None]:
        return {"force [N]": self.force, "moment [N·m]": self.moment}

    def _doubts(self) -> str:
        if not self.not_unique:
            return ""
        found = f"; not unique: {', '.join(self.not_unique)}"
        if not self.shared_with:
            return found
        why = f"rigid bodies do not determine how it shares its load with {listed(self.shared_with)}"
        return f"{found}; {why}: see resultant_force, or pass a compliance={{name: m/N, …}} of each"


@dataclass(frozen=True, eq=False)
class Reaction(_Wrench):
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
        None if the reaction is well determined. Otherwise the loop's rows are independent of the others only because
        numbers in a file are rounded, and this is the degree of independence, from 0 to 1: force, moment and torque are
        then meaningless, but the sum of the joint forces of all loops is not.
    not_unique : tuple of str
        Components in `axes` that equilibrium does not determine because the loop is redundant: ``"force x"`` …
        ``"moment z"``, ``"torque"``, or rows of a constraint. They are those of smallest norm, and would be different
        if the loop were cut elsewhere; the other components are unique. Empty if a `compliance` is given for every item
        that shares the load.
    shared_with : tuple of str
        Loops and joints with which the loop shares a load in these components. Empty if they are not loaded, as
        out of the plane of a planar mechanism.
    resultant_of : tuple of str
        All loops and joints that connect the same two bodies; if there is only this one, those of `shared_with` that
        act on body 2.
    resultant_force, resultant_moment : ndarray, shape (n, 3), or None
        Their total force on body 2, and moment about anchor 2, in `axes`, which are unique; NaN in components that are
        not. None if nothing is shared.
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
    not_unique: tuple[str, ...] = ()
    shared_with: tuple[str, ...] = ()
    resultant_of: tuple[str, ...] = ()
    resultant_force: np.ndarray | None = field(default=None, repr=False)
    resultant_moment: np.ndarray | None = field(default=None, repr=False)
    _at: Callable | None = field(default=None, repr=False)

    def _parts(self):
        return super()._parts() | {"torque [N·m or N]": self.torque}

    def __str__(self):
        size = np.abs(self.joint_forces).max(initial=0.0)
        text = f"{self.kind} {self.loop!r}: {', '.join(self._sizes()) or f'joint forces up to {size:.4g}'}"
        warning = "; not determined: its rows depend on others to"
        text = text if self.dependence is None else f"{text}{warning} {self.dependence:.0e}"
        return text + self._doubts()


@dataclass(frozen=True, eq=False)
class JointForce(_Wrench):
    """The force transmitted by one joint of the tree over a run. Rows are those of the solution; arrays are read-only.

    It balances the child body and all bodies outboard of it: inertial forces, weights, loops and forces on bodies.
    Torques of drives, actuators, springs, damping and friction in joints, and user-defined torques and constraints, act
    in the joints: they are the components along the joint's free axes, less the torque that accelerates a rotor. A free
    joint transmits nothing. If a user-defined force acts on bodies, like that of a floor, the joints between it and the
    ground also carry it; this cannot be taken into account, see ``taken_as_torques``.

    Attributes
    ----------
    joint : str
        Its name.
    axes : str
        ``"world"``, or ``"joint"``: the axes of the joint's frame on the child.
    t : ndarray, shape (n,)
        Times, s.
    force, moment : ndarray, shape (n, 3)
        Force on the child from its parent, N, and moment about the origin of the joint's frame on the child, N·m; the
        parent receives the opposite at the same point.
    not_unique, shared_with, resultant_of, resultant_force, resultant_moment
        As in :class:`Reaction`, for the child, about the same point.
    taken_as_torques : tuple of str
        The user-defined torques and constraints of the mechanism. A :class:`~pinconsist.Wrench` and a
        :class:`~pinconsist.SpringDamper` act at their points.
    """

    joint: str
    axes: str
    t: np.ndarray = field(repr=False)
    force: np.ndarray = field(repr=False)
    moment: np.ndarray = field(repr=False)
    not_unique: tuple[str, ...] = ()
    shared_with: tuple[str, ...] = ()
    resultant_of: tuple[str, ...] = ()
    resultant_force: np.ndarray | None = field(default=None, repr=False)
    resultant_moment: np.ndarray | None = field(default=None, repr=False)
    taken_as_torques: tuple[str, ...] = ()
    _at: Callable | None = field(default=None, repr=False)

    def __str__(self):
        text = f"joint {self.joint!r} of the tree, on its child: {', '.join(self._sizes())}{self._doubts()}"
        if self.taken_as_torques:
            text += f"; {listed(self.taken_as_torques)}: taken for torques in joints, not for forces on bodies"
        return text


@dataclass(frozen=True, eq=False)
class States:
    """The states of a result.

    `motion` returns the velocities and accelerations of some of its rows, and `at` the states at other times, if any.
    """

    mechanism: Mechanism
    t: np.ndarray
    q: np.ndarray
    lam: np.ndarray
    workspace: Workspace
    motion: Callable
    at: Callable[[np.ndarray], States] | None = None

    def transmission(self, rows=slice(None), lam=None) -> Transmission:
        """The wrenches of the tree's joints in some rows, with other multipliers if they are passed."""
        v, a = self.motion(rows)
        lam = self.lam if lam is None else lam
        return Transmission(self.mechanism, self.t[rows], self.q[rows], v, a, lam[rows], self.workspace)


class HasReactions:
    """Base of results that have a ``mechanism``, states ``t``, ``q`` and multipliers ``lam``."""

    mechanism: Mechanism
    t: Any
    q: np.ndarray
    lam: np.ndarray

    def reaction(self, loop: str, *, axes: str = "world", compliance=None) -> Reaction | JointForce:
        """The reaction of a loop on its bodies, one row for each of the n times; one row in an equilibrium.

        `loop` is the name of a loop, drive, coupling or constraint; or of a joint of the tree, for :meth:`joint_force`.
        Force and moment are expressed in `axes`: "world", or "anchor" for those of the loop's anchor 1. `compliance` is
        as in :meth:`Solution.reaction`. Raises InputError for other names and axes.
        """
        return reaction(self._states(), loop, axes, compliance)

    def joint_force(self, joint: str, *, axes: str = "world", compliance=None) -> JointForce:
        """The force and moment that a `joint` of the tree transmits to its child, see :class:`~pinconsist.JointForce`.

        `axes` are "world", or "joint" for those of its frame. `compliance` is as in :meth:`Solution.reaction`. Raises
        InputError for other names and axes.
        """
        return joint_force(self._states(), joint, axes, compliance)

    def _states(self) -> States:
        t, q, lam = np.atleast_1d(self.t), np.atleast_2d(self.q), np.atleast_2d(self.lam)
        v, a = (np.atleast_2d(part) for part in self._motion())
        mechanism = self._scene()
        return States(mechanism, t, q, lam, Workspace(mechanism.model), lambda rows: (v[rows], a[rows]))

    def _scene(self) -> Mechanism:
        """The mechanism with all forces that act."""
        return self.mechanism

    def _motion(self) -> tuple[np.ndarray, np.ndarray]:
        """Velocities and accelerations; at rest by default."""
        still = np.zeros((len(np.atleast_1d(self.t)), self.mechanism.nv))
        return still, still


def reaction(states: States, name: str, axes: str = "world", compliance=None) -> Reaction | JointForce:
    """The reaction of one loop, or what a joint of the tree transmits."""
    mechanism = states.mechanism
    names = [loop.name for loop in mechanism.loops]
    if checked_name(name, "reaction(): the loop or joint") not in names:
        if name in mechanism.joints:
            return joint_force(states, name, axes, compliance)
        _require_no_fixed_joint(mechanism, name)
        others = near(name, (*names, *mechanism.joints))
        others = others or (f"; the loops are {', '.join(names)}" if names else "; it has no loops")
        raise InputError(f"{mechanism.name}: no loop or joint {name!r}{others}")
    axes = _axes("reaction", axes, AXES)
    stress, lam = _distributed(states, compliance)

    def found(states, lam):
        return reactions(mechanism, [name], states.t, states.q, lam, axes, states.workspace)[0]

    doubts = _doubts(states, stress, (LOOP, name), axes, lam)
    return replace(found(states, lam), **doubts, _at=_elsewhere(states, compliance, found))


def joint_force(states: States, name: str, axes: str = "world", compliance=None) -> JointForce:
    """What one joint of the tree transmits."""
    mechanism = states.mechanism
    _require_no_fixed_joint(mechanism, name)
    joint = mechanism.joint_index(name)
    axes = _axes("joint_force", axes, JOINT_AXES)
    stress, lam = _distributed(states, compliance)

    def found(states, lam, transmission=None):
        transmission = transmission or states.transmission(lam=lam)
        wrench = transmission.wrench(joint).reshape(-1, 2, 3)
        if axes == "joint":
            wrench = np.einsum("nji,nkj->nki", transmission.turns[:, joint], wrench)
        force, moment = read_only(wrench[:, 0]), read_only(wrench[:, 1])
        return JointForce(joint=name, axes=axes, t=read_only(states.t), force=force, moment=moment)

    transmission = states.transmission(lam=lam)
    doubts = _doubts(states, stress, (JOINT, name), axes, lam, transmission)
    doubts["taken_as_torques"] = _user_defined(mechanism)
    return replace(found(states, lam, transmission), **doubts, _at=_elsewhere(states, compliance, found))


def _user_defined(mechanism) -> tuple[str, ...]:
    """The names of the forces and constraints that are functions of the user, whose points are not known."""
    laws = [each.force if isinstance(each, Piecewise) else each for each in mechanism.forces]
    constraints = [loop.name for loop in mechanism.loops if isinstance(loop, Constraint)]
    return (*constraints, *(label_of(law) for law in laws if not isinstance(law, ForceRecord)))


def _elsewhere(states: States, compliance, found):
    """A function that returns what `found(states, lam)` is at other times; None if there are no states."""
    if states.at is None:
        return None

    def at(times):
        others = states.at(times)
        return found(others, others.lam if compliance is None else _distributed(others, compliance)[1])

    return at


def _require_no_fixed_joint(mechanism, name):
    """Raise InputError for the name of a fixed joint of the file."""
    if name in mechanism.joints or not mechanism.model.existFrame(str(name), pin.FrameType.FIXED_JOINT):
        return
    frame = mechanism.model.frames[mechanism.model.getFrameId(str(name), pin.FrameType.FIXED_JOINT)]
    body = mechanism.model.names[frame.parentJoint]
    raise InputError(
        f"{mechanism.name}: joint {name!r} is fixed: what it joins is one body with that of "
        f"{f'joint {body!r}' if frame.parentJoint else 'the ground'}, and the force between its links is not known. "
        "Two bodies of the tree that are welded by a loop of kind 'frame' have a reaction"
    )


def _axes(method, axes, known) -> str:
    """Axes from user input: one of those that are known, or Pinocchio's LOCAL and LOCAL_WORLD_ALIGNED, also by name."""
    theirs = dict(zip(("LOCAL_WORLD_ALIGNED", "LOCAL"), known, strict=True))
    axes = theirs.get(str(axes), axes)
    choice(axes, known, f"{method}: axes")
    return axes


def shared_loads(states: States) -> dict[str, tuple[str, ...]]:
    """Loops and joints that share a load in a way that is not unique, and its components in world axes."""
    rows = LoopRows.of(states.mechanism)
    stress = over_samples(rows, states.workspace, states.t, states.q)
    sizes: dict[Member, np.ndarray] = {}
    for each in _loaded(states, rows, stress, states.lam).values():
        for member in each.members:
            parts = each.parts(member, "world")
            sizes[member] = np.maximum(sizes.get(member, parts), parts)
    found = {member[1]: _components(rows, member, parts) for member, parts in sizes.items()}
    return {name: parts for name, parts in found.items() if parts}


def shared_rows(states: States) -> list[int]:
    """Multipliers that are not unique and share a load."""
    rows = LoopRows.of(states.mechanism)
    stress = over_samples(rows, states.workspace, states.t, states.q)
    found = np.zeros(rows.nc, dtype=bool)
    for each in _loaded(states, rows, stress, states.lam).values():
        sizes = np.linalg.norm(each.multipliers, axis=1)
        found |= sizes > STRESS_ROUNDING * sizes.max()
    return np.flatnonzero(found).tolist()


def _distributed(states: States, compliance):
    """The self-stresses at a few rows, and the multipliers; `compliance` determines some of the former."""
    rows, workspace = LoopRows.of(states.mechanism), states.workspace
    stress = over_samples(rows, workspace, states.t, states.q)
    if compliance is None:
        return stress, states.lam
    given = compliances(states.mechanism, compliance)
    if not stress:
        return stress, states.lam
    lam, left = states.lam.copy(), {}
    transmission = states.transmission()
    joints = [name for kind, name in given if kind == JOINT]
    carried = {(JOINT, name): transmission.wrench(states.mechanism.joint_index(name)) for name in joints}
    for i, (t, q) in enumerate(zip(states.t, states.q, strict=True)):
        here = self_stress(rows, workspace, t, q)
        if here is None:
            continue
        wrenches = _on_loops(rows, workspace, t, q, lam[i]) | {member: wrench[i] for member, wrench in carried.items()}
        more, undetermined = relaxed(here, wrenches, given)
        lam[i, : rows.nc] += here.multipliers @ more
        if i in stress and undetermined.size:
            left[i] = here.through(undetermined)
    return left, lam


def _on_loops(rows, workspace, t, q, lam):
    """The wrenches of the loops."""
    found, *_ = wrenches_of(rows, workspace, t, q, lam[: rows.nc, None])
    return {member: wrench[:, 0] for member, wrench in found.items() if member[0] == LOOP}


def _loaded(states, rows, stress, lam):
    """Of the self-stresses at a few rows those along which there is a load."""
    if not stress:
        return {}
    model = rows.model
    transmission = states.transmission(list(stress), lam)
    carried = {(JOINT, model.names[joint]): transmission.wrench(joint) for joint in range(1, model.njoints)}
    found = {}
    for k, (i, each) in enumerate(stress.items()):
        on_loops = _on_loops(rows, states.workspace, states.t[i], states.q[i], lam[i])
        wrenches = on_loops | {member: wrench[k] for member, wrench in carried.items()}
        basis = each.loaded(wrenches)
        if basis.size:
            found[i] = each.through(basis)
    return found


def _components(rows, member, parts) -> tuple[str, ...]:
    """The names of the components of a member that have a part in self-stresses."""
    kind, name = member
    loop = next((each for each in rows.loops if kind == LOOP and each.name == name), None)
    names = WAYS
    if loop is not None and not isinstance(loop, Loop):
        names = ("torque",) if isinstance(loop, JointConstraint) else loop.rows
    return tuple(name for name, part in zip(names, parts, strict=True) if part > STRESS_ROUNDING)


def _doubts(states, stress, member, axes, lam, transmission=None) -> dict[str, Any]:
    """The fields of a reaction or a joint force that say what is not unique, and with whom its load is shared."""
    rows = LoopRows.of(states.mechanism)
    parts = [each.parts(member, axes) for each in stress.values()]
    doubted = _components(rows, member, np.max(parts, axis=0)) if parts else ()
    if not doubted:
        return {}
    loaded = _loaded(states, rows, stress, lam)
    partners: dict[Member, None] = {}
    for each in loaded.values():
        if _components(rows, member, each.parts(member, axes)):
            partners.update(dict.fromkeys(each.partners(member)))
    found: dict[str, Any] = {"not_unique": doubted, "shared_with": tuple(name for _, name in partners)}
    first = next(iter(stress.values()))
    if not partners or member not in first.poses:
        return found
    together = first.parallel(member)
    if len(together) == 1:
        together = (member, *(each for each in partners if first.bodies[member][0] in first.bodies.get(each, ())))
    total = _resultant(states, transmission or states.transmission(lam=lam), member, together, axes)
    for each in loaded.values():
        total[:, each.parts_of_sum(together, member, axes) > STRESS_ROUNDING] = np.nan
    force, moment = read_only(total[:, :3]), read_only(total[:, 3:])
    names = tuple(name for _, name in together)
    return found | {"resultant_of": names, "resultant_force": force, "resultant_moment": moment}


def _resultant(states, transmission, member, together, axes):
    """[force, moment] of several loops and joints on the body of one, about its point, (n, 6)."""
    rows = LoopRows.of(states.mechanism)
    closure = next((each for each in rows.closures if (LOOP, each.loop.name) == member), None)
    if closure is None:
        body = states.mechanism.joint_index(member[1])
        point, turns = transmission.places[:, body], transmission.turns[:, body]
    else:
        body, point = closure.joint2, transmission.anchor(closure)
        turns = transmission.turns[:, closure.joint1] @ closure.place1.rotation
    total = transmission.resultant(together, body, point)
    if axes != "world":
        total = np.einsum("nji,nkj->nki", turns, total.reshape(-1, 2, 3)).reshape(-1, 6)
    return total


def reactions(mechanism: Mechanism, names, t, q, lam, axes: str = "world", workspace=None) -> list[Reaction]:
    """The reactions of several loops at the same states."""
    rows, workspace, out = LoopRows.of(mechanism), workspace or Workspace(mechanism.model), []
    doubtful = undetermined(mechanism, t, q, rows)
    for closure in (each for each in rows.closures if each.loop.name in names):
        loop, its = closure.loop, lam[:, rows.slices[closure.loop.name]]
        anchored = isinstance(loop, Loop)
        wrenches, joint_forces = loop_wrenches(rows, closure, t, q, its, axes, workspace)
        found = Reaction(
            loop=loop.name,
            kind=loop.kind,
            axes=axes,
            t=read_only(t),
            force=read_only(wrenches[:, :3]) if anchored else None,
            moment=read_only(wrenches[:, 3:]) if anchored else None,
            torque=read_only(its[:, 0].copy()) if isinstance(loop, JointConstraint) else None,
            joint_forces=read_only(joint_forces),
            dependence=doubtful.get(loop.name),
        )
        out.append(found)
    return out


def undetermined(mechanism: Mechanism, t, q, rows=None) -> dict[str, float]:
    """Loops whose multipliers are meaningless, with the small relative singular value of their rows.

    This value must be small at all examined times: while a singular configuration is passed, forces are large but real.
    Exactly dependent rows share their load at minimum norm, and are not included.
    """
    rows, samples = rows or LoopRows.of(mechanism), []
    if not rows.nc or not len(t):
        return {}
    for i in sampled(len(t)):
        samples.append(_nearly_dependent(rows, rows.at(q[i], t[i])[1]))
        if not samples[-1]:
            return {}
    return {name: max(each[name] for each in samples) for name in samples[0] if all(name in each for each in samples)}


def _nearly_dependent(rows: LoopRows, J) -> dict[str, float]:
    ranking = Ranking(J, rows.turns)
    if not len(kept := ranking.kept):
        return {}
    scaled = (J / ranking.scales[:, None])[kept]
    if (sizes := np.linalg.svd(scaled, compute_uv=False))[-1] >= ROUNDED_ROWS * sizes[0]:
        return {}
    shares, sizes, _ = np.linalg.svd(scaled)
    found: dict[str, float] = {}
    for k in np.flatnonzero(sizes < ROUNDED_ROWS * sizes[0])[::-1]:
        for name, part in rows.slices.items():
            its = (kept >= part.start) & (kept < part.stop)
            if np.linalg.norm(shares[its, k]) > LOOP_SHARE:
                found.setdefault(name, float(sizes[k] / sizes[0]))
    return found


def not_determined(found: dict[str, float]) -> str:
    ends = dict.fromkeys(f"{end(found.values()):.0e}" for end in (min, max))
    return f"the forces of {', '.join(found)} are not determined: their rows depend on others to {' … '.join(ends)}"
