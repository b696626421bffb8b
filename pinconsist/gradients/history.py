"""The derivatives of the history with which BDF begins.

The history is that of the equations of index 1, y' = g(t, y) with y = [ξ | v], at k+1 equidistant times. Its
derivatives, s' = A s + b, are put through a polynomial of the same degree: s_j = s_0 + h Σ Q_jl (A_l s_l + b_l), which
is exact to one order more than the steps that follow.
"""

from __future__ import annotations

import numpy as np

from ..dae import bdf
from ..dae.charts import chart_matrix, chart_point, table_row
from ..dae.kkt import KKT

NUDGE = 1e-5  # over the size of a coordinate, of differences of second order


def history_table(first, variants, base, s):
    """S of the history `first`, from the derivatives `s`, (P, nx+nv), of the state where it begins, at a fixed time."""
    system = first.system
    n, m, P = first.k + 1, system.nx + system.nv, len(variants)
    nodes = [Node(variants, base, first, first.t_old + j * first.h) for j in range(n)]
    Q, h = _integrals(n), first.h
    start = s.copy()
    start[:, : system.nx] = s[:, : system.nx] @ nodes[0].chart.T
    known = start + h * np.einsum("jl,lpm->jpm", Q[1:], [node.b for node in nodes])
    known += h * Q[1:, 0, None, None] * (start @ nodes[0].A.T)
    matrix = np.eye((n - 1) * m)
    for j in range(1, n):
        for i in range(1, n):
            matrix[(j - 1) * m : j * m, (i - 1) * m : i * m] -= h * Q[j, i] * nodes[i].A
    rows = np.linalg.solve(matrix, known.transpose(0, 2, 1).reshape(-1, P)).reshape(n - 1, m, P).transpose(0, 2, 1)
    rows = np.concatenate((start[None], rows))
    lam = [row @ node.A_lam.T + node.b_lam for row, node in zip(rows, nodes, strict=True)]
    rows = np.concatenate((rows, lam), axis=2)
    S = np.zeros((bdf.ROWS, *rows.shape[1:]))
    S[:n] = np.tensordot(bdf.differences(n - 1), rows[::-1], 1)
    return S


class Node:
    """The equations of index 1 at a time of a history, linear: of s' = A s + b, and s_λ = A_λ s + b_λ."""

    def __init__(self, variants, base, first, t):
        system, index1 = first.system, base.index1(first.system)
        p, v, _ = first(t)
        nx, nv = system.nx, system.nv
        y = table_row(system, first.base, p, v, np.zeros(0))

        def moving(y):
            T = np.eye(nx) if system.vector_like else chart_matrix(system, y[:nx])
            return np.concatenate(
                (T @ y[nx:], *index1.acceleration(t, chart_point(system, first.base, y[:nx]), y[nx:]))
            )

        steps = NUDGE * np.concatenate((np.ones(nx), 1.0 + np.abs(v)))
        both = [(moving(y + e) - moving(y - e)) / (2.0 * step) for e, step in zip(np.diag(steps), steps, strict=True)]
        self.A, self.A_lam = np.split(np.column_stack(both), [nx + nv])
        self.chart = np.eye(nx) if system.vector_like else chart_matrix(system, y[:nx])
        a, _ = index1.acceleration(t, p, v)
        _, _, G, _ = system.evaluate(t, p, v, a)
        kkt = KKT(system.matrices(t, p, v, a)[0], np.array(G), np.array(G).T)
        rates = np.array([self._by(variant, system, kkt, t, p, v, a) for variant in variants])
        self.b, self.b_lam = np.hstack((np.zeros((len(variants), nx)), rates[:, :nv])), rates[:, nv:]

    def _by(self, variant, system, kkt, t, p, v, a):
        if variant.inert:
            return np.zeros(system.nv + system.nc)
        if variant.keeps_rows:
            residuals = [
                (weight, getattr(known, "compiled", known.system)) for weight, known in variant.residuals(system)
            ]
            f = sum(weight * known.evaluate(t, p, v, a)[0] for weight, known in residuals)
            return -kkt.solve(np.concatenate((f, np.zeros(system.nc))))
        return variant.derivative(lambda side: np.concatenate(side.index1(system).acceleration(t, p, v)))


def _integrals(n):
    """Q (n, n): the integral to j of the polynomial through values at 0, 1, …, n-1 is Σ Q_jl value_l."""
    j, powers = np.arange(n)[:, None] / 1.0, np.arange(n)
    return (j ** (powers + 1) / (powers + 1)) @ np.linalg.inv(j**powers)
