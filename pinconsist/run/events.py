"""Events: zeros of functions of the solution, located on the interpolant of each step."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from numbers import Real
from types import FunctionType
from typing import NamedTuple, NoReturn

import numpy as np

from ..engine import constant
from ..engine.arguments import may_read
from ..engine.norms import largest
from ..errors import InputError, PinconsistError, UserFunctionError, warn

PROJECTION_ROUNDING = 1e-9  # change of a velocity by a projection, rad/s or m/s, that is none
SET, SMALL = 1e-2, 1e-3  # change of a velocity that was set, relative to it and to the largest, that is reported


@dataclass(frozen=True)
class Event:
    """An event: a zero of a function along the solution.

    Parameters
    ----------
    function : callable
        ``g(t, q, v, lam) -> float``; the event is where it crosses zero.
    terminal : bool or int
        Whether to stop at the event; a number: stop after that many occurrences.
    direction : float
        > 0: only where g increases, < 0: only where it decreases, 0: both.
    apply : callable, optional
        ``apply(t, q, v)`` returns the state after the event (a latch, an impact):

        * a mapping joint name → velocity: these joints get this velocity, as if by impulses at them; the others follow
          through the loops, with the smallest change in the mass metric,
        * a velocity, which is projected onto the constraints in the mass metric; a warning says if a joint then does
          not have the velocity that was set, as in a closed chain in which only one joint was changed,
        * ``(q, v)``, `v` being either of these,
        * ``None`` if only forces change.

        The run then restarts with consistent multipliers, without the old history.
    name : str
        For messages.
    """

    function: Callable
    terminal: bool | int = False
    direction: float = 0.0
    apply: Callable | None = None
    name: str = ""

    def __post_init__(self):
        if not callable(self.function):
            raise InputError(f"an event needs a function g(t, q, v, lam), got {self.function!r}")
        if not (self.apply is None or callable(self.apply)):
            raise InputError(f"apply of an event must be a function (t, q, v), got {self.apply!r}")
        numbers = isinstance(self.terminal, Real) and isinstance(self.direction, Real)
        if not numbers or self.terminal != self.terminal // 1 or self.terminal < 0 or self.direction != self.direction:
            raise InputError(
                "terminal of an event must be True, False or a number of occurrences, and direction a number, got "
                f"{self.terminal!r} and {self.direction!r}"
            )

    def _raise_failure(self, t, error) -> NoReturn:
        """Raise what says that the function raised `error` at `t`, or returned NaN."""
        raise UserFunctionError(f"the event {self.name!r}", t, error or ValueError("it returned NaN")) from error


def as_events(events, mechanism=None) -> tuple[Event, ...]:
    """Events from user input: Event objects, impacts on a mechanism, or functions with scipy's attributes."""
    if events is None:
        return ()
    events = (events,) if callable(events) or isinstance(events, Event) or hasattr(events, "bind") else events
    if not isinstance(events, Iterable):
        raise InputError(f"events must be a sequence of events, got {events!r}")
    result = []
    for event in events:
        if hasattr(event, "bind"):  # an impact
            event = Event(**event.bind(mechanism))
        if not isinstance(event, Event):
            if not callable(event):
                raise InputError(f"an event must be an Event or a function g(t, q, v, lam), got {event!r}")
            names = ("terminal", "direction", "apply")
            attributes = {name: getattr(event, name) for name in names if hasattr(event, name)}
            event = Event(event, **attributes, name=getattr(event, "__name__", ""))
        result.append(event)
    return tuple(result)


def one_sided(event) -> bool:
    """Whether an event's function cannot become negative: that of an impact."""
    return getattr(event.apply, "one_sided", False)


class Applied(NamedTuple):
    """The state after an event, on the constraints, and what its `apply` returned.

    `wanted` is the velocity, None for a mapping; `moved` says whether it returned a position, too.
    """

    p: np.ndarray
    v: np.ndarray
    wanted: np.ndarray | None
    moved: bool


def state_after(event, index1, t, p, v, forward=True) -> Applied:
    """The state after an event; `forward` says whether the run goes forward in time."""
    system = index1.system
    try:
        direction = () if event.apply is None or not one_sided(event) else (forward,)
        changed = event.apply(t, p.copy(), v.copy(), *direction)
    except PinconsistError as error:
        raise type(error)(f"apply of the event {event.name!r} at t = {t:.6g}: {error}") from error
    except Exception as error:
        raise UserFunctionError(f"apply of the event {event.name!r}", t, error) from error
    wanted, moved = v if changed is None else changed, isinstance(changed, tuple) and len(changed) == 2
    if moved:
        p, wanted = changed
    named = wanted if isinstance(wanted, Mapping) else None
    try:
        p, wanted = np.array(p, float), np.array(v if named is not None else wanted, float)
        good = p.shape == (system.npos,) and wanted.shape == (system.nv,)
        good = good and np.isfinite(p.dot(p) + wanted.dot(wanted))
    except (TypeError, ValueError):
        good = False
    if not good:
        raise InputError(
            f"apply of the event {event.name!r} must return v, shape ({system.nv},), a mapping joint → velocity, or "
            f"(q, v), all finite; it returned {changed!r} at t = {t:.6g}"
        )
    p, v = index1.projected(t, p, wanted)
    if named is None:
        return Applied(p, v, wanted, moved)
    try:
        return Applied(p, system.with_velocities(t, p, v, named), None, moved)
    except PinconsistError as error:
        raise InputError(f"apply of the event {event.name!r} at t = {t:.6g}: {error}") from error


def lost_in_projection(before, wanted, after) -> int | None:
    """The component of v that `apply` has set and the projection has changed most; None if it changed none by much."""
    if wanted is None:
        return None
    lost = np.abs(after - wanted)
    allowed = SET * np.maximum(np.abs(wanted), np.abs(before)) + SMALL * largest(before) + PROJECTION_ROUNDING
    lost[(wanted == before) | (lost <= allowed)] = 0.0
    return int(np.argmax(lost)) if lost.any() else None


def warn_of_projection(event, system, t, i, before, wanted, after) -> None:
    """Warn that component `i` of v, which `apply` has set, does not have this value after the projection."""
    name = system.describe_velocity(i)
    warn(
        f"apply of the event {event.name!r} set the velocity of {name} to {wanted[i]:.6g} at t = {t:.6g}, but it is "
        f"{after[i]:.6g} now (before: {before[i]:.6g}): the constraints do not allow what was set, and it was "
        "projected onto them in the mass metric. To set some joints and let the others follow, return a mapping "
        "joint → velocity"
    )


class Change(NamedTuple):
    """A change of the state by an event.

    Its name and time, the states before and after, and whether the velocity that it set did not outlast the projection.
    """

    name: str
    t: float
    p_before: np.ndarray
    v_before: np.ndarray
    p_after: np.ndarray
    v_after: np.ndarray
    altered: bool


class EventWatch:
    """The events of a run, which the engine finds in each step, in order of time.

    `modes` are the :class:`~pinconsist.run.modes.Modes` of a run with contacts, whose ends are events too;
    ``interrupted()`` says after each step whether to end the run.

    Attributes
    ----------
    changes : list of Change
        What events changed.
    compiled : Events or None
        The engine's part; None if there are no events.
    """

    def __init__(self, events, stepper, interrupted, modes=None):
        self.events = events
        self.modes = modes
        self.changes: list[Change] = []
        self.compiled = None
        self._warned: set[int] = set()
        self._ends: list = []  # what ends the present mode of contacts: pairs (element, what falls to zero)
        # The engine keeps neither these nor those of the mode alive.
        self._mode: tuple = ()
        self._alive = [_in_numbers(event) for event in events], interrupted, stepper.full_multipliers
        if events or modes is not None:
            self.compiled = stepper.events(*self._alive)

    def enter_mode(self) -> None:
        """Watch for the end of the present mode of contacts."""
        watched, self._ends, agree = self.modes.watch()
        self.compiled.enter_mode(watched)
        self._mode = watched, agree

    def ended(self, fired) -> list:
        """What has ended the mode of contacts among events with these indices: pairs (element, what fell to zero)."""
        return [self._ends[i - len(self.events)] for i in fired if i >= len(self.events)]

    def restart(self, t, p, v, lam) -> None:
        """Take the signs at a new start; InputError if what cannot become negative is negative."""
        if self.compiled is None:
            return
        self.compiled.restart(t, p, v, lam)
        for event in self.events:
            gap = event.function(t, p, v, None) if one_sided(event) else 0.0
            if gap < -constant("TOUCHING"):
                raise InputError(f"the impact {event.name!r}: the run starts {-gap:.3g} beyond its stop or plane")

    def restart_after(self, fired, moved, stepper, t, p, v, known, forward) -> str:
        """Take the signs after the events `fired`; `known` are acceleration and multipliers there.

        `moved` says whether one of them has moved the position. Returns why the run cannot continue, or an empty
        string.
        """
        i = stepper.restart_events(self.compiled, fired, moved, t, p, v, known, forward)
        if i < 0:
            return ""
        times = [occurrence[0] for occurrence in self.found[i]]
        return (
            f"the event {self.events[i].name or 'without a name'} accumulates at t = {t:.6g}, after "
            f"{len(times)} occurrences: the times between them have shrunk to {abs(times[-1] - times[-2]):.1g} s. The "
            "bouncing body comes to rest, which an event cannot model but a contact can: instead of the event, use "
            "mech.with_contacts(pc.Stop(joint, lower, upper, restitution)), or pc.Contact for a point above a plane"
        )

    def changed(self, i, system, t, before, after: Applied) -> None:
        """Record what the event `i` has changed; warn, once a run, if its velocity does not outlast the projection.

        `before` are the position and velocity before it.
        """
        lost = lost_in_projection(before[1], after.wanted, after.v)
        self.compiled.has_changed(i, largest(after.v - before[1]))
        self.changes.append(Change(self.events[i].name, t, *before, after.p, after.v, lost is not None))
        if lost is not None and i not in self._warned:
            self._warned.add(i)
            warn_of_projection(self.events[i], system, t, lost, before[1], after.wanted, after.v)

    @property
    def found(self) -> list:
        """The occurrences (t, p, v) of each event."""
        return [[] for _ in self.events] if self.compiled is None else self.compiled.found

    def until(self, t, forward) -> list:
        """The occurrences of each event up to a time: a step may have been searched beyond the end."""
        late = (lambda time: time > t) if forward else (lambda time: time < t)
        return [[row for row in rows if _at_once(row[0], t) or not late(row[0])] for rows in self.found]


def _in_numbers(event: Event) -> tuple:
    """An event as the engine takes it."""
    applies = event.apply is not None
    reads = reads_multipliers(event.function)
    return event, event.function, float(event.direction), int(event.terminal), applies, one_sided(event), reads


def reads_multipliers(function) -> bool:
    """Whether an event's function may use λ, its last argument; λ takes as long to compute as all the rest."""
    code = getattr(function, "__code__", None)
    return not isinstance(function, FunctionType) or code.co_argcount != 4 or may_read(function, 3)


def _at_once(t1, t2) -> bool:
    return abs(t1 - t2) <= constant("SAME_TIME") * max(1.0, abs(t1))
