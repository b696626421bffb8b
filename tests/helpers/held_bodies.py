"""A free body held to a moving arm by every kind of loop, and the same scene with tree joints in their place."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

import pinconsist as pc
from helpers.bodies import frame_pose
from helpers.scenes import add_body, add_point

AXIS, AXIS2 = (0.3, -0.5, 0.8), (0.9, 0.2, -0.4)
E, A = (np.array(axis) / np.linalg.norm(axis) for axis in (AXIS, AXIS2))
U = np.linalg.svd(E[None, :])[2][1:]  # two directions across E, found without the package
CROSSED = pin.Quaternion.FromTwoVectors(A, U[0]).matrix()  # makes AXIS2 perpendicular to AXIS
LENGTH = 0.7
XYZ1, RPY1, XYZ2, RPY2 = (0.1, -0.2, 0.4), (0.4, 0.1, -0.6), (-0.1, 0.15, 0.1), (-0.2, 0.5, 0.3)
BODY = pin.Inertia(1.3, np.array([0.15, -0.1, 0.05]), np.diag([0.04, 0.06, 0.05]) + 0.01)


def anchor(xyz, rpy):
    return pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array(xyz))


def turning(axis):
    return pin.JointModelRevoluteUnaligned(axis)


def sliding(axis):
    return pin.JointModelPrismaticUnaligned(axis)


AT_ONCE = pin.SE3.Identity()
JOINTS = {  # (placement, joint) one after the other, from anchor 1 to anchor 2
    "point": [(AT_ONCE, pin.JointModelSpherical())],
    "frame": [],
    "hinge": [(AT_ONCE, turning(E))],
    "distance": [
        (AT_ONCE, turning(U[0])),
        (AT_ONCE, turning(U[1])),
        (pin.SE3(np.eye(3), LENGTH * E), pin.JointModelSpherical()),
    ],
    "slider": [(AT_ONCE, sliding(E))],
    "cylinder": [(AT_ONCE, sliding(E)), (AT_ONCE, turning(E))],
    "plane": [(AT_ONCE, sliding(U[0])), (AT_ONCE, sliding(U[1])), (AT_ONCE, turning(E))],
    "universal": [(AT_ONCE, turning(E)), (pin.SE3(CROSSED, np.zeros(3)), turning(A))],
}


def arm(model):
    turn, inertia = turning(np.array([0.6, 0.0, 0.8])), np.diag([0.1, 0.2, 0.15])
    joint = add_body(model, 0, turn, AT_ONCE, "arm", 2.0, (0.1, 0.1, 0.2), inertia)
    add_point(model, joint, "arm_end", 0, 0)
    return joint


def as_tree(kind):
    """The body on tree joints; its frame is "body"."""
    model, place = pin.Model(), anchor(XYZ1, RPY1)
    last = arm(model)
    for i, (shift, joint) in enumerate(JOINTS[kind]):
        last, place = model.addJoint(last, joint, place * shift, f"joint{i}"), AT_ONCE
    place = place * anchor(XYZ2, RPY2).inverse()
    model.appendBodyToJoint(last, BODY, place)
    model.addFrame(pin.Frame("body", last, 0, place, pin.FrameType.OP_FRAME))
    return pc.Mechanism(model, name=f"{kind} tree")


def own_fields(kind, axis, axis2, length):
    """The fields axis, axis2 and length, if a loop of this kind has them."""
    given = {"axis": axis, "axis2": axis2, "length": length}
    own = {"point": (), "frame": (), "distance": ("length",), "universal": ("axis", "axis2")}.get(kind, ("axis",))
    return {field: given[field] for field in own}


def as_loop(kind, guess=None):
    """The free body, connected to the arm by a loop of this kind."""
    model = pin.Model()
    arm(model)
    free = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    model.appendBodyToJoint(free, BODY, pin.SE3.Identity())
    add_point(model, free, "body_end", 0, 0)
    loop = pc.Loop(
        "held", kind, "arm_end", "body_end", XYZ1, RPY1, XYZ2, RPY2, **own_fields(kind, AXIS, AXIS2, LENGTH)
    )  # fmt: skip
    return pc.Mechanism(model, [loop], name=f"{kind} loop", guess=guess)


def free_state(tree, q, v):
    """(q, v) of the scene with a loop for a state of the tree: those of the arm, then the body's pose and velocity."""
    model, data = tree.model, tree.model.createData()
    pin.forwardKinematics(model, data, q, v)
    pose = frame_pose(model, q, "body")
    twist = pin.getFrameVelocity(model, data, model.getFrameId("body"), pin.LOCAL)
    return np.concatenate((q[:1], pin.SE3ToXYZQUAT(pose))), np.concatenate((v[:1], twist.vector))


def joint_wrench(tree, q, v):
    """Force and moment of the joints on the body at anchor 2, in world axes, by the Newton-Euler equations."""
    model, data, frame = tree.model, tree.model.createData(), tree.model.getFrameId("body")
    pin.forwardKinematics(model, data, q, v, pin.aba(model, data, q, v, np.zeros(model.nv)))
    twist = pin.getFrameVelocity(model, data, frame, pin.LOCAL)
    pose = frame_pose(model, q, "body")
    acceleration = pin.getFrameAcceleration(model, data, frame, pin.LOCAL)
    acceleration.linear = acceleration.linear - pose.rotation.T @ model.gravity.linear
    at_body = BODY * acceleration + BODY.vxiv(twist)
    at_anchor = anchor(XYZ2, RPY2).actInv(at_body)
    turn = pose.rotation @ anchor(XYZ2, RPY2).rotation
    return turn @ at_anchor.linear, turn @ at_anchor.angular
