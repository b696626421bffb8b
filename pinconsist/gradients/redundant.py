"""Derivatives of the multipliers of redundant rows.

Those of all rows are x = Π y: y has the multipliers that the run keeps, and zeros, and Π = J J⁺ projects onto the
columns of J of all rows, whose rank r does not change. With z = J⁺ y and u = (1 - Π) y

    dx = Π dy + (1 - Π) dJ z + J⁺ᵀ dJᵀ u

for any motion that keeps the rank, that is, on the loops. Where the parts of dJ by state and parameter lead off the
loops, only their sum has a meaning.
"""

import numpy as np

from ..mechanism.motion import slope

NUDGE = 1e-3  # rad or m, of differences of fourth order


class Completion:
    """The multipliers of all rows at a configuration, from the kept ones `lam`, for derivatives forwards and back."""

    def __init__(self, base, system, q, lam):
        self._base, self._system, self._q = base, system, q
        self._steady = np.flatnonzero(system.rows.steady)
        self._lam = self._spread(lam)
        rank = int(np.isin(system.kept, self._steady).sum())
        U, sizes, Vt = np.linalg.svd(self._jacobian(base, q), full_matrices=False)
        self._range, self._inverse = U[:, :rank], Vt[:rank].T / sizes[:rank] @ U[:, :rank].T
        y = self._lam[self._steady]
        self._z, self._u = self._inverse @ y, y - self._projected(y)

    def forward(self, variant, s_q, s_lam):
        """Derivatives of all multipliers, from those of the configuration and of the kept ones."""
        change = self._spread(s_lam)
        size = np.abs(s_q).max(initial=0.0)
        dJ = 0.0 if size == 0.0 else self._along(s_q * NUDGE / size) * (size / NUDGE)
        if not variant.keeps_rows:
            dJ = dJ + variant.derivative(lambda side: self._jacobian(side, self._q))
        dJ = dJ + np.zeros((len(self._steady), self._system.nx))
        across = dJ @ self._z
        y = self._projected(change[self._steady]) + across - self._projected(across)
        change[self._steady] = y + self._inverse.T @ (dJ.T @ self._u)
        return change

    def backward(self, variants, bar):
        """The transpose: derivatives by configuration, (nx,), by kept multipliers, and by the parameters."""
        of_steady, kept = bar[self._steady], bar.copy()
        kept[self._steady] = self._projected(of_steady)
        weights = np.outer(of_steady - self._projected(of_steady), self._z)
        weights += np.outer(self._u, self._inverse @ of_steady)
        of_q = [np.sum(weights * self._along(NUDGE * unit)) / NUDGE for unit in np.eye(self._system.nx)]
        own = np.zeros(len(variants))
        for i, variant in variants.moved.items():
            if not variant.inert:
                own[i] = np.sum(weights * variant.derivative(lambda side: self._jacobian(side, self._q)))
        return np.array(of_q), kept[self._system.kept], own

    def _spread(self, lam):
        full = np.zeros(self._system.n_multipliers)
        full[self._system.kept] = lam
        return full

    def _projected(self, y):
        return self._range @ (self._range.T @ y)

    def _along(self, way):
        return slope(lambda e: self._jacobian(self._base, self._system.integrate(self._q, e * way)))

    def _jacobian(self, side, q):
        return side.jacobian(self._system, q)[self._steady]
