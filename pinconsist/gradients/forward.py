"""The recursion of sensitivities over the accepted steps of a run.

A table S holds the differences of s = [s_ξ | s_v | s_λ] as the run's table holds those of [ξ | v | λ], one for each
parameter: shape (ROWS, P, nx+nv+nc). Prediction, change of step and update are linear, hence the same for S.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..dae import bdf
from ..dae.charts import chart_matrix
from ..dae.dense import Segment, Tables
from .linear import Step


@dataclass
class Leg:
    """The steps of a run from one start to the next: arrays with an entry for each step, as in ``dae.dense.Tables``.

    `start` is the polynomial of the history. `tables`, (1+n, ROWS, P, nx+nv+nc), are those of S after the history and
    after each step.
    """

    start: Segment
    ends: np.ndarray
    t: np.ndarray
    h: np.ndarray
    k: np.ndarray
    base: np.ndarray
    Z: np.ndarray
    changes: np.ndarray
    tables: Any = None

    @property
    def system(self):
        """The system, with the constraint rows that were kept in these steps."""
        return self.start.system

    @property
    def span(self):
        """(from, to), s."""
        return self.start.t_old, float(self.ends[-1]) if len(self.ends) else self.start.end

    def step_at(self, t, sign):
        """(start, size) of the step that holds a time."""
        ends = np.concatenate(([self.start.end], self.ends))
        i = min(int(np.searchsorted(sign * ends, sign * t)), len(ends) - 1)
        return (float(ends[i - 1]), float(self.h[i - 1])) if i else (self.start.t_old, self.start.h)

    def curve(self):
        """t, h, k, chart centre and table of all, the history first."""
        first = self.start
        pairs = ("t", first.t), ("h", first.h), ("k", first.k), ("base", first.base), ("Z", first.Z)
        return [np.concatenate(([value], getattr(self, name))) for name, value in pairs]

    def at(self, times, sign):
        """(p, a, ds): p (n, npos), ẏ of [ξ | v | λ] and S interpolated, (n, P, nx+nv+nc), tangent at p."""
        t, h, k, base, Z = self.curve()
        ends = np.concatenate(([self.start.end], self.ends))
        i = np.minimum(np.searchsorted(sign * ends, sign * times), len(ends) - 1)
        basis = bdf.interpolate(highest := int(k.max()), (times - t[i]) / h[i])
        basis[np.arange(highest + 1) > k[i, None]] = 0.0
        y = np.einsum("nj,njy->ny", basis, Z[i, : highest + 1])
        s = np.einsum("nj,njpy->npy", basis, self.tables[i, : highest + 1])
        nx = self.system.nx
        if self.system.vector_like:
            return y[:, :nx], y, s
        for row, xi in enumerate(y[:, :nx]):
            s[row, :, :nx] = np.linalg.solve(chart_matrix(self.system, xi), s[row, :, :nx].T).T
        return np.array([self.system.integrate(*pair) for pair in zip(base[i], y[:, :nx], strict=True)]), y, s


def legs_of(dense) -> list[Leg]:
    """The legs of a run from its dense output."""
    legs: list[tuple] = []
    for curve in dense.curves:
        if not isinstance(curve, Tables):
            segments = [curve.segment(i) for i in range(len(curve.ends))]
            columns = zip(*((s.end, s.t, s.h, s.k, s.base, s.Z) for s in segments), strict=True)
            arrays = [*map(np.array, columns), np.full(len(segments), None)]
            for i, segment in enumerate(segments):
                arrays[-1][i] = segment.changes
        else:
            arrays = [curve.ends, curve.t, curve.h, curve.k, curve.base, curve.Z, curve.changes]
        begun = [i for i, changes in enumerate(arrays[-1]) if changes is None]
        ends = [*begun, len(arrays[-1])]
        if ends[0]:  # goes on from the curve before
            legs[-1][1].append([array[: ends[0]] for array in arrays])
        for i, end in zip(begun, ends[1:], strict=True):
            legs.append((curve.segment(i), [[array[i + 1 : end] for array in arrays]]))
    return [Leg(start, *map(np.concatenate, zip(*parts, strict=True))) for start, parts in legs]


def follow(leg, residuals, S) -> None:
    """Fill the leg's `tables` from `S` of its history; `residuals` as in :class:`Step`."""
    system, start = leg.system, leg.start
    leg.tables = np.empty((1 + len(leg.t), *S.shape))
    leg.tables[0] = S
    base, Z = start.base, start.Z
    for i, (t, h, k) in enumerate(zip(leg.t, leg.h, leg.k, strict=True)):
        S = np.tensordot(leg.changes[i], S, 1)
        if not system.vector_like:
            recenter(system, base, leg.base[i], leg.changes[i] @ Z, S, k + 2)
        base, Z = leg.base[i], leg.Z[i]
        predicted, psi = np.tensordot(bdf.predictor(k), S[: k + 1], 1)
        S[k + 2] = Step(system, t, h, k, base, Z, residuals).forward(psi) - predicted
        S = np.tensordot(bdf.advance(k), S, 1)
        leg.tables[i + 1] = S


def recenter(system, base, new_base, Z, S, rows) -> None:
    """Carry S from the chart at `base`, where the run's table is `Z`, to that at `new_base`; in place."""
    D, nx = bdf.differences(rows - 1), system.nx
    past = np.tensordot(D, S[:rows, :, :nx], 1)
    for xi, s in zip(D @ Z[:rows, :nx], past, strict=True):
        there = system.difference(new_base, system.integrate(base, xi))
        s[:] = s @ (chart_matrix(system, there) @ np.linalg.inv(chart_matrix(system, xi))).T
    S[:rows, :, :nx] = np.tensordot(D, past, 1)
