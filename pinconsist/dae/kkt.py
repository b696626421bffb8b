"""The block matrix of a step and of the index-1 equations."""

import numpy as np
from scipy.linalg.lapack import dgetrf, dgetrs

from ..errors import SingularSystemError


class KKT:
    """The factorised matrix

        K = [ A  -c G ]
            [ W    0  ]

    with A = M + c ∂f/∂v + c² ∂f/∂p in a Newton step, and A = M, c = 1 in the index-1 equations. Shapes: A (nv, nv),
    G (nv, nc), W (nc, nv). If ``singular``, a pivot is exactly zero, and :meth:`solve` must not be used.
    """

    def __init__(self, A, G, W, c: float = 1.0):
        nv, nc = G.shape
        K = np.zeros((nv + nc, nv + nc), order="F")
        K[:nv, :nv] = A
        K[:nv, nv:] = -c * G
        K[nv:, :nv] = W
        self._lu, self._pivots, info = dgetrf(K, overwrite_a=True)
        self.singular = info != 0

    def solve(self, rhs):
        """K⁻¹ rhs, for `rhs` of shape (nv+nc,) or (nv+nc, columns)."""
        return dgetrs(self._lu, self._pivots, rhs)[0]

    def solve_transposed(self, rhs):
        """K⁻ᵀ rhs, for `rhs` of shape (nv+nc,)."""
        return dgetrs(self._lu, self._pivots, rhs, trans=1)[0]


def singular_message(t) -> str:
    """The message about a singular position."""
    return f"the equations of motion are singular at t = {t:.6g} ([[M, -G], [W, 0]])"


def kkt_at(system, t, p, v):
    """(K, f₀, G, W) of the index-1 equations at a state, c = 1 and A = M; raises SingularSystemError."""
    zero_v, zero_c = np.zeros(system.nv), np.zeros(system.nc)
    f0, _, G, _ = system.evaluate(t, p, v, zero_v)
    M = np.empty((system.nv, system.nv))
    W = system.linearize(t, p, v, zero_v, zero_c, 0.0, M)
    kkt = KKT(M, G, W)
    if kkt.singular:
        raise SingularSystemError(singular_message(t))
    return kkt, f0, G, W
