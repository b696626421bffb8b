"""Forces of every kind on ``bodies.mixed_tree``."""

import numpy as np

import pinconsist as pc
from pinconsist.mechanism.forces import FluidDrag, FluidEllipsoid


def law(t, q, v):
    return np.cos(t) - 3.0 * np.sin(q[: len(v)]) * v**2


def law_gradient(t, q, v):
    """The derivatives of the law above on vector-like joints."""
    return np.diag(-3.0 * np.cos(q) * v**2), np.diag(-6.0 * np.sin(q) * v)


def wave(t):
    return np.array([3.0 * np.sin(5 * t), 1.0, -t])


FORCES = {  # on mixed_tree: joints hinge, slide, ball, float, turn, glide
    "damping": pc.JointDamping({"hinge": 0.4, "ball": 2.0, "float": (1, 2, 3, 4, 5, 6), "turn": 0.1}),
    "damping of all": pc.JointDamping(np.arange(15.0)),
    "friction": pc.JointFriction({"slide": 0.5, "turn": 3.0, "ball": 1.0}, width=0.5),
    "hinge spring": pc.JointSpring("hinge", 30.0, 0.4),
    "hinge spring with a damper": pc.JointSpring("hinge", 30.0, 0.4, 2.0),
    "spring of a tendon": pc.JointSpring({"hinge": 1.5, "slide": -2.0}, 30.0, 0.4, 2.0),
    "slack spring": pc.JointSpring({"hinge": 1.5, "slide": -2.0}, 30.0, (-0.1, 0.05), 0.5),
    "spring of a ball": pc.JointSpring("ball", 30.0, (0.1, 0.2, -0.3, 0.9), 2.0),
    "spring of a free joint": pc.JointSpring("float", 30.0, (0.1, 0.2, -0.3, 0.0, 0.1, 0.2, 0.9)),
    "slide spring": pc.JointSpring("slide", 30.0),
    "spring of an unbounded hinge": pc.JointSpring("turn", 30.0, 0.4),
    "spring": pc.SpringDamper("arm", "raft", 30.0, 0.4, xyz1=(0.1, -0.2, 0.3), xyz2=(-0.3, 0.2, 0.1)),
    "spring-damper": pc.SpringDamper("wheel", "puck", 30.0, 0.4, 5.0, xyz1=(0.1, -0.2, 0.3), xyz2=(-0.3, 0.2, 0.1)),
    "spring to the ground": pc.SpringDamper("universe", "wheel", 30.0, 4.0, 0.3, xyz1=(0.1, -0.2, 0.3)),
    "pushing spring in a chain": pc.SpringDamper("arm0", "arm", 30.0, 3.0, 2.0, xyz2=(0.4, 0.1, 0.0)),
    "bushing": pc.Bushing(
        "arm",
        "raft",
        (30, 20, 10, 4, 5, 6),
        (3, 2, 1, 0.4, 0.5, 0.6),
        (0.1, -0.2, 0.3),
        (0.1, 0.2, 0.3),
        (-0.3, 0.2, 0.1),
    ),
    "bushing on the ground": pc.Bushing("universe", "wheel", (30, 20, 10, 4, 5, 6), rpy1=(0.1, 0.2, 1.8)),
    "drag": FluidDrag("arm", (0.1, 0.2, 0.3), 100.0, 2.0, (1, 2, 3), (0.1, 0.2, 0.3), (0.3, 0.2, 0.1)),
    "lift": FluidEllipsoid(
        "arm",
        (0.1, 0.2, 0.3),
        100.0,
        2.0,
        (1, 2, 3),
        (0.1, 0.2, 0.3),
        (0.3, 0.2, 0.1),
        (0.5, 0.3, 1.5, 0.9, 0.8),
        (0.1, 0.2, 0.3, 0.01, 0.02, 0.03),
    ),
    "viscous drag": FluidDrag("raft", (0.1, 0.2, 0.3), 0.0, 2.0),
    "torque": pc.JointTorque({"hinge": 2.0, "ball": (1, 2, 3)}),
    "torque of time": pc.JointTorque({"hinge": np.sin, "ball": wave, "slide": 3}),
    "servo": pc.Servo("hinge", np.sin, 20.0, 3.0),
    "servo of an unbounded hinge": pc.Servo("turn", 0.3, 20.0, 3.0),
    "actuator": pc.Actuator("m", "turn", (3, 0.3, 0.1), (0.2, -4, -0.3), gear=-2.0, control=pc.Motion(0.1, 0.3)),
    "actuator of a tendon": pc.Actuator("m", {"hinge": 1.5, "slide": -2.0, "turn": 0.5}, (2, 0, 0), (0, -2, -0.5)),
    "limited actuator": pc.Actuator("m", "slide", (30, 0, 0), (0, -30, -1), control=9.0, control_range=(-1, 0.1)),
    "world wrench": pc.Wrench("wheel", (1, -2, 3), (0.5, 0.1, -0.7), xyz=(0.3, 0.2, -0.4)),
    "local wrench": pc.Wrench("arm", (1, -2, 3), (0.5, 0.1, -0.7), "local", (0.3, 0.2, -0.4)),
    "wrench of time": pc.Wrench("puck", wave, lambda t: [0, t, 1], xyz=(0.3, 0.2, -0.4)),
    "law": pc.Torque(law),
}
