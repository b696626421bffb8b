"""The complementarity problems of contacts: which push, which part, which stick, and by how much.

Unknowns z with u = A z + b. They belong to blocks, each with its law:

- a *push*: 0 ≤ z ⊥ u ≥ 0, of a normal force (impulse) and the acceleration (velocity) of its gap;
- a *grip*: \\|z\\| ≤ limit, and -u in the normal cone of this disc at z: Coulomb's law of tangential forces. The
  limit is a number, or a multiple of a push.

By sweeps of projected Gauss-Seidel, and then Newton's method on z = projection(z - u / size), which ends at rounding;
where that fails, it starts from the solution of Lemke's method, with friction along a few directions. The computations
are in ``engine/complementarity.hpp``.

References
----------
P. Alart, A. Curnier, Comput. Methods Appl. Mech. Eng. 92 (1991) 353-375. D. Stewart, J. C. Trinkle, Int. J. Numer.
Methods Eng. 39 (1996) 2673-2691.
"""

from typing import NamedTuple

import numpy as np

from . import required


class Push(NamedTuple):
    """The index of a normal force."""

    at: int


class Grip(NamedTuple):
    """The first index of a tangential force, how many it has, and its limit.

    The limit is a number, or ``friction`` times the push with index `of`.
    """

    at: int
    size: int
    limit: float = 0.0
    friction: float = 0.0
    of: int = -1


SHARES = 1e-6  # compliance of pushes that share a load, relative to their own responses
SHARED = 1e-12  # relative change of z at which they are found
TURNS = 6


def solve(A, b, blocks, shared=False):
    """(z, u, residual) of a complementarity problem with matrix `A` (n, n), vector `b` (n,) and its `blocks`.

    The residual is relative to b; it is large where there is no solution, as with friction there may be none. With
    `shared`, pushes that depend on each other have those forces, of many, that equal small compliances give.
    """
    laws = [
        (block.at, 1, True, 0.0, 0.0, -1) if isinstance(block, Push) else (*block[:2], False, *block[2:])
        for block in blocks
    ]
    if not shared:
        z, left = required().complementarity(A, b, laws)
        return z, A @ z + b, float(left)
    compliance = np.zeros(len(b))
    pushes = [block.at for block in blocks if isinstance(block, Push)]
    compliance[pushes] = SHARES * max(np.abs(np.diag(A)).max(initial=0.0), 1e-300)
    stiff = A + np.diag(compliance)
    z = np.zeros(len(b))
    for _ in range(TURNS):  # a proximal point method: the compliances are taken off again
        last = z
        z, left = required().complementarity(stiff, b - compliance * last, laws)
        if np.abs(z - last).max(initial=0.0) <= SHARED * np.abs(z).max(initial=0.0):
            break
    return z, A @ z + b, float(left)
