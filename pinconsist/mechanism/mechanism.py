"""Mechanism: the immutable, picklable description of a scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from ..errors import InputError
from .checks import finite_array, near, normalized, number, own_model, places, put, require_mechanism, triple
from .contacts import checked_contacts, elements_of
from .correction import correction
from .custom import Constraint
from .description import html_of, text_of
from .editing import lock, reanchored, reduced
from .forces import as_force, bound_forces
from .forces.actuators import commanded
from .joint_constraints import Coupling, Drive
from .loops import Loop
from .names import filled
from .parameters import with_parameters
from .rows import RECORDS, LoopRows
from .spins import lock_spins


@dataclass(frozen=True)
class Geometry:
    """The shapes of a scene: a checked URDF text and the folders of its meshes; loaded when something is shown."""

    urdf: str
    package_dirs: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False, repr=False)
class Mechanism:
    """A tree of bodies, the loops that close it and the forces that act.

    The joint damping and dry friction of the model, and gravity, always act; ``forces`` are added to them.

    Parameters
    ----------
    model : pin.Model
        The tree; copied, never changed. The copy has a frame for each joint, unless a frame has its name already.
    loops : sequence of Loop, Drive, Coupling and Constraint
        Loop closures, driven and coupled joints, user-defined constraints; may be empty (a plain tree).
    forces : sequence
        Records of :mod:`pinconsist.mechanism.forces`; joint torques by name (joint → N·m or N, or a function of
        time) or as an array (nv,); callables ``f(t, q, v) -> (nv,)``.
    contacts : sequence
        Records of :mod:`pinconsist.mechanism.contacts`: stops, ropes, points on planes.
    name : str
        Used in messages and files.
    guess : mapping or array, optional
        Where assembly starts: joint name → value, or a configuration (nq,). Default ``pin.neutral``.
    actuated : sequence of str
        Names of motorised joints; the motors of :class:`Actuation` by default.
    geometry : Geometry, optional
        Shapes for replays.
    duration : float
        Default duration of a run of the commands, s.
    corrected_by : float
        Largest change of lengths and angles by :meth:`corrected`, m or rad; for information.
    ignored : sequence of str
        Elements of its file without effect, counted: ``"5 collision shapes"``; for information.

    Raises
    ------
    InputError
        Unknown frames or joints, duplicate loop names, wrong sizes, joints not in depth-first order.
    """

    model: pin.Model
    loops: Sequence[Loop | Drive | Coupling | Constraint] = ()
    forces: Sequence[Any] = ()
    contacts: Sequence[Any] = field(default=(), kw_only=True)
    name: str = ""
    guess: Any = None
    actuated: tuple[str, ...] = ()
    geometry: Geometry | None = field(default=None, repr=False)
    duration: float = 5.0
    corrected_by: float = 0.0
    ignored: tuple[str, ...] = ()

    def __post_init__(self):
        if not isinstance(self.model, pin.Model):
            raise InputError(f"Mechanism needs a pin.Model, got {type(self.model).__name__}")
        put(self, model=(model := own_model(self.model)))
        if isinstance(self.name, str) and not self.name:
            put(self, name=model.name or "mechanism")
        for several in ("loops", "forces", "actuated", "ignored"):
            put(self, **{several: _sequence(getattr(self, several), several)})
        if not all(isinstance(loop, tuple(RECORDS)) for loop in self.loops):
            raise InputError(f"loops= needs Loop, Drive, Coupling and Constraint objects, got {self.loops!r}")
        names = [loop.name for loop in self.loops]
        if twice := [name for name in names if names.count(name) > 1]:
            raise InputError(f"two loops are named {min(twice)!r}; reactions and reports need unique names")
        LoopRows.built(self)  # this checks frames and bodies
        put(self, forces=tuple(as_force(force) for force in self.forces))
        bound_forces(model, self.forces)  # this checks joints, frames and sizes
        put(self, contacts=checked_contacts(model, self.contacts, self.loops))
        put(self, guess=self.configuration({} if self.guess is None else self.guess))
        for joint in self.actuated:
            self.joint_index(joint)
        put(self, duration=number(self.duration, "duration", above=0.0))

    def __repr__(self):
        return text_of(self)

    _repr_html_ = html_of

    @property
    def nq(self) -> int:
        """Size of a configuration."""
        return self.model.nq

    @property
    def nv(self) -> int:
        """Size of a velocity."""
        return self.model.nv

    @property
    def nc(self) -> int:
        """Number of rows of all loops, redundant ones included."""
        return sum(len(loop.rows) for loop in self.loops)

    @property
    def anchored_loops(self) -> tuple[Loop, ...]:
        """The loops that connect two anchors, without drives, couplings and user-defined constraints."""
        return tuple(loop for loop in self.loops if isinstance(loop, Loop))

    @property
    def row_labels(self) -> list[tuple[str, str]]:
        """(loop or contact, row) of each multiplier: those of the loops come first."""
        rows = [(loop.name, row) for loop in self.loops for row in loop.rows]
        return rows + [(each.record.name, row) for each in self.contact_elements for row in each.labels]

    @cached_property
    def contact_elements(self) -> list:
        """The elements of the contacts."""
        return elements_of(self.model, self.contacts, self.loops)

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Joint names, without the ground."""
        return tuple(self.model.names)[1:]

    def columns(self, joint: str) -> slice:
        """The columns of a `joint` in v, τ and J, as a slice; raises InputError for an unknown joint."""
        return places(self.model, self.joint_index(joint))[1]

    def joint_index(self, joint: str) -> int:
        """The index of a `joint` in ``model.joints``, from 1 on: the ground is 0. Its position in v: :meth:`columns`.

        Raises InputError for an unknown joint; the message lists the joints of the mechanism.
        """
        if not isinstance(joint, str) or joint not in self.joints:
            known = ", ".join(self.joints[:12]) + (", …" if len(self.joints) > 12 else "")
            resembling = near(joint, self.joints) if len(self.joints) > 12 else ""
            frame = isinstance(joint, str) and self.model.existFrame(joint)
            hint = f"; {joint!r} is a frame: its motion is sol.frame({joint!r})" if frame else ""
            raise InputError(f"{self.name}: no joint {joint!r}{resembling}; the joints are {known}{hint}")
        return self.model.getJointId(joint)

    def configuration(self, values, base=None) -> np.ndarray:
        """A full configuration (nq,), quaternions and (cos, sin) pairs at unit length. The loops are not closed.

        `values` maps joint names to as many numbers as the joint has in q, or fewer: one angle, rad, if it stores (cos,
        sin); roll, pitch, yaw or a rotation matrix for a ball; x, y, angle for a planar joint; for a free-flyer x, y,
        z, roll, pitch, yaw, or [x, y, z, R], or a matrix (4, 4), or a pin.SE3. The other joints come from `base`, a
        configuration (nq,), by default ``pin.neutral``. `values` may also be a configuration (nq,), which is copied.
        Raises InputError for an unknown joint, a wrong size, NaN, a quaternion or pair of length zero.
        """
        start = pin.neutral(self.model) if base is None else finite_array(base, "base")
        return normalized(self.model, filled(self, values, start), self.name)

    def velocity(self, values) -> np.ndarray:
        """A full velocity (nv,). It is not projected onto the constraints.

        `values` maps joint names to velocities, rad/s or m/s, one number for each degree of freedom of the joint; the
        other joints are at rest. It may also be a velocity (nv,), which is copied. Raises InputError for an unknown
        joint, a wrong size, NaN.
        """
        return filled(self, values, np.zeros(self.model.nv), velocity=True)

    def q(self, values=None, /, **joints) -> np.ndarray:
        """A configuration (nq,) by names: ``mech.q(crank=0.3, base=[x, y, z, R])``; the other joints as in ``guess``.

        `values` is a mapping for names that are not Python identifiers; `joints` are the others. See
        :meth:`configuration`, also for what raises InputError.
        """
        if not (values is None or isinstance(values, Mapping)):
            raise InputError(f"{self.name}.q() needs a mapping joint name → value, got {values!r}")
        return self.configuration({**(values or {}), **joints}, self.guess)

    def with_loops(self, *loops: Loop | Drive | Coupling | Constraint) -> Mechanism:
        """The same mechanism with these `loops` instead of its own; without arguments, a tree.

        :meth:`add_loops` keeps the existing ones. Raises InputError for unknown frames or joints, duplicate names, and
        arguments that are not loops.
        """
        return replace(self, loops=loops)

    def add_loops(self, *loops: Loop | Drive | Coupling | Constraint) -> Mechanism:
        """The same mechanism with these `loops` added to its own, after them.

        Raises InputError for unknown frames or joints, duplicate names, and arguments that are not loops.
        """
        return replace(self, loops=(*self.loops, *loops))

    def with_forces(self, *forces) -> Mechanism:
        """The same mechanism with these `forces` instead of its own; without arguments, with those of the model alone.

        Damping and dry friction of the model, and gravity, are not part of ``forces`` and are kept. :meth:`add_forces`
        keeps the existing forces. Raises InputError for unknown frames or joints, wrong sizes, and arguments that are
        not forces.
        """
        return replace(self, forces=forces)

    def add_forces(self, *forces) -> Mechanism:
        """The same mechanism with these `forces` added after its own; each as in ``forces`` of :class:`Mechanism`.

        Raises InputError for unknown frames or joints, wrong sizes, and arguments that are not forces.
        """
        return replace(self, forces=(*self.forces, *forces))

    def with_contacts(self, *contacts) -> Mechanism:
        """The same mechanism with these `contacts` instead of its own; without arguments, with none.

        Each is a record of :mod:`pinconsist.mechanism.contacts`: :class:`Stop`, :class:`Rope`, :class:`Strut`,
        :class:`Contact`, :class:`DryFriction`, :class:`PinFriction`. :meth:`add_contacts` keeps the existing ones.
        Raises InputError for unknown joints, frames and loops, names that are not unique, and other objects.
        """
        return replace(self, contacts=contacts)

    def add_contacts(self, *contacts) -> Mechanism:
        """The same mechanism with these `contacts` added to its own, see :meth:`with_contacts`."""
        return replace(self, contacts=(*self.contacts, *contacts))

    def with_control(self, control: Mapping[str, Any]) -> Mechanism:
        """The same mechanism with other commands: `control` maps names of actuators, or of their joints, to commands.

        A command is a number, a function of time, or a table (times, values), interpolated
        linearly and constant before and after; steps end at its times. Raises InputError for anything else.
        """
        return commanded(self, control)

    def with_gravity(self, gravity) -> Mechanism:
        """The same mechanism with another `gravity`, three numbers, m/s², in world axes.

        Raises InputError for anything but three finite numbers.
        """
        model = self.model.copy()
        model.gravity.linear = np.array(triple(gravity, "gravity"))
        return replace(self, model=model)

    def with_armature(self, armature: Mapping[str, float]) -> Mechanism:
        """The same mechanism with rotor inertia added: `armature` maps joints to kg·m² (or kg), reflected to the joint.

        It applies to each velocity of a joint. Raises InputError for unknown joints and negative values.
        """
        if not isinstance(armature, Mapping):
            raise InputError(f"armature needs a mapping joint name → rotor inertia, got {armature!r}")
        model = self.model.copy()
        for joint, value in armature.items():
            model.armature[self.columns(joint)] += number(value, f"armature of joint {joint!r}", least=0.0)
        return replace(self, model=model)

    def with_parameters(self, values: Mapping[str, float]) -> Mechanism:
        """The same mechanism with other `values` of parameters by name: see :mod:`pinconsist.mechanism.parameters`."""
        return with_parameters(self, values)

    def lock(self, joints, q=None) -> Mechanism:
        """The same mechanism with these joints locked and removed; their bodies are merged with those of their parents.

        Items without effect are then removed: loops with both anchors on one body (they must be closed), couplings of
        two locked joints, forces of locked joints. User-defined torques and constraints still receive the whole state,
        with the locked joints at rest.

        `joints` are their names, or one name. They are locked at `q`: joint name → value (others from ``guess``), or a
        configuration (nq,), by default the ``guess``; its remaining entries are the new guess. Raises InputError for
        unknown joints, if all joints would be locked, if a loop would stay open, for a driven joint, and for only one
        of two coupled joints.
        """
        return lock(self, joints, q)

    def lock_spins(self, q0=None) -> Mechanism:
        """The same mechanism without the spins of rods about their own axes: faster, with otherwise the same motion.

        A rod in a loop whose last joint turns it about its own axis is found if this moves no loop: the other end is a
        point on the axis, or the rod consists of two halves connected by a loop of kind ``frame``, which becomes a
        hinge. The rod must be axisymmetric, without motors, forces, damping or armature of its own; otherwise its spin
        has effects, and it is kept. Without its inertia about the axis, a locked rod moves the other bodies exactly as
        one that does not spin. The locked joints are logged; if there are none, the mechanism itself is returned.

        `q0` is the configuration from which assembly starts, as for :func:`~pinconsist.assemble`; the new guess is the
        assembled one. Raises AssemblyError if the loops do not close.
        """
        return lock_spins(self, q0)

    def reduced(self, q0=None) -> Mechanism:
        """A mechanism with the same motion but fewer joints and rows, faster and easier to read.

        Joints that the loops immobilise are locked. Redundant loops are removed, the last ones first, and a frame,
        hinge or universal whose rotational rows are redundant becomes a point. Both are decided by the rank at a few
        closed configurations, along a random walk from the assembled one; the changes are logged. The motion, and the
        joint forces Jᵀλ of all loops together, are unchanged; the distribution of the load among redundant loops is
        lost. A loop that is redundant elsewhere may be needed to guide a mechanism through a singular configuration: a
        reduced mechanism may branch there, and a run that reaches such a configuration reports it.

        `q0` is the configuration from which assembly starts, as for :func:`~pinconsist.assemble`; the new guess is the
        assembled configuration. Raises AssemblyError if the loops do not close, InputError if they leave no motion.
        """
        return reduced(self, q0)

    def corrected(self, precision: float) -> Mechanism:
        """The same mechanism with rounded numbers corrected, so that redundant loops are consistent again.

        Some rows depend on others except for errors of at most `precision` (m and rad) in the placements of joints and
        anchors. The smallest change of these placements, ``corrected_by``, is computed with which they depend exactly,
        wherever the mechanism moves. The guess is then closed. If no change within the precision is found, the
        mechanism is returned unchanged.
        """
        found = correction(self, precision) if (precision := number(precision, "precision", least=0.0)) else None
        return self if found is None else found.mechanism

    def to_pinocchio(self, q0=None) -> Any:
        """The tuple (model, constraints, motors) for which ``pin.constraintDynamics`` gives the same motion.

        ``model`` is a copy of the tree. ``constraints`` are ``pin.RigidConstraintModel`` of the loops, in the axes of
        anchor 1: points and frames; a hinge is a point, and a second one on its axis where loops are not planar.
        Their contact forces act on body 1, and are -λ: :meth:`Solution.contact_forces`. ``motors`` are the names of
        motorised joints. Assembly starts from `q0`, as in :meth:`reanchored`. Forces, drives and couplings are not part
        of these; InputError for drives, couplings, user-defined constraints and loops of other kinds.
        """
        from .rigid import to_pinocchio

        return to_pinocchio(self, q0)

    def reanchored(self, q0=None) -> Mechanism:
        """The same mechanism with every loop's anchor 2 moved to where anchor 1 fits best.

        If a loop cannot close, its second anchor (for a distance, its length) is moved by the remaining gap, and a
        warning lists each move. Loops that close are unchanged. The new guess is the configuration that was reached,
        in which all loops close.

        Assembly starts from `q0`: joint name → value (others from ``guess``), or a configuration (nq,); default
        ``guess``. Raises InputError for an unknown joint, a wrong size, NaN.
        """
        return reanchored(self, q0)


def _sequence(value, what: str) -> tuple:
    if isinstance(value, str) or not hasattr(value, "__iter__"):
        raise InputError(f"{what}= needs a sequence, got {value!r}")
    return tuple(value)


def with_added_forces(mechanism, forces, caller: str) -> Mechanism:
    """The mechanism with the `forces` argument of a function added, after checks; it may be a single force."""
    require_mechanism(mechanism, caller)
    if type(forces) is tuple and not forces:
        return mechanism
    if callable(forces) or isinstance(forces, Mapping) or hasattr(forces, "torque") or hasattr(forces, "bind"):
        forces = (forces,)
    forces = _sequence(forces, "forces")
    return mechanism.add_forces(*forces) if forces else mechanism
