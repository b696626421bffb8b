"""Norms, as tests and tolerances use them."""

import numpy as np

EPS = float(np.finfo(float).eps)


def largest(x) -> float:
    """The largest magnitude in an array, 0 in an empty one."""
    return np.abs(x).max(initial=0.0)
