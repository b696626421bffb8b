"""Norms, as tests and tolerances use them."""

from math import sqrt

import numpy as np

EPS = float(np.finfo(float).eps)


def largest(x) -> float:
    """The largest magnitude in an array, 0 in an empty one."""
    return np.abs(x).max(initial=0.0)


def weighted_norm(change, weight, nv) -> float:
    """√(Σ (weight·change)² / nv) over [ξ | v]: not below the root mean square of either part, where nx = nv."""
    e = change[: len(weight)] * weight
    return sqrt(e.dot(e) / nv)
