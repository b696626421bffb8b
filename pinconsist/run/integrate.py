"""The loop of a run: the engine advances, and Python acts on the reason for which it returns."""

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field

import numpy as np

from ..engine import constant
from ..engine.failure import FAILURES, failure_report, jumping
from ..engine.problem import Index3System
from ..errors import InputError, PinconsistError, UserFunctionError
from ..mechanism.mode_system import ModeSystem
from .control import ErrorControl, FixedStep, Switches
from .dense import DenseOutput
from .events import EventWatch, state_after
from .modes import Modes
from .output import FAILED, STOPPED, SUCCESS, Output, Record, Stop

JUST_AFTER = 1e-6  # of a step, after which the modes of redundant rows are decided
RESTS = 1e-6  # relative speed after an impact below which contacts rest, with fixed steps


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
            if not record.at_steps:
                stepper.ask_rows(record.due, output.exact)
            run = March(stepper, t_span, method, record, watch, interrupted)
            run.start(p0, v0)
            run.to_end()
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
    watch.enter_mode()
    return stepper.index1.projected(t, p, v)


def _ending(error, t):
    """The error that ends a run; sys.exit() in a user's function counts as its error, and does not end the program."""
    if not isinstance(error, SystemExit):
        return error
    ending = UserFunctionError("a user-defined function", t, error)
    ending.__cause__ = error
    return ending


class March:
    """A run of a stepper from `t_span[0]`: it asks the engine for steps, and acts on the reason for which it returns.

    What was reached is in the record; :class:`Stop` ends a run early.
    """

    def __init__(self, stepper, t_span, method, record, watch, interrupted):
        self.stepper = stepper
        self.method = method
        self.record = record
        self.watch = watch
        self.t, self.t_end = t_span
        self._interrupted = interrupted

    def start(self, p, v, known=None) -> None:
        """Start, or start again, at the time reached; `known` are acceleration and λ there."""
        self.stepper.place(self.t, p, v, known)

    def to_end(self, jumped=False) -> None:
        """Steps up to the end; forces have `jumped` since the run was left."""
        while self.t != self.t_end:
            if self._interrupted():
                raise KeyboardInterrupt
            made = self._advance(jumped)
            jumped = False
            if made.reason == "interrupted":
                raise KeyboardInterrupt
            if made.reason == "event":
                self.after_events(*self.stepper.hit)
                continue
            self.t = self.stepper.t
            if made.reason == "failed" and not self._other_rows():
                raise Stop(FAILED, failure_report(self.stepper, made.why))
            if made.reason == "rows":
                self._other_rows()
            if self.t != self.t_end:
                self._require_progress(made.reason == "slow")

    def _advance(self, jumped):
        """Steps, which are recorded."""
        record = self.record
        system = self.stepper.system
        made = self.stepper.advance(
            self.t_end,
            self._steps_left(),
            jumped,
            record.output.dense,
            self.watch.compiled,
            record.sees if record.output.each_step else None,
            system if system.changes else None,
        )
        record.add(self.stepper.read())
        if made.error is not None:
            raise made.error
        return made

    def _steps_left(self) -> int | None:
        most = self.method.max_steps
        return None if most is None else most - self.record.nsteps

    def _require_progress(self, slow: bool) -> None:
        left = self._steps_left()
        if left is not None and left <= 0:
            reached = self.record.reached
            raise Stop(FAILED, f"max_steps = {self.method.max_steps} used up at t = {reached:.6g} of {self.t_end:.6g}")
        if slow and (self.stepper.steps_to_come > constant("ENDLESS") or jumping(self.stepper)):
            raise Stop(FAILED, failure_report(self.stepper, FAILURES["chatters"]))

    def _other_rows(self) -> bool:
        """Start again with other constraint rows if the kept ones have become a poor choice."""
        stepper = self.stepper
        fresh = stepper.system.reselected(stepper.p)
        if fresh is None:
            return False
        self.record.complete_multipliers()  # by the rows that were kept until here
        p, v = stepper.p, stepper.v
        if self.watch.modes is None:
            stepper.change_system(fresh)
        else:
            stepper.change_system(self.watch.modes.rebased(self.t, fresh.base))
            self.watch.enter_mode()
            self.watch.restart(self.t, p, v, stepper.index1.acceleration(self.t, p, v)[1])
        self.start(p, v)
        return True

    def after_events(self, fired, at, ends) -> None:
        """Start again after events; Stop if one ends the run."""
        stepper = self.stepper
        record = self.record
        watch = self.watch
        self.t, p, v, lam = at
        t = self.t
        ended = watch.ended(fired)
        fired = [i for i in fired if i < len(watch.events)]
        events = [watch.events[i] for i in fired]
        if watch.modes is not None:
            watch.compiled.keep_of_multipliers(t, p, v, lam)
        if ends:
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
        why = watch.restart_after(fired, moved, stepper, t, p, v, known, record.forward)
        if why:
            raise Stop(FAILED, why)
        if watch.modes is not None:
            hit = watch.compiled.passed(fired, t, p, v, known[1])
            if hit is not None:
                self.after_events(*hit)
                return
        self.start(p, v, known)

    def _other_modes(self, t, p, v, ended):
        """Position and velocity after a change of the modes of contacts."""
        stepper = self.stepper
        modes = self.watch.modes
        beyond = None
        if ended and ended[0][0] is None:  # redundant rows, whose modes are those a little later
            a = stepper.index1.acceleration(t, p, v)[0]
            later = JUST_AFTER * abs(stepper.h)
            beyond = t + later, stepper.system.integrate(p, later * v), v + later * a
        p, v = modes.change(t, p, v, ended, beyond)
        if modes.system is not stepper.system:
            self.record.complete_multipliers()
            stepper.change_system(modes.system)
        self.watch.enter_mode()
        return stepper.index1.projected(t, p, v)
