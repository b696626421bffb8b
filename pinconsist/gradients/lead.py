"""Leading derivatives along all legs of a run: starts, steps, events, and the rows that users see."""

from __future__ import annotations

import numpy as np

from .._core.compiled_gradient import follower
from .forward import follow
from .linear import NUDGE
from .starts import Crossing, first_table, later_table
from .variants import CENTRAL

AT_ONCE = 1e-12  # relative: rows of one time


class Lead:
    """Leads S along the legs of a run, from start to start."""

    def __init__(self, solution, legs, variants, base):
        self.solution, self.legs, self.variants, self.base = solution, legs, variants, base
        self.sign = 1.0 if legs[-1].span[1] >= legs[0].span[0] else -1.0
        self.rows: list = []
        self.event_times = [np.zeros((len(times), len(variants))) for times in solution.t_events]
        self.work = {"steps": 0, "evaluations": 0, "starts": 0}

    def run(self):
        """Fill rows and event times."""
        variants, base, S = self.variants, self.base, None
        for leg, following in zip(self.legs, [*self.legs[1:], None], strict=True):
            if S is None:
                S = first_table(variants, leg, leg.start.t_old)
                self.work["starts"] += sum(len(variant.weights) for variant in variants)
            residuals = [variant.residuals(leg.system) for variant in variants]
            compiled = follower(base.index1(leg.system), residuals)
            if compiled is not None:
                compiled.forward(leg, S)
            else:
                follow(leg, residuals, S)
            self.work["steps"] += len(leg.t)
            self.work["evaluations"] += len(leg.t) * sum(map(len, residuals))
            changed = self._cross(leg, following)
            self._take_rows(leg, following)
            if following is not None:
                S = later_table(variants, base, following, changed)
                self.work["starts"] += len(variants) * len(CENTRAL)
                self.work["starts"] += sum(len(variant.weights) for variant in variants if not variant.idle)

    def _cross(self, leg, following):
        """Note the events of a leg; the derivatives of the state at which the `following` one begins."""
        first, last = leg.span
        applied, crossing = [], None
        for i, times in enumerate(self.solution.t_events):
            for row, t in enumerate(times):
                inside = self.sign * (t - first) > 0 and self.sign * (t - last) <= 0
                if not inside:
                    continue
                crossing_here = Crossing(i, float(t), leg, self.variants, self.base, self.sign, _full)
                self.event_times[i][row] = crossing_here.dt
                if abs(t - last) <= AT_ONCE * max(1.0, abs(last)) and self.base.events[i].apply is not None:
                    applied, crossing = [*applied, i], crossing or crossing_here
        if following is None:
            return None
        if crossing is not None:
            return crossing.after(applied, self.variants, self.base, following)
        nx, nv = leg.system.nx, leg.system.nv
        return leg.at(np.array([last]), self.sign)[2][0, :, : nx + nv]

    def _take_rows(self, leg, following):
        """The rows of the solution in a leg: at an event that changes the state one before it and one after."""
        t, sign, taken = self.solution.t, self.sign, sum(map(len, self.rows))
        n = int(np.searchsorted(sign * t, sign * leg.span[1], side="right"))
        if following is not None:
            at_once = n - int(np.searchsorted(sign * t, sign * leg.span[1], side="left"))
            jumped = not np.array_equal(following.start(following.start.t_old)[1], self._end(leg)[1])
            n -= at_once == 2 or (at_once == 1 and jumped and len(self.solution.h) == 0)
        self.rows.append(self.finished(leg, t[taken:n], sign))

    def _end(self, leg):
        (p,), (y,), _ = leg.at(np.array([leg.span[1]]), self.sign)
        return p, y[leg.system.nx : leg.system.nx + leg.system.nv]

    def finished(self, leg, times, sign):
        """[dq | dv | dlam], (n, P, …), with the multipliers as the user sees them."""
        system = leg.system
        p, y, s = leg.at(times, sign)
        nx, nv = system.nx, system.nv
        if system.nc == system.n_multipliers:
            return s
        rows = np.zeros((*s.shape[:2], nx + nv + system.n_multipliers))
        rows[..., : nx + nv] = s[..., : nx + nv]
        if system.dropped_are_zero:
            rows[..., nx + nv :] = system.full_multipliers(p[:, None], s[..., nx + nv :])
            return rows
        for i, variant in enumerate(self.variants):
            rows[:, i, nx + nv :] = _full_rates(self.base, variant, system, p, y[:, nx + nv :], s[:, i])
        return rows


def _full(system, p, lam):
    return system.full_multipliers(p, lam)


def _full_rates(base, variant, system, q, lam, s):
    """The derivatives of the multipliers of all rows, from states (n, …) and their derivatives."""
    s_q, s_lam = s[:, : system.nx], s[:, system.nx + system.nv :]
    size = NUDGE / np.maximum(np.abs(s_q).max(axis=1, initial=0.0), 1e-300)
    moved = size[:, None] * s_q
    sides = [np.array([system.integrate(*row) for row in zip(q, way, strict=True)]) for way in (moved, -moved)]
    ahead, behind = (base.multipliers(system, side, lam) for side in sides)
    rates = (ahead - behind) / (2.0 * size[:, None]) + base.multipliers(system, q, s_lam)
    if not variant.inert:
        rates = rates + variant.derivative(lambda side: side.multipliers(system, q, lam))
    return rates
