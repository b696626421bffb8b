"""Every peer that is installed solves what it is measured on, to what its setting promises; no timings."""

import numpy as np
import pytest

import pinconsist as pc
from pinconsist.dae.newton import solve_acceleration
from pinconsist.errors import InputError
from pinconsist.study.peers import OWN, peers
from pinconsist.study.peers.constraint_dynamics import accelerations
from pinconsist.study.peers.equations import Equations
from pinconsist.study.peers.problem import number_of_steps
from pinconsist.study.peers.scenes import problem_of
from pinconsist.study.reference import reference_problem
from pinconsist.study.workprecision import Answers, Point, _equal_error, work_precision

PEERS = {peer.name: peer for peer in peers()}
SHORT = {"problem51": 0.3, "pendulum": 0.5, "crank_rocker": 0.1}
ACCUMULATED = {"pinconsist ImplicitEuler": 500.0, "pinconsist BDF ≤ 2": 500.0}  # low orders take many steps


@pytest.fixture(scope="module", params=SHORT)
def answers(request):
    return Answers(problem_of(request.param, SHORT[request.param]))


@pytest.mark.parametrize("name", PEERS)
def test_a_peer_comes_to_the_right_answer(answers, name):
    peer, problem = PEERS[name], answers.problem
    if reason := peer.missing() or peer.can(problem):
        pytest.skip(reason)
    tol = 1e-4 if name.startswith(("MuJoCo", "pinconsist Implicit")) else 1e-6
    q, v, lam, _, lam_first = _errors(answers, peer, tol)
    if name.startswith("MuJoCo"):  # soft constraints, first order: the solution is near, the multipliers swing in
        assert q < 1e-2 and v < 5e-2
        assert _errors(answers, peer, 1e-6)[0] < 0.35 * q  # with a quarter of the step
        return
    allowed = ACCUMULATED.get(name, 100.0) * tol
    assert q < allowed and v < allowed
    assert lam < (0.05 if "index 3" in name else 100 * allowed)
    assert lam_first < (0.05 if "index 3" in name else 1e-2)


def _errors(answers, peer, tol):
    solve, read = peer.prepare(answers.problem, tol)
    rows = read(solve(), lambda count: np.unique(np.r_[0, 1, np.linspace(0, count - 1, 60).astype(int)]))
    assert rows.t[0] == 0.0 and rows.t[-1] == pytest.approx(answers.problem.span[1], abs=1e-12)
    return answers.errors(rows)


def test_exact_problem_as_reference():
    exact = reference_problem("problem51").exact
    q, v, lam = Answers(problem_of("problem51")).at(np.array([0.0, 0.4, 1.0]))
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
    expected = solve_acceleration(problem.system, *state)[0]
    assert np.abs(a(*state) - expected).max() < 1e-7 * (1.0 + np.abs(expected).max())


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


def test_steps_of_fixed_step_methods():
    assert [number_of_steps(tol) for tol in (1e-3, 1e-5, 1e-7)] == [1000, 4000, 16000]


def test_a_study_names_what_it_cannot_do_and_cuts_what_takes_too_long():
    study = work_precision(problem_of("pendulum", 1.0), (1e-4, 1e-7), repeats=2, methods=["LSODA", "MuJoCo", "DOP"])
    by_method = {}
    for point in study.points:
        by_method.setdefault(point.method, []).append(point)
    assert len(by_method[OWN]) == 2 and all(len(point.times) == 2 for point in by_method[OWN])
    assert by_method[OWN][1].q < by_method[OWN][0].q < 1e-2
    (refused,) = by_method["MuJoCo implicitfast, soft loops"]
    assert refused.status != "done" and not refused.times
    assert set(study.series()) == {OWN, "scipy LSODA, index 1", "scipy DOP853, index 1"}
    cut = work_precision(problem_of("crank_rocker", 2.0), (1e-9,), repeats=1, budget=0.05, methods=["Radau"])
    status = {point.method: point.status for point in cut.points}
    assert status["scipy Radau, index 1"] == "cut after 0.05 s" and status[OWN] == "cut after 0.05 s"


def test_equal_error_is_read_off_a_straight_line_in_the_logarithms():
    points = [
        Point(OWN, 1e-3, "done", 1, (1.0, 2.0), q=1e-3),
        Point(OWN, 1e-5, "done", 1, (4.0, 8.0), q=1e-5),
        Point("other", 1e-3, "done", 1, (10.0, 20.0), q=1e-3),
        Point("other", 1e-5, "done", 1, (40.0, 80.0), q=1e-5),
        Point("coarse", 1e-3, "done", 1, (1.0, 1.0), q=1e-2),
    ]
    target, found = _equal_error(points, 1e-4)
    assert target == 1e-4 and found["coarse"] is None
    assert found[OWN] == pytest.approx((3.0, 1.0)) and found["other"] == pytest.approx((30.0, 10.0))


def test_bad_input():
    problem = problem_of("problem51", 0.1)
    with pytest.raises(InputError, match="repeats"):
        work_precision(problem, repeats=0)
    with pytest.raises(InputError, match="no method 'nonsense'"):
        work_precision(problem, methods=["nonsense"])
    with pytest.raises(InputError, match="positive"):
        problem_of("crank_rocker", -1.0)
