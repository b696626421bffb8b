"""Mechanisms with motors whose positions are known in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin

import pinconsist as pc
from helpers.bodies import circles_meet
from helpers.scenes import add_body, add_point, at

CRANK, DISTAL, APART = 0.25, 0.3, 0.2  # of five_bar: its distal links are too short for some crank angles


def five_bar() -> pc.Mechanism:
    """The built-in model with shorter distal links: two cranks about y on the ground and two links to the tip."""
    at = (DISTAL, 0.0, 0.0)
    tip = pc.Loop("tip", "hinge", "left_distal_bar", "right_distal_bar", xyz1=at, xyz2=at, axis=(0, 1, 0))
    return replace(pc.load("five_bar").with_loops(tip), guess=five_bar_configuration(-2.0, -1.2))


def elbows(left, right):
    """The ends of the cranks in the plane of x and height, two arrays (2,)."""
    return tuple(
        np.array([x + CRANK * np.cos(angle), -CRANK * np.sin(angle)])
        for x, angle in ((-APART / 2, left), (APART / 2, right))
    )


def five_bar_configuration(left, right):
    """(left crank, left distal, right crank, right distal) with the tip on the left of the line from elbow to elbow."""
    ends = elbows(left, right)
    tip = circles_meet(ends[0], DISTAL, ends[1], DISTAL, left=True)
    turns = [
        np.arctan2(-(tip - end)[1], (tip - end)[0]) - angle for end, angle in zip(ends, (left, right), strict=True)
    ]
    return np.array([left, turns[0], right, turns[1]])


def five_bar_side(q) -> float:
    """The distance of the tip from the line from elbow to elbow, m, positive on the left."""
    (p, r), angle = elbows(q[0], q[2]), q[0] + q[1]
    along, arm = r - p, DISTAL * np.array([np.cos(angle), -np.sin(angle)])
    return float(along[0] * arm[1] - along[1] * arm[0]) / max(float(np.linalg.norm(along)), 1e-12)


HORN, ROD, HEIGHT, BACK, WIDE = 0.04, 0.26, 0.25, 0.05, 0.03
"""Dimensions of the ankle: motor horns, rods, height of the motors above it, and attachment of the rods to the foot."""


def ankle() -> pc.Mechanism:
    """A foot on two hinges, pitch about y and roll about x, moved by two motors through two rods behind it."""
    model = pin.Model()
    pitch = add_body(model, 0, pin.JointModelRY(), pin.SE3.Identity(), "pitch", 0.05, (0, 0, 0), 1e-5)
    roll = add_body(model, pitch, pin.JointModelRX(), pin.SE3.Identity(), "roll", 0.8, (0.04, 0, -0.03), 2e-3)
    loops = []
    for name, y in (("left", WIDE), ("right", -WIDE)):
        motor = add_body(model, 0, pin.JointModelRY(), at(0, y, HEIGHT), name, 0.05, (-HORN / 2, 0, 0), 1e-5)
        model.armature[model.idx_vs[motor]] = 0.01
        add_point(model, motor, f"{name}_horn", -HORN, 0)
        add_point(model, roll, f"{name}_heel", -BACK, y)
        loops.append(pc.Loop(f"{name}_rod", "distance", f"{name}_horn", f"{name}_heel", length=ROD))
    add_point(model, roll, "sole", 0, 0, -0.06)
    angles = ankle_motors(0.0, 0.0)
    guess = {"left": angles[0], "right": angles[1]}
    return pc.Mechanism(model, loops, name="ankle", guess=guess, actuated=("left", "right"))


def ankle_motors(pitch, roll):
    """The motor angles of a foot, in closed form: the rod's length gives A sin α + B cos α = C."""
    R = pin.rpy.rpyToMatrix(0.0, pitch, 0.0) @ pin.rpy.rpyToMatrix(roll, 0.0, 0.0)
    angles = []
    for y in (WIDE, -WIDE):
        heel = R @ np.array([-BACK, y, 0.0])
        dx, dy, dz = np.array([0.0, y, HEIGHT]) - heel  # the horn is at motor + HORN (-cos α, 0, sin α)
        A, B, C = 2 * HORN * dz, -2 * HORN * dx, ROD**2 - HORN**2 - dx**2 - dy**2 - dz**2
        angles.append(np.arctan2(A, B) - np.arccos(C / np.hypot(A, B)))
    return np.array(angles)


FOOT, TOP = 0.5, 0.7  # of boom: from the boom's hinge to the cylinder's, and to the eye of its rod


def boom() -> pc.Mechanism:
    """A boom about y, raised by a hydraulic cylinder: a barrel on a hinge, and a rod that slides along its x axis."""
    model = pin.Model()
    lever = add_body(model, 0, pin.JointModelRY(), pin.SE3.Identity(), "boom", 20.0, (0.9, 0, 0), 5.0)
    add_point(model, lever, "eye", TOP, 0)
    barrel = add_body(model, 0, pin.JointModelRY(), at(0, 0, -FOOT), "barrel", 3.0, (0.2, 0, 0), 0.05)
    rod = add_body(model, barrel, pin.JointModelPX(), pin.SE3.Identity(), "cylinder", 2.0, (-0.1, 0, 0), 0.02)
    add_point(model, rod, "clevis", 0, 0)
    pin_loop = pc.Loop("pin", "hinge", "clevis", "eye", axis=(0, 1, 0))
    guess = {"boom": 0.0, "barrel": -np.arctan2(FOOT, TOP), "cylinder": np.hypot(FOOT, TOP)}
    return pc.Mechanism(model, [pin_loop], name="boom", guess=guess, actuated=("cylinder",))


def boom_angle(length):
    """The angle of the boom, negative upwards, for a length of the cylinder, by the law of cosines."""
    return np.pi / 2 - np.arccos((FOOT**2 + TOP**2 - length**2) / (2 * FOOT * TOP))


FREE = {
    "free": (pin.JointModelFreeFlyer, 6),
    "planar": (pin.JointModelPlanar, 3),
    "ball": (pin.JointModelSpherical, 3),
    "translation": (pin.JointModelTranslation, 3),
}
"""Joints of a body that is held only by rods, and the number of rods needed."""
AXIS = np.array([0.48, 0.6, 0.64])
MOTORS = (
    lambda: pin.JointModelHelicalUnaligned(AXIS, 0.3),
    lambda: pin.JointModelRUBZ(),
    lambda: pin.JointModelPrismaticUnaligned(AXIS),
    lambda: pin.JointModelRUBY(),
    lambda: pin.JointModelHZ(0.2),
    lambda: pin.JointModelRX(),
)


def held(kind, seed=41) -> pc.Mechanism:
    """A body on a joint of several degrees of freedom, moved through rods by motors on every kind of 1-DOF joint."""
    rng, model, (joint, count) = np.random.default_rng(seed), pin.Model(), FREE[kind]
    turned = pin.SE3(pin.exp3(rng.normal(size=3)), np.zeros(3))
    body, loops = add_body(model, 0, joint(), turned, kind, 2.0, (0.1, 0, 0.05), 0.1), []
    for k in range(count):
        place = pin.SE3(pin.exp3(rng.normal(size=3)), rng.uniform(-1.0, 1.0, 3))
        motor = add_body(model, 0, MOTORS[k](), place, f"motor{k}", 0.3, (0.1, 0.1, 0), 0.02)
        model.armature[model.idx_vs[motor]] = 0.05
        add_point(model, motor, f"horn{k}", 0.4, 0.2, 0.3)
        add_point(model, body, f"eye{k}", *rng.uniform(-0.5, 0.5, 3))
        data = model.createData()
        pin.framesForwardKinematics(model, data, pin.neutral(model))
        ends = (data.oMf[model.getFrameId(f"{name}{k}")].translation for name in ("horn", "eye"))
        length = float(np.linalg.norm(np.subtract(*ends)))
        loops.append(pc.Loop(f"rod{k}", "distance", f"horn{k}", f"eye{k}", length=length))
    forces = [
        pc.JointSpring("motor0", 5.0, 0.2), pc.JointSpring("motor1", 4.0, 0.4), pc.JointDamping({kind: 0.3}),
        pc.JointFriction({"motor1": 0.2}, width=0.5), pc.SpringDamper("eye0", "horn1", 40.0, 0.1, 3.0),
    ]  # fmt: skip
    return pc.Mechanism(model, loops, forces, name=kind, actuated=[f"motor{k}" for k in range(count)])
