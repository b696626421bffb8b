"""Curves through the values of a table."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import cos, pi, sin
from numbers import Real

import numpy as np

from ..errors import InputError, warn
from .checks import choice, finite_array, put
from .sampling import Change

SWING = 0.5  # of the range of the values; through values at even times, splines do not swing that far
STEPS = {"table": (0.0, 1.0), "step5": (0.0, 0.0, 0.0, 10.0, -15.0, 6.0)}
"""Law → coefficients of s, s², … by which it goes from one value to the next, s from 0 to 1."""
LAWS = ("spline", "step5", "cycloid", "table")
BENDS = {"table": 1, "spline": 3, "step5": 3, "cycloid": 3}
"""Law → order of the derivative that jumps at its times; splines have an acceleration that jumps at both ends."""


@dataclass(frozen=True)
class Curve:
    """A function of time that interpolates values at times, constant before and after, with exact derivatives.

    It can be the curve of a :class:`Drive`, the target of a :class:`Servo`, a torque of :class:`JointTorque` or the
    command of an :class:`Actuator`; it can be written to a file and pickled. Steps of a run end at its times.

    Parameters
    ----------
    times, values : sequence of float
        At least two increasing times, s; values in rad or m (N·m or N for a torque).
    law : {"spline", "step5", "cycloid", "table"}
        Interpolation between two values, with h their difference and s the time between them, scaled from 0 to 1.
        ``spline``: the cubic spline at rest at both ends. ``step5``: h (10 s³ - 15 s⁴ + 6 s⁵), and ``cycloid``: h (s -
        sin(2π s)/2π), which are at rest at each value, with zero acceleration. ``table``: linear interpolation; its
        rate jumps, and a drive that follows it exerts an impulse at each time.

    Raises
    ------
    InputError
        Times that do not increase, different numbers of times and values, numbers that are not finite, unknown laws.
    """

    times: tuple[float, ...]
    values: tuple[float, ...]
    law: str = "spline"

    def __post_init__(self):
        times, values = finite_array(self.times, "curve: times"), finite_array(self.values, "curve: values")
        put(self, law=choice(self.law, LAWS, "curve: law"))
        _check(times, values, "curve")
        put(self, times=tuple(times.tolist()), values=tuple(values.tolist()))

    @cached_property
    def _pieces(self) -> list[list[tuple[float, ...]]]:
        """Order of the derivative → piece → coefficients of powers of the time since its start, the highest first."""
        if self.law == "spline":
            from scipy.interpolate import CubicSpline

            own = CubicSpline(self.times, self.values, bc_type="clamped").c.T
        else:
            length, rise = np.diff(self.times), np.diff(self.values)
            own = [h * np.array(STEPS[self.law]) / T ** np.arange(len(STEPS[self.law]))
                   for T, h in zip(length, rise, strict=True)]  # fmt: skip
            own = [[*each[:0:-1], value] for each, value in zip(own, self.values, strict=False)]
        return [[tuple(np.polyder(each, order).tolist()) for each in own] for order in range(3)]

    def _at(self, t, order, outside) -> float:
        if not self.times[0] <= t <= self.times[-1]:
            return outside
        piece = min(bisect_right(self.times, t), len(self.times) - 1) - 1
        since = t - self.times[piece]
        if self.law == "cycloid":
            return self._cycloid(piece, since, order)
        result = 0.0
        for coefficient in self._pieces[order][piece]:
            result = result * since + coefficient
        return result

    def _cycloid(self, piece, since, order) -> float:
        length = self.times[piece + 1] - self.times[piece]
        rise, turn = self.values[piece + 1] - self.values[piece], 2.0 * pi * since / length
        if order == 0:
            return self.values[piece] + rise * (since / length - sin(turn) / (2.0 * pi))
        return rise / length * (1.0 - cos(turn)) if order == 1 else rise / length**2 * 2.0 * pi * sin(turn)

    def __call__(self, t: float) -> float:
        return self._at(t, 0, self.values[0] if t < self.times[0] else self.values[-1])

    def rate(self, t: float) -> float:
        """The derivative at time `t`, s."""
        return self._at(t, 1, 0.0)

    def acceleration(self, t: float) -> float:
        """The second derivative at time `t`, s."""
        return self._at(t, 2, 0.0)

    @property
    def break_points(self) -> list[Change]:
        """Where its derivatives jump: for a spline the acceleration at both ends, for a table the rate."""
        ends = self.times[0], self.times[-1]
        return [Change(t, 2 if self.law == "spline" and t in ends else BENDS[self.law]) for t in self.times]


def _check(times, values, what) -> None:
    if times.ndim != 1 or times.shape != values.shape or len(times) < 2:
        raise InputError(
            f"{what}: a table is (times, values), two rows of the same length, at least 2; got shapes "
            f"{times.shape} and {values.shape}"
        )
    if (np.diff(times) <= 0.0).any():
        hint = "; for a list of points pass their transpose" if len(times) == 2 else ""
        raise InputError(f"{what}: the times of a table must increase, got {times.tolist()}{hint}")


def spline_of(table, what: str) -> Curve:
    """The spline of a table (times, values) from user input."""
    try:
        times, values = table
    except (TypeError, ValueError):
        held = f"; to hold the joint there: pinconsist.Motion(start={table!r})" if isinstance(table, Real) else ""
        reason = f"{what} must be a function of time or a table (times, values), got {table!r}{held}"
        raise InputError(reason) from None
    times, values = finite_array(times, f"{what}: times"), finite_array(values, f"{what}: values")
    _check(times, values, what)
    found = Curve(tuple(times.tolist()), tuple(values.tolist()))
    _warn_of_swings(found, what)
    return found


def _warn_of_swings(spline, what):
    """Warn if it goes far beyond its values, as through times of uneven distances."""
    inside = np.concatenate([np.linspace(*ends, 17) for ends in pairwise(spline.times)])
    curve, low, high = np.array([spline(t) for t in inside]), min(spline.values), max(spline.values)
    if max(low - curve.min(), curve.max() - high) > SWING * (high - low):
        warn(
            f"{what}: the cubic spline through its table goes from {curve.min():.4g} to {curve.max():.4g}, far "
            f"beyond its values, {low:g} … {high:g}, as the distances of its times are uneven. Give more values "
            "where it rests, or pass scipy.interpolate.PchipInterpolator(times, values)"
        )
