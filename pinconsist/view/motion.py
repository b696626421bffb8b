"""The motion that is shown: solutions at even steps of playing time, and where that puts every body."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from math import ceil

import numpy as np
import pinocchio as pin

from ..errors import InputError
from ..mechanism.checks import finite_array
from ..mechanism.constraints.loops import Loop
from ..mechanism.mechanism import Mechanism

MAX_FRAMES = 3000
log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Run:
    """A solution to be shown, checked; ``elapsed`` counts from its first row, forward or backward in time."""

    title: str
    mech: Mechanism
    elapsed: np.ndarray  # (n,), s, never falling
    t: np.ndarray  # (n,)
    q: np.ndarray  # (n, nq)
    lam: np.ndarray | None = None  # (n, nc), where they were asked for
    v: np.ndarray | None = None  # (n, nv), where they were asked for

    @classmethod
    def of(cls, mech: Mechanism, sol, title: str = "", *, needs=()) -> Run:
        """The run of a solution.

        Parameters
        ----------
        mech : Mechanism
            Whose configurations they are.
        sol : object
            With ``t``, shape (n,), s, monotone, steps of any size, and ``q``, shape (n, nq).
        title : str
            By which it is told from others.
        needs : sequence of str
            What else is needed: ``lam``, shape (n, nc), and ``v``, shape (n, nv).

        Raises
        ------
        InputError
            Not a solution of this mechanism: sizes that do not fit, times that run both ways, numbers that are not
            finite.
        """
        if not isinstance(mech, Mechanism):
            raise InputError(f"a replay needs a Mechanism, got {type(mech).__name__}")
        absent = [name for name in ("t", "q", *needs) if not hasattr(sol, name)]
        if absent:
            raise InputError(f"a replay of {mech.name!r} needs a solution; {type(sol).__name__} has no {absent[0]}")
        t, q = finite_array(sol.t, "the solution's t"), finite_array(sol.q, "the solution's q")
        if t.ndim != 1 or not t.size or q.shape != (t.size, mech.nq):
            raise InputError(
                f"a replay of {mech.name!r} needs t of shape (n,), n ≥ 1, and q of shape (n, {mech.nq}); "
                f"got {t.shape} and {q.shape}"
            )
        more = {name: finite_array(getattr(sol, name), f"the solution's {name}") for name in needs}
        for name, array in more.items():
            shape = (t.size, mech.nc if name == "lam" else mech.nv)
            if array.shape != shape:
                raise InputError(f"forces of {mech.name!r} need {name} of shape {shape}, got {array.shape}")
        elapsed = np.abs(t - t[0])
        if np.any(np.diff(elapsed) < 0):
            raise InputError("the solution's times run both forward and backward")
        return cls(title, mech, elapsed, t, q, **more)

    def at(self, elapsed: np.ndarray) -> Run:
        """The run at other times, shape (m,); at rest after its end. Configurations follow the manifold."""
        if self.t.size == 1:
            rows = np.zeros(len(elapsed), int)
            return Run(self.title, self.mech, elapsed, *(_rows(x, rows) for x in (self.t, self.q, self.lam, self.v)))
        after = np.clip(np.searchsorted(self.elapsed, elapsed, side="right"), 1, self.t.size - 1)
        step = self.elapsed[after] - self.elapsed[after - 1]
        share = np.where(step > 0, (elapsed - self.elapsed[after - 1]) / np.where(step > 0, step, 1.0), 1.0).clip(0, 1)
        pairs = zip(self.q[after - 1], self.q[after], share, strict=True)
        q = np.array([pin.interpolate(self.mech.model, *pair) for pair in pairs])
        t, lam, v = (
            None if x is None else x[after - 1] + (share * (x[after] - x[after - 1]).T).T
            for x in (self.t, self.lam, self.v)
        )
        return Run(self.title, self.mech, elapsed, t, q, lam, v)


def _rows(array, rows):
    return None if array is None else array[rows]


def playing_times(runs, speed: float, fps: float) -> np.ndarray:
    """Even steps of playing time, s, from 0 to the end of the longest run, shape (m,).

    Parameters
    ----------
    runs : sequence of Run
        What is played.
    speed : float
        Seconds of motion per second of playing.
    fps : float
        Frames per second of playing; lowered where the motion would have more than 3000 frames.

    Raises
    ------
    InputError
        `speed` or `fps` not positive.
    """
    for name, value in (("speed", speed), ("fps", fps)):
        if isinstance(value, str) or not (np.isfinite(value) and value > 0):
            raise InputError(f"{name} needs a positive number, got {value!r}")
    duration = max(run.elapsed[-1] for run in runs) / speed
    frames = ceil(duration * fps * (1 - 1e-12)) + 1
    if frames > MAX_FRAMES:
        name = runs[0].mech.name
        log.info("replay of %s: %.4g frames per second instead of %g", name, (MAX_FRAMES - 1) / duration, fps)
        frames = MAX_FRAMES
    return np.linspace(0.0, duration, frames)


def anchors(model: pin.Model, loop: Loop) -> tuple[tuple[int, pin.SE3], tuple[int, pin.SE3]]:
    """Joint and placement on it of both anchors of a loop."""
    pairs = ((loop.frame1, loop.placement1), (loop.frame2, loop.placement2))
    frames = [(model.frames[model.getFrameId(name)], offset) for name, offset in pairs]
    first, second = ((frame.parentJoint, frame.placement * offset) for frame, offset in frames)
    return first, second


def body_poses(model: pin.Model, q: np.ndarray) -> np.ndarray:
    """World poses of all joints, the ground first: position and quaternion x y z w, shape (n, njoints, 7)."""
    data = model.createData()
    poses = np.empty((len(q), model.njoints, 7))
    for row, configuration in zip(poses, q, strict=True):
        pin.forwardKinematics(model, data, configuration)
        for joint, pose in enumerate(data.oMi):
            row[joint] = pin.SE3ToXYZQUAT(pose)
    return poses


def in_world(pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points of a body, shape (k, 3) or (n, k, 3), under its poses, shape (n, 7): shape (n, k, 3)."""
    points = np.asarray(points, float)
    axis, w = pose[:, None, 3:6], pose[:, None, 6:7]
    turn = 2 * np.cross(axis, points)
    return pose[:, None, :3] + points + w * turn + np.cross(axis, turn)


def bar_poses(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Poses, shape (n, 7), of a bar along its own y axis, centred between points `start` and `end`, shape (n, 3)."""
    poses = np.empty((len(start), 7))
    poses[:, :3] = (start + end) / 2
    for pose, along in zip(poses, end - start, strict=True):
        pose[3:] = turn_from_y(along).coeffs()
    return poses


def turn_from(axis, along: np.ndarray) -> pin.Quaternion:
    """The smallest rotation that takes an axis of unit length to a direction; none where there is no direction."""
    axis, length = np.array(axis, float), np.linalg.norm(along)
    return pin.Quaternion.FromTwoVectors(axis, along / length if length else axis)


def turn_from_y(along: np.ndarray) -> pin.Quaternion:
    """The rotation that takes the y axis, along which three.js builds cylinders, to a direction."""
    return turn_from((0, 1, 0), along)
