"""The equations of motion of a mechanism, from its records and Pinocchio's primitives alone.

Nothing of the package's systems, rows, forces or charts is used: constraints are made of three kinds of rows, written
in world axes, and configurations move by the kinematics of their quaternions and (cos, sin) pairs.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial
from math import atan2, cos, pi, remainder, sin, tanh

import numpy as np
import pinocchio as pin

import pinconsist as pc


@dataclass(frozen=True)
class OnLine:
    """A point of a body on a line that is fixed in the world or swings: Φ of a constraint of the user's own."""

    model: pin.Model
    frame: str
    xyz: np.ndarray
    origin: np.ndarray
    across: np.ndarray  # (k, 3): directions along which the point stays where the origin is
    sway: np.ndarray  # the origin moves by sway·sin(rate·t)
    rate: float

    @cached_property
    def data(self):
        return self.model.createData()

    def __call__(self, t, q):
        pin.framesForwardKinematics(self.model, self.data, q)
        place = self.data.oMf[self.model.getFrameId(self.frame)].act(self.xyz)
        return self.across @ (place - self.origin - self.sway * sin(self.rate * t))


class Curve:
    """A Motion as a plain function of time, which the package has to differentiate by itself."""

    def __init__(self, motion: pc.Motion):
        self.motion = motion

    def __call__(self, t):
        return self.motion(t)


class Drag:
    """A user's torque: -c |v| v."""

    def __init__(self, coefficient):
        self.coefficient = coefficient

    def __call__(self, t, q, v):
        return -self.coefficient * np.abs(v) * v


class _Anchor:
    """A point of a body with axes of its own, and how both move."""

    def __init__(self, model, frame, place):
        frame = model.frames[model.getFrameId(frame)]
        self.model, self.joint, self.place = model, frame.parentJoint, frame.placement * place
        self.x, self.R = self.place.translation, self.place.rotation
        self.J = self.spin = np.zeros((3, model.nv))
        self.v = self.a = np.zeros(3)
        self.W = self.bend = np.zeros((3, 3))  # of a vector fixed in the body: u' = W u, u'' = bend u

    def move(self, data):
        if not (joint := self.joint):
            return
        model, world = self.model, pin.LOCAL_WORLD_ALIGNED
        pose = data.oMi[joint]
        J = pin.getJointJacobian(model, data, joint, world).reshape(6, -1)
        speed, rise = (f(model, data, joint, world) for f in (pin.getVelocity, pin.getClassicalAcceleration))
        arm = pose.rotation @ self.place.translation
        self.W = pin.skew(speed.angular)
        self.bend = pin.skew(rise.angular) + self.W @ self.W
        self.x, self.R, self.spin = pose.translation + arm, pose.rotation @ self.place.rotation, J[3:]
        self.J = J[:3] - pin.skew(arm) @ self.spin
        self.v, self.a = speed.linear + self.W @ arm, rise.linear + self.bend @ arm


class _Loop:
    """Rows (Φ, J, Φ_t, γ with d²Φ/dt² = J v' + γ) of a loop between two anchors.

    `along` (3, k) are directions of body 1 in which the anchors do not part, `square` pairs of a direction of body 1
    and one of body 2 that stay perpendicular.
    """

    def __init__(self, model, loop):
        self.ends = [_Anchor(model, loop.frame1, loop.placement1), _Anchor(model, loop.frame2, loop.placement2)]
        self.length = loop.length
        if loop.kind == "distance":
            return
        e = np.array(loop.axis or (0.0, 0.0, 1.0)) / np.linalg.norm(loop.axis or 1.0)
        normal = np.linalg.svd(e[None, :])[2][1:]
        every, none = np.eye(3), np.zeros((0, 3))
        parallel = [(u, e) for u in normal]
        other = np.array(loop.axis2 or e)
        along, square = {
            "point": (every, []),
            "frame": (every, [(every[0], every[1]), (every[1], every[2]), (every[2], every[0])]),
            "hinge": (every, parallel),
            "slider": (normal, [(every[0], every[1]), (every[1], every[2]), (every[2], every[0])]),
            "cylinder": (normal, parallel),
            "plane": (e[None, :], parallel),
            "universal": (every, [(e, other)]),
        }[loop.kind]
        self.along = np.array(along).T
        self.square = [np.array(side).T for side in zip(*square, strict=True)] if square else [none.T, none.T]

    def __call__(self, data, t, q, v):
        first, second = self.ends
        for end in self.ends:
            end.move(data)
        d, J = second.x - first.x, second.J - first.J
        speed, rise = second.v - first.v, second.a - first.a
        if self.length:
            phi = (d @ d - self.length**2) / (2.0 * self.length)
            return [phi], (d @ J)[None, :] / self.length, [0.0], [(speed @ speed + d @ rise) / self.length]
        U = (first.R @ self.along).T
        W = first.W
        parts = [(U @ d, U @ (J + pin.skew(d) @ first.spin), U @ (rise - 2.0 * W @ speed + first.bend.T @ d))]
        B, C = first.R @ self.square[0], second.R @ self.square[1]
        turn = np.array([pin.skew(c) @ b for b, c in zip(B.T, C.T, strict=True)]).reshape(-1, 3)
        bias = ((first.bend @ B) * C + 2.0 * (W @ B) * (second.W @ C) + B * (second.bend @ C)).sum(axis=0)
        parts.append(((B * C).sum(axis=0), turn @ (second.spin - first.spin), bias))
        phi, J, bias = (np.concatenate(part) for part in zip(*parts, strict=True))
        return phi, J, np.zeros(len(phi)), bias


class _Line:
    """Rows of a point on a line."""

    def __init__(self, model, constraint):
        self.law = law = constraint.function
        self.end = _Anchor(model, law.frame, pin.SE3(np.eye(3), law.xyz))

    def __call__(self, data, t, q, v):
        law, end = self.law, self.end
        end.move(data)
        w = law.rate
        phi = law.across @ (end.x - law.origin - law.sway * sin(w * t))
        rate, bias = -law.across @ law.sway * (w * cos(w * t)), law.across @ (end.a + law.sway * w**2 * sin(w * t))
        return phi, law.across @ end.J, rate, bias


class _Coordinate:
    """Place of a joint of one freedom, and its value."""

    def __init__(self, model, joint):
        index = model.getJointId(joint)
        self.q, self.v, self.wraps = model.idx_qs[index], model.idx_vs[index], model.nqs[index] == 2

    def __call__(self, q):
        return atan2(q[self.q + 1], q[self.q]) if self.wraps else q[self.q]

    def gap(self, difference):
        return remainder(difference, 2.0 * pi) if self.wraps else difference


def _motion(curve, t):
    """A Motion and its two derivatives."""
    motion = getattr(curve, "motion", curve)
    if not isinstance(motion, pc.Motion):
        return float(motion), 0.0, 0.0
    w, size = 2.0 * pi * motion.frequency, motion.amplitude
    angle = w * t + motion.phase
    place = motion.start + motion.speed * t + size * sin(angle)
    return place, motion.speed + size * w * cos(angle), -size * w**2 * sin(angle)


class _Joints:
    """The row of a drive, or of a coupling."""

    def __init__(self, model, record):
        self.record, self.joint = record, _Coordinate(model, record.joint)
        self.J = np.zeros((1, model.nv))
        self.J[0, self.joint.v] = 1.0
        self.other = _Coordinate(model, record.other) if isinstance(record, pc.Coupling) else None

    def __call__(self, data, t, q, v):
        if self.other is None:
            place, rate, bend = _motion(self.record.curve, t)
            return [self.joint.gap(self.joint(q) - place)], self.J.copy(), [-rate], [-bend]
        law = np.polynomial.Polynomial([self.record.offset, self.record.ratio, *self.record.higher])
        x, speed, J = self.other(q), v[self.other.v], self.J.copy()
        J[0, self.other.v] = -law.deriv()(x)
        return [self.joint.gap(self.joint(q) - law(x))], J, [0.0], [-law.deriv(2)(x) * speed**2]


def _spread(model, values):
    """Values by joints as an array of the velocities."""
    full = np.zeros(model.nv)
    for joint, value in values.items():
        index = model.getJointId(joint)
        full[model.idx_vs[index] :][: model.nvs[index]] = value
    return full


def _spring(record, ends, data, t, q, v):
    first, second = ends
    for end in ends:
        end.move(data)
    d, J = second.x - first.x, second.J - first.J
    length = np.sqrt(d @ d)
    along = d @ J / length
    return -(record.stiffness * (length - record.length) + record.damping * (along @ v)) * along


def _wrench(record, end, data, t, q, v):
    end.move(data)
    R = end.R if record.axes == "local" else np.eye(3)
    return (R @ record.force) @ end.J + (R @ record.moment) @ end.spin


def _servo(record, joint, nv, data, t, q, v):
    place, rate, _ = _motion(getattr(record, "target", getattr(record, "rest", None)), t)
    tau = np.zeros(nv)
    tau[joint.v] = -record.stiffness * joint.gap(joint(q) - place)
    tau[joint.v] += getattr(record, "damping", 0.0) * (rate - v[joint.v])
    return tau


def rows_of(model, record):
    """(Φ, J, Φ_t, γ) of a loop's record, as a function of (data, t, q, v) where data has moved; d²Φ/dt² = J v' + γ."""
    if isinstance(record, pc.Drive | pc.Coupling):
        return _Joints(model, record)
    return _Line(model, record) if isinstance(record, pc.Constraint) else _Loop(model, record)


def force_of(model, record):
    """τ of a force's record, as a function of (data, t, q, v) where data has moved."""
    if isinstance(record, pc.JointDamping):
        damping = _spread(model, record.coefficients)
        return lambda data, t, q, v: -damping * v
    if isinstance(record, pc.JointFriction):
        friction = _spread(model, record.coefficients)
        return lambda data, t, q, v: -friction * np.array([tanh(x / record.width) for x in v])
    if isinstance(record, pc.JointTorque):
        return lambda data, t, q, v: _spread(model, {j: _motion(curve, t)[0] for j, curve in record.torques.items()})
    if isinstance(record, pc.JointSpring | pc.Servo):
        return partial(_servo, record, _Coordinate(model, record.joint), model.nv)
    if isinstance(record, pc.Torque):
        return lambda data, t, q, v: record.function(t, q, v)
    if isinstance(record, pc.Wrench):
        return partial(_wrench, record, _Anchor(model, record.frame, pin.SE3(np.eye(3), np.array(record.xyz))))
    if isinstance(record, pc.SpringDamper):
        ends = (record.frame1, record.xyz1), (record.frame2, record.xyz2)
        return partial(_spring, record, [_Anchor(model, end, pin.SE3(np.eye(3), np.array(xyz))) for end, xyz in ends])
    raise TypeError(f"no equations for {record!r}")
