"""Forward and backward pass over all legs of a run: starts, steps, events, and the rows that users see.

Multipliers of redundant rows: the multipliers of all rows are x = Π y. Here y consists of the multipliers of the kept
rows and zeros, and Π = J J⁺ projects onto the columns of J of all rows, whose rank r is constant. With z = J⁺ y and
u = (1 - Π) y,

    dx = Π dy + (1 - Π) dJ z + J⁺ᵀ dJᵀ u

for any motion that keeps the rank, that is, with the loops closed. If the parts of dJ by state and by parameter open
the loops, only their sum is meaningful.
"""

import numpy as np

from ..errors import UserFunctionError
from ..mechanism.breakpoints import jump_offset
from ..mechanism.forces.held import BoundSampled
from ..mechanism.motion import slope
from .laws import Laws
from .starts import Crossing, initial_derivatives, moved
from .variants import Variant

EQUAL_TIMES = 1e-12  # relative difference of times that count as equal
GRADIENT_STEP = 1e-3  # rad or m, step of fourth-order differences
PUSH = 1e-4  # relative to the size of a coordinate, step of fourth-order differences
PUSHED = 1e-9  # relative to velocities, smallest jump of them
NO_VARIANT = Variant("", 0.0, 1.0, None, None)  # type: ignore[arg-type]  # stands for a direction of the state
NO_VARIANT.beside = {}, {}, {}


class ForwardPass:
    """Propagates S along the legs of a run."""

    def __init__(self, solution, legs, variants, base):
        self.solution, self.legs, self.variants, self.base = solution, legs, variants, base
        self.sign = sign_of(legs)
        self.rows: list = []
        self.event_times = [np.zeros((len(times), len(variants))) for times in solution.t_events]
        self.work = {"steps": 0, "evaluations": 0}

    def run(self):
        variants, base = self.variants, self.base
        s = initial_derivatives(variants, base, self.legs[0].system)
        times, laws = times_of(self.solution, self.legs), laws_of(self.legs, base, variants)
        for leg, following in zip(self.legs, [*self.legs[1:], None], strict=True):
            residuals = variants.residuals(leg.system)
            leg.follow(base.index1(leg.system), residuals, s, laws)
            self.work["steps"] += len(leg.t)
            self.work["evaluations"] += len(leg.t) * residuals.evaluations
            s = self._cross(leg, following)
            self.rows.append(self.finished(leg, next(times)))

    def close(self) -> None:
        """Release compiled systems: they hold users' functions in cycles that the garbage collector cannot see."""
        for each in (self.base, self.variants, *self.legs):
            each.close()

    def _cross(self, leg, following):
        """Record the events of a leg; return the derivatives of the state at which the `following` one begins."""
        for i, times in enumerate(self.solution.t_events):
            for row, t in enumerate(times):
                if self.sign * (t - leg.span[0]) > 0 and self.sign * (t - leg.span[1]) <= 0:
                    s = leg.at(np.array([t]))[2][0]
                    crossing = Crossing(i, float(t), leg, self.variants, self.base, s)
                    self.event_times[i][row] = crossing.dt
        if following is None:
            return None
        (s,) = leg.at(np.array([leg.span[1]]))[2]
        return across_event(leg, following, self.solution, self.variants, self.base, s)

    def finished(self, leg, times):
        """[dq | dv | dlam], (n, P, …), with the multipliers of all rows, as in a solution."""
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


class BackwardPass:
    """Computes the derivative of a number by all parameters, backwards along the legs of a run (adjoint).

    It is the transpose of the forward pass, step by step. The work per step that does not depend on the parameters is
    shared; each parameter costs the residuals of two mechanisms along the run, and its derivative at the start.

    ``derivative(system, i)`` is the derivative of the number by [q | v | λ] at row i of the run,
    (nx+nv+n_multipliers,).
    """

    def __init__(self, solution, legs, variants, base, derivative):
        self.solution, self.legs, self.variants = solution, legs, variants
        self.base, self.derivative = base, derivative
        self.total = np.zeros(len(variants))

    def run(self) -> np.ndarray:
        times, bar, end = list(times_of(self.solution, self.legs)), None, len(self.solution.t)
        laws = laws_of(self.legs, self.base, self.variants)
        for i in reversed(range(len(self.legs))):
            leg, begin = self.legs[i], end - len(times[i])
            seeds = leg.seeds()
            if bar is not None:
                leg.add_seeds(np.array([leg.span[1]]), [self._across_event(leg, self.legs[i + 1], bar)], seeds)
            leg.add_seeds(times[i], self._pulled(leg, times[i], range(begin, end)), seeds)
            residuals = self.variants.residuals(leg.system)
            bar, rates = leg.follow_back(self.base.index1(leg.system), residuals, seeds, laws)
            self.total += rates
            end = begin
        return self.total + initial_derivatives(self.variants, self.base, self.legs[0].system) @ bar

    def _across_event(self, leg, following, bar):
        """The derivative by s at the end of a leg, from that by the state at the start of the `following` one."""
        n = leg.system.nx + leg.system.nv + leg.system.nc
        s = np.vstack((np.eye(n), np.zeros((len(self.variants), n))))
        both = [NO_VARIANT] * n + list(self.variants)
        rates = across_event(leg, following, self.solution, both, self.base, s) @ bar
        self.total += rates[n:]
        return rates[:n]

    def _pulled(self, leg, times, rows):
        """Derivatives by s at the rows of the run, from those by the multipliers of all loop rows."""
        system = leg.system
        nx, nv = system.nx, system.nv
        if not len(times):
            return np.zeros((0, nx + nv + system.nc))
        bars = np.array([self.derivative(system, i) for i in rows])
        if system.nc == system.n_multipliers:
            return bars
        if system.dropped_are_zero:
            return np.hstack((bars[:, : nx + nv], bars[:, nx + nv :][:, system.kept]))
        p, y = leg.states(times)[:2]
        return np.array([self._of_kept(system, *row) for row in zip(p, y[:, nx + nv :], bars, strict=True)])

    def _of_kept(self, system, q, lam, bar):
        split = system.nx + system.nv
        if not bar[split:].any():
            return np.append(bar[:split], np.zeros(system.nc))
        by_q, by_lam, own = Completion(self.base, system, q, lam).backward(self.variants, bar[split:])
        self.total += own
        return np.concatenate((bar[: system.nx] + by_q, bar[system.nx : split], by_lam))


class Number:
    """The sum of ``rows(t, q, v, lam)`` over the rows of a run, with ``terminal`` for the last one.

    Each of the two is a function, a pair of a function and its derivatives, or None.
    """

    def __init__(self, solution, rows, terminal):
        self._states = list(zip(solution.t.tolist(), solution.q, solution.v, solution.lam, strict=True))
        self._functions = [rows] * (len(self._states) - 1) + [terminal]

    def value(self) -> float:
        return sum(_called(each, *state) for each, state in zip(self._functions, self._states, strict=True))

    def derivative(self, system, i):
        """The derivative by [q | v | λ] at row i, shape (2 nv + nc,)."""
        function, (t, q, v, lam) = self._functions[i], self._states[i]
        if function is None:
            return np.zeros(2 * len(v) + len(lam))
        if isinstance(function, tuple):
            parts = function[1](t, q, v, lam)
            return np.concatenate([np.broadcast_to(part, len(x)) for part, x in zip(parts, (v, v, lam), strict=True)])

        def along(sizes, moved):
            steps = PUSH * np.diag(sizes)
            return [slope(lambda e, x=x: _called(function, t, *moved(e * x))) / x.max() for x in steps]

        by_q = along(np.ones(len(v)), lambda e: (system.integrate(q, e), v, lam))
        by_v = along(1.0 + np.abs(v), lambda e: (q, v + e, lam))
        return np.array([*by_q, *by_v, *along(1.0 + np.abs(lam), lambda e: (q, v, lam + e))])


def _called(function, t, q, v, lam) -> float:
    if function is None:
        return 0.0
    try:
        return float((function[0] if isinstance(function, tuple) else function)(t, q, v, lam))
    except Exception as error:
        raise UserFunctionError("the function rows= or terminal=", t, error) from error


def laws_of(legs, base, variants) -> Laws | None:
    """The laws of sampled torques of a run; None if it has none."""
    system = base.index1(legs[0].system).system
    return Laws(system, base, variants) if any(isinstance(each, BoundSampled) for each in system.held_forces) else None


def sign_of(legs) -> float:
    return 1.0 if legs[-1].span[1] >= legs[0].span[0] else -1.0


def times_of(solution, legs):
    """The times of the solution's rows in each leg; an event that changes the state has a row in both legs."""
    t, taken, sign = solution.t, 0, sign_of(legs)
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
    """The events at a time `end` that change the state."""
    near = EQUAL_TIMES * max(1.0, abs(end))
    events = enumerate(zip(solution._events, solution.t_events, strict=True))
    return [i for i, (event, times) in events if event.apply is not None and (np.abs(times - end) <= near).any()]


def across_event(leg, following, solution, variants, base, s):
    """The derivatives (P, nx+nv) of the state at the start of the `following` leg, from `s` at the end of `leg`."""
    t, nx, nv = leg.span[1], leg.system.nx, leg.system.nv
    if not (applied := applied_at(solution, t)):
        return pushed(leg, following, variants, base, s[:, : nx + nv])
    return Crossing(applied[0], t, leg, variants, base, s).after(applied, variants, base, following)


def pushed(leg, following, variants, base, s):
    """The same where velocities jump with the rates of constraints: they are projected onto those behind the jump."""
    system = leg.system
    last = leg.steps[-1]
    first = following.start
    if np.abs(first.v0 - last.v).max() <= PUSHED * (1.0 + np.abs(last.v).max()):
        return s

    def projected(side, t, p, v):
        p, v = side.index1(system).projected(t, p, v)
        return np.concatenate((system.difference(first.p0, p), v))

    behind = leg.span[1] + leg.sign * jump_offset(leg.span[1])
    return np.array(
        [
            moved(projected, each, base, system, behind, last.p, last.v, row)
            for each, row in zip(variants, s, strict=True)
        ]
    )


class Completion:
    """The map from the multipliers of kept rows, `lam`, to those of all rows, differentiated forwards and backwards."""

    def __init__(self, base, system, q, lam):
        self._base, self._system, self._q = base, system, q
        self._steady = np.flatnonzero(system.rows.steady)
        self._lam = self._spread(lam)
        rank = int(np.isin(system.kept, self._steady).sum())
        U, sizes, Vt = np.linalg.svd(self._jacobian(base, q), full_matrices=False)
        self._range, self._inverse = U[:, :rank], Vt[:rank].T / sizes[:rank] @ U[:, :rank].T
        y = self._lam[self._steady]
        self._z, self._u = self._inverse @ y, y - self._projected(y)

    def forward(self, variant, s_q, s_lam):
        """Derivatives of all multipliers, from those of the configuration and of the kept multipliers."""
        change = self._spread(s_lam)
        size = np.abs(s_q).max(initial=0.0)
        dJ = 0.0 if size == 0.0 else self._along(s_q * GRADIENT_STEP / size) * (size / GRADIENT_STEP)
        if not variant.keeps_rows:
            dJ = dJ + variant.derivative(lambda side: self._jacobian(side, self._q))
        dJ = dJ + np.zeros((len(self._steady), self._system.nx))
        across = dJ @ self._z
        y = self._projected(change[self._steady]) + across - self._projected(across)
        change[self._steady] = y + self._inverse.T @ (dJ.T @ self._u)
        return change

    def backward(self, variants, bar):
        """The transpose: derivatives by the configuration, (nx,), by the kept multipliers, and by the parameters."""
        of_steady, kept = bar[self._steady], bar.copy()
        kept[self._steady] = self._projected(of_steady)
        weights = np.outer(of_steady - self._projected(of_steady), self._z)
        weights += np.outer(self._u, self._inverse @ of_steady)
        of_q = [np.sum(weights * self._along(GRADIENT_STEP * unit)) / GRADIENT_STEP for unit in np.eye(self._system.nx)]
        own = np.zeros(len(variants))
        for i, variant in variants.moved.items():
            if not variant.inert:
                own[i] = np.sum(weights * variant.derivative(lambda side: self._jacobian(side, self._q)))
        return np.array(of_q), kept[self._system.kept], own

    def _spread(self, lam):
        full = np.zeros(self._system.n_multipliers)
        full[self._system.kept] = lam
        return full

    def _projected(self, y):
        return self._range @ (self._range.T @ y)

    def _along(self, way):
        return slope(lambda e: self._jacobian(self._base, self._system.integrate(self._q, e * way)))

    def _jacobian(self, side, q):
        return side.jacobian(self._system, q)[self._steady]
