"""Scenes whose runs are differentiated: mechanism, names of parameters, end of the run, initial velocity."""

import numpy as np

import pinconsist as pc

from . import scenes


def crank_rocker():
    names = ["mass:coupler", "anchor:rocker_ground.xyz2[0]", "damping:rocker", "crank_speed"]
    return pc.load("crank_rocker").with_parameters({"damping:rocker": 0.1}), names, 0.3, {"crank": 12.0}


def andrews():
    return pc.load("andrews"), ["stiffness:D-stage", "torque beta.beta", "mass:beta", "E3.xyz2[0]"], 5e-3, None


def delta_robot():
    names = ["stiffness:leg1_arm", "servo leg1_arm.amplitude", "mass:platform_roll", "leg1_left.xyz2[1]"]
    return pc.load("delta_robot"), names, 0.05, None


def bricard():
    mech = pc.load("bricard").with_parameters({"damping:hinge0": 0.05})
    return mech, ["mass:hinge2", "damping:hinge0", "gravity[2]"], 1.5, None


def slider_crank():
    mech = pc.load("slider_crank")
    driven = mech.with_loops(*mech.loops, pc.Drive("motor", "crank", pc.Motion(-1.0, 3.0, 0.4, 1.3, 0.2)))
    return driven, ["motor.amplitude", "motor.frequency", "length:rod"], 0.3, None


def two_balls():
    return scenes.spherical_chain(), ["mass:second", "end.length", "gravity[1]"], 0.3, None


def floating_four_bar():
    mech, v0 = scenes.four_bar(floating=True), np.array([0, 0, 0, 0.5, -0.3, 0.8, 2.0, 0, 0])
    return mech, ["mass:coupler", "length:coupler", "pin.xyz1[0]"], 0.2, v0


SCENES = [crank_rocker, andrews, delta_robot, bricard, slider_crank, two_balls, floating_four_bar]


def hits(theta):
    return [
        pc.Event(lambda t, q, v, lam: q[0] - 2.0 - 0.1 * theta[1], apply=lambda t, q, v: 0.8 * v, name="hit"),
        pc.Event(lambda t, q, v, lam: lam[0] - 5.0, name="load"),
    ]
