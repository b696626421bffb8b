"""Derivatives of quantities that are given by their names: at rows, at a time, of extrema and of means."""

from dataclasses import replace

import numpy as np

from ..errors import InputError
from ..mechanism.motion import slope
from ..run.quantities import MEANS, RANKS, Quantity, averages, next_to
from ..run.states import states_at
from .passes import EQUAL_TIMES
from .starts import STATE_STEP


def derivatives(found, quantity: str | Quantity) -> np.ndarray:
    """The derivatives of a quantity by the parameters of `found`, :class:`~pinconsist.Sensitivities`, as the last axis.

    An extremum moves in time, which changes its value in second order only (envelope theorem): its derivative is that
    of the quantity at its time, also at an end of the run. Extrema at events, and means of runs with events that change
    the state or end the run, depend on the times of the events: InputError.
    """
    solution, variants = found.solution, found._pass.variants
    if isinstance(quantity, str):
        quantity = Quantity.of(quantity, solution.mechanism)
    if quantity.what == "error" or quantity.only_rows:
        raise InputError(f"{quantity.text!r}: an error has no derivatives")
    if quantity.statistic in MEANS:
        return _of_mean(found, quantity)
    if quantity.statistic in ("", "final"):
        rows = slice(None) if not quantity.statistic else slice(-1, None)
        states = tuple(part[rows] for part in (solution.t, solution.q, solution.v, solution.lam))
        by = np.concatenate((found.dq[rows], found.dv[rows], found.dlam[rows]), axis=1)
    else:
        sought = quantity.statistic in RANKS
        time = quantity.sought(solution).best()[1] if sought else quantity.time
        states, by = _at(found, np.array([time]))
    if quantity.statistic:
        _require_no_event(found, quantity, states[0])
    values, rates = _rates(found, quantity, states, by, variants)
    if quantity.statistic in RANKS and values.ndim > 1:
        rates = np.einsum("nk,nkp->np", values / np.linalg.norm(values, axis=1, keepdims=True), rates)
    return rates[-1] if quantity.statistic else rates


def _of_mean(found, quantity):
    solution, variants = found.solution, found._pass.variants
    times = quantity.sought(solution).t
    if any(event.apply is not None or event.terminal for event, at in _events(solution) if len(at)):
        raise InputError(f"{quantity.text!r}: the times of the run's events depend on the parameters, and with them it")
    if (np.diff(times) == 0.0).any():
        raise InputError(f"{quantity.text!r}: the run has two states at one time")
    states, by = _at(found, times)
    values, rates = _rates(found, quantity, states, by, variants)
    squares = quantity.statistic == "rms"
    if values.ndim > 1:
        rates = np.einsum("nk,nkp->np", values, rates)
        sizes = np.linalg.norm(values, axis=1)
        rates = rates if squares else rates / np.where(sizes > 0.0, sizes, 1.0)[:, None]
    elif squares:
        rates = values[:, None] * rates
    mean = averages(times, rates)
    if not squares:
        return mean
    size = quantity.value(solution)
    return mean / size if size > 0.0 else np.zeros_like(mean)


def _events(solution):
    return zip(solution._events, solution.t_events, strict=True)


def _require_no_event(found, quantity, times):
    for event, at in _events(found.solution):
        moves = event.apply is not None or event.terminal
        near = [t for t in at if np.abs(times - t).min() <= EQUAL_TIMES * max(1.0, abs(t))]
        if moves and near:
            raise InputError(
                f"{quantity.text!r} is at the event {event.name!r} at t = {near[0]:.6g} s, whose time depends on the "
                "parameters; 'at TIME' before it has derivatives"
            )


def _at(found, times):
    """States at times, (t, q, v, lam), and the derivatives of the states, (n, 2 nv + nc, P)."""
    states = (times, *states_at(found.solution, times, None))
    return states, np.concatenate(found.at(times), axis=1)


def _rates(found, quantity, states, by, variants):
    """Values (n, …) at some states, and their derivatives (n, …, P); `by` has those of the states."""
    solution, base, system = found.solution, found._pass.base, found._legs[0].system
    t, q, v, lam = states

    def evaluated(side, q, v, lam):
        rows = {"t": t, "q": q, "v": v, "lam": lam, "h": np.zeros(0), "order": np.zeros(0, int)}
        return quantity.series(replace(solution, **rows, system=None), side.mechanism).values

    here, turns, rates = evaluated(base, q, v, lam), quantity.turns(base.mechanism), []

    def values(*state):
        return next_to(evaluated(*state), here) if turns else evaluated(*state)

    for k, variant in enumerate(variants):
        s_q, s_v, s_lam = np.split(by[:, :, k], [system.nx, system.nx + system.nv], axis=1)
        rate = _along(values, base, system, (q, v, lam), (s_q, s_v, s_lam))
        if not variant.idle:
            rate = rate + variant.derivative(lambda side: values(side, q, v, lam))
        rates.append(rate)
    return here, np.stack(rates, axis=-1)


def _along(values, base, system, state, rates):
    """The derivatives of values along rates of the states, by differences over a step for each state."""
    q, v, lam = state
    scaled = [np.abs(rates[0])] + [np.abs(r) / (1.0 + np.abs(x)) for r, x in zip(rates[1:], (v, lam), strict=True)]
    sizes = np.max(np.hstack(scaled), axis=1, initial=0.0)
    reach = np.where(sizes > 0.0, STATE_STEP / np.where(sizes > 0.0, sizes, 1.0), 0.0)

    def at(e):
        s_q, s_v, s_lam = (e * reach[:, None] * rate for rate in rates)
        moved = np.array([system.integrate(*pair) for pair in zip(q, s_q, strict=True)])
        return values(base, moved, v + s_v, lam + s_lam)

    change = slope(at)
    reach = reach.reshape(-1, *[1] * (change.ndim - 1))
    return np.divide(change, reach, out=np.zeros_like(change), where=reach > 0.0)
