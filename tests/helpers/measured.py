"""Reactions, energies and powers state by state, by Pinocchio and the Python of rows and forces: not compiled."""

import numpy as np
import pinocchio as pin

from pinconsist.mechanism.forces import bound_forces
from pinconsist.mechanism.rows import LoopRows


def reaction_of_the_loop(mech, q, lam, axes):
    """Force, moment and joint forces of the only loop of a mechanism, at a state."""
    model, data = mech.model, mech.model.createData()
    closure = LoopRows.of(mech).closures[0]
    pin.computeJointJacobians(model, data, q)
    joint_forces = closure.evaluate(data, q, 0.0)[1].T @ lam
    J, pose1, _ = closure.by_twist(data)
    turn = pose1.rotation if axes == "world" else np.eye(3)
    force, moment = (J.T @ lam).reshape(2, 3) @ turn.T
    return force, moment, joint_forces


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
    for label, force in bound_forces(mech.model, mech.forces).items():
        power = float(force.torque(t, q, v) @ v)
        elastic, rate = force.stored(q, v) if hasattr(force, "stored") else (0.0, 0.0)
        found[label] = power + rate, elastic
    return found
