"""Large systems go on with an old Newton matrix where that is cheaper; what they reach is as good as before."""

from unittest.mock import patch

import numpy as np
import pytest

import pinconsist as pc
from pinconsist.dae.foresight import REMEMBERED
from pinconsist.dae.newton import KKT
from pinconsist.dae.reuse import WORTH, Reuse


def step(reuse, iterations, c=1.0):
    """One step of so many iterations; whether it used an old matrix."""
    kept = reuse.pays(c)
    if not kept:
        reuse.made(c)
    for _ in range(iterations):
        reuse.iterated()
    return kept


def test_small_systems_never_keep_a_matrix():
    reuse = Reuse(WORTH - 1)
    assert not reuse.possible and not any(step(reuse, 1) for _ in range(10))


def test_a_matrix_is_kept_until_a_step_costs_more_than_the_average():
    reuse = Reuse(4 * WORTH)  # a matrix costs 4 iterations
    assert not step(reuse, 1)  # 5
    assert step(reuse, 2) and step(reuse, 3)  # 10 in 3 steps
    assert step(reuse, 4)  # 3 is below 10/3
    assert not step(reuse, 1)  # 4 is above 14/4


def test_the_rule_finds_the_cheapest_cycle():
    """Iterations that grow with the age of the matrix: it goes where a step costs least, or one step further."""
    reuse, age, oldest = Reuse(8 * WORTH), 0, 0
    for _ in range(60):
        age = age + 1 if reuse.pays(1.0) else 0
        if age == 0:
            reuse.made(1.0)
        for _ in range(1 + age):
            reuse.iterated()
        oldest = max(oldest, age)
    costs = {n: (8 + sum(range(1, n + 1))) / n for n in range(1, 12)}
    best = min(costs, key=costs.get)
    assert oldest + 1 in (best, best + 1)


def test_no_matrix_is_kept_over_a_large_change_of_c_or_after_a_restart():
    reuse = Reuse(4 * WORTH)
    step(reuse, 1)
    assert step(reuse, 1, 1.9) and not step(reuse, 1, 2.1) and step(reuse, 1, 1.2) and not step(reuse, 1, -1.2)
    reuse.forget()
    assert not step(reuse, 1, -1.2)


def test_where_keeping_fails_it_is_not_tried_for_a_while():
    reuse = Reuse(WORTH)
    step(reuse, 1)
    assert reuse.pays(1.0)
    reuse.iterated()
    reuse.iterated()
    reuse.made(1.0)  # in vain
    reuse.iterated()
    assert not any(step(reuse, 1) for _ in range(REMEMBERED - 1)) and step(reuse, 1)


def test_old_factors_solve_for_another_c():
    rng = np.random.default_rng(1)
    kkt, G, W = KKT(4, 2), rng.standard_normal((4, 2)), rng.standard_normal((2, 4))
    A, rhs = rng.standard_normal((4, 4)) + 5 * np.eye(4), rng.standard_normal((6, 3))
    kkt.A[:] = A
    kkt.solve_new(G, W, 0.1, rhs)
    expected = np.linalg.solve(np.block([[A, -0.3 * G], [W, np.zeros((2, 2))]]), rhs)
    np.testing.assert_allclose(kkt.solve(rhs, 0.3), expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("tol", [1e-4, 1e-7])
def test_a_chain_is_as_accurate_with_kept_matrices(tol):
    mech, times = pc.load("chain_64"), np.linspace(0.0, 0.5, 26)
    exact = pc.simulate(mech, (0.0, 0.5), t_eval=times, rtol=1e-11, atol=1e-11)
    kept = pc.simulate(mech, (0.0, 0.5), t_eval=times, rtol=tol, atol=tol, backend="python")
    with patch.object(Reuse, "pays", lambda self, c: False):
        fresh = pc.simulate(mech, (0.0, 0.5), t_eval=times, rtol=tol, atol=tol, backend="python")
    assert kept.nlu < 0.7 * fresh.nlu
    for part in ("q", "v", "lam"):
        errors = [np.abs(getattr(sol, part) - getattr(exact, part)).max() for sol in (kept, fresh)]
        assert errors[0] < 2.0 * errors[1], part


@pytest.mark.parametrize(("name", "tol"), [("four_bar", 1e-6), ("four_bar", 1e-8), ("crank_rocker", 1e-4)])
def test_multipliers_do_not_feel_a_matrix_kept_as_long_as_newton_converges(name, tol):
    """Such a matrix leaves a part of the hidden residual, and the multipliers feel it unless that is taken out too."""
    mech, start, times = pc.load(name), {"v0": {"crank": 3.0}}, np.linspace(0.0, 1.0, 51)
    exact = pc.simulate(mech, (0.0, 1.0), t_eval=times, rtol=1e-12, atol=1e-12, **start)
    options = start | {"t_eval": times, "rtol": tol, "atol": tol, "backend": "python"}
    fresh = pc.simulate(mech, (0.0, 1.0), **options)
    with patch.object(Reuse, "pays", lambda self, c: self._c is not None):
        kept = pc.simulate(mech, (0.0, 1.0), **options)
    assert kept.nlu < 0.5 * fresh.nlu
    errors = [np.abs(sol.lam - exact.lam).max() for sol in (kept, fresh)]
    assert errors[0] < 2.0 * errors[1]


def test_matrices_become_rarer_as_a_chain_grows():
    shares = []
    for n in (16, 48, 96):
        sol = pc.simulate(pc.load(f"chain_{n}"), (0.0, 0.3))
        shares.append(sol.nlu / sol.nsteps)
        assert sol.nfev < 2.5 * sol.nsteps
    assert shares[0] > 0.8 and shares[1] < 0.5 and shares[2] < 0.2


def test_a_jump_of_the_velocities_is_survived():
    """The matrix of the time before an event says nothing of the time after it."""
    mech = pc.load("chain_64")

    def kick(t, q, v):
        return v + 0.2 * np.sin(np.arange(len(v)))

    sol = pc.simulate(mech, (0.0, 0.4), events=[pc.Event(lambda t, q, v, lam: t - 0.2, apply=kick)], rtol=1e-7)
    assert sol.success and sol.nlu < 0.6 * sol.nsteps
    after = np.flatnonzero(sol.t == sol.t_events[0][0])[-1]
    again = pc.simulate(mech, (sol.t[after], 0.4), sol.q[after], sol.v[after], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(sol.q[-1], again.q[-1], atol=1e-5)


@pytest.mark.parametrize("links, order", [(32, 2), (32, 3), (64, 1), (64, 3), (64, 5)])
@pytest.mark.parametrize("backend", ["auto", "python"])
def test_fixed_steps_with_kept_matrices_come_down_to_rounding(links, order, backend):
    """A kept matrix that no longer contracts at the rounding floor is renewed before that is called divergence."""
    sol = pc.simulate(pc.load(f"chain_{links}"), (0.0, 0.05), step=1e-3, max_order=order, backend=backend)
    assert sol.success and sol.nsteps == 50, sol.message
    assert sol.nlu < sol.nfev / 2  # matrices were kept
