"""What the last steps promise for the next one, so that nothing is evaluated that cannot matter."""

from __future__ import annotations

from math import sqrt

REMEMBERED = 20  # steps for which a measurement is believed
CLOSED = 1e-15  # relative to the positions: gap that may stay open
HIDDEN = 7.0  # of Newton's tolerance: hidden residual that may stay; multipliers begin to feel it at 20
ROUNDING = 2e-12  # relative to the velocities: a hidden residual below this is always taken out


class Foresight:
    """Remembers how Newton's iteration contracted, and what closing the loops a second time changed.

    With c = h/α and s the weighted size of the first increment: the increment after it is taken to be a multiple of
    c² s, the gap that it leaves in the loops of (c s)², the hidden residual of c s.
    """

    def __init__(self):
        self._contraction, self._trusted = 1.0, 0
        self._gap, self._hidden, self._least, self._looks = 0.0, 0.0, 0.0, 0

    def forget(self) -> None:
        """A step was rejected, or the run begins anew: believe nothing."""
        self._trusted = self._looks = 0

    def one_is_enough(self, size, c, tol) -> bool:
        """Whether the first increment was the last that counts."""
        self._trusted -= 1
        return self._trusted >= 0 and self._contraction * c**2 * size <= tol

    def measured(self, rate, c) -> None:
        """Two iterations were made, and the second increment was `rate` times the first."""
        self._contraction, self._trusted = max(rate / c**2, 0.3 * self._contraction), REMEMBERED

    def stays_closed(self, size, c, tol) -> bool:
        """Whether loops and hidden constraint need no second look."""
        self._looks -= 1
        moved, allowed = abs(c) * size, HIDDEN * tol
        foreseen = self._looks >= 0 and allowed >= self._least
        return foreseen and self._gap * moved**2 <= CLOSED and self._hidden * moved <= allowed

    def closing_rate(self, size, c, moved) -> float:
        """Part of the gap of the last look that a correction leaves whose Jacobian is that of the prediction.

        A gap is half of what the Jacobian changes by on the way, times the way: `moved`, m or rad, of weighted `size`.
        """
        return min(1.0, 2.0 * self._gap * (c * size) ** 2 / moved) if moved else 0.0

    def looked(self, gap, shift, v, size, c) -> None:
        """A second look found this gap, relative to the positions, and shifted the velocities `v`; both weighted."""
        moved = abs(c) * size or 1.0
        self._gap, self._hidden, self._looks = gap / moved**2, sqrt(shift.dot(shift) / len(v)) / moved, REMEMBERED
        self._least = ROUNDING * sqrt(v.dot(v) / len(v))
