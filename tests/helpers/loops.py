"""Loops of every kind between the frames of ``bodies.mixed_tree``."""

import numpy as np
import pinocchio as pin

import pinconsist as pc
from helpers.bodies import frame_pose
from helpers.held_bodies import AXIS, AXIS2, E, own_fields
from helpers.scenes import add_body, add_point
from pinconsist.mechanism import loops

KINDS = tuple(loops.LOOP_KINDS)
PAIRS = [("arm", "wheel"), ("arm", "universe"), ("universe", "puck"), ("raft", "arm0"), ("raft", "wheel")]


def loop_of(kind, frame1, frame2, **fields):
    offsets = {"xyz1": (0.1, -0.2, 0.3), "rpy1": (0.4, 0.1, -0.6), "xyz2": (-0.3, 0.2, 0.1), "rpy2": (-0.2, 0.5, 0.3)}
    own = own_fields(kind, AXIS, AXIS2, 0.7)
    return pc.Loop(f"{kind} {frame1} {frame2}", kind, frame1, frame2, **own, **(offsets | fields))


def loop_open_by(model, q, kind, frame1, frame2, gap):
    """A loop whose anchor 2 has the pose `gap` (SE3) relative to anchor 1 at configuration q."""
    loop = loop_of(kind, frame1, frame2)
    anchor = frame_pose(model, q, frame2).actInv(frame_pose(model, q, frame1) * loop.placement1 * gap)
    return loop_of(kind, frame1, frame2, xyz2=anchor.translation, rpy2=pin.rpy.matrixToRpy(anchor.rotation))


def closed_gap(kind, rng):
    """A random pose of anchor 2 relative to anchor 1 that closes a loop of this kind."""
    slide, angle, cross = rng.uniform(-0.5, 0.5), rng.uniform(-2, 2), np.cross(E, rng.normal(size=3))
    turn = np.eye(3) if kind in ("point", "frame", "slider") else pin.exp3(angle * E)
    if kind == "universal":  # any rotation with perpendicular axes
        across, a = cross / np.linalg.norm(cross), np.array(AXIS2) / np.linalg.norm(AXIS2)
        turn = turn @ pin.Quaternion.FromTwoVectors(a, across).matrix() @ pin.exp3(1.3 * a)
    shift = {"slider": slide * E, "cylinder": slide * E, "plane": cross, "distance": 0.7 * E}.get(kind, np.zeros(3))
    return pin.SE3(turn, shift)


def stayed_lid(lever):
    """A lid on two balls along x; a stay at the distance `lever`, m, from their line prevents rotation about it."""
    model = pin.Model()
    inertia, ends = np.diag([0.1, 0.2, 0.15]), ("universe", "lid")
    free = add_body(model, 0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "lid", 2.0, (0, 0, -0.4), inertia)
    add_point(model, free, "lid", 0, 0)
    balls = [pc.Loop(f"ball{x}", "point", *ends, xyz1=(x, 0, 0), xyz2=(x, 0, 0)) for x in (-0.5, 0.5)]
    stay = pc.Loop("stay", "distance", *ends, xyz1=(0, 1, 0), xyz2=(0, 0, -lever), length=float(np.hypot(1, lever)))
    return pc.Mechanism(model, [*balls, stay])
