"""Events: zeros of functions of the solution, located on the interpolant of each step."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from numbers import Real
from types import FunctionType
from typing import NamedTuple, NoReturn

import numpy as np

from ..engine.arguments import may_read
from ..engine.norms import EPS, largest
from ..engine.rounding import shortest_step
from ..errors import InputError, PinconsistError, UserFunctionError, warn

FLIGHT = 1e-5  # change of the state, relative to it, over which the rate of a function is measured that leaves zero
ROUNDED_FLIGHT = 1e3  # roundings of the position below which flights between occurrences of an event do not count
FLIGHTS = 3  # number of such flights after which an event accumulates
AT_ONCE = 30  # number of occurrences at one time after which it does

SAME_TIME = 1e-13  # relative: events closer than this are simultaneous
STOPPED = 1e-9  # rate of a function after an event, relative to that before, that counts as zero
TOUCHING = 1e-9  # rad or m: gap of an impact that counts as closed
SOONER = 8  # times that a gap is sought that has closed before the first event
DEEP = 1e-11  # rad or m: a gap below it at the first event has closed before
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


class ContactEvent(NamedTuple):
    """The end of a mode of contacts: the index of the element, and what has fallen to zero."""

    element: int | None
    what: str
    direction: float = -1.0
    terminal: bool = False
    apply: None = None
    name: str = ""


class EventWatch:
    """Finds the events of each step of a stepper, in order of time.

    `modes` are the :class:`~pinconsist.run.modes.Modes` of a run with contacts, whose ends are events too.

    Attributes
    ----------
    found : list of list of (t, p, v)
        Occurrences of each event.
    changes : list of Change
        What they changed.
    signs : Signs or None
        The signs in each step, of the stepper's own type; None if there are no events.
    """

    def __init__(self, events, stepper, interrupted, modes=None):
        self.events, self.found, self.signs, self._told = events, [[] for _ in events], None, set()
        self.changes: list[Change] = []
        self._last_change: dict[int, float] = {}  # largest change of v by the last occurrence of an event
        self._may_read, self._flights = [reads_multipliers(event.function) for event in events], {}
        self.modes, self._interrupted, self._every = modes, interrupted, tuple(events)
        self._made_of: tuple = ()
        if events and modes is None:
            self._made_of = events, any(self._may_read), interrupted, stepper.full_multipliers
            self.signs = stepper.signs(*self._made_of)

    def enter_mode(self, stepper) -> None:
        """Watch for the end of the present mode of contacts."""
        watched, ends = self.modes.watch()
        asked = tuple(Event(self.modes.margin, name="contacts") for _ in range(self.modes.system.redundant))
        multipliers = any(self._may_read) or bool(asked) or any(what in ("push", "cone") for _, what in ends)
        self._made_of = (*self.events, *asked), multipliers, self._interrupted, stepper.full_multipliers, watched
        self._every = (*self.events, *(ContactEvent(None, "agree") for _ in asked), *(ContactEvent(*of) for of in ends))
        self.signs = stepper.signs(*self._made_of)

    def ended(self, fired) -> list:
        """What has ended the mode of contacts among events with these indices: pairs (element, what fell to zero)."""
        return [self._every[i][:2] for i in fired if i >= len(self.events)]

    def _contacts_leaving(self, leaving) -> None:
        """Functions of contacts are positive in their mode: what is about zero at its beginning rises from there."""
        for i in range(len(self.events), len(self._every)):
            if self.signs.values[i] <= TOUCHING:
                leaving[i] = TOUCHING

    def restart(self, t, p, v, lam) -> None:
        """Take the signs at a new start; InputError if what cannot become negative is negative."""
        if self.signs is None:
            return
        self.signs.restart(t, p, v, lam, (), ())
        touching: dict[int, float] = {}
        self._contacts_leaving(touching)
        for i, (event, value) in enumerate(zip(self.events, self.signs.values, strict=False)):
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
        self._contacts_leaving(leaving)
        for i, (event, value) in enumerate(zip(self.events, self.signs.values, strict=False)):
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
        values, offsets = [math.nan] * len(self._every), [0.0] * len(self._every)
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
            "there comes to rest, which no event can model, but a contact can: in place of the event, "
            "mech.with_contacts(pc.Stop(joint, lower, upper, restitution)), or pc.Contact for a point above a plane"
        )

    def jumped(self, t, p, v, lam):
        """Take the signs after a jump of forces, which may move a function past zero; returns as :meth:`first`."""
        if self.signs is None:
            return None
        before = list(self.signs.values)
        self.signs.restart(t, p, v, lam, (), ())
        passed = zip(self._every, before, self.signs.values, strict=True)
        return self._happen([(t, i, (p, v, lam)) for i, each in enumerate(passed) if _passes(*each)])

    def of_multipliers(self, t, p, v, lam) -> dict[int, float]:
        """The values of the users' functions that may use λ, which jumps where modes of contacts change."""
        return {i: self.signs.value(i, t, p, v, lam) for i, reads in enumerate(self._may_read) if reads}

    def passed(self, before, fired, t, p, v, lam):
        """Record the events whose functions have passed zero by a jump of λ; returns as :meth:`first`."""
        after = {i: self.signs.value(i, t, p, v, lam) for i in before if i not in fired}
        return self._happen([(t, i, (p, v, lam)) for i in after if _passes(self.events[i], before[i], after[i])])

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
        for i, (event, g0, g1) in enumerate(zip(self._every, signs.before, signs.values, strict=True)):
            if _passes(event, g0, g1):
                t, state = stepper.locate(signs, i)
                hits.append((t, i, state))
        hits.sort(key=lambda hit: (abs(hit[0] - begin), hit[1]))
        return self._with_sooner(stepper, hits) if hits and self.modes is not None else hits

    def _with_sooner(self, stepper, hits):
        """The hits, and gaps that have closed before the first of them, as a shorter step than the last one shows."""
        signs = self.signs
        for _ in range(SOONER):
            t, first, (p, v, lam) = hits[0]
            closed = [
                i
                for i, event in enumerate(self._every)
                if i != first
                and isinstance(event, ContactEvent)
                and event.what == "gap"
                and signs.before[i] > 0.0
                and signs.value(i, t, p, v, lam) < -DEEP
            ]
            found = [(i, stepper.sooner(signs, i, t)) for i in closed]
            sooner = [(hit[0], i, hit[1]) for i, hit in found if hit is not None and hit[0] < t]
            if not sooner:
                break
            hits = [min(sooner, key=lambda hit: hit[0]), *hits]
        return hits

    def _happen(self, hits):
        """Record `hits` up to the first that changes the run."""
        stop, final = None, False
        for t, i, state in hits:
            if stop is not None and not _at_once(t, stop[0]):
                break
            event = self._every[i]
            if isinstance(event, ContactEvent):
                stop = stop or (t, state)
                continue
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
