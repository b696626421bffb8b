"""Joints fixed where they stand, and what becomes of loops and forces then."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from ...errors import InputError
from ..constraints.coupling import Coupling
from ..constraints.custom import Constraint
from ..constraints.drive import Drive
from ..constraints.loop import Loop
from ..constraints.loops import LoopRows
from ..forces import JointDamping, JointFriction, JointSpring, JointTorque, Servo, SpringDamper, Torque, Wrench
from ..loop_solver import CLOSED
from ..mechanism import Mechanism
from .rebuild import rebuilt


def lock(mechanism: Mechanism, joints, q=None) -> Mechanism:
    """See :meth:`Mechanism.lock`."""
    if not (isinstance(joints, str) or hasattr(joints, "__iter__")):
        raise InputError(f"lock needs the name of a joint or several, got {joints!r}")
    joints = (joints,) if isinstance(joints, str) else tuple(joints)
    locked = {joint: mechanism.joint_index(joint) for joint in joints}
    if len(locked) == len(mechanism.joints):
        raise InputError(f"{mechanism.name}: with all its joints locked nothing can move")
    full = mechanism.guess if q is None else mechanism.configuration(q, base=mechanism.guess)
    model, data = mechanism.model, mechanism.model.createData()
    pin.forwardKinematics(model, data, full)
    poses = {joint: model.jointPlacements[i].actInv(data.liMi[i]) for joint, i in locked.items()}
    smaller = rebuilt(model, dict.fromkeys(locked, ()), poses)
    state = _Widened(model, locked.values(), full)
    loops = (_loop(loop, mechanism, smaller, locked, state) for loop in mechanism.loops)
    forces = (_force(force, smaller, locked, state) for force in mechanism.forces)
    return replace(
        mechanism,
        model=smaller,
        loops=tuple(loop for loop in loops if loop is not None),
        forces=tuple(force for force in forces if force is not None),
        guess=full[state.q_left],
        actuated=tuple(joint for joint in mechanism.actuated if joint not in locked),
    )


def _loop(loop, mechanism, smaller, locked, state):
    """The loop on the smaller model; None if it holds by itself; InputError where it cannot be kept."""
    if isinstance(loop, Loop):
        if _body(smaller, loop.frame1) != _body(smaller, loop.frame2):
            return loop
    elif isinstance(loop, Coupling):
        held = [joint for joint in (loop.joint, loop.other) if joint in locked]
        if not held:
            return loop
        if len(held) == 1:
            other = loop.other if held[0] == loop.joint else loop.joint
            raise InputError(
                f"{mechanism.name}: joint {held[0]!r} cannot be locked alone: coupling {loop.name!r} then holds "
                f"{other!r} too. Lock both"
            )
    elif isinstance(loop, Drive):
        if loop.joint not in locked:
            return loop
        raise InputError(
            f"{mechanism.name}: joint {loop.joint!r} cannot be locked, drive {loop.name!r} moves it; take the drive "
            "out first, by with_loops()"
        )
    else:
        return state.constraint(loop)
    data = mechanism.model.createData()
    pin.computeJointJacobians(mechanism.model, data, state.full)
    phi, _ = LoopRows(mechanism.model, [loop]).evaluate(data, state.full)
    gap = np.max(np.abs(phi))
    if gap > CLOSED:
        raise InputError(
            f"{mechanism.name}: with {', '.join(locked)} locked, loop {loop.name!r} would stay open by {gap:.3g} "
            "(m or rad). Lock the joints in a closed configuration, q = pinconsist.assemble(mechanism).q"
        )
    return None


def _body(model, frame):
    return model.frames[model.getFrameId(frame)].parentJoint


def _force(force, smaller, locked, state):
    """The force on the smaller model; None if it has nothing left to act on."""
    if isinstance(force, JointDamping | JointFriction):
        left = state.amounts(force.coefficients, locked)
        return replace(force, coefficients=left) if left else None
    if isinstance(force, JointTorque):
        left = state.amounts(force.torques, locked)
        return replace(force, torques=left) if left else None
    if isinstance(force, JointSpring | Servo):
        return None if force.joint in locked else force
    if isinstance(force, SpringDamper):
        return None if _body(smaller, force.frame1) == _body(smaller, force.frame2) else force
    if isinstance(force, Wrench):
        return None if _body(smaller, force.frame) == 0 else force
    return force if hasattr(force, "bind") else state.force(force)


class _Widened:
    """The whole state of a mechanism from that of the joints that are left; the others stand still."""

    def __init__(self, model, locked, full):
        left = [i for i in range(1, model.njoints) if i not in set(locked)]
        self.full, self.nv = full, model.nv
        self.q_left = [k for i in left for k in range(model.idx_qs[i], model.idx_qs[i] + model.nqs[i])]
        self.v_left = [k for i in left for k in range(model.idx_vs[i], model.idx_vs[i] + model.nvs[i])]

    def q(self, q):
        whole = self.full.copy()
        whole[self.q_left] = q
        return whole

    def v(self, v):
        whole = np.zeros(self.nv)
        whole[self.v_left] = v
        return whole

    def amounts(self, values, locked):
        if isinstance(values, Mapping):
            return {joint: value for joint, value in values.items() if joint not in locked}
        return tuple(values[i] for i in self.v_left)

    def constraint(self, constraint: Constraint) -> Constraint:
        functions: dict[str, Any] = {"function": _OfWhole(self, constraint.function)}
        if constraint.jacobian is not None:
            functions["jacobian"] = _OfWhole(self, constraint.jacobian, columns=True)
        if constraint.rate is not None:
            functions["rate"] = _OfWhole(self, constraint.rate)
        return replace(constraint, **functions)

    def force(self, force):
        if isinstance(force, Torque):
            gradient = None if force.gradient is None else _GradientOfWhole(self, force.gradient)
            return Torque(_TorqueOfWhole(self, force.function), gradient)
        return Torque(_TorqueOfWhole(self, force.torque), _GradientOfWhole(self, force.derivatives))


class _OfWhole:
    """A user's Φ(t, q), or its Jacobian, as a function of the joints that are left."""

    def __init__(self, state, function, columns=False):
        self.state, self.function, self.columns = state, function, columns
        self.__qualname__ = getattr(function, "__qualname__", repr(function))

    def __call__(self, t, q):
        value = self.function(t, self.state.q(q))
        return np.asarray(value)[:, self.state.v_left] if self.columns else value


class _TorqueOfWhole:
    """A user's τ(t, q, v) at the joints that are left."""

    def __init__(self, state, function):
        self.state, self.function = state, function
        self.__qualname__ = getattr(function, "__qualname__", repr(function))

    def __call__(self, t, q, v):
        return np.asarray(self.function(t, self.state.q(q), self.state.v(v)))[self.state.v_left]


class _GradientOfWhole(_TorqueOfWhole):
    """Its derivatives by these joints."""

    def __call__(self, t, q, v):
        left = self.state.v_left
        parts = self.function(t, self.state.q(q), self.state.v(v))
        return tuple(None if part is None else np.asarray(part)[np.ix_(left, left)] for part in parts)
