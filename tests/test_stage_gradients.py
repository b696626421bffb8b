"""Derivatives of the steps of Radau IIA: their order, and what it hangs on."""

import numpy as np
import pytest
from helpers import scenes
from helpers.gradients import SCENES, crank_rocker, delta_robot, two_balls
from helpers.twin import needs_twin

import pinconsist as pc
from benchmarks.gradient_reference import worst
from pinconsist.dae import charts
from pinconsist.gradients import linear, stage_leg
from pinconsist.gradients.prepare import prepared
from pinconsist.gradients.stage_leg import StagePropagator, propagator_of
from pinconsist.mechanism.system import MechanismSystem

STEPS = {1: (60, 120), 2: (20, 40), 3: (5, 10)}


def errors(scene, s, until=0.1, steps=None, **more):
    """Of dq, dv and dλ where the run ends and inside of a step, at fixed steps, by a run of order 13."""
    mech, names, _, v0 = scene()
    times = np.array([0.7537, 1.0]) * until

    def run(s, n):
        options = {"step": until / n, "max_order": 2 * s - 1, "method": "Radau", "t_eval": times, **more}
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


class WithoutMetric(linear.Motion):
    """The projection of the velocity is taken for one in a metric that stays."""

    def _end(self):
        super()._end()
        self.q, self.nu = 0.0 * self.q, 0.0 * self.nu

    def residuals(self, index1):
        all_of_them = super().residuals(index1)
        all_of_them[-self.system.nv :] = 0.0
        return all_of_them


def test_where_the_metric_of_the_projection_stays_the_order_is_lost(monkeypatch):
    monkeypatch.setattr(stage_leg, "Motion", WithoutMetric)
    coarse, fine = errors(crank_rocker, 3, backend="python")
    assert np.log2(coarse / fine).max() < 4.0


def test_where_charts_do_not_turn_rotations_are_wrong(monkeypatch):
    monkeypatch.setattr(linear, "chart_rate_gradient", lambda system, xi, rate: np.zeros((system.nx, system.nx)))
    (error,) = errors(two_balls, 3, steps=(10,), backend="python")
    assert error[0] > 1e-4  # 2e-9


@needs_twin
@pytest.mark.parametrize("scene", [s for s in SCENES if s is not delta_robot], ids=lambda scene: scene.__name__)
def test_the_compiled_way_is_the_python_one(scene):
    mech, names, until, v0 = scene()
    options = 1e-4, 1e-4, "compiled", {"method": "Radau"}
    _, legs, variants, base, *_ = prepared(mech, names, (0.0, until), None, v0, None, None, (), None, *options)
    leg, rng = legs[0], np.random.default_rng(0)
    residuals = variants.residuals(leg.system)
    plain, compiled = StagePropagator(leg.system, residuals), propagator_of(base.index1(leg.system), residuals)
    assert not isinstance(compiled, StagePropagator)
    steps, n = leg.steps[:3], leg.system.nx + leg.system.nv
    inside = [step.ending_at(step.t_old + 0.4 * step.h) for step in steps]
    led = [way.again(inside) for way in (plain, compiled)]
    for one, other in zip(*led, strict=True):
        size = 1.0 + np.abs(one.v).max()
        np.testing.assert_allclose(one.p, other.p, atol=1e-11)
        np.testing.assert_allclose(one.v, other.v, atol=1e-10 * size)
    steps = steps + led[0]
    state = [np.array([getattr(step, name) for step in steps]) for name in ("end", "p", "v")]
    S, given = rng.normal(size=(len(steps), len(names), n)), rng.normal(size=(len(steps), n))
    of_lam = rng.normal(size=(len(steps), leg.system.nc))
    found = []
    for way in (plain, compiled):
        ends, bars, others = np.empty_like(S), np.zeros_like(given), np.zeros_like(given)
        way.forward(steps, S, ends)
        own = way.backward(steps, given, bars)
        last = way.multipliers_back(*state, of_lam, others)
        found.append((ends, bars, own, *way.multipliers(*state, S), others, last))
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-7 * np.abs(one).max(initial=0.0) + 1e-10)


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
