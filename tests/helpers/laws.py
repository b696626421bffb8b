"""The laws of forces, written once more from their definitions, by Pinocchio's frames: torques to compare with."""

from collections.abc import Mapping

import numpy as np
import pinocchio as pin

import pinconsist as pc
from pinconsist.mechanism.forces import bound_force, label_of, model_forces


def torques_by_hand(mech, t, q, v):
    """τ of all forces of a mechanism, those of its model included."""
    forces = (*model_forces(mech.model), *mech.forces)
    return sum((torque_by_hand(force, mech.model, t, q, v) for force in forces), np.zeros(mech.nv))


def torque_by_hand(record, model, t, q, v):
    """τ of a record; by its law if that is in Python."""
    if _is_in_python(record):
        return bound_force(model, record, label_of(record)).torque(t, q, v)
    return LAWS[type(record)](record, model, t, q, v)


def derivatives_by_hand(record, model, t, q, v):
    """(∂τ/∂q, ∂τ/∂v) by differences of these; by its law if that is in Python."""
    step, every = 1e-3, np.eye(model.nv)
    if _is_in_python(record):
        parts = bound_force(model, record, label_of(record)).derivatives(t, q, v)
        return tuple(0.0 * every if part is None else part for part in parts)

    def slope(of):
        return (8.0 * (of(step) - of(-step)) - (of(2.0 * step) - of(-2.0 * step))) / (12.0 * step)

    by_q = [slope(lambda s, e=e: torque_by_hand(record, model, t, pin.integrate(model, q, s * e), v)) for e in every]
    by_v = [slope(lambda s, e=e: torque_by_hand(record, model, t, q, v + s * e)) for e in every]
    return np.column_stack(by_q), np.column_stack(by_v)


def stored_by_hand(record, model, q, v):
    """The elastic energy of a record and its rate, by differences along the motion; by its law if that is in Python."""
    if _is_in_python(record):
        law = bound_force(model, record, label_of(record))
        return law.stored(q, v) if law.stores else (0.0, 0.0)

    def energy(s):
        there = pin.integrate(model, q, s * v)
        if isinstance(record, pc.JointSpring):
            i = model.getJointId(record.joint)
            unit = pc.JointSpring(record.joint, 1.0, record.rest)
            return 0.5 * record.stiffness * _joint_spring(unit, model, 0.0, there, 0.0 * v)[model.idx_vs[i]] ** 2
        if isinstance(record, pc.SpringDamper):
            ends = (record.frame1, record.xyz1), (record.frame2, record.xyz2)
            x1, x2 = (_frame(model, frame, xyz, there)[0] for frame, xyz in ends)
            return 0.5 * record.stiffness * (np.linalg.norm(x2 - x1) - record.length) ** 2
        return 0.0

    h = 1e-3 / (1.0 + np.abs(v).max(initial=0.0))
    rate = (8.0 * (energy(h) - energy(-h)) - (energy(2.0 * h) - energy(-2.0 * h))) / (12.0 * h)
    return energy(0.0), rate


def _is_in_python(record):
    """Whether the engine asks Python for its law: it has no other spring than those of one joint."""
    if isinstance(record, pc.JointSpring):
        return not (isinstance(record.joint, str) and isinstance(record.rest, float))
    return type(record) not in LAWS


def _at(curve, t):
    return np.asarray(curve(t) if callable(curve) else curve, float)


def _columns(model, joint):
    i = model.getJointId(joint)
    return slice(model.idx_vs[i], model.idx_vs[i] + model.nvs[i])


def _angle(model, joint, q):
    i = model.getJointId(joint)
    at = model.idx_qs[i]
    return q[at] if model.nqs[i] == 1 else np.arctan2(q[at + 1], q[at])


def _spread(values, model):
    """A number of each velocity, of a mapping joint → numbers or a sequence."""
    if not isinstance(values, Mapping):
        return np.asarray(values, float)
    every = np.zeros(model.nv)
    for joint, value in values.items():
        every[_columns(model, joint)] = value
    return every


def _damping(record, model, t, q, v):
    return -_spread(record.coefficients, model) * v


def _friction(record, model, t, q, v):
    return -_spread(record.coefficients, model) * np.tanh(v / record.width)


def _torque(record, model, t, q, v):
    if not isinstance(record.torques, Mapping):
        return np.asarray(record.torques, float)
    return _spread({joint: _at(curve, t) for joint, curve in record.torques.items()}, model)


def _pull(model, joint, stiffness, damping, target, rate, q, v):
    tau, column = np.zeros(model.nv), _columns(model, joint)
    gap = target - _angle(model, joint, q)
    if model.nqs[model.getJointId(joint)] == 2:
        gap = (gap + np.pi) % (2.0 * np.pi) - np.pi
    tau[column] = stiffness * gap + damping * (rate - v[column])
    return tau


def _joint_spring(record, model, t, q, v):
    return _pull(model, record.joint, record.stiffness, record.damping, record.rest, 0.0, q, v)


def _servo(record, model, t, q, v):
    rate, h = 0.0, 1e-3
    if callable(record.target):
        f = record.target
        rate = (
            record.target.rate(t)
            if isinstance(f, pc.Motion)
            else (8.0 * (f(t + h) - f(t - h)) - (f(t + 2.0 * h) - f(t - 2.0 * h))) / (12.0 * h)
        )
    return _pull(model, record.joint, record.stiffness, record.damping, _at(record.target, t), rate, q, v)


def _frame(model, name, xyz, q):
    """Position, axes, and Jacobians of velocity and spin, in world axes, of a point of a frame."""
    data = model.createData()
    pin.computeJointJacobians(model, data, q)
    frame = model.frames[model.getFrameId(name)]
    pose = frame.placement * pin.SE3(np.eye(3), np.array(xyz, float))
    J = pin.getFrameJacobian(model, data, frame.parentJoint, pose, pin.LOCAL_WORLD_ALIGNED)
    where = data.oMi[frame.parentJoint] * pose
    return where.translation, where.rotation, J[:3], J[3:]


def _spring(record, model, t, q, v):
    x1, _, J1, _ = _frame(model, record.frame1, record.xyz1, q)
    x2, _, J2, _ = _frame(model, record.frame2, record.xyz2, q)
    length = np.linalg.norm(x2 - x1)
    along = (x2 - x1) / length @ (J2 - J1)
    return -(record.stiffness * (length - record.length) + record.damping * along @ v) * along


def _wrench(record, model, t, q, v):
    _, R, J, spin = _frame(model, record.frame, record.xyz, q)
    turn = R if record.axes == "local" else np.eye(3)
    return (turn @ _at(record.force, t)) @ J + (turn @ _at(record.moment, t)) @ spin


def _actuator(record, model, t, q, v):
    low, high = record.control_range or (-np.inf, np.inf)
    command = np.clip(_at(record.control, t), low, high)
    length = sum(arm * _angle(model, joint, q) for joint, arm in record.arms.items())
    arms = _spread(record.arms, model)
    force = (np.array(record.gain) * command + np.array(record.bias)) @ (1.0, length, arms @ v)
    low, high = record.force_range or (-np.inf, np.inf)
    return arms * np.clip(force, low, high)


LAWS = {
    pc.JointDamping: _damping,
    pc.JointFriction: _friction,
    pc.JointTorque: _torque,
    pc.JointSpring: _joint_spring,
    pc.Servo: _servo,
    pc.SpringDamper: _spring,
    pc.Wrench: _wrench,
    pc.Actuator: _actuator,
}
