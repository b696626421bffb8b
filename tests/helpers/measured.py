"""Reactions, energies and powers state by state, by Pinocchio and the laws of forces by hand: not compiled."""

import numpy as np
import pinocchio as pin

from helpers.laws import stored_by_hand, torque_by_hand
from pinconsist.mechanism.forces import bound_forces, model_forces
from pinconsist.mechanism.loops import Length, RotationVector
from pinconsist.mechanism.rows import LoopRows


def reaction_of_the_loop(mech, q, lam, axes):
    """Force, moment and joint forces of the only loop of a mechanism, at a state."""
    model, data = mech.model, mech.model.createData()
    closure = LoopRows.of(mech).closures[0]
    pin.computeJointJacobians(model, data, q)
    joint_forces = LoopRows.of(mech).at(q)[1].T @ lam
    turn = data.oMi[closure.joint1].rotation @ closure.place1.rotation if axes == "world" else np.eye(3)
    force, moment = (by_twist(closure, data).T @ lam).reshape(2, 3) @ turn.T
    return force, moment, joint_forces


def by_twist(closure, data):
    """∂Φ by the twist of body 2 relative to body 1 at anchor 2, in the axes of anchor 1, of a closed loop."""
    pose1, pose2 = data.oMi[closure.joint1] * closure.place1, data.oMi[closure.joint2] * closure.place2
    gap, turn = pose1.actInv(pose2), closure.rotation
    if isinstance(closure.translation, Length):
        return np.append(gap.translation / closure.translation.length, np.zeros(3))[None]
    moving = [np.hstack((closure.translation.directions, np.zeros_like(closure.translation.directions)))]
    if isinstance(turn, RotationVector):
        moving.append(np.eye(6)[3:])
    elif turn is not None:
        spun = -turn.directions @ pin.skew(gap.rotation @ turn.axis2)
        moving.append(np.hstack((np.zeros_like(spun), spun)))
    return np.vstack(moving)


def energies_of(model, q, v):
    """Kinetic energy, with that of rotors, and potential energy of a state."""
    data = model.createData()
    pin.forwardKinematics(model, data, q, v)
    kinetic = 0.5 * (model.armature @ v**2 + sum(b.vtiv(u) for b, u in zip(model.inertias, data.v, strict=True)))
    height = [pose.act(body.lever) * body.mass for body, pose in zip(model.inertias, data.oMi, strict=True)]
    return kinetic, -float(model.gravity.linear @ np.sum(height[1:], axis=0))


def powers_of(mech, t, q, v):
    """Of each force: its power without the rate of its stored energy, and this energy, or 0."""
    found = {}
    records = (*model_forces(mech.model), *mech.forces)
    for label, record in zip(bound_forces(mech.model, mech.forces), records, strict=True):
        power = float(torque_by_hand(record, mech.model, t, q, v) @ v)
        elastic, rate = stored_by_hand(record, mech.model, q, v)
        found[label] = power + rate, elastic
    return found
