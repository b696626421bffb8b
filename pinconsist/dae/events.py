"""Events: zeros of functions of the solution, located on the interpolant of each step."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from dis import get_instructions
from types import FunctionType

from scipy.optimize import brentq

from ..errors import InputError, UserFunctionError

SAME_TIME = 1e-13  # relative: events closer than that happen at once
NUDGE = 1e-6  # of a step
BESIDE = 1e-3  # of a step, for a slope
ROUGHLY = 1e-7  # of a step, where a secant follows
LOOKING = {"locals", "vars", "dir", "eval", "exec"}  # functions that see all variables
MOST_TRIES = 3000  # Brent's method needs 135 for a triple zero, and never more than 52² for any


@dataclass(frozen=True)
class Event:
    """An event: a zero of a function along the solution.

    Parameters
    ----------
    function : callable
        ``g(t, q, v, lam) -> float``; the event is where it passes zero.
    terminal : bool or int
        Stop there; a number: stop at that many occurrences.
    direction : float
        > 0: only where g rises, < 0: only where it falls, 0: both.
    apply : callable, optional
        ``apply(t, q, v) -> v`` or ``-> (q, v)``: the state after the event (an impact, a latch), or ``None`` where
        only forces change. The run then starts afresh with consistent velocity and multipliers; nothing of the
        old history is used.
    name : str
        For messages.
    """

    function: Callable
    terminal: bool | int = False
    direction: float = 0.0
    apply: Callable | None = None
    name: str = ""


def as_events(events) -> tuple[Event, ...]:
    """Events from what a user may give: Event objects or functions with scipy's attributes."""
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


class EventWatch:
    """Finds the events of each step, in the order of time.

    ``retake(segment, t)``, if not None, makes the step of a segment again up to a time: its (p, v, λ) there.

    Attributes
    ----------
    found : list of list of (t, p, v, λ)
        Occurrences of each event.
    """

    def __init__(self, events, finish, interrupted, retake):
        self.events, self.finish, self.interrupted, self.retake = events, finish, interrupted, retake
        self.found = [[] for _ in events]
        self._values, self._seen = [0.0] * len(events), []  # of each event: at the last look, and ahead of the search
        self._multipliers = any(reads_multipliers(event.function) for event in events)
        self._there = None, 0.0, ()  # the state made last: of a segment, at a time

    def restart(self, t, p, v, lam, fired=()) -> None:
        """Take the signs at a new start; an event that is zero there, as those that just fired, is not found again."""
        if not self.events:
            return
        self._values, self._seen = self._signs(t, p, v, lam), []
        for i in fired:
            self._values[i] = 0.0  # what rounding leaves of it has no meaning

    def sees(self, t, p, v, lam, order) -> bool:
        """Look at a step before the batch it belongs to is searched; whether something may have happened in it."""
        before, values = self._seen[-1] if self._seen else self._values, self._signs(t, p, v, lam)
        self._seen.append(values)
        return any(not a * b > 0.0 for a, b in zip(before, values, strict=True))

    def first(self, batch):
        """Record the events of steps in order of time; stop at the first that changes the run.

        ``looked`` counts the steps that were seen to the end.

        Returns
        -------
        (indices of the events at that time, t, (p, v, λ), whether to stop) or None
        """
        begin, left, looks, self.looked = batch.curve.start, batch.curve.looks, batch.curve.looks, 0
        t, p, v, lam = batch.looked_into(looks, self._multipliers)
        rows = p, v, self._given(p, lam)
        for end, p, v, lam in zip(t.tolist(), *rows, strict=True):  # at every step: plain loops are fastest
            values = self._values
            self._values = self._seen.pop(0) if self._seen else [_value(each, end, p, v, lam) for each in self.events]
            for before, after in zip(values, self._values, strict=True):
                if not before * after > 0.0:
                    segment = batch.curve.segment(min(self.looked, len(batch.curve.ends) - 1))  # a start is one
                    if change := self._happen(segment, self._hits(segment, begin, end, values)):
                        return change
                    break
            begin, left = end, left - 1
            if not left:  # a step was seen to its end
                left, self.looked = looks, self.looked + 1
                if self.interrupted():
                    raise KeyboardInterrupt
        return None

    def until(self, t, forward) -> list:
        """What was found up to a time: steps may have been looked at beyond the end of the run."""
        late = (lambda time: time > t) if forward else (lambda time: time < t)
        return [[row for row in rows if _at_once(row[0], t) or not late(row[0])] for rows in self.found]

    def _hits(self, segment, begin, end, values):
        """(t, index) of the events between two times, in their order."""
        beside = begin + NUDGE * (end - begin)
        leaving = self._signs(beside, *segment(beside, self._multipliers)) if 0.0 in values else values
        hits = []
        for i, event in enumerate(self.events):
            g0, g1 = values[i] or leaving[i], self._values[i]
            rises, falls = g0 < 0 <= g1 and event.direction >= 0, g0 > 0 >= g1 and event.direction <= 0
            if rises or falls:
                hits.append((self._locate(event, segment, begin if values[i] else beside, end, g1), i))
        return sorted(hits, key=lambda hit: (abs(hit[0] - begin), hit[1]))

    def _happen(self, segment, hits):
        """Record `hits`, (t, index) in the order of time, up to the first that changes the run."""
        stop_at, final = None, False
        for t, i in hits:
            if stop_at is not None and not _at_once(t, stop_at):
                break
            event = self.events[i]
            p, v, lam = self._state(segment, t)
            self.found[i].append((t, p, v, self.finish(p, lam)))
            enough = bool(event.terminal) and len(self.found[i]) >= int(event.terminal)
            if enough or event.apply is not None:
                stop_at, final = t if stop_at is None else stop_at, final or enough
        if stop_at is None:
            return None
        return [i for t, i in hits if _at_once(t, stop_at)], stop_at, self._state(segment, stop_at), final

    def _state(self, segment, t):
        """(p, v, λ) at a time inside a step, which is wanted repeatedly."""
        if self._there[0] is not segment or self._there[1] != t:
            self._there = segment, t, segment(t) if self.retake is None else self.retake(segment, t)
        return self._there[2]

    def _given(self, p, lam):
        """λ as events are given it."""
        return self.finish(p, lam) if self._multipliers else lam

    def _signs(self, t, p, v, lam):
        state = [read_only(each) for each in (p, v, self._given(p, lam))]
        return [_value(event, t, *state) for event in self.events]

    def _locate(self, event, segment, begin, end, g_end) -> float:
        if g_end == 0.0:
            return end

        known = {end: g_end}

        def g(t):
            if t not in known:
                p, v, lam = segment(t, self._multipliers)
                known[t] = _value(event, t, p, v, self._given(p, lam))
            return known[t]

        if g(begin) == 0.0 or g(begin) * g_end > 0:
            return end  # the interpolant's sign at its old end is lost in rounding
        exact = 4e-16 * max(1.0, abs(end))
        near = exact if self.retake is None else max(exact, ROUGHLY * abs(end - begin))
        root = brentq(g, begin, end, xtol=near, rtol=1e-14, maxiter=MOST_TRIES)
        if self.retake is None:
            return root
        p, v, lam = self._state(segment, root)
        missing, beside = _value(event, root, p, v, self._given(p, lam)) - g(root), root - BESIDE * (root - begin)
        slope = (g(root) - g(beside)) / (root - beside) if root != beside else 0.0
        moved = root - missing / slope if slope else root  # one secant takes out what the interpolant is wrong by
        return moved if (moved - begin) * (moved - end) < 0 else root


def reads_multipliers(function) -> bool:
    """Whether an event's function may look at λ, its last argument; it takes as long to compute as all the rest."""
    code = getattr(function, "__code__", None)
    if not isinstance(function, FunctionType) or code.co_argcount != 4 or LOOKING.intersection(code.co_names):
        return True
    name = code.co_varnames[3]
    used = (each.argval for each in get_instructions(code))
    return name in code.co_cellvars or any(name == each or (type(each) is tuple and name in each) for each in used)


def _at_once(t1, t2) -> bool:
    return abs(t1 - t2) <= SAME_TIME * max(1.0, abs(t1))


def _value(event, t, p, v, lam) -> float:
    """The event's function at a state, as a number that can have a sign."""
    try:
        value = float(event.function(t, p, v, lam))
        if value != value:
            raise ValueError("it returned NaN")
    except Exception as error:
        raise UserFunctionError(f"the event {event.name!r}", t, error) from error
    return value


def read_only(array):
    """The array as users' functions get it."""
    view = array.view()
    view.flags.writeable = False
    return view
