"""Radau IIA on the index-3 equations."""

import numpy as np
import pytest

import pinconsist as pc
from pinconsist.dae.radau import table

STEPS = {1: 1 / 80, 3: 1 / 40, 5: 1 / 10, 9: 1 / 4}  # order → step; half of it is still above rounding


@pytest.mark.parametrize("s", [1, 2, 3, 5, 7])
def test_tables_are_exact_up_to_their_order(s):
    formula = table(s)
    for k in range(2 * s + 1):
        error = abs(formula.A[-1] @ formula.c**k - 1.0 / (k + 1))
        assert error < 1e-14 if k <= 2 * s - 2 else error > 1e-9 or k > 2 * s - 1, k
    stage = [np.abs(formula.A @ formula.c**k - formula.c ** (k + 1) / (k + 1)).max() for k in range(s)]
    assert max(stage) < 1e-14


@pytest.mark.parametrize("order", STEPS)
@pytest.mark.parametrize("name", ["problem51", "problem52"])
def test_orders_of_positions_velocities_and_multipliers(name, order):
    problem = pc.reference_problem(name)
    t0, errors = problem.t0, []
    for h in (STEPS[order], STEPS[order] / 2):
        run = pc.integrate(
            problem.system, (t0, t0 + 0.5), problem.p0, problem.v0, method="Radau", max_order=order, step=h
        )
        assert run.success
        ends = zip((run.q, run.v, run.lam), problem.exact(t0 + 0.5), strict=True)
        errors.append([np.abs(found[-1] - exact).max() for found, exact in ends])
    assert np.log2(np.divide(*errors)) == pytest.approx(order, abs=0.4)


def test_modes_of_bdf_are_refused():
    problem = pc.reference_problem("problem51")
    for mode in ("initial", "exact"):
        with pytest.raises(pc.InputError, match="leave consistency out"):
            pc.integrate(problem.system, (0, 1), problem.p0, problem.v0, method="Radau", consistency=mode)
    with pytest.raises(pc.InputError, match="one of 1, 3, 5, 9, 13"):
        pc.integrate(problem.system, (0, 1), problem.p0, problem.v0, method="Radau", max_order=4)
