"""The derivatives with which a run begins, and begins again after an event.

At the start they are differences of assembled states and of the histories from there. Later they are the sum of two
parts: what the parameter changes at a fixed state, and what the derivatives of the state change in the system of the
run. The sum is that of the moved state, which is on the loops of the moved parameter; each part is put on its own.
"""

from __future__ import annotations

import numpy as np

from ..errors import InputError
from .variants import CENTRAL

NUDGE = 1e-3  # by which a state is moved, over its size: differences of fourth order
BESIDE = 1e-3  # of a step, over which the rate of an event's function is taken
GRAZING = 0.02  # of the slope with which an event's function reached zero in its step


def first_table(variants, leg, t):
    """S of the first leg: each side from the state that it assembles."""

    def rows(side):
        return leg.initial(side.index1(leg.system), *side.assembled(t)[:2])

    return leg.table(np.stack([variant.derivative(rows) for variant in variants], axis=1))


def later_table(variants, base, leg, s):
    """S of a leg that begins at (p, v) with the derivatives `s`, (P, nx+nv), of that state at a fixed time."""
    t, system = leg.start.t_old, leg.system
    p, v, _ = leg.start(t)

    def rows(side, t, p, v):
        index1 = side.index1(system)
        return leg.initial(index1, *index1.state(t, p, v)[1:3])

    pairs = zip(variants, s, strict=True)
    return leg.table(np.stack([moved(rows, each, base, system, t, p, v, row) for each, row in pairs], axis=1))


def moved(function, variant, base, system, t, p, v, s, rate=0.0, scale=1.0):
    """The derivative of ``function(side, t, p, v)`` by a parameter, with those of the state, `s`, and of t, `rate`.

    The function changes considerably over times of `scale`.
    """
    s_p, s_v = s[: system.nx], s[system.nx :]
    size = max(np.abs(s_p).max(), (np.abs(s_v) / (1.0 + np.abs(v))).max(), abs(rate) / scale)
    change = 0.0 if size > 0.0 or not variant.idle else 0.0 * function(base, t, p, v)
    if size > 0.0:
        e = NUDGE / size
        for m, weight in CENTRAL.items():
            there = t + m * e * rate, system.integrate(p, m * e * s_p), v + m * e * s_v
            change = change + weight / e * function(base, *there)
    if not variant.idle:
        change = change + variant.derivative(lambda side: function(side, t, p, v))
    return change


class Crossing:
    """An occurrence of the event `i` at the time `t` in a leg: the derivative of its time by each parameter.

    `s`, (P, nx+nv+nc), are the derivatives of the state at that time.
    """

    def __init__(self, i, t, leg, variants, base, sign, s):
        system, event = leg.system, base.events[i]
        (p,), (y,) = leg.states(np.array([t]), sign)[:2]
        nx, nv = system.nx, system.nv
        self.t, self.p, self.v, self.s, (before, self.h) = t, p, y[nx : nx + nv], s, leg.step_at(t, sign)

        def value(time):
            (q,), (y,) = leg.states(np.array([time]), sign)[:2]
            return event.function(time, q, y[nx : nx + nv], base.multipliers(system, q, y[nx + nv :]))

        e = BESIDE * self.h
        slope = sum(weight * value(t + m * e) for m, weight in CENTRAL.items()) / e
        reach = (value(t) - value(before)) / (t - before) if t != before else slope
        if not abs(slope) > GRAZING * abs(reach):
            raise InputError(
                f"the event {event.name!r} at t = {t:.6g} only grazes zero (its rate there is {slope:.1e} 1/s): "
                "whether it happens depends on the parameters, and its time has no derivative. Leave it out, or "
                "shift its threshold"
            )

        def at(side, time, q, v_and_lam):
            v, lam = v_and_lam[:nv], v_and_lam[nv:]
            return np.array(float(side.events[i].function(time, q, v, side.multipliers(system, q, lam))))

        rest = y[nx:]
        pairs = zip(variants, s, strict=True)
        rates = [moved(at, each, base, system, t, p, rest, row) for each, row in pairs]
        self.dt = -np.array(rates) / slope

    def after(self, events, variants, base, leg):
        """The derivatives (P, nx+nv) of the state from which the next `leg` begins, at a fixed time."""
        system, t = leg.system, self.t
        p_after, v_after, _ = leg.start(leg.start.t_old)

        def applied(side, t, p, v):
            for i in events:
                if (apply := side.events[i].apply) is not None:
                    changed = apply(t, p.copy(), v.copy())
                    if changed is not None:
                        p, v = changed if isinstance(changed, tuple) and len(changed) == 2 else (p, changed)
            _, p, v, _ = side.index1(system).state(t, np.array(p, float), np.array(v, float))
            return np.concatenate((system.difference(p_after, p), v))

        nx, nv = system.nx, system.nv
        before = np.concatenate((self.v, base.index1(system).acceleration(t, self.p, self.v)[0]))
        behind = np.concatenate((v_after, base.index1(system).acceleration(t, p_after, v_after)[0]))
        total = self.s[:, : nx + nv] + self.dt[:, None] * before
        parts, scale = zip(variants, total, self.dt, strict=True), 10.0 * abs(self.h)
        reached = [moved(applied, each, base, system, t, self.p, self.v, *row, scale) for each, *row in parts]
        return np.array(reached) - self.dt[:, None] * behind
