"""Singular positions that a motion passes: the loops lose rank there for a moment, and branches of the motion meet."""

import numpy as np

from .lie import difference, integrate
from .rank import ROUNDED_ROWS

RANK_SAMPLES = 200  # positions at which the rank is measured at least
DISTURBANCE = 1e-3  # of the largest of the run: disturbances of a thousandth decide the branch
MAX_MINIMA = 20  # minima that are searched for
PARTS_OF_INTERVAL = 8  # parts of an interval in which a minimum is searched for


def branch_times(system, t, q) -> tuple[float, ...]:
    """The times, s, at which a motion passes positions of a MechanismSystem where branches meet.

    `q`, (n, nq), are its positions at the times `t`. The measure is the smallest singular value of the Jacobian of all
    rows, of those that are not zero by redundancy.
    """
    distinct = np.append(True, np.diff(t) != 0.0)
    t, q = t[distinct], q[distinct]
    if not system.nc or len(t) < 3:
        return ()
    some = np.unique(np.linspace(0, len(t) - 1, RANK_SAMPLES + 1).astype(int))
    sizes, strongest = np.array([_independence(system, t[i], q[i]) for i in some]).T
    largest = sizes.max()
    if not largest > ROUNDED_ROWS * strongest.max():
        return ()
    lows = [k for k in range(1, len(some) - 1) if sizes[k - 1] > sizes[k] <= sizes[k + 1]]
    found = []
    for k in sorted(lows, key=lambda k: sizes[k])[:MAX_MINIMA]:
        time, size = _lowest(system, t, q, some[k - 1], some[k + 1])
        if size < DISTURBANCE * largest:
            found.append(time)
    return tuple(sorted(found))


def _independence(system, t, q) -> tuple[float, float]:
    """The smallest singular value of the independent rows, and the largest of all."""
    values = np.linalg.svd(system.loop_rows(q, t)[1] / system.scales[:, None], compute_uv=False)
    return values[system.nc - 1], values[0]


def _lowest(system, t, q, low, high) -> tuple[float, float]:
    """Time and size of the smallest value between two rows."""
    from scipy.optimize import minimize_scalar

    while high - low > 2:
        some = np.unique(np.linspace(low, high, PARTS_OF_INTERVAL + 1).astype(int))
        k = 1 + np.argmin([_independence(system, t[i], q[i])[0] for i in some[1:-1]])
        low, high = some[k - 1], some[k + 1]
    i = low + 1
    before, after = (difference(system.model, q[i], q[j]) for j in (low, high))
    h0, h1 = t[i] - t[low], t[high] - t[i]

    def size(s):  # along the parabola through three positions
        turn = before * s * (s - h1) / (h0 * (h0 + h1)) + after * s * (s + h0) / (h1 * (h0 + h1))
        return _independence(system, t[i] + s, integrate(system.model, q[i], turn))[0]

    found = minimize_scalar(size, bounds=sorted((-h0, h1)), method="bounded", options={"xatol": 1e-7 * abs(h0 + h1)})
    return float(t[i] + found.x), float(found.fun)
