"""Derivatives at zero of functions of one number, by sixth-order central differences."""

from __future__ import annotations

import numpy as np


def first(function, step: float):
    """f'(0). Error near step⁶ f⁽⁷⁾/140 and 2 eps |f|/step; exactly zero where `function` is constant."""
    f = {i: np.asarray(function(i * step), float) for i in (-3, -2, -1, 1, 2, 3)}
    return (45.0 * (f[1] - f[-1]) - 9.0 * (f[2] - f[-2]) + (f[3] - f[-3])) / (60.0 * step)


def second(function, step: float):
    """f''(0). Error near step⁶ f⁽⁸⁾/560 and 8 eps |f|/step²; exactly zero where `function` is constant."""
    f = {i: np.asarray(function(i * step), float) for i in (-3, -2, -1, 0, 1, 2, 3)}
    bends = [(f[i] - f[0]) + (f[-i] - f[0]) for i in (1, 2, 3)]
    return (270.0 * bends[0] - 27.0 * bends[1] + 2.0 * bends[2]) / (180.0 * step**2)
