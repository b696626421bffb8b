"""The tables of Arévalo (2008) and the identities behind them."""

import re
import subprocess
import sys

import numpy as np
import pinocchio as pin
import pytest
from helpers import scenes

import pinconsist as pc
from pinconsist.mechanism.system import MechanismSystem
from pinconsist.paper.consistency import MODES, bdf_step, consistent_history, general_history
from pinconsist.paper.index1 import index3_system, states_at, velocity_shift
from pinconsist.paper.step import State

# |λ_n - λ(t_n)| at the first step from exact and from consistent values, then steps 2..6, which both share.
FIRST = {
    ("problem51", 0.01): (2.0808, 8.1200e-2),
    ("problem51", 0.001): (2.0080, 8.0120e-3),
    ("problem51", 1e-4): (2.0008, 8.0013e-4),
    ("problem52", 0.01): (1.0404, 4.0600e-2),
    ("problem52", 0.001): (1.0040, 4.0060e-3),
    ("problem52", 1e-4): (1.0004, 4.0007e-4),
}
LATER = {
    "problem51": [8.0341e-3, 8.0743e-3, 8.1147e-3, 8.1553e-3, 8.1960e-3],
    "problem52": [4.0170e-3, 4.0372e-3, 4.0574e-3, 4.0776e-3, 4.0980e-3],
}
CHANGED = {
    ("problem51", 0.01): (1.09765, -1.67248),
    ("problem51", 0.001): (1.08229, -1.68186),
    ("problem52", 0.001): (-0.728269, 0.937290, 1.0),
}


def system_of(problem):
    return index3_system(problem.system, problem.t0, problem.p0, problem.v0)


@pytest.mark.parametrize(("name", "h"), FIRST)
def test_first_step_error_to_four_digits(name, h):
    run = pc.paper.compare(name, [h], count=2).runs[0]
    assert run.exact[0] < 1e-12  # λ[0] is the multiplier of the differential equation
    np.testing.assert_allclose((run.exact[1], run.consistent[1]), FIRST[name, h], rtol=6e-5)


@pytest.mark.parametrize("name", LATER)
def test_later_steps_to_four_digits_and_equal_for_both_starts(name):
    run = pc.paper.compare(name, [0.001], count=6).runs[0]
    np.testing.assert_allclose(run.consistent[2:], LATER[name], rtol=2e-5)
    np.testing.assert_allclose(run.exact[2:], run.consistent[2:], rtol=1e-5)


@pytest.mark.parametrize(("name", "h"), CHANGED)
def test_changed_velocities(name, h):
    run = pc.paper.compare(name, [h], count=1).runs[0]
    np.testing.assert_allclose(run.v_consistent, CHANGED[name, h], atol=6e-6)


@pytest.mark.parametrize("name", ["problem51", "problem52"])
def test_shifting_the_velocity_shifts_the_multiplier_exactly(name):
    """v0 - h M₁⁻¹ G₁ c leaves p₁, v₁ unchanged and adds c to λ₁ (NB M, G at the end of the step)."""
    problem, h = pc.paper.reference_problem(name), 1e-3
    system = system_of(problem)

    def first_step(v0):
        step = bdf_step(system, [State(problem.t0, problem.p0, v0, np.zeros(system.nc))], h, 1)
        return step.p, step.v, step.lam

    p1, v1, lam1 = first_step(problem.v0)
    c = np.arange(1.0, system.nc + 1)
    _, _, G, _ = system.evaluate(problem.t0 + h, p1, v1, np.zeros(system.nv))
    p2, v2, lam2 = first_step(problem.v0 - h * G @ c)  # M = 1 in both problems
    np.testing.assert_allclose(p2, p1, atol=1e-15)
    np.testing.assert_allclose(v2, v1, atol=1e-12)
    np.testing.assert_allclose(lam2 - lam1, c, atol=1e-8)


@pytest.mark.parametrize("name", ["problem51", "problem52"])
@pytest.mark.parametrize(("factor", "expected"), [(-1.0, 2.0), (0.5, 0.5), (1.0, 0.0)])
def test_only_the_right_sign_and_size_cures_the_first_multiplier(name, factor, expected):
    """A wrong sign doubles the O(1) error, half the change halves it."""
    problem, h = pc.paper.reference_problem(name), 1e-5
    consistent = pc.paper.consistent_initial_velocity(system_of(problem), problem.t0, problem.p0, problem.v0, h)
    truth = problem.exact(problem.t0 + h)[2]

    def error(v0):
        sol = pc.paper.solve(problem.system, (problem.t0, problem.t0 + h), problem.p0, v0, h, consistency="exact")
        return np.abs(sol.lam[-1] - truth).max()

    raw = error(problem.v0)
    changed = error(problem.v0 + factor * (consistent - problem.v0))
    assert changed / raw == pytest.approx(expected, abs=2e-3)


def test_the_general_history_agrees_with_the_paper_up_to_second_order():
    problem = pc.paper.reference_problem("problem51")
    system = system_of(problem)
    gaps = []
    for h in (2e-3, 1e-3):
        history = states_at(system, problem.t0, problem.p0, problem.v0, [problem.t0])
        general = general_history(system, history, h, 1)[0].v
        paper = consistent_history(system, history, h, 1)[0].v
        gaps.append(np.abs(general - paper).max())
    assert np.log2(gaps[0] / gaps[1]) == pytest.approx(2.0, abs=0.1)


def test_problem51_takes_mass_forces_and_jacobian_from_pinocchio():
    problem = pc.paper.reference_problem("problem51")
    system = MechanismSystem(problem.system, problem.p0)
    q, v = np.array([0.3, -0.8]), np.array([1.0, 2.0])
    np.testing.assert_allclose(system.mass_matrix(q), np.eye(2), atol=1e-15)
    f, phi, G, _ = system.evaluate(0.0, q, v, np.zeros(2))
    np.testing.assert_allclose(f, [-2 * q[1], 2 * q[0]], atol=1e-15)
    np.testing.assert_allclose(phi, [(q @ q - 1) / 2], atol=1e-15)
    np.testing.assert_allclose(G[:, 0], q, atol=1e-15)


@pytest.mark.parametrize("name", ["problem51", "problem52"])
def test_closed_forms_solve_the_equations(name):
    """Finite differences of the closed form satisfy both equations and the constraint."""
    problem = pc.paper.reference_problem(name)
    system = system_of(problem)
    d = 1e-5
    for t in problem.t0 + np.array([0.05, 0.2, 0.4]):
        p, v, lam = problem.exact(t)
        (p2, v2, _), (p1, v1, _) = problem.exact(t + d), problem.exact(t - d)
        np.testing.assert_allclose((p2 - p1) / (2 * d), system.rate(t, p, v), atol=1e-8)
        f, phi, G, _ = system.evaluate(t, p, v, (v2 - v1) / (2 * d))
        np.testing.assert_allclose(f, G @ lam, atol=1e-7)
        np.testing.assert_allclose(phi, 0.0, atol=1e-15)


def test_velocity_shift_is_the_smallest_with_that_residual():
    problem = pc.paper.reference_problem("problem52")
    system = system_of(problem)
    rho = np.array([0.3, -0.2])
    shift = velocity_shift(system, problem.t0, problem.p0, problem.v0, rho)
    before = system.constraint(problem.t0, problem.p0, system.rate(problem.t0, problem.p0, problem.v0))[1]
    after = system.constraint(problem.t0, problem.p0, system.rate(problem.t0, problem.p0, problem.v0 + shift))[1]
    np.testing.assert_allclose(after - before, rho, atol=1e-14)
    _, _, G, _ = system.evaluate(problem.t0, problem.p0, problem.v0, np.zeros(3))
    outside = shift - G @ np.linalg.lstsq(G, shift, rcond=None)[0]
    np.testing.assert_allclose(outside, 0.0, atol=1e-14)


def test_what_is_wrong_is_the_force_that_is_seen():
    """The force in the loop of a mechanism, against that of a run with a thousandth of the step."""
    mech, h = pc.load("crank_rocker"), 1e-3
    run = pc.paper.compare(mech, [h], count=1, v0={"crank": 12.0}).runs[0]
    fine = pc.simulate(mech, (0.0, h), v0={"crank": 12.0}, rtol=1e-9, atol=1e-11)
    exact = pc.simulate(mech, (0.0, h), v0={"crank": 12.0}, method="ImplicitEuler", step=h, consistency="exact")
    true, wrong = (sol.reaction("rocker_ground").force[-1] for sol in (fine, exact))
    told = re.search(r"is (\S+) N, turned by \S+ instead of (\S+) N \((\S+) %", run.verdict)
    size, true_size, share = map(float, told.groups())
    assert run.loop == "rocker_ground" and run.unit == "N"
    assert size == pytest.approx(np.linalg.norm(wrong), rel=6e-3)
    assert true_size == pytest.approx(np.linalg.norm(true), rel=6e-3)
    assert share == pytest.approx(100 * np.linalg.norm(wrong - true) / np.linalg.norm(true), rel=2e-2)


def test_from_rest_the_first_force_is_not_far_off():
    start = {"crank": 0.0}, {"crank": 12.0}
    runs = [pc.paper.compare(pc.load("crank_rocker"), [1e-4], count=1, v0=v0).runs[0] for v0 in start]
    assert [run.ok for run in runs] == [True, False]


def test_constraints_without_anchors_and_general_problems_tell_their_own():
    drive = pc.load("double_pendulum")
    drive = drive.with_loops(pc.Drive("motor", drive.joints[0], lambda t: 0.1 * t))
    run = pc.paper.compare(drive, [0.01], count=1).runs[0]
    assert (run.of, run.unit, run.true.shape) == ("the torque of motor", "N·m", (2, 1))
    general = pc.paper.compare("problem52", [0.01], count=1).runs[0]
    # both multipliers are wrong by the same amount; which is the larger one is rounding
    assert general.of in ("multiplier 1", "multiplier 2")
    assert f"instead of {general.true[1, 0]:.3g} (" in general.verdict


@pytest.mark.parametrize("k", range(1, 7))
@pytest.mark.parametrize("consistency", MODES)
@pytest.mark.parametrize("name", ["problem51", "problem52"])
def test_fixed_steps_of_the_engine_are_those_of_the_paper(name, consistency, k):
    """Positions and velocities to rounding and Newton's accuracy; multipliers to a fraction of their error."""
    problem, h = pc.paper.reference_problem(name), 1 / 200
    span = problem.t0, problem.t0 + 20 * h
    ours = pc.paper.solve(problem.system, span, problem.p0, problem.v0, h, order=k, consistency=consistency)
    engine = pc.integrate(
        problem.system, span, problem.p0, problem.v0, step=h, order=k, consistency=consistency, method="BDF"
    )
    np.testing.assert_allclose(ours.t, engine.t, atol=1e-14)
    truth = [np.array(column) for column in zip(*map(problem.exact, ours.t), strict=True)]
    floor = 1e-13, 1e-13 / h, 1e-13 / h**2
    parts = (ours.p, engine.q), (ours.v, engine.v), (ours.lam, engine.lam)
    for (mine, others), exact, rounding in zip(parts, truth, floor, strict=True):
        assert np.abs(mine - others).max() <= 0.05 * np.abs(mine - exact).max() + rounding


@pytest.mark.parametrize("k", [1, 2, 3, 5])
@pytest.mark.parametrize("name", ["spherical_chain", "floating_four_bar"])
def test_orders_of_the_paper_where_bodies_turn(name, k):
    """Spherical joints and a free body: positions in charts at the predicted position, without derivatives of exp."""
    mech, v0 = {
        "spherical_chain": (scenes.spherical_chain(), np.array([0.5, -1.0, 0.3, 1.0, 0.4, -0.6])),
        "floating_four_bar": (scenes.four_bar(floating=True), {"ground": (0.3, 0, 0.2, 1.0, 2.0, -1.0), "crank": 3.0}),
    }[name]
    start = pc.assemble(mech, None, v0)
    T, steps, count = 0.2, {1: 200, 2: 100, 3: 100, 5: 40}[k], 10
    times = np.linspace(0.0, T, count + 1)[1:]
    truth = pc.paper.reference_solution(mech, 0.0, start.q, start.v, times)
    errors = []
    for n in (steps, 2 * steps):
        run = pc.paper.solve(mech, (0.0, T), start.q, start.v, T / n, order=k)
        rows = n // count * np.arange(1, count + 1)
        apart = [pin.difference(mech.model, a, b) for a, b in zip(truth.q, run.p[rows], strict=True)]
        parts = apart, run.v[rows] - truth.v, run.lam[rows] - truth.lam
        errors.append([np.sqrt(np.mean(np.square(part))) for part in parts])
    assert (np.log2(np.divide(*errors)) > k - 0.3).all(), errors


def test_the_paper_works_without_pinocchio():
    code = """
import sys
sys.modules["pinocchio"] = None
from pinconsist import paper
problem = paper.reference_problem("problem52")
run = paper.solve(problem.system, (1.0, 1.1), problem.p0, problem.v0, 0.001, order=3)
print(abs(run.lam[-1] - problem.exact(1.1)[2]).max() < 1e-6, paper.compare("problem52", [0.01]).runs[0].ok)
"""
    printed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert printed.split() == ["True", "False"]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"step": -0.1}, "step must be positive"),
        ({"step": float("nan")}, "step must be positive"),
        ({"order": 7}, "from 1 to 6"),
        ({"consistency": "none"}, "every-step"),
        ({"p0": [1.0, np.nan]}, "p0 must be finite"),
        ({"t_span": (0.0, 0.0)}, "not empty"),
        ({"t_span": "abc"}, "t_span must be numbers"),
    ],
)
def test_arguments_that_the_paper_refuses(arguments, says):
    problem = pc.paper.reference_problem("problem51")
    good = {"t_span": (0.0, 0.1), "p0": problem.p0, "v0": problem.v0, "step": 0.01}
    with pytest.raises(pc.InputError, match=says):
        pc.paper.solve(problem.system, **(good | arguments))


def test_forces_that_hardly_differ_are_told_with_more_digits():
    run = pc.paper.compare(pc.load("four_bar"), [1e-3], count=6).runs[0]
    found, true = re.search(r"is (\S+) N instead of (\S+) N", run.verdict).groups()
    assert found != true and float(found) == pytest.approx(float(true), rel=1e-4)
