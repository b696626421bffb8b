"""Radau IIA on the index-3 equations."""

import numpy as np
import pytest
from helpers import scenes
from helpers.twin import needs_twin
from helpers.zoo import scaled_bead

import pinconsist as pc
from pinconsist.dae.radau import table

STEPS = {1: 1 / 80, 3: 1 / 40, 5: 1 / 10, 9: 1 / 4}  # order → step; half of it is still above rounding
needs_both = pytest.mark.parametrize("backend", ["python", pytest.param("compiled", marks=needs_twin)])


@pytest.mark.parametrize("s", [1, 2, 3, 5, 7])
def test_tables_are_exact_up_to_their_order(s):
    formula = table(s)
    for k in range(2 * s + 1):
        error = abs(formula.A[-1] @ formula.c**k - 1.0 / (k + 1))
        assert error < 1e-14 if k <= 2 * s - 2 else error > 1e-9 or k > 2 * s - 1, k
    stage = [np.abs(formula.A @ formula.c**k - formula.c ** (k + 1) / (k + 1)).max() for k in range(s)]
    assert max(stage) < 1e-14


@pytest.mark.parametrize("order", STEPS)
@pytest.mark.parametrize("name", ["problem51", "problem52"])
def test_orders_of_positions_velocities_and_multipliers(name, order):
    problem = pc.reference_problem(name)
    t0, errors = problem.t0, []
    for h in (STEPS[order], STEPS[order] / 2):
        run = pc.integrate(
            problem.system, (t0, t0 + 0.5), problem.p0, problem.v0, method="Radau", max_order=order, step=h
        )
        assert run.success
        ends = zip((run.q, run.v, run.lam), problem.exact(t0 + 0.5), strict=True)
        errors.append([np.abs(found[-1] - exact).max() for found, exact in ends])
    assert np.log2(np.divide(*errors)) == pytest.approx(order, abs=0.4)


def test_modes_of_bdf_are_refused():
    problem = pc.reference_problem("problem51")
    for mode in ("initial", "exact"):
        with pytest.raises(pc.InputError, match="leave consistency out"):
            pc.integrate(problem.system, (0, 1), problem.p0, problem.v0, method="Radau", consistency=mode)
    with pytest.raises(pc.InputError, match="one of 1, 3, 5, 9, 13"):
        pc.integrate(problem.system, (0, 1), problem.p0, problem.v0, method="Radau", max_order=4)


@needs_both
def test_backwards_in_time(backend):
    mech = pc.load("four_bar")
    there = pc.simulate(mech, (0.0, 0.5), method="Radau", rtol=1e-8, backend=backend)
    back = pc.integrate(mech, (0.5, 0.0), there.q[-1], there.v[-1], method="Radau", rtol=1e-8, backend=backend)
    assert back.success and back.t[-1] == 0.0 and (back.h < 0).all()
    np.testing.assert_allclose(back.q[-1], there.q[0], atol=1e-7)


@needs_both
def test_a_mechanism_that_is_fully_driven(backend):
    """Nothing is free: the motion is that of the drive, the torque that of the inverse dynamics."""
    mech = pc.load("slider_crank")
    motion = pc.Motion(0.1, 0.7, 0.3, 1.4, 0.2)
    crank = mech.joints[0]
    driven = pc.Mechanism(mech.model, [*mech.loops, pc.Drive("motor", crank, motion)], mech.forces)
    sol = pc.simulate(driven, (0.0, 1.0), method="Radau", backend=backend)
    slow = pc.simulate(driven, (0.0, 1.0), rtol=1e-9)
    assert sol.success
    np.testing.assert_allclose(sol.q[-1], slow.q[-1], atol=1e-8)
    np.testing.assert_allclose(sol.lam[-1], slow.lam[-1], atol=1e-6 * np.abs(slow.lam[-1]).max())


def test_a_constraint_that_moves():
    problem, p0, v0 = scenes.car_axis()
    sol = pc.integrate(problem, (0.0, 3.0), p0, v0, method="Radau", rtol=1e-5, atol=1e-6)
    for found, expected in zip((sol.q, sol.v, sol.lam), scenes.CAR_AXIS_END, strict=True):
        np.testing.assert_allclose(found[-1], expected, atol=5e-6)


@needs_both
def test_kinematics_that_depend_on_the_position(backend):
    problem, exact = scaled_bead()
    p0, v0, _ = exact(0.0)
    sol = pc.integrate(problem, (0.0, 0.5), p0, v0, method="Radau", rtol=1e-8, backend=backend)
    p, v, lam = exact(0.5)
    np.testing.assert_allclose(sol.q[-1], p, atol=1e-8)
    np.testing.assert_allclose(sol.v[-1], v, atol=1e-8)
    np.testing.assert_allclose(sol.lam[-1], lam, atol=1e-7)


@needs_both
def test_impacts_that_come_faster_than_steps(backend):
    """The tolerance would allow steps over several of them; none is missed."""
    impact = pc.Event(lambda t, q, v, lam: np.sin(52.0 * q[0]), apply=lambda t, q, v: 0.998 * v)
    options = {"v0": {"crank": 12.0}, "events": impact}
    sol = pc.simulate(pc.load("crank_rocker"), (0.0, 0.06), method="Radau", backend=backend, **options)
    times = sol.t_events[0]
    tight = pc.simulate(pc.load("crank_rocker"), (0.0, 0.06), rtol=1e-10, atol=1e-12, **options).t_events[0]
    assert len(times) == len(tight) > 8
    np.testing.assert_allclose(times, tight, atol=1e-8)


@needs_both
def test_dense_output_t_eval_and_callbacks(backend):
    mech, t = pc.load("crank_rocker"), np.linspace(0.0, 0.3, 40)
    options = {"v0": {"crank": 12.0}}
    seen = []
    sol = pc.simulate(
        mech, (0.0, 0.3), method="Radau", backend=backend, dense_output=True, **options,
        callback=lambda t, q, v, lam: seen.append(t),
    )  # fmt: skip
    asked = pc.simulate(mech, (0.0, 0.3), method="Radau", backend=backend, t_eval=t, **options)
    exact = pc.simulate(mech, (0.0, 0.3), rtol=1e-11, atol=1e-13, t_eval=t, **options)
    assert seen == list(sol.t)
    for rows in (sol.sol(t), (asked.q, asked.v, asked.lam)):
        np.testing.assert_allclose(rows[0], exact.q, atol=1e-6)
        np.testing.assert_allclose(rows[1], exact.v, atol=1e-3)
        np.testing.assert_allclose(rows[2], exact.lam, atol=1e-3 * np.abs(exact.lam).max())
