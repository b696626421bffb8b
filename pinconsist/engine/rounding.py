"""Rounding of times."""

import numpy as np

from . import constant


def shortest_step(*times) -> float:
    """The shortest step, s, that can be distinguished from zero at these times."""
    return constant("SMALLEST_STEP") * float(np.spacing(max(map(abs, times))))
