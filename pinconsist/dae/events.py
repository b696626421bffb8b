"""Events: zeros of functions of the solution, located on the interpolant of each step."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from numbers import Real
from types import FunctionType
from typing import NamedTuple, NoReturn

import numpy as np

from ..errors import InputError, PinconsistError, UserFunctionError, warn
from .arguments import may_read
from .norms import EPS, largest
from .rounding import shortest_step
from .tuning import AT_ONCE, FLIGHT, FLIGHTS, HALVING, ROUNDED_FLIGHT, SHORTER

SAME_TIME = 1e-13  # relative: events closer than this are simultaneous
BESIDE = 1e-3  # distance before a root at which the slope is measured, relative to the search interval
STOPPED = 1e-9  # rate of a function after an event, relative to that before, that counts as zero
TOUCHING = 1e-9  # rad or m: gap of an impact that counts as closed
ROUGHLY = 1e-7  # accuracy of a root before a Newton step, relative to the step
STILL = 1e-9  # change of velocities by a projection, relative to them and 1 rad/s or m/s, that is no jump
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
        self.changed, self._first, self._leaving, self._offsets = False, False, (), ()

    def restart(self, t, p, v, lam, leaving, offsets) -> None:
        """Take the signs at a new start.

        `leaving` has values for the functions that leave zero there, NaN for the others, and `offsets` what is taken
        off the functions up to the next look; both may be empty.
        """
        self.begin = self.end = t
        self._leaving, self._offsets = leaving, ()
        self.values = [
            leaving[i] if leaving and leaving[i] == leaving[i] else self.value(i, t, p, v, lam)
            for i in range(len(self.events))
        ]
        self._offsets, self._first = offsets, True

    def leaves(self, i) -> bool:
        """Whether a function has left zero at the first of the last two evaluations, with the sign that it had then."""
        return bool(self._leaving) and self._leaving[i] == self._leaving[i] and self._leaving[i] != 0.0

    def look(self, t, p, v, lam) -> bool:
        """Evaluate the functions at a state; returns whether some sign has changed."""
        if not self._first:
            self._leaving = self._offsets = ()
        self._first = False
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
        return value - self._offsets[i] if self._offsets else value


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
    allowed = SET * np.maximum(np.abs(wanted), np.abs(before)) + SMALL * largest(before) + STILL
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


def fail(event, t, error) -> NoReturn:
    """Raise the error of an event whose function raised `error`, or returned NaN."""
    raise UserFunctionError(f"the event {event.name!r}", t, error or ValueError("it returned NaN")) from error


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
    """Finds the events of each step of a stepper, in order of time.

    Attributes
    ----------
    found : list of list of (t, p, v)
        Occurrences of each event.
    changes : list of Change
        What they changed.
    signs : Signs or None
        The signs in each step, of the stepper's own type; None if there are no events.
    """

    def __init__(self, events, stepper, interrupted):
        self.events, self.found, self.signs, self._told = events, [[] for _ in events], None, set()
        self.changes: list[Change] = []
        self._last_change: dict[int, float] = {}  # largest change of v by the last occurrence of an event
        self._may_read, self._flights = [reads_multipliers(event.function) for event in events], {}
        if events:
            multipliers = any(self._may_read)
            self._made_of = events, multipliers, interrupted, stepper.full_multipliers
            self.signs = stepper.signs(*self._made_of)

    def restart(self, t, p, v, lam) -> None:
        """Take the signs at a new start; InputError if what cannot become negative is negative."""
        if not self.events:
            return
        self.signs.restart(t, p, v, lam, (), ())
        touching = {}
        for i, (event, value) in enumerate(zip(self.events, self.signs.values, strict=True)):
            if one_sided(event) and value < -TOUCHING:
                raise InputError(f"the impact {event.name!r}: the run starts {-value:.3g} beyond its stop or plane")
            if one_sided(event) and value <= TOUCHING:
                touching[i] = TOUCHING
        if touching:
            self._leave(touching, t, p, v, lam)

    def restart_after(self, fired, moved, system, t, p, v, known, forward) -> str:
        """Take the signs after the events `fired`; `known` are acceleration and multipliers there.

        The values of their functions are only rounding there, unless one of them has `moved` the position. Their signs
        are those with which they leave zero, so that they are right however soon it returns, and what they have of the
        other sign is rounding. Returns why the run cannot continue, or an empty string.
        """
        leaving, reversed_ = {}, []
        self.signs.restart(t, p, v, known[1], (), ())
        for i, (event, value) in enumerate(zip(self.events, self.signs.values, strict=True)):
            if one_sided(event):
                if i in fired or value <= TOUCHING:
                    leaving[i] = TOUCHING
                reversed_ += [i] * (i in fired)
            elif i in fired:
                leaving[i] = 0.0
                if not self._depends_on_multipliers(i, t, p, v, known[1]):
                    rate = self._departure(i, system, t, p, v, known, forward)
                    arrived = self._departure(i, system, *self.found[i][-1], known, forward)
                    leaving[i] = rate if abs(rate) > STOPPED * abs(arrived) else 0.0
                    reversed_ += [i] * (leaving[i] * arrived <= 0.0)
                    if moved and abs(value) > max(abs(rate), abs(arrived)):
                        leaving[i] = math.nan
        self._leave(leaving, t, p, v, known[1])
        return next(filter(None, [self._accumulates(i, t, p) for i in reversed_]), "")

    def _leave(self, leaving, t, p, v, lam):
        """Restart with the signs of functions that leave zero, by their indices."""
        values, offsets = [math.nan] * len(self.events), [0.0] * len(self.events)
        for i, sign in leaving.items():
            here = self.signs.values[i]
            values[i] = sign
            offsets[i] = here if here * sign < 0.0 else 0.0
        self.signs.restart(t, p, v, lam, values, offsets)

    def _depends_on_multipliers(self, i, t, p, v, lam) -> bool:
        """Whether an event's function uses λ, and not only gets it."""
        return self._may_read[i] and self.signs.value(i, t, p, v, 2.0 * lam + 1.0) != self.signs.values[i]

    def _departure(self, i, system, t, p, v, known, forward):
        """The change of a function over a short time after an event, of first order."""
        rate, (a, lam) = system.rate(t, p, v), known
        time = FLIGHT * (1.0 + largest(p)) / (1.0 + largest(rate) + largest(a)) * (1.0 if forward else -1.0)

        def beside(dt):
            return self.signs.value(i, t + dt, system.integrate(p, dt * rate), v + dt * a, lam)

        return 0.5 * (beside(time) - beside(-time))

    def _accumulates(self, i, t, p) -> str:
        """Why the run cannot continue after an event that has reversed the rate of its function; else empty."""
        if self.events[i].apply is None or len(self.found[i]) < 2:
            return ""
        flight = abs(self.found[i][-1][0] - self.found[i][-2][0])
        change = self._last_change[i]
        at_once = flight <= shortest_step(t)
        height = change * flight / 8.0  # of a parabola
        short = at_once or height <= ROUNDED_FLIGHT * EPS * (1.0 + largest(p))
        self._flights[i] = self._flights.get(i, 0) + 1 if short else 0
        at_most = FLIGHTS
        if at_once:  # several impacts at one time may take turns
            at_most = AT_ONCE if one_sided(self.events[i]) else 1
        if self._flights[i] < at_most:
            return ""
        return (
            f"the event {self.events[i].name or 'without a name'} accumulates at t = {t:.6g}, after "
            f"{len(self.found[i])} occurrences: the times between them have shrunk to {flight:.1g} s. What bounces "
            "there comes to rest, which no event can model: end the run before (terminal=a number of occurrences) and "
            "go on with a mechanism in which it is held by a loop, or let a spring and a damper make the contact"
        )

    def jumped(self, t, p, v, lam):
        """Take the signs after a jump of forces, which may move a function past zero; returns as :meth:`first`."""
        if not self.events:
            return None
        before = list(self.signs.values)
        self.signs.restart(t, p, v, lam, (), ())
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

    def changed(self, i, system, t, before, after: Applied) -> None:
        """Record what the event `i` has changed; warn, once a run, if its velocity does not outlast the projection.

        `before` are the position and velocity before it.
        """
        lost = lost_in_projection(before[1], after.wanted, after.v)
        self._last_change[i] = largest(after.v - before[1])
        self.changes.append(Change(self.events[i].name, t, *before, after.p, after.v, lost is not None))
        if lost is not None and i not in self._told:
            self._told.add(i)
            warn_of_projection(self.events[i], system, t, lost, before[1], after.wanted, after.v)

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
    before, after, left, root = signs.before[i], signs.values[i], 0.0, begin
    if signs.leaves(i):
        begin, before, end, after = narrowed(partial(g, segment), begin, before, end, after)
    if begin != end:
        near = max(nearness(begin, end, False), near * abs((end - begin) / (signs.end - signs.begin)))
        root, left = zero(partial(g, segment), begin, before, end, after, near)
    if abs(root - segment.t_old) < shortest_step(root):
        retake = None  # it is the state at the start
    again = segment if retake is None else retake(segment, root)
    if again is not segment:  # a Newton step removes the error of the interpolant
        there, beside = g(again, root), root - BESIDE * (root - begin)
        slope = (left - g(segment, beside)) / (root - beside) if root != beside else 0.0
        moved = root - there / slope if slope else root
        root = moved if (moved - begin) * (moved - end) < 0 else root
    return root, again(root)


def narrowed(g, begin, before, end, after):
    """The interval shortened until `g` has its sign before the zero at the beginning too; empty if it never has."""
    left = begin
    while abs(end - left) > shortest_step(end):
        t = left + SHORTER * (end - left)
        value = g(t)
        if value * before > 0.0:
            return t, value, end, after
        end, after = t, value
    return left, before, left, after


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
