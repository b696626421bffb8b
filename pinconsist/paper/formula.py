"""The formulas of BDF at constant step: weights of the derivative, and of the prediction.

With y_n, y_{n-1}, … known, BDF of order k approximates h y'_{n+1} by the backward differences of y,

    h y'_{n+1} = Σ_{j=1..k} 1/j ∇ʲ y_{n+1} = Σ_{i=0..k} d_i y_{n+1-i},

so that a step solves y_{n+1} = ψ + c y'_{n+1} with c = h/d₀ and ψ = -Σ_{i≥1} d_i/d₀ y_{n+1-i}. Order 1 is implicit
Euler.
"""

from math import comb

import numpy as np

HIGHEST = 6  # BDF of higher orders is unstable


def derivative_weights(k: int) -> np.ndarray:
    """d, shape (k+1,): h y'_{n+1} = Σ d_i y_{n+1-i}."""
    return np.array([(-1.0) ** i * sum(comb(j, i) / j for j in range(max(i, 1), k + 1)) for i in range(k + 1)])


def history_weights(k: int) -> np.ndarray:
    """w, shape (k,): ψ = Σ w_i y_{n-i}."""
    d = derivative_weights(k)
    return -d[1:] / d[0]


def prediction_weights(m: int) -> np.ndarray:
    """e, shape (m,): the polynomial through m values extrapolated by one step, y_{n+1} ≈ Σ e_i y_{n-i}."""
    return np.array([(-1.0) ** i * comb(m, i + 1) for i in range(m)])
