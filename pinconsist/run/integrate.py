"""The one loop: begin, advance, look for events, record."""

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import numpy as np

from ..engine.failure import FAILURES, failure_report, jumping
from ..engine.norms import largest
from ..engine.problem import Index3System
from ..engine.rounding import Pace
from ..errors import InputError, PinconsistError, UserFunctionError
from ..mechanism.mode_system import ModeSystem
from .control import ErrorControl, FixedStep, Switches
from .dense import DenseOutput, StepBatch
from .events import STILL, EventWatch, state_after
from .modes import Modes
from .output import FAILED, STOPPED, SUCCESS, Output, Record, Stop

BEYOND = 1e-6  # of a step, after which the modes of redundant rows are decided
RESTS = 1e-6  # relative speed after an impact below which contacts rest, with fixed steps
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
    periods: list = field(default_factory=list)  # of the modes of contacts, see run/modes.py
    impacts: list = field(default_factory=list)
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
        modes = modes_of(system, method, t_span)
        watch = EventWatch(output.events, stepper, interrupted, modes)
        status, message = SUCCESS, "the end of the interval was reached"
        try:
            stepper.system.look_ahead(*t_span, p0, v0, method.step is None)
            stepper.system.start(t_span[0], p0, v0, t_span[1] < t_span[0])
            if modes is not None:
                p0, v0 = start_in_modes(stepper, watch, t_span[0], p0, v0)
            lam0 = stepper.index1.acceleration(t_span[0], p0, v0)[1]
            record.first(t_span[0], p0, v0, lam0)
            watch.restart(t_span[0], p0, v0, lam0)
            march(March(stepper, t_span, method, record, watch, interrupted), Start(p0, v0))
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
    rows = record.arrays(stepper.system)
    newton = stepper.newton
    modes = watch.modes
    h, order = record.steps(rows[0])
    return Trajectory(
        *rows, system=stepper.system, status=status, message=message, nsteps=record.nsteps,
        nfev=newton.nfev, njev=newton.njev, nlu=newton.nlu, rejected=dict(method.control.reasons),
        dense=record.dense(), events=watch.until(record.reached, t_span[1] >= t_span[0]),
        h=h, order=order, changes=list(watch.changes), opened=stepper.opened(rows[0], rows[1]),
        periods=list(modes.periods) if modes else [], impacts=list(modes.impacts) if modes else [],
    )  # fmt: skip


def modes_of(system, method, t_span):
    """The modes of the contacts of a system; None if it has none, or is in a mode that stays.

    Raises InputError where contacts are not supported.
    """
    if system.mechanism is None or isinstance(system, ModeSystem):
        return None
    contacts = system.mechanism.contacts
    if not contacts:
        return None
    names = ", ".join(repr(each.name) for each in contacts[:4])
    if method.name != "Radau":
        raise InputError(
            f"BDF cannot run a mechanism with contacts ({names}), because it needs a history at every impact: leave "
            "out method=, or take method='Radau'"
        )
    if t_span[1] < t_span[0]:
        raise InputError(f"a mechanism with contacts ({names}) cannot run backwards in time: impacts cannot be undone")
    rtol, atol = method.control.wanted if isinstance(method.control, ErrorControl) else (RESTS, 0.0)
    return Modes(system, float(np.min(rtol)), float(np.min(atol)))


def start_in_modes(stepper, watch, t, p, v):
    """Choose the modes of contacts at the start; returns position and velocity, which an impact may change."""
    p, v = watch.modes.begin(t, p, v)
    stepper.change_system(watch.modes.system)
    watch.enter_mode(stepper)
    return stepper.index1.projected(t, p, v)


def _ending(error, t):
    """The error that ends a run; sys.exit() in a user's function counts as its error, and does not end the program."""
    if not isinstance(error, SystemExit):
        return error
    told = UserFunctionError("a user-defined function", t, error)
    told.__cause__ = error
    return told


class Start(NamedTuple):
    """A state from which a run begins, perhaps again; `known`: acceleration and λ there; forces may have `jumped`."""

    p: np.ndarray
    v: np.ndarray
    known: tuple | None = None
    jumped: bool = False


class Resumption(NamedTuple):
    """The run goes on from the state that it has reached, where forces may have `jumped`."""

    jumped: bool


def march(run: "March", begin: Start | Resumption | None) -> None:
    """Integrate to the end: from one start to the next, after events and where forces jump."""
    while begin is not None:
        begin = run.leg(begin)


class March:
    """A run of a stepper from `t_span[0]`: it asks for steps, and acts on the reason for which they end.

    What was reached is in the record; :class:`Stop` ends a run early.
    """

    def __init__(self, stepper, t_span, method, record, watch, interrupted):
        self.stepper = stepper
        self.method = method
        self.record = record
        self.watch = watch
        self.t, self.t_end = t_span
        self._interrupted = interrupted
        self._with_curve = record.needs_curve
        self._pace = Pace(method.control, self.t, record.nsteps)
        # Whether the engine goes on by itself where forces jump.
        self._passes = bool(watch.signs is None and stepper.system.changes and stepper.passes_changes(self._with_curve))
        # Called with each step before the next one is made, if a user's function might change the next one.
        sees = record.output.each_step and not (stepper.ahead and not self._passes)
        self._sees = record.sees if sees else None

    def leg(self, begin):
        """Steps until there is another start, which is returned; None at the end."""
        if self.t == self.t_end:
            return None
        self._stop_if_interrupted()
        stop = self.record.next_stop(self.t, self.t_end)  # where a step has to end
        change = self.stepper.system.next_change(self.t, stop)
        first, *self.stepper.unseen = self._begun(begin, change)
        if begin.jumped:
            self.record.jump(*first)
            hit = self.watch.jumped(*first)
            if hit is not None:
                return self._after_events(*hit)
        until = stop if self._passes else change
        batch = self._started() if self.stepper.unseen else self._more(until)
        while True:
            hit = self._event_in(batch)
            if hit is not None:
                return self._after_events(*hit)
            self._add(batch)
            if batch.failure and not self._other_rows():
                raise Stop(FAILED, failure_report(self.stepper, batch.failure))
            if self.t == self.t_end == self.record.reached:
                return None
            self._stop_without_progress()
            other_rows = bool(batch.failure) or (self._rows_are_due() and self._other_rows())
            at_change = self.t == until or (other_rows and self._passes)
            changed = self.stepper.system.change(self.t, *self._state()) if at_change else None
            if other_rows or changed is not None or self.t == stop:
                return self._after_change(bool(changed), other_rows)
            if self.t == until:
                until = self.stepper.system.next_change(self.t, stop)
            self._stop_if_interrupted()
            batch = self._more(until)

    def _begun(self, begin, until):
        if isinstance(begin, Resumption):
            return self.stepper.resume(until)
        return self.stepper.begin(self.t, begin.p, begin.v, until, begin.known)

    def _state(self):
        return self.stepper.p, self.stepper.v

    def _more(self, until) -> StepBatch:
        """More steps, at most as many as there may be before something has to be looked at."""
        stepper = self.stepper
        most = stepper.batch
        left = self._steps_left()
        if not stepper.system.dropped_are_zero:
            most = min(most, stepper.rows_watched - self.record.nsteps % stepper.rows_watched)
        forces = stepper.system if self._passes else None
        made = stepper.steps(until, int(min(most, left)), self._with_curve, self.watch.signs, self._sees, forces)
        return made if len(made.t) <= left else made.first(left)  # a start makes several

    def _started(self) -> StepBatch:
        """The batch of steps of a start."""
        stepper = self.stepper
        if self.method.max_steps is not None:
            stepper.unseen = stepper.unseen[: self._steps_left()]
        states = list(stepper.unseen)
        curve = stepper.curve_of_start() if self._with_curve and states else None
        return StepBatch.of(states, [0] * len(states), curve)

    def _steps_left(self):
        most = self.method.max_steps
        return np.inf if most is None else most - self.record.nsteps

    def _event_in(self, batch):
        """The first event in these steps that changes the run, recorded up to it; None if there is none."""
        if not self.watch.signs or batch.error:
            return None
        try:
            hit = self.watch.first(self.stepper)
        except BaseException:  # of a user's function: the steps before are kept
            self.record.add(batch.first(batch.before(self.watch.signs.end)))
            raise
        if hit is not None:
            _, t, state, _ = hit
            self.record.add(batch.cut(self._with_curve, t, *state))
        return hit

    def _add(self, batch) -> None:
        self.record.add(batch)
        if batch.error is not None:
            raise batch.error
        self.t = self.stepper.t

    def _rows_are_due(self) -> bool:
        return self.record.nsteps % self.stepper.rows_watched == 0

    def _other_rows(self) -> bool:
        """Choose other constraint rows if the kept ones have become a poor choice; the run then restarts there."""
        fresh = self.stepper.system.reselected(self.stepper.p)
        if fresh is None:
            return False
        self.record.complete_multipliers()  # by the rows that were kept until here
        if self.watch.modes is None:
            self.stepper.change_system(fresh)
            return True
        self.stepper.change_system(self.watch.modes.rebased(self.stepper.t, fresh.base))
        self.watch.enter_mode(self.stepper)
        state = self.stepper.t, *self._state()
        lam = self.stepper.index1.acceleration(*state)[1]
        self.watch.restart(*state, lam)
        return True

    def _stop_without_progress(self) -> None:
        record = self.record
        most = self.method.max_steps
        if most is not None and record.nsteps >= most:
            raise Stop(FAILED, f"max_steps = {most} used up at t = {record.reached:.6g} of {self.t_end:.6g}")
        if self._pace.lost(record.nsteps, self.t, self.t_end, partial(jumping, self.stepper)):
            raise Stop(FAILED, failure_report(self.stepper, FAILURES["chatters"]))

    def _stop_if_interrupted(self) -> None:
        if self._interrupted():
            raise KeyboardInterrupt

    def _after_change(self, jumped: bool, other_rows: bool) -> Start | Resumption:
        """How the run goes on where forces may have `jumped`, or `other_rows` of the constraints were chosen.

        Where rates of constraints jump, too, it starts from the velocities projected onto the new rates: the effect of
        an impulse along the constraints.
        """
        stepper = self.stepper
        system = stepper.system
        t = self.t
        p, v = self._state()
        unpushed = Start(p, v, None, jumped) if other_rows else Resumption(jumped)
        if not (jumped and system.moving):
            return unpushed
        phi = system.constraint(t, p, system.rate(t, p, v))[0]
        if largest(phi) > CLOSED * (1.0 + largest(p)):
            row = system.describe_row(int(np.argmax(np.abs(phi))))
            raise PinconsistError(f"the run cannot continue at t = {t:.6g}: {row} jumps there, by {largest(phi):.3g}")
        p, pushed = stepper.index1.projected(t, p, v)
        if largest(pushed - v) <= STILL * (1.0 + largest(v)):
            return unpushed
        known = stepper.index1.acceleration(t, p, pushed)
        self.record.jump(t, p, pushed, known[1])
        self.watch.restart(t, p, pushed, known[1])
        return Start(p, pushed, known)

    def _after_events(self, fired, t, state, final) -> Start:
        """The start after events; Stop if one ends the run."""
        stepper = self.stepper
        record = self.record
        watch = self.watch
        p, v, lam = state
        ended = watch.ended(fired)
        fired = [i for i in fired if i < len(watch.events)]
        events = [watch.events[i] for i in fired]
        self.t = t
        before = watch.of_multipliers(t, p, v, lam) if watch.modes is not None else {}
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
        if watch.modes is not None:
            p, v = self._other_modes(t, p, v, ended)
        known = stepper.index1.acceleration(t, p, v)
        record.jump(t, p, v, known[1])
        why = watch.restart_after(fired, moved, stepper.system, t, p, v, known, record.forward)
        if why:
            raise Stop(FAILED, why)
        hit = watch.passed(before, fired, t, p, v, known[1])
        if hit is not None:
            return self._after_events(*hit)
        return Start(p, v, known)

    def _other_modes(self, t, p, v, ended):
        """Position and velocity after a change of the modes of contacts."""
        stepper = self.stepper
        modes = self.watch.modes
        beyond = None
        if ended and ended[0][0] is None:  # redundant rows, whose modes are those a little later
            a = stepper.index1.acceleration(t, p, v)[0]
            later = BEYOND * abs(stepper.h)
            beyond = t + later, stepper.system.integrate(p, later * v), v + later * a
        p, v = modes.change(t, p, v, ended, beyond)
        if modes.system is not stepper.system:
            self.record.complete_multipliers()
            stepper.change_system(modes.system)
        self.watch.enter_mode(stepper)
        return stepper.index1.projected(t, p, v)
