"""The results of a run by the names of joints, frames and forces, and as a table."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from ..errors import InputError, MissingExtraError
from ..files import write_csv
from ..mechanism.checks import frame_of, near, places, read_only, several
from ..mechanism.checks import name as checked_name
from ..mechanism.energy import torques_of
from ..mechanism.forces import bound_forces
from ..mechanism.forces.actuators import Actuator
from ..mechanism.forces.held import sided
from ..mechanism.joint_constraints import Drive, JointConstraint
from ..mechanism.loops import Loop
from ..mechanism.mechanism import Mechanism
from ..mechanism.names import position_names, position_units, velocity_names, velocity_units
from ..mechanism.peaks import HasPeaks
from ..mechanism.reactions import Reaction, States, shared_rows
from ..mechanism.rows import LoopRows, Workspace
from .accuracy import accelerations
from .contact_results import (
    ContactHistory,
    ContactImpact,
    ContactMode,
    ContactMotion,
    contact_columns,
    contact_motion,
    row_units,
)  # fmt: skip
from .states import states_at


@dataclass(frozen=True, eq=False)
class JointMotion:
    """The motion of one joint over a run. Rows are those of the solution.

    Attributes
    ----------
    joint : str
        Name of the joint, or of one of its coordinates, ``ball[0]``.
    t : ndarray, shape (n,)
        Times, s.
    position, velocity, acceleration : ndarray, shape (n,), or (n, k) for a joint of several
        As returned by :meth:`Solution.position`, :meth:`Solution.velocity` and :meth:`Solution.acceleration`.
    torque : ndarray, shape (n,) or (n, k)
        Total torque of all forces and drives on the joint, N·m or N.
    """

    joint: str
    t: np.ndarray = field(repr=False)
    position: np.ndarray = field(repr=False)
    velocity: np.ndarray = field(repr=False)
    acceleration: np.ndarray = field(repr=False)
    torque: np.ndarray = field(repr=False)


@dataclass(frozen=True, eq=False)
class FrameMotion:
    """The motion of one frame over a run, in world axes. Rows are those of the solution.

    Attributes
    ----------
    frame : str
        Its name.
    t : ndarray, shape (n,)
        Times, s.
    position : ndarray, shape (n, 3)
        Position of its origin, m.
    rotation : ndarray, shape (n, 3, 3)
        Rotation from its axes to those of the world.
    velocity, acceleration : ndarray, shape (n, 3)
        Velocity and acceleration of its origin, m/s and m/s².
    angular_velocity, angular_acceleration : ndarray, shape (n, 3)
        rad/s and rad/s².
    """

    frame: str
    t: np.ndarray = field(repr=False)
    position: np.ndarray = field(repr=False)
    rotation: np.ndarray = field(repr=False)
    velocity: np.ndarray = field(repr=False)
    angular_velocity: np.ndarray = field(repr=False)
    acceleration: np.ndarray = field(repr=False)
    angular_acceleration: np.ndarray = field(repr=False)


@dataclass(frozen=True, eq=False)
class ElementForce(HasPeaks):
    """One force of a mechanism over a run. Rows are those of the solution; missing quantities are None.

    Attributes
    ----------
    label : str
        Its name, as in energies.
    t : ndarray, shape (n,)
        Times, s.
    force : ndarray, shape (n,) or (n, 3)
        For a spring between points, its tension, N. For an actuator, its force before the gear, N·m or N. For a wrench,
        the force in world axes, N.
    moment : ndarray, shape (n, 3)
        For a wrench, the moment about its point of application in world axes, N·m.
    length, speed : ndarray, shape (n,)
        For a spring, the distance between its points, m, and its rate, m/s; for an actuator, gear times joint position,
        rad or m, and its rate.
    torque : ndarray, shape (n,), or (n, nv)
        Its torque on the joints, N·m or N, as :meth:`Solution.torque` returns it.
    """

    label: str
    t: np.ndarray = field(repr=False)
    force: np.ndarray | None = field(repr=False)
    moment: np.ndarray | None = field(repr=False)
    length: np.ndarray | None = field(repr=False)
    speed: np.ndarray | None = field(repr=False)
    torque: np.ndarray = field(repr=False)
    _at: Callable | None = field(default=None, repr=False)

    def __str__(self):
        parts = {"force [N]": self.force, "moment [N·m]": self.moment}
        parts = {name: part for name, part in parts.items() if part is not None}
        parts = parts or {"torque [N·m or N]": self.torque}
        largest = [
            f"{name} up to {np.linalg.norm(np.atleast_2d(part.T), axis=0).max(initial=0.0):.4g}"
            for name, part in parts.items()
        ]
        return f"{self.label}: {', '.join(largest)}"


class ByName:
    """The part of a solution that is read by the names of joints, frames, loops and forces.

    A solution read from a file needs the `mechanism` that was simulated, with the forces of the run.
    """

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    lam: np.ndarray
    system: Any
    reaction: Callable[..., Any]
    _mechanism: Callable[..., Mechanism]
    _workspace: Callable[..., Workspace]
    _require_forces: Callable[..., None]
    _states: Callable[..., States]
    contacts: ContactHistory | None

    def position(self, joint: str, mechanism=None) -> np.ndarray:
        """The position of a joint, rad or m, shape (n,); (n, k) for a joint of several numbers, as `q` stores them.

        `joint` is a joint, or one of its numbers, ``"ball[0]"``. The angle of a joint that stores (cos, sin) is
        unwrapped: it has no jumps of 2π. `mechanism` is as in :meth:`check`. Raises InputError for other names.
        """
        mechanism = self._mechanism(mechanism, "position", False)
        model, part = mechanism.model, _part(mechanism, joint, positions=True)
        found = self.q[:, part]
        if found.shape[1] == 2 and model.nvs[mechanism.joint_index(joint)] == 1:
            return np.unwrap(np.arctan2(found[:, 1], found[:, 0]))
        return found[:, 0] if found.shape[1] == 1 else found

    def velocity(self, joint: str, mechanism=None) -> np.ndarray:
        """The velocity of a joint, rad/s or m/s, shape (n,); (n, k) for a joint of several.

        `joint` and `mechanism` are as in :meth:`position`.
        """
        return _of(self._mechanism(mechanism, "velocity", False), joint, self.v)

    def acceleration(self, joint: str | None = None, mechanism=None) -> np.ndarray:
        """The acceleration of a joint, rad/s² or m/s², shape (n,); (n, k) for a joint of several; (n, nv) for all.

        It follows from the equations of motion at each row; `joint` is as in :meth:`position`, `mechanism` as in
        :meth:`check`. Raises SingularSystemError if it is not determined, InputError as there.
        """
        self._require_forces(mechanism)
        mechanism = self._mechanism(mechanism, "acceleration")
        found = accelerations(mechanism, self, sided(self.t), self.q, self.v)
        return found if joint is None else _of(mechanism, joint, found)

    def frame(self, frame: str, mechanism=None) -> FrameMotion:
        """The pose, velocity and acceleration of a `frame` of the model, see :class:`FrameMotion`.

        `mechanism` is as in :meth:`check`. Raises InputError for other names.
        """
        mechanism = self._mechanism(mechanism, "frame")
        model, data = mechanism.model, self._workspace(mechanism.model).data
        i, axes = model.getFrameId(frame_of(model, frame, mechanism.name).name), pin.LOCAL_WORLD_ALIGNED
        rows = np.empty((len(self.t), 24))
        for row, *state in zip(rows, self.q, self.v, self.acceleration(None, mechanism), strict=True):
            pin.forwardKinematics(model, data, *state)
            pose = pin.updateFramePlacement(model, data, i)
            velocity = pin.getFrameVelocity(model, data, i, axes)
            row[:3], row[3:12], row[12:18] = pose.translation, pose.rotation.ravel(), velocity.vector
            row[18:] = pin.getFrameClassicalAcceleration(model, data, i, axes).vector
        place, turn, *motion = np.split(rows, (3, 12, 15, 18, 21), axis=1)
        found = (self.t, place, turn.reshape(-1, 3, 3), *motion)
        return FrameMotion(frame, *(read_only(each) for each in found))

    def torque(self, name: str, mechanism=None) -> np.ndarray:
        """The torque of a force, motor or drive, N·m (or N), positive along the joint's velocity.

        `name` is that of a drive or coupling (the torque on its joint); or the label of a force, ``"servo crank"``, or
        its first word; or a joint: the total of all forces and drives on it. Shape (n,) for a force that acts
        on a joint of one degree of freedom, else (n, nv), or (n, k) for a joint of several. `mechanism` is as in
        :meth:`check`. Raises InputError for other names.
        """
        mechanism = self._mechanism(mechanism, "torque")
        loops = {loop.name: loop for loop in mechanism.loops if isinstance(loop, JointConstraint)}
        if checked_name(name, "torque(): the force, drive or joint") in loops:
            row: int = LoopRows.of(mechanism).slices[name].start
            return self.lam[:, row]
        label = self._label(mechanism, name)
        joint, found = name if label is None else joint_of(mechanism, label), self._acting(mechanism, label)
        return found if joint is None else _of(mechanism, joint, found)

    @property
    def modes(self) -> list[ContactMode]:
        """The mode of each contact, with begin and end, in order of time; empty without contacts."""
        return self.contacts.modes(float(self.t[-1])) if self.contacts else []

    @property
    def impacts(self) -> tuple[ContactImpact, ...]:
        """The impacts of contacts, in order of time."""
        return self.contacts.impacts if self.contacts else ()

    def contact(self, name: str, mechanism=None) -> ContactMotion:
        """The gap, force, slip and mode of a contact at the rows, see :class:`.ContactMotion`.

        `name` is that of its record, or of one stop, ``"knee upper"``; `mechanism` is as in :meth:`check`. Raises
        InputError for other names.
        """
        return contact_motion(self, self._mechanism(mechanism, "contact"), checked_name(name, "contact(): the contact"))

    def force(self, name: str, mechanism=None) -> ElementForce:
        """The force of an element, such as a spring: with its length and speed, see :class:`ElementForce`.

        `name` is the label of a force, ``"spring boom-stick"``, or a word that occurs in no other label,
        ``"boom-stick"``. `mechanism` is as in :meth:`check`. Raises InputError for other names; for loops and joints it
        names the method.
        """
        mechanism = self._mechanism(mechanism, "force")
        forces = bound_forces(mechanism.model, mechanism.forces)
        label = _element(mechanism, forces, name)
        joint, bound, workspace = joint_of(mechanism, label), forces[label], self._workspace(mechanism.model)

        def found(t, sides, q, v, at=None):
            rows = [bound.element(*state) for state in zip(sides, q, v, strict=True)]
            parts = {part: read_only(np.array([row[part] for row in rows])) for part in (rows[0] if rows else ())}
            torque = torques_of(bound, sides, q, v, workspace)
            torque = torque if joint is None else _of(mechanism, joint, torque)
            every = {part: parts.get(part) for part in ("force", "moment", "length", "speed")}
            return ElementForce(label=label, t=t, **every, torque=read_only(torque), _at=at)

        def at(times):
            return found(times, times, *states_at(self, times, mechanism)[:2])

        return found(self.t, sided(self.t), self.q, self.v, at)

    def power(self, name: str, mechanism=None) -> np.ndarray:
        """The power τ·v of a force, motor or drive, W, shape (n,), positive into the mechanism; springs included.

        `name` and `mechanism` are as in :meth:`torque`. Raises InputError for other names.
        """
        mechanism = self._mechanism(mechanism, "power")
        loops = {loop.name: loop for loop in mechanism.loops if not isinstance(loop, Loop)}
        if checked_name(name, "power(): the force, drive or joint") in loops:
            return (self.reaction(name, mechanism).joint_forces * self.v).sum(axis=1)
        label = self._label(mechanism, name)
        part = slice(None) if label is not None else _part(mechanism, name)
        return (self._acting(mechanism, label)[:, part] * self.v[:, part]).sum(axis=1)

    def _label(self, mechanism, name) -> str | None:
        """The label of the force with this name, or None if the name is that of a joint."""
        forces = bound_forces(mechanism.model, mechanism.forces)
        begin = [label for label in forces if label.split()[0] == name]
        if name in forces or len(begin) == 1:
            return name if name in forces else begin[0]
        if name.partition("[")[0] not in mechanism.joints:
            loops = (loop.name for loop in mechanism.loops if isinstance(loop, JointConstraint))
            known = near(name, [*forces, *loops, *mechanism.joints])
            there = f"the forces are {', '.join(forces) or 'none'}"
            raise InputError(f"{mechanism.name}: no force, drive or joint {name!r}{known}; {there}")
        return None

    def _acting(self, mechanism, label=None) -> np.ndarray:
        """τ of the force of a label, or of all forces and drives together, (n, nv)."""
        forces, total = bound_forces(mechanism.model, mechanism.forces), np.zeros(self.v.shape)
        workspace = self._workspace(mechanism.model)
        for force in forces.values() if label is None else [forces[label]]:
            total += torques_of(force, sided(self.t), self.q, self.v, workspace)
        rows = LoopRows.of(mechanism)
        for drive in mechanism.loops if label is None else ():
            if isinstance(drive, Drive):
                total[:, mechanism.columns(drive.joint)] += self.lam[:, rows.slices[drive.name]]
        return total

    def __getitem__(self, name: str) -> JointMotion | FrameMotion | Reaction:
        """The motion of the joint or frame, or the reaction of the loop, of this name, searched in this order."""
        if self.system is None:
            raise InputError(f"a solution read from a file has no mechanism: use sol.position({name!r}, mechanism), …")
        mechanism = self._mechanism(None, "__getitem__")
        if name.partition("[")[0] in mechanism.joints:
            parts = [part(name) for part in (self.position, self.velocity, self.acceleration)]
            parts.append(_of(mechanism, name, self._acting(mechanism)))
            return JointMotion(name, self.t, *(read_only(part) for part in parts))
        if name in (loops := [loop.name for loop in mechanism.loops]):
            return self.reaction(name)
        frames = [frame.name for frame in mechanism.model.frames]
        if name not in frames:
            known = near(name, (*mechanism.joints, *frames, *loops))
            raise InputError(f"{mechanism.name}: no joint, frame or loop {name!r}{known}; forces: sol.torque(label)")
        return self.frame(name)

    def to_dataframe(self, mechanism=None, *, forces=()) -> Any:
        """A pandas DataFrame of the columns ``t``, ``q.crank``, ``v.crank``, ``a.crank`` and ``lam.loop.row``.

        `forces` names loops, joints of the tree and forces whose columns are added, in world axes:
        ``force.boom_pin.x``, ``moment.boom_pin.x``, and of elements ``force.strut``, ``length.strut``. Contacts have
        ``gap.heel``, ``force.heel.x`` in world axes or ``force.knee``, and ``mode.heel``: 0 open, 1 closed, 2 stick,
        3 slip. Its ``attrs["units"]`` maps the columns to their units, and ``attrs["not_unique"]`` lists those that
        redundant loops share, see :class:`Reaction`. `mechanism` is as in :meth:`check`. Raises MissingExtraError
        without pandas, and InputError for other names.
        """
        return _dataframe(*self._table("to_dataframe", mechanism, forces))

    def to_csv(self, file, mechanism=None, *, forces=()) -> Path:
        """Write the table of :meth:`to_dataframe` with units, ``v.crank [rad/s]``, to a CSV `file` and return its path.

        Forces shared by redundant loops have the column name ``lam.hinge.x [N; not unique]``. The file is written
        atomically; `mechanism` and `forces` are as in :meth:`to_dataframe`. Raises OSError if that fails.
        """
        names, units, values, shared = self._table("to_csv", mechanism, forces)
        for i, name in enumerate(names):
            if name in shared:
                units[i] = f"{units[i]}; not unique".lstrip("; ")
        return write_csv(file, names, units, values)

    def _table(self, method, mechanism, forces):
        """(names, units, values, names of those that are not unique) of the columns."""
        general = mechanism is None and self.system is not None and self.mechanism is None
        values = [self.t[:, None], self.q, self.v, *([] if general else [None]), self.lam]
        if general:
            names = [f"{part}[{i}]" for part in ("q", "v", "lam") for i in range(getattr(self, part).shape[1])]
            return ["t", *names], ["s", *[""] * len(names)], np.hstack(values), []
        mechanism = self._mechanism(mechanism, method)
        model, rows, values[3] = mechanism.model, mechanism.row_labels, self.acceleration(None, mechanism)
        names = ["t", *(f"q.{name}" for name in position_names(model))]
        names += [f"{part}.{name}" for part in "va" for name in velocity_names(model)]
        units = velocity_units(model)
        units = ["s", *position_units(model), *(f"{u}/s" for u in units), *(f"{u}/s²" for u in units)]
        units += [{"rad": "N·m", "m": "N"}.get(unit, "") for unit in row_units(mechanism)]
        of_rows = [f"lam.{loop}.{row}" for loop, row in rows]
        names += of_rows
        for column, unit, part in contact_columns(self, mechanism):
            names.append(column)
            units.append(unit)
            values.append(part[:, None])
        shared = [of_rows[i] for i in shared_rows(self._states(mechanism, method))]
        for name in several(forces):
            for column, unit, part, unique in self._columns_of(name, mechanism):
                names.append(column)
                units.append(unit)
                values.append(part[:, None])
                shared += [] if unique else [column]
        return names, units, np.hstack(values), shared

    def _columns_of(self, name, mechanism):
        """(name, unit, values, whether they are unique) of the columns of a loop, a joint or a force."""
        of_joints = [{"rad": "N·m", "m": "N"}.get(unit, "") for unit in velocity_units(mechanism.model)]
        loops = [loop.name for loop in mechanism.loops]
        if checked_name(name, "forces: a loop, joint or force") in loops or name in mechanism.joints:
            found = self.reaction(name, mechanism)
            doubted = found.not_unique if found.shared_with else ()
            for what, unit in ("force", "N"), ("moment", "N·m"):
                for k, axis in enumerate("xyz" if getattr(found, what) is not None else ""):
                    yield f"{what}.{name}.{axis}", unit, getattr(found, what)[:, k], f"{what} {axis}" not in doubted
            if isinstance(found, Reaction) and found.torque is not None:
                unit = LoopRows.of(mechanism).multiplier_units[LoopRows.of(mechanism).slices[name].start]
                yield f"torque.{name}", unit, found.torque, not doubted
            return
        found = self.force(name, mechanism)
        if found.moment is not None:
            for what, unit in ("force", "N"), ("moment", "N·m"):
                yield from (
                    (f"{what}.{name}.{axis}", unit, getattr(found, what)[:, k], True) for k, axis in enumerate("xyz")
                )
        elif found.length is not None:
            for what, unit in zip(("force", "length", "speed"), element_units(mechanism, found.label), strict=True):
                yield f"{what}.{name}", unit, getattr(found, what), True
        elif found.torque.ndim == 1 or found.torque.shape[1] < mechanism.nv:
            joint = joint_of(mechanism, found.label)
            yield f"torque.{name}", of_joints[mechanism.columns(joint).start], found.torque, True
        else:
            for k, (axis, unit) in enumerate(zip(velocity_names(mechanism.model), of_joints, strict=True)):
                if found.torque[:, k].any():
                    yield f"torque.{name}.{axis}", unit, found.torque[:, k], True


def _dataframe(names, units, values, shared):
    try:
        import pandas as pd
    except ImportError:
        raise MissingExtraError("a DataFrame needs pandas; install it with: pip install 'pinconsist[pandas]'") from None
    frame = pd.DataFrame(values, columns=names)
    frame.attrs["units"] = dict(zip(names, units, strict=True))
    frame.attrs["not_unique"] = shared
    return frame


def _element(mechanism, forces, name) -> str:
    """The label of the force that `name` means."""
    if checked_name(name, "force(): the force") in forces:
        return name
    having = [label for label in forces if name in label.replace(",", " ").replace("-", " ").split() + label.split()]
    if len(having) == 1:
        return having[0]
    if having:
        raise InputError(f"{mechanism.name}: {name!r} may be {', '.join(map(repr, having))}: use the whole label")
    loops = {loop.name: loop.kind for loop in mechanism.loops}
    if name in loops or name in mechanism.joints:
        method = "reaction" if name in loops else "joint_force"
        what = loops.get(name, "joint of the tree")
        raise InputError(f"{mechanism.name}: {name!r} is a {what}, not a force: use sol.{method}({name!r})")
    there = f"the forces are {', '.join(forces) or 'none'}"
    raise InputError(f"{mechanism.name}: no force {name!r}{near(name, forces)}; {there}")


def _part(mechanism, name, positions=False) -> list[int]:
    """The columns of a joint, or of one of its numbers, in v, or in q."""
    joint = name if not isinstance(name, str) or name in mechanism.joints else name.partition("[")[0]
    part = places(mechanism.model, mechanism.joint_index(joint))[0 if positions else 1]
    every = list(range(part.start, part.stop))
    found = {joint: every} | {f"{joint}[{k}]": [column] for k, column in enumerate(every)}
    if name not in found:
        last = len(every) - 1
        raise InputError(f"{mechanism.name}: joint {joint!r} has the numbers {joint}[0] … [{last}], not {name!r}")
    return found[name]


def _of(mechanism, joint, rows):
    """The columns of a joint in rows (n, nv), or its only one."""
    found = rows[:, _part(mechanism, joint)]
    return found[:, 0] if found.shape[1] == 1 else found


def require_columns(mechanism, forces) -> None:
    """Raise InputError for `forces` of :meth:`Solution.to_csv` that are no loop, joint or force of the mechanism."""
    known = (*mechanism.joints, *(loop.name for loop in mechanism.loops))
    bound = bound_forces(mechanism.model, mechanism.forces)
    for name in forces:
        if name not in known:
            _element(mechanism, bound, name)


def element_units(mechanism, label) -> tuple[str, str, str]:
    """The units of force, length and speed of the element with this label."""
    turns = isinstance(_record(mechanism, label), Actuator) and _turns(mechanism, label)
    return ("N·m", "rad", "rad/s") if turns else ("N", "m", "m/s")


def torque_unit(mechanism, joint) -> str:
    """The unit of a torque on a joint of one degree of freedom."""
    return {"rad": "N·m", "m": "N"}[velocity_units(mechanism.model)[mechanism.columns(joint).start]]


def _record(mechanism, label):
    """The force of a mechanism with this label; None if it is one of the model itself."""
    at = list(bound_forces(mechanism.model, mechanism.forces)).index(label) - len(bound_forces(mechanism.model, ()))
    return mechanism.forces[at] if at >= 0 else None


def _turns(mechanism, label) -> bool:
    """Whether an actuator's joints turn."""
    joint = next(iter(_record(mechanism, label).arms))
    return velocity_units(mechanism.model)[mechanism.columns(joint).start] == "rad"


def joint_of(mechanism, label) -> str | None:
    """The only joint that the force with this label acts on, if it has one degree of freedom."""
    force, nvs = _record(mechanism, label), mechanism.model.nvs
    where = getattr(force, "_acts_on", "")
    given = (getattr(force, where) or ()) if where in ("joint", "joints", "coefficients", "torques") else ()
    joints = [given] if isinstance(given, str) else [*given]  # or an array of the velocities of all joints
    alone = len(joints) == 1 and isinstance(joints[0], str)
    return joints[0] if alone and nvs[mechanism.joint_index(joints[0])] == 1 else None
