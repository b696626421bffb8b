"""The interpolating polynomial of one accepted step."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..errors import PinconsistError
from . import bdf
from .charts import chart_point
from .index1 import Index1, settled
from .problem import Index3System
from .radau_table import Table, integrals


@dataclass(frozen=True)
class Segment:
    """The polynomial of degree k over one step from `t_old` to `end`, in [ξ | v | λ], exact at both of its ends.

    Positions on a manifold are interpolated in the chart at `base`, so they stay on it; loops are closed in between
    to the order of the method. `changes` maps the table of the previous step to this step's size, including rejected
    tries; None at the start of a run, with k+1 points.
    """

    t_old: float
    end: float
    t: float
    h: float
    k: int
    base: np.ndarray
    Z: np.ndarray
    changes: np.ndarray | None
    system: Index3System

    def __call__(self, t: float):
        """(p, v, λ) at a time inside the step."""
        y = bdf.interpolate(self.k, (t - self.t) / self.h).dot(self.Z[: self.k + 1])
        nx, nv = self.system.nx, self.system.nv
        return chart_point(self.system, self.base, y[:nx]), y[nx : nx + nv], y[nx + nv :]

    def look(self, t: float, with_multipliers: bool):
        """The same, for events."""
        return self(t)


@dataclass(frozen=True)
class RadauSegment:
    """The polynomials of a step from (p0, v0), bent to its projected end (p, v); λ by the index-1 equations.

    Between the ends it is projected onto both constraints, which removes most of its error. Events use it without
    projection; the step is repeated up to an event that is found. `W` and `U` have the accelerations and the rates of ξ
    at the stages of the formula `table`, a row for each, and `ends` the accelerations at both ends, None until a step
    that was given another end is solved.
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
    ends: tuple[np.ndarray, np.ndarray] | None = None

    def __call__(self, t: float):
        """(p, v, λ) at a time inside the step."""
        return settled(self.system, t, *self._polynomials(t))

    def look(self, t: float, with_multipliers: bool):
        """The same without projection; λ is None if it is not requested."""
        p, v = self._polynomials(t) if t != self.end else (self.p, self.v)
        return p, v, Index1(self.system).acceleration(t, p, v)[1] if with_multipliers else None

    def _polynomials(self, t):
        n, theta = self.table.s + 1, (t - self.t_old) / self.h
        here, whole = self.h * integrals([theta, 1.0], n)
        rates, accelerations = self._coefficients
        missing = self.system.difference(self.p0, self.p) - whole[:-1] @ rates
        missing_v = self.v - self.v0 - whole @ accelerations
        bend = theta**2 * (3.0 - 2.0 * theta)
        p = self.system.integrate(self.p0, here[:-1] @ rates + bend * missing)
        return p, self.v0 + here @ accelerations + bend * missing_v

    @cached_property
    def _coefficients(self):
        """Of the rates and the accelerations."""
        return self.table.modes @ self.U, self.table.coefficients(self.W, *self.ends)

    def ending_at(self, t: float) -> RadauSegment:
        """The step with its end at another time; its accelerations, from the polynomial, are a guess for Newton."""
        h = t - self.t_old
        W = self.table.values(h / self.h * self.table.c) @ self.W
        return replace(self, end=t, h=h, W=W, ends=None)


def not_made_again(t) -> PinconsistError:
    """The error of a step that fails when it is repeated up to another time."""
    return PinconsistError(f"the step of Radau IIA could not be repeated up to t = {t:.6g}")
