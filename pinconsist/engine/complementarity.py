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


def contact_laws(elements):
    """The laws of contacts in one mode, in the engine, which says whether forces obey them, and shares them.

    `elements` are (first row, whether it has a gap, number of tangents, static friction, whether it is closed and does
    not slide, whether it sticks).
    """
    return required().ContactLaws(elements)


def solve(A, b, blocks, shared=False):
    """(z, u, residual) of a complementarity problem with matrix `A` (n, n), vector `b` (n,) and its `blocks`.

    The residual is relative to b; it is large where there is no solution, as with friction there may be none. With
    `shared`, unknowns that depend on each other have those forces, of many, that equal small compliances give.
    """
    laws = [
        (block.at, 1, True, 0.0, 0.0, -1) if isinstance(block, Push) else (*block[:2], False, *block[2:])
        for block in blocks
    ]
    z, left = required().complementarity(A, b, laws, shared)
    return z, A @ z + b, float(left)
