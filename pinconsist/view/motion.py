"""The motion that is shown: checked solutions at even steps of playing time, and the poses of all bodies."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import ceil
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from ..errors import InputError, PinconsistError
from ..mechanism.checks import finite_array, number, require_mechanism
from ..mechanism.forces import Actuator, JointTorque, Servo, SpringDamper, Wrench
from ..mechanism.forces.actuators import replayed
from ..mechanism.forces.held import Held
from ..mechanism.lie import interpolate
from ..mechanism.loops import Loop
from ..mechanism.mechanism import Mechanism
from ..mechanism.rows import Workspace
from .filled import Arrays, as_solution, is_continuous, only

MAX_FRAMES = 3000
log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Run:
    """A checked solution of a mechanism."""

    mech: Mechanism
    title: str
    consistency: str  # of the initial values; empty if not known
    elapsed: np.ndarray  # (n,), s, since the first row, forward or backward in time; not decreasing
    t: np.ndarray  # (n,)
    q: np.ndarray  # (n, nq)
    source: Any = None  # the solution
    lam: np.ndarray | None = None  # (n, nc), if the solution has them
    v: np.ndarray | None = None  # (n, nv), if it has them
    true: Run | None = None  # the run with which it is compared

    @classmethod
    def of(cls, mech: Mechanism, sol, title: str = "", *, forces: bool = False) -> Run:
        """The run of a solution; InputError for one that does not fit its mechanism."""
        require_mechanism(mech, "a replay")
        given, sol = sol, as_solution(sol)
        mech = _as_simulated(mech, sol)
        if forces or sol.held:
            mech = replayed(mech, sol)
        columns = _columns(mech, given, forces)
        t = columns["t"]
        elapsed = np.abs(t - t[0])
        if np.any(np.diff(elapsed) < 0):
            raise InputError("the solution's times run both forward and backward")
        return cls(mech, title, sol.method.get("consistency", ""), elapsed, source=sol, **columns)

    def workspace(self) -> Workspace:
        """The workspace for measurements: that of the solution, which may evaluate all rows at once."""
        return Workspace(self.mech.model) if self.is_bare else self.source._workspace(self.mech.model)

    @property
    def is_bare(self) -> bool:
        """Whether it is no Solution, but arrays only."""
        return isinstance(self.source, Arrays)

    def at(self, elapsed: np.ndarray) -> Run:
        """The run at other times, shape (m,), in order; at rest after its end.

        States between the rows are those of :meth:`pinconsist.Solution.at`; other results, and those with exact
        initial values, whose wrong forces are shown as they are, are interpolated on the configuration manifold.
        """
        joined, found = self._joined(elapsed), self._states(elapsed) if self.continuous else None
        return joined if found is None else replace(joined, q=found.q, v=found.v, lam=found.lam)

    @property
    def continuous(self) -> bool:
        """Whether the states between the rows can be computed."""
        return is_continuous(self.source)

    @property
    def scene_of_file(self) -> Mechanism | None:
        """The mechanism, if the solution has none."""
        return self.mech if self.source.mechanism is None else None

    def _states(self, elapsed):
        """The solution at other times; None if it cannot be computed there."""
        way = elapsed.clip(0.0, self.elapsed[-1])
        t = self.t[0] + (way if self.t[-1] >= self.t[0] else -way)
        try:
            return self.source.at(t.clip(min(self.t[0], self.t[-1]), max(self.t[0], self.t[-1])), self.scene_of_file)
        except PinconsistError as error:
            log.warning(
                "%s: rows are joined by straight lines, as states between them are missing: %s", self.mech.name, error
            )
            return None

    def _joined(self, elapsed: np.ndarray) -> Run:
        after = np.searchsorted(self.elapsed, elapsed, side="right").clip(1, self.t.size - 1)  # 0 for a single row
        before = np.maximum(after - 1, 0)
        step = self.elapsed[after] - self.elapsed[before]
        share = np.divide(elapsed - self.elapsed[before], step, out=np.ones(len(step)), where=step > 0).clip(0, 1)
        pairs = zip(self.q[before], self.q[after], share, strict=True)
        q = np.array([interpolate(self.mech.model, *pair) for pair in pairs])

        others = self._each(lambda x: x[before] + (share * (x[after] - x[before]).T).T)
        return replace(self, **others | {"elapsed": elapsed, "q": q}, true=self.true and self.true.at(elapsed))

    def rows(self, rows: np.ndarray) -> Run:
        return replace(self, **self._each(lambda x: x[rows]), true=self.true and self.true.rows(rows))

    def _each(self, change) -> dict:
        names = [name for name in ("elapsed", "t", "q", "lam", "v") if getattr(self, name) is not None]
        return {name: change(getattr(self, name)) for name in names}


def accelerations_of(run: Run) -> np.ndarray | None:
    """The accelerations at the rows of a run, (n, nv); None if they cannot be computed."""
    if run.v is None or run.lam is None or run.is_bare:
        return None
    try:
        rows = only(run.source, slice(0, 0))
        return replace(rows, t=run.t, q=run.q, v=run.v, lam=run.lam).acceleration(None, run.mech)
    except PinconsistError:
        return None


def without_forces(run: Run) -> str:
    """Why what needs the forces of the run is not known; empty if it is."""
    if run.is_bare:
        return ""
    try:
        only(run.source, slice(0, 1)).acceleration(None, run.mech)
    except InputError as error:
        return str(error)
    except PinconsistError:  # a singular configuration
        return ""
    return ""


def motors(mech: Mechanism) -> list:
    """The servos, actuators and joint torques of a mechanism, whose torques depend on the velocity."""
    return [force for force in mech.forces if isinstance(force, JointTorque | Servo | Actuator | Held)]


def _columns(mech: Mechanism, sol, forces: bool) -> dict[str, np.ndarray]:
    """The times of a solution, its positions, and multipliers and velocities: those that `forces` need, others if any.

    Raises InputError if what is needed is missing, not finite or of another shape.
    """
    needs = f"a replay of {mech.name!r} needs"
    widths = {"q": mech.nq}
    if forces:
        widths |= {"lam": len(mech.row_labels)} | ({"v": mech.nv} if motors(mech) else {})
    for name in ("t", *widths):
        if not hasattr(sol, name):
            raise InputError(f"{needs} a solution; {type(sol).__name__} has no {name}")
    found = {name: finite_array(getattr(sol, name), f"the solution's {name}") for name in ("t", *widths)}
    rows = found["t"].shape
    if len(rows) != 1 or rows == (0,):
        raise InputError(f"{needs} t of shape (n,), n ≥ 1, got {rows}")
    for name, width in widths.items():
        if found[name].shape != (*rows, width):
            raise InputError(f"{needs} {name} of shape ({rows[0]}, {width}), got {found[name].shape}")
    for name, width in {"lam": len(mech.row_labels), "v": mech.nv}.items():  # for curves, if they can be used
        values = np.asarray(getattr(sol, name, np.nan))
        if name not in found and values.shape == (*rows, width) and np.isfinite(values).all():
            found[name] = values
    return found


def _as_simulated(mech: Mechanism, sol) -> Mechanism:
    """The mechanism with the forces of the run, those given to :func:`pinconsist.simulate` included."""
    own = sol.mechanism
    if own is None or (own.nq, own.nv, own.nc) != (mech.nq, mech.nv, mech.nc):
        return mech
    return mech if own.forces is mech.forces else replace(mech, forces=own.forces)


def runs_of(mech, sol, *, forces: bool = False) -> list[Run]:
    """The runs that are shown, from left to right; parameters and errors as in :func:`pinconsist.export_html`.

    Without titles, several runs are named by consistency if it differs, else by mechanism, else by a number.
    """
    several = sol.values() if isinstance(sol, Mapping) else sol
    sols = list(several) if isinstance(sol, Mapping | list | tuple) else [sol]
    if not sols:
        raise InputError("nothing to show: the list of solutions is empty")
    mechs = list(mech) if isinstance(mech, list | tuple) else [mech] * len(sols)
    if len(mechs) != len(sols):
        raise InputError(f"{len(mechs)} mechanisms for {len(sols)} solution(s): give one for all, or one for each")
    runs = [Run.of(*each, forces=forces) for each in zip(mechs, sols, strict=True)]
    if isinstance(sol, Mapping):
        titles = [str(title) for title in sol]
    elif len(runs) == 1:
        return runs
    else:
        choices = ([run.consistency for run in runs], [run.mech.name for run in runs])
        numbers = [str(k + 1) for k in range(len(runs))]
        titles = next((names for names in choices if all(names) and len(set(names)) == len(names)), numbers)
    return [replace(run, title=title) for run, title in zip(runs, titles, strict=True)]


def playing_times(runs, speed: float, fps: float) -> np.ndarray:
    """Equidistant playing times, s, from 0 to the end of the longest run, shape (m,), with m at most `MAX_FRAMES`."""
    speed, fps = number(speed, "speed", above=0.0), number(fps, "fps", above=0.0)
    duration = max(run.elapsed[-1] for run in runs) / speed
    frames = ceil(duration * fps * (1 - 1e-12)) + 1
    if frames > MAX_FRAMES:
        name, lower = runs[0].mech.name, (MAX_FRAMES - 1) / duration
        log.info("replay of %s: %.4g frames per second instead of %g", name, lower, fps)
    return np.linspace(0.0, duration, min(frames, MAX_FRAMES))


def on_joint(model: pin.Model, frame: str, offset: pin.SE3 | None = None) -> tuple[int, pin.SE3]:
    """Joint, and placement on it, of a point or pose with an offset from a frame."""
    found = model.frames[model.getFrameId(frame)]
    return found.parentJoint, found.placement if offset is None else found.placement * offset


def force_points(mech: Mechanism) -> list[tuple[int, np.ndarray]]:
    """Joint, and point on it, of the ends of springs and of the points of wrenches."""
    places = []
    for force in mech.forces:
        if isinstance(force, SpringDamper):
            places += [(force.frame1, force.xyz1), (force.frame2, force.xyz2)]
        elif isinstance(force, Wrench):
            places.append((force.frame, force.xyz))
    found = [on_joint(mech.model, frame, pin.SE3(np.eye(3), np.array(xyz, float))) for frame, xyz in places]
    return [(joint, place.translation) for joint, place in found]


def anchors(model: pin.Model, *loops: Loop) -> list[tuple[int, pin.SE3]]:
    """Joint, and placement on it, of both anchors of each loop."""
    pairs = (pair for a in loops for pair in ((a.frame1, a.placement1), (a.frame2, a.placement2)))
    return [on_joint(model, *pair) for pair in pairs]


def joint_axis(model: pin.Model, joint: int) -> tuple[np.ndarray | None, bool]:
    """Axis, shape (3,), of a joint of one degree of freedom, and whether it turns about it; None for other joints."""
    if model.nvs[joint] != 1:
        return None, False
    slides, turns = np.reshape(model.joints[joint].createData().S, (2, 3))
    return (turns, True) if turns.any() else (slides, False)


def body_poses(model: pin.Model, q: np.ndarray) -> np.ndarray:
    """World poses of all joints, the ground first: position and quaternion x y z w, shape (n, njoints, 7)."""
    data = model.createData()
    poses = np.empty((len(q), model.njoints, 7))
    for row, configuration in zip(poses, q, strict=True):
        pin.forwardKinematics(model, data, configuration)
        row[:] = [pin.SE3ToXYZQUAT(pose) for pose in data.oMi]
    return poses


def in_world(pose: np.ndarray, points) -> np.ndarray:
    """Points of a body, shape (k, 3) or (n, k, 3), under its poses, shape (n, 7): shape (n, k, 3)."""
    turn = Rotation.from_quat(pose[:, 3:]).as_matrix()
    return pose[:, None, :3] + np.asarray(points, float) @ turn.transpose(0, 2, 1)


def point_in_world(poses: np.ndarray, joint: int, point) -> np.ndarray:
    """One point of a joint's body over the motion, shape (n, 3); `poses` of shape (n, njoints, 7)."""
    return in_world(poses[:, joint], [point])[:, 0]


def bar_poses(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Poses, shape (n, 7), of a bar along its own y axis, centred between points `start` and `end`, shape (n, 3)."""
    return np.hstack(((start + end) / 2, [rotation_to(along).coeffs() for along in end - start]))


def rotation_to(along, axis=(0.0, 1.0, 0.0)) -> pin.Quaternion:
    """The smallest rotation that takes an axis, by default that of three.js's cylinders, to a direction (or zero)."""
    axis, along = np.array(axis, float), np.asarray(along, float)
    length = np.linalg.norm(along)
    return pin.Quaternion.FromTwoVectors(axis, along / length if length else axis)
