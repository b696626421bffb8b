"""The motion that is shown: a solution at even steps of playing time, and where that puts every body."""

from __future__ import annotations

import logging
from math import ceil

import numpy as np
import pinocchio as pin

from ..errors import InputError
from ..mechanism.loops import Loop
from ..mechanism.mechanism import Mechanism, finite_array

MAX_FRAMES = 3000
log = logging.getLogger(__name__)


def resample(mech: Mechanism, sol, speed: float, fps: float) -> tuple[np.ndarray, np.ndarray]:
    """Configurations at even steps of playing time, interpolated on the manifold.

    The frames follow the rows of the solution: a solution that runs backward in time is shown backward.

    Parameters
    ----------
    mech : Mechanism
        Whose configurations they are.
    sol : object
        With ``t``, shape (n,), s, monotone, steps of any size, and ``q``, shape (n, nq).
    speed : float
        Seconds of motion per second of playing.
    fps : float
        Frames per second of playing; lowered where the motion would have more than 3000 frames.

    Returns
    -------
    clock : ndarray, shape (m,)
        Playing time, s, from 0.
    q : ndarray, shape (m, nq)

    Raises
    ------
    InputError
        Sizes that do not fit, times that run both ways, numbers that are not finite, `speed` or `fps` not positive.
    """
    for name, value in (("speed", speed), ("fps", fps)):
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"{name} needs a positive number, got {value!r}")
    t, q = finite_array(sol.t, "the solution's t"), finite_array(sol.q, "the solution's q")
    if t.ndim != 1 or not t.size or q.shape != (t.size, mech.nq):
        raise InputError(
            f"a replay of {mech.name!r} needs t of shape (n,), n ≥ 1, and q of shape (n, {mech.nq}); "
            f"got {t.shape} and {q.shape}"
        )
    elapsed = np.abs(t - t[0])
    if np.any(np.diff(elapsed) < 0):
        raise InputError("the solution's times run both forward and backward")
    duration = elapsed[-1] / speed
    frames = ceil(duration * fps * (1 - 1e-12)) + 1
    if frames > MAX_FRAMES:
        log.info("replay of %s: %.4g frames per second instead of %g", mech.name, (MAX_FRAMES - 1) / duration, fps)
        frames = MAX_FRAMES
    clock = np.linspace(0.0, duration, frames)
    after = np.clip(np.searchsorted(elapsed, clock * speed, side="right"), 1, max(t.size - 1, 1))
    rows = [_between(mech.model, elapsed, q, k, now) for k, now in zip(after, clock * speed, strict=True)]
    return clock, np.array(rows)


def _between(model, elapsed, q, k, now):
    if elapsed.size == 1:
        return q[0]
    step = elapsed[k] - elapsed[k - 1]
    share = min(max((now - elapsed[k - 1]) / step, 0.0), 1.0) if step > 0 else 1.0
    return pin.interpolate(model, q[k - 1], q[k], share)


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


def turn_from_y(along: np.ndarray) -> pin.Quaternion:
    """The rotation that takes the y axis, along which three.js builds cylinders, to a direction."""
    length = np.linalg.norm(along)
    return pin.Quaternion.FromTwoVectors(np.array([0.0, 1.0, 0.0]), along / length if length else np.eye(3)[1])
