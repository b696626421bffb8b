"""Break points: the times at which functions of time change their character. Steps end there.

Forces and rows that depend on time have a method ``functions_of_time(q, v)``, which returns each of their functions
as a :class:`TimeFunction`; its break points are known, as those of a table, or found by sampling it before a run.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass
from math import inf
from types import FunctionType, MethodType
from weakref import WeakMethod

import numpy as np

from ..engine.arguments import may_read
from ..errors import InputError, PinconsistError
from .checks import finite_array, returned
from .motion import TIME_STEP, in_time
from .sampling import PARTS, SAMPLE_SPACING, SMOOTH, Change, changes, continues, samples_of

JUMP_OFFSET = 1e-13  # relative to a time, or to 1 s: offset at which functions are evaluated before and after a jump
SAME_BREAKPOINT = 1e-2  # distance of the samples of a function, relative to which nearer break points are one
NOTABLE = 1e-9  # change of a function, relative to it, that is a jump
BEFORE = 5.0  # distances of samples; a pulse does not also begin so near to a jump


def jump_offset(t):
    """The difference of times near `t` below which they are equal."""
    return JUMP_OFFSET * np.maximum(1.0, np.abs(t))


@dataclass
class TimeFunction:
    """A function of time of a force or a row.

    A jump of a derivative of the order `jumps` or a lower one makes the multipliers jump; they bend if that of the next
    order jumps. `known` are its changes, if they are known; otherwise it is sampled.
    """

    function: Callable
    jumps: int = 0
    known: list[Change] | None = None

    def changes(self, t, t_end, n) -> list[Change]:
        """Its changes between two times, from n + 1 samples if they are not known."""
        return changes(self.function, t, t_end, n) if self.known is None else self.known

    def restarts(self, change) -> bool | None:
        """Whether the multipliers jump at a change; None if a method that remembers earlier steps need not restart."""
        if change.order > self.jumps + 1 or (change.order == SMOOTH and self.known is None):
            return None
        return change.order <= self.jumps


def time_function(function, call, jumps=0, knots=()) -> TimeFunction:
    """The time function of a user's `function`, whose values ``call(t)`` returns; its break points, if it has any."""
    known = [Change(t, jumps) for t in knots]
    own = _own_changes(function)
    return TimeFunction(call, jumps, known + own if known or own else None)


def _own_changes(function) -> list[Change]:
    """The break points of tables, and of the splines of SciPy."""
    if hasattr(function, "break_points"):
        return list(function.break_points)
    kind = type(function)
    if not kind.__module__.startswith("scipy.interpolate"):
        return []
    if hasattr(function, "t") and hasattr(function, "k"):  # a B-spline; of several equal knots nothing is known
        inside = np.asarray(function.t)[function.k : -function.k or None]
        knots, counts = np.unique(inside[np.isfinite(inside)], return_counts=True)
        return [Change(float(t), function.k if n == 1 else 0) for t, n in zip(knots, counts, strict=True)]
    order = {"CubicSpline": 3, "PchipInterpolator": 2, "Akima1DInterpolator": 2}.get(kind.__name__, 0)
    linear = kind.__name__ == "interp1d" and getattr(function, "_kind", "") == "linear"
    knots = getattr(function, "x", None)
    return [] if knots is None else [Change(float(t), 1 if linear else order) for t in np.unique(knots)]


def depends_on_time(law) -> bool:
    """Whether a user's law f(t, q, v) may use its argument t."""
    plain = law.__func__ if isinstance(law, MethodType) else law
    return not isinstance(plain, FunctionType) or may_read(plain, plain is not law)


def with_own_state(law) -> Callable:
    """The same law, with a copy of its state if it is an object that can be copied."""
    if isinstance(law, FunctionType):
        return law
    try:
        return deepcopy(law)
    except Exception:
        return law


class Breakpoints:
    """The break points of the functions of time of one system, and the piece between them in which a run is."""

    def __init__(self):
        self._parts: list[WeakMethod] = []  # (q, v) → time functions; of the forces and rows, which hold this object
        self.first, self.last = -inf, inf  # no difference quotient evaluates a function outside
        self._times: list[float] = []
        self._restarts: list[bool | None] = []
        self._ends: list[float] = []  # those at which pieces end
        self._backwards, self._passed, self._piece = False, 0, None
        self._begun: tuple | None = None  # on the steps of a run: its start, and the piece that begins there
        self.sampled = False
        self._looked, self._seen = None, {}  # the times between which functions were sampled, and what was found

    def __bool__(self):
        return bool(self._parts)

    def add(self, parts) -> None:
        """Add the functions of time of forces or rows, and let these evaluate them in pieces."""
        for part in parts:
            if part.functions_of_time(None, None):
                self._parts.append(WeakMethod(part.functions_of_time))
                part.set_breakpoints(self)

    @property
    def times(self) -> list[float]:
        """All break points, ascending."""
        return list(self._times)

    @property
    def ends(self) -> list[float]:
        """Those at which a force, or one of the first derivatives of a constraint, jumps or bends."""
        return list(self._ends)

    def look_ahead(self, t, t_end, q, v, every: bool = True) -> None:
        """Find the break points of a run, which begins at `t`; if `every`, also those that are not known."""
        if self:
            self._look(t, t_end, q, v, samples_of(abs(t_end - t)) if every else 0)
            self.start(t, t_end < t)

    def look_on(self, t, t_end, q, v) -> None:
        """Find those of the next part of a run, which is sampled only if it is long."""
        if self:
            n = min(int(abs(t_end - t) / SAMPLE_SPACING), samples_of(abs(t_end - t)))
            self._look(t, t_end, q, v, n if n >= PARTS else 0)
            self.start(t, t_end < t)

    def _look(self, t, t_end, q, v, n) -> None:
        low, high, self.sampled = min(t, t_end), max(t, t_end), n > 0
        if self._looked != (looked := (t, t_end, n)):
            self._looked, self._seen, self.first, self.last = looked, {}, -inf, inf
        for part in self._parts:
            if part not in self._seen:
                sampled = [each for each in self._of(part, q, v) if n or each.known is not None]
                changes = [(each, change) for each in sampled for change in each.changes(t, t_end, n)]
                self._seen[part] = [(change.time, each.restarts(change)) for each, change in changes]
                self._limit(low, high, [each.function for each in sampled if each.jumps])
        found = [each for seen in self._seen.values() for each in seen if low <= each[0] <= high]
        self._take(_merged(sorted(found, key=lambda each: each[0]), (high - low) / n if n else 0.0))

    @staticmethod
    def _of(part, q, v) -> list[TimeFunction]:
        functions = part()
        return functions(q, v) if functions else []

    def _limit(self, low, high, functions) -> None:
        """Limit difference quotients to the run if one of the functions does not go on before or after it."""
        if not all(continues(each, low, -TIME_STEP) for each in functions):
            self.first = low
        if not all(continues(each, high, TIME_STEP) for each in functions):
            self.last = high

    def _take(self, found) -> None:
        self._times, self._restarts = [t for t, _ in found], [restarts for _, restarts in found]
        self._ends = [t for t, restarts in found if restarts is not None]

    def look_over(self, t, t_end, q, v, run=None) -> None:
        """Find the break points between two times, for evaluations in any order; those of a `run` that covers them."""
        if run is not None and run.covers(t, t_end):
            self.share(run)
        elif self:
            self._look(t, t_end, q, v, samples_of(abs(t_end - t)))
            self._backwards, self._piece = t_end < t, None

    def covers(self, t, t_end) -> bool:
        """Whether these are the break points from one time to another, in the direction of the run."""
        if self._looked is None:
            return False
        begun, ended, _ = self._looked
        return begun <= t <= t_end <= ended or begun >= t >= t_end >= ended

    def share(self, run) -> None:
        """Take over the break points and the domain of another run."""
        self._take(list(zip(run._times, run._restarts, strict=True)))
        self.first, self.last, self.sampled = run.first, run.last, run.sampled
        self._backwards, self._piece, self._begun = run._backwards, None, run._begun

    def on_steps(self, t) -> None:
        """After a run from `t`, on its steps: a break point belongs to the piece that ends with it, as in the run."""
        self.start(t, self._backwards)
        self._begun, self._backwards, self._piece = (t, self._piece), not self._backwards, None

    def start(self, t, backwards) -> None:
        """Start a run at `t`: break points up to there are passed."""
        near = jump_offset(t)
        self._backwards = backwards
        self._passed = bisect_left(self._times, t - near) if backwards else bisect_right(self._times, t + near)
        self._piece = self._around(t - near if backwards else t + near)

    def next_change(self, t) -> float:
        """The next break point in the direction of the run, or infinity."""
        if self._backwards:
            return self._times[self._passed - 1] if self._passed else -inf
        return self._times[self._passed] if self._passed < len(self._times) else inf

    def change(self, t, q, v) -> bool | None:
        """Pass the break points at `t`; see :meth:`Index3System.change`."""
        passed, found = self._passed, []
        sign = -1.0 if self._backwards else 1.0
        while sign * (self.next_change(t) - t) <= jump_offset(t):
            due = self._passed - self._backwards
            found.append(self._restarts[due])
            self._passed += -1 if self._backwards else 1
        if self._passed == passed:
            return None
        kinds = [restarts for restarts in found if restarts is not None]
        if not kinds:
            return None
        self._piece = self._around(self._times[self._passed - (not self._backwards)])
        return any(kinds)

    def jump_at(self, t, q, v) -> bool:
        """Whether a function jumps at `t`, seen from this state."""
        near = 2.0 * jump_offset(t)
        for function in (each.function for part in self._parts for each in self._of(part, q, v)):
            try:
                before, at, after = (np.asarray(function(float(time)), float) for time in (t - near, t, t + near))
            except PinconsistError:  # it need not be defined beyond the end
                continue
            size = NOTABLE * np.abs(at).max(initial=0.0)
            if max(np.abs(before - at).max(initial=0.0), np.abs(after - at).max(initial=0.0)) > size:
                return True
        return False

    def piece(self, t) -> tuple[float, float]:
        """The piece that contains `t`; at its ends, and in the direction of the run beyond them, the current one."""
        if self._begun is not None and abs(t - self._begun[0]) <= jump_offset(t):
            return self._begun[1]
        here = self._piece
        if here is None or (t > here[1] if self._backwards else t < here[0]):  # a time before the current piece
            here = self._around(t)
        return here

    def inside(self, t) -> float:
        """The nearest time inside the piece, excluding its ends."""
        if not self._ends:
            return t
        low, high = self.piece(t)
        if low > -inf and t < low + jump_offset(low):
            return float(low + jump_offset(low))
        if high < inf and t > high - jump_offset(high):
            return float(high - jump_offset(high))
        return t

    def reach(self, t) -> tuple[tuple[float, float], bool]:
        """How far before and after `t`, inside a piece, functions may be evaluated; whether corners may be there."""
        low, high = self.piece(t) if self._ends else (-inf, inf)
        low, high = max(low, self.first), min(high, self.last)
        return (min(low + JUMP_OFFSET - t, 0.0), max(high - JUMP_OFFSET - t, 0.0)), not self.sampled

    def _around(self, t):
        """The ends of the piece that contains `t`; at an end, of the next one in the direction of the run."""
        i = (bisect_left if self._backwards else bisect_right)(self._ends, t)
        return self._ends[i - 1] if i else -inf, self._ends[i] if i < len(self._ends) else inf


def _merged(found, apart):
    """Break points without those that are the same as others, and without smooth ones near to a jump or bend."""
    kept: list[tuple[float, bool | None]] = []
    for t, restarts in found:
        near = max(SAME_BREAKPOINT * apart, jump_offset(t))
        if kept and t - kept[-1][0] <= near:
            kinds = [each for each in (kept[-1][1], restarts) if each is not None]
            kept[-1] = kept[-1][0], any(kinds) if kinds else None
        else:
            kept.append((t, restarts))
    ends = np.array([t for t, restarts in kept if restarts is not None])
    beside = BEFORE * apart
    return [(t, kind) for t, kind in kept if kind is not None or not (np.abs(ends - t) < beside).any()]


NONE = Breakpoints()
"""Of a system without functions of time."""


class TimeCurve:
    """A user's `function` of time, as the engine calls it: inside the pieces of a run, and checked."""

    breakpoints: Breakpoints = NONE

    def __init__(self, function, what: str, shape: tuple = (), finite: bool = False):
        self.function = function
        self._what = what
        self._shape = shape
        self._finite = finite

    def __call__(self, t):
        return self.value(self.breakpoints.inside(t))

    def value(self, t):
        """The value at a time, outside of the pieces too."""
        found = returned(self.function, self._what, self._shape, t)
        if self._finite and not np.isfinite(found).all():
            raise InputError(f"{self._what} is {found} at t = {t:.6g}; it must be finite")
        return found if self._shape else float(found)


class MovingCurve(TimeCurve):
    """The function in a `field` of a record, with its derivatives: functions, or differences.

    A derivative is the field of its name if the record has it, or the method of that name of the function.
    """

    def __init__(self, record, field: str, who: str, derivatives: tuple[str, ...], finite: bool = False):
        function = getattr(record, field)
        super().__init__(function, f"the {field} of {who}", finite=finite)
        self.derivatives: dict[str, TimeCurve] = {}
        for name in derivatives:
            given = getattr(record, name) or getattr(function, name, None)
            if given is not None:
                self.derivatives[name] = TimeCurve(given, f"the {name} of {who}", finite=finite)

    def rate(self, t) -> float:
        return self._derivative("rate", 1, t)

    def acceleration(self, t) -> float:
        return self._derivative("acceleration", 2, t)

    def _derivative(self, name, order, t) -> float:
        t = self.breakpoints.inside(t)
        if name in self.derivatives:
            return self.derivatives[name].value(t)
        return float(in_time(lambda s: self.value(t + s), order, TIME_STEP, *self.breakpoints.reach(t)))


def knots_of(values, what: str) -> tuple[float, ...]:
    """Knots from user input: increasing times."""
    times = finite_array(values, what)
    return tuple(np.unique(times).tolist())
