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


def is_slope(slope, function, steps, size=0.0) -> bool:
    """Whether `slope` is f'(0) to a thousandth (of `size` where that is larger), by differences over one of `steps`.

    Slopes from one side count, as functions may have a corner at zero, and several steps are tried, as they may have
    scales of their own: a false alarm would be worse than a wrong slope that is overlooked.
    """
    slope = np.asarray(slope, float)
    for h in steps:
        f = {i: np.asarray(function(i * h), float) for i in (-2, -1, 0, 1, 2)}
        noise = 20.0 * np.finfo(float).eps * max(np.max(np.abs(value), initial=0.0) for value in f.values()) / h
        middle = (8.0 * (f[1] - f[-1]) - (f[2] - f[-2])) / (12.0 * h)
        ahead, behind = (4.0 * f[1] - 3.0 * f[0] - f[2]) / (2.0 * h), (3.0 * f[0] - 4.0 * f[-1] + f[-2]) / (2.0 * h)
        for found in (middle, ahead, behind):
            largest = np.maximum(np.maximum(np.abs(slope), np.abs(found)), size)
            if (np.abs(slope - found) <= 1e-3 * largest + noise).all():
                return True
    return False
