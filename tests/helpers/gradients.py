"""Scenes whose runs are differentiated: mechanism, names of parameters, end of the run, initial velocity."""

import numpy as np

import pinconsist as pc
from benchmarks import gradient_scenes

from . import scenes


def of_benchmark(name, until):
    """A scene of the benchmarks, run for a shorter time."""

    def scene():
        whole = gradient_scenes.SCENES[name]
        return whole.make(), whole.names, until, whole.v0

    scene.__name__ = name
    return scene


ENDS = {"crank_rocker": 0.3, "andrews": 5e-3, "delta_robot": 0.05, "bricard": 1.5, "slider_crank": 0.3}
crank_rocker, andrews, delta_robot, bricard, slider_crank = (of_benchmark(*row) for row in ENDS.items())


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
