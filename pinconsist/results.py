"""The results of a run by the names of joints, frames and forces, and as a table."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from .accuracy import accelerations
from .errors import InputError, MissingExtraError
from .files import write_csv
from .mechanism.checks import frame_of, near, places, read_only
from .mechanism.energy import torques_of
from .mechanism.forces import bound_forces
from .mechanism.forces.held import sided
from .mechanism.joint_constraints import Drive
from .mechanism.loops import Loop
from .mechanism.mechanism import Mechanism
from .mechanism.names import position_names, position_units, velocity_names, velocity_units
from .mechanism.reactions import Reaction
from .mechanism.rows import LoopRows, Workspace


@dataclass(frozen=True, eq=False)
class JointMotion:
    """The motion of one joint over a run. Rows are those of the solution.

    Attributes
    ----------
    joint : str
        Its name, or that of one of its coordinates, ``ball[0]``.
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


class ByName:
    """The part of a solution that is read by the names of joints, frames, loops and forces.

    A solution read from a file needs the `mechanism` that was simulated, with the forces of the run.
    """

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    lam: np.ndarray
    system: Any
    reaction: Callable[..., Reaction]
    _mechanism: Callable[..., Mechanism]
    _workspace: Callable[..., Workspace]

    def position(self, joint: str, mechanism=None) -> np.ndarray:
        """The position of a joint, rad or m, shape (n,); (n, k) for a joint of several numbers, as `q` stores them.

        `joint` is a joint, or one of its numbers, ``"ball[0]"``. The angle of a joint that stores (cos, sin) is
        unwrapped: it has no jumps of 2π. `mechanism` is as in :meth:`check`. Raises InputError for other names.
        """
        mechanism = self._mechanism(mechanism, "position")
        model, part = mechanism.model, _part(mechanism, joint, positions=True)
        found = self.q[:, part]
        if found.shape[1] == 2 and model.nvs[mechanism.joint_index(joint)] == 1:
            return np.unwrap(np.arctan2(found[:, 1], found[:, 0]))
        return found[:, 0] if found.shape[1] == 1 else found

    def velocity(self, joint: str, mechanism=None) -> np.ndarray:
        """The velocity of a joint, rad/s or m/s, shape (n,); (n, k) for a joint of several.

        `joint` and `mechanism` are as in :meth:`position`.
        """
        return _of(self._mechanism(mechanism, "velocity"), joint, self.v)

    def acceleration(self, joint: str | None = None, mechanism=None) -> np.ndarray:
        """The acceleration of a joint, rad/s² or m/s², shape (n,); (n, k) for a joint of several; (n, nv) for all.

        It follows from the equations of motion at each row; `joint` and `mechanism` are as in :meth:`position`. Raises
        SingularSystemError if it is not determined.
        """
        mechanism = self._mechanism(mechanism, "acceleration")
        found = accelerations(mechanism, sided(self.t), self.q, self.v)
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
        loops = {loop.name: loop for loop in mechanism.loops if loop.kind in ("drive", "coupling")}
        if name in loops:
            row: int = LoopRows.of(mechanism).slices[name].start
            return self.lam[:, row]
        label = self._label(mechanism, name)
        joint, found = name if label is None else _joint_of(mechanism, label), self._acting(mechanism, label)
        return found if joint is None else _of(mechanism, joint, found)

    def power(self, name: str, mechanism=None) -> np.ndarray:
        """The power τ·v of a force, motor or drive, W, shape (n,), positive into the mechanism; springs included.

        `name` and `mechanism` are as in :meth:`torque`. Raises InputError for other names.
        """
        mechanism = self._mechanism(mechanism, "power")
        loops = {loop.name: loop for loop in mechanism.loops if not isinstance(loop, Loop)}
        if name in loops:
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
            loops = (loop.name for loop in mechanism.loops if loop.kind in ("drive", "coupling"))
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

    def to_dataframe(self, mechanism=None) -> Any:
        """A pandas DataFrame of the columns ``t``, ``q.crank``, ``v.crank``, ``a.crank`` and ``lam.loop.row``.

        Its ``attrs["units"]`` maps the columns to their units. `mechanism` is as in :meth:`check`. Raises
        MissingExtraError without pandas.
        """
        return _dataframe(*self._table(mechanism))

    def to_csv(self, file, mechanism=None) -> Path:
        """The path of the CSV `file`: the table of :meth:`to_dataframe`, units in the headings: ``v.crank [rad/s]``.

        It is written whole or not at all; `mechanism` is as in :meth:`check`. Raises OSError if that fails.
        """
        return write_csv(file, *self._table(mechanism))

    def _table(self, mechanism):
        """(names, units, values) of the columns."""
        general = mechanism is None and self.system is not None and not hasattr(self.system, "mechanism")
        values = [self.t[:, None], self.q, self.v, *([] if general else [None]), self.lam]
        if general:
            names = [f"{part}[{i}]" for part in ("q", "v", "lam") for i in range(getattr(self, part).shape[1])]
            return ["t", *names], ["s", *[""] * len(names)], np.hstack(values)
        mechanism = self._mechanism(mechanism, "to_csv")
        model, rows, values[3] = mechanism.model, mechanism.row_labels, self.acceleration(None, mechanism)
        names = ["t", *(f"q.{name}" for name in position_names(model))]
        names += [f"{part}.{name}" for part in "va" for name in velocity_names(model)]
        units = velocity_units(model)
        units = ["s", *position_units(model), *(f"{u}/s" for u in units), *(f"{u}/s²" for u in units)]
        units += LoopRows.of(mechanism).multiplier_units
        return names + [f"lam.{loop}.{row}" for loop, row in rows], units, np.hstack(values)


def _dataframe(names, units, values):
    try:
        import pandas as pd
    except ImportError:
        raise MissingExtraError("a DataFrame needs pandas; install it with: pip install 'pinconsist[pandas]'") from None
    frame = pd.DataFrame(values, columns=names)
    frame.attrs["units"] = dict(zip(names, units, strict=True))
    return frame


def _part(mechanism, name, positions=False) -> list[int]:
    """The columns of a joint, or of one of its numbers, in v, or in q."""
    joint = name if name in mechanism.joints else name.partition("[")[0]
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


def _joint_of(mechanism, label) -> str | None:
    """The only joint that the force with this label acts on, if it has one degree of freedom."""
    at = list(bound_forces(mechanism.model, mechanism.forces)).index(label) - len(bound_forces(mechanism.model, ()))
    force, nvs = mechanism.forces[at] if at >= 0 else None, mechanism.model.nvs
    where = getattr(force, "_acts_on", "")
    given = (getattr(force, where) or ()) if where in ("joint", "joints", "coefficients", "torques") else ()
    joints = [given] if isinstance(given, str) else [*given]  # or an array of the velocities of all joints
    alone = len(joints) == 1 and isinstance(joints[0], str)
    return joints[0] if alone and nvs[mechanism.joint_index(joints[0])] == 1 else None
