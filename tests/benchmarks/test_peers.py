"""Every peer that is installed solves what it is measured on, to what its setting promises; no timings."""

from dataclasses import replace
from functools import partial

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import null_space

import pinconsist as pc
from benchmarks.dense_reference import DenseReference
from benchmarks.equal_error import at_equal_error
from benchmarks.peers import OWN, peers
from benchmarks.peers.dae_solvers import Equations
from benchmarks.peers.problem import Peer, Problem, SolverFailed
from benchmarks.peers.scenes import problem_of
from benchmarks.peers.scipy_index1 import accelerations
from benchmarks.work_precision import FEWEST_STEPS, Point, _chosen, work_precision
from pinconsist.errors import InputError, PinconsistError
from pinconsist.paper import reference_problem
from pinconsist.paper.index1 import acceleration, right_hand_side

PEERS = {peer.name: peer for peer in peers() if not (peer.detail and not peer.fixed_step)}
SHORT = {"problem51": 0.3, "pendulum": 0.5, "crank_rocker": 0.1}
ORDERS = {  # of methods of fixed step, in q, v and λ (of all steps); None where it need not converge
    **{f"pinconsist fixed BDF-{k}, every-step": (k, k, k) for k in (1, 2, 3)},  # higher ones: test_order.py
    **{f"pinconsist fixed BDF-{k}, initial": (k, k, k) for k in (1, 2, 3)},
    **{f"pinconsist fixed BDF-{k}, exact": (k, k, k - 1) for k in (1, 2, 3)},  # the first steps of raw BDF
    "Exudyn generalized-α, index 3": (2, 2, 1),
    "Exudyn trapezoidal, index 2": (2, 2, 2),
    "MuJoCo implicitfast, soft loops": (1, 1, None),  # its soft loops swing in again at every step size
}
SLACK = 0.3  # of an order seen between two step sizes
STEPS = 50
EPS = np.finfo(float).eps


@pytest.fixture(scope="module", params=SHORT)
def reference(request):
    return DenseReference(problem_of(request.param, SHORT[request.param]))


def _run(reference, name, setting):
    """(steps, errors of q, v and λ) or a skip."""
    peer, counts = PEERS[name], []
    if reason := peer.missing() or peer.can(reference.problem):
        pytest.skip(reason)

    def thin(count, first=1):
        counts.append(count - 1)
        return np.unique(np.r_[0, first, np.linspace(0, count - 1, 60).astype(int)])

    solve, read = peer.prepare(reference.problem, setting)
    rows = read(solve(), thin)
    assert rows.t[0] == 0.0 and rows.t[-1] == pytest.approx(reference.problem.span[1], abs=1e-12)
    return counts[0], np.array(reference.errors(rows)[:3])


@pytest.mark.parametrize("name", ORDERS)
def test_half_the_step_gives_the_errors_of_the_order(reference, name):
    (_, coarse), (_, fine) = (_run(reference, name, steps) for steps in (STEPS, 2 * STEPS))
    h = reference.problem.span[1] / (2 * STEPS)
    raw = not name.endswith("every-step")
    floor = 10 * reference.uncertainty * np.ones(3) + (0.0, EPS / h, 100 * EPS / h**2 if raw else 100 * EPS / h)
    for error, half, least, order in zip(coarse, fine, floor, ORDERS[name], strict=True):
        if order is not None:
            assert half < max(least, error * 2.0 ** (SLACK - order))


@pytest.mark.parametrize("name", [name for name, peer in PEERS.items() if not peer.fixed_step])
def test_errors_are_what_the_tolerance_lets_add_up(reference, growth, name):
    """At worst all local errors, each tol (1 + |y|), are of one sign, and grow like a change of the state."""
    tols = np.array([1e-4, 1e-6] if "Euler" in name else [1e-6, 1e-8])
    counts, errors = zip(*(_run(reference, name, tol) for tol in tols), strict=True)
    for count, error, tol in zip(counts, errors, tols, strict=True):
        bound = count * tol * growth
        assert (error[:2] < bound[:2]).all()
        if "GGL" not in name:
            assert error[2] < bound[2]
    if "GGL" in name:  # λ is out of the test; that of a first step of order 1, h ∝ √tol, is off in proportion to h
        assert errors[1][2] < errors[0][2] * (tols[1] / tols[0]) ** (0.5 * (1 - SLACK))


@pytest.fixture(scope="module")
def growth(reference):
    """Changes of q, v and λ anywhere for a local error of tolerance 1 in q and v at the start, scaled as errors are."""
    problem, system = reference.problem, reference.problem.system
    n, size, times = system.nv, 1e-5, np.linspace(*reference.problem.span, 50)
    rows = reference.at(times)
    rate = right_hand_side(system, problem.q0, partial(acceleration, system))
    gains = np.zeros((3, 2))
    for tangent in null_space(system.loop_rows(problem.q0)[1]).T:
        for part, change in enumerate(((size * tangent, 0 * tangent), (0 * tangent, size * tangent))):
            start = np.concatenate((problem.q0, problem.v0)) + np.concatenate(change)
            y = solve_ivp(rate, problem.span, start, "DOP853", rtol=1e-11, atol=1e-11, t_eval=times).y.T
            kept = [acceleration(system, t, row[:n], row[n:])[1] for t, row in zip(times, y, strict=True)]
            moved = y[:, :n], y[:, n:], problem.multipliers(y[:, :n], kept)
            changes = [np.abs(a - b).max() / size for a, b in zip(moved, rows, strict=True)]
            gains[:, part] = np.maximum(gains[:, part], changes)
    q, v, lam = (np.abs(part).max() for part in rows)
    return gains @ (1 + q, 1 + v) / (1.0, v, lam)


@pytest.mark.parametrize("order", [5, 2])
def test_raw_bdf_of_variable_step_says_why_it_fails(order):
    problem = problem_of("problem51", 0.3)
    peer = next(peer for peer in peers() if peer.name == f"pinconsist BDF ≤ {order}, exact")
    solve, read = peer.prepare(problem, 1e-7)
    with pytest.raises(SolverFailed, match="use consistency='every-step'"):
        read(solve(), np.arange)


def test_a_method_must_be_written():
    with pytest.raises(TypeError, match="prepare"):
        Peer()


def test_exact_problem_as_reference():
    exact = reference_problem("problem51").exact
    q, v, lam = DenseReference(problem_of("problem51")).at(np.array([0.0, 0.4, 1.0]))
    for t, *ours in zip((0.0, 0.4, 1.0), q, v, lam, strict=True):
        for a, b in zip(ours, exact(t), strict=True):
            assert np.abs(a - b).max() < 1e-10


@pytest.mark.parametrize("scene", ["crank_rocker", "andrews", "stiff_four_bar", "chain_4"])
def test_pinocchios_accelerations_are_those_of_the_kkt_system(scene):
    problem = problem_of(scene)
    a = accelerations(problem)
    assert a.__name__ == "acceleration"
    sol = pc.integrate(problem.system, (0.0, 0.01 * problem.span[1]), problem.q0, problem.v0)
    state = sol.t[-1], sol.q[-1], sol.v[-1]
    expected = acceleration(problem.system, *state)[0]
    assert np.abs(a(*state) - expected).max() < 1e-7 * (1.0 + np.abs(expected).max())


@pytest.mark.parametrize("name", ["CasADi IDAS, index 1", "MuJoCo implicitfast, soft loops"])
def test_constant_torques_are_translated_and_those_of_time_are_not(name):
    problem = problem_of("andrews")
    moved = replace(problem, mechanism=problem.mechanism.add_forces({"beta": lambda t: t}))
    if PEERS[name].missing():
        pytest.skip(PEERS[name].missing())
    assert PEERS[name].can(problem) is None
    assert "JointTorque of time" in PEERS[name].can(moved)


@pytest.mark.parametrize("scene", ["bricard", "problem51"])
def test_where_pinocchios_contacts_cannot_the_kkt_system_is_solved(scene):
    assert accelerations(problem_of(scene)).__name__ == "by_kkt"


@pytest.mark.parametrize("scene", ["crank_rocker", "andrews", "stiff_four_bar", "problem51"])
def test_the_jacobian_of_the_ggl_form_by_differences(scene):
    problem = problem_of(scene)
    equations = Equations(problem, "GGL")
    rng = np.random.default_rng(1)
    y, yp = equations.y0.copy(), equations.yp0.copy()
    n = equations.n
    y[:n] += 1e-4 * rng.normal(size=n)  # open, too
    y[2 * n + equations.m :] = 0.0

    def residual(y, yp):
        out = np.empty_like(y)
        equations.residual(0.1, y, yp, out)
        return out

    for k, matrix in enumerate(equations.jacobian(0.1, y, yp)):
        columns = []
        for i in range(len(y)):
            e = np.zeros(len(y))
            e[i] = 1e-6 * (1.0 + abs((y, yp)[k][i]))
            moved = [(y + s * e, yp) if k == 0 else (y, yp + s * e) for s in (1, -1)]
            columns.append((residual(*moved[0]) - residual(*moved[1])) / (2 * e[i]))
        expected = np.column_stack(columns)
        scale = 1.0 + np.abs(expected).max(axis=1, keepdims=True)
        assert (np.abs(matrix - expected) / scale).max() < 2e-4


def test_a_residual_vanishes_at_its_start():
    for form in ("GGL", "index 1"):
        equations = Equations(problem_of("andrews"), form)
        out = np.full_like(equations.y0, np.nan)
        equations.residual(0.0, equations.y0, equations.yp0, out)
        assert np.abs(out).max() < 1e-8


def test_methods_of_fixed_step_go_on_until_the_last_target_or_the_budget():
    problem = problem_of("problem51", 0.3)
    diagram = work_precision(problem, (1e-5,), repeats=1, methods=["fixed BDF-2, every"])
    fixed = [point for point in diagram.points if "fixed" in point.method]
    assert fixed[0].steps == FEWEST_STEPS and [point.tol == point.tol for point in fixed] == [False] * len(fixed)
    assert fixed[-1].q < 1e-6 < fixed[-2].q and all(point.status == "done" for point in fixed)
    cut = work_precision(problem, (1e-5,), repeats=1, budget=0.02, methods=["fixed BDF-1, every"])
    assert "0.02 s" in cut.points[-1].status and not cut.points[-1].times  # foreseen, or cut
    assert dict(cut.equal_error["q"])[1e-6]["pinconsist fixed BDF-1, every-step"] is None
    assert not any(point.setups for point in fixed)


def test_words_choose_methods():
    def chosen(*words):
        return {peer.name for peer in _chosen(words or None)}

    others = {peer.name for peer in peers() if peer.package != "pinconsist"}
    assert chosen("peers") == {OWN} | others
    assert others < chosen() and "pinconsist BDF ≤ 2" in chosen() and not any("fixed" in name for name in chosen())
    assert chosen("exact") == {OWN} | {peer.name for peer in peers() if "exact" in peer.name}


def test_a_reference_that_takes_too_many_steps_is_given_up(monkeypatch):
    problem = problem_of("pendulum")
    monkeypatch.setattr("benchmarks.dense_reference.MAX_STEPS", 100)
    with pytest.raises(PinconsistError, match=r"pendulum: no reference: at a tolerance of 1e-09 .* earlier end"):
        DenseReference(problem)


def test_a_study_names_what_it_cannot_do_and_cuts_what_takes_too_long():
    diagram = work_precision(problem_of("pendulum", 0.5), (1e-4, 1e-7), repeats=2, methods=["LSODA", "MuJoCo", "DOP"])
    by_method = {}
    for point in diagram.points:
        by_method.setdefault(point.method, []).append(point)
    assert len(by_method[OWN]) == 2
    assert all(
        len(point.times) == len(point.setups) == 2 for point in by_method[OWN] + by_method["scipy LSODA, index 1"]
    )
    assert by_method[OWN][1].q < by_method[OWN][0].q < 1e-2
    (refused,) = by_method["MuJoCo implicitfast, soft loops"]
    assert refused.status != "done" and not refused.times
    assert set(diagram.series()) == {OWN, "scipy LSODA, index 1", "scipy DOP853, index 1"}
    cut = work_precision(problem_of("crank_rocker", 1.0), (1e-9,), repeats=1, budget=0.02, methods=["Radau"])
    status = {point.method: point.status for point in cut.points}
    assert status["scipy Radau, index 1"] == "cut after 0.02 s"


def test_equal_error_is_read_off_a_straight_line_in_the_logarithms():
    points = [
        Point(OWN, 1e-3, "done", 1, (1.0, 2.0), (0.5, 0.0), q=1e-3, lam=1e-4, lam_row=0.0, lam_first=1e-4),
        Point(OWN, 1e-5, "done", 1, (4.0, 8.0), (2.0, 0.0), q=1e-5, lam=1e-8, lam_row=0.0, lam_first=1e-8),
        Point("other", 1e-3, "done", 1, (10.0, 20.0), q=1e-3),
        Point("other", 1e-5, "done", 1, (40.0, 80.0), q=1e-5),
        Point("coarse", 1e-3, "done", 1, (1.0, 1.0), q=1e-2),
    ]
    found = at_equal_error(points, 1e-4, OWN)
    assert found["coarse"] is None
    assert found[OWN] == pytest.approx((3.0, 1.0, 2.5, 1.0, 0.0, 1e-6))
    assert found["other"][:2] == pytest.approx((30.0, 10.0)) and np.isnan(found["other"].core)
    assert at_equal_error(points, 1e-6, OWN, "lam")[OWN][:2] == pytest.approx((3.0, 1.0))
    assert np.isnan(at_equal_error(points, 1e-4, "coarse")["other"].ratio)


def test_runs_that_chance_has_put_out_of_order_are_averaged():
    """A longer run with a larger error counts with the shorter one, both halfway in the logarithms."""
    errors = {1.0: 1e-2, 4.0: 1e-6, 16.0: 1e-4, 64.0: 1e-8}
    points = [Point(OWN, np.nan, "done", 1, (time,), q=error) for time, error in errors.items()]
    found = {target: at_equal_error(points, target, OWN)[OWN] for target in (1e-1, 1e-5, 1e-8, 1e-9)}
    assert found[1e-9] is None
    assert [found[target].time for target in (1e-1, 1e-5, 1e-8)] == pytest.approx([1.0, 8.0, 64.0])


def test_bad_input():
    problem = problem_of("problem51", 0.1)
    with pytest.raises(InputError, match="repeats"):
        work_precision(problem, repeats=0)
    with pytest.raises(InputError, match="no method 'nonsense'"):
        work_precision(problem, methods=["nonsense"])
    with pytest.raises(InputError, match="positive"):
        problem_of("crank_rocker", -1.0)


def test_reference_of_a_body_that_turns_freely():
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.diag([1.0, 2.0, 3.0])), pin.SE3.Identity())
    model.gravity = pin.Motion.Zero()
    q0, v0 = pin.neutral(model), np.array([1.0, 0.0, 0.0, 0.0, 0.0, 2.0])  # about a principal axis
    problem = Problem("spin", "", pc.Mechanism(model), (0.0, 1.0), q0, v0)
    q, v, _ = DenseReference(problem).at([0.5, 1.0])
    np.testing.assert_allclose(q[1], [1.0, 0.0, 0.0, 0.0, 0.0, np.sin(1.0), np.cos(1.0)], atol=1e-9)
    np.testing.assert_allclose(v[1], [np.cos(2.0), -np.sin(2.0), 0.0, 0.0, 0.0, 2.0], atol=1e-9)  # in its own axes
    with pytest.raises(PinconsistError, match="turns by 4 rad; try an earlier end"):
        DenseReference(replace(problem, span=(0.0, 2.0)))
