"""Initial derivatives, at the start of a run and after an event.

The derivatives of the assembled state follow from the loops, J s_q = -Φ_θ, if these and the given joint values
determine it; otherwise they are differences of assembled states.
"""

from collections.abc import Mapping

import numpy as np

from ..errors import AssemblyError, InputError
from ..mechanism.assembly import not_kept
from ..mechanism.closing import CLOSED_GAP, check_closing
from ..mechanism.motion import slope
from ..run.events import state_after

STATE_STEP = 1e-3  # relative to the size of a state: step of fourth-order differences
SLOPE_STEP = 1e-3  # relative to a step of the run: step of the differences of an event's function
GRAZING = 0.02  # relative to the mean slope of an event's function in the step: smallest slope of a crossing
PROJECTION_GAP = 1e-10  # m or rad


class Start:
    """The assembled state at the start of a run, and its derivative by each parameter."""

    def __init__(self, base, system):
        self.base, self.system, self.solver = base, system, base.solver
        self.q, self.v = base.assembled[:2]
        self.named = dict(base.q0) if isinstance(base.q0, Mapping) else {}
        J, E = self.solver.rows(self.q)[1], np.eye(system.nv)[~self.solver.free_columns(self.named)]
        self.A = np.vstack((J, E))
        closed = base.q0 is None and self.solver.size(base.mechanism.guess) <= CLOSED_GAP
        known = base.q0 is None or bool(self.named)
        kept = not not_kept(base.mechanism, self.named, self.q)
        self.implicit = closed or (known and kept and np.linalg.matrix_rank(self.A) == system.nv)
        E = np.eye(system.nv)[~self.solver.free_columns(base.v0 if isinstance(base.v0, Mapping) else {})]
        self.follows = not self.v.any() or np.linalg.matrix_rank(np.vstack((J, E))) == system.nv

    def rate(self, variant):
        """(s_q, s_v), (nx+nv,)."""
        system, base, q = self.system, self.base, self.q
        stays = variant.keeps_rows and not variant.inert
        by_loops = self._by_loops if self.implicit else self._by_differences
        s_q = np.zeros(system.nx) if stays else by_loops(variant)
        s_v = variant.derivative(lambda side: side.velocity(q, system.kept))
        if (size := np.abs(s_q).max()) > 0.0:
            s_v = s_v + slope(lambda e: base.velocity(system.integrate(q, e * s_q), system.kept), STATE_STEP / size)
        return np.concatenate((s_q, s_v))

    def _by_loops(self, variant):
        columns = ~self.solver.free_columns(self.named)

        def open_by(side):
            phi = side.solver.rows(self.q)[0]
            there = side.mechanism.configuration(side.q0 if self.named else {}, base=self.q)
            return np.concatenate((phi, -self.system.difference(self.q, there)[columns]))

        right = -variant.derivative(open_by)
        s_q = np.linalg.lstsq(self.A, right, rcond=1e-10)[0]
        check_closing(variant.name, self.A @ s_q - right, right)
        return s_q

    def _by_differences(self, variant):
        allowed = max(PROJECTION_GAP, 3.0 * self.base.assembled[2])
        try:
            gap = max(side.assembled[2] for side in variant.beside[0].values())
        except AssemblyError as error:
            raise InputError(
                f"the parameter {variant.name!r} cannot vary alone: the loops would no longer close ({error})"
            ) from error
        if gap > allowed:
            raise InputError(
                f"the parameter {variant.name!r} cannot vary alone: it opens redundant loops, by {gap:.1e}. Vary all "
                "values that keep them consistent together, by one parameter of build()"
            )
        return variant.derivative(lambda side: self.system.difference(self.q, side.assembled[0]))


def initial_derivatives(variants, base, system):
    """The derivatives (P, nx+nv) of the assembled state."""
    start, rates = Start(base, system), np.zeros((len(variants), system.nx + system.nv))
    for i in variants.moved if start.follows else range(len(variants)):
        rates[i] = start.rate(variants[i])
    return rates


def moved(function, variant, base, system, t, p, v, s, rate=0.0, scale=1.0):
    """The total derivative of ``function(side, t, p, v)`` by a parameter, with those of the state, `s`, and t, `rate`.

    `scale` is the time over which the function changes considerably.
    """
    s_p, s_v = s[: system.nx], s[system.nx :]
    size = max(np.abs(s_p).max(), (np.abs(s_v) / (1.0 + np.abs(v))).max(), abs(rate) / scale)

    def along(e):
        return function(base, t + e * rate, system.integrate(p, e * s_p), v + e * s_v)

    change = slope(along, STATE_STEP / size) if size > 0.0 else 0.0 * along(0.0) if variant.idle else 0.0
    if not variant.idle:
        change = change + variant.derivative(lambda side: function(side, t, p, v))
    return change


class Crossing:
    """An occurrence of the event `i` at the time `t` in a leg: the derivative of its time by each parameter.

    `s`, (P, nx+nv+nc), are the derivatives of the state at that time.
    """

    def __init__(self, i, t, leg, variants, base, s):
        system, event = leg.system, base.events[i]
        (p,), (y,) = leg.states(np.array([t]))[:2]
        nx, nv = system.nx, system.nv
        self.t, self.p, self.v, self.s, (before, self.h) = t, p, y[nx : nx + nv], s, leg.step_at(t)

        def value(time):
            (q,), (y,) = leg.states(np.array([time]))[:2]
            return event.function(time, q, y[nx : nx + nv], base.multipliers(system, q, y[nx + nv :]))

        falls = slope(lambda e: value(t + e), SLOPE_STEP * self.h)
        reach = (value(t) - value(before)) / (t - before) if t != before else falls
        if not abs(falls) > GRAZING * abs(reach):
            raise InputError(
                f"the event {event.name!r} at t = {t:.6g} only grazes zero (its rate there is {falls:.1e} 1/s), so "
                "that its occurrence depends on the parameters and its time has no derivative. Omit it, or shift its "
                "threshold"
            )

        def at(side, time, q, v_and_lam):
            v, lam = v_and_lam[:nv], v_and_lam[nv:]
            return np.array(float(side.events[i].function(time, q, v, side.multipliers(system, q, lam))))

        rest = y[nx:]
        pairs = zip(variants, s, strict=True)
        rates = [moved(at, each, base, system, t, p, rest, row) for each, row in pairs]
        self.dt = -np.array(rates) / falls

    def after(self, events, variants, base, leg):
        """The derivatives (P, nx+nv) of the state at the start of the next `leg`, at a fixed time."""
        system, t = leg.system, self.t
        p_after, v_after = leg.start.p0, leg.start.v0

        def applied(side, t, p, v):
            for i in events:
                if side.events[i].apply is not None:
                    p, v = state_after(side.events[i], side.index1(system), t, p, v, self.h > 0.0)[:2]
            p, v = side.index1(system).projected(t, p, v)
            return np.concatenate((system.difference(p_after, p), v))

        nx, nv = system.nx, system.nv
        before = np.concatenate((self.v, base.index1(system).acceleration(t, self.p, self.v)[0]))
        behind = np.concatenate((v_after, base.index1(system).acceleration(t, p_after, v_after)[0]))
        total = self.s[:, : nx + nv] + self.dt[:, None] * before
        parts, scale = zip(variants, total, self.dt, strict=True), 10.0 * abs(self.h)
        reached = [moved(applied, each, base, system, t, self.p, self.v, *row, scale) for each, *row in parts]
        return np.array(reached) - self.dt[:, None] * behind
