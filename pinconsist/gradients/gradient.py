"""The derivative of one number of a run by many parameters: its steps are gone through backwards."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import InputError, PinconsistError, UserFunctionError
from ..mechanism.mechanism import Mechanism
from ..mechanism.motion import slope
from ..solution import Solution
from .adjoint import Back
from .sensitivities import prepared

NUDGE = 1e-4  # of the size of a coordinate, of differences of fourth order


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
    number = _Number(rows, terminal, solution)
    back = Back(solution, legs, variants, base, number.derivatives)
    back.run()
    return Gradient(number.value(), back.total, names, solution)


class _Number:
    """The sum over all rows but the last, which is the end of the run, and what the end gives."""

    def __init__(self, rows, terminal, solution):
        self.rows, self.terminal, self.solution, self._seen = rows, terminal, solution, len(solution.t)

    def value(self) -> float:
        """The number."""
        return float(sum(_value(function, *state) for function, *state in map(self._row, range(len(self.solution.t)))))

    def _row(self, i):
        sol, last = self.solution, i == len(self.solution.t) - 1
        return self.terminal if last else self.rows, float(sol.t[i]), sol.q[i], sol.v[i], sol.lam[i]

    def derivatives(self, leg, times):
        """Those by [q | v | λ] at the rows of a leg; legs are asked for from the last to the first."""
        first, self._seen = self._seen - len(times), self._seen - len(times)
        return np.array([_derivative(leg.system, *self._row(first + i)) for i in range(len(times))])


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
