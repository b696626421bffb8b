"""Hand-built trees for tests: every kind of joint, frames away from the joints, full inertias."""

from __future__ import annotations

import numpy as np
import pinocchio as pin


def placement(rng, reach=0.5):
    return pin.SE3(pin.exp3(rng.normal(size=3)), rng.uniform(-reach, reach, 3))


def mixed_tree(seed=0) -> pin.Model:
    """Arm (revolute, prismatic, spherical), raft (free flyer, unbounded revolute) and puck (planar) on one ground.

    Frames "arm", "arm0", "raft", "wheel", "puck", each away from its joint.
    """
    rng, model = np.random.default_rng(seed), pin.Model()

    def body(parent, joint, name):
        index = model.addJoint(parent, joint, placement(rng), name)
        model.appendBodyToJoint(index, pin.Inertia.Random(), placement(rng))
        return index

    def frame(name, joint):
        model.addFrame(pin.Frame(name, joint, 0, placement(rng), pin.FrameType.OP_FRAME))

    hinge = body(0, pin.JointModelRZ(), "hinge")
    frame("arm0", hinge)
    slide = body(hinge, pin.JointModelPX(), "slide")
    frame("arm", body(slide, pin.JointModelSpherical(), "ball"))
    raft = body(0, pin.JointModelFreeFlyer(), "float")
    frame("raft", raft)
    frame("wheel", body(raft, pin.JointModelRUBY(), "turn"))
    frame("puck", body(0, pin.JointModelPlanar(), "glide"))
    return model


def random_state(model, rng, speed=1.0):
    q = pin.integrate(model, pin.neutral(model), rng.uniform(-1.5, 1.5, model.nv))
    return q, speed * rng.normal(size=model.nv)


def frame_pose(model, q, name):
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return data.oMf[model.getFrameId(name)]
