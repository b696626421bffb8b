"""The two main functions: `simulate` a mechanism, `integrate` any index-3 system."""

import numpy as np

from ..engine.hessenberg import HessenbergProblem
from ..engine.norms import largest
from ..engine.problem import Index3System
from ..errors import InputError
from ..mechanism.assembly import assembled
from ..mechanism.checks import finite_array, flag
from ..mechanism.closing import LoopSolver
from ..mechanism.file_laws import with_dry_friction, with_limits
from ..mechanism.mechanism import Mechanism, with_added_forces
from ..mechanism.rank import require_nonsingular
from ..mechanism.system import MechanismSystem
from .events import as_events
from .integrate import integrate as advance
from .interrupts import deferred
from .options import Options, looking, span_of, warn_of_differences, without_backend
from .output import Output
from .solution import Solution
from .steppers import stepper_for


def simulate(
    mech, t_span, q0=None, v0=None, *, method=None, step=None, order=None, rtol=1e-6, atol=1e-8, forces=(),
    control=None, t_eval=None, dense_output=False, events=None, callback=None, consistency="every-step",
    first_step=None, max_step=np.inf, max_steps=None, limits="watch", dry_friction="smooth", backend=None,
) -> Solution:  # fmt: skip
    """Assemble a mechanism and integrate its index-3 equations of motion.

    Parameters
    ----------
    mech : Mechanism
        The scene; see :func:`pinconsist.load`.
    t_span : (float, float)
        Start and end, s. An end before the start integrates backwards.
    q0 : mapping or array, optional
        Mapping joint name → value: the named joints keep these values if the loops allow it, otherwise a warning
        reports the actual ones; the others follow. Array (nq,): an initial guess from which the loops are closed; all
        entries may change. Default: the scene's guess.
    v0 : mapping or array, optional
        Mapping joint name → velocity: the named joints keep it, the others follow. Array (nv,): projected
        onto the constraints in the mass metric. Default: rest.
    method : {"Radau", "BDF", "ImplicitEuler"}, optional
        Radau IIA, whose steps need no history; BDF of variable order; or implicit Euler (BDF-1). Default: Radau IIA;
        BDF for mechanisms of more than 32 degrees of freedom, where it is faster, if neither `step` nor `order` is
        given, and for values of `consistency` that Radau does not support.
    step : float, optional
        Fixed step, s; reduced to the largest step that divides the interval. The order is then constant, and Newton
        iterates to rounding. By default step and order vary.
    order : int, optional
        Radau: 1, 3, 5, 9 or 13; by default it starts at 9 and varies. BDF: the maximum order, 1 to 5 (default 5); with
        `step` the constant order, 1 to 6.
    rtol, atol : float or (float, float)
        The accuracy of the run in positions and velocities, relative to the largest value of each coordinate and
        absolute; a pair (q, v) sets them separately. ``sol.error`` estimates what was achieved: a motion that amplifies
        errors loses accuracy. The multipliers are never part of the error test; they converge with the velocities.
    forces : sequence
        Forces in addition to the mechanism's own; see :class:`Mechanism`.
    control : mapping, optional
        Commands of actuators, by their names or those of their joints: ``{"knee": 0.4}``, a number, a function of time,
        or a table (times, values), interpolated linearly and constant outside; see :meth:`Mechanism.with_control`.
    t_eval : array, optional
        Times of the rows, within the span and in its direction; no other rows are stored. Rows are interpolated between
        steps: their loops are closed only to the tolerance. Default: every accepted step.
    dense_output : bool
        Whether to compute a continuous solution ``sol.sol(t) -> (q, v, lam)``.
    events : Event or function, or sequence of them, optional
        See :class:`Event`; plain functions ``g(t, q, v, lam)`` may carry ``terminal``, ``direction``, ``apply``.
    callback : callable, optional
        ``callback(t, q, v, lam)`` after every accepted step; a true value stops the run. If it has an attribute
        ``order``, this is first set to the order of the step (0: the start of BDF). The next step is computed after it
        has returned.
    consistency : {"every-step", "initial", "exact"}
        ``"every-step"``: every accepted step is projected onto the hidden constraint; multipliers have full order
        throughout. ``"initial"``: only the starting velocities are made numerically consistent (Arévalo 2008); for
        fixed steps. ``"exact"``: plain BDF from the exact values; its first multipliers are wrong.
    first_step, max_step : float, optional
        First and largest step of the variable-step method, s. If there are laws of (t, q, v) among the forces, or
        actuators with a force limit, the default is a tenth (Radau) or a twentieth (BDF) of the span, because they may
        become active after a period of rest. See the notes.
    max_steps : int, optional
        Stop with an error after this many steps.
    limits : {"watch", "stops", "off"}
        What the position limits of the file do: watched, :meth:`Solution.check` names the joints that leave them; or
        they are stops, see :class:`Stop`; or nothing.
    dry_friction : {"smooth", "exact"}
        Whether dry friction of the file is smoothed near rest, or holds the joints, see :class:`DryFriction`.
    backend : str, optional
        Deprecated; has no effect.

    Returns
    -------
    Solution
        If the integration fails, ``success`` is False, and the solution contains the rows so far and a message. Ctrl-C
        ends the run with the rows so far and ``status`` 1; after the last step it has no effect.

    Notes
    -----
    Steps end at the times of tables, at the knots of drives and of SciPy splines, and where functions of time (of
    drives, constraints, forces, targets and commands) have a jump or a kink, or where a pulse begins, peaks or ends.
    These times are located before a variable-step run: such functions are sampled 2,000 times over the span, and every
    millisecond up to 10,000 times (constraints and laws of (t, q, v) at the initial state), and up to 10,000 times more
    for the exact times of jumps and kinks. They are called only within the span. Pulses shorter than two samples may be
    missed: pass their times, as a table, as `knots` or in a :class:`Piecewise`, or limit steps by `max_step`. A fixed
    `step` ends at known times only. A function that depends on earlier calls is not a function of time: use
    :class:`Sampled`. (For laws that are objects, a copy is sampled; laws that do not use t are not sampled.)

    Raises
    ------
    InputError
        Arguments that cannot be used.
    AssemblyError
        The loops cannot be closed, `v0` contradicts them, or `q0` a drive.
    SingularSystemError
        Some joint can move without any inertia.
    UserFunctionError
        A user-defined function raised an exception before the first step; later ones result in a failed solution.
    """
    without_backend(backend)
    mech = with_added_forces(mech, forces, "simulate")
    mech = mech if control is None else mech.with_control(control)
    mech = with_dry_friction(with_limits(mech, limits), dry_friction)
    span = span_of(t_span)
    options = Options(method, step, order, rtol, atol, consistency, first_step, max_step, max_steps)
    method = options.for_span(span)  # errors in the options come before those of the mechanism
    solver = LoopSolver(mech, span[0])
    solver.loop_rows.breakpoints.look_ahead(span[0], span[1], mech.guess, np.zeros(mech.nv), step is None)
    assembly = assembled(solver, q0, v0)
    system = MechanismSystem(mech, assembly.q, span[0], solver)
    require_nonsingular(system, assembly.q)
    output = _output(span, t_eval, dense_output, as_events(events, mech), callback)
    return _integrated(system, span, assembly.q, assembly.v, options, method, output)


def integrate(
    system, t_span, p0, v0, *, method=None, step=None, order=None, rtol=1e-6, atol=1e-8, t_eval=None,
    dense_output=False, events=None, callback=None, consistency="every-step", first_step=None, max_step=np.inf,
    max_steps=None, backend=None,
) -> Solution:  # fmt: skip
    """Integrate an index-3 system from initial values, without assembly.

    Parameters
    ----------
    system : HessenbergProblem or Mechanism or Index3System
        The system to integrate; a mechanism with its own forces.
    t_span : (float, float)
        Start and end, s.
    p0, v0 : array
        Initial position, which must satisfy the constraint, and velocity. The velocity need not satisfy the hidden
        constraint, because numerically consistent values do not.
    method, step, order, rtol, atol, t_eval, dense_output, events, callback, consistency, first_step, max_step, \
    max_steps, backend
        As in :func:`simulate`.

    Returns
    -------
    Solution
        With ``q`` and ``v`` for the p and v (the paper's q) of the general form.

    Raises
    ------
    InputError
        Wrong sizes, NaN, or a position that violates the constraint, which at index 3 would cause a multiplier error of
        |Φ|/step².
    """
    without_backend(backend)
    span = span_of(t_span)
    options = Options(method, step, order, rtol, atol, consistency, first_step, max_step, max_steps)
    method = options.for_span(span)
    p0, v0 = finite_array(p0, "p0"), finite_array(v0, "v0")
    system = system_of(system, span[0], p0, v0)
    phi = system.constraint(span[0], p0, system.rate(span[0], p0, v0))[0]
    size = largest(phi)
    if not size <= 1e-6 * (1.0 + largest(p0)):
        raise InputError(
            f"p0 is off the constraint by {size:.3g} ({system.describe_row(int(np.argmax(np.abs(phi))))}); an index-3 "
            "method turns that into a multiplier error of that size over the step squared. Pass a p0 on the "
            "constraint, or use simulate(), which assembles"
        )
    events = as_events(events, system.mechanism)
    output = _output(span, t_eval, dense_output, events, callback)
    return _integrated(system, span, p0, v0, options, method, output)


def _integrated(system, span, p0, v0, options, chosen, output) -> Solution:
    contacts = () if system.mechanism is None else system.mechanism.contacts
    freedoms = 0 if contacts else system.nv - system.nc  # Radau for contacts
    if options.chosen(freedoms) != options.chosen(0):
        chosen = options.for_span(span, freedoms)
    warn_of_differences(system, chosen)
    chosen = looking(chosen, system, span)
    with deferred(late=False) as interrupted:
        stepper = stepper_for(system, chosen)
        trajectory = advance(system, span, p0, v0, chosen, output, stepper, interrupted)
        return Solution._from_trajectory(trajectory, chosen, output.events)


def system_of(system, t0, p0, v0):
    """The Index3System of a Mechanism or HessenbergProblem at a state, or the given Index3System; else InputError."""
    if isinstance(system, Mechanism):
        if p0.shape != (system.nq,) or v0.shape != (system.nv,):
            raise InputError(
                f"{system.name}: p0 and v0 need shapes ({system.nq},) and ({system.nv},), got {p0.shape} and {v0.shape}"
            )
        if np.max(np.abs(system.configuration(p0) - p0)) > 1e-8:
            raise InputError(f"{system.name}: p0 has a quaternion or a (cos, sin) pair that is not of unit length")
        built = MechanismSystem(system, p0, t0)
        require_nonsingular(built, p0)
        return built
    if isinstance(system, HessenbergProblem):
        return system.at(t0, p0, v0)
    if isinstance(system, Index3System):
        return system
    raise InputError(f"cannot integrate a {type(system).__name__}; give a Mechanism or a HessenbergProblem")


def _output(span, t_eval, dense_output, events, callback) -> Output:
    if callback is not None and not callable(callback):
        raise InputError(f"callback must be a function of (t, q, v, lam), got {type(callback).__name__}")
    if t_eval is not None:
        t_eval = np.atleast_1d(finite_array(t_eval, "t_eval"))
        low, high = min(span), max(span)
        if t_eval.ndim != 1:
            raise InputError(f"t_eval must be one row of times, got an array of shape {t_eval.shape}")
        if (t_eval < low).any() or (t_eval > high).any():
            raise InputError(f"t_eval must be times between {low:g} and {high:g} s")
        if ((span[1] - span[0]) * np.diff(t_eval) < 0).any():
            raise InputError("t_eval must be sorted in the direction of t_span")
    return Output(t_eval, flag(dense_output, "dense_output"), events, callback)
