"""Curves through the values of a table."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..errors import InputError
from .checks import finite_array
from .sampling import Change


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
            raise InputError(f"{what} must be a function of time or a table (times, values), got {table!r}") from None
        times, values = finite_array(times, f"{what}: times"), finite_array(values, f"{what}: values")
        if times.ndim != 1 or times.shape != values.shape or len(times) < 2:
            raise InputError(
                f"{what}: a table is (times, values), two rows of the same length, at least 2; got shapes "
                f"{times.shape} and {values.shape}"
            )
        if (np.diff(times) <= 0.0).any():
            hint = "; for a list of points pass their transpose" if len(times) == 2 else ""
            raise InputError(f"{what}: the times of a table must increase, got {times.tolist()}{hint}")
        return cls(tuple(times.tolist()), tuple(values.tolist()))

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
