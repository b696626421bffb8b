"""Loop closures: the rows Φ(q), J(q) that the records of :mod:`pinconsist.mechanism.loop` stand for.

This is the only file that names Pinocchio's constraint classes.

Conventions (stated here once)
------------------------------
A loop joins anchor 1 (on ``frame1``) to anchor 2 (on ``frame2``); either may sit on the ground, whose frame is
``"universe"``. With ``d`` the position of anchor 2 seen from anchor 1 **in the axes of anchor 1** and ``R`` the
rotation that takes axes of anchor 2 to axes of anchor 1, the rows are

========== ===== ============================================================== ============================
kind       rows  Φ                                                              λ (equations M v' + nle = τ + Jᵀλ)
========== ===== ============================================================== ============================
point      3     d                                                              force on body 2, N
frame      6     d, log R                                                       force and moment on body 2
hinge      5     d, chord between the two axes (two rows normal to the axis)    force, moment across the axis
distance   1     (|d|² − L²) / (2L)                                             force along d on body 2: λ < 0 pulls
drive      1     q_joint − curve(t)                                             motor torque on the joint
========== ===== ============================================================== ============================

all in the axes of anchor 1, acting on body 2 at anchor 2; body 1 receives the opposite. Forces are in N, moments
in N·m, Φ in m and rad. Every J is the exact derivative of Φ in the tangent space, also while a loop is open.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ..errors import InputError
from .drive import DriveRow
from .loop import GROUND, ROW_NAMES, Loop

__all__ = ["GROUND", "ROW_NAMES", "Loop", "LoopRows", "anchor_constraint", "similar"]


TURNING = ("rx", "ry", "rz", "tilt1", "tilt2", "motor")  # rows in rad; a drive is measured by its own joint


class LoopRows:
    """The rows of several loops on one model, evaluated together. Private to systems and assembly.

    Attributes
    ----------
    labels : list of (str, str)
        Loop name and row name of each of the ``nc`` rows.
    slices : dict[str, slice]
        The rows of each loop.
    """

    def __init__(self, model: pin.Model, loops):
        self.model, self.loops = model, tuple(loops)
        self.labels = [(loop.name, row) for loop in self.loops for row in loop.rows]
        self.nc = len(self.labels)
        self.slices, start = {}, 0
        for loop in self.loops:
            self.slices[loop.name] = slice(start, start := start + len(loop.rows))
        self.closures = [_KINDS[loop.kind](model, loop) for loop in self.loops]
        self.turns = np.array([row in TURNING for _, row in self.labels], dtype=bool)
        self.moving = any(closure.moving for closure in self.closures)

    def evaluate(self, data: pin.Data, q=None, t: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Φ, shape (nc,), and J, shape (nc, nv), where ``pin.computeJointJacobians`` was called last on ``data``.

        `q` and `t` are what the rows of drives look at.
        """
        if not self.closures:
            return np.zeros(0), np.zeros((0, self.model.nv))
        values, jacobians = zip(*(closure.evaluate(data, q, t) for closure in self.closures), strict=True)
        return np.concatenate(values), np.concatenate(jacobians)

    def time_rate(self, t: float) -> np.ndarray:
        """Φ_t, shape (nc,)."""
        parts = [closure.rate(t) if closure.moving else np.zeros(len(closure.loop.rows)) for closure in self.closures]
        return np.concatenate(parts) if parts else np.zeros(0)

    def acceleration_bias(self, data: pin.Data, t: float = 0.0) -> np.ndarray:
        """J̇ v + Φ_tt, shape (nc,), at a closed configuration.

        Needs ``pin.forwardKinematics(model, data, q, v, 0)`` on ``data``. The rotational rows use R = 1 where
        the exact expression has a derivative of the logarithm.
        """
        if not self.closures:
            return np.zeros(0)
        return np.concatenate([closure.acceleration_bias(data, t) for closure in self.closures])


class _Closure:
    """One loop on one model: anchors as (joint, placement) and Pinocchio's constraint for its kind."""

    rotates, moving = True, False

    def __init__(self, model: pin.Model, loop: Loop):
        self.model, self.loop = model, loop
        self.joint1, self.place1 = _anchor(model, loop, loop.frame1, loop.placement1)
        self.joint2, self.place2 = _anchor(model, loop, loop.frame2, loop.placement2)
        if self.joint1 == self.joint2:
            raise InputError(
                f"loop {loop.name!r}: frames {loop.frame1!r} and {loop.frame2!r} sit on the same body; "
                "a loop joins two bodies, or a body and the ground"
            )
        self.constraint = anchor_constraint(model, self, self.rotates)
        self.constraint_data = self.constraint.createData()

    def evaluate(self, data, q=None, t=0.0):
        """Φ and J of this loop."""
        self.constraint.calc(self.model, data, self.constraint_data)
        twist = self.constraint.jacobian(self.model, data, self.constraint_data)  # of body 2 relative to 1, in axes 1
        pose = self.constraint_data.c1Mc2
        d, R = pose.translation, pose.rotation
        linear = twist[:3] - pin.skew(d) @ twist[3:]  # the twist is taken at anchor 1, d at anchor 2
        return self.rows(d, R, linear, twist[3:])

    def acceleration_bias(self, data, t=0.0):
        """J̇ v of this loop, from the bodies' velocities and velocity-product accelerations."""
        p1, R1, v1, w1, a1, b1 = _anchor_motion(data, self.joint1, self.place1)
        p2, R2, v2, w2, a2, b2 = _anchor_motion(data, self.joint2, self.place2)
        r, rd = p2 - p1, v2 - v1
        W1 = pin.skew(w1)
        rdd = a2 - a1 - pin.skew(b1) @ r - 2 * W1 @ rd + W1 @ (W1 @ r)
        d, dd, ddd = R1.T @ r, R1.T @ (rd - W1 @ r), R1.T @ rdd
        spin = R1.T @ (w2 - w1)
        spin_rate = R1.T @ (b2 - b1 - W1 @ w2)
        return self.bias_rows(d, dd, ddd, R1.T @ R2, spin, spin_rate)


def anchor_constraint(model, closure, rotates: bool):
    """Pinocchio's constraint between the anchors of a closure: six rows if it rotates, else the three of a point."""
    kind = pin.FrameAnchorConstraintModel if rotates else pin.PointAnchorConstraintModel
    return kind(model, closure.joint1, closure.place1, closure.joint2, closure.place2)


def _anchor(model, loop, frame_name, offset):
    if not model.existFrame(frame_name):
        near = ", ".join(similar(frame_name, [frame.name for frame in model.frames]))
        raise InputError(
            f"loop {loop.name!r}: the model has no frame {frame_name!r}" + (f"; near it: {near}" if near else "")
        )
    if sum(frame.name == frame_name for frame in model.frames) > 1:
        raise InputError(f"loop {loop.name!r}: the model has several frames named {frame_name!r}")
    frame = model.frames[model.getFrameId(frame_name)]
    return frame.parentJoint, frame.placement * offset


def similar(name, names):
    import difflib

    return difflib.get_close_matches(str(name), sorted(set(names)), n=4, cutoff=0.5)


def _anchor_motion(data, joint, placement):
    """Position, axes, velocity, spin, classical acceleration and spin rate of an anchor, in world axes."""
    pose = data.oMi[joint] * placement
    if joint == 0:
        zero = np.zeros(3)
        return pose.translation, pose.rotation, zero, zero, zero, zero
    R = pose.rotation
    velocity, acceleration = placement.actInv(data.v[joint]), placement.actInv(data.a[joint])
    classical = acceleration.linear + pin.skew(velocity.angular) @ velocity.linear
    return pose.translation, R, R @ velocity.linear, R @ velocity.angular, R @ classical, R @ acceleration.angular


class _Point(_Closure):
    rotates = False

    def evaluate(self, data, q=None, t=0.0):
        self.constraint.calc(self.model, data, self.constraint_data)
        jacobian = self.constraint.jacobian(self.model, data, self.constraint_data)
        return np.array(self.constraint_data.constraint_position_error), jacobian  # a view until copied

    def bias_rows(self, d, dd, ddd, R, spin, spin_rate):
        return ddd


class _Distance(_Point):
    def evaluate(self, data, q=None, t=0.0):
        d, jacobian = super().evaluate(data)
        length = self.loop.length
        return np.array([(d @ d - length**2) / (2 * length)]), (d @ jacobian / length)[None, :]

    def bias_rows(self, d, dd, ddd, R, spin, spin_rate):
        return np.array([(dd @ dd + d @ ddd) / self.loop.length])


class _Frame(_Closure):
    def rows(self, d, R, linear, angular):
        angle = pin.log3(R)
        return np.concatenate((d, angle)), np.concatenate((linear, pin.Jlog3(R) @ R.T @ angular))

    def bias_rows(self, d, dd, ddd, R, spin, spin_rate):
        return np.concatenate((ddd, spin_rate))


class _Hinge(_Closure):
    """Tilt of the axis a = R e of body 2 against e, measured by the chord 2 sin(angle/2).

    The chord grows monotonically up to the antiparallel axis, so that this is no false solution; there its direction
    is undetermined, and within TURNED rad of it Φ and J are those at TURNED.
    """

    TURNED = 1e-6

    def __init__(self, model, loop):
        super().__init__(model, loop)
        self.e = np.array(loop.axis) / np.linalg.norm(loop.axis)
        u1 = np.cross(self.e, np.eye(3)[np.argmin(np.abs(self.e))])
        u1 /= np.linalg.norm(u1)
        across = np.array([u1, np.cross(self.e, u1)])  # tilt1 turns about its first row, tilt2 about its second
        self.w = np.cross(across, self.e)

    def rows(self, d, R, linear, angular):
        e, w, a = self.e, self.w, R @ self.e
        tilt = w @ a
        z = 1.0 + e @ a
        if z < 0.5:  # no cancellation: |tilt|² = (1 + e·a)(1 - e·a)
            size = np.linalg.norm(tilt)
            if size < self.TURNED:
                tilt = self.TURNED * (tilt / size if size else np.array([1.0, 0.0]))
            z = tilt @ tilt / (1.0 - e @ a)
        s = np.sqrt(2.0 / z)
        gradient = s * (w - np.outer(tilt, e) / (2 * z))
        return np.concatenate((d, s * tilt)), np.concatenate((linear, -gradient @ pin.skew(a) @ angular))

    def bias_rows(self, d, dd, ddd, R, spin, spin_rate):
        a = R @ self.e
        add = pin.skew(spin) @ (pin.skew(spin) @ a) + pin.skew(spin_rate) @ a
        return np.concatenate((ddd, self.w @ add))


_KINDS = {"point": _Point, "frame": _Frame, "hinge": _Hinge, "distance": _Distance, "drive": DriveRow}
