"""The rows Φ(t, q), J(t, q) of the loops, drives, couplings and constraints of a mechanism.

The rows are defined in :mod:`pinconsist.mechanism.loops`.
"""

from __future__ import annotations

from copy import copy
from functools import cached_property
from typing import Any
from weakref import WeakKeyDictionary, WeakValueDictionary

import numpy as np
import pinocchio as pin

from ..engine.systems import blank_system
from ..errors import InputError
from .breakpoints import NONE, Breakpoints
from .checks import frame_of, workspace
from .custom import Constraint, ConstraintRows
from .joint_constraints import Coupling, CouplingRow, Drive, DriveRow, Rows
from .loops import Length, Loop, Place, Turn, blocks
from .names import velocity_units

TURNING = ("rx", "ry", "rz", "tilt1", "tilt2", "cross")  # rows in rad
POSE = None  # in place of a shift: all six rows of a pose


class Workspace:
    """Pinocchio's data of a model, created on first use and shared by many evaluations; those of `like`, if given."""

    def __init__(self, model, like: Workspace | None = None):
        self.model, self._like = model, like

    @cached_property
    def data(self) -> pin.Data:
        """The data; for large models its creation takes seconds."""
        return workspace(self.model) if self._like is None else self._like.data

    def compiled(self) -> Any:
        """An empty compiled system, to which rows and forces are added: it evaluates many states."""
        return blank_system(self.model, self._like or self)


class Anchors:
    """The anchors of loops in C++: second anchors as seen from the first ones, open or closed."""

    def __init__(self, model, closures):
        self._system = blank_system(model)
        for closure in closures:
            for shift in (np.zeros(3), *np.eye(3)) if closure.turn is not None else (np.zeros(3),):
                self._system.add_anchored(*closure.ends(shift), np.eye(3), True)

    def seen(self, q):
        """Origins of second anchors, with the ends of their axes where rows turn, (n, 3); derivatives (n, 3, nv)."""
        phi, J = self._system.rows(q)
        return phi.reshape(-1, 3), J.reshape(-1, 3, J.shape[1])


def positions(model, points, q) -> np.ndarray:
    """World positions (n, 3) of points, each (joint, xyz in its axes)."""
    system = blank_system(model)
    for joint, xyz in points:
        system.add_anchored(0, np.eye(4), joint, pin.SE3(np.eye(3), np.array(xyz)).homogeneous, np.eye(3), True)
    return system.rows(q)[0].reshape(-1, 3)


def mass_matrix(model, q, owner) -> np.ndarray:
    """M(q), shape (nv, nv), in the compiled workspace of an `owner`."""
    return blank_system(model, owner).dynamics(0.0, q, np.zeros(model.nv))[0]


class LoopRows:
    """The rows of several loops on one model, evaluated together.

    ``labels`` has the loop and row name of each of the ``nc`` rows, and ``slices`` the rows of each loop by its name.
    The boolean arrays (nc,) ``turns`` and ``steady`` mark rows measured in rad, and rows whose J does not depend on
    time. ``moving`` is True if some Φ depends on time.
    """

    def __init__(self, model: pin.Model, loops):
        self.model, self.loops = model, tuple(loops)
        self.labels = [(loop.name, row) for loop in self.loops for row in loop.rows]
        self.nc = len(self.labels)
        self.slices, start = {}, 0
        for loop in self.loops:
            self.slices[loop.name] = slice(start, start := start + len(loop.rows))
        kinds = [next(rows for record, rows in RECORDS.items() if isinstance(loop, record)) for loop in self.loops]
        self.closures = [rows(model, loop) for rows, loop in zip(kinds, self.loops, strict=True)]
        self.turns = np.array([turns for closure in self.closures for turns in closure.turns], dtype=bool)
        self.steady = np.array([closure.steady for closure in self.closures for _ in closure.turns], dtype=bool)
        self.breakpoints = NONE
        self.moving = any(closure.moving for closure in self.closures)
        # Without functions of the user's, which may change.
        self.pure = all(isinstance(loop, Loop | Coupling) for loop in self.loops)
        self._evaluated: dict[tuple, list] = {}  # the last place → Φ and J; the start of a run is evaluated many times
        self.near: dict[tuple, list] = {}  # loop and some of its rows → what KeptRows makes of them
        self.vanishing: dict[tuple, bool] = {}  # indices of rows → whether they vanish everywhere
        self.closed: dict[tuple, tuple] = {}  # the last result of LoopSolver.close
        self.ranked: dict[bytes, Any] = {}  # the last J → the ranking of its rows
        self.levers: list[str] = []  # the doubt about long levers, or "", once it is known
        self.anchors: list[Anchors] = []  # the anchors in C++, once they are needed
        self.structure: list[np.ndarray] = []  # the structure constants of the model, once they are known
        self.assemblies: dict[tuple, Any] = {}  # the last start → its assembly
        self.regular: set[bytes] = set()  # the last place at which the equations have a unique solution

    @staticmethod
    def of(mechanism) -> LoopRows:
        """The rows of a mechanism, with their own workspace; they are built once and then copied."""
        built = LoopRows.built(mechanism)
        rows = copy(built)
        rows.closures = [closure.apart() for closure in built.closures]
        if built.moving:
            rows.breakpoints = Breakpoints()
            rows.breakpoints.add(rows.closures)
        if not built.pure:
            rows._evaluated = {}
        return rows

    def _with(self, loops, others) -> LoopRows:
        """The same rows for `loops`, of which some (their indices) have other numbers."""
        rows = copy(self)
        rows.assemblies = {}  # these depend on inertias, as the next one
        rows.regular = set()
        if others:
            rows.loops, rows.closures = loops, list(self.closures)
            for i in others:
                rows.closures[i] = AnchoredRows(self.model, loops[i])
            changed = {loops[i].name for i in others}
            rows.near = {key: near for key, near in self.near.items() if key[0] not in changed}
            rows._evaluated, rows.vanishing, rows.closed, rows.ranked = {}, {}, {}, {}
            rows.levers, rows.anchors = [], []
        return rows

    @staticmethod
    def built(mechanism) -> LoopRows:
        """The rows from which those of a mechanism are copied: one object for all with the same model and loops."""
        rows = _BUILT.get(mechanism)
        if rows is None:
            like, others = _LIKE.pop(mechanism, (None, ()))
            if like is None:
                key = id(mechanism.model), id(mechanism.loops)  # the rows hold both
                rows = _SHARED.get(key) or _SHARED.setdefault(key, LoopRows(mechanism.model, mechanism.loops))
            else:
                rows = like._with(mechanism.loops, others)
            _BUILT[mechanism] = rows
        return rows

    def continue_in(self, breakpoints) -> None:
        """Evaluate functions of time in the pieces of a run that other rows have begun."""
        self.breakpoints = breakpoints
        for closure in self.closures:
            if closure.moving:
                closure.set_breakpoints(breakpoints)

    @property
    def units(self) -> list[str]:
        """``rad`` or ``m`` for each row; empty for user-defined constraints."""
        units = ["rad" if turns else "m" for turns in self.turns]
        of_joints = velocity_units(self.model) if any(isinstance(loop, Coupling | Drive) for loop in self.loops) else []
        for loop, part in zip(self.loops, self.slices.values(), strict=True):
            if isinstance(loop, Coupling | Drive):
                first = next(iter(loop.shares[0])) if isinstance(loop, Coupling) else loop.joint
                units[part.start] = of_joints[self.model.idx_vs[self.model.getJointId(first)]]
            elif not isinstance(loop, Loop):
                units[part] = [""] * (part.stop - part.start)
        return units

    @property
    def multiplier_units(self) -> list[str]:
        """``N·m`` or ``N`` for the multiplier of each row; empty for user-defined constraints."""
        return [{"rad": "N·m", "m": "N"}.get(unit, "") for unit in self.units]

    def evaluate(self, data: pin.Data, q=None, t: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Φ and J, (nc,) and (nc, nv), after ``pin.computeJointJacobians`` on `data`; anchors need no `q` and `t`."""
        return _stacked([closure.evaluate(data, q, t) for closure in self.closures], self.model.nv)

    def at(self, q, t: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Copies of Φ and J at `q`, without a workspace of Pinocchio."""
        if (known := self._evaluated.get(place := (t, q.tobytes()))) is None:
            self._evaluated.clear()
            known = self._evaluated[place] = [each.copy() for each in self._at(q, t)]
        return known[0].copy(), known[1].copy()

    def _at(self, q, t):
        anchored = [closure for closure in self.closures if isinstance(closure, AnchoredRows)]
        if anchored and not self.anchors:
            self.anchors.append(Anchors(self.model, anchored))
        ends, moving = self.anchors[0].seen(q) if anchored else (None, None)
        parts, first = [], 0
        for closure in self.closures:
            if isinstance(closure, AnchoredRows):
                last = first + (1 if closure.turn is None else 4)
                parts.append(closure.from_ends(ends[first:last], moving[first:last]))
                first = last
            else:
                parts.append(closure.evaluate(None, q, t))
        return _stacked(parts, self.model.nv)

    def time_rate(self, t: float, q=None) -> np.ndarray:
        """Φ_t, shape (nc,)."""
        return np.concatenate([np.zeros(0), *(closure.rate(t, q) for closure in self.closures)])

    def check_derivatives(self, t: float, q) -> None:
        for closure in self.closures:
            closure.check_derivatives(t, q)

    def acceleration_bias(self, data: pin.Data, t: float = 0.0, q=None, v=None) -> np.ndarray:
        """J̇ v and the terms from Φ's dependence on time, shape (nc,), for closed loops.

        Needs ``pin.forwardKinematics(model, data, q, v, 0)`` on `data`.
        """
        return np.concatenate([np.zeros(0), *(closure.acceleration_bias(data, t, q, v) for closure in self.closures)])


class KeptRows:
    """Φ and J of some rows of the loops of a model, for use near closed configurations.

    In a closed loop, the exact Jacobian is a constant linear map of the rows of Pinocchio's own constraints, and Φ has
    the same zeros as this map of Pinocchio's position errors. Newton's iteration therefore has the same solution, and a
    hinge whose tilts are not kept is as cheap as a point. An axis of body 2 is the difference of two points 1 m apart,
    R axis2 = d(at axis2) − d. Distances, drives, couplings and user-defined constraints are evaluated directly.
    `kept` are the ascending indices of the required rows among all `rows`.
    """

    def __init__(self, model: pin.Model, rows: LoopRows, kept):
        self.model, self._closures, kept = model, [], [int(row) for row in kept]
        for closure in rows.closures:
            start = rows.slices[closure.loop.name].start
            if local := [row - start for row in kept if 0 <= row - start < len(closure.turns)]:
                if (parts := rows.near.get(key := (closure.loop.name, *local))) is None:
                    anchored = isinstance(closure, AnchoredRows) and isinstance(closure.place, Place)
                    near = near_closed(closure, local) if anchored else []
                    parts = rows.near[key] = [(shift, matrix, closure.ends(shift)) for shift, matrix in near]
                self._closures.append((closure, local, parts))
        self.difference_step = min((closure.difference_step for closure, _, _ in self._closures), default=np.inf)

    @cached_property
    def pinocchios(self) -> list:
        """Pinocchio's constraint models of each loop, with data and matrices; not used by the compiled system."""
        models = [[(_constraint(self.model, each, at), A) for at, A, _ in parts] for each, _, parts in self._closures]
        return [[(model, model.createData(), A) for model, A in each] for each in models]

    def evaluate(self, data, q, t):
        """Φ and J, shapes (n,) and (n, nv), after ``pin.computeJointJacobians`` on `data`."""
        loops = zip(self._closures, self.pinocchios, strict=True)
        return _stacked([self._rows(*each[:2], own, data, q, t) for each, own in loops], self.model.nv)

    def _rows(self, closure, local, pinocchios, data, q, t):
        if not pinocchios:
            phi, J = closure.evaluate(data, q, t)
            return phi[local], J[local]
        rows = [[A.dot(part) for part in _calculated(self.model, data, *each)] for *each, A in pinocchios]
        return rows[0] if len(rows) == 1 else [one + other for one, other in zip(*rows, strict=True)]

    def hand_over(self, compiled) -> dict[str, list]:
        """Add these rows to the compiled system, which calls Python for kinds that it does not support.

        Returns, for each loop between anchors, the number of each of its parts there, and the distance of its point
        from anchor 2, in the axes of the joint.
        """
        found = {}
        for closure, local, parts in self._closures:
            if isinstance(closure, AnchoredRows):
                points = [ends[3][:3, 3] - closure.place2.translation for *_, ends in parts] or [np.zeros(3)]
                found[closure.loop.name] = [(compiled.number_of_rows + i, point) for i, point in enumerate(points)]
            for i, (_, matrix, ends) in enumerate(parts):
                compiled.add_anchored(*ends, matrix, i == 0)
            if not (parts or closure.hand_over(compiled)):
                compiled.add_python_rows(RowsInPython(closure, self), local, closure.moving, closure.difference_step)
        return found

    @cached_property
    def data(self) -> pin.Data:
        """Pinocchio's data for rows that the compiled system evaluates in Python."""
        return self.model.createData()


class RowsInPython:
    """The rows of one loop, on its own poses, as the compiled system calls them."""

    def __init__(self, closure, rows: KeptRows):
        self._closure, self._rows = closure, rows
        self.rate = closure.rate

    def evaluate(self, q, t):
        """Φ and J."""
        data = self._rows.data
        pin.computeJointJacobians(self._rows.model, data, q)
        return self._closure.evaluate(data, q, t)

    def acceleration_bias(self, t, q, v):
        """The part of the second derivative of Φ that does not depend on accelerations."""
        model, data = self._rows.model, self._rows.data
        pin.computeJointJacobians(model, data, q)
        pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
        return self._closure.acceleration_bias(data, t, q, v)


class AnchoredRows(Rows):
    """One loop on one model: anchors as (joint, placement), and the blocks of its rows; `turn` may be None."""

    def __init__(self, model: pin.Model, loop: Loop):
        self.model, self.loop, who = model, loop, f"loop {loop.name!r}"
        frame1, frame2 = frame_of(model, loop.frame1, who), frame_of(model, loop.frame2, who)
        self.joint1, self.place1 = frame1.parentJoint, frame1.placement * loop.placement1
        self.joint2, self.place2 = frame2.parentJoint, frame2.placement * loop.placement2
        if self.joint1 == self.joint2:
            raise InputError(
                f"{who}: frames {loop.frame1!r} and {loop.frame2!r} are on the same body; "
                "a loop connects two bodies, or a body and the ground"
            )
        self.turns = tuple(row in TURNING for row in loop.rows)
        self.place, self.turn = blocks(loop)
        self._blocks = [block for block in (self.place, self.turn) if block is not None]
        shift = np.zeros(3) if self.turn is None else POSE
        self.constraint = _constraint(model, self, shift)

    @cached_property
    def constraint_data(self):
        """Pinocchio's data of the constraint."""
        return self.constraint.createData()

    def apart(self):
        other = copy(self)
        vars(other).pop("constraint_data", None)
        return other

    def evaluate(self, data, q=None, t=0.0):
        error, jacobian = _calculated(self.model, data, self.constraint, self.constraint_data)
        if self.turn is None:
            return self.place.rows(error, None, jacobian, None)
        pose = self.constraint_data.c1Mc2
        d, R = pose.translation, pose.rotation
        angular = jacobian[3:]  # twist of body 2 relative to body 1, in axes 1, at anchor 1; d is at anchor 2
        return self.rows(d, R, jacobian[:3] - pin.skew(d) @ angular, angular)

    def from_ends(self, ends, moving):
        """Φ and J from the origin of anchor 2 and, if rows turn, the ends of its axes, and their derivatives."""
        d, linear = ends[0], moving[0]
        if self.turn is None:
            return self.place.rows(d, None, linear, None)
        axes = ends[1:] - d
        angular = 0.5 * np.cross(axes[:, :, None], moving[1:] - linear, axis=1).sum(axis=0)
        return self.rows(d, axes.T, linear, angular)

    def rows(self, d, R, linear, angular):
        """Φ and J from the pose of anchor 2 seen from anchor 1 and its derivatives."""
        return _stacked([block.rows(d, R, linear, angular) for block in self._blocks], 0)

    def acceleration_bias(self, data, t=0.0, q=None, v=None):
        p1, R1, v1, w1, a1, b1 = _anchor_motion(self.model, data, self.joint1, self.place1)
        p2, R2, v2, w2, a2, b2 = _anchor_motion(self.model, data, self.joint2, self.place2)
        r, rd, W1 = p2 - p1, v2 - v1, pin.skew(w1)
        rdd = a2 - a1 - pin.skew(b1) @ r - 2 * W1 @ rd + W1 @ (W1 @ r)
        spin, spin_rate = R1.T @ (w2 - w1), R1.T @ (b2 - b1 - W1 @ w2)
        motion = R1.T @ r, R1.T @ (rd - W1 @ r), R1.T @ rdd, R1.T @ R2, spin, spin_rate
        return np.concatenate([block.bias(*motion) for block in self._blocks])

    def by_twist(self, data):
        """J with respect to the relative twist at anchor 2, in the axes of anchor 1; and the poses of both anchors."""
        pose1, pose2 = data.oMi[self.joint1] * self.place1, data.oMi[self.joint2] * self.place2
        gap, unit = pose1.actInv(pose2), np.eye(6)
        return self.rows(gap.translation, gap.rotation, unit[:3], unit[3:])[1], pose1, pose2

    def ends(self, shift=POSE):
        """Anchor 1, and anchor 2 or the point at `shift` from it, in the form of the compiled system."""
        return self.joint1, self.place1.homogeneous, self.joint2, _shifted(self.place2, shift).homogeneous

    def hand_over(self, compiled) -> bool:
        if not isinstance(self.place, Length):
            return False
        compiled.add_distance(*self.ends(), self.place.length)
        return True


def near_closed(closure, local):
    """The rows `local` of a loop as pairs (shift, matrix), whose products are added.

    `matrix` is applied to the position of the point at `shift` from anchor 2 or, if `shift` is POSE, to the pose.
    """
    place, turn, here = closure.place, closure.turn, np.zeros(3)
    n = len(place.directions)
    if turn is None or max(local) < n:
        return [(here, place.directions[local])]
    if not isinstance(turn, Turn):
        shift, ahead, behind = turn.axis2, turn.directions, -turn.directions
    elif n == 3:
        return [(POSE, np.eye(6)[local])]
    else:
        shift, ahead, behind = POSE, np.eye(6)[3:], np.zeros((3, 3))
    matrix = np.vstack((place.directions, behind)), np.vstack((np.zeros((n, ahead.shape[1])), ahead))
    return [(here, matrix[0][local]), (shift, matrix[1][local])]


def _shifted(place, shift):
    """The placement of the point at `shift` from an anchor, or of the anchor itself if `shift` is POSE."""
    return pin.SE3(place.rotation, place.act(shift)) if shift is not POSE and shift.any() else place


def _constraint(model, closure, shift):
    """Pinocchio's constraint between the anchors of a closure: of the pose, or of the point at `shift` from anchor 2.

    The error and the Jacobian of a point, seen from anchor 1, are exact even while the loop is open.
    """
    record = pin.FrameAnchorConstraintModel if shift is POSE else pin.PointAnchorConstraintModel
    return record(model, closure.joint1, closure.place1, closure.joint2, _shifted(closure.place2, shift))


def _calculated(model, data, constraint, constraint_data):
    """Pinocchio's position error and Jacobian of a constraint."""
    constraint.calc(model, data, constraint_data)
    jacobian = constraint.jacobian(model, data, constraint_data)  # a 1-d array if nv = 1
    return constraint_data.constraint_position_error, jacobian.reshape(-1, model.nv)


def _stacked(parts, nv):
    if not parts:
        return np.zeros(0), np.zeros((0, nv))
    if len(parts) == 1:
        return parts[0]
    values, jacobians = zip(*parts, strict=True)
    return np.concatenate(values), np.concatenate(jacobians)


def _anchor_motion(model, data, joint, placement):
    """Position, axes, velocity, spin, classical acceleration and spin rate of an anchor, in world axes."""
    pose, where = data.oMi[joint] * placement, (joint, placement, pin.LOCAL_WORLD_ALIGNED)
    velocity = pin.getFrameVelocity(model, data, *where)
    acceleration = pin.getFrameClassicalAcceleration(model, data, *where)
    return pose.translation, pose.rotation, *velocity.np.reshape(2, 3), *acceleration.np.reshape(2, 3)


_BUILT: WeakKeyDictionary[Any, LoopRows] = WeakKeyDictionary()  # mechanism → rows that are only copied, not evaluated
_LIKE: WeakKeyDictionary[Any, tuple] = WeakKeyDictionary()  # mechanism → rows, and its loops with other numbers
_SHARED: WeakValueDictionary[tuple, LoopRows] = WeakValueDictionary()  # the same by model and loops
RECORDS = {Loop: AnchoredRows, Drive: DriveRow, Coupling: CouplingRow, Constraint: ConstraintRows}
"""Record types among the loops of a mechanism → the class of their rows."""


def rows_with_other_numbers(mechanism, other, loop=None) -> None:
    """Let a mechanism with the same kinematics, except for those of a `loop` (its index), use rows already built."""
    like, others = _LIKE.get(mechanism, (_BUILT.get(mechanism), ()))
    if like is not None:
        _LIKE[other] = like, ({*others, loop} if loop is not None else others)
