"""Scenes whose runs are differentiated by ``python -m benchmarks gradients``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pinconsist import Actuator, Drive, JointDamping, JointSpring, Motion, load

from . import linkages

MANY = 1000


@dataclass(frozen=True)
class Scene:
    """What is run, names of parameters, end, initial velocities; steps of the reference's differences, relative; rows.

    Of `nearly_dependent` constraint rows the joint forces Jᵀ dλ are compared, not the multipliers.
    """

    make: Callable
    names: Sequence[str]
    until: float
    v0: Any = None
    relative: Any = 5e-4
    rows: int = 9
    nearly_dependent: bool = False


def driven():
    """The slider-crank on a curve of time."""
    mech = load("slider_crank")
    return mech.add_loops(Drive("motor", "crank", Motion(-1.0, 3.0, 0.4, 1.3, 0.2)))


# of all joints that move Cassie: what were left open would depend on masses, by rounding in nearly dependent rows
SPEEDS = {"root_joint": np.zeros(6)} | {
    f"{side}-{joint}-op": speed
    for side, speeds in (("left", (0.3, -0.2, 0.5, 3.0, 1.0)), ("right", (-0.4, 0.1, 0.8, -2.0, 0.7)))
    for joint, speed in zip(("roll", "yaw", "pitch", "knee", "foot"), speeds, strict=True)
}

SCENES = {
    "crank_rocker": Scene(
        lambda: load("crank_rocker").with_parameters({"damping:rocker": 0.1}),
        ["mass:coupler", "anchor:rocker_ground.xyz2[0]", "damping:rocker", "crank_speed"],
        0.6,
        {"crank": 12.0},
    ),
    "andrews": Scene(
        lambda: load("andrews"), ["stiffness:D-stage", "torque beta.beta", "mass:beta", "E3.xyz2[0]"], 0.01
    ),
    "delta_robot": Scene(
        lambda: load("delta_robot"),
        ["stiffness:leg1_arm", "servo leg1_arm.amplitude", "mass:platform_roll", "leg1_left.xyz2[1]"],
        0.1,
    ),
    "rssr": Scene(
        linkages.rssr, ["mass:coupler", "length:coupler", "ball.xyz2[0]", "crank_speed"], 0.5, {"crank": 6.0}
    ),
    "bricard": Scene(
        lambda: load("bricard").with_parameters({"damping:hinge0": 0.05}),
        ["mass:hinge2", "damping:hinge0", "gravity[2]"],
        2.5,
    ),
    "slider_crank": Scene(driven, ["motor.amplitude", "motor.frequency", "length:rod"], 0.6),
    "stewart_platform": Scene(
        lambda: load("stewart_platform"),
        ["mass:platform_pose", "stiffness:leg1_length", "anchor:leg2.xyz2[0]"],
        0.05,
    ),
    "delta_robot that floats": Scene(
        lambda: load("delta_robot", free_flyer=True).with_parameters(
            {"mass:root_joint": 2.0, **{f"inertia:root_joint[{ii}]": 0.02 for ii in ("xx", "yy", "zz")}}
        ),
        ["stiffness:leg1_arm", "servo leg1_arm.amplitude", "mass:platform_roll", "leg1_left.xyz2[1]"],
        0.1,
    ),
    "cassie that floats": Scene(
        lambda: load("cassie", free_flyer=True),
        ["left-knee-op_speed", "mass:left-foot-op"],
        0.02,
        SPEEDS,
        (0.3, 0.1),
        rows=3,
        nearly_dependent=True,
    ),
}


def swung():
    """A crank-rocker swung by a torque of 1,000 values, and their names."""
    times = np.linspace(0.0, 2.5, MANY)
    mech = load("four_bar").add_forces(JointDamping({"crank": 0.5}), Actuator("motor", "crank"))
    names = [f"motor.control.values[{i}]" for i in range(MANY)]
    return mech.with_control({"motor": (times, 8.0 * np.sin(4.0 * times))}), names, 2.5


def long_chain():
    """A chain of 100 rods with springs and dampers in its joints, and ten numbers of each rod and its joint."""
    mech = load("chain_100")
    own = *(f"com:{{0}}[{i}]" for i in range(3)), *(f"inertia:{{0}}[{ij}]" for ij in ("xx", "yy", "zz", "xz"))
    kinds = "mass:{0}", *own, "stiffness:{0}", "damping:{0}"
    names = [kind.format(joint) for joint in mech.joints for kind in kinds]
    springs = (JointSpring(joint, 2.0) for joint in mech.joints)
    return mech.add_forces(JointDamping(dict.fromkeys(mech.joints, 0.5)), *springs), names, 0.5
