"""The derivative of one number of a run by many parameters: its steps are gone through backwards."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import InputError, PinconsistError, UserFunctionError
from ..mechanism.mechanism import Mechanism
from ..mechanism.motion import slope
from ..solution import Solution
from .lead import through, times_of
from .redundant import Completion
from .sensitivities import prepared
from .starts import begun
from .variants import Variant

NUDGE = 1e-4  # of the size of a coordinate, of differences of fourth order
STILL = Variant("", 1.0, {}, {}, {}, inert=True, idle=True)  # a direction of the state


@dataclass(frozen=True, eq=False)
class Gradient:
    """A number computed from a run, and its derivatives with respect to parameters.

    Attributes
    ----------
    value : float
        The number.
    gradient : ndarray, shape (P,)
        Its derivatives.
    names : tuple of str
        Of the parameters.
    solution : Solution
        The run.
    """

    value: float
    gradient: np.ndarray
    names: tuple[str, ...]
    solution: Solution


def gradient(
    build: Callable | Mechanism,
    theta,
    t_span,
    q0=None,
    v0=None,
    *,
    rows: Callable | tuple | None = None,
    terminal: Callable | tuple | None = None,
    names: Sequence[str] | None = None,
    steps=None,
    forces=(),
    events=None,
    t_eval=None,
    rtol=1e-8,
    atol=1e-10,
    backend="auto",
    **options: Any,
) -> Gradient:
    """Simulate a mechanism, and differentiate one number of the run with respect to many parameters.

    The number is the sum of ``rows(t, q, v, lam)`` over the times `t_eval`, plus ``terminal(t, q, v, lam)`` at the end.
    Its derivative is that of :func:`sensitivities` to rounding, and comes from one pass backwards over the steps, which
    does not depend on the number of parameters.

    Parameters
    ----------
    build, theta, t_span, q0, v0, names, steps, forces, events, rtol, atol, backend, **options
        As in :func:`sensitivities`.
    rows, terminal : callable, or pair of callables, optional
        ``f(t, q, v, lam) -> float``; or a pair of it and ``(t, q, v, lam) -> (f_q, f_v, f_lam)``, the derivatives,
        shapes (nv,), (nv,), (nc,), that by q in the tangent space. Without them they are differences.
    t_eval : array, optional
        Times of `rows`, inside the span.

    Returns
    -------
    Gradient

    Raises
    ------
    InputError
        As :func:`sensitivities`; neither `rows` nor `terminal`; `rows` without `t_eval`.
    PinconsistError
        The run did not reach its end.
    """
    if rows is None and terminal is None:
        raise InputError("gradient() needs a number: rows=, a function of each row, or terminal=, of the last state")
    if (rows is None) != (t_eval is None):
        raise InputError("rows= and t_eval= go together: the function, and the times over which it is summed")
    times = np.zeros(0) if t_eval is None else np.atleast_1d(np.asarray(t_eval, float))
    options = {**options, "t_eval": np.append(times, t_span[1])}
    run = prepared(build, theta, t_span, q0, v0, names, steps, forces, events, rtol, atol, backend, options)
    solution, legs, variants, base, names, _ = run
    if solution.status != 0:
        raise PinconsistError(f"the number is one of the whole run, and it ended early: {solution.message}")

    def row(i):  # the last is the end of the run
        function = terminal if i == len(solution.t) - 1 else rows
        return function, float(solution.t[i]), solution.q[i], solution.v[i], solution.lam[i]

    back = Back(solution, legs, variants, base, lambda system, i: _derivative(system, *row(i)))
    back.run()
    value = sum(_value(*row(i)) for i in range(len(solution.t)))
    return Gradient(float(value), back.total, names, solution)


def _value(function, t, q, v, lam) -> float:
    if function is None:
        return 0.0
    called = function[0] if isinstance(function, tuple) else function
    try:
        return float(called(t, q, v, lam))
    except Exception as error:
        raise UserFunctionError("the function of rows or of the end", t, error) from error


def _derivative(system, function, t, q, v, lam):
    """By [q | v | λ], shape (2 nv + nc,)."""
    if function is None:
        return np.zeros(2 * len(v) + len(lam))
    if isinstance(function, tuple):
        parts = function[1](t, q, v, lam)
        return np.concatenate([np.broadcast_to(part, len(x)) for part, x in zip(parts, (v, v, lam), strict=True)])

    def along(sizes, moved):
        steps = NUDGE * np.diag(sizes)
        return [slope(lambda e, x=x: _value(function, t, *moved(e * x))) / x.max() for x in steps]

    by_q = along(np.ones(len(v)), lambda e: (system.integrate(q, e), v, lam))
    by_v = along(1.0 + np.abs(v), lambda e: (q, v + e, lam))
    return np.array([*by_q, *by_v, *along(1.0 + np.abs(lam), lambda e: (q, v, lam + e))])


class Back:
    """Goes back along the legs of a run; ``total`` is then the derivative of a number by all parameters.

    The transpose of :mod:`forward`, step by step. What a step passes on does not depend on the parameters; each of them
    costs the residuals of two mechanisms along the run, and what it changes at its start.

    ``derivative(system, i)`` is that of the number by [q | v | λ] at row i of the run, (nx+nv+n_multipliers,).
    """

    def __init__(self, solution, legs, variants, base, derivative):
        self.solution, self.legs, self.variants = solution, legs, variants
        self.base, self.derivative = base, derivative
        self.sign = 1.0 if legs[-1].span[1] >= legs[0].span[0] else -1.0
        self.total = np.zeros(len(variants))

    def run(self) -> None:
        times, bar, end = list(times_of(self.solution, self.legs, self.sign)), None, len(self.solution.t)
        for i in reversed(range(len(self.legs))):
            leg, begin = self.legs[i], end - len(times[i])
            seeds = leg.seeds()
            if bar is not None:
                leg.sow(np.array([leg.span[1]]), [self._through(leg, self.legs[i + 1], bar)], seeds)
            leg.sow(times[i], self._pulled(leg, times[i], range(begin, end)), seeds)
            residuals = self.variants.residuals(leg.system)
            self.total += leg.follow_back(self.base.index1(leg.system), residuals, seeds)
            bar, rates = leg.begin_back(self.variants, self.base, seeds[0])
            self.total, end = self.total + rates, begin
        self.total += begun(self.variants, self.base, self.legs[0].system) @ bar

    def _through(self, leg, following, bar):
        """The derivative by s where a leg ends, from that by the state where the `following` one begins."""
        n = leg.system.nx + leg.system.nv + leg.system.nc
        s = np.vstack((np.eye(n), np.zeros((len(self.variants), n))))
        both = [STILL] * n + list(self.variants)
        rates = through(leg, following, self.solution, both, self.base, s) @ bar
        self.total += rates[n:]
        return rates[:n]

    def _pulled(self, leg, times, rows):
        """Derivatives by s of the rows, from those by the multipliers as the user sees them."""
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
