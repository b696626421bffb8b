"""Events: zeros of functions of the solution, located on the interpolant of each step."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from numbers import Real
from types import FunctionType
from typing import NoReturn

import numpy as np

from ..errors import InputError, PinconsistError, UserFunctionError, warn
from .arguments import may_read
from .rounding import shortest_step
from .tuning import HALVING

SAME_TIME = 1e-13  # relative: events closer than this are simultaneous
BESIDE = 1e-3  # distance before a root at which the slope is measured, relative to the search interval
ROUGHLY = 1e-7  # accuracy of a root before a Newton step, relative to the step
SET, SMALL = 1e-2, 1e-3  # change of a velocity that was set, relative to it and to the largest, that is told


@dataclass(frozen=True)
class Event:
    """An event: a zero of a function along the solution.

    Parameters
    ----------
    function : callable
        ``g(t, q, v, lam) -> float``; the event is where it passes zero.
    terminal : bool or int
        Stop there; a number: stop after that many occurrences.
    direction : float
        > 0: only where g rises, < 0: only where it falls, 0: both.
    apply : callable, optional
        ``apply(t, q, v)`` returns the state after the event (a latch, an impact):

        * a mapping joint name → velocity: these joints have it, as if by impulses at them; the others follow through
          the loops, and change as little as the masses allow,
        * a velocity, which is projected onto the constraints in the mass metric; a warning says if a joint then does
          not have the velocity that was set, as in a closed chain in which only one of them was changed,
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


def as_events(events) -> tuple[Event, ...]:
    """Events from user input: Event objects, or functions with scipy's attributes."""
    if events is None:
        return ()
    events = (events,) if callable(events) or isinstance(events, Event) else events
    if not isinstance(events, Iterable):
        raise InputError(f"events must be a sequence of events, got {events!r}")
    result = []
    for event in events:
        if not isinstance(event, Event):
            if not callable(event):
                raise InputError(f"an event must be an Event or a function g(t, q, v, lam), got {event!r}")
            names = ("terminal", "direction", "apply")
            attributes = {name: getattr(event, name) for name in names if hasattr(event, name)}
            event = Event(event, **attributes, name=getattr(event, "__name__", ""))
        result.append(event)
    return tuple(result)


class Signs:
    """The signs of the event functions at successive times of a run.

    Attributes
    ----------
    begin, end, before, values : float, float, list of float
        Times of the last two evaluations, and the values at these times.
    changed : bool
        Whether some function has changed its sign between them. One that is zero takes its sign at the next evaluation,
        which follows shortly after, so that the event is not found again.
    interrupted : callable
        ``interrupted() -> bool``, called after each step: whether the run is to end there.
    """

    def __init__(self, events, with_multipliers, interrupted, finish):
        self.events, self.with_multipliers, self.interrupted = events, with_multipliers, interrupted
        self._finish = finish
        self.changed = False

    def restart(self, t, p, v, lam, fired=()) -> None:
        """Take the signs at a new start; events that just `fired` count as zero: their values are only rounding."""
        self.end = t
        self.values = [0.0 if i in fired else self.value(i, t, p, v, lam) for i in range(len(self.events))]

    def look(self, t, p, v, lam) -> bool:
        """Evaluate the functions at a state; returns whether some sign has changed."""
        self.begin, self.end, self.before = self.end, t, self.values
        self.values = [self.value(i, t, p, v, lam) for i in range(len(self.events))]
        signs = zip(self.before, self.values, strict=True)
        self.changed = any(before != 0.0 and not before * after > 0.0 for before, after in signs)
        return self.changed

    def value(self, i, t, p, v, lam) -> float:
        """An event's function at a state; an error if it is not a number."""
        error, value = None, math.nan
        try:
            given = read_only(self._finish(p, lam)) if self.with_multipliers else None
            value = float(self.events[i].function(t, read_only(p), read_only(v), given))
        except Exception as raised:
            error = raised
        if value != value:
            fail(self.events[i], t, error)
        return value


def state_after(event, index1, t, p, v):
    """(p, v) after an event, on the constraints, and the velocity that its `apply` returned, None for a mapping."""
    system = index1.system
    try:
        changed = event.apply(t, p.copy(), v.copy())
    except PinconsistError as error:
        raise type(error)(f"apply of the event {event.name!r} at t = {t:.6g}: {error}") from error
    except Exception as error:
        raise UserFunctionError(f"apply of the event {event.name!r}", t, error) from error
    wanted = v if changed is None else changed
    if isinstance(changed, tuple) and len(changed) == 2:
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
        return p, v, wanted
    try:
        return p, system.with_velocities(t, p, v, named), None
    except PinconsistError as error:
        raise InputError(f"apply of the event {event.name!r} at t = {t:.6g}: {error}") from error


def warn_of_projection(event, system, t, before, wanted, after) -> bool:
    """Warn if a component of v that `apply` has set does not have this value after the projection; whether it did."""
    lost = np.abs(after - wanted)
    allowed = SET * np.maximum(np.abs(wanted), np.abs(before)) + SMALL * np.abs(before).max(initial=0.0)
    lost[(wanted == before) | (lost <= allowed)] = 0.0
    if not lost.any():
        return False
    i = int(np.argmax(lost))
    name = system.describe_velocity(i)
    warn(
        f"apply of the event {event.name!r} set the velocity of {name} to {wanted[i]:.6g} at t = {t:.6g}, but it is "
        f"{after[i]:.6g} now (before: {before[i]:.6g}): the constraints do not allow what was set, and it was "
        "projected onto them in the mass metric. To set some joints and let the others follow, return a mapping "
        "joint → velocity"
    )
    return True


def fail(event, t, error) -> NoReturn:
    """Raise the error of an event whose function raised `error`, or returned NaN."""
    raise UserFunctionError(f"the event {event.name!r}", t, error or ValueError("it returned NaN")) from error


class EventWatch:
    """Finds the events of each step of a stepper, in order of time.

    Attributes
    ----------
    found : list of list of (t, p, v)
        Occurrences of each event.
    signs : Signs or None
        The signs in each step, of the stepper's own type; None if there are no events.
    """

    def __init__(self, events, stepper, interrupted):
        self.events, self.found, self.signs, self._told = events, [[] for _ in events], None, set()
        if events:
            multipliers = any(reads_multipliers(event.function) for event in events)
            self._made_of = events, multipliers, interrupted, stepper.full_multipliers
            self.signs = stepper.signs(*self._made_of)

    def restart(self, t, p, v, lam, fired=()) -> None:
        """Take the signs at a new start; see :meth:`Signs.restart`."""
        if self.events:
            self.signs.restart(t, p, v, lam, fired)

    def jumped(self, t, p, v, lam):
        """Take the signs after a jump of forces, which may move a function past zero; returns as :meth:`first`."""
        if not self.events:
            return None
        before = list(self.signs.values)
        self.signs.restart(t, p, v, lam, ())
        passed = zip(self.events, before, self.signs.values, strict=True)
        return self._happen([(t, i, (p, v, lam)) for i, each in enumerate(passed) if _passes(*each)])

    def first(self, stepper):
        """Record the events of the last step, or of a start, in order of time, up to the first that changes the run.

        Returns
        -------
        (indices of the events at that time, t, (p, v, λ), whether to stop) or None
        """
        while self.signs.changed or stepper.watched(self.signs):
            if change := self._happen(self._hits(stepper)):
                return change
        return None

    def tell(self, i, system, t, before, wanted, after) -> None:
        """Warn, once a run, if a velocity that the event `i` has set does not outlast the projection."""
        if (
            wanted is not None
            and i not in self._told
            and warn_of_projection(self.events[i], system, t, before, wanted, after)
        ):
            self._told.add(i)

    def until(self, t, forward) -> list:
        """The events up to a time: steps may have been searched beyond the end of the run."""
        late = (lambda time: time > t) if forward else (lambda time: time < t)
        return [[row for row in rows if _at_once(row[0], t) or not late(row[0])] for rows in self.found]

    def _hits(self, stepper):
        """(t, index, (p, v, λ)) of events between the last two evaluations, in order of time."""
        signs, hits = self.signs, []
        begin, signs.changed = signs.begin, False
        for i, (event, g0, g1) in enumerate(zip(self.events, signs.before, signs.values, strict=True)):
            if _passes(event, g0, g1):
                t, state = stepper.locate(signs, i)
                hits.append((t, i, state))
        return sorted(hits, key=lambda hit: (abs(hit[0] - begin), hit[1]))

    def _happen(self, hits):
        """Record `hits` up to the first that changes the run."""
        stop, final = None, False
        for t, i, state in hits:
            if stop is not None and not _at_once(t, stop[0]):
                break
            event = self.events[i]
            self.found[i].append((t, *state[:2]))
            enough = bool(event.terminal) and len(self.found[i]) >= int(event.terminal)
            if enough or event.apply is not None:
                stop, final = stop or (t, state), final or enough
        if stop is None:
            return None
        return [i for t, i, _ in hits if _at_once(t, stop[0])], *stop, final


def _passes(event, g0, g1) -> bool:
    """Whether an event's function passes zero from one value to another, in its direction."""
    return (g0 < 0 <= g1 and event.direction >= 0) or (g0 > 0 >= g1 and event.direction <= 0)


def located(segment, signs, i, retake=None):
    """The time of an event between the last two evaluations in a step, and (p, v, λ) there.

    ``retake(segment, t)``, if not None, repeats the step up to a time inside it and returns a segment that is exact
    there, or the old one if that fails.
    """

    def g(segment, t):
        return signs.value(i, t, *segment.look(t, signs.with_multipliers))

    begin, end = signs.begin, signs.end
    if signs.values[i] == 0.0:
        return end, (segment if retake is None or end == segment.end else retake(segment, end))(end)
    near = nearness(begin, end, retake is not None)
    root, left = zero(partial(g, segment), begin, signs.before[i], end, signs.values[i], near)
    if abs(root - segment.t_old) < shortest_step(root):
        retake = None  # it is the state at the start
    again = segment if retake is None else retake(segment, root)
    if again is not segment:  # a Newton step removes the error of the interpolant
        there, beside = g(again, root), root - BESIDE * (root - begin)
        slope = (left - g(segment, beside)) / (root - beside) if root != beside else 0.0
        moved = root - there / slope if slope else root
        root = moved if (moved - begin) * (moved - end) < 0 else root
    return root, again(root)


def nearness(begin, end, roughly) -> float:
    """The accuracy, s, with which the search between two evaluations locates an event."""
    exact = 4e-16 * max(1.0, abs(end))
    return max(exact, ROUGHLY * abs(end - begin)) if roughly else exact


def zero(g, a, fa, b, fb, near):
    """The zero of `g` between `a` and `b`, where its signs differ, and its value there.

    By inverse quadratic interpolation or bisection, chosen as by Chandrupatla (Adv. Eng. Softw. 28, 1997); if that
    takes long, by bisection alone.
    """
    part, tries = fa / (fa - fb), 0
    part = 0.5 if part != part else part  # infinite values
    while True:
        least, tries = 0.5 * near / abs(b - a), tries + 1
        t = a + min(max(part, least), 1.0 - least) * (b - a)
        f = g(t)
        c, fc = a, fa
        if not f * fa > 0.0:
            b, fb, c, fc = a, fa, b, fb
        a, fa = t, f
        if fa == 0.0 or abs(b - a) <= near:
            return (a, fa) if abs(fa) < abs(fb) else (b, fb)
        x, y = (a - b) / (c - b), (fa - fb) / (fc - fb)
        part = 0.5
        if tries < HALVING and y * y < x and (1.0 - y) ** 2 < 1.0 - x:
            part = fa / (fa - fb) * fc / (fc - fb) - (c - a) / (b - a) * fa / (fc - fa) * fb / (fb - fc)


def reads_multipliers(function) -> bool:
    """Whether an event's function may use λ, its last argument; λ takes as long to compute as all the rest."""
    code = getattr(function, "__code__", None)
    return not isinstance(function, FunctionType) or code.co_argcount != 4 or may_read(function, 3)


def _at_once(t1, t2) -> bool:
    return abs(t1 - t2) <= SAME_TIME * max(1.0, abs(t1))


def read_only(array):
    """The array as users' functions get it."""
    view = array.view()
    view.flags.writeable = False
    return view
