"""The tables of Arévalo (2008) and the identities behind them."""

import re

import numpy as np
import pytest

import pinconsist as pc
from pinconsist.dae import consistency, start
from pinconsist.dae.charts import table_row
from pinconsist.dae.consistency import trial_step
from pinconsist.dae.index1 import Index1, velocity_shift
from pinconsist.mechanism.system import MechanismSystem

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
    if isinstance(problem.system, pc.HessenbergProblem):
        return problem.system.at(problem.t0, problem.p0, problem.v0)
    return MechanismSystem(problem.system, problem.p0)


@pytest.mark.parametrize(("name", "h"), FIRST)
def test_first_step_error_to_four_digits(name, h):
    run = pc.compare(name, [h], count=2).runs[0]
    assert run.exact[0] < 1e-12  # λ[0] is the multiplier of the differential equation
    np.testing.assert_allclose((run.exact[1], run.consistent[1]), FIRST[name, h], rtol=6e-5)


@pytest.mark.parametrize("name", LATER)
def test_later_steps_to_four_digits_and_equal_for_both_starts(name):
    run = pc.compare(name, [0.001], count=6).runs[0]
    np.testing.assert_allclose(run.consistent[2:], LATER[name], rtol=2e-5)
    np.testing.assert_allclose(run.exact[2:], run.consistent[2:], rtol=1e-5)


@pytest.mark.parametrize(("name", "h"), CHANGED)
def test_changed_velocities(name, h):
    run = pc.compare(name, [h], count=1).runs[0]
    np.testing.assert_allclose(run.v_consistent, CHANGED[name, h], atol=6e-6)


@pytest.mark.parametrize("name", ["problem51", "problem52"])
def test_shifting_the_velocity_shifts_the_multiplier_exactly(name):
    """v0 - h M₁⁻¹ G₁ c leaves p₁, v₁ unchanged and adds c to λ₁ (NB M, G at the end of the step)."""
    problem, h = pc.reference_problem(name), 1e-3
    system = system_of(problem)

    def first_step(v0):
        Z = np.zeros((4, system.nx + system.nv + system.nc))
        Z[0] = table_row(system, problem.p0, problem.p0, v0, np.zeros(system.nc))
        step = trial_step(system, problem.t0, h, 1, problem.p0, Z)
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
    problem, h = pc.reference_problem(name), 1e-5
    consistent = pc.consistent_initial_velocity(system_of(problem), problem.t0, problem.p0, problem.v0, h)
    truth = problem.exact(problem.t0 + h)[2]

    def error(v0):
        sol = pc.integrate(
            problem.system, (problem.t0, problem.t0 + h), problem.p0, v0, step=h, max_order=1, consistency="exact"
        )
        return np.abs(sol.lam[-1] - truth).max()

    raw = error(problem.v0)
    changed = error(problem.v0 + factor * (consistent - problem.v0))
    assert changed / raw == pytest.approx(expected, abs=2e-3)


def test_the_general_history_agrees_with_the_paper_up_to_second_order():
    problem = pc.reference_problem("problem51")
    system = system_of(problem)
    gaps = []
    for h in (2e-3, 1e-3):
        states = start.equidistant_history(Index1(system), problem.t0, problem.p0, problem.v0, h, 1)
        base, Z = start.fill_table(system, states)
        general = consistency.consistent_history(system, h, 1, base, Z, states)[0]
        paper = pc.consistent_initial_velocity(system, problem.t0, problem.p0, problem.v0, h)
        gaps.append(np.abs(general - paper).max())
    assert np.log2(gaps[0] / gaps[1]) == pytest.approx(2.0, abs=0.1)


def test_problem51_takes_mass_forces_and_jacobian_from_pinocchio():
    problem = pc.reference_problem("problem51")
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
    problem = pc.reference_problem(name)
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
    problem = pc.reference_problem("problem52")
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
    run = pc.compare(mech, [h], count=1, v0={"crank": 12.0}).runs[0]
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
    assert [pc.compare(pc.load("crank_rocker"), [1e-4], count=1, v0=v0).runs[0].ok for v0 in start] == [True, False]


def test_constraints_without_anchors_and_general_problems_tell_their_own():
    drive = pc.load("double_pendulum")
    drive = drive.with_loops(pc.Drive("motor", drive.joints[0], lambda t: 0.1 * t))
    run = pc.compare(drive, [0.01], count=1).runs[0]
    assert (run.of, run.unit, run.true.shape) == ("the torque of motor", "N·m", (2, 1))
    general = pc.compare("problem52", [0.01], count=1).runs[0]
    assert general.of == "multiplier 2" and f"instead of {general.true[1, 0]:.3g} (" in general.verdict
