"""What a run that could not go on says: the row that fails, and advice that fits the method."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.scenes import held_mass, sliding_mass

import pinconsist as pc
from pinconsist.engine.failure import failure_report

FAILURE = "the error test fails at any step size"


def stopped(rows, v=(3.0, -40.0, 0.5), step=None, consistency="every-step", name="BDF", t=0.25):
    """A run that stopped at `t` where R_p = `rows`, shape (nc, 3)."""
    rows = np.asarray(rows, float)
    p = np.zeros(3)
    problem = held_mass(rows).at(0.25, p, np.array(v))
    control = SimpleNamespace(best=2e-10, rtol=(np.array(1e-6),) * 2)
    method = SimpleNamespace(consistency=consistency, step=step, control=control, name=name)
    return SimpleNamespace(system=problem, method=method, t=t, h=1e-3, k=4, p=p, v=np.array(v))


@pytest.mark.parametrize("unit", [1.0, 1e-3, 1e3])
def test_rows_in_other_units_are_not_called_dependent(unit):
    text = failure_report(stopped([[1, 0, 0], [0, unit, 0]]), FAILURE)
    assert text.startswith(f"{FAILURE} at t = 0.25 with step 0.001 (order 4). ")
    assert "dependent" not in text and "largest velocity there is 40;" in text


@pytest.mark.parametrize("unit", [1.0, 1e-3, 1e3])
@pytest.mark.parametrize(("angle", "near"), [(1e-3, True), (0.005, True), (0.05, False)])
def test_rows_that_nearly_agree_are_dependent_in_any_units(angle, near, unit):
    """Unit rows at a small angle φ have the singular values √(1 ± cos φ): their ratio is tan(φ/2)."""
    text = failure_report(stopped([[1, 0, 0], [unit * np.cos(angle), unit * np.sin(angle), 0]]), FAILURE)
    assert ("nearly dependent" in text) == near
    assert not near or f"smallest singular value {np.tan(angle / 2):.1e} of the largest" in text


def test_the_row_that_fades_away_is_named():
    text = failure_report(stopped([[0, 0, 1], [1e-6, 0, 0], [0, 1, 0]]), FAILURE)
    assert "nearly dependent there (row 1 of R; smallest singular value 1.0e-06" in text


@pytest.mark.parametrize(
    ("step", "advice"), [(0.01, "try a smaller step"), (None, "try looser tolerances, or max_step")]
)
def test_advice_fits_the_method(step, advice):
    assert advice in failure_report(stopped([[1, 0, 0]], step=step), FAILURE)


@pytest.mark.parametrize(("told", "options"), [
    ("pass its rate and acceleration as well, or use BDF", {"name": "Radau"}), ("start the run near t = 0", {"t": 1e9}),
], ids=["drive", "late"])  # fmt: skip
def test_what_else_to_try(told, options):
    assert told in failure_report(stopped([[1, 0, 0]], **options), FAILURE)
    assert told not in failure_report(stopped([[1, 0, 0]]), FAILURE)


@pytest.mark.parametrize(("step", "consistency", "told"), [
    (None, "exact", True), (None, "initial", True), (0.01, "exact", False), (None, "every-step", False),
])  # fmt: skip
def test_uncorrected_multipliers_are_blamed_only_where_steps_vary(step, consistency, told):
    text = failure_report(stopped([[1, 0, 0]], step=step, consistency=consistency), FAILURE)
    assert (f"consistency='{consistency}' with variable steps" in text) == told
    assert ("largest velocity" in text) != told


def test_numbers_that_are_not_finite_are_traced_to_the_users_functions():
    assert "a force or a user-defined function returned NaN" in failure_report(
        stopped([[1, 0, 0]]), "the residual is not finite"
    )


def surface(q, v):
    return v[0] + 5.0 * (q[0] - 0.1)


def relay(t, q, v):
    return np.array([-200.0 * np.sign(surface(q, v))])


def deadband(t, q, v):
    return np.array([-200.0 * np.sign(surface(q, v)) * (abs(surface(q, v)) > 1e-7)])


@pytest.mark.parametrize("law", [relay, deadband])
def test_forces_that_chatter_end_a_run_soon(law):
    sol = pc.simulate(sliding_mass(law), (0.0, 1.0), max_steps=5000, method="BDF")
    assert not sol.success and sol.nsteps < 2500, sol.message
    assert (
        f"'torque {law.__name__}' jumps" in sol.message
        and "tanh(s/width)" in sol.message
        and "JointFriction, over a larger width" in sol.message
    )


def smooth(t, q, v):
    return np.array([-200.0 * np.tanh(surface(q, v) / 1e-3)])


@pytest.mark.parametrize(("force", "until"), [
    (smooth, 10.0), (pc.JointFriction({"rail": 200.0}, 1e-8), 1e5), (pc.JointDamping({"rail": 1e9}), 1e5),
])  # fmt: skip
def test_what_is_advised_and_what_is_only_stiff_runs(force, until):
    sol = pc.simulate(sliding_mass(force), (0.0, until), max_steps=5000)
    assert sol.success, sol.message


def test_a_steep_force_that_is_smooth_is_not_stopped():
    """Newton fails at every third step, and 700,000 steps are to come; but they come."""
    sol = pc.simulate(sliding_mass(smooth), (0.0, 1e5), max_steps=2500, method="BDF")
    assert "max_steps" in sol.message and sol.rejected["newton"] > 0.3 * sol.nsteps


def test_a_force_that_chatters_near_the_end_does_not_end_a_run():
    """Few steps are to come then, and they are made."""
    span = (0.0, 1.0)
    ended = pc.simulate(sliding_mass(relay), span, max_steps=5000, method="BDF")
    sol = pc.simulate(sliding_mass(relay), (0.0, 0.9 * ended.t[-1]), max_steps=5000, method="BDF")
    assert sol.success and sol.rejected["newton"] <= ended.rejected["newton"]


def test_a_drive_out_of_reach_is_refused_soon_near_rounding():
    mech = pc.load("four_bar")
    start = pc.assemble(mech).q
    driven = mech.add_loops(pc.Drive("motor", "rocker", pc.Motion(start[2], 1.0)))
    sol = pc.simulate(driven, (0.0, 10.0), start, rtol=1e-13, atol=1e-15, max_steps=20_000)
    assert not sol.success and "loop 'motor' row motor" in sol.message and sol.nsteps < 15_000, sol.message


def test_the_advice_for_a_run_that_ended_early_is_in_its_message():
    good = pc.simulate(pc.load("four_bar"), (0.0, 0.05)).check(error=False)
    assert "tighten rtol" in str(replace(good, force=0.5))
    assert "tighten rtol" not in str(replace(good, force=0.5, ended_early=True))
