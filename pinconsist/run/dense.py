"""Accepted steps with their interpolating polynomials, and the continuous solution made of them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..engine import bdf
from ..engine.problem import Index3System
from ..errors import InputError


class Curve(ABC):
    """The polynomials of successive steps of one system, from `start` to their `ends`."""

    start: float
    ends: np.ndarray
    system: Index3System

    @property
    def sign(self) -> float:
        """1 forwards in time, -1 backwards."""
        return 1.0 if self.ends[-1] >= self.start else -1.0

    def holders(self, times):
        """Index of the step at each of the times."""
        return np.minimum(np.searchsorted(self.sign * self.ends, self.sign * times), len(self.ends) - 1)

    @abstractmethod
    def __call__(self, times):
        """(p, v, λ) at several times, as arrays."""

    @abstractmethod
    def with_others(self, curves) -> Curve:
        """One curve made of this one and the ones that follow."""


@dataclass
class Tables(Curve):
    """Polynomials in [ξ | v | λ] of successive steps from `start` on, exact at both, as arrays with an entry a step.

    The polynomial of a step has the degree k, and backward differences Z about its time t, of size h. Positions on a
    manifold are interpolated in the chart at `base`, so they stay on it; loops are closed in between to the order of
    the method. ``chart_points(bases, ξ)`` returns the positions of a stack of rows; if None, they are computed one by
    one.
    """

    start: float
    ends: np.ndarray
    t: np.ndarray
    h: np.ndarray
    k: np.ndarray
    base: np.ndarray
    Z: np.ndarray
    system: Index3System
    chart_points: Callable | None

    def _columns(self):
        return self.ends, self.t, self.h, self.k, self.base, self.Z

    def __call__(self, times):
        i, nx, nv = self.holders(times), self.system.nx, self.system.nv
        highest = int(self.k[i].max(initial=0))
        basis = bdf.interpolate(highest, (times - self.t[i]) / self.h[i])
        basis[np.arange(highest + 1) > self.k[i, None]] = 0.0
        y = (basis[:, None] @ self.Z[i, : highest + 1])[:, 0]
        return self._positions(self.base[i], y[:, :nx]), y[:, nx : nx + nv], y[:, nx + nv :]

    def _positions(self, bases, xi):
        if self.system.vector_like:
            return xi
        if self.chart_points is not None:
            return self.chart_points(bases, xi)
        return np.array([self.system.integrate(*row) for row in zip(bases, xi, strict=True)])

    def with_others(self, curves):
        columns = zip(*(curve._columns() for curve in (self, *curves)), strict=True)
        return Tables(self.start, *map(np.concatenate, columns), self.system, self.chart_points)


@dataclass
class Made:
    """What one call of the engine has made.

    `rows` are t, p, v and λ, as arrays: the ends of steps, or what was requested, and second rows where forces jump;
    `orders` are those of the steps that lead to them, 0 in a start and after jumps. The curve has the polynomials of
    all steps, if requested. `reached` is the end of the last step, its size and its order.
    """

    steps: int
    rows: tuple
    orders: np.ndarray
    curve: Curve | None
    reached: tuple


def joined(curves) -> list[Curve]:
    """The curves, with successive ones of the same system and type merged."""
    groups: list[list[Curve]] = []
    for curve in curves:
        first = groups[-1][0] if groups else None
        if first is not None and first.system is curve.system and type(first) is type(curve):
            groups[-1].append(curve)
        else:
            groups.append([curve])
    return [first.with_others(others) for first, *others in groups]


class DenseOutput:
    """The solution at any time of the run.

    Calling it with times of shape (n,) gives (q, v, lam) with shapes (n, nq), (n, nv), (n, nc); a single time gives
    single rows.
    """

    def __init__(self, curves):
        self._curves = joined(curves)
        first, last = self._curves[0].start, self._curves[-1].ends[-1]
        self.t_min, self.t_max, self._sign = min(first, last), max(first, last), 1.0 if last >= first else -1.0
        self._ends = np.array([curve.ends[-1] for curve in self._curves])

    def __call__(self, t):
        try:
            times = np.asarray(t, float)
        except (TypeError, ValueError):
            raise InputError(f"dense output needs a time or times (s), got {t!r}") from None
        if not (
            times.ndim < 2 and np.isfinite(times).all() and (times >= self.t_min).all() and (times <= self.t_max).all()
        ):
            raise InputError(f"dense output covers t = {self.t_min:g} to {self.t_max:g} s, requested {t}")
        requested = np.atleast_1d(times) if times.size else np.array([self.t_min])
        holders = np.minimum(np.searchsorted(self._sign * self._ends, self._sign * requested), len(self._ends) - 1)
        parts = [self._finished(self._curves[i], requested[holders == i]) for i in np.unique(holders)]
        order = np.argsort(np.argsort(holders, kind="stable"), kind="stable")
        columns = tuple(np.concatenate(column)[order] for column in zip(*parts, strict=True))
        return tuple(column[: times.size] for column in columns) if times.ndim else tuple(row[0] for row in columns)

    @property
    def curves(self) -> tuple[Curve, ...]:
        """The polynomials of all steps, in the order of the run."""
        return tuple(self._curves)

    @staticmethod
    def _finished(curve, times):
        """Rows with the multipliers as the user sees them, from the constraint rows kept in these steps."""
        p, v, lam = curve(times)
        return p, v, curve.system.full_multipliers(p, lam, v=v)
