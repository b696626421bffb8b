"""Closed configurations along a way of a few coordinates, within one assembly mode.

The coordinates y are as many velocity columns as the loops leave free; the others, p, follow. Each step is predicted
along the tangent, δp = -B⁻¹ J_y δy with B = J_p, and closed by Newton's method in p. It is accepted where the
prediction is good, Newton's corrections shrink at once, and det B keeps its sign: this vanishes in the singular
positions, at which assembly modes meet, and only there. In C++: ``_core/closure.hpp``.
"""

import numpy as np
from scipy.linalg import LinAlgError, lu_factor, lu_solve

LONGEST = 0.6  # rad, or lengths of the mechanism, that a joint moves in a step
SHORTEST = 1e-8  # of the coordinates; a step that would have to be shorter is blocked, unless it leads away
OUTWARD = 1e-4  # of that: the shortest step away from a singular position
MISS = 0.25  # of the step, by which the prediction may be corrected
SHRINK = 0.25  # of a correction, to which the next one must shrink
AIM = 0.5  # of that miss, for the next step
LEAST, FURTHER = 0.1, 4.0  # of a step, for the next one
ENOUGH = 3e-9  # rad, or lengths: Newton's error after such a correction is rounding
MOST = 8  # corrections
TRIES = 400  # steps; ways that need more run along a singular position
NUMBERS = (LONGEST, SHORTEST, MISS, SHRINK, AIM, LEAST, FURTHER, ENOUGH, MOST)


class Follower:
    """The way of a mechanism's configurations with some coordinates.

    `rows` is a function q → (Φ, J) of independent rows, `integrate` one of (q, δq), `sizes` (nv,) what counts as one
    radian. There are as many rows as velocities that are no coordinates.
    """

    def __init__(self, rows, integrate, coordinates, sizes):
        self._rows, self._integrate, self._sizes = rows, integrate, sizes
        self._y = np.array(coordinates, dtype=int)
        self._p = np.setdiff1d(np.arange(len(sizes)), self._y)

    def follow(self, q, way):
        """(configuration, share of `way` that was made) from a closed `q`, for increments of the coordinates."""
        here = self._factors(self._rows(q)[1])
        length, share, part = np.max(np.abs(way) / self._sizes[self._y], initial=0.0), 0.0, 1.0
        for _ in range(TRIES if here is not None else 0):
            if share == 1.0:
                break
            is_short = part < 1.0 and part * length < SHORTEST  # made so, not the way or its rest
            last = part >= 1.0 - share
            part = min(part, 1.0 - share)
            found, longer = self._step(q, here, part * way, is_short)
            if found is not None:
                (q, here), share = found, 1.0 if last else share + part
            elif part * length < OUTWARD * SHORTEST:
                break
            part *= longer
        return q, share

    def _factors(self, J):
        """J_y, factors of B, the sign and the logarithm of its determinant; None where it is singular."""
        B = J[:, self._p]
        try:
            lu, pivots = lu_factor(B, check_finite=False)
        except (LinAlgError, ValueError):
            return None
        diagonal = np.diagonal(lu)
        if not np.isfinite(lu).all() or (diagonal == 0.0).any():
            return None
        odd = np.count_nonzero(diagonal < 0.0) + np.count_nonzero(pivots != np.arange(len(pivots)))
        return J[:, self._y], (lu, pivots), odd % 2, np.sum(np.log(np.abs(diagonal)))

    def _moved(self, q, of_p, of_y=0.0):
        change = np.zeros(len(self._sizes))
        change[self._p], change[self._y] = of_p, of_y
        return self._integrate(q, change), np.max(np.abs(change) / self._sizes, initial=0.0)

    def _step(self, q, here, move, is_short):
        """((configuration, its factors) or None, by how much longer the next step may be)."""
        J_y, lu, sign, size_of_B = here
        q, size = self._moved(q, -lu_solve(lu, J_y @ move, check_finite=False), move)
        if not size <= LONGEST:
            return None, max(LEAST, LONGEST / size)
        longer, last = 0.5, 0.0
        for i in range(MOST):
            phi, J = self._rows(q)
            there = self._factors(J)
            if there is None:
                return None, 0.5
            q, correction = self._moved(q, -lu_solve(there[1], phi, check_finite=False))
            if i == 0:  # the miss is of second order
                longer = np.clip(AIM * MISS * size / max(correction, ENOUGH), LEAST, FURTHER)
            if not (correction <= ENOUGH or correction <= (MISS * size if i == 0 else SHRINK * last)):
                return None, min(longer, 0.5)
            if correction <= ENOUGH:
                crossed = there[2] != sign or (is_short and there[3] < size_of_B)
                return (None, 0.5) if crossed else ((q, there), max(longer, 1.0))
            last = correction
        return None, 0.5
