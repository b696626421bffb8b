"""Digital controllers and tables of torques against DOP853, one window a sample; runs as objects."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers.extras import skips_missing_extras
from scipy.integrate import solve_ivp

import pinconsist as pc
from pinconsist.formats.catalogue import robot_file
from pinconsist.mechanism.system import MechanismSystem
from pinconsist.paper.index1 import acceleration
from pinconsist.run.steppers import Stepper

PERIOD = 5e-3


def law(t, q, v):
    return 5.0 * (1.0 + np.sin(40.0 * t) - v[0])


@cache
def crank_rocker():
    return pc.load("crank_rocker")


@cache
def windows(count, sign=1.0, late=0):
    """(q, v, λ) at the end of so many samples, by scipy on the equations of index 1 with constant torques."""
    mech = crank_rocker()
    at = pc.assemble(mech)
    q, v, waiting, n = at.q, at.v, [0.0] * late, len(at.q)
    for k in range(count):
        t = sign * k * PERIOD
        waiting.append(law(t, q, v))
        system = MechanismSystem(mech.add_forces({"crank": waiting.pop(0)}), q)
        run = solve_ivp(
            lambda t, y, of=system: np.append(y[n:], acceleration(of, t, y[:n], y[n:])[0]),
            (t, sign * (k + 1) * PERIOD), np.append(q, v), "DOP853", rtol=1e-12, atol=1e-13,
        )  # fmt: skip
        q, v = run.y[:n, -1], run.y[n:, -1]
    lam = acceleration(system, t, q, v)[1]
    return q, v, system.full_multipliers(q, lam)


def sampled(span, method="Radau", **options):
    delay = options.pop("delay", 0.0)
    return pc.simulate(crank_rocker(), span, method=method, forces=[pc.Sampled(PERIOD, law, "crank", delay)], **options)


@pytest.mark.parametrize("method", ["Radau", "BDF"])
@pytest.mark.parametrize(("sign", "late"), [(1.0, 0), (1.0, 2), (-1.0, 1)])
def test_each_sample_is_a_window_of_constant_torque(method, sign, late):
    count = 12
    sol = sampled((0.0, sign * count * PERIOD), method, delay=late * PERIOD)
    assert sol.success
    q, v, lam = windows(count, sign, late)
    for mine, theirs, within in ((sol.q[-1], q, 1e-8), (sol.v[-1], v, 1e-7), (sol.lam[-1], lam, 1e-6)):
        np.testing.assert_allclose(mine, theirs, atol=within * (1.0 + np.abs(theirs).max()))


def test_samples_are_asked_once_and_steps_end_on_them():
    asked = []
    controller = pc.Sampled(PERIOD, lambda t, q, v: asked.append(t) or 1.0, ["crank"])
    sol = pc.simulate(crank_rocker(), (0.0, 8 * PERIOD), forces=[controller], method="Radau")
    np.testing.assert_array_equal(asked, PERIOD * np.arange(8))
    assert set(asked) <= set(sol.t)
    sol.check(error=True), sol.energy(), sol.error
    assert len(asked) == 8
    table = sol.held["sampled crank"]
    np.testing.assert_array_equal(table[:, 0], asked)
    np.testing.assert_array_equal(table[:, 1:], np.tile([1.0, 0.0, 0.0], (8, 1)))


@pytest.mark.parametrize("method", ["Radau", "BDF"])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_run_is_judged_by_what_was_held(method, sign, tmp_path):
    sol = sampled((0.0, 10 * sign * PERIOD), method)
    saved = pc.Solution.load(sol.save(tmp_path / "run.npz"))
    mech = crank_rocker().add_forces(pc.Sampled(PERIOD, law, "crank"))
    for certificate in (sol.check(error=True), saved.check(mech, error=True)):
        assert certificate.force < 1e-8
        assert certificate.energy_error < 1e-3  # powers are straight between two rows
        assert certificate.error.q < 1e-7
        assert certificate.error.force < 1e-6
    np.testing.assert_array_equal(saved.held["sampled crank"], sol.held["sampled crank"])


@pytest.mark.parametrize("method", ["Radau", "BDF"])
def test_a_callback_sees_each_step_before_the_next_sample(method):
    calls = []
    controller = pc.Sampled(PERIOD, lambda t, q, v: calls.append(("law", t)) or 1.0, "crank")
    sol = pc.simulate(
        crank_rocker(), (0.0, 3 * PERIOD), forces=[controller], method=method,
        callback=lambda t, *state: calls.append(("row", t)) or t > 1.5 * PERIOD,
    )  # fmt: skip
    assert [t for _, t in calls] == sorted(t for _, t in calls)
    assert [what for what, t in calls if t == PERIOD] == ["row", "law"]
    assert sol.status == 1
    assert sol.t[-1] == calls[-1][1]


@pytest.mark.parametrize("method", ["Radau", "BDF"])
def test_a_law_that_fails_leaves_what_was_reached(method):
    def fails(t, q, v):
        return 1.0 / (t < 2.5 * PERIOD)

    sol = pc.simulate(crank_rocker(), (0.0, 1.0), forces=[pc.Sampled(PERIOD, fails, "crank")], method=method)
    assert not sol.success
    assert sol.t[-1] == 3 * PERIOD
    assert "ZeroDivisionError" in sol.message and "sampled crank" in sol.message


@pytest.mark.parametrize("method", ["Radau", "BDF"])
def test_the_compiled_loop_starts_again_by_itself(method, monkeypatch):
    """Python begins the run, and no more; a torque that is not finite is named as Python names it."""
    begun = []
    monkeypatch.setattr(Stepper, "place", lambda *args, of=Stepper.place: begun.append(args) or of(*args))
    sol = sampled((0.0, 8 * PERIOD), method, rtol=1e-4, max_steps=40)
    assert len(begun) == 1 and np.count_nonzero(np.diff(sol.t) == 0.0) >= (method == "BDF") + 4
    assert sol.nsteps <= 40 and sol.success == (method == "Radau")
    infinite = pc.Torque(lambda t, q, v: np.array([np.nan if t > 2.1 * PERIOD else 0.0, 0.0, 0.0]))
    held = pc.Sampled(PERIOD, law, "crank")
    failed = pc.simulate(crank_rocker(), (0.0, 8 * PERIOD), forces=[infinite, held], method=method, rtol=1e-3)
    assert not failed.success and failed.t[-1] <= 2.2 * PERIOD and "not finite" in failed.message


def test_dense_output_goes_through_samples():
    sol = sampled((0.0, 6 * PERIOD), dense_output=True, rtol=1e-9, atol=1e-11)
    steps = sampled((0.0, 6 * PERIOD), rtol=1e-9, atol=1e-11, max_step=PERIOD / 7)
    q, v, lam = sol.sol(steps.t)
    after = np.append(np.diff(steps.t) > 0, True)  # at a sample itself λ is that after it
    np.testing.assert_allclose(q, steps.q, atol=1e-8)
    np.testing.assert_allclose(v, steps.v, atol=1e-6)
    np.testing.assert_allclose(lam[after], steps.lam[after], atol=1e-5)


def test_rows_of_t_eval_have_the_torques_after_a_sample():
    times = PERIOD * np.arange(6)
    sol, steps = sampled((0.0, 5 * PERIOD), t_eval=times), sampled((0.0, 5 * PERIOD))
    last = [np.flatnonzero(steps.t == t)[-1] for t in times]
    np.testing.assert_allclose(sol.lam, steps.lam[last], rtol=1e-9, atol=1e-9)
    assert sol.check(error=False).force < 1e-8


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_table_makes_the_run_again(sign):
    sol = sampled((0.0, 8 * sign * PERIOD), delay=0.5 * PERIOD)
    table = sol.held["sampled crank"]
    again = pc.simulate(
        crank_rocker(), (0.0, 8 * sign * PERIOD), method="Radau", forces=[pc.HeldTorque(table[:, 0], table[:, 1:])]
    )
    np.testing.assert_allclose(again.q[-1], sol.q[-1], atol=1e-9)
    back = pc.simulate(
        crank_rocker(), (again.t[-1], 0.0), again.q[-1], again.v[-1], method="Radau",
        forces=[pc.HeldTorque(table[:, 0], table[:, 1:])],
    )  # fmt: skip
    np.testing.assert_allclose(back.q[-1], sol.q[0], atol=1e-7)
    np.testing.assert_allclose(back.v[-1], sol.v[0], atol=1e-6)


@pytest.mark.parametrize("method", ["Radau", "BDF"])
@pytest.mark.parametrize(("start", "period"), [(86400.0, 1e-3), (2000.0, 1e-4), (1e6, 0.01)])
def test_samples_far_from_the_origin_of_time(method, start, period):
    """Times are rounded to more than a billionth of a period there; the run made no progress."""
    asked = []
    law = pc.Sampled(period, lambda t, q, v: asked.append(t) or [1.0], "crank")
    sol = pc.simulate(crank_rocker(), (start, start + 10 * period), method=method, forces=[law], max_steps=300)
    assert sol.success and len(asked) == 10
    assert np.abs(np.array(asked) - start - period * np.arange(10)).max() < 1e-14 * start


def test_two_controllers_whose_samples_nearly_agree():
    fast, slow = pc.Sampled(1e-3, law, "crank"), pc.Sampled(7e-3, lambda t, q, v: 0.1, "rocker", 1e-3)
    sol = pc.simulate(crank_rocker(), (0.0, 0.03), method="Radau", forces=[fast, slow])
    assert sol.success
    assert len(sol.held["sampled rocker"]) == 5
    assert np.diff(sol.t)[np.diff(sol.t) > 0].min() > 1e-6


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: pc.Sampled(0.0, law), "period"),
        (lambda: pc.Sampled(1e-3, 3.0), "law"),
        (lambda: pc.Sampled(1e-3, law, delay=-1.0), "delay"),
        (lambda: pc.HeldTorque([0.0, 1.0, 0.5], np.zeros((3, 3))), "increasing"),
        (lambda: pc.simulate(crank_rocker(), (0, 0.1), forces=[pc.Sampled(1e-3, law, "crnk")]), "crank"),
        (lambda: pc.simulate(crank_rocker(), (0, 0.1), forces=[pc.Sampled(1e-3, law)]), "shape"),
        (lambda: pc.simulate(crank_rocker(), (0, 0.1), forces=[pc.HeldTorque([0.0], [[1.0]])]), "columns"),
    ],
)
def test_what_cannot_be_is_refused(make, words):
    with pytest.raises(pc.InputError, match=words):
        make()


def test_a_run_is_recorded_with_what_was_held_and_made_again(tmp_path):
    controller = pc.Sampled(PERIOD, law, "crank")
    sol = pc.record("crank_rocker", (0.0, 4 * PERIOD), tmp_path / "run", forces=[controller], method="Radau")
    assert len(sol.held["sampled crank"]) == 4
    assert pc.rerun(tmp_path / "run.npz", forces=[controller]).same
    with pytest.raises(pc.InputError, match="checkpoint"):
        pc.record("crank_rocker", (0.0, 1.0), tmp_path / "run", forces=[controller], save_every=0.1)


def test_cases_of_a_sweep_have_controllers_of_their_own():
    def last(gain):
        controller = pc.Sampled(PERIOD, lambda t, q, v: gain * (1.0 - v[0]), "crank")
        return pc.simulate(crank_rocker(), (0.0, 4 * PERIOD), method="Radau", forces=[controller]).q[-1, 0]

    one, two, again = (outcome.value for outcome in pc.sweep(last, [5.0, 6.0, 5.0]))
    assert one == again != two


def test_pages_show_the_torques_that_were_held(tmp_path):
    controller = pc.Sampled(PERIOD, lambda t, q, v: 3.0, "crank")
    sol = pc.simulate(crank_rocker(), (0.0, 4 * PERIOD), method="Radau", forces=[controller])
    page = pc.export_html(crank_rocker().add_forces(controller), sol, tmp_path / "page.html", forces=True)
    plain = pc.export_html(crank_rocker(), replace(sol, held={}), tmp_path / "plain.html", forces=True)
    assert "motor crank" in page.read_text(encoding="utf-8")
    assert "motor crank" not in plain.read_text(encoding="utf-8")


@pytest.mark.parametrize("force", [
    lambda joints: pc.Sampled(0.01, lambda t, q, v: 2 * [0.0], joints),
    lambda joints: pc.HeldTorque([0.0, 0.1], np.zeros((2, 2)), joints),
], ids=["Sampled", "HeldTorque"])  # fmt: skip
@pytest.mark.parametrize("joints", [[], ["crank", "crank"], ["crank", 3], [["crank"]]])
def test_joints_are_named_once(force, joints):
    with pytest.raises(pc.InputError, match=r"one or more joints, each once|each of its joints must be a name"):
        pc.simulate(pc.load("four_bar"), (0.0, 0.1), forces=[force(joints)])


def test_a_law_that_fails_once_holds_nothing():
    """NaN was held for all later samples."""
    torques = iter([1.0, np.nan, 1.0, 1.0])
    sim = pc.Simulation(pc.load("four_bar"), forces=[pc.Sampled(0.01, lambda t, q, v: next(torques), "crank")])
    sim.step(0.01)
    with pytest.raises(pc.InputError, match=r"returned .*nan.* at t = 0\.01; torques must be finite"):
        sim.step(0.01)
    assert sim.step(0.01).t == pytest.approx(0.02)


@pytest.mark.parametrize("first_step", [None, 1e-7])
def test_a_robot_at_rest_needs_a_step_a_sample(first_step):
    """Cassie held by a PD law at 1 kHz, with two nearly dependent rows: what they do to forces is rounding, not error.

    Once steps had become short, as after a short first one, they stayed so: 50 a sample.
    """
    with skips_missing_extras():
        robot_file("cassie")
    mech = pc.load("cassie")
    motors = [joint for joint in mech.joints if joint.endswith("-op")]
    of_q = [mech.model.idx_qs[mech.joint_index(joint)] for joint in motors]
    of_v = [mech.model.idx_vs[mech.joint_index(joint)] for joint in motors]
    wanted = pc.assemble(mech).q[of_q]
    springs = [pc.JointSpring(joint, 200.0, rest=float(x)) for joint, x in zip(motors, wanted, strict=True)]
    rest = pc.equilibrium(mech.add_forces(*springs), pc.assemble(mech).q).q
    law = pc.Sampled(1e-3, lambda t, q, v: 200.0 * (wanted - q[of_q]) - 5.0 * v[of_v], joints=motors)
    run = {"forces": [law], "method": "Radau", "rtol": 1e-5, "atol": 1e-8, "first_step": first_step}
    sol = pc.simulate(mech, (0.0, 0.06), rest, **run)
    assert sol.success and sol.nsteps <= 80 and np.abs(sol.v).max() < 1e-6
    assert np.abs(sol.q - rest).max() < 1e-7
