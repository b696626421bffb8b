"""Forces and drives that act between the times at which a run evaluates them."""

import numpy as np

from .joint_constraints import Drive
from .lie import interpolate
from .motion import Motion

PARTS = 10  # samples of each interval
SEEN = 0.02  # of the largest value: what deviates by less from a curve through the ends of the intervals is smooth
MAX_INTERVALS = 30  # intervals, those with the largest deviations


def brief_times(system, t, q, v, intervals) -> np.ndarray:
    """Times at which a run of a MechanismSystem should evaluate its forces and drives, ascending; usually none.

    The forces that may bend or jump, the positions of drives, and the rates of other constraints that depend on time
    are evaluated at the rows (`t`, `q`, `v`) and between them. The times are those in the `intervals`, of equal length,
    in which they are not on a cubic spline through the ends.
    """
    drives = [
        closure
        for closure in (system.rows.closures if system.moving else ())
        if closure.moving and not (isinstance(closure.loop, Drive) and isinstance(closure.loop.curve, Motion))
    ]
    if not (system.may_act_later or drives):
        return np.zeros(0)
    times = np.linspace(min(t[0], t[-1]), max(t[0], t[-1]), intervals * PARTS + 1)
    try:
        values = np.array(
            [_acting(system, drives, *state) for state in zip(*_states(system, t, q, v, times), strict=True)]
        )
    except Exception:  # a function of the user need not be defined between the rows
        return np.zeros(0)
    from scipy.interpolate import CubicSpline

    ends = slice(None, None, PARTS)
    off = np.abs(values - CubicSpline(times[ends], values[ends])(times)).reshape(len(times), -1)
    largest = np.abs(values).max(axis=0, initial=0.0)
    off = (off / np.where(largest > 0.0, largest, 1.0)).max(axis=1)
    by_interval = off[:-1].reshape(intervals, PARTS).max(axis=1)
    worst = np.argsort(by_interval)[-MAX_INTERVALS:]
    chosen = np.sort(worst[by_interval[worst] > SEEN])
    return np.unique(times[(chosen[:, None] * PARTS + np.arange(PARTS + 1)).ravel()])


def _acting(system, drives, t, q, v):
    forces = system.sharp_force(t, q, v) if system.may_act_later else np.zeros(0)
    curves = [closure.loop.curve(t) if isinstance(closure.loop, Drive) else closure.rate(t, q) for closure in drives]
    return np.hstack((forces, *curves))


def _states(system, t, q, v, times):
    """The times, and positions and velocities there on straight lines between the rows."""
    order = np.argsort(t, kind="stable")
    t, q, v = t[order], q[order], v[order]
    after = np.clip(np.searchsorted(t, times), 1, len(t) - 1)
    length = t[after] - t[after - 1]
    share = np.where(length > 0.0, (times - t[after - 1]) / np.where(length > 0.0, length, 1.0), 1.0).clip(0.0, 1.0)
    rows = zip(q[after - 1], q[after], share, strict=True)
    if system.vector_like:
        positions = [a + s * (b - a) for a, b, s in rows]
    else:
        positions = [interpolate(system.model, a, b, s) for a, b, s in rows]
    return times, positions, v[after - 1] + share[:, None] * (v[after] - v[after - 1])
