"""The interpolating polynomial of one accepted step."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..errors import PinconsistError
from . import bdf
from .charts import chart_point
from .index1 import Index1, settled
from .kkt import KKT
from .problem import Index3System
from .radau_table import Table, integrals, polynomials
from .tuning import STIFF


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

    def __call__(self, t: float):
        """(p, v, λ) at a time inside the step."""
        y = bdf.interpolate(self.k, (t - self.t) / self.h).dot(self.Z[: self.k + 1])
        nx, nv = self.system.nx, self.system.nv
        return chart_point(self.system, self.base, y[:nx]), y[nx : nx + nv], y[nx + nv :]


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
    U: np.ndarray | None  # None where only its end is needed
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


def held_back(system, t, p, v, a, projected, h):
    """The projected velocity without the part of the projection that is along stiff forces, as in _core/unstirred.hpp.

    (p, v) is the state before the projection, `a` its acceleration, `h` the size of the step.
    """
    _, _, G, _ = system.evaluate(t, p, v, a)
    M, stiff = _parts(system.matrices(t, p, v, a), h / STIFF)
    return _without(M, stiff, G, system.velocity_jacobian(t, p, v, G), projected, projected - v)


def _along(kkt, stiff, nc, x):
    """What stiff forces do to the velocities after a change by `x`."""
    return kkt.solve(np.concatenate((stiff @ x, np.zeros(nc))))[: len(x)]


def _without(M, stiff, G, W, v, moved):
    """The velocity `v` without what stiff forces hold back of its change by `moved`."""
    within = KKT(M + stiff, G, W)
    return v if within.singular else v - _along(within, stiff, len(W), _along(within, stiff, len(W), moved))


def _parts(matrices, c):
    """(M, c D + c² K); their sum is the A of :class:`~pinconsist.dae.kkt.KKT`."""
    M, D, K = matrices
    return M, c * D + c**2 * K
