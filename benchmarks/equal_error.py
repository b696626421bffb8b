"""Run times at equal error, from runs at several tolerances."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

TARGETS = (1e-3, 1e-4, 1e-6, 1e-8)
"""Errors at which run times are compared."""
COMPARED = {"q": "q", "v": "v", "lam": "λ", "force": "Jᵀλ"}
"""What these errors are of: fields of a Point, and their names in tables."""
NOWHERE = np.nan, (np.nan, np.nan)  # what `_at` returns where no run reaches the error
TINY = 1e-300  # in place of an error of zero, in logarithms


class Equal(NamedTuple):
    """One method where its largest error is the target: medians over the repeats, errors of the first multipliers."""

    time: float  # CPU time, s
    ratio: float  # to that of the method that others are measured against
    core: float  # CPU time without set-up, s
    core_ratio: float
    lam_row: float
    lam_first: float


def at_equal_error(points, target, over, of="q") -> dict:
    """Method → :class:`Equal` or None at one error of q (or another of COMPARED). `over` is the method of ratio 1.

    The error of a method is a falling function of its run time: straight lines in the log-log diagram through its runs.
    Where a longer run has the larger error, as happens by chance between close tolerances, both are replaced by their
    geometric mean (isotonic regression). Where the shortest run is already better it stands as it is.
    """
    runs = {}
    for point in points:
        if point.times and np.isfinite(getattr(point, of)):
            runs.setdefault(point.method, []).append(point)
    reached = {method: [_at(rows, target, of, which) for which in ("times", "cores")] for method, rows in runs.items()}
    (whole, _), (core, _) = reached.get(over, 2 * [NOWHERE])
    return {
        method: Equal(*map(median, (found, found / whole, inner, inner / core)), *firsts) if np.ndim(found) else None
        for method, ((found, firsts), (inner, _)) in reached.items()
    }


def _at(rows, target, of, which):
    """(times of the repeats, first multipliers' errors) where the error reaches `target`, or NOWHERE.

    `which` is "times" or "cores"; runs without such times, or where they are below the clock's noise, are left out.
    """
    timed = [(point, getattr(point, which)) for point in rows]
    blocks = []  # (logarithms of errors and times, of how many runs); the error falls
    for point, times in sorted((pair for pair in timed if min(pair[1], default=0.0) > 0.0), key=lambda p: median(p[1])):
        values = getattr(point, of), point.lam_row, point.lam_first, *times
        blocks.append((np.log(np.maximum(values, TINY)), 1))
        while len(blocks) > 1 and blocks[-1][0][0] >= blocks[-2][0][0]:
            (last, n), (before, m) = blocks.pop(), blocks.pop()
            blocks.append(((m * before + n * last) / (m + n), m + n))
    if not blocks or np.log(target) < blocks[-1][0][0]:
        return NOWHERE
    logs = np.transpose([block for block, _ in reversed(blocks)])
    _, *firsts, times = np.split(np.exp([np.interp(np.log(target), logs[0], each) for each in logs]), (1, 2, 3))
    return times, np.ravel(firsts)


def median(values) -> float:
    """Their median, or not a number where there are none."""
    return float(np.median(values)) if np.size(values) else np.nan
