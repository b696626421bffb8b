"""The interpolating polynomial of one accepted step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from math import hypot, sqrt

import numpy as np

from ..errors import AssemblyError, PinconsistError, SingularSystemError
from . import bdf
from .charts import chart_point
from .index1 import Index1, NotFiniteError, settled
from .problem import Index3System
from .radau_table import Table, integrals, polynomials
from .tuning import BETWEEN, NEXT_MODE
from .unseen import held_back


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
    that was given another end is solved. If forces are `stiff`, what the projection moves along them is taken back, as
    at the end. Where the polynomials are not accurate between the ends, `halves` has those of two steps of half the
    size.
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
    stiff: bool = False
    halves: tuple[RadauSegment, ...] = ()

    def __call__(self, t: float):
        """(p, v, λ) at a time inside the step."""
        if self.halves:
            return self.halves[int((t - self.halves[1].t_old) * self.h > 0.0)](t)
        system, (p, v) = self.system, self._polynomials(t)
        p, projected, lam = settled(system, t, p, v)
        if not self.stiff:
            return p, projected, lam
        a = polynomials([(t - self.t_old) / self.h], self.table.s + 1)[0] @ self._coefficients[1]
        v = held_back(system, t, p, v, a, projected, self.h)
        return p, v, Index1(system).acceleration(t, p, v)[1]

    def look(self, t: float, with_multipliers: bool):
        """The same without projection; λ is empty if it is not requested."""
        p, v = self._polynomials(t) if t != self.end else (self.p, self.v)
        return p, v, Index1(self.system).acceleration(t, p, v)[1] if with_multipliers else np.zeros(0)

    def _polynomials(self, t):
        theta = (t - self.t_old) / self.h
        here = self.h * integrals([theta], self.table.s + 1)[0]
        (rates, accelerations), (missing, missing_v) = self._coefficients, self._missing
        bend = theta**2 * (3.0 - 2.0 * theta)
        p = self.system.integrate(self.p0, here[:-1] @ rates + bend * missing)
        return p, self.v0 + here @ accelerations + bend * missing_v

    @cached_property
    def _coefficients(self):
        """Of the rates and the accelerations."""
        return self.table.modes @ self.U, self.table.coefficients(self.W, *self.ends)

    @cached_property
    def _missing(self):
        """What their integrals over the step, those of the first modes, lack of ξ and v at the projected end."""
        (rate, *_), (acceleration, *_) = self._coefficients
        moved = self.system.difference(self.p0, self.p)
        return moved - self.h * rate, self.v - self.v0 - self.h * acceleration

    def error_between(self, weight: np.ndarray) -> float:
        """An estimate of the error of v between the ends; `weight` (nv,) has reciprocal tolerances.

        It is the geometric mean of two estimates. That from the decay of the modes is too small with stiff forces, that
        from the defect of the accelerations too large.
        """
        s, system = self.table.s, self.system
        if s < 3:  # such formulas are not more accurate at the end
            return 0.0

        def size(a):
            return abs(self.h) * np.linalg.norm(weight * a) / np.sqrt(system.nv) / (2 * s)

        accelerations = self._coefficients[1]
        *before, low, high = (size(mode) for mode in accelerations[-4:])
        last = hypot(low, high)
        following = last * min(1.0, last / (hypot(*before) + 1e-300))
        if following <= NEXT_MODE * BETWEEN:
            return 0.0
        theta = 0.5 * (self.table.c[s // 2 - 1] + self.table.c[s // 2])  # modes vanish in the middle of the step
        t = self.t_old + theta * self.h
        bend = 6.0 * theta * (1.0 - theta) / self.h * self._missing[1]
        a = Index1(system).acceleration(t, *self(t)[:2])[0]
        return sqrt(following * size(a - polynomials([theta], s + 1)[0] @ accelerations - bend))

    def refined(self, weight: np.ndarray, made: Callable) -> RadauSegment:
        """The same, with its halves if it is not accurate between the ends; ``made(step, a)`` solves a step."""
        middle = self.t_old + 0.5 * self.h
        try:
            if self.error_between(weight) <= BETWEEN:
                return self
            first = made(self.ending_at(middle), self.ends[0])
            second = first and made(self.part(middle, self.end, first.p, first.v), first.ends[1])
        except (AssemblyError, NotFiniteError, SingularSystemError):  # the step itself was accepted
            return self
        return replace(self, halves=(first, replace(second, p=self.p, v=self.v))) if second else self

    def part(self, t_old: float, end: float, p0: np.ndarray, v0: np.ndarray) -> RadauSegment:
        """A step inside this one; its accelerations, from the polynomial, are a guess for Newton."""
        h = end - t_old
        W = self.table.values((t_old - self.t_old + h * self.table.c) / self.h) @ self.W
        return replace(self, t_old=t_old, end=end, h=h, p0=p0, v0=v0, W=W, ends=None, halves=())

    def ending_at(self, t: float) -> RadauSegment:
        """The step with its end at another time."""
        return self.part(self.t_old, t, self.p0, self.v0)


def not_made_again(t) -> PinconsistError:
    """The error of a step that fails when it is repeated up to another time."""
    return PinconsistError(f"the step of Radau IIA could not be repeated up to t = {t:.6g}")
