"""Derivatives of a run: of all rows with respect to a few parameters (forward), or of one number with respect to
many."""

import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..errors import InputError, PinconsistError
from ..mechanism.checks import finite_array
from ..mechanism.mechanism import Mechanism
from ..run.quantities import Quantity
from ..run.solution import Solution
from .leg import Leg
from .passes import BackwardPass, ForwardPass, Number
from .prepare import prepared
from .quantities import derivatives
from .starts import moved


@dataclass(frozen=True, eq=False)
class Sensitivities:
    """A run and its derivatives with respect to parameters: rows as in the solution, parameters along the last axis.

    Attributes
    ----------
    solution : Solution
        The run itself.
    names, values : tuple of str, ndarray, shape (P,)
        Names and values of the parameters.
    steps : ndarray, shape (P,)
        Difference steps of the parameters, used if the derivatives of the equations are finite differences.
    dq : ndarray, shape (n, nv, P)
        Derivatives of the configurations as tangent vectors, like velocities: for joints with one number those of
        ``q``, for rotations in the axes of the body.
    dv, dlam : ndarray, shapes (n, nv, P), (n, nc, P)
        Derivatives of velocities and multipliers.
    event_times : list of ndarray, shape (m, P)
        Derivatives of ``solution.t_events``.
    work : dict
        Cost: number of ``steps`` differentiated, and of ``evaluations`` of the equations in addition to those of the
        run.
    """

    solution: Solution
    names: tuple[str, ...]
    values: np.ndarray
    steps: np.ndarray
    dq: np.ndarray
    dv: np.ndarray
    dlam: np.ndarray
    event_times: list
    work: dict
    _legs: list[Leg] = field(repr=False)
    _pass: ForwardPass | None = field(repr=False)

    def __repr__(self):
        return f"Sensitivities of {self.solution.scene or 'a run'} by {', '.join(self.names)}: {len(self.dq)} rows"

    def at(self, t) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(dq, dv, dlam) at any time of the run; at an event that changes the state, the values before it.

        Parameters
        ----------
        t : float or array, shape (n,)
            Times, s.

        Returns
        -------
        tuple of ndarray, shapes (nv, P), (nv, P), (nc, P)
            For an array of n times, (n, nv, P) and so on.

        Raises
        ------
        InputError
            A time outside the run; copied or unpickled sensitivities, which have only the rows of the run.
        """
        followed, times = self._followed(), finite_array(t, "t")
        requested, (begin, end) = np.atleast_1d(times), (self._legs[0].span[0], self._legs[-1].span[1])
        if (requested < min(begin, end)).any() or (requested > max(begin, end)).any():
            raise InputError(f"the run covers t = {begin:g} to {end:g} s, requested {t}")
        sign, ends = followed.sign, np.array([leg.span[1] for leg in self._legs])
        holders = np.minimum(np.searchsorted(sign * ends, sign * requested), len(ends) - 1)
        rows = np.empty((len(requested), len(self.names), 2 * self.dv.shape[1] + self.dlam.shape[1]))
        for i in np.unique(holders):
            rows[holders == i] = followed.finished(self._legs[i], requested[holders == i])
        parts = _parts(rows, self.dv.shape[1])
        return parts if times.ndim else tuple(part[0] for part in parts)

    def of(self, function: Callable | str) -> np.ndarray:
        """Derivatives of another quantity at the rows of the solution: a frame position, an energy, a stress.

        Parameters
        ----------
        function : callable or str
            ``function(mech, t, q, v, lam)``, a number or an array; `mech` is the mechanism with the parameters' values.
            Or a quantity by its name, as for :meth:`Solution.evaluate`: ``"peak reaction boom_pin"``. An extremum is
            followed in time; if two are equal, the derivative does not exist, and that of one of them is returned.

        Returns
        -------
        ndarray, shape (n, …, P)
            The axes between the first and the last are those of the return value of `function`. Of a quantity with a
            statistic or a time there are no rows: shape (P,), or (k, P) for one of several numbers.

        Raises
        ------
        InputError
            An unknown name; a quantity whose time, or that of an event which it includes, is that of an event that
            changes the state or ends the run; copied or unpickled sensitivities.
        """
        followed = self._followed()
        if isinstance(function, str | Quantity):
            return derivatives(self, function)
        base, system, rows = followed.base, self._legs[0].system, []

        def at(side, t, q, v_and_lam):
            v, lam = np.split(v_and_lam, [system.nv])
            return np.asarray(function(side.mechanism, t, q, v, lam), float)

        sol = self.solution
        by_state = np.concatenate((self.dq, self.dv, self.dlam), axis=1).transpose(0, 2, 1)
        for t, q, v, lam, s in zip(sol.t, sol.q, sol.v, sol.lam, by_state, strict=True):
            state = base, system, float(t), q, np.concatenate((v, lam))
            pairs = zip(followed.variants, s, strict=True)
            rows.append(np.stack([moved(at, variant, *state, row) for variant, row in pairs], axis=-1))
        return np.array(rows)

    def __getstate__(self):
        """Without the steps of the run and its systems, which hold Pinocchio's workspaces and the user's functions."""
        return self.__dict__ | {"_legs": [], "_pass": None}

    def _followed(self) -> ForwardPass:
        if self._pass is None:
            raise InputError(
                "copied or unpickled sensitivities have only the rows of the run: call at() and of() before, or choose "
                "the rows by t_eval="
            )
        return self._pass


def sensitivities(
    build: Callable | Mechanism, theta, t_span, q0=None, v0=None, *, names: Sequence[str] | None = None, steps=None,
    forces=(), events=None, rtol=1e-8, atol=1e-10, **options: Any,
) -> Sensitivities:  # fmt: skip
    """Simulate a mechanism, and differentiate motion, multipliers and event times with respect to parameters.

    The derivatives are propagated along the accepted steps of Radau IIA by the formulas of the method, across changes
    of step size, order and constraint rows, events and drives. They are derivatives of the solution, not finite
    differences of runs, which adaptive steps spoil: their relative error is about 10 to 30 times that of the state.

    Parameters
    ----------
    build : callable or Mechanism
        A mechanism whose parameters are named by `theta`; or ``build(theta) -> Mechanism`` with arbitrary parameters of
        bodies, joints, loops, forces, drives, gravity. It must return the same joints and loops for all values. If it
        returns the same object for other values, only the initial state depends on the parameter, which costs less.
    theta : array, shape (P,), or sequence of str
        Values of the parameters; or names of parameters of a mechanism: see :mod:`pinconsist.mechanism.parameters`, and
        ``JOINT`` and ``JOINT_speed`` for the initial position and velocity of a joint of one degree of freedom.
    t_span, q0, v0, forces
        As in :func:`simulate`; ``q0`` and ``v0`` may be functions of theta.
    names : sequence of str, optional
        Names of the parameters. Default ``theta[0]``, …
    steps : sequence of float, optional
        Difference steps of the parameters, used if the derivatives of the equations are finite differences. None, the
        default for each, chooses the step: 1e-4 of the value, or less if the equations are not smooth enough.
    events
        As in :func:`simulate`; or a function of theta alone that returns them.
    rtol, atol
        As in :func:`simulate`, with tighter defaults.
    **options
        As in :func:`simulate`; the method is Radau IIA.

    Returns
    -------
    Sensitivities

    Raises
    ------
    InputError
        As :func:`simulate`; parameters that change the number of joints or rows, or open redundant loops, or on which
        the equations do not depend smoothly; an event function that grazes zero, with zero slope; a sampled law whose
        derivatives are not known; a parameter that moves a time at which forces jump.
    PinconsistError
        The run failed at its start.
    """
    run = build, theta, t_span, q0, v0, names, steps, forces, events, rtol, atol, options
    solution, legs, variants, base, names, values = prepared(*run)
    forward = ForwardPass(solution, legs, variants, base)
    forward.run()
    dq, dv, dlam = _parts(np.concatenate(forward.rows), base.mechanism.nv)
    rows = dq, dv, dlam, forward.event_times
    found = Sensitivities(solution, names, values, variants.steps, *rows, forward.work, legs, forward)
    weakref.finalize(found, forward.close)  # at the latest when Python exits
    return found


def _parts(rows, nv):
    """dq, dv and dlam, read-only, with the parameter as the last index."""
    parts = [np.ascontiguousarray(part.transpose(0, 2, 1)) for part in np.split(rows, [nv, 2 * nv], axis=2)]
    for part in parts:
        part.setflags(write=False)
    return tuple(parts)


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
        Names of the parameters.
    solution : Solution
        The run.
    """

    value: float
    gradient: np.ndarray
    names: tuple[str, ...]
    solution: Solution


def gradient(
    build: Callable | Mechanism, theta, t_span, q0=None, v0=None, *, rows: Callable | tuple | None = None,
    terminal: Callable | tuple | None = None, names: Sequence[str] | None = None, steps=None, forces=(), events=None,
    t_eval=None, rtol=1e-8, atol=1e-10, **options: Any,
) -> Gradient:  # fmt: skip
    """Simulate a mechanism, and differentiate one number of the run with respect to many parameters.

    The number is the sum of ``rows(t, q, v, lam)`` over the times `t_eval`, plus ``terminal(t, q, v, lam)`` at the end.
    Its derivative agrees with that of :func:`sensitivities` to rounding, and is computed in one backward pass over the
    steps, which does not depend on the number of parameters.

    Parameters
    ----------
    build, theta, t_span, q0, v0, names, steps, forces, events, rtol, atol, **options
        As in :func:`sensitivities`.
    rows, terminal : callable, or pair of callables, optional
        ``f(t, q, v, lam) -> float``; or a pair of it and ``(t, q, v, lam) -> (f_q, f_v, f_lam)``, its derivatives,
        shapes (nv,), (nv,), (nc,), with f_q in the tangent space. Default: finite differences.
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
        raise InputError("gradient() needs a number: a function rows= of each row, or terminal= of the last state")
    if (rows is None) != (t_eval is None):
        raise InputError("rows= and t_eval= go together: the function, and the times over which it is summed")
    times = np.zeros(0) if t_eval is None else np.atleast_1d(np.asarray(t_eval, float))
    options = {**options, "t_eval": np.append(times, t_span[1])}
    run = build, theta, t_span, q0, v0, names, steps, forces, events, rtol, atol, options
    solution, legs, variants, base, names, _ = prepared(*run)
    if solution.status != 0:
        raise PinconsistError(f"the number needs the whole run, which ended early: {solution.message}")

    number = Number(solution, rows, terminal)
    gradient = BackwardPass(solution, legs, variants, base, number.derivative).run()
    return Gradient(number.value(), gradient, names, solution)
