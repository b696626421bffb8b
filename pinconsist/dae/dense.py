"""Continuous solutions: the interpolating polynomials of the accepted steps."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError
from . import bdf
from .charts import chart_point
from .index1 import Index1
from .problem import Index3System
from .radau import Table


@dataclass(frozen=True)
class Segment:
    """The polynomial of degree k over one step from `t_old` to `end`, in [ξ | v | λ], exact at both of its ends.

    Positions on a manifold are interpolated in the chart at `base`, so they stay on it; loops are closed in between
    to the order of the method.
    """

    t_old: float
    end: float
    t: float
    h: float
    k: int
    base: np.ndarray
    Z: np.ndarray
    system: Index3System

    def until(self, end: float) -> Segment:
        """The same polynomial, used only up to `end`."""
        return self if end == self.end else replace(self, end=end)

    def __call__(self, t: float):
        """(p, v, λ) at a time inside the step."""
        y = bdf.interpolate(self.k, (t - self.t) / self.h).dot(self.Z)
        nx, nv = self.system.nx, self.system.nv
        return chart_point(self.system, self.base, y[:nx]), y[nx : nx + nv], y[nx + nv :]

    def finished(self, t: float):
        """(p, v, λ) with the multipliers as the user sees them, by the rows that were kept in this step."""
        p, v, lam = self(t)
        return p, v, self.system.full_multipliers(p, lam)


@dataclass(frozen=True)
class RadauSegment:
    """The collocation polynomial of a step from (p0, v0), led to its projected end (p, v); λ by the index-1 equations.

    `W` and `U` have the accelerations and the rates of ξ at the stages of the formula `table`, a row for each.
    """

    t_old: float
    end: float
    h: float
    table: Table
    p0: np.ndarray
    v0: np.ndarray
    W: np.ndarray
    U: np.ndarray
    p: np.ndarray
    v: np.ndarray
    system: Index3System

    def until(self, end: float):
        """The same polynomial, used only up to `end`."""
        return self if end == self.end else replace(self, end=end)

    def __call__(self, t: float):
        """(p, v, λ) at a time inside the step."""
        system, theta = self.system, (t - self.t_old) / self.h
        here, last = self.h * self.table.integrals([theta])[0], self.h * self.table.A[-1]
        missing = system.difference(self.p0, self.p) - last @ self.U
        p = system.integrate(self.p0, here @ self.U + theta**2 * (3.0 - 2.0 * theta) * missing)
        v = self.v0 + here @ self.W + theta**2 * (self.v - self.v0 - last @ self.W)
        return p, v, Index1(system).acceleration(t, p, v)[1]

    def finished(self, t: float):
        """(p, v, λ) with the multipliers as the user sees them, by the rows that were kept in this step."""
        p, v, lam = self(t)
        return p, v, self.system.full_multipliers(p, lam)


class DenseOutput:
    """The solution at any time of the run.

    Calling it with times of shape (n,) gives (q, v, lam) with shapes (n, nq), (n, nv), (n, nc); a single time gives
    single rows.
    """

    def __init__(self, segments):
        self.segments = tuple(segments)
        first, last = self.segments[0].t_old, self.segments[-1].end
        self.t_min, self.t_max, self._forward = min(first, last), max(first, last), last >= first
        self._ends = np.array([segment.end for segment in self.segments])

    def __call__(self, t):
        times = np.asarray(t, float)
        if not (np.isfinite(times).all() and (times >= self.t_min).all() and (times <= self.t_max).all()):
            raise InputError(f"dense output covers t = {self.t_min:g} to {self.t_max:g} s, asked for {t}")
        rows = [self._at(float(each)) for each in np.atleast_1d(times)]
        columns = tuple(np.array(column) for column in zip(*rows, strict=True))
        return columns if times.ndim else tuple(column[0] for column in columns)

    def _at(self, t):
        sign = 1.0 if self._forward else -1.0
        index = min(int(np.searchsorted(sign * self._ends, sign * t)), len(self.segments) - 1)
        return self.segments[index].finished(t)
