"""The derivatives of the history with which BDF begins.

The history is that of the equations of index 1, y' = g(t, y) with y = [ξ | v], at k+1 equidistant times. Its
derivatives, s' = A s + b, are put through a polynomial of the same degree: s_j = s_0 + h Σ Q_jl (A_l s_l + b_l), which
is exact to one order more than the steps that follow.
"""

import numpy as np

from .._core.compiled_gradient import known_columns
from ..dae import bdf
from ..dae.charts import chart_matrix, chart_rate_gradient
from ..dae.kkt import KKT
from .stage_leg import way_along


class History:
    """The history `first`, a polynomial, and its derivatives forwards and back."""

    def __init__(self, first, variants, base):
        self.first, self.nx, self.size = first, first.system.nx, first.system.nx + first.system.nv
        n, m, h = first.k + 1, self.size, first.h
        index1 = base.index1(first.system)
        way = way_along(index1, [])
        known = known_columns(index1, variants.residuals(first.system))
        self.nodes = [Node(variants, known, first, way, first.t_old + j * h) for j in range(n)]
        self.Q = _integrals(n)
        self.matrix = np.eye((n - 1) * m)
        for j in range(1, n):
            for i in range(1, n):
                self.matrix[(j - 1) * m : j * m, (i - 1) * m : i * m] -= h * self.Q[j, i] * self.nodes[i].A

    def table(self, s):
        """S, from the derivatives `s`, (P, nx+nv), of the state where the history begins, at a fixed time."""
        nodes, Q, h, n = self.nodes, self.Q, self.first.h, len(self.nodes)
        start, b = s.copy(), [node.forward() for node in nodes]
        start[:, : self.nx] = s[:, : self.nx] @ nodes[0].chart.T
        known = start + h * np.einsum("jl,lpm->jpm", Q[1:], [of_y for of_y, _ in b])
        known += h * Q[1:, 0, None, None] * (start @ nodes[0].A.T)
        rows = np.linalg.solve(self.matrix, known.transpose(0, 2, 1).reshape(-1, len(s)))
        rows = np.concatenate((start[None], rows.reshape(n - 1, -1, len(s)).transpose(0, 2, 1)))
        lam = [row @ node.A_lam.T + of_lam for row, node, (_, of_lam) in zip(rows, nodes, b, strict=True)]
        rows = np.concatenate((rows, lam), axis=2)
        S = np.zeros((bdf.ROWS, *rows.shape[1:]))
        S[:n] = np.tensordot(bdf.differences(n - 1), rows[::-1], 1)
        return S

    def back(self, seeds):
        """The derivatives of a number by `s`, (nx+nv,), and by the parameters, (P,), from those by S: the transpose."""
        nodes, Q, h, n = self.nodes, self.Q, self.first.h, len(self.nodes)
        rows, lam = np.split((bdf.differences(n - 1).T @ seeds[:n])[::-1], [self.size], axis=1)
        rows = rows + [node.A_lam.T @ own for node, own in zip(nodes, lam, strict=True)]
        known = np.linalg.solve(self.matrix.T, rows[1:].ravel()).reshape(n - 1, -1)
        start = rows[0] + known.sum(axis=0) + h * nodes[0].A.T @ (Q[1:, 0] @ known)
        start[: self.nx] = nodes[0].chart.T @ start[: self.nx]
        return start, sum(map(Node.backward, nodes, h * Q[1:].T @ known, lam))


class Node:
    """The equations of index 1 at a time of a history, linear: s' = A s + b, and s_λ = A_λ s + b_λ."""

    def __init__(self, variants, known, first, way, t):
        system = first.system
        p, v, _ = first(t)
        nx, nv = system.nx, system.nv
        a, _, by = way.linear(t, p, v)
        self.chart, turned = np.eye(nx), np.zeros((nx, nx))
        if not system.vector_like:
            xi = system.difference(first.base, p)
            self.chart, turned = chart_matrix(system, xi), chart_rate_gradient(system, xi, v)
        by[:, :nx] = by[:, :nx] @ np.linalg.inv(self.chart)
        self.A, self.A_lam = np.split(np.vstack((np.hstack((turned, self.chart)), by)), [nx + nv])
        _, _, G, _ = system.evaluate(t, p, v, a)
        self._kkt = KKT(system.matrices(t, p, v, a)[0], np.array(G), np.array(G).T)
        self._known, self._still = known(t, p, v, a), np.zeros((len(variants), nx))
        self._beside = {
            i: variant.derivative(lambda side: np.concatenate(side.index1(system).acceleration(t, p, v)))
            for i, variant in variants.moved.items()
            if not variant.inert
        }

    def forward(self):
        """(b, b_λ), (P, ·) each."""
        nv = self._known.shape[1]
        rates = -self._kkt.solve(np.hstack((self._known, np.zeros((len(self._known), len(self.A_lam))))).T).T
        for i, rate in self._beside.items():
            rates[i] = rate
        return np.hstack((self._still, rates[:, :nv])), rates[:, nv:]

    def backward(self, of_b, of_lam):
        """The transpose, (P,)."""
        nv = self._known.shape[1]
        weights = np.concatenate((of_b[-nv:], of_lam))
        rates = -self._known @ self._kkt.solve_transposed(weights)[:nv]
        for i, rate in self._beside.items():
            rates[i] = rate @ weights
        return rates


def _integrals(n):
    """Q (n, n): the integral to j of the polynomial through values at 0, 1, …, n-1 is Σ Q_jl value_l."""
    j, powers = np.arange(n)[:, None] / 1.0, np.arange(n)
    return (j ** (powers + 1) / (powers + 1)) @ np.linalg.inv(j**powers)
