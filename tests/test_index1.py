"""Projections onto the constraints, and accelerations that are not finite."""

import numpy as np
import pytest

import pinconsist as pc
from pinconsist.engine.index1 import Index1, NotFiniteError
from pinconsist.engine.norms import EPS


@pytest.mark.parametrize("length", [1e-3, 1.0, 1e3, 1e6])
def test_positions_are_put_on_the_constraint_in_any_unit_of_length(length):
    """|p|²/2 = L²/2 is known to eps L²: rounding that no iteration can take out, and that must not be waited for."""
    problem = pc.HessenbergProblem(
        U=lambda t, p, v: v,
        F=lambda t, p, v: np.zeros(2),
        G=lambda t, p, v: p[:, None],
        R=lambda t, p: np.array([(p @ p - length**2) / 2]),
        R_p=lambda t, p: p[None],
    )
    for angle in np.linspace(0.1, 6.0, 20):
        direction = np.array([np.cos(angle), np.sin(angle)])
        p, v = 1.01 * length * direction, length * np.array([-direction[1], direction[0]])
        found = Index1(problem.at(0.0, p, v)).projected(0.0, p, v)[0]
        assert np.linalg.norm(found) == pytest.approx(length, rel=4 * EPS)
        assert found @ direction == pytest.approx(length, rel=4 * EPS)  # straight in: the mass is the same each way


def test_accelerations_that_are_not_finite_say_when():
    problem = pc.HessenbergProblem(
        U=lambda t, p, v: v,
        F=lambda t, p, v: np.array([0.0, np.nan if t > 0.2 else 0.0]),
        G=lambda t, p, v: p[:, None],
        R=lambda t, p: np.array([(p @ p - 1.0) / 2]),
    )
    p, v = np.array([0.6, 0.8]), np.zeros(2)
    with pytest.raises(NotFiniteError, match=r"not finite at t = 0\.3: a force or a user-defined function"):
        Index1(problem.at(0.0, p, v)).acceleration(0.3, p, v)
