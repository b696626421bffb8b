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
from .joint_constraints import Coupling, CouplingRow, Drive, DriveRow, JointConstraint, Rows
from .loops import LOOP_KINDS, Loop, Position, RotationVector
from .names import velocity_units

POSE = None  # in place of a shift: all six rows of a pose
HERE = np.zeros(3)


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
        self._evaluated: dict[tuple, tuple] = {}  # the last place → Φ and J; the start of a run is evaluated many times
        self.near: dict[tuple, list] = {}  # loop and some of its rows → what KeptRows makes of them
        self.vanishing: dict[tuple, bool] = {}  # indices of rows → whether they vanish everywhere
        self.closed: dict[tuple, tuple] = {}  # the last result of LoopSolver.close
        self.ranked: dict[bytes, Any] = {}  # the last J → the ranking of its rows
        self.levers: list[str] = []  # the doubt about long levers, or "", once it is known
        self._compiled: list[Any] = []  # the rows in C++, once they are needed
        self.structure: list[np.ndarray] = []  # the structure constants of the model, once they are known
        self.assemblies: dict[tuple, Any] = {}  # the last start → its assembly
        self.regular: set[bytes] = set()  # the last place at which the equations have a unique solution

    @staticmethod
    def of(mechanism) -> LoopRows:
        """The rows of a mechanism, with their own functions of time; they are built once and then copied."""
        built = LoopRows.built(mechanism)
        rows = copy(built)
        if built.moving:
            rows.closures = [copy(closure) if closure.moving else closure for closure in built.closures]
            rows.breakpoints = Breakpoints()
            rows.breakpoints.add(rows.closures)
        if not built.pure:
            rows._evaluated = {}
            rows._compiled = []
        return rows

    def _with(self, loops, others) -> LoopRows:
        """The same rows for `loops`, of which some (their indices) have other numbers."""
        rows = copy(self)
        # These depend on inertias.
        rows.assemblies = {}
        rows.regular = set()
        rows.levers = []
        if others:
            rows.loops, rows.closures = loops, list(self.closures)
            for i in others:
                rows.closures[i] = AnchoredRows(self.model, loops[i])
            changed = {loops[i].name for i in others}
            rows.near = {key: near for key, near in self.near.items() if key[0] not in changed}
            rows._evaluated, rows.vanishing, rows.closed, rows.ranked = {}, {}, {}, {}
            rows._compiled = []
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
        of_joints = velocity_units(self.model) if any(isinstance(loop, JointConstraint) for loop in self.loops) else []
        for loop, part in zip(self.loops, self.slices.values(), strict=True):
            if isinstance(loop, JointConstraint):
                units[part.start] = of_joints[self.model.idx_vs[self.model.getJointId(loop.joints[0])]]
            elif not isinstance(loop, Loop):
                units[part] = [""] * (part.stop - part.start)
        return units

    @property
    def multiplier_units(self) -> list[str]:
        """``N·m`` or ``N`` for the multiplier of each row; empty for user-defined constraints."""
        return [{"rad": "N·m", "m": "N"}.get(unit, "") for unit in self.units]

    @property
    def compiled(self) -> Any:
        """All rows in C++, which are exact also while loops are open."""
        if not self._compiled:
            system = blank_system(self.model)
            for closure in self.closures:
                add_rows(system, closure)
            self._compiled.append(system)
        return self._compiled[0]

    def at(self, q, t: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Φ and J at `q`, (nc,) and (nc, nv): new arrays."""
        place = t, q.tobytes()
        known = self._evaluated.get(place)  # by one look: other threads may replace it
        if known is None:
            known = self._at(q, t)
            self._evaluated.clear()
            self._evaluated[place] = known
        phi, J = known
        return phi.copy(), J.copy()

    def _at(self, q, t):
        return self.compiled.rows(q, t)

    def time_rate(self, t: float, q) -> np.ndarray:
        """Φ_t, shape (nc,)."""
        return self.compiled.constraint(t, q, np.zeros(self.model.nv))[1]

    def check_derivatives(self, t: float, q) -> None:
        for closure in self.closures:
            closure.check_derivatives(t, q)

    def acceleration_bias(self, t: float, q, v) -> np.ndarray:
        """J̇ v and the terms from Φ's dependence on time, shape (nc,), for closed loops."""
        return self.compiled.dynamics(t, q, v)[3]


def add_rows(compiled, closure, local=None) -> None:
    """Add the rows of a record, or some of them, to a compiled system; it calls Python for kinds it does not have."""
    if not closure.hand_over(compiled):
        local = range(len(closure.turns)) if local is None else local
        compiled.add_python_rows(closure, list(local), closure.moving, closure.difference_step)


class KeptRows:
    """Some rows of the loops of a model, for use near closed configurations.

    In a closed loop, the exact Jacobian is a constant linear map of that of the position of points or of a pose, and Φ
    has the same zeros as this map of the positions. Newton's iteration therefore has the same solution, and a hinge
    whose tilts are not kept is as cheap as a point. An axis of body 2 is the difference of two points 1 m apart,
    R axis2 = d(at axis2) − d. Distances, drives, couplings and user-defined constraints are evaluated directly.
    `kept` are the ascending indices of the required rows among all `rows`.
    """

    def __init__(self, rows: LoopRows, kept):
        self._closures = []
        kept = [int(row) for row in kept]
        for closure in rows.closures:
            start = rows.slices[closure.loop.name].start
            local = [row - start for row in kept if 0 <= row - start < len(closure.turns)]
            if not local:
                continue
            key = closure.loop.name, *local
            if key not in rows.near:
                anchored = isinstance(closure, AnchoredRows) and isinstance(closure.translation, Position)
                near = near_closed(closure, local) if anchored else []
                rows.near[key] = [(matrix, closure.ends(shift)) for shift, matrix in near]
            self._closures.append((closure, local, rows.near[key]))
        self.difference_step = min((closure.difference_step for closure, _, _ in self._closures), default=np.inf)

    def hand_over(self, compiled) -> dict[str, list]:
        """Add these rows to the compiled system.

        Returns, for each loop between anchors, the number of each of its parts there, and the distance of its point
        from anchor 2, in the axes of the joint.
        """
        found = {}
        for closure, local, parts in self._closures:
            if isinstance(closure, AnchoredRows):
                points = [ends[3][:3, 3] - closure.place2.translation for _, ends in parts] or [HERE]
                found[closure.loop.name] = [(compiled.number_of_rows + i, point) for i, point in enumerate(points)]
            for i, (matrix, ends) in enumerate(parts):
                compiled.add_anchored(*ends, matrix, i == 0)
            if not parts:
                add_rows(compiled, closure, local)
        return found


class AnchoredRows(Rows):
    """One loop on one model: anchors as (joint, placement), and the blocks of its rows; `rotation` may be None."""

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
        kind = LOOP_KINDS[loop.kind]
        self.turns = (False,) * len(kind.translations) + (True,) * len(kind.rotations)
        self.translation, self.rotation = kind.blocks(loop)

    def ends(self, shift=HERE):
        """Anchor 1, and anchor 2 or the point at `shift` from it, in the form of the compiled system."""
        return self.joint1, self.place1.homogeneous, self.joint2, _shifted(self.place2, shift).homogeneous

    def hand_over(self, compiled) -> bool:
        for block in (self.translation, self.rotation):
            if block is not None:
                block.add_to(compiled, self.ends)
        return True


def near_closed(closure, local):
    """The rows `local` of a loop as pairs (shift, matrix), whose products are added.

    `matrix` is applied to the position of the point at `shift` from anchor 2 or, if `shift` is POSE, to the pose.
    """
    position, rotation = closure.translation, closure.rotation
    n = len(position.directions)
    if rotation is None or max(local) < n:
        return [(HERE, position.directions[local])]
    if not isinstance(rotation, RotationVector):
        shift, at_shift, at_anchor = rotation.axis2, rotation.directions, -rotation.directions
    elif n == 3:
        return [(POSE, np.eye(6)[local])]
    else:
        shift, at_shift, at_anchor = POSE, np.eye(6)[3:], np.zeros((3, 3))
    above = np.zeros((n, at_shift.shape[1]))
    matrix = np.vstack((position.directions, at_anchor)), np.vstack((above, at_shift))
    return [(HERE, matrix[0][local]), (shift, matrix[1][local])]


def _shifted(place, shift):
    """The placement of the point at `shift` from an anchor, or of the anchor itself if `shift` is POSE."""
    return pin.SE3(place.rotation, place.act(shift)) if shift is not POSE and shift.any() else place


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
