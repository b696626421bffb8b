"""The first history: exact states at equidistant times, from the index-1 equations and an explicit one-step method.

A multistep method that starts at order 1 needs tiny first steps, and at index 3 each change of order disturbs the
multipliers. Here the first step of the multistep method already has its full order.
"""

import logging

import numpy as np

from ..errors import PinconsistError
from . import bdf
from .charts import chart_point, fastest_turn, table_row, turning_coordinates
from .rounding import representable, shortest_step
from .tuning import (
    SAFETY,
    START_AIM,
    START_APART,
    START_ERROR,
    START_GROWTH,
    START_LEAST,
    START_SHARE,
    START_SHORTER,
    START_STEPS,
    START_TRIES,
    START_TURN,
)

log = logging.getLogger(__name__)

JUMPED, BEFORE_JUMP = 10.0, 4.0  # largest change of a start by projection, in accuracies; divisor of the step beyond it
START_BUDGET = 400  # number of evaluations allowed for each step of the history


class _TooMuchWork(Exception):
    """The one-step method needs more evaluations than it was allowed."""


def integrate_index1(index1, t0, p0, v0, times, rtol, atol, budget=None):
    """States (t, p, v, λ) at `times` (monotone, from t0 on) by DOP853 on the index-1 equations, projected at each.

    `budget` limits the evaluations of the right-hand side. Raises PinconsistError if the one-step method fails,
    SingularSystemError if the equations are singular on the way.
    """
    system = index1.system
    states, t, p, v, evaluations = [], t0, p0, v0, 0
    turns = turning_coordinates(system, p0)
    for target in times:
        while t != target:
            stop = target
            if not system.vector_like:  # stay well inside one chart
                turn = fastest_turn(turns, system.rate(t, p, v)) * abs(target - t)
                stop = t + (target - t) / max(1, int(np.ceil(turn / START_TURN)))
                stop = target if abs(target - stop) < 1e-14 * max(1.0, abs(target)) else stop
            run = index1.one_step(p, t, p, v, stop, rtol, atol)
            while not run.finished:
                run.step()
                if budget is not None and evaluations + run.evaluations > budget:
                    raise _TooMuchWork
            evaluations += run.evaluations
            t, p, v, lam = index1.state(stop, chart_point(system, p, run.y[: system.nx]), run.y[system.nx :])
        states.append((t, p, v, lam) if t != t0 else index1.state(t0, p0, v0))
    return states


def equidistant_history(index1, t0, p0, v0, h, k):
    """States at t0, t0 + h, ..., t0 + (k-1) h for a fixed-step BDF-k; the first is (p0, v0) as given.

    Accurate to rounding if the accelerations are smooth enough; if near-massless links make them noisy, to the
    tolerance that a moderate number of evaluations reaches.
    """
    first = (t0, p0, v0, index1.acceleration(t0, p0, v0)[1])
    times = [t0 + j * h for j in range(1, k)]
    for rtol in (1e-13, 1e-11, 1e-9, 1e-7):
        try:
            return [first, *integrate_index1(index1, t0, p0, v0, times, rtol, 0.1 * rtol, START_BUDGET * k)]
        except _TooMuchWork:
            log.info("the start at t = %g s does not reach rtol = %g", t0, rtol)
    raise PinconsistError(
        f"no starting history at t = {t0:.6g} with step {h:.3g}: the accelerations are too noisy or the motion too "
        "fast for it; take a smaller step, or leave `step` out"
    )


def fill_table(system, states):
    """(chart centre, Z) of equidistant states, oldest first: their differences, then zeros."""
    base = states[-1][1]
    rows = [table_row(system, base, p, v, lam) for _, p, v, lam in reversed(states)]
    Z = np.zeros((bdf.ROWS, len(rows[0])))
    Z[: len(rows)] = bdf.differences(len(rows) - 1) @ np.array(rows)
    return base, Z


def adaptive_history(index1, t0, p0, v0, t_end, k, control, first_step):
    """(h, states) of k+2 states, oldest first, whose step h suits the tolerance of `control`, by a few steps of DOP853.

    h is signed, and at most (t_end - t0)/(k+2).
    """
    system = index1.system
    rtol, atol = (START_SHARE * tightest for tightest in control.tightest)
    turns = turning_coordinates(system, p0)
    speed = fastest_turn(turns, system.rate(t0, p0, v0))
    max_step = START_TURN / speed if speed else np.inf
    run = index1.one_step(p0, t0, p0, v0, t_end, max(rtol, 1e-13), max(atol, 1e-14), max_step, dense=True)
    longest, shortest = 0.0, START_APART * shortest_step(t0, t_end)
    for _ in range(START_STEPS):  # its first step is cautious: continue while its steps grow
        run.step()
        grows, longest = run.step_size > START_GROWTH * longest, run.step_size
        if run.finished or not grows or fastest_turn(turns, run.y[: system.nx]) > START_TURN:
            break
    while not run.finished and abs(run.t - t0) < (k + 1) * shortest:  # equal steps can be told apart only then
        run.step()

    def sample(h):
        times = t0 + h * np.arange(k + 2)
        return times, run.sample(times)

    reach = (run.t - t0) / (k + 1)
    while fastest_turn(turns, run.sample(np.array([t0 + (k + 1) * reach]))[0, : system.nx]) > START_TURN:
        reach *= START_SHORTER  # from rest the one-step method may turn a joint far in one step
    h = reach if first_step is None else np.copysign(min(abs(first_step), abs(reach)), reach)
    if first_step is None:
        for _ in range(START_TRIES):
            _, rows = sample(h)
            error = control.error_of(system, rows, k)
            if error <= START_ERROR:
                break
            h *= max(START_LEAST, SAFETY * (START_AIM / error) ** (1.0 / (k + 1)))
    h = np.copysign(max(min(abs(h), control.max_step), shortest), h)
    if (k + 1) * abs(h) < abs(t_end - t0):  # else it may lead to the end exactly
        h = representable(t0, h)
    first = (t0, p0, v0, index1.acceleration(t0, p0, v0)[1])
    while True:
        if abs(reach) >= shortest:
            times, rows = sample(h)
        else:
            h, times = t_end - t0, np.array([t0, t_end])
            rows = run.sample(times)
        points = [chart_point(system, p0, y[: system.nx]) for y in rows]
        states = [first, *map(index1.state, times[1:], points[1:], rows[1:, system.nx :])]
        closed = [table_row(system, p0, p, v, np.zeros(0)) for _, p, v, _ in states]
        if not system.moving or control.apart(rows, closed) <= JUMPED:
            return h, states
        if abs(h) < BEFORE_JUMP * shortest:
            phi, rho = system.constraint(times[-1], p := points[-1], system.rate(times[-1], p, rows[-1, system.nx :]))
            row = system.describe_row(int(np.argmax(np.abs(phi) + abs(h) * np.abs(rho))))
            raise PinconsistError(f"the run cannot start at t = {t0:.6g}: {row} jumps there, or its rate does")
        h /= BEFORE_JUMP  # a constraint jumps: the method and its error test handle this
