"""BDF at a fixed step on an index-3 system, from exact or from numerically consistent initial values."""

from typing import NamedTuple

import numpy as np

from ..errors import InputError
from .consistency import MODES, consistent_history, corrected
from .formula import HIGHEST
from .index1 import finite, index3_system, states_at
from .step import bdf_step


class FixedStepRun(NamedTuple):
    """Rows of a run at fixed step: t (n,), p (n, npos), v (n, nv), lam (n, nc).

    For order k the first k rows are the exact start, with the multipliers of the differential equation.
    """

    t: np.ndarray
    p: np.ndarray
    v: np.ndarray
    lam: np.ndarray


def solve(system, t_span, p0, v0, step: float, *, order: int = 1, consistency: str = "every-step") -> FixedStepRun:
    """Integrate by BDF of one order with a fixed step; order 1 is implicit Euler.

    The starting values at t0, t0 + h, …, t0 + (k-1) h come from the index-1 equations by scipy's DOP853.

    Parameters
    ----------
    system : Mechanism or HessenbergProblem or Index3System
    t_span : (float, float)
        Start and end, s; an end before the start integrates backwards.
    p0, v0 : array
        Exact initial values.
    step : float
        Step, s: the largest not above it that divides the interval is used.
    order : int
        1 to 6.
    consistency : {"exact", "initial", "every-step"}
        Whether the values are used as they are, the starting velocities are made numerically consistent, or every
        step is corrected.

    Returns
    -------
    FixedStepRun

    Raises
    ------
    InputError
        Arguments that cannot be used.
    PinconsistError
        A step fails.

    References
    ----------
    C. Arévalo, A note on numerically consistent initial values for high index DAEs, ETNA 34 (2008).
    """
    t0, t_end = (float(t) for t in finite(t_span, "t_span"))
    p0 = finite(p0, "p0")
    v0 = finite(v0, "v0")
    if order not in range(1, HIGHEST + 1):
        raise InputError(f"order must be a whole number from 1 to {HIGHEST}, got {order!r}")
    if consistency not in MODES:
        raise InputError(f"unknown consistency {consistency!r}; choose from {', '.join(map(repr, MODES))}")
    if not (step > 0.0 and t0 != t_end):
        raise InputError(f"step must be positive and the interval not empty, got {step!r} and {t_span!r}")
    system = index3_system(system, t0, p0, v0)
    count = max(order, int(np.ceil(abs(t_end - t0) / step * (1.0 - 1e-9))))
    h = (t_end - t0) / count
    rows = states_at(system, t0, p0, v0, t0 + h * np.arange(order))
    history = rows[::-1]
    if consistency == "initial":
        history = consistent_history(system, history, h, order)
    for _ in range(order, count + 1):
        new = bdf_step(system, history, h, order)
        if consistency == "every-step":
            new = corrected(system, new)
        rows.append(new)
        history = [new, *history[:order]]
    p = np.array([each.p for each in rows])
    lam = np.array([each.lam for each in rows])
    return FixedStepRun(
        t0 + h * np.arange(count + 1), p, np.array([each.v for each in rows]), system.full_multipliers(p, lam)
    )
