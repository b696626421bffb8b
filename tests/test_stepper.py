"""Estimates inside a step that no run shows by itself: what rounding leaves in a velocity."""

from types import SimpleNamespace

import numpy as np
import pytest

import pinconsist as pc
from pinconsist.dae.control import ErrorControl
from pinconsist.dae.index1 import NotFiniteError, project_position, solve_acceleration
from pinconsist.dae.norms import EPS, largest
from pinconsist.dae.rounding import Headway, RoundingTest, velocity_rounding
from pinconsist.dae.tuning import SURE


def test_rounding_turns_the_velocities_by_the_square_of_the_distance_from_regular():
    """A mass held by y = 0 and σ x + x²/2 = 0: eps moves it by eps/σ, which turns the second row by as much."""

    def rounding(sigma):
        rows = [lambda p: p[1], lambda p: sigma * p[0] + p[0] ** 2 / 2.0]
        problem = pc.HessenbergProblem(
            U=lambda t, p, v: v,
            F=lambda t, p, v: np.zeros(3),
            G=lambda t, p, v: np.array([[0.0, sigma + p[0]], [1.0, 0.0], [0.0, 1e-30]]),
            R=lambda t, p: np.array([row(p) for row in rows]),
        )
        p, v = np.zeros(3), np.array([1.0, 0.0, 2.0])
        return velocity_rounding(problem.at(0.0, p, v), 0.0, p, v)[1]

    for sigma in (1.0, 1e-2, 1e-4):
        assert rounding(sigma) == pytest.approx(SURE * EPS * (2.0 + 1.0 / sigma**2), rel=1e-4)
    assert rounding(0.0) == np.inf


@pytest.mark.parametrize(
    ("h", "error", "tried", "noise", "rounding"),
    [
        (-0.05, 2.0, (0.1, 7.0), 1.0, True),
        (0.05, 2.0, (0.1, 9.0), 1.0, False),  # it falls
        (0.1, 9.0, (0.1, 9.0), 1.0, False),  # the same step, with another order
        (0.05, 2.0, (0.1, 7.0), 0.1, False),  # more than rounding explains
        (0.05, 2e9, (0.1, 2e9), np.inf, False),  # more than half the digits, as beside a singular position
    ],
)
def test_rounding_shows_as_it_does_not_fall_with_the_step(h, error, tried, noise, rounding):
    """A truncation error of order 3 falls by 2⁴ when h is halved; what falls by less than 2² is rounding."""
    d, v = np.array([0.0, error]), np.array([1e9])
    assert RoundingTest().passes(largest, h, 3, d, d, tried, v, lambda: (0.0, noise)) == rounding


@pytest.mark.parametrize(("expected", "rounding"), [(1.0, False), (0.6, False), (0.4, True), (-1.0, True)])
def test_rounding_shows_as_it_does_not_follow_from_the_last_step(expected, rounding):
    d, expected, v = np.array([0.0, 1.0]), np.array([0.0, expected]), np.array([1e9])
    assert RoundingTest().passes(largest, 0.1, 3, d, expected, (0.0, 0.0), v, lambda: (0.0, 1.0)) == rounding


def test_noise_of_a_step_fades_from_the_differences_after_it():
    rounding, d, v = RoundingTest(), np.array([0.0, 16.0]), np.array([1e12])

    def passes(share, noise):
        return rounding.passes(largest, 0.1, 3, share * d, 0.0 * d, (0.0, 0.0), v, lambda: (0.0, noise))

    assert passes(1.0, np.inf)  # where the equations are singular
    for _ in range(60):
        rounding.accepted()
    assert not passes(1.0, 0.1)
    rounding.restart()
    assert passes(1.0, 1.0) and not passes(1.1, 0.1)
    rounding.accepted()
    assert passes(0.5, 0.0) and not passes(0.6, 0.1)
    rounding.restart()
    assert not passes(0.5, 0.0)


def test_many_failed_tries_without_headway_end_a_run():
    headway = Headway()
    headway.restart(0.5, 1.0)
    headway.reached(1.5)
    assert not any(headway.setback() for _ in range(100))
    headway.reached(1.5 + 1e-7)  # less than a millionth of what was done
    assert headway.setback()
    headway.reached(1.6)
    assert not any(headway.setback() for _ in range(100)) and headway.setback()


def test_without_constraints_only_the_velocity_is_rounded():
    free = SimpleNamespace(nv=3, nc=0)
    assert velocity_rounding(free, 0.0, np.zeros(3), np.array([1.0, -2.0, 0.5])) == (2.0 * EPS, SURE * 2.0 * EPS)


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
        found = project_position(problem.at(0.0, p, v), 0.0, p, v)
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
    with pytest.raises(NotFiniteError, match=r"not finite at t = 0\.3: a force or a user's function"):
        solve_acceleration(problem.at(0.0, p, v), 0.3, p, v)


def control(**options):
    control = ErrorControl(rtol=(1e-3, 1e-4), atol=(1e-6, 1e-7), **({"max_order": 5, "max_step": np.inf} | options))
    system = SimpleNamespace(nx=1, nv=1, nc=0, vector_like=True)
    control.fit(system)
    return control, system


def table(k, errors):
    """Differences whose errors at orders k-1, k and k+1 are the given multiples of the tolerance; weights are 1."""
    Z = np.zeros((9, 2))
    for order, error in zip((k - 1, k, k + 1), errors, strict=True):
        Z[order + 1, 0] = error * (order + 1)  # the error constant of BDF is 1/(order + 1)
    return Z


def after_equal_steps(control, system, Z, k, error, h=0.1):
    for _ in range(k):
        assert control.next_step(system, Z, k, h, error, np.ones(2)) == (h, k)  # too few equal steps to judge
    return control.next_step(system, Z, k, h, error, np.ones(2))


@pytest.mark.parametrize(
    ("errors", "order"), [((0.9, 0.4, 0.1), 4), ((0.01, 0.01, 0.01), 2), ((0.5, 1e-3, 0.5), 3), ((0.1, 0.3, 0.5), 2)]
)
def test_the_order_that_allows_the_longest_step_is_taken(errors, order):
    """Order j allows h·(1/error_j)^(1/(j+1)); of that, four fifths are used."""
    subject, system = control()
    h, k = after_equal_steps(subject, system, table(3, errors), 3, errors[1])
    assert k == order
    best = max(error ** (-1.0 / (j + 1)) for j, error in zip((2, 3, 4), errors, strict=True))
    assert h == pytest.approx(0.1 * 0.8 * best)


def test_small_gains_do_not_change_the_step_and_limits_hold():
    subject, system = control()
    small_gain = (0.8 / 1.05) ** 4  # allows 1.05 h with order 3
    assert after_equal_steps(subject, system, table(3, (1.0, small_gain, 1.0)), 3, small_gain) == (0.1, 3)
    gain = (0.8 / 1.15) ** 4
    h, k = after_equal_steps(control()[0], system, table(3, (1.0, gain, 1.0)), 3, gain)
    assert (h, k) == (pytest.approx(0.115), 3)
    for sign in (1.0, -1.0):
        h, _ = after_equal_steps(control()[0], system, table(3, (0, 0, 0)), 3, 0.0, sign * 0.1)
        assert h == pytest.approx(sign * 1.0)  # ten times at most
        limited = control(max_step=0.15)[0]
        h, _ = after_equal_steps(limited, system, table(3, (0, 0, 0)), 3, 0.0, sign * 0.1)
        assert h == pytest.approx(sign * 0.15)
    assert after_equal_steps(control(max_order=3)[0], system, table(3, (1.0, 0.5, 0.0)), 3, 0.5)[1] == 3


def test_after_a_rejection_the_step_shrinks_by_what_the_error_asks():
    subject, system = control()
    d, weight = np.zeros(2), np.ones(2)
    Z = table(3, (1e9, 0, 0))  # no lower order helps
    h, k = subject.after_rejection(system, Z, d, 3, 0.1, 16.0, weight)
    assert (h, k) == (pytest.approx(0.1 * 0.8 / 2), 3)  # 16^(1/4) = 2
    assert subject.after_rejection(system, Z, d, 3, 0.1, 1e9, weight) == (pytest.approx(0.02), 3)  # a fifth at least
    Z = table(3, (1.0, 0, 0))  # the lower one fits at this step
    assert subject.after_rejection(system, Z, d, 3, 0.1, 16.0, weight) == (pytest.approx(0.08), 2)
    assert subject.reasons == {"error": 3, "newton": 0}
    assert subject.after_failure(-0.1) == -0.025 and subject.reasons["newton"] == 1
