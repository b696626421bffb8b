"""Functions of one variable: Motion, a function of time with exact derivatives, and difference quotients for others."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import lru_cache
from math import cos, inf, pi, sin
from operator import mul

import numpy as np

from ..errors import InputError, PinconsistError
from .checks import number, put_checked

CHECK_DELAY = 1.7e-3  # s, from the start, where given derivatives are checked as well
TIME_STEP = 1e-3  # s, of difference quotients in time
RESOLVED = 1e-7  # relative difference of the fourth and sixth order below which a step resolves a function
ASIDE = 7.0  # steps, distance of differences that have no point in common
UNLIMITED = -inf, inf
EPS = float(np.finfo(float).eps)
RELATIVE_STEP, SMALLEST = 1e-4, 0.1  # of differences with respect to a parameter: relative to it, and least value


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
# Where differences in time are taken, in steps; not in a ratio of small numbers, or curves of 1 kHz could look constant
NODES = 1.0, 1.9371, 3.0


def _pair_weights(order: int, *used: int):
    """Weights of f(x h) -/+ f(-x h) at all nodes x, in hᵏ f⁽ᵏ⁾(0): of order 2n, if n of them are used."""
    n, weights = len(used), np.zeros(len(NODES))
    powers = np.array(NODES)[[*used]] ** (order + 2.0 * np.arange(n)[:, None])
    weights[[*used]] = np.linalg.solve(powers, 0.5 * order * np.eye(n)[0])
    return weights.tolist()


PARTS = tuple(np.linspace(0.0, 1.0, 9).tolist())  # where differences are taken near an end, parts of an interval
PAIRS = {order: [_pair_weights(order, *used) for used in ((0, 1, 2), (0, 1))] for order in (1, 2)}


def slope(function, step: float = 1.0):
    """f'(0) by central differences of fourth order."""
    return sum(weight * function(i * step) for i, weight in CENTRAL.items()) / step


def first(function, step: float):
    """f'(0) by central differences: error about step⁶ f⁽⁷⁾/140 + 2 eps |f|/step; exact for a constant `function`."""
    f = {i: np.asarray(function(i * step), float) for i in (-3, -2, -1, 1, 2, 3)}
    return (45.0 * (f[1] - f[-1]) - 9.0 * (f[2] - f[-2]) + (f[3] - f[-3])) / (60.0 * step)


def in_time(function, order: int = 1, step: float = TIME_STEP, reach=UNLIMITED, corners: bool = True):
    """The first or second derivative at time 0, by central differences of sixth order; exact for a constant function.

    The step is divided by 4 until it resolves a fast function. It is kept if it resolves the function on both sides,
    for then a corner or a jump lies between, which it smooths, unless it is known that there are no `corners`; and if
    no step does, as with noise. The function is called between the two times `reach` only, near which differences are
    one-sided.
    """
    room = min(-reach[0], reach[1])
    if room < NODES[-1] * step:
        return _aside(function, order, step, *reach)
    coarse, resolved = _difference(function, order, step)
    corners = corners and room >= (ASIDE + NODES[-1]) * step
    asides = (-ASIDE * step, ASIDE * step)
    if resolved or (corners and all(_resolved(function, order, step, aside) for aside in asides)):
        return coarse
    for i in range(1, 8):
        fine, resolved = _difference(function, order, step / 4.0**i, _largest(coarse))
        if resolved:
            return fine
    return coarse


def _difference(function, order: int, h: float, size: float = 0.0):
    """(the derivative, whether the formula of fourth order gives the same, relative to it or to a larger `size`).

    The error is about h⁶ f⁽⁷⁾/140 + 2 eps |f|/h, or h⁶ f⁽⁸⁾/560 + 8 eps |f|/h².
    """
    (a, b, c), (x, y, z) = ([function(side * node * h) for node in NODES] for side in (1.0, -1.0))
    if order == 1:
        pairs = a - x, b - y, c - z
    else:
        middle = function(0.0)
        pairs = (a - middle) + (x - middle), (b - middle) + (y - middle), (c - middle) + (z - middle)
    sixth, fourth = (sum(map(mul, weights, pairs)) / h**order for weights in PAIRS[order])
    rounding = 50.0 * EPS * (_largest(c) + _largest(z)) / h**order
    size = max(_largest(sixth), size)
    resolved = _largest(sixth - fourth) <= RESOLVED * size + rounding
    if resolved and order == 1:  # the two may agree by chance, where neither is right
        finer = sum(_slope_part(function, *each, h / 4.0) for each in zip(PAIRS[1][1], NODES[:2], strict=False))
        resolved = _largest(sixth - finer) <= RESOLVED * size + 4.0 * rounding
    return sixth, resolved


def _slope_part(function, weight, node, h):
    return weight * (function(node * h) - function(-node * h)) / h


def _aside(function, order: int, step: float, low: float, high: float):
    """The derivative at time 0, by differences of eighth order in an interval that ends near it.

    The interval is divided by 4 until that changes little; the error of the last one is smaller than this change. Of a
    function that is the small difference of large numbers, the rounding is not known: if no change is small enough, the
    derivative is that after which it changed least.
    """
    wide, found = min(2.0 * NODES[-1] * step, high - low), None
    best, least = None, inf
    for _ in range(8):
        first = min(max(-0.5 * wide, low), high - wide)
        values = [np.asarray(function(first + part * wide), float) for part in PARTS]
        weights = _weights(-first / wide, order)
        before, found = found, sum(map(mul, weights, values)) / wide**order
        rounding = EPS * sum(abs(weight) * _largest(value) for weight, value in zip(weights, values, strict=True))
        if before is not None:
            change = _largest(found - before)
            if change <= RESOLVED * _largest(found) + rounding / wide**order:
                return found
            if change < least:
                best, least = before, change
        wide *= 0.25
    return best


@lru_cache(1000)
def _weights(place: float, order: int):
    """Weights of values at PARTS, in the derivative at a place between 0 and 1, of order 9 - `order`."""
    powers = (np.array(PARTS) - place) ** np.arange(len(PARTS))[:, None]
    return np.linalg.solve(powers, order * np.eye(len(PARTS))[order]).tolist()


def _resolved(function, order, h, aside) -> bool:
    try:
        return _difference(lambda s: function(aside + s), order, h)[1]
    except PinconsistError:  # it need not be defined there
        return True


def _largest(x) -> float:
    return abs(x) if isinstance(x, float) else np.abs(x).max(initial=0.0)


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


def check_rate(what: str, of: str, function, rate, t: float, steps) -> None:
    """:func:`check_slope` of functions of time, at `t` and on both sides of it, one of which may be outside the run.

    At t = 0 a wrong rate, as of a sine, is often zero as well.
    """

    def check(at, slope):
        check_slope(f"{what} at t = {at:.6g}", of, slope, lambda s: function(at + s), steps)

    check(t, rate(t))
    refusals = []
    for near in (t + CHECK_DELAY, t - CHECK_DELAY):
        try:
            slope = rate(near)
        except PinconsistError:  # it need not be defined there
            return
        try:
            return check(near, slope)
        except InputError as error:
            refusals.append(error)
    raise refusals[0]
