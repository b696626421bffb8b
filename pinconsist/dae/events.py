"""Events: zeros of functions of the solution, located on the interpolant of each step."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from dis import get_instructions
from functools import partial
from types import FunctionType

from ..errors import InputError, UserFunctionError
from .tuning import HALVING

SAME_TIME = 1e-13  # relative: events closer than that happen at once
NUDGE = 1e-6  # of a step
BESIDE = 1e-3  # of a step, for a slope
ROUGHLY = 1e-7  # of a step, where a secant follows
LOOKING = {"locals", "vars", "dir", "eval", "exec"}  # functions that see all variables


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

    `locate` is that of a :class:`~pinconsist.dae.stepper.Stepper`.

    Attributes
    ----------
    found : list of list of (t, p, v)
        Occurrences of each event.
    """

    def __init__(self, events, finish, interrupted, locate):
        self.events, self.finish, self.interrupted, self.locate = events, finish, interrupted, locate
        self.found = [[] for _ in events]
        self._values, self._seen = [0.0] * len(events), []  # of each event: at the last look, and ahead of the search
        self._multipliers = any(reads_multipliers(event.function) for event in events)
        self._inside = [_of_kept_rows(event, finish) for event in events] if self._multipliers else events

    def restart(self, t, p, v, lam, fired=()) -> None:
        """Take the signs at a new start; an event that is zero there, as those that just fired, is not found again."""
        if not self.events:
            return
        self._seen = []
        if len(fired) < len(self.events):
            self._values = self._at_row(t, p, v, lam)
        for i in fired:
            self._values[i] = 0.0  # what rounding leaves of it has no meaning

    def sees(self, t, p, v, lam, order) -> bool:
        """Look at a step before the batch it belongs to is searched; whether something may have happened in it."""
        before, values = self._seen[-1] if self._seen else self._values, self._at_row(t, p, v, lam)
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
        events, seen, values = self.events, self._seen, self._values
        t, p, v, lam = batch.looked_into(self._multipliers)
        lam = [None] * len(t) if lam is None else self._given(p, lam)
        for end, at, speed, force in zip(t.tolist(), p, v, lam, strict=True):  # at every step: plain loops are fastest
            last, values = values, seen.pop(0) if seen else _values(events, end, at, speed, force)
            self._values = values
            for before, after in zip(last, values):  # noqa: B905 - strict takes time
                if not before * after > 0.0:
                    segment = batch.curve.segment(min(self.looked, len(batch.curve.ends) - 1))  # a start is one
                    if change := self._happen(self._hits(segment, begin, end, last)):
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

    def _hits(self, segment, begin, end, last):
        """(t, index, (p, v, λ)) of events between two looks, in the order of time; `last`: values at the first one."""
        leaving, beside = last, begin
        if 0.0 in last:
            beside = begin + NUDGE * (end - begin)
            p, v, lam = segment.look(beside, self._multipliers)
            leaving = _values(self.events, beside, p, v, self._given(p, lam))
        hits = []
        for i, event in enumerate(self.events):
            g0, g1 = leaving[i], self._values[i]
            rises, falls = g0 < 0 <= g1 and event.direction >= 0, g0 > 0 >= g1 and event.direction <= 0
            if rises or falls:
                between = (begin if last[i] else beside, g0), (end, g1)
                t, state = self.locate(segment, self._inside[i], self._multipliers, *between)
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

    def _given(self, p, lam):
        """λ as events are given it."""
        return self.finish(p, lam) if self._multipliers else lam

    def _at_row(self, t, p, v, lam):
        """The events' values at a state that is recorded."""
        return _values(self.events, t, *(read_only(each) for each in (p, v, self._given(p, lam))))


def _of_kept_rows(event, finish):
    """The event as a function of the multipliers of the rows that are kept."""
    return replace(event, function=lambda t, p, v, lam: event.function(t, p, v, finish(p, lam)))


def located(segment, event, with_multipliers, begin, end, retake=None):
    """The time of an event, a function of kept multipliers, between two looks into a step, and (p, v, λ) there.

    `begin` and `end` are (time, value) of the looks. ``retake(segment, t)``, if not None, makes the step again up to a
    time inside it: a segment that is exact there, or the old one where that fails.
    """

    def g(segment, t):
        return _values((event,), t, *segment.look(t, with_multipliers))[0]

    (t_begin, _), (t_end, g_end) = begin, end
    if g_end == 0.0:
        return t_end, (segment if retake is None or t_end == segment.end else retake(segment, t_end))(t_end)
    root, left = zero(partial(g, segment), *begin, *end, nearness(begin, end, retake is not None))
    again = segment if retake is None else retake(segment, root)
    if again is not segment:  # one step of Newton's takes out how wrong the interpolant is
        there, beside = g(again, root), root - BESIDE * (root - t_begin)
        slope = (left - g(segment, beside)) / (root - beside) if root != beside else 0.0
        moved = root - there / slope if slope else root
        root = moved if (moved - t_begin) * (moved - t_end) < 0 else root
    return root, again(root)


def nearness(begin, end, roughly) -> float:
    """How near to an event the search between two looks comes."""
    exact = 4e-16 * max(1.0, abs(end[0]))
    return max(exact, ROUGHLY * abs(end[0] - begin[0])) if roughly else exact


def zero(g, a, fa, b, fb, near):
    """Where `g` passes zero between `a` and `b`, whose values differ in sign, and its value there.

    By inverse quadratic interpolation or halving, as Chandrupatla (Adv. Eng. Softw. 28, 1997) chooses between them;
    where that takes long, by halving alone.
    """
    part, tries = fa / (fa - fb), 0
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
    """Whether an event's function may look at λ, its last argument; it takes as long to compute as all the rest."""
    code = getattr(function, "__code__", None)
    if not isinstance(function, FunctionType) or code.co_argcount != 4 or LOOKING.intersection(code.co_names):
        return True
    name = code.co_varnames[3]
    used = (each.argval for each in get_instructions(code))
    return name in code.co_cellvars or any(name == each or (type(each) is tuple and name in each) for each in used)


def _at_once(t1, t2) -> bool:
    return abs(t1 - t2) <= SAME_TIME * max(1.0, abs(t1))


def _values(events, t, p, v, lam) -> list[float]:
    """The events' functions at a state, as numbers that can have a sign."""
    values: list[float] = []
    try:
        for event in events:
            value = event.function(t, p, v, lam)
            if type(value) is not float:
                value = float(value)
            if value != value:
                raise ValueError("it returned NaN")
            values.append(value)
    except Exception as error:
        raise UserFunctionError(f"the event {events[len(values)].name!r}", t, error) from error
    return values


def read_only(array):
    """The array as users' functions get it."""
    view = array.view()
    view.flags.writeable = False
    return view
