"""Large systems go on with an old Newton matrix where that is cheaper; what they reach is as good as before.

Only the compiled method does so.
"""

import numpy as np
import pytest
from helpers.twin import with_constants, with_switches

import pinconsist as pc
from pinconsist.engine.radau_table import STAGES, eigenvectors, table


@pytest.mark.parametrize("tol", [1e-4, 1e-7])
def test_a_chain_is_as_accurate_with_kept_matrices(tol):
    mech, times = pc.load("chain_64"), np.linspace(0.0, 0.5, 26)
    exact = pc.simulate(mech, (0.0, 0.5), t_eval=times, rtol=1e-11, atol=1e-11)
    kept = pc.simulate(mech, (0.0, 0.5), t_eval=times, rtol=tol, atol=tol)
    with with_switches(jacobian_reuse=False):
        fresh = pc.simulate(mech, (0.0, 0.5), t_eval=times, rtol=tol, atol=tol)
    assert kept.nlu < 0.9 * fresh.nlu
    for part in ("q", "v", "lam"):
        errors = [np.abs(getattr(sol, part) - getattr(exact, part)).max() for sol in (kept, fresh)]
        assert errors[0] < 2.0 * errors[1], part


@pytest.mark.parametrize(("name", "tol"), [("four_bar", 1e-4), ("four_bar", 2e-6), ("crank_rocker", 5e-3)])
def test_multipliers_do_not_feel_a_matrix_kept_as_long_as_newton_converges(name, tol):
    """Such a matrix leaves a part of the hidden residual, and the multipliers feel it unless that is taken out too."""
    mech, start, times = pc.load(name), {"v0": {"crank": 3.0}, "method": "BDF"}, np.linspace(0.0, 1.0, 51)
    exact = pc.simulate(mech, (0.0, 1.0), t_eval=times, rtol=1e-12, atol=1e-12, **start)
    options = start | {"t_eval": times, "rtol": tol, "atol": tol}
    fresh = pc.simulate(mech, (0.0, 1.0), **options)
    with with_constants(WORTH=0.01, WIDEST=1e9):  # as if a matrix were dear for small systems too
        kept = pc.simulate(mech, (0.0, 1.0), **options)
    assert kept.nlu < 0.9 * fresh.nlu
    errors = [np.abs(sol.lam - exact.lam).max() for sol in (kept, fresh)]
    assert errors[0] < 2.0 * errors[1]


def test_matrices_become_rarer_as_a_chain_grows():
    shares = []
    for n in (16, 48, 96):
        sol = pc.simulate(pc.load(f"chain_{n}"), (0.0, 0.3), method="BDF", rtol=1e-4, atol=1e-6)
        shares.append(sol.nlu / sol.nsteps)
        assert sol.nfev < 2.5 * sol.nsteps
    assert shares[0] > 0.8 and shares[1] < 0.5 and shares[2] < 0.2


def test_a_jump_of_the_velocities_is_survived():
    """The matrix of the time before an event says nothing of the time after it."""
    mech = pc.load("chain_64")

    def kick(t, q, v):
        return v + 0.2 * np.sin(np.arange(len(v)))

    sol = pc.simulate(mech, (0.0, 0.4), events=[pc.Event(lambda t, q, v, lam: t - 0.2, apply=kick)], rtol=1e-5)
    assert sol.success and sol.nlu < 0.6 * sol.nsteps
    after = np.flatnonzero(sol.t == sol.t_events[0][0])[-1]
    again = pc.simulate(mech, (sol.t[after], 0.4), sol.q[after], sol.v[after], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(sol.q[-1], again.q[-1], atol=1e-5)


@pytest.mark.parametrize("links, order", [(32, 2), (32, 3), (64, 1), (64, 3), (64, 5)])
def test_fixed_steps_with_kept_matrices_come_down_to_rounding(links, order):
    """A kept matrix that no longer contracts at the rounding floor is renewed before that is called divergence."""
    sol = pc.simulate(pc.load(f"chain_{links}"), (0.0, 0.05), method="BDF", step=1e-3, order=order)
    assert sol.success and sol.nsteps == 50, sol.message
    assert sol.nlu < sol.nfev / 2  # matrices were kept


@pytest.mark.parametrize("order", [3, 5, 9, 13])
def test_stages_come_apart_by_the_eigenvalues_of_the_formula(order):
    """With many degrees of freedom the equations of a step of Radau are solved in blocks: the motion is that of BDF."""
    mech = pc.load("chain_36")
    exact = pc.simulate(mech, (0.0, 0.2), method="BDF", rtol=1e-9, atol=1e-10)
    sol = pc.simulate(mech, (0.0, 0.2), method="Radau", order=order, rtol=1e-6, atol=1e-7)
    assert sol.success
    np.testing.assert_allclose(sol.q[-1], exact.q[-1], atol=1e-5)
    np.testing.assert_allclose(sol.v[-1], exact.v[-1], atol=1e-4)
    assert sol.nfev < 40 * sol.nsteps  # Newton converges


@pytest.mark.parametrize("s", STAGES)
def test_eigenvectors_of_the_formula(s):
    (real, imaginary), beside, below = eigenvectors(s)
    made = np.zeros((s, s))
    for k, (a, b) in enumerate(zip(real, imaginary, strict=True)):
        vector, row = beside[:, 2 * k] + 1j * beside[:, 2 * k + 1], below[2 * k] + 1j * below[2 * k + 1]
        made += ((2.0 if b else 1.0) * (a + 1j * b) * np.outer(vector, row)).real
    np.testing.assert_allclose(made, table(s).inverse, rtol=1e-11, atol=1e-11)
