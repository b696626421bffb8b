"""Positions on a manifold: coordinates ξ of p = base ⊕ ξ, and how far a chart may reach."""

from functools import cache
from math import pi

import numpy as np

from . import constant
from .norms import EPS, largest


def chart_point(system, base, xi):
    """base ⊕ ξ; ξ itself if positions are vectors."""
    return xi if system.vector_like else system.integrate(base, xi)


def chart_matrix(system, xi, columns=slice(None)):
    """T, shape (nx, nx): ξ changes at the rate T v if base ⊕ ξ moves with the tangent velocity v.

    T = ad/(1 - exp(-ad)) = 1 + ad/2 + Σ B₂ₙ/(2n)! ad²ⁿ, ad = ad ξ, whose terms fall like (turn/2π)²ⁿ. `xi` may be a
    stack (n, nx); `columns` selects coordinates that others do not turn.
    """
    ad = system.bracket(xi)[..., columns, :][..., columns]
    unit = np.eye(ad.shape[-1])
    with np.errstate(over="ignore", invalid="ignore"):  # beyond a full turn it diverges, and T is not finite
        T, power, square = unit + 0.5 * ad, unit, ad @ ad
        for weight in bernoulli():
            power = power @ square
            T = T + weight * power
            if largest(weight * power) <= EPS:
                break
    return T


def chart_rate_gradient(system, xi, rate):
    """∂(T rate)/∂ξ at `xi`, shape (nx, nx), for a constant tangent velocity `rate`: the series of T, term by term."""
    ad, power, change = system.bracket(xi), rate, np.zeros((system.nx, system.nx))  # adᵏ rate, and its derivative
    total = -0.5 * system.bracket(rate)
    for weight in bernoulli():
        for _ in range(2):
            power, change = ad @ power, ad @ change - system.bracket(power)
        total = total + weight * change
        if largest(weight * change) <= EPS * largest(total):
            break
    return total


@cache
def bernoulli() -> list[float]:
    """B₂ₙ/(2n)!, the coefficients of x/2 coth(x/2)."""
    from scipy.special import zeta

    return [float(-2.0 * (-1.0) ** n * zeta(2 * n) / (2.0 * pi) ** (2 * n)) for n in range(1, 40)]


def turning_coordinates(system, p):
    """(joints, nx) of zeros and ones: for each joint the tangent coordinates that return after 2π."""
    joints, nx = {}, system.nx
    if system.vector_like:
        return np.zeros((0, nx))
    p = system.integrate(p, 0.3 + 0.01 * np.arange(nx))  # at which each of them changes every number of a quaternion
    for i, turn in enumerate(2 * np.pi * np.eye(nx)):
        if np.abs(system.difference(p, system.integrate(p, turn))).max() < 1e-6:
            moved = np.abs(system.integrate(p, 0.1 * turn) - p) > 1e-6
            joints.setdefault(int(np.argmax(moved)), np.zeros(nx))[i] = 1.0
    return np.array(list(joints.values())).reshape(-1, nx)


def fastest_turn(turns, rate) -> float:
    """Largest angular speed (or angle) of the joints that turn, from the tangent velocity (or vector), or its rows."""
    return float(np.sqrt((rate**2 @ turns.T).max(initial=0.0))) if len(turns) else 0.0


def longest_step(turns, rate, k) -> float:
    """The longest step, s, with which no joint makes half a turn in the k+2 intervals that a chart spans."""
    speed = fastest_turn(turns, rate)
    return constant("MAX_CHART_TURN") / ((k + 2) * speed) if speed else np.inf
