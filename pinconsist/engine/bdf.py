"""BDF on backward differences: tables, and the polynomials through them; the steps are in ``engine/bdf.hpp``.

A table ``Z`` holds ∇⁰y, ∇¹y, ..., ∇ᵏ⁺²y of y = [ξ | v | λ] as rows, ξ being the position in a chart. With
``c = h/α_k`` a step solves

    ξ_{n+1} = ψ_ξ + c U,    v_{n+1} = ψ_v + c v',    (ψ = Σ_j (1 - γ_j/α_k) ∇ʲy_n,  γ_j = Σ_{i≤j} 1/i)

and predicts y_{n+1} = Σ_{j≤k} ∇ʲy_n; α_k = γ_k. (Klopfenstein's and Shampine's NDF constants were tried and gain
nothing here: they do not change order 5, which does nearly all the work.)

References
----------
L. F. Shampine, M. W. Reichelt, The MATLAB ODE suite, SIAM J. Sci. Comput. 18 (1997), section 2.
"""

import numpy as np

MAX_ORDER = 6
ROWS = MAX_ORDER + 3  # of a table: ∇⁰y to ∇ᵏ⁺²y, and zeros


def interpolate(k: int, s) -> np.ndarray:
    """(..., k+1): Newton basis at t_n + s h, s ≤ 0 in the past; its product with Z[:k+1] interpolates."""
    s = np.asarray(s, float)
    basis = np.ones((*s.shape, k + 1))
    for j in range(1, k + 1):
        basis[..., j] = basis[..., j - 1] * (s + j - 1) / j
    return basis
