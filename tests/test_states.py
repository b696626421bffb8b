"""States between the rows of a run: as accurate as the rows, loops closed to rounding."""

import numpy as np
import pinocchio as pin
import pytest

import pinconsist as pc
from pinconsist.mechanism.closing import LoopSolver

SPAN = (0.0, 1.0)
TIMES = np.sort(np.random.default_rng(5).uniform(*SPAN, 60))
RUNS = {
    "Radau": {"method": "Radau"},
    "Radau of order 5": {"method": "Radau", "order": 5},
    "BDF": {},
    "rows of t_eval": {"method": "Radau", "t_eval": np.linspace(*SPAN, 11)},
    "rows of t_eval by BDF": {"t_eval": np.linspace(*SPAN, 11)},
    "Radau, dense": {"method": "Radau", "dense_output": True},
    "BDF, dense": {"dense_output": True},
    "Python": {"method": "Radau"},
}


def tight(mech, times, **options):
    """States of a run at a far smaller tolerance."""
    sol = pc.simulate(mech, SPAN, method="Radau", rtol=1e-12, atol=1e-13, t_eval=times, **options)
    return sol.q, sol.v, sol.lam


def apart(mech, q, other):
    return max(np.abs(pin.difference(mech.model, *pair)).max() for pair in zip(q, other, strict=True))


@pytest.mark.parametrize("run", RUNS)
@pytest.mark.parametrize("name", ["four_bar", "delta_robot", "bricard"])
def test_states_between_rows_are_those_of_a_tight_run(name, run):
    mech = pc.load(name)
    sol = pc.simulate(mech, SPAN, **RUNS[run])
    q, v, lam = tight(mech, TIMES)
    found = sol.at(TIMES)
    # the bound of the run itself: 1e-6 relative, amplified a little over the span
    assert apart(mech, found.q, q) < 2e-6
    assert np.abs(found.v - v).max() < 2e-5 * (1.0 + np.abs(v).max())
    assert np.abs(found.lam - lam).max() < 1e-5 * np.abs(lam).max()
    solver = LoopSolver(mech)
    assert max(solver.size(each) for each in found.q) < 1e-14
    hidden = [solver.rows(q)[1] @ v for q, v in zip(found.q, found.v, strict=True)]
    assert np.abs(hidden).max() < 1e-12 * (1.0 + np.abs(v).max())
    assert np.array_equal(found.t, TIMES) and not len(found.h)


def test_straight_lines_between_long_steps_are_far_off():
    """What pages did: rows of Radau joined in a chart, 1e-2 off."""
    mech = pc.load("four_bar")
    sol = pc.simulate(mech, SPAN, method="Radau")
    middles = 0.5 * (sol.t[1:] + sol.t[:-1])
    lines = [pin.interpolate(mech.model, *pair, 0.5) for pair in zip(sol.q[:-1], sol.q[1:], strict=True)]
    assert apart(mech, lines, sol.at(middles).q) > 1e-3


def test_a_step_of_bdf_is_interpolated_to_order_six():
    """Accurate rows at even times, taken for steps of BDF: half the step leaves a 64th of the error between them."""
    mech = pc.load("planar_pendulum")
    exact = pc.simulate(mech, SPAN, method="Radau", rtol=1e-13, atol=1e-14, dense_output=True)
    errors = []
    for n in (20, 40):
        t = np.linspace(*SPAN, n + 1)
        rows = exact.at(t)
        object.__setattr__(rows, "h", np.diff(t))
        object.__setattr__(rows, "order", np.full(n, 5))
        object.__setattr__(rows, "sol", None)
        object.__setattr__(rows, "_run", None)
        rows.method.update(method="BDF")
        middles = 0.5 * (t[1:] + t[:-1])
        errors.append(apart(mech, rows.at(middles).q, exact.at(middles).q))
        exact.method.update(method="Radau")
    assert 45.0 < errors[0] / errors[1] < 90.0


@pytest.mark.parametrize("run", ["Radau", "BDF"])
def test_files_and_backwards_runs(run, tmp_path):
    mech = pc.load("four_bar")
    sol = pc.simulate(mech, SPAN, **RUNS[run])
    loaded = pc.Solution.load(sol.save(tmp_path / "run.npz"))
    with pytest.raises(pc.InputError, match=r"sol\.at\("):
        loaded.at(TIMES)
    np.testing.assert_allclose(loaded.at(TIMES, mech).q, sol.at(TIMES).q, atol=1e-12)
    back = pc.simulate(mech, SPAN[::-1], dict(zip(mech.joints, sol.q[-1], strict=True)), sol.v[-1], **RUNS[run])
    assert apart(mech, back.at(TIMES[::-1]).q[::-1], tight(mech, TIMES)[0]) < 1e-5


def test_rows_are_returned_as_they_are_and_the_later_of_two():
    sol = pc.simulate(pc.load("four_bar"), SPAN, method="Radau")
    same = sol.at(sol.t)
    for name in ("t", "q", "v", "lam"):
        assert np.array_equal(getattr(same, name), getattr(sol, name))
    pendulum = pc.load("planar_pendulum")
    bounce = pc.Event(lambda t, q, v, lam: t - 0.3, apply=lambda t, q, v: -v)
    jumping = pc.simulate(pendulum, SPAN, method="Radau", events=[bounce])
    (at,) = jumping.t_events[0]
    row = np.flatnonzero(jumping.t == at)
    assert len(row) == 2
    assert np.array_equal(jumping.at(at).v[0], jumping.v[row[1]])
    before, after = jumping.at([at - 1e-9, at + 1e-9]).v
    np.testing.assert_allclose(before, jumping.v[row[0]], atol=1e-6)
    np.testing.assert_allclose(after, jumping.v[row[1]], atol=1e-6)


def test_an_event_between_rows_of_t_eval():
    pendulum = pc.load("planar_pendulum")
    bounce = pc.Event(lambda t, q, v, lam: t - 0.3, apply=lambda t, q, v: -v)
    grid = {"t_eval": np.linspace(0.0, 1.0, 4), "method": "Radau"}
    sol = pc.simulate(pendulum, SPAN, events=[bounce], **grid)
    full = pc.simulate(pendulum, SPAN, sol.q[0], sol.v[0], events=[bounce], method="Radau")
    times = np.array([0.1, 0.25, 0.31, 0.5, 0.9])
    np.testing.assert_allclose(sol.at(times).q, full.at(times).q, atol=2e-6)


def test_torques_held_by_a_controller():
    mech = pc.load("four_bar")
    forces = [pc.Sampled(0.05, lambda t, q, v: -3.0 * v[0], "crank")]
    for method in ("BDF", "Radau"):
        sol = pc.simulate(mech, SPAN, forces=forces, method=method)
        fine = pc.simulate(mech, SPAN, forces=forces, method="Radau", rtol=1e-11, atol=1e-12, t_eval=TIMES)
        found = sol.at(TIMES)
        assert apart(mech, found.q, fine.q) < 1e-5
        np.testing.assert_allclose(found.lam, fine.lam, atol=1e-4 * (1.0 + np.abs(fine.lam).max()))


def test_driven_joints():
    mech = pc.load("four_bar")
    drive = pc.Drive("crank_motor", "crank", lambda t: 3.0 * t + 0.2 * np.sin(9.0 * t))
    driven = mech.with_loops(*mech.loops, drive)
    sol = pc.simulate(driven, SPAN, method="Radau")
    found = sol.at(TIMES)
    for t, q in zip(TIMES, found.q, strict=True):
        assert LoopSolver(driven, t).size(q) < 1e-13


@pytest.mark.parametrize("options", [{}, {"method": "Radau"}, {"t_eval": np.linspace(0.0, 1.0, 6)}])
def test_problems_of_the_general_form(options):
    """A point on the unit circle with constant speed, whose motion and multiplier have closed forms."""
    circle = pc.HessenbergProblem(
        U=lambda t, p, v: v,
        F=lambda t, p, v: np.zeros(2),
        G=lambda t, p, v: p[:, None],
        R=lambda t, p: np.array([(p @ p - 1.0) / 2]),
    )
    sol = pc.integrate(circle, SPAN, [1.0, 0.0], [0.0, 3.0], rtol=1e-9, atol=1e-10, **options)
    found = sol.at(TIMES)
    np.testing.assert_allclose(found.q, np.column_stack((np.cos(3 * TIMES), np.sin(3 * TIMES))), atol=1e-7)
    np.testing.assert_allclose((found.q**2).sum(axis=1), 1.0, atol=1e-15)
    np.testing.assert_allclose(found.lam, -9.0, rtol=1e-6)  # G λ = -v² p


def test_times_that_the_run_does_not_have():
    sol = pc.simulate(pc.load("four_bar"), SPAN, method="Radau")
    with pytest.raises(pc.InputError, match=r"covers t = 0 to 1 s, not 1\.5 s"):
        sol.at([0.5, 1.5])
    with pytest.raises(pc.InputError, match="sorted in the direction of the run"):
        sol.at([0.5, 0.4])
    with pytest.raises(pc.InputError):
        sol.at([[0.1]])
    with pytest.raises(pc.InputError):
        sol.at([np.nan])
    assert sol.at(0.5).q.shape == (1, 3)
    assert not sol.at([]).t.size
