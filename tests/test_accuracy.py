"""The global error that a solution estimates, against independent answers."""

import numpy as np
import pinocchio as pin
import pytest

import pinconsist as pc
from pinconsist.mechanism.energy import integrals


def truth(sol, times):
    """q and v of scipy's DOP853 on the index-1 equations."""
    answer = pc.paper.reference_solution(sol.system, sol.t[0], sol.q[0], sol.v[0], times, rtol=1e-12, atol=1e-12)
    return answer.q, answer.v


@pytest.mark.parametrize("tol", [1e-3, 1e-6])
@pytest.mark.parametrize("method", ["BDF", "Radau"])
@pytest.mark.parametrize(("name", "T"), [("crank_rocker", 1.0), ("delta_robot", 0.2), ("planar_pendulum", 2.0)])
def test_the_estimate_is_the_error(name, T, method, tol):
    sol = pc.simulate(pc.load(name), (0.0, T), rtol=tol, atol=1e-2 * tol, method=method)
    rows = np.linspace(len(sol.t) // 2, len(sol.t) - 1, 8).astype(int)
    q, _ = truth(sol, sol.t[rows])
    model = sol.system.model
    error = max(np.abs(pin.difference(model, a, b)).max() for a, b in zip(sol.q[rows], q, strict=True))
    assert 0.3 * error < sol.error.q < 10 * error  # the largest may be in the first half
    assert sol.error.tolerances < 10


def test_beside_rounding_the_finer_run_is_one_of_radau():
    """A BDF of a tenth of the tolerance would make the same rounding errors."""
    sol = pc.simulate(pc.load("crank_rocker"), (0.0, 0.5), rtol=1e-10, atol=1e-12)
    q, _ = truth(sol, sol.t[-1:])
    assert np.abs(sol.q[-1] - q[-1]).max() < 3 * sol.error.q < 1e-8


def test_a_chaotic_motion_is_named():
    mech = pc.load("double_pendulum")
    sol = pc.simulate(mech, (0.0, 30.0), dict.fromkeys(mech.joints, 2.5), rtol=1e-6, atol=1e-8)
    assert sol.error.tolerances > 1e3 and f"in tolerances   {sol.error.tolerances:11.0f} " in str(sol.error)
    assert "the motion amplifies perturbations" in str(sol.check())
    assert sol.check(error=False).error is None


@pytest.mark.parametrize("method", [{"step": 1e-3, "order": 2, "method": "BDF"}, {"step": 0.05}])
def test_fixed_steps_are_halved(method):
    sol = pc.simulate(pc.load("four_bar"), (0.0, 0.5), **method)
    q, _ = truth(sol, sol.t[-1:])
    error = np.abs(sol.q[-1] - q[-1]).max()
    assert 0.5 * error < sol.error.q < 2 * error and sol.error.tolerances is None


def test_the_verdict_says_if_the_error_is_not_estimated(monkeypatch):
    sol = pc.simulate(pc.load("four_bar"), (0.0, 0.5))
    monkeypatch.setattr("pinconsist.run.solution.FINER_TIME", 0.0)
    late = sol.check()
    assert late.ok and late.error is None and late.verdict.endswith(": ok; not judged: error")
    assert "a finer run takes more than 0 s of processor time; check(error=True) waits for it" in str(late)
    assert sol.check(error=False).not_judged == ["error"]
    found = sol.check(error=True)
    assert found.error.q > 0.0 and found.not_judged == [] and "not judged" not in str(found)
    assert sol.check() is found


def test_events_of_both_runs_are_matched():
    """Rows between an impact of one run and that of the other would differ by the whole jump."""
    mech = pc.load("planar_pendulum")
    bounce = pc.Event(lambda t, q, v, lam: q[0], apply=lambda t, q, v: -0.9 * v, direction=-1)
    sol = pc.simulate(mech, (0.0, 8.0), v0=[3.0], events=bounce, rtol=1e-5, atol=1e-7)
    assert len(sol.t_events[0]) > 1 and sol.error.tolerances < 100


def test_rows_of_t_eval_and_a_solution_from_a_file(tmp_path):
    mech = pc.load("four_bar")
    sol = pc.simulate(mech, (0.0, 1.0), t_eval=[0.2, 0.5, 0.9])
    assert 0.0 < sol.error.q < 1e-5
    sol = pc.record("four_bar", (0.0, 0.5), tmp_path / "run.npz")
    read = pc.Solution.load(tmp_path / "run.npz")
    assert read.check(pc.load("four_bar")).error.q == pytest.approx(sol.error.q, rel=1e-6)


def test_a_general_problem():
    problem = pc.paper.reference_problem("problem51")
    sol = pc.integrate(problem.system, (0.0, 1.0), problem.p0, problem.v0, rtol=1e-6, atol=1e-6)
    error = max(np.abs(q - problem.exact(t)[0]).max() for t, q in zip(sol.t, sol.q, strict=True))
    assert error / 3 < sol.error.q < 3 * error


def two_drives():
    """A globe that turns about a tilted axis on an arm that turns: both speeds are constant, so steps are long."""
    model, tilt = pin.Model(), np.array([0.4, 0.0, np.sqrt(1.0 - 0.4**2)])
    year = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "year")
    model.appendBodyToJoint(year, pin.Inertia(1.0, np.zeros(3), 0.1 * np.eye(3)), pin.SE3.Identity())
    day = model.addJoint(year, pin.JointModelRevoluteUnaligned(tilt), pin.SE3(np.eye(3), 2.0 * np.eye(3)[0]), "day")
    model.appendBodyToJoint(day, pin.Inertia(3.0, np.zeros(3), np.diag([0.2, 0.2, 0.3])), pin.SE3.Identity())
    return pc.Mechanism(model, [pc.Drive("y", "year", lambda t: 0.5 * t), pc.Drive("d", "day", lambda t: 20.0 * t)])


@pytest.mark.parametrize("method", ["BDF", "Radau"])
def test_forces_that_change_between_long_steps_are_no_alarm(method):
    """The rows are right, however far apart they are: motor torques by inverse dynamics of the prescribed motion."""
    mech, speeds = two_drives(), np.array([0.5, 20.0])
    sol = pc.simulate(mech, (0.0, 3.0), method=method)
    model, data = mech.model, mech.model.createData()
    true = np.array([pin.rnea(model, data, speeds * t, speeds, np.zeros(2)) for t in sol.t])
    assert np.abs(sol.lam - true).max() < 1e-7 and np.diff(sol.t).max() > 0.1
    found = sol.check()
    assert found.ok and not found.not_judged and found.error.force < 1e-7
    assert found.energy_error < 1e-8  # the work is that along the finer run; a spline through the rows is off by 8 %
    energy, rows = sol.energy(), sum(sol.energy().power.values())
    by_rows = integrals(sol.t, rows[:, None])[:, 0]
    assert np.abs(energy.total - energy.total[0] - by_rows).max() > 1e-3 * energy.exchanged > np.abs(energy.error).max()
    rows = sol.check(error=False)
    assert rows.ok and ("energy" in rows.not_judged or rows.energy_error < 0.01)


def body_on_a_spring(force=None, road=0.0):
    """A body of 300 kg on a spring and a damper above a road, which moves as it is told; in equilibrium."""
    model = pin.Model()
    for name, mass in ("road", 1.0), ("body", 300.0):
        joint = model.addJoint(model.njoints - 1, pin.JointModelPZ(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(joint, pin.Inertia(mass, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    forces = [pc.JointSpring("body", 2e4, 300.0 * 9.81 / 2e4), pc.JointDamping({"body": 2e3})]
    forces += [] if force is None else [pc.Torque(force)]
    return pc.Mechanism(model, [pc.Drive("road", "road", road if callable(road) else pc.Motion(road))], forces)


def pulse(start, duration, size):
    """Smooth, and zero before and after."""
    return lambda t: size * np.sin(np.pi * (t - start) / duration) ** 4 if start < t < start + duration else 0.0


@pytest.mark.parametrize("method", ["BDF", "Radau"])
@pytest.mark.parametrize("kind", ["force", "force along the way", "road"])
def test_a_pulse_that_a_run_steps_over_is_never_ok(kind, method):
    """The body is hit for 40 ms of 10 s; the true motion is that of a run with steps of 2 ms."""
    hit = pulse(6.03, 0.04, 5e3)
    if kind == "force":
        mech = body_on_a_spring(lambda t, q, v: np.array([0.0, hit(t)]))
    elif kind == "road":
        mech = body_on_a_spring(road=pulse(6.03, 0.05, 0.05))
    else:
        mech = body_on_a_spring(lambda t, q, v: np.array([0.0, hit(5.0 * q[0])]), lambda t: 0.2 * t)
    sol = pc.simulate(mech, (0.0, 10.0), method=method)
    true = pc.simulate(mech, (0.0, 10.0), method="Radau", max_step=2e-3, t_eval=sol.t)
    error, found = np.abs(sol.q - true.q).max(), sol.check()
    assert np.abs(true.q[:, 1]).max() > 1e-3 or error > 1e-4  # it is hit
    assert not found.ok or (not found.not_judged and error < 1e-4)
    assert found.error.q == pytest.approx(error, rel=0.3, abs=1e-6)


def test_a_fixed_step_over_a_pulse_is_never_ok():
    hit = pulse(6.03, 0.04, 5e3)
    sol = pc.simulate(
        body_on_a_spring(lambda t, q, v: np.array([0.0, hit(t)])), (0.0, 10.0), step=0.2, order=2, method="BDF"
    )
    assert not sol.check().ok


@pytest.mark.parametrize("method", ["BDF", "Radau"])
def test_a_pulse_between_the_looks_of_a_finer_run_is_never_ok(method):
    """It lasts for 5 ms of 10 s, and begins right after one of a thousand even times."""
    hit = pulse(6.0305, 0.005, 1e4)
    sol = pc.simulate(body_on_a_spring(lambda t, q, v: np.array([0.0, hit(t)])), (0.0, 10.0), method=method)
    impulse = 1e4 * 0.005 * 3 / 8  # of sin⁴
    found = sol.check()
    if np.abs(sol.v[:, 1]).max() < 0.1 * impulse / 300.0:  # it was stepped over
        assert not found.ok and found.error.v > 1e-5
