"""BDF on backward differences: coefficients, prediction, table update, change of step.

A table ``Z`` holds ∇⁰y, ∇¹y, ..., ∇ᵏ⁺²y of y = [ξ | v | λ] as rows, ξ being the position in a chart. With
``c = h/α_k`` a step solves

    ξ_{n+1} = ψ_ξ + c U,    v_{n+1} = ψ_v + c v',    (ψ = Σ_j (1 - γ_j/α_k) ∇ʲy_n,  γ_j = Σ_{i≤j} 1/i)

and predicts y_{n+1} = Σ_{j≤k} ∇ʲy_n; α_k = γ_k. (Klopfenstein's and Shampine's NDF constants were measured and bring
nothing here: they leave order 5, which does nearly all the work, as it is.)

References
----------
L. F. Shampine, M. W. Reichelt, The MATLAB ODE suite, SIAM J. Sci. Comput. 18 (1997), section 2.
"""

from __future__ import annotations

from functools import cache
from math import comb

import numpy as np

from .newton import rounding_weights

MAX_ORDER = 6
ROWS = MAX_ORDER + 3  # of a table: ∇⁰y to ∇ᵏ⁺²y, and zeros
MAX_CHART_TURN = 2.5  # rad that a chart may span: at π it wraps around
GAMMA = np.concatenate(([0.0], np.cumsum(1.0 / np.arange(1, MAX_ORDER + 1))))


@cache
def alpha(k: int) -> float:
    """α_k: the leading weight of the formula; c = h/α_k."""
    return float(GAMMA[k])


@cache
def error_constant(k: int) -> float:
    """C with local error ≈ C ∇ᵏ⁺¹y."""
    return 1.0 / (k + 1)


@cache
def predictor(k: int) -> np.ndarray:
    """(2, k+1): its product with Z[:k+1] is the prediction and ψ."""
    weights = np.ones((2, k + 1))
    weights[1] -= GAMMA[: k + 1] / alpha(k)
    return _frozen(weights)


@cache
def advance(k: int) -> np.ndarray:
    """(ROWS, ROWS): leads a table whose row k+2 holds y_{n+1} minus its prediction to the table at n+1."""
    T = np.zeros((ROWS, ROWS))
    for j in range(k + 1):
        T[j, j : k + 1] = 1.0
        T[j, k + 2] = 1.0
    T[k + 1, k + 2] = 1.0
    T[k + 2, k + 1 : k + 3] = (-1.0, 1.0)
    return _frozen(T)


@cache
def differences(k: int) -> np.ndarray:
    """(k+1, k+1): leads past values y_n, y_{n-1}, ..., y_{n-k} to differences, and differences back to values."""
    return _frozen(np.array([[(-1.0) ** i * comb(j, i) for i in range(k + 1)] for j in range(k + 1)]))


def rescale(k: int, factor: float) -> np.ndarray:
    """(k+1, k+1): leads Z[:k+1] to the differences for step factor·h of the same interpolating polynomial."""
    return _rescaling(k).dot(factor ** np.arange(k + 1))


@cache
def _rescaling(k: int) -> np.ndarray:
    """(k+1, k+1, k+1): :func:`rescale` as polynomials of its factor, lowest power first."""
    nodes = np.zeros((k + 1, k + 1, k + 1))  # [i, j]: Newton's basis polynomial j at i new steps back from t_n
    for i in range(k + 1):
        polynomial = np.ones(1)
        nodes[i, 0, 0] = 1.0
        for j in range(k):
            polynomial = np.convolve(polynomial, (j, -i)) / (j + 1)
            nodes[i, j + 1, : j + 2] = polynomial
    return _frozen(np.tensordot(differences(k), nodes, 1))


def interpolate(k: int, s) -> np.ndarray:
    """(..., k+1): Newton basis at t_n + s h, s ≤ 0 inside the past; its product with Z[:k+1] interpolates."""
    s = np.asarray(s, float)
    basis = np.ones((*s.shape, k + 1))
    for j in range(1, k + 1):
        basis[..., j] = basis[..., j - 1] * (s + j - 1) / j
    return basis


def recenter(system, base, new_base, Z, rows: int) -> None:
    """Move the position columns of Z[:rows] from the chart at `base` to the chart at `new_base`, in place.

    Only for systems on manifolds. The values behind the differences are carried over one by one, which keeps the
    order of the method without any derivative of the exponential.
    """
    D, nx = differences(rows - 1), system.nx
    past = D @ Z[:rows, :nx]
    moved = [system.difference(new_base, system.integrate(base, xi)) for xi in past]
    Z[:rows, :nx] = D @ np.array(moved)


def turning_coordinates(system, p):
    """(joints, nx) of zeros and ones: the tangent coordinates that turn each joint, those that come back after 2π."""
    joints, nx = {}, system.nx
    if system.vector_like:
        return np.zeros((0, nx))
    p = system.integrate(p, 0.3 + 0.01 * np.arange(nx))  # where every number of a quaternion moves with each of them
    for i, turn in enumerate(2 * np.pi * np.eye(nx)):
        if np.abs(system.difference(p, system.integrate(p, turn))).max() < 1e-6:
            moved = np.abs(system.integrate(p, 0.1 * turn) - p) > 1e-6
            joints.setdefault(int(np.argmax(moved)), np.zeros(nx))[i] = 1.0
    return np.array(list(joints.values())).reshape(-1, nx)


def fastest_turn(turns, rate) -> float:
    """Largest angular speed (or angle) of the joints that turn, from the tangent velocity (or vector)."""
    return float(np.sqrt((turns @ rate**2).max(initial=0.0)))


def formula_step(newton, t, h, k, base, Z):
    """Predict and solve one constant-step BDF-k step to rounding: (Attempt, prediction, chart centre)."""
    system = newton.system
    base, predicted, psi = predict(system, k, base, Z)
    weights = rounding_weights(system, predicted)
    return newton.attempt(t + h, base, psi, predicted, h / alpha(k), *weights), predicted, base


def predict(system, k, base, Z):
    """(chart centre, prediction, ψ); moves the table to the chart at the predicted position where there is one."""
    predicted, psi = predictor(k).dot(Z[: k + 1])
    if system.vector_like:
        return predicted[: system.nx], predicted, psi
    centre = system.integrate(base, predicted[: system.nx])
    recenter(system, base, centre, Z, k + 2)
    predicted, psi = predictor(k) @ Z[: k + 1]
    return centre, predicted, psi


def table_row(system, base, p, v, lam):
    """[ξ | v | λ] of a state: ξ is the position itself, or its coordinates in the chart at `base`."""
    xi = p if system.vector_like else system.difference(base, p)
    return np.concatenate((xi, v, lam))


def _frozen(array):
    array.setflags(write=False)
    return array
