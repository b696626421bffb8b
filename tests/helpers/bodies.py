"""Hand-built trees for tests: every kind of joint, frames displaced from the joints, full inertias."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from pinconsist.mechanism.rows import LoopRows


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


def loop_rows(mech, q, t=0.0):
    """Φ and J of all loops."""
    return LoopRows(mech.model, mech.loops).at(np.asarray(q, float), t)


def differences(function, x, step=1e-4):
    """Fourth-order central differences, columns."""
    columns = []
    for i in range(len(x)):
        at = [function(x + s * step * np.eye(len(x))[i]) for s in (-2, -1, 1, 2)]
        columns.append((at[0] - 8 * at[1] + 8 * at[2] - at[3]) / (12 * step))
    return np.column_stack(columns)


def circles_meet(p, r, q, s, left):
    """The intersection of circles of radii r about p and s about q in the plane, left of p → q or right of it."""
    along = q - p
    n = np.linalg.norm(along)
    x = (r**2 - s**2 + n**2) / (2 * n)
    across = np.sqrt(r**2 - x**2) * np.array([-along[1], along[0]]) / n
    return p + x * along / n + (across if left else -across)
