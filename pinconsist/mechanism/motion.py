"""Functions of one variable: Motion, a function of time with exact derivatives, and difference quotients for others."""

from __future__ import annotations

from dataclasses import dataclass, fields
from math import cos, pi, sin

import numpy as np

from ..errors import InputError, PinconsistError
from .checks import number, put_checked

TIME_STEP = 1e-3  # s, of the difference quotients in time
RELATIVE_STEP, SMALLEST = 1e-4, 0.1  # of differences with respect to a parameter: relative to it, and least value
PARTED = 1e-7  # relative to Φ_θ: largest part that no motion can compensate


@dataclass(frozen=True)
class Motion:
    """start + speed·t + amplitude·sin(2π·frequency·t + phase): a curve that can be written to a file and pickled.

    It can be the curve of a :class:`Drive`, the target of a :class:`Servo` or a torque of :class:`JointTorque`.

    Parameters
    ----------
    start, speed : float
        In rad or m (N·m or N for a torque), and in this unit per second.
    amplitude, frequency, phase : float
        In the unit of `start`; Hz; rad.

    Raises
    ------
    InputError
        A value that is not a finite number.
    """

    start: float = 0.0
    speed: float = 0.0
    amplitude: float = 0.0
    frequency: float = 0.0
    phase: float = 0.0

    def __post_init__(self):
        put_checked(self, "motion", number, *(each.name for each in fields(self)))

    @property
    def numbers(self) -> tuple[float, ...]:
        """The five numbers: (start, speed, amplitude, frequency, phase)."""
        return self.start, self.speed, self.amplitude, self.frequency, self.phase

    def __call__(self, t: float) -> float:
        return self.start + self.speed * t + self.amplitude * sin(2 * pi * self.frequency * t + self.phase)

    def rate(self, t: float) -> float:
        """The derivative at time `t`, s: rad/s or m/s; for other units of ``start``, that unit per second."""
        w = 2 * pi * self.frequency
        return self.speed + self.amplitude * w * cos(w * t + self.phase)

    def acceleration(self, t: float) -> float:
        """The second derivative at time `t`, s: rad/s² or m/s²; for other units of ``start``, that unit per s²."""
        w = 2 * pi * self.frequency
        return -self.amplitude * w**2 * sin(w * t + self.phase)


# Weights of fourth-order differences, by position in steps: central, and one-sided
CENTRAL = {-2: 1 / 12, -1: -2 / 3, 1: 2 / 3, 2: -1 / 12}
AHEAD = {0: -25 / 12, 1: 4.0, 2: -3.0, 3: 4 / 3, 4: -1 / 4}


def slope(function, step: float = 1.0):
    """f'(0) by central differences of fourth order."""
    return sum(weight * function(i * step) for i, weight in CENTRAL.items()) / step


def first(function, step: float):
    """f'(0) by central differences: error about step⁶ f⁽⁷⁾/140 + 2 eps |f|/step; exact for a constant `function`."""
    f = {i: np.asarray(function(i * step), float) for i in (-3, -2, -1, 1, 2, 3)}
    return (45.0 * (f[1] - f[-1]) - 9.0 * (f[2] - f[-2]) + (f[3] - f[-3])) / (60.0 * step)


def second(function, step: float):
    """f''(0) by central differences: error about step⁶ f⁽⁸⁾/560 + 8 eps |f|/step²; exact for a constant `function`."""
    f = {i: np.asarray(function(i * step), float) for i in (-3, -2, -1, 0, 1, 2, 3)}
    bends = [(f[i] - f[0]) + (f[-i] - f[0]) for i in (1, 2, 3)]
    return (270.0 * bends[0] - 27.0 * bends[1] + 2.0 * bends[2]) / (180.0 * step**2)


def check_slope(what: str, of: str, slope, function, steps, size=0.0) -> None:
    """Raise InputError if `slope` differs from f'(0) by more than a thousandth of itself, or of `size` if larger.

    f'(0) is computed by differences. One-sided differences are accepted, as a function may have a kink at zero, and
    several steps are tried, as its scale is unknown: a false alarm would be worse than an undetected error.
    """
    slope = np.asarray(slope, float)
    try:
        for h in steps:
            f = {i: np.asarray(function(i * h), float) for i in (-2, -1, 0, 1, 2)}
            noise = 20.0 * np.finfo(float).eps * max(np.max(np.abs(value), initial=0.0) for value in f.values()) / h
            middle = (8.0 * (f[1] - f[-1]) - (f[2] - f[-2])) / (12.0 * h)
            sides = [(4.0 * f[i] - 3.0 * f[0] - f[2 * i]) / (2.0 * i * h) for i in (1, -1)]
            for found in (middle, *sides):
                largest = np.maximum(np.maximum(np.abs(slope), np.abs(found)), size)
                if (np.abs(slope - found) <= 1e-3 * largest + noise).all():
                    return
        found = first(function, steps[1])
    except PinconsistError:  # the function need not be defined so far away
        return
    given, found = (np.array2string(each, precision=6) for each in (slope, found))
    raise InputError(
        f"{what} is {given}, which is not the derivative of its {of}: differences give {found}. Correct it, or omit "
        "it, so that differences are used"
    )


def difference_step(value):
    """The step of differences with respect to a parameter, or to each of several: 1e-4 max(|θ|, 0.1)."""
    return RELATIVE_STEP * np.maximum(np.abs(value), SMALLEST)


def check_closing(name, left, rate) -> None:
    """Raise InputError if varying a parameter opens the loops: no motion compensates `left`, a part of their `rate`."""
    if np.abs(left).max(initial=0.0) > PARTED * np.abs(rate).max(initial=1e-3):
        raise InputError(
            f"the parameter {name!r} cannot vary alone, because the loops would open. The lengths of an "
            "overconstrained loop depend on each other; vary them together, by one parameter of build()"
        )
