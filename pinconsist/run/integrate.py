"""The one loop: begin, advance, look for events, record."""

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from ..engine.failure import FAILURES, failure_report, jumping
from ..engine.norms import largest
from ..engine.problem import Index3System
from ..engine.rounding import Pace
from ..errors import PinconsistError, UserFunctionError
from .control import ErrorControl, FixedStep, Switches
from .dense import DenseOutput, StepBatch
from .events import STILL, EventWatch, state_after
from .output import FAILED, STOPPED, SUCCESS, Output, Record, Stop

CLOSED = 1e-6  # gap of a constraint, relative to positions and 1 rad or m, that is no jump


@dataclass
class Method:
    """The method of one run: order, consistency and step control."""

    order: int
    consistency: str
    control: FixedStep | ErrorControl
    step: float | None
    first_step: float | None = None
    max_steps: int | None = None
    switches: Switches = field(default_factory=Switches)
    stages: int | None = None  # of Radau IIA; 0 if the method chooses them, None for BDF

    @property
    def name(self) -> str:
        """The method's name."""
        return "BDF" if self.stages is None else "Radau"

    def describe(self) -> dict:
        """The method in plain numbers and words, for the record."""
        about = {"method": self.name, "order": self.order, "consistency": self.consistency, "step": self.step}
        if isinstance(self.control, ErrorControl):
            about["rtol"] = [np.asarray(part).tolist() for part in self.control.rtol]
            about["atol"] = [np.asarray(part).tolist() for part in self.control.atol]
            about |= {"max_step": self.control.max_step} if self.control.max_step < np.inf else {}
        return about


@dataclass
class Trajectory:
    """What an integration reached, as in :class:`~pinconsist.run.solution.Solution`. Rows are times."""

    t: np.ndarray
    p: np.ndarray
    v: np.ndarray
    lam: np.ndarray
    system: Index3System  # at the end: other rows of its constraints may be kept than at the start
    status: int
    message: str
    nsteps: int = 0
    nfev: int = 0
    njev: int = 0
    nlu: int = 0
    rejected: dict = field(default_factory=dict)
    h: np.ndarray = field(default_factory=lambda: np.zeros(0))
    order: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    dense: DenseOutput | None = None
    events: list = field(default_factory=list)  # occurrences (t, p, v) of each event
    changes: list = field(default_factory=list)  # of the state by events
    opened: tuple | None = None  # where a constraint that was left out is violated, see Index3System.opened


def integrate(
    system,
    t_span,
    p0,
    v0,
    method: Method,
    output: Output,
    stepper,
    interrupted: Callable[[], bool] | None = None,
) -> Trajectory:
    """Integrate an index-3 system from (p0, v0), taken as given.

    Parameters
    ----------
    system, t_span, p0, v0 : Index3System, (float, float), ndarray, ndarray
        The system, the interval (s; backwards if the end is earlier), initial position and velocity.
    method, output : Method, Output
        The method, and what to record.
    stepper : Stepper
        Makes the steps, for this system and method: see run/steppers.py.
    interrupted : callable, optional
        ``interrupted() -> bool``, called between batches of steps; a true value ends the run; what was reached is
        returned.

    Returns
    -------
    Trajectory
        If the method fails, ``status`` is -1, and the rows reached are returned.
    """
    interrupted = interrupted or (lambda: False)
    with closing(stepper):
        record = Record(output, t_span, stepper.full_multipliers, interrupted)
        watch = EventWatch(output.events, stepper, interrupted)
        status, message = SUCCESS, "the end of the interval was reached"
        try:
            stepper.system.look_ahead(*t_span, p0, v0, method.step is None)
            stepper.system.start(t_span[0], p0, v0, t_span[1] < t_span[0])
            lam0 = stepper.index1.acceleration(t_span[0], p0, v0)[1]
            record.first(t_span[0], p0, v0, lam0)
            watch.restart(t_span[0], p0, v0, lam0)
            march(stepper, t_span, p0, v0, method, record, watch, interrupted)
        except Stop as stop:
            status, message = stop.status, str(stop)
        except KeyboardInterrupt:
            status, message = STOPPED, f"interrupted at t = {record.reached:.6g}; the solution holds what was reached"
        except (PinconsistError, MemoryError, SystemExit) as raised:
            error = _ending(raised, record.reached)
            if record.nsteps == 0:  # nothing was reached that could be lost
                raise error from error.__cause__
            status, message = FAILED, f"{str(error) or 'out of memory'} (reached t = {record.reached:.6g})"
        return trajectory_of(stepper, method, record, watch, t_span, status, message)


def trajectory_of(stepper, method, record, watch, t_span, status, message) -> Trajectory:
    """The trajectory that was recorded so far."""
    rows, newton = record.arrays(stepper.system), stepper.newton
    h, order = record.steps(rows[0])
    return Trajectory(
        *rows, system=stepper.system, status=status, message=message, nsteps=record.nsteps,
        nfev=newton.nfev, njev=newton.njev, nlu=newton.nlu, rejected=dict(method.control.reasons),
        dense=record.dense(), events=watch.until(record.reached, t_span[1] >= t_span[0]),
        h=h, order=order, changes=list(watch.changes), opened=stepper.opened(rows[0], rows[1]),
    )  # fmt: skip


def _ending(error, t):
    """The error that ends a run; sys.exit() in a user's function counts as its error, and does not end the program."""
    if not isinstance(error, SystemExit):
        return error
    told = UserFunctionError("a user-defined function", t, error)
    told.__cause__ = error
    return told


def march(stepper, t_span, p, v, method, record, watch, interrupted, resumes=False, jumped=False):
    """Integrate from (p, v); or continue (`resumes`) from the stepper's state, where forces may have `jumped`."""
    (t, t_end), with_curve, known = t_span, record.needs_curve, None
    passes = not watch.events and stepper.system.changes and stepper.passes_changes(with_curve)
    pace, signs = Pace(method.control, t, record.nsteps), watch.signs
    # Called with each step before the next one is made, if a user's function might change the next one.
    sees = record.sees if record.output.each_step and not (stepper.ahead and not passes) else None

    def more(until):
        most, forces = _batch_size(stepper, method, record), [stepper.system] * passes
        made = stepper.steps(until, most, with_curve, signs, sees, *forces)
        left = (method.max_steps or np.inf) - record.nsteps
        return made if len(made.t) <= left else made.first(left)  # a start makes several

    while t != t_end:  # once, and again after every event that changes the state and where forces jump
        _stop_if(interrupted)
        stop = record.next_stop(t, t_end)
        until = stepper.system.next_change(t, stop)
        first, *stepper.unseen = stepper.resume(until) if resumes else stepper.begin(t, p, v, until, known)
        if jumped:
            record.jump(*first)
            if (hit := watch.jumped(*first)) is not None:
                p, v, known = _after_events(stepper, watch, record, *hit)
                resumes = jumped = False
                continue
        resumes, jumped, known, until = False, False, None, stop if passes else until
        batch = _started(stepper, method, record, with_curve) if stepper.unseen else more(until)
        while True:
            hit = _look(watch, stepper, batch, record) if signs and not batch.error else None
            if hit is not None:
                t, state = hit[1:3]
                record.add(batch.cut(record.needs_curve, t, *state))
                p, v, known = _after_events(stepper, watch, record, *hit)
                break
            record.add(batch)
            if batch.error is not None:
                raise batch.error
            t = stepper.t
            if batch.failure and not _choose_rows(stepper, record):
                raise Stop(FAILED, failure_report(stepper, batch.failure))
            if t == t_end == record.reached:
                return
            if method.max_steps is not None and record.nsteps >= method.max_steps:
                raise Stop(FAILED, f"max_steps = {method.max_steps} used up at t = {record.reached:.6g} of {t_end:.6g}")
            if pace.lost(record.nsteps, t, t_end, partial(jumping, stepper)):
                raise Stop(FAILED, failure_report(stepper, FAILURES["chatters"]))
            other_rows = batch.failure or (record.nsteps % stepper.rows_watched == 0 and _choose_rows(stepper, record))
            if other_rows or t == until:
                p, v = stepper.p, stepper.v
                changed = stepper.system.change(t, p, v) if t == until or passes else None
                if other_rows or changed is not None or t == stop:
                    jumped, resumes = bool(changed), not other_rows
                    if jumped and (pushed := _pushed(stepper, record, watch, t, p, v)) is not None:
                        (p, v, known), jumped, resumes = pushed, False, False
                    break
                until = stop if passes else stepper.system.next_change(t, stop)
            _stop_if(interrupted)
            batch = more(until)


def _pushed(stepper, record, watch, t, p, v):
    """The state after a jump of the rates of constraints, with its acceleration and multipliers; None if none jumped.

    The projection onto the new rates is the effect of an impulse along the constraints.
    """
    if not stepper.system.moving:
        return None
    phi = stepper.system.constraint(t, p, stepper.system.rate(t, p, v))[0]
    if largest(phi) > CLOSED * (1.0 + largest(p)):
        row = stepper.system.describe_row(int(np.argmax(np.abs(phi))))
        raise PinconsistError(f"the run cannot continue at t = {t:.6g}: {row} jumps there, by {largest(phi):.3g}")
    p, pushed = stepper.index1.projected(t, p, v)
    if largest(pushed - v) <= STILL * (1.0 + largest(v)):
        return None
    known = stepper.index1.acceleration(t, p, pushed)
    record.jump(t, p, pushed, known[1])
    watch.restart(t, p, pushed, known[1])
    return p, pushed, known


def _started(stepper, method, record, with_curve):
    """The batch of steps of a start."""
    if method.max_steps is not None:
        stepper.unseen = stepper.unseen[: method.max_steps - record.nsteps]
    states = list(stepper.unseen)
    curve = stepper.curve_of_start() if with_curve and states else None
    return StepBatch.of(states, [0] * len(states), curve)


def _look(watch, stepper, batch, record):
    """The first event in these steps that changes the run; if a user's function fails, the steps before are kept."""
    try:
        return watch.first(stepper)
    except BaseException:
        record.add(batch.first(batch.before(watch.signs.end)))
        raise


def _stop_if(interrupted):
    if interrupted():
        raise KeyboardInterrupt


def _batch_size(stepper, method, record) -> int:
    """How many steps may be made before the next check of their number and of the constraint rows."""
    most = stepper.batch
    if method.max_steps is not None:
        most = min(most, method.max_steps - record.nsteps)
    if stepper.system.dropped_are_zero:
        return most
    return min(most, stepper.rows_watched - record.nsteps % stepper.rows_watched)


def _choose_rows(stepper, record) -> bool:
    """Choose other constraint rows if the kept ones have become a poor choice; the run then restarts there."""
    fresh = stepper.system.reselected(stepper.p)
    if fresh is None:
        return False
    record.complete_multipliers()  # by the rows that were kept until here
    stepper.change_system(fresh)
    return True


def _after_events(stepper, watch, record, fired, t, state, final):
    """Position and velocity after events, and the acceleration and multipliers there; Stop if one ends the run."""
    (p, v, _), events = state, [watch.events[i] for i in fired]
    if final:
        names = " and ".join(event.name or "without a name" for event in events if event.terminal)
        raise Stop(STOPPED, f"stopped by the event {names} at t = {t:.6g}")
    moved = False
    for i, event in zip(fired, events, strict=True):
        if event.apply is not None:
            after = state_after(event, stepper.index1, t, p, v, record.forward)
            watch.changed(i, stepper.system, t, (p, v), after)
            p, v = after.p, after.v
            moved |= after.moved
    stepper.system.change(t, p, v)
    known = stepper.index1.acceleration(t, p, v)
    record.jump(t, p, v, known[1])
    if why := watch.restart_after(fired, moved, stepper.system, t, p, v, known, record.forward):
        raise Stop(FAILED, why)
    return p, v, known
