"""The largest value of a result over a run, also between its rows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import InputError

SPREAD = 2000  # points at which a peak is sought between the rows; at least one between two rows
HIGHEST = 3  # points with the largest values around which the search goes on
ROUNDS = 5  # each leaves an eighth of the time around a peak: at last 3e-5 of it, and 1e-9 of the value
POINTS = 17  # in each round


@dataclass(frozen=True)
class Peak:
    """The largest value of a result over a run.

    Attributes
    ----------
    of : str
        The quantity: ``"force"``, ``"moment z"``, ….
    value : float
        The value, N, N·m or in the unit of the result: for vectors their norm; for components and scalars the one of
        largest magnitude, with its sign.
    t : float
        Its time, s.
    between : bool
        Whether it was also searched for between the rows.
    """

    of: str
    value: float
    t: float
    between: bool

    def __str__(self):
        return f"largest {self.of}: {self.value:.6g} at t = {self.t:.6g} s" + ("" if self.between else ", of the rows")


class HasPeaks:
    """Base of frozen results with times ``t``, and arrays with a row for each; `_at` returns one at other times."""

    t: np.ndarray
    _at: Callable[[np.ndarray], Any] | None
    _arrays = ("force", "moment", "torque", "length", "speed")

    def __getstate__(self):
        """Without what finds it at other times."""
        return self.__dict__ | {"_at": None}

    def peak(self, of: str | None = None) -> Peak:
        """The largest value over the run and its time, also between the rows: see :class:`Peak`.

        `of` is one of its arrays, ``"force"`` or ``"moment"``, for the length of the vector, or a component of it,
        ``"force x"``; by default its force, or torque. States between the rows are those of :meth:`Solution.at`; in a
        copy of the result, only rows are compared. Raises InputError for anything else, and for a result without rows.
        """
        known = [name for name in self._arrays if getattr(self, name, None) is not None]
        of = known[0] if of is None and known else str(of)
        values = self._values(of, known)
        if not len(values):
            raise InputError(f"no peak of {of!r}: the result has no rows")
        at, rows = self._at, Sought(self.t, values)
        if at is None or len(self.t) < 2:
            return Peak(of, *rows.best(), between=False)
        return Peak(of, *rows.searched(lambda times: at(times)._values(of, known)).best(), between=True)

    def _values(self, of, known) -> np.ndarray:
        name, _, axis = of.partition(" ")
        found = getattr(self, name) if name in known else None
        width = 0 if found is None or found.ndim == 1 else found.shape[1]
        axes = list("xyz") if width == 3 and name != "torque" else [str(k) for k in range(width)]
        if found is None or (axis and axis not in axes):
            there = ", ".join(known) or "nothing"
            raise InputError(f"no peak of {of!r}: choose from {there}, or a component such as 'force x'")
        if found.ndim == 1:
            return found
        return found[:, axes.index(axis)] if axis else np.linalg.norm(found, axis=1)


class Sought:
    """Points in the order of the run, with values; the best has the largest `rank`, by default the largest size."""

    def __init__(self, t, values, rank=np.abs):
        self.t, self.values, self.rank = t, values, rank

    def best(self) -> tuple[float, float]:
        """The best value and its time."""
        i = int(np.argmax(self.rank(self.values)))
        return float(self.values[i]), float(self.t[i])

    def refined(self, evaluate) -> Sought:
        """The points and more between them, everywhere; `evaluate(times)` returns values."""
        return self._added(range(len(self.t) - 1), max(SPREAD // (len(self.t) - 1), 1), evaluate)

    def searched(self, evaluate) -> Sought:
        """The points and more of them: everywhere, and closer around the best values."""
        coarse = self.refined(evaluate)
        parts = [coarse]
        for place in coarse._highest():
            here = coarse
            for _ in range(ROUNDS):
                place = min(max(place, 1), len(here.t) - 2)
                here = here._cut(place)._added((0, 1), (POINTS - 1) // 2, evaluate)
                place = int(np.argmax(self.rank(here.values)))
            parts.append(here)
        t, values = (np.concatenate(each) for each in zip(*((part.t, part.values) for part in parts), strict=True))
        return Sought(t, values, self.rank)

    def _highest(self) -> list[int]:
        """Points that are no smaller than their neighbours, the largest first."""
        sizes = self.rank(self.values)
        around = np.concatenate(([-np.inf], sizes, [-np.inf]))
        tops = np.flatnonzero((sizes >= around[:-2]) & (sizes >= around[2:]))
        return tops[np.argsort(-sizes[tops], kind="stable")][:HIGHEST].tolist()

    def _cut(self, place) -> Sought:
        part = slice(place - 1, place + 2)
        return Sought(self.t[part], self.values[part], self.rank)

    def _added(self, after, count, evaluate) -> Sought:
        """With `count` points after each of the points `after`; none between the two rows of an event."""
        after = np.array([i for i in after if self.t[i] != self.t[i + 1]], dtype=int)
        if not len(after):
            return self
        shares = np.arange(1, count + 1) / (count + 1)
        times = (self.t[after, None] + shares * (self.t[after + 1] - self.t[after])[:, None]).ravel()
        places = np.repeat(after + 1, count)
        values = np.insert(self.values, places, evaluate(times))
        return Sought(np.insert(self.t, places, times), values, self.rank)
