"""The first history: exact states at equidistant times, from the index-1 equations and an explicit one-step method.

A multistep method that crawls up from order 1 needs tiny first steps, and at index 3 each of its order changes
disturbs the multipliers. Here the first step of the multistep method already has its full order.
"""

from __future__ import annotations

import logging

import numpy as np

from ..errors import AssemblyError, PinconsistError, SingularSystemError
from . import bdf
from .acceleration import singular, solve_acceleration
from .consistency import not_closed, project_position, project_velocity
from .one_step import one_step

log = logging.getLogger(__name__)

MAX_TURN = 1.0  # rad: how far one chart is used
START_BUDGET = 400  # evaluations for each step of the history


def state(system, t, p, v):
    """(t, p, v, λ) with p and v put on the constraints and λ the one of the differential equation."""
    if (twin := getattr(system, "twin", None)) is not None:
        p, v, failure, gap = twin.project(t, p, v)
        if failure:
            raise SingularSystemError(singular(t)) if failure == "singular" else AssemblyError(not_closed(gap))
    else:
        p = project_position(system, t, p, v)
        v = project_velocity(system, t, p, v)
    return t, p, v, solve_acceleration(system, t, p, v)[1]


class _TooMuchWork(Exception):
    """The one-step method needs more evaluations than it was allowed."""


def integrate_index1(system, t0, p0, v0, times, rtol, atol, budget=None):
    """States at `times` (monotone, from t0 on) by DOP853 on the index-1 equations, projected at each of them.

    `budget` limits the evaluations of the right-hand side.

    Returns
    -------
    list of (t, p, v, λ)

    Raises
    ------
    PinconsistError
        The one-step method gives up.
    SingularSystemError
        The equations are singular on the way.
    """
    states, t, p, v, evaluations = [], t0, p0, v0, 0
    turns = bdf.turning_coordinates(system, p0)
    for target in times:
        while t != target:
            stop = target
            if not system.vector_like:  # stay well inside one chart
                turn = bdf.fastest_turn(turns, system.rate(t, p, v)) * abs(target - t)
                stop = t + (target - t) / max(1, int(np.ceil(turn / MAX_TURN)))
                stop = target if abs(target - stop) < 1e-14 * max(1.0, abs(target)) else stop
            run = one_step(system, p, t, p, v, stop, rtol, atol)
            while not run.finished:
                run.step()
                if budget is not None and evaluations + run.evaluations > budget:
                    raise _TooMuchWork
            evaluations += run.evaluations
            p = run.y[: system.nx] if system.vector_like else system.integrate(p, run.y[: system.nx])
            t, p, v, lam = state(system, stop, p, run.y[system.nx :])
        states.append((t, p, v, lam) if t != t0 else state(system, t0, p0, v0))
    return states


def equidistant_history(system, t0, p0, v0, h, k):
    """States at t0, t0 + h, ..., t0 + (k-1) h for a fixed-step BDF-k; the first is (p0, v0) as given.

    Down to rounding where the accelerations are that smooth; near-massless links make them noisy, and then to the
    tolerance that a moderate number of evaluations reaches.
    """
    first = (t0, p0, v0, solve_acceleration(system, t0, p0, v0)[1])
    times = [t0 + j * h for j in range(1, k)]
    for rtol in (1e-13, 1e-11, 1e-9, 1e-7):
        try:
            return [first, *integrate_index1(system, t0, p0, v0, times, rtol, 0.1 * rtol, START_BUDGET * k)]
        except _TooMuchWork:
            log.info("the start at t = %g s does not reach rtol = %g", t0, rtol)
    raise PinconsistError(
        f"no starting history at t = {t0:.6g} with step {h:.3g}: the accelerations are too noisy or the motion too "
        "fast for it; take a smaller step, or leave `step` out"
    )


def fill_table(system, states, k):
    """(chart centre, Z) of equidistant states, oldest first: differences up to the number of states, then zeros."""
    base = states[-1][1]
    rows = [bdf.table_row(system, base, p, v, lam) for _, p, v, lam in reversed(states)]
    Z = np.zeros((k + 3, len(rows[0])))
    Z[: len(rows)] = bdf.differences(len(rows) - 1) @ np.array(rows)
    return base, Z


def adaptive_history(system, t0, p0, v0, t_end, k, control, first_step):
    """k+2 states of a step size that suits the tolerance of `control`, from a few steps of DOP853.

    Returns
    -------
    h : float
        The step, signed, at most (t_end - t0)/(k+2).
    states : list of (t, p, v, λ), oldest first
    """
    rtol, atol = max(1e-2 * control.tightest[0], 1e-13), 1e-2 * control.tightest[1]
    turns = bdf.turning_coordinates(system, p0)
    speed = bdf.fastest_turn(turns, system.rate(t0, p0, v0))
    max_step = MAX_TURN / speed if speed else np.inf
    run = one_step(system, p0, t0, p0, v0, t_end, rtol, max(atol, 1e-14), max_step, dense=True)
    longest = 0.0
    for _ in range(6):  # it starts with a careful step: go on while its steps grow
        run.step()
        grows, longest = run.step_size > 1.5 * longest, run.step_size
        if run.finished or not grows or bdf.fastest_turn(turns, run.y[: system.nx]) > MAX_TURN:
            break

    def sample(h):
        times = t0 + h * np.arange(k + 2)
        return times, run.sample(times)

    reach = (run.t - t0) / (k + 1)
    while bdf.fastest_turn(turns, run.sample(np.array([t0 + (k + 1) * reach]))[0, : system.nx]) > MAX_TURN:
        reach *= 0.7  # from rest the one-step method may turn a joint far in one step
    h = reach if first_step is None else np.copysign(min(abs(first_step), abs(reach)), reach)
    if first_step is None:
        for _ in range(4):
            _, rows = sample(h)
            error = control.error_of(system, rows, k)
            if error <= 0.5:
                break
            h *= max(0.05, 0.8 * (0.25 / error) ** (1.0 / (k + 1)))
    shortest = 16.0 * np.spacing(max(abs(t0), abs(t_end)))  # times must differ
    h = np.copysign(max(min(abs(h), control.max_step), shortest), h)
    if abs(reach) >= shortest:
        times, rows = sample(h)
    else:
        h, times = t_end - t0, np.array([t0, t_end])
        rows = run.sample(times)
    states = [(t0, p0, v0, solve_acceleration(system, t0, p0, v0)[1])]
    for t, y in zip(times[1:], rows[1:], strict=True):
        p = y[: system.nx] if system.vector_like else system.integrate(p0, y[: system.nx])
        states.append(state(system, t, p, y[system.nx :]))
    return h, states
