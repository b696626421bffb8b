"""When the Newton matrix of an earlier step still pays: in large systems, where a new one costs many iterations."""

from __future__ import annotations

from .foresight import REMEMBERED

WORTH = 32  # a new matrix, derivatives and factors, costs as much as nv/WORTH iterations (measured on long chains)
WIDEST = 2.0  # change of c up to which it is kept


class Reuse:
    """Keeps a matrix as long as the step it serves costs less than a step has cost on average since it was made.

    That minimises the cost of a step: it falls as long as another step adds less than the average. Everything is
    counted in iterations, not in seconds, so that runs can be repeated.

    Parameters
    ----------
    nv : int
        Below ``WORTH`` velocities every step gets its own matrix.

    Attributes
    ----------
    possible : bool
        Whether a matrix may serve more than one step.
    """

    def __init__(self, nv: int):
        self.possible, self._price = nv >= WORTH, nv / WORTH
        self._c, self._paused = None, 0
        self._cost, self._steps = 0.0, 0  # since the matrix was made
        self._first = 0.0  # cost of the step that it was made for
        self._iterations, self._kept = 0, False  # of the step being made

    def forget(self) -> None:
        """The next step is not a continuation of the last: make a new matrix."""
        self._c = None

    def pays(self, c) -> bool:
        """Whether the step that now begins, with this c = h/α, should use the matrix that is there."""
        last, self._iterations, self._kept = self._iterations, 0, False
        self._cost += last
        self._steps += 1
        self._paused -= 1
        if self._steps == 1:
            self._first = self._cost
        if not self.possible or self._paused > 0 or self._c is None:
            return False
        if not 1.0 / WIDEST <= c / self._c <= WIDEST:
            return False
        self._kept = last * self._steps <= self._cost
        return self._kept

    def made(self, c) -> None:
        """A new matrix was made."""
        if self._kept:  # the old one was tried in vain, its iterations are lost
            self._cost += self._iterations
            self._iterations, self._kept = 0, False
        if self._cost > self._first * self._steps:  # more than with a new matrix for every step
            self._paused = REMEMBERED
        self._c, self._cost, self._steps = c, self._price, 0

    def iterated(self) -> None:
        """An iteration was made."""
        self._iterations += 1
