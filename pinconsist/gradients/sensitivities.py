"""Derivatives of a run by a few parameters: the derivatives of the state are led along its accepted steps."""

import inspect
import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..dae.events import as_events
from ..errors import InputError, PinconsistError
from ..mechanism.checks import finite_array
from ..mechanism.forces import HeldTorque, Piecewise, Sampled
from ..mechanism.mechanism import Mechanism, with_forces
from ..simulation import simulate
from ..solution import Solution
from .forward import Leg, legs_of
from .lead import Lead
from .named import named_start
from .starts import moved
from .variants import Side
from .varied import variants_of


@dataclass(frozen=True, eq=False)
class Sensitivities:
    """A run and its derivatives with respect to parameters: rows as in the solution, parameters along the last axis.

    Attributes
    ----------
    solution : Solution
        The run itself.
    names, values : tuple of str, ndarray, shape (P,)
        Of the parameters.
    steps : ndarray, shape (P,)
        By which they were moved, where derivatives of the equations come from differences.
    dq : ndarray, shape (n, nv, P)
        Derivatives of the configurations as tangent vectors, like velocities: for joints with one number they are those
        of ``q``, for rotations in axes of the body.
    dv, dlam : ndarray, shapes (n, nv, P), (n, nc, P)
        Derivatives of velocities and multipliers.
    event_times : list of ndarray, shape (m, P)
        Derivatives of ``solution.t_events``.
    work : dict
        What it took: ``steps`` that were followed, ``evaluations`` of the equations beside the run's.
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
    _lead: Lead = field(repr=False)

    def __repr__(self):
        return f"Sensitivities of {self.solution.scene or 'a run'} by {', '.join(self.names)}: {len(self.dq)} rows"

    def at(self, t) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(dq, dv, dlam) at any time of the run; at an event that changes the state, before it.

        Parameters
        ----------
        t : float or array, shape (n,)
            Times, s.

        Returns
        -------
        tuple of ndarray, shapes (nv, P), (nv, P), (nc, P)
            For several times n of each, (n, nv, P) and so on.

        Raises
        ------
        InputError
            A time outside of the run.
        """
        times = finite_array(t, "t")
        asked, (begin, end) = np.atleast_1d(times), (self._legs[0].span[0], self._legs[-1].span[1])
        if (asked < min(begin, end)).any() or (asked > max(begin, end)).any():
            raise InputError(f"the run goes from t = {begin:g} to {end:g} s, asked for {t}")
        sign, ends = self._lead.sign, np.array([leg.span[1] for leg in self._legs])
        holders = np.minimum(np.searchsorted(sign * ends, sign * asked), len(ends) - 1)
        rows = np.empty((len(asked), len(self.names), 2 * self.dv.shape[1] + self.dlam.shape[1]))
        for i in np.unique(holders):
            rows[holders == i] = self._lead.finished(self._legs[i], asked[holders == i])
        parts = _parts(rows, self.dv.shape[1])
        return parts if times.ndim else tuple(part[0] for part in parts)

    def of(self, function: Callable) -> np.ndarray:
        """Derivatives of something else at the rows of the solution: the place of a frame, an energy, a stress.

        Parameters
        ----------
        function : callable
            ``function(mech, t, q, v, lam)``, a number or an array; `mech` is the mechanism with the parameters' values.

        Returns
        -------
        ndarray, shape (n, …, P)
            What `function` returns in between.
        """
        base, system, rows = self._lead.base, self._legs[0].system, []

        def at(side, t, q, v_and_lam):
            v, lam = np.split(v_and_lam, [system.nv])
            return np.asarray(function(side.mechanism, t, q, v, lam), float)

        sol = self.solution
        derivatives = np.concatenate((self.dq, self.dv, self.dlam), axis=1).transpose(0, 2, 1)
        for t, q, v, lam, s in zip(sol.t, sol.q, sol.v, sol.lam, derivatives, strict=True):
            state = base, system, float(t), q, np.concatenate((v, lam))
            pairs = zip(self._lead.variants, s, strict=True)
            rows.append(np.stack([moved(at, variant, *state, row) for variant, row in pairs], axis=-1))
        return np.array(rows)


def sensitivities(
    build: Callable | Mechanism,
    theta,
    t_span,
    q0=None,
    v0=None,
    *,
    names: Sequence[str] | None = None,
    steps=None,
    forces=(),
    events=None,
    rtol=1e-8,
    atol=1e-10,
    backend="auto",
    **options: Any,
) -> Sensitivities:
    """Simulate a mechanism, and differentiate motion, multipliers and event times with respect to parameters.

    The derivatives are propagated along the accepted steps by the method's own formulas (staggered, every step put on
    the hidden constraint), through changes of step and order, of constraint rows, events and drives. They are those of
    the solution, not differences of runs, which adaptive steps make useless: their relative error is about 10 to 30
    times that of the state.

    Parameters
    ----------
    build : callable or Mechanism
        A mechanism, of which `theta` names parameters; or ``build(theta) -> Mechanism``: any parameters whatever, of
        bodies, joints, loops, forces, drives, gravity. It must give the same joints and loops for all values. Where it
        returns the very same object, only the start depends on the parameter, which costs less.
    theta : array, shape (P,), or sequence of str
        Values of the parameters; or the names of those of a mechanism: see :mod:`pinconsist.mechanism.parameters`, and
        ``JOINT`` and ``JOINT_speed`` for where a joint of one degree of freedom starts and how fast.
    t_span, q0, v0, forces
        As in :func:`simulate`; ``q0`` and ``v0`` may be functions of theta.
    names : sequence of str, optional
        Of the parameters. Default ``theta[0]``, …
    steps : sequence of float, optional
        By which parameters are moved, where derivatives of the equations come from differences; None for those that
        are to be chosen, by default all: 1e-4 of the value, shorter where the equations are not that smooth.
    events
        As in :func:`simulate`; or a function of theta alone that returns them.
    rtol, atol
        As in :func:`simulate`, with tighter defaults.
    backend, **options
        As in :func:`simulate`, with ``consistency="every-step"``.

    Returns
    -------
    Sensitivities

    Raises
    ------
    InputError
        What :func:`simulate` raises; parameters that change the number of joints or rows, part redundant loops, or are
        not smooth; an event that only grazes zero; torques that are held or sampled, forces that jump at known times.
    PinconsistError
        The run failed at its start.
    """
    run = prepared(build, theta, t_span, q0, v0, names, steps, forces, events, rtol, atol, backend, options)
    solution, legs, variants, base, names, values = run
    lead = Lead(solution, legs, variants, base)
    lead.run()
    dq, dv, dlam = _parts(np.concatenate(lead.rows), base.mechanism.nv)
    rows = dq, dv, dlam, lead.event_times
    found = Sensitivities(solution, names, values, variants.steps, *rows, lead.work, legs, lead)
    weakref.finalize(found, lead.close)  # at the latest where Python ends
    return found


def prepared(build, theta, t_span, q0, v0, names, steps, forces, events, rtol, atol, backend, options):
    """(solution, legs, variants, base, names, theta): the run, and the mechanisms beside the one that was run."""
    control = options.pop("control", None)
    if isinstance(build, Mechanism):
        mechanism, control = build if control is None else build.with_control(control), None
        build, names, theta, q0, v0 = named_start(mechanism, theta, q0, v0)
    theta = np.atleast_1d(finite_array(theta, "theta"))
    names = _names(names, theta)
    if steps is not None and len(steps) != len(theta):
        raise InputError(f"steps= needs one for each of the {len(theta)} parameters, got {len(steps)}")
    if (mode := options.get("consistency", "every-step")) != "every-step":
        raise InputError(
            f"sensitivities need consistency='every-step', not {mode!r}: raw BDF leaves a hidden residual, whose "
            "derivative makes those of the multipliers wrong"
        )
    make = _maker(build, t_span[0], q0, v0, forces, events, backend, control)
    base = make(theta)
    solution = simulate(
        base.mechanism, t_span, base.q0, base.v0, events=base.events, rtol=rtol, atol=atol, backend=backend,
        **{**options, "dense_output": True},
    )  # fmt: skip
    if solution.sol is None:
        raise PinconsistError(f"the run itself failed: {solution.message}")
    legs = legs_of(solution.sol, base.index1)
    first = legs[0].start
    state, parameters = first(first.t_old)[:2], getattr(build, "parameters", ())
    end = legs[-1].span[1]  # where what depends on t has changed most
    variants = variants_of(make, theta, names, steps, base, first.system, end, *state, parameters)
    return solution, legs, variants, base, names, theta


def _parts(rows, nv):
    """dq, dv and dlam, read-only, with the parameter as the last index."""
    parts = [np.ascontiguousarray(part.transpose(0, 2, 1)) for part in np.split(rows, [nv, 2 * nv], axis=2)]
    for part in parts:
        part.setflags(write=False)
    return tuple(parts)


def _names(names, theta):
    if theta.ndim != 1 or not len(theta):
        raise InputError(f"theta needs at least one number in one row, got shape {theta.shape}")
    names = tuple(names) if names is not None else tuple(f"theta[{i}]" for i in range(len(theta)))
    if len(names) != len(theta):
        raise InputError(f"names= needs one for each of the {len(theta)} parameters, got {len(names)}")
    return names


def _maker(build, t, q0, v0, forces, events, backend, control=None):
    """``make(theta) -> Side``; the same mechanism for the same object that `build` returns."""
    made: dict = {}

    def make(values) -> Side:
        mechanism = build(values.copy())
        if not isinstance(mechanism, Mechanism):
            raise InputError(f"build(theta) must return a Mechanism, it returned a {type(mechanism).__name__}")
        if id(mechanism) not in made:
            commanded = mechanism if control is None else mechanism.with_control(control)
            made[id(mechanism)] = mechanism, with_forces(commanded, forces, "sensitivities")
        acting = made[id(mechanism)][1]
        if any(isinstance(force, HeldTorque | Piecewise | Sampled) for force in acting.forces):
            raise InputError(
                "derivatives of runs do not pass times at which forces jump, such as held or sampled torques: "
                "the steps start anew there, and the multipliers jump. Give smooth functions of time, or commands of "
                "an Actuator as a table"
            )
        starts = [value(values.copy()) if callable(value) else value for value in (q0, v0)]
        return Side(acting, starts[0], starts[1], t, as_events(_of_theta(events, values)), backend != "python")

    return make


def _of_theta(events, values):
    """The events, by a function of theta alone if they are given as one."""
    if callable(events) and len(inspect.signature(events).parameters) == 1:
        return events(values.copy())
    return events
