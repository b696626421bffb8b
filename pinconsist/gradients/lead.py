"""Leading derivatives along all legs of a run: starts, steps, events, and the rows that users see."""

import numpy as np

from .redundant import Completion
from .starts import Crossing, begun

AT_ONCE = 1e-12  # relative: rows of one time


class Lead:
    """Leads S along the legs of a run, from start to start."""

    def __init__(self, solution, legs, variants, base):
        self.solution, self.legs, self.variants, self.base = solution, legs, variants, base
        self.sign = 1.0 if legs[-1].span[1] >= legs[0].span[0] else -1.0
        self.rows: list = []
        self.event_times = [np.zeros((len(times), len(variants))) for times in solution.t_events]
        self.work = {"steps": 0, "evaluations": 0}

    def run(self):
        variants, base = self.variants, self.base
        s = begun(variants, base, self.legs[0].system)
        times = times_of(self.solution, self.legs, self.sign)
        for leg, following in zip(self.legs, [*self.legs[1:], None], strict=True):
            residuals = variants.residuals(leg.system)
            leg.follow(base.index1(leg.system), residuals, leg.begin(variants, base, s))
            self.work["steps"] += len(leg.t)
            self.work["evaluations"] += len(leg.t) * residuals.evaluations
            s = self._cross(leg, following)
            self.rows.append(self.finished(leg, next(times)))

    def close(self) -> None:
        """Let go of compiled systems: they hold users' functions where the garbage collector does not see them."""
        for each in (self.base, self.variants, *self.legs):
            each.close()

    def _cross(self, leg, following):
        """Note the events of a leg; the derivatives of the state at which the `following` one begins."""
        for i, times in enumerate(self.solution.t_events):
            for row, t in enumerate(times):
                if self.sign * (t - leg.span[0]) > 0 and self.sign * (t - leg.span[1]) <= 0:
                    s = leg.at(np.array([t]))[2][0]
                    crossing = Crossing(i, float(t), leg, self.variants, self.base, s)
                    self.event_times[i][row] = crossing.dt
        if following is None:
            return None
        (s,) = leg.at(np.array([leg.span[1]]))[2]
        return through(leg, following, self.solution, self.variants, self.base, s)

    def finished(self, leg, times):
        """[dq | dv | dlam], (n, P, …), with the multipliers as the user sees them."""
        system = leg.system
        p, y, s = leg.at(times)
        nx, nv = system.nx, system.nv
        if system.nc == system.n_multipliers:
            return s
        rows = np.zeros((*s.shape[:2], nx + nv + system.n_multipliers))
        rows[..., : nx + nv] = s[..., : nx + nv]
        if system.dropped_are_zero:
            rows[..., nx + nv :] = system.full_multipliers(p[:, None], s[..., nx + nv :])
            return rows
        for q, row, derivatives, full in zip(p, y, s, rows, strict=True):
            completion = Completion(self.base, system, q, row[nx + nv :])
            for variant, own, found in zip(self.variants, derivatives, full, strict=True):
                found[nx + nv :] = completion.forward(variant, own[:nx], own[nx + nv :])
        return rows


def times_of(solution, legs, sign):
    """The times of the solution's rows in each leg: at an event that changes the state one before it and one after."""
    t, taken = solution.t, 0
    for leg, following in zip(legs, [*legs[1:], None], strict=True):
        end = leg.span[1]
        n = int(np.searchsorted(sign * t, sign * end, side="right"))
        if following is not None:
            at_once = n - int(np.searchsorted(sign * t, sign * end, side="left"))
            only_after = at_once == 1 and len(solution.h) == 0 and bool(applied_at(solution, end))
            n -= at_once == 2 or only_after
        yield t[taken:n]
        taken = n


def applied_at(solution, end) -> list[int]:
    """The events at a time that change the state."""
    near = AT_ONCE * max(1.0, abs(end))
    events = enumerate(zip(solution._events, solution.t_events, strict=True))
    return [i for i, (event, times) in events if event.apply is not None and (np.abs(times - end) <= near).any()]


def through(leg, following, solution, variants, base, s):
    """The derivatives (P, nx+nv) of the state where the `following` leg begins, from those, `s`, where `leg` ends."""
    t, nx, nv = leg.span[1], leg.system.nx, leg.system.nv
    if not (applied := applied_at(solution, t)):
        return s[:, : nx + nv]
    return Crossing(applied[0], t, leg, variants, base, s).after(applied, variants, base, following)
