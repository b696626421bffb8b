"""Complementarity problems against all cases of their laws, and what they must fulfil."""

from itertools import product

import numpy as np
import pytest

from pinconsist.engine.complementarity import Grip, Push, solve


def problem(rng, contacts, tangents, freedoms, redundant=False):
    """A, b and blocks of random contacts of a body with a mass matrix that is diagonal."""
    size = 1 + tangents
    R = rng.standard_normal((contacts * size, freedoms))
    if redundant:
        R[size : 2 * size] = R[:size]
    A = R @ np.diag(1.0 / rng.uniform(0.1, 10.0, freedoms)) @ R.T
    b = R @ rng.standard_normal(freedoms)
    blocks = []
    for i in range(0, contacts * size, size):
        blocks.append(Push(i))
        if tangents:
            blocks.append(Grip(i + 1, tangents, friction=rng.uniform(0.0, 0.7), of=i))
    return A, b, blocks


def violation(z, u, blocks):
    """By how much a solution violates the laws, written as they stand in textbooks."""
    worst = 0.0
    for block in blocks:
        if isinstance(block, Push):
            worst = max(worst, -z[block.at], -u[block.at], abs(z[block.at] * u[block.at]))
            continue
        at = slice(block.at, block.at + block.size)
        force, slip = z[at], u[at]
        limit = block.friction * z[block.of] if block.of >= 0 else block.limit
        worst = max(worst, np.linalg.norm(force) - limit)
        speed = np.linalg.norm(slip)  # the force opposes sliding, with its limit
        worst = max(worst, np.linalg.norm(force * speed + limit * slip))
    return worst


@pytest.mark.parametrize("tangents", [0, 1, 2])
@pytest.mark.parametrize("redundant", [False, True])
def test_solutions_fulfil_the_laws(tangents, redundant):
    rng = np.random.default_rng(tangents)
    for _ in range(60):
        A, b, blocks = problem(rng, int(rng.integers(2, 7)), tangents, int(rng.integers(6, 12)), redundant)
        z, u, left = solve(A, b, blocks)
        assert left < 1e-9
        assert violation(z, u, blocks) < 1e-8 * (1.0 + np.abs(z).max()) * (1.0 + np.abs(b).max())


def test_pushes_are_those_found_by_trying_all_cases():
    rng = np.random.default_rng(3)
    for _ in range(200):
        n = int(rng.integers(1, 5))
        A, b, blocks = problem(rng, n, 0, 6)
        z = solve(A, b, blocks)[0]
        found = []
        for case in product([False, True], repeat=n):
            closed = np.flatnonzero(case)
            trial = np.zeros(n)
            trial[closed] = np.linalg.solve(A[np.ix_(closed, closed)], -b[closed])
            if trial.min(initial=0.0) >= 0.0 and (A @ trial + b)[~np.array(case)].min(initial=0.0) >= -1e-12:
                found.append(trial)
        np.testing.assert_allclose(z, found[0], atol=1e-10 * (1.0 + np.abs(z).max()))


@pytest.mark.parametrize(("push", "expected"), [(0.5, -0.5), (3.0, -1.0), (-3.0, 1.0)])
def test_dry_friction_holds_up_to_its_limit(push, expected):
    z, u, _ = solve(np.eye(1), np.array([push]), [Grip(0, 1, limit=1.0)])
    assert z[0] == pytest.approx(expected) and u[0] == pytest.approx(push + expected, abs=1e-14)


def test_a_problem_without_a_solution_has_a_residual():
    """Painlevé: the force that friction couples to the push makes it accelerate towards the wall."""
    _, _, left = solve(np.array([[-1.0]]), np.array([-1.0]), [Push(0)])
    assert left > 1e-3


def test_nothing_to_solve():
    z, u, left = solve(np.zeros((0, 0)), np.zeros(0), [])
    assert len(z) == len(u) == 0 and left == 0.0
