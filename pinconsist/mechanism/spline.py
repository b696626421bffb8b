"""Curves through the values of a table."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from numbers import Real

import numpy as np

from ..errors import InputError, warn
from .checks import finite_array
from .sampling import Change

SWING = 0.5  # of the range of the values; through values at even times, splines do not swing that far


@dataclass(frozen=True)
class Spline:
    """The cubic spline through values at times that is at rest at both ends, and constant before and after."""

    times: tuple[float, ...]
    values: tuple[float, ...]

    @classmethod
    def of(cls, table, what: str) -> Spline:
        """The spline of a table (times, values) from user input."""
        try:
            times, values = table
        except (TypeError, ValueError):
            held = f"; to hold the joint there: pinconsist.Motion(start={table!r})" if isinstance(table, Real) else ""
            reason = f"{what} must be a function of time or a table (times, values), got {table!r}{held}"
            raise InputError(reason) from None
        times, values = finite_array(times, f"{what}: times"), finite_array(values, f"{what}: values")
        if times.ndim != 1 or times.shape != values.shape or len(times) < 2:
            raise InputError(
                f"{what}: a table is (times, values), two rows of the same length, at least 2; got shapes "
                f"{times.shape} and {values.shape}"
            )
        if (np.diff(times) <= 0.0).any():
            hint = "; for a list of points pass their transpose" if len(times) == 2 else ""
            raise InputError(f"{what}: the times of a table must increase, got {times.tolist()}{hint}")
        found = cls(tuple(times.tolist()), tuple(values.tolist()))
        found._warn_of_swings(what)
        return found

    def _warn_of_swings(self, what):
        """Warn if it goes far beyond its values, as through times of uneven distances."""
        inside = np.concatenate([np.linspace(*ends, 17) for ends in pairwise(self.times)])
        curve, low, high = self._curves[0](inside), min(self.values), max(self.values)
        if max(low - curve.min(), curve.max() - high) > SWING * (high - low):
            warn(
                f"{what}: the cubic spline through its table goes from {curve.min():.4g} to {curve.max():.4g}, far "
                f"beyond its values, {low:g} … {high:g}, as the distances of its times are uneven. Give more values "
                "where it rests, or pass scipy.interpolate.PchipInterpolator(times, values)"
            )

    @cached_property
    def _curves(self):
        from scipy.interpolate import CubicSpline

        curve = CubicSpline(self.times, self.values, bc_type="clamped")
        return curve, curve.derivative(1), curve.derivative(2)

    def _at(self, t, order, outside):
        return float(self._curves[order](t)) if self.times[0] <= t <= self.times[-1] else outside

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
        """Its accelerations jump at the ends, and bend at the other times."""
        ends = self.times[0], self.times[-1]
        return [Change(t, 2 if t in ends else 3) for t in self.times]
