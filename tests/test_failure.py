"""What a run that could not go on says: the row that fails, and advice that fits the method."""

from types import SimpleNamespace

import numpy as np
import pytest
from helpers.scenes import held_mass

from pinconsist.dae.failure import failure_report

FAILURE = "the error test fails at any step size"


def stopped(rows, v=(3.0, -40.0, 0.5), step=None, consistency="every-step"):
    """A run that stopped at t = 0.25 where R_p = `rows`, shape (nc, 3)."""
    rows = np.asarray(rows, float)
    p, nc = np.zeros(3), len(rows)
    problem = held_mass(rows).at(0.25, p, np.array(v))
    method = SimpleNamespace(consistency=consistency, step=step)
    y = np.concatenate((p, v, np.zeros(nc)))
    return SimpleNamespace(system=problem, method=method, t=0.25, h=1e-3, k=4, p=p, y=y)


@pytest.mark.parametrize("unit", [1.0, 1e-3, 1e3])
def test_rows_in_other_units_are_not_called_dependent(unit):
    text = failure_report(stopped([[1, 0, 0], [0, unit, 0]]), FAILURE)
    assert text.startswith(f"{FAILURE} at t = 0.25 with step 0.001 (order 4). ")
    assert "dependent" not in text and "largest velocity there is 40;" in text


@pytest.mark.parametrize("unit", [1.0, 1e-3, 1e3])
@pytest.mark.parametrize(("angle", "near"), [(1e-3, True), (0.005, True), (0.05, False)])
def test_rows_that_nearly_agree_are_dependent_in_any_units(angle, near, unit):
    """Unit rows at a small angle φ have the singular values √(1 ± cos φ): their ratio is tan(φ/2)."""
    text = failure_report(stopped([[1, 0, 0], [unit * np.cos(angle), unit * np.sin(angle), 0]]), FAILURE)
    assert ("nearly dependent" in text) == near
    assert not near or f"smallest singular value {np.tan(angle / 2):.1e} of the largest" in text


def test_the_row_that_fades_away_is_named():
    text = failure_report(stopped([[0, 0, 1], [1e-6, 0, 0], [0, 1, 0]]), FAILURE)
    assert "nearly dependent there (row 1 of R; smallest singular value 1.0e-06" in text


@pytest.mark.parametrize(
    ("step", "advice"), [(0.01, "try a smaller step"), (None, "try looser tolerances, or max_step")]
)
def test_advice_fits_the_method(step, advice):
    assert advice in failure_report(stopped([[1, 0, 0]], step=step), FAILURE)


@pytest.mark.parametrize(("step", "consistency", "told"), [
    (None, "exact", True), (None, "initial", True), (0.01, "exact", False), (None, "every-step", False),
])  # fmt: skip
def test_uncorrected_multipliers_are_blamed_only_where_steps_vary(step, consistency, told):
    text = failure_report(stopped([[1, 0, 0]], step=step, consistency=consistency), FAILURE)
    assert (f"consistency='{consistency}' with variable steps" in text) == told
    assert ("largest velocity" in text) != told


def test_numbers_that_are_not_finite_are_traced_to_the_users_functions():
    assert "a force or a user's function returned NaN" in failure_report(
        stopped([[1, 0, 0]]), "the residual is not finite"
    )
