"""Dense output and t_eval: exact at the steps, of the method's order between them, and nothing kept in vain."""

import numpy as np
import pinocchio as pin
import pytest
from helpers import scenes
from helpers.zoo import scaled_bead

import pinconsist as pc
from pinconsist.run.output import Record

V0 = np.array([0.5, -1.0, 0.3, 1.0, 0.4, -0.6])


def run(mech="four_bar", T=1.0, **options):
    if mech == "spherical_chain":
        return pc.simulate(scenes.spherical_chain(), (0.0, T), v0=V0, **options, method="BDF")
    return pc.simulate(pc.load(mech), (0.0, T), v0={"crank": 2.0}, **options, method="BDF")


@pytest.mark.parametrize("mech", ["four_bar", "crank_rocker", "spherical_chain"])
@pytest.mark.parametrize("options", [{}, {"step": 0.01}, {"step": 0.01, "order": 1}, {"rtol": 1e-3, "atol": 1e-3}])
def test_at_the_steps_it_is_the_rows(mech, options):
    sol = run(mech, dense_output=True, **options)
    q, v, lam = sol.sol(sol.t)
    np.testing.assert_allclose(q, sol.q, atol=2e-14)
    np.testing.assert_allclose(v, sol.v, atol=1e-13 * (1 + np.abs(sol.v).max()))
    np.testing.assert_allclose(lam, sol.lam, atol=1e-12 * (1 + np.abs(sol.lam).max()))


@pytest.mark.parametrize("k", [1, 2, 3, 4, 5])
def test_between_the_steps_it_has_the_order_of_the_method(k):
    """Problem 5.1 in closed form: order k in q, v and λ; the loop is closed to k+1."""
    problem, errors = pc.paper.reference_problem("problem51"), []
    for h in (1 / 100, 1 / 200):
        sol = pc.integrate(
            problem.system, (0.0, 0.5), problem.p0, problem.v0, step=h, order=k, dense_output=True, method="BDF"
        )
        times = np.linspace(k * h, 0.5, 777)
        found, exact = sol.sol(times), zip(*(problem.exact(t) for t in times), strict=True)
        closed = np.abs((found[0] ** 2).sum(axis=1) - 1.0).max()
        errors.append([*(np.abs(a - np.array(b)).max() for a, b in zip(found, exact, strict=True)), closed])
    assert np.log2(np.divide(*errors)) == pytest.approx([k, k, k, k + 1], abs=0.3)


def test_over_the_start_too():
    """The rows of the one-step start are joined by their own polynomial, within the tolerance."""
    problem = pc.paper.reference_problem("problem51")
    sol = pc.integrate(problem.system, (0.0, 0.5), problem.p0, problem.v0, rtol=1e-8, atol=1e-8, dense_output=True)
    times = np.linspace(0.0, sol.t[6], 50)
    q, v, lam = sol.sol(times)
    exact = [problem.exact(t) for t in times]
    for found, column, tol in ((q, 0, 1e-7), (v, 1, 1e-7), (lam, 2, 1e-5)):
        np.testing.assert_allclose(found, [row[column] for row in exact], atol=tol)


def test_errors_between_adaptive_steps_follow_the_tolerance():
    problem, errors = pc.paper.reference_problem("problem51"), []
    for tol in (1e-4, 1e-6, 1e-8):
        sol = pc.integrate(
            problem.system, (0.0, 1.0), problem.p0, problem.v0, rtol=tol, atol=tol, dense_output=True, method="BDF"
        )
        times = np.linspace(0.0, 1.0, 501)
        at_steps = max(np.abs(lam - problem.exact(t)[2]).max() for t, lam in zip(sol.t, sol.lam, strict=True))
        between = np.abs(sol.sol(times)[2] - [problem.exact(t)[2] for t in times]).max()
        assert between < 3 * at_steps
        errors.append(between)
    assert errors[0] > 20 * errors[1] > 400 * errors[2]


def test_loops_stay_closed_between_steps_of_a_closed_chain():
    gaps = []
    for tol in (1e-4, 1e-8):
        sol = run(rtol=tol, atol=tol, dense_output=True)
        times = np.linspace(0.0, 1.0, 301)
        gaps.append(max(np.abs(sol.system.loop_rows(q)[0]).max() for q in sol.sol(times)[0]))
        assert gaps[-1] < 10 * tol
    assert gaps[1] < 1e-3 * gaps[0]


def test_rotations_are_interpolated_on_the_manifold():
    tight = run("spherical_chain", rtol=1e-10, atol=1e-10, dense_output=True)
    sol = run("spherical_chain", rtol=1e-6, atol=1e-6, dense_output=True)
    times = np.linspace(0.0, 1.0, 201)
    q, v, _ = sol.sol(times)
    q_tight, v_tight, _ = tight.sol(times)
    for found, expected in zip(q, q_tight, strict=True):
        np.testing.assert_allclose(pin.normalize(sol.system.model, found), found, atol=4e-15)
        assert np.abs(pin.difference(sol.system.model, found, expected)).max() < 1e-3
    np.testing.assert_allclose(v, v_tight, atol=1e-2)


@pytest.mark.parametrize("mech", ["four_bar", "spherical_chain"])
@pytest.mark.parametrize("options", [{}, {"step": 0.007}])
def test_t_eval_gives_what_dense_output_gives(mech, options):
    times = np.linspace(0.0, 1.0, 38)
    rows, dense = run(mech, t_eval=times, **options), run(mech, dense_output=True, **options)
    assert rows.t.tolist() == times.tolist() and rows.h.size == rows.order.size == 0 and rows.nsteps == dense.nsteps
    for found, expected in zip((rows.q, rows.v, rows.lam), dense.sol(times), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("span", [(0.0, 0.5), (0.5, 0.0)])
def test_a_general_problem_between_its_steps_either_way_in_time(span):
    problem, exact = scaled_bead()
    p0, v0, _ = exact(span[0])
    times = np.linspace(*span, 21)
    options = {"rtol": 1e-8, "atol": 1e-8}
    dense = pc.integrate(problem, span, p0, v0, dense_output=True, **options)
    rows = pc.integrate(problem, span, p0, v0, t_eval=times, **options)
    assert rows.t.tolist() == times.tolist() and len(dense.t) < 100
    assert rows.order.dtype == dense.order.dtype == int
    p, v, lam = (np.array(column) for column in zip(*map(exact, times), strict=True))
    for q_found, v_found, lam_found in (dense.sol(times), (rows.q, rows.v, rows.lam)):
        np.testing.assert_allclose(q_found, p, atol=1e-7)
        np.testing.assert_allclose(v_found, v, atol=1e-7)
        np.testing.assert_allclose(lam_found[:, 0], lam, atol=1e-5)


def test_t_eval_backwards_repeated_and_partial():
    there = run()
    start = there.q[-1], there.v[-1]
    times = [1.0, 0.7, 0.7, 0.2]
    sol = pc.integrate(pc.load("four_bar"), (1.0, 0.0), *start, t_eval=times, dense_output=True, rtol=1e-8)
    assert sol.t.tolist() == times and sol.success
    np.testing.assert_array_equal(sol.q[0], start[0])
    np.testing.assert_array_equal(sol.q[1], sol.q[2])
    np.testing.assert_allclose(sol.q[3], sol.sol(0.2)[0], rtol=1e-14)
    assert sol.sol(0.0)[0].shape == (3,)
    none = run(t_eval=[])
    assert none.success and none.t.shape == (0,) and none.q.shape == (0, 3) and none.lam.shape == (0, 5)


def test_shapes_and_limits():
    sol = run(T=0.2, dense_output=True)
    for t, shape in ((0.1, ()), ([0.1], (1,)), ([0.0, 0.1, 0.2], (3,))):
        q, v, lam = sol.sol(t)
        assert (q.shape, v.shape, lam.shape) == ((*shape, 3), (*shape, 3), (*shape, 5))
    for outside in (-1e-9, 0.2 + 1e-9, [0.1, 5.0], np.nan):
        with pytest.raises(pc.InputError, match=r"dense output covers t = 0 to 0\.2"):
            sol.sol(outside)
    assert run(T=0.2).sol is None


@pytest.mark.parametrize("options", [{}, {"step": 1e-3}])
def test_with_t_eval_nothing_is_kept_of_the_steps(monkeypatch, options):
    """Memory must not grow with the length of a run."""
    records = []
    first = Record.first
    monkeypatch.setattr(Record, "first", lambda self, *state: records.append(self) or first(self, *state))
    sol = run("crank_rocker", T=2.0, t_eval=[0.0, 1.0, 2.0], **options)
    (record,) = records
    kept = [value for value in vars(record).values() if isinstance(value, list)]
    assert sol.nsteps > 100 and sum(map(len, kept)) <= 3 and len(sol.t) == 3


def test_dense_output_of_a_stopped_run_ends_where_it_stopped():
    sol = run(dense_output=True, events=pc.Event(lambda t, q, v, lam: t - 0.333, terminal=True))
    assert sol.t[-1] == pytest.approx(0.333, abs=1e-12)
    np.testing.assert_allclose(sol.sol(sol.t[-1])[0], sol.q[-1], atol=1e-14)
    with pytest.raises(pc.InputError, match="covers"):
        sol.sol(0.34)


def test_dense_output_of_a_failed_run_covers_what_was_reached():
    sol = run(dense_output=True, max_steps=30)
    assert sol.status == -1
    np.testing.assert_allclose(sol.sol(sol.t[-1])[2], sol.lam[-1], atol=1e-11)
