"""Derivatives of the steps of Radau IIA: their order, and what it hangs on."""

import numpy as np
import pytest
from helpers import scenes
from helpers.gradients import crank_rocker, two_balls

import pinconsist as pc
from benchmarks.gradient_reference import worst
from pinconsist.engine import charts
from pinconsist.mechanism.system import MechanismSystem

STEPS = {1: (60, 120), 2: (20, 40), 3: (5, 10)}


def errors(scene, s, until=0.1, steps=None, **more):
    """Of dq, dv and dλ where the run ends and inside of a step, at fixed steps, by a run of order 13."""
    mech, names, _, v0 = scene()
    times = np.array([0.7537, 1.0]) * until

    def run(s, n):
        options = {"step": until / n, "order": 2 * s - 1, "method": "Radau", "t_eval": times, **more}
        found = pc.sensitivities(mech, names[:2], (0.0, until), None, v0, **options)
        return found.dq, found.dv, found.dlam

    exact = run(7, 20)
    return np.array([worst(run(s, n), exact) for n in steps or STEPS[s]])


@pytest.mark.parametrize("s", STEPS)
@pytest.mark.parametrize("scene", [crank_rocker, two_balls], ids=lambda scene: scene.__name__)
def test_order_of_all_derivatives(scene, s):
    coarse, fine = errors(scene, s)
    order = np.log2(coarse / fine)
    assert (np.abs(order - (2 * s - 1)) < 0.6).all(), (order, fine)


def test_how_the_rate_in_a_chart_changes():
    mech = scenes.four_bar(floating=True)
    system = MechanismSystem(mech, mech.guess)
    rng = np.random.default_rng(0)
    for size in (1e-8, 1e-2, 2.0):
        xi, rate = size * rng.normal(size=system.nx), rng.normal(size=system.nx)
        found, e = charts.chart_rate_gradient(system, xi, rate), 1e-4
        for j, unit in enumerate(np.eye(system.nx)):
            change = (
                sum(
                    w * (charts.chart_matrix(system, xi + m * e * unit) @ rate)
                    for m, w in {-2: 1 / 12, -1: -2 / 3, 1: 2 / 3, 2: -1 / 12}.items()
                )
                / e
            )
            np.testing.assert_allclose(found[:, j], change, atol=1e-10)
