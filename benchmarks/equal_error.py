"""What methods need, and how good their first multipliers are, where their errors are the same."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np


class Equal(NamedTuple):
    """One method where its largest error in q is the one asked for.

    Attributes
    ----------
    time, ratio : float
        CPU time, s, and how many times that of the method it is compared with; medians over the repeats.
    lam_row, lam_first : float
        Errors of the multipliers in the first row, and at the first step by the method itself.
    """

    time: float
    ratio: float
    lam_row: float
    lam_first: float


def at_equal_error(points, target, own) -> dict:
    """Each method at one error in q, by straight lines between its points in log-log diagrams.

    Parameters
    ----------
    points : sequence of Point
        From coarse to fine.
    target : float
        Error in q, rad and m; where the coarsest run is already better it stands as it is.
    own : str
        The method whose time is 1.

    Returns
    -------
    dict
        Method → Equal, or None where no run reached the target.
    """
    runs = {}
    for point in points:
        if point.times and np.isfinite(point.q):
            runs.setdefault(point.method, []).append(point)
    reached = {method: _at(rows, target) for method, rows in runs.items()}
    reference = reached.get(own)
    found = {}
    for method, values in reached.items():
        if values is None:
            found[method] = None
            continue
        times, (lam_row, lam_first) = values
        ratio = float(np.median(times / reference[0])) if reference is not None else np.nan
        found[method] = Equal(float(np.median(times)), ratio, float(lam_row), float(lam_first))
    return found


def _at(rows, target):
    """(times of the repeats, first multipliers' errors) where the error reaches `target`, or None."""

    def values(point):
        return np.array(point.times), np.array((point.lam_row, point.lam_first))

    for before, after in pairwise(rows):
        if after.q <= target <= before.q:
            part = np.log(before.q / target) / np.log(before.q / after.q)
            return tuple(a ** (1.0 - part) * b**part for a, b in zip(values(before), values(after), strict=True))
    return values(rows[0]) if rows and rows[0].q <= target else None
