"""Events: zeros of functions of the solution, located on the interpolant of each step."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from scipy.optimize import brentq

from ..errors import InputError


@dataclass(frozen=True)
class Event:
    """Something to look for along the solution.

    Parameters
    ----------
    function : callable
        ``g(t, q, v, lam) -> float``; the event is where it passes zero.
    terminal : bool or int
        Stop there; a number stops at that many occurrences.
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

    Attributes
    ----------
    found : list of list of (t, p, v, λ)
        Occurrences of each event.
    """

    def __init__(self, events, finish):
        self.events, self._finish = events, finish
        self.found = [[] for _ in events]
        self._values = [0.0] * len(events)

    def restart(self, t, p, v, lam) -> None:
        """Take the signs at a new start; an event that is zero there is not found again."""
        lam = self._finish(p, lam)
        self._values = [float(event.function(t, p, v, lam)) for event in self.events]

    def first(self, segment):
        """Record the events of a step in order of time; stop at, and return, the first one that changes the run.

        Returns
        -------
        (Event, t, whether to stop) or None
        """
        p, v, lam = segment(segment.end)
        lam = self._finish(p, lam)
        after = [float(event.function(segment.end, p, v, lam)) for event in self.events]
        hits = []
        for i, (event, g0, g1) in enumerate(zip(self.events, self._values, after, strict=True)):
            rises, falls = g0 < 0 <= g1 and event.direction >= 0, g0 > 0 >= g1 and event.direction <= 0
            if rises or falls:
                hits.append((self._locate(event, segment, g1), i))
        self._values = after
        sign = 1.0 if segment.end >= segment.t_old else -1.0
        for t, i in sorted(hits, key=lambda hit: sign * hit[0]):
            event = self.events[i]
            p, v, lam = segment(t)
            self.found[i].append((t, p, v, self._finish(p, lam)))
            enough = event.terminal and len(self.found[i]) >= int(event.terminal)
            if enough or event.apply is not None:
                return event, t, bool(enough)
        return None

    def _locate(self, event, segment, g_end) -> float:
        if g_end == 0.0:
            return segment.end

        def g(t):
            p, v, lam = segment(t)
            return float(event.function(t, p, v, self._finish(p, lam)))

        if g(segment.t_old) == 0.0 or g(segment.t_old) * g_end > 0:
            return segment.end  # the interpolant's sign at its old end is lost in rounding
        return brentq(g, segment.t_old, segment.end, xtol=4e-16 * max(1.0, abs(segment.end)), rtol=1e-14)
