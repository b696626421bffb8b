"""Runs through singularities: n four-bars side by side, whose loops all lose a row where the cranks lie level."""

import numpy as np
import pytest
from helpers.extras import skips_missing_extras

import pinconsist as pc


def passed(n, until, **how):
    """A run that reached its end."""
    sol = pc.simulate(pc.load(f"n_four_bar_{n}"), (0.0, until), v0={"crank0": 1.0}, **{"method": "BDF", **how})
    assert sol.success, sol.message
    return sol


@pytest.mark.parametrize("tol", [1e-5, 1e-7, 6.3e-9])
@pytest.mark.parametrize("n", [16, 20])
def test_kept_matrices_do_not_end_a_run(n, tol):
    """Matrices are kept from 32 velocities on; beside singular configurations one of a few steps ago leads astray."""
    sol = passed(n, 2.0, rtol=tol, atol=tol)
    assert sol.njev < sol.nsteps  # and yet some are kept


@pytest.mark.parametrize(("step", "order"), [(1e-3, 3), (1e-3, 4)])
def test_fixed_steps_that_end_beside_the_singular_position(step, order):
    """The gap there is rounding, and yet it moves the bars by 1e-11."""
    passed(16, 0.725, step=step, order=order)


@pytest.mark.parametrize(("n", "step", "order"), [(20, 1e-3, 9), (20, 2e-3, 9), (16, 1e-3, 5)])
def test_stages_beside_the_singular_position(n, step, order):
    """Gaps there are rounding as well, larger than in a single loop, and move the bars by 1e-12."""
    mech = pc.load(f"n_four_bar_{n}")
    before = passed(n, 0.71, rtol=1e-11, atol=1e-13, method="Radau")
    span, options = (0.71, 0.732), {"step": step, "order": order, "method": "Radau"}
    sol = pc.simulate(mech, span, before.q[-1], before.v[-1], **options)
    assert sol.success, sol.message
    exact = passed(n, 0.732, rtol=1e-11, atol=1e-13, method="Radau")
    np.testing.assert_allclose(sol.q[-1], exact.q[-1], atol=1e-7)


@pytest.mark.parametrize("method", ["BDF", "Radau"])
@pytest.mark.parametrize(("n", "start"), [(10, 0.0), (10, 1e-12), (10, 1e-9), (24, 0.0)])
def test_fixed_steps_at_rest(n, start, method):
    """Rounding of the weights moves the bars a little: those increments are large beside velocities near zero."""
    mech = pc.load(f"n_four_bar_{n}")
    until = 0.25
    sol = pc.simulate(mech, (0.0, until), v0={"crank0": start}, step=1e-3, method=method)
    assert sol.success, sol.message
    assert np.abs(sol.v).max() <= 2.0 * start + 1e-12
    np.testing.assert_allclose(sol.lam, np.broadcast_to(sol.lam[0], sol.lam.shape), atol=1e-8)


@pytest.mark.parametrize(("n", "tol", "share"), [
    (10, 3.2e-7, 0.01), (10, 2.5e-10, 0.01), (20, 1e-9, 0.01), (10, 1.2e-10, 1.0), (2, 1e-10, 0.01),
])  # fmt: skip
def test_a_tight_tolerance_does_not_creep_towards_the_singular_position(n, tol, share):
    """Where rounding was believed late, the first stopped, and the second took 185,000 steps before it did.

    Where rounding begins is chance: of three tolerances nearby most must pass quickly, and all are accurate.
    """
    other, steps = passed(n, 0.75, rtol=1e-11, atol=1e-13, method="Radau"), []
    for factor in (1.0, 1.2, 1.5):
        sol = passed(n, 0.75, rtol=factor * tol, atol=share * factor * tol)
        np.testing.assert_allclose(sol.q[-1], other.q[-1], rtol=0.0, atol=10.0 * max(factor * tol, 2e-10))
        steps.append(sol.nsteps)
    assert sorted(steps)[1] < 2000 and max(steps) < 20_000, steps


@pytest.mark.parametrize("tol", [1e-9, 1e-10, 1e-11])
def test_stages_do_not_begin_in_another_closed_position(tol):
    """A shin of the floating Cassie closes at two places that are 1 mm apart, and the rows are independent by 3e-7.

    Extrapolated rounding led the stages to the other place, and the polynomial through them all later attempts.
    """
    with skips_missing_extras():
        mech = pc.load("cassie", free_flyer=True)
    spin = {"left-knee-op": 3.0, "right-knee-op": -2.0}
    expected = pc.simulate(mech, (0.0, 0.02), None, spin, rtol=1e-9, atol=1e-9)
    found = pc.simulate(mech, (0.0, 0.02), None, spin, rtol=tol, atol=tol, method="Radau")
    assert found.success and np.abs(found.q[-1] - expected.q[-1]).max() < 1e-7
