"""How a run is made, as plain data stored in its file; and the run itself, from checkpoint to checkpoint.

At every checkpoint the integration starts again from the state there, whether the run was interrupted or not. So the
numbers after it depend on that state alone, and a run that is continued from its file gives the same numbers as one
without interruption.
"""

from __future__ import annotations

import inspect
import json
import logging
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from math import ceil

import numpy as np

from ..errors import FormatError, InputError, PinconsistError, SavingError, UserFunctionError
from ..formats.records import force_entries, force_record
from ..mechanism.checks import finite_array, near
from ..mechanism.description import digests
from ..mechanism.mechanism import with_added_forces
from .contact_results import ContactHistory
from .interrupts import deferred
from .options import positive_time, span_of
from .simulation import integrate, simulate

STEPS = ("h", "order")
ROWS = ("t", "q", "v", "lam")
COUNTERS = ("nsteps", "nfev", "njev", "nlu")
MAX_PARTS = 100_000
NOT_STORED = ("events", "dense_output")  # options of simulate whose results are not stored in the file
OTHERS = ("mech", "t_span", "q0", "v0", "forces", "callback", *NOT_STORED)
OPTIONS = [name for name in inspect.signature(simulate).parameters if name not in OTHERS]
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Recipe:
    """All that a run depends on, apart from the packages."""

    scene: dict | None  # a SceneSource, paths as seen from the run's file; None for a mechanism in memory
    files: dict  # of the scene → SHA-256
    t_span: list
    q0: object = None
    v0: object = None
    forces: list | None = field(default_factory=list)  # records as in a loop file; None: one was a Python function
    options: dict = field(default_factory=dict)
    save_every: float | None = None
    checkpoint: dict | None = None  # the last one: state, number of rows, counters
    mechanism: dict | None = None  # digests, without `forces`; None in files of older versions

    @classmethod
    def read(cls, solution, file) -> Recipe:
        """The recipe of a saved run; FormatError if the file has none."""
        if solution.recipe is None:
            raise FormatError(
                "it does not contain how it was made: a solution of simulate() alone does not know from which file its "
                "mechanism was loaded. Make the run with pinconsist.record(scene, ...) or the command line",
                path=file,
            )
        try:
            recipe = cls(**solution.recipe)
            options = {
                name: tuple(each["pair"]) if isinstance(each, dict) and name != "control" else each
                for name, each in recipe.options.items()
            }
            recipe = replace(recipe, options=options).checked()
            recipe.given_forces()
        except (TypeError, ValueError, AttributeError, KeyError) as error:
            raise FormatError(f"its record of how it was made cannot be read ({error})", path=file) from error
        try:
            at = recipe.checkpoint
            good = at is None or (
                at["t"] in recipe.ends()
                and 0 <= at["rows"] <= len(solution.t)
                and (len(at["q"]), len(at["v"])) == (solution.q.shape[1], solution.v.shape[1])
                and {"counted", "rejected"} <= set(at)
            )
        except (TypeError, KeyError, ValueError):
            good = False
        if not good:
            raise FormatError("its record of the last checkpoint cannot be read", path=file)
        return recipe

    @classmethod
    def of(cls, scene, files, mechanism, t_span, q0, v0, forces, options, save_every) -> Recipe:
        """A recipe from the arguments of :func:`pinconsist.record`; InputError for what cannot be stored in a file."""
        for name in NOT_STORED:
            if options.get(name):
                raise InputError(f"{name}= is not for recorded runs, whose file does not store it; use simulate()")
        options = {name: each for name, each in options.items() if name not in NOT_STORED}
        for name, each in options.items():
            _option(each, name)
        try:
            entries = force_entries(with_added_forces(replace(mechanism, forces=()), forces, "record"))
        except InputError:  # a user-defined function
            entries = None
        span, start = finite_array(t_span, "t_span").tolist(), (_plain(q0, "q0"), _plain(v0, "v0"))
        made = cls(scene, files, span, *start, entries, options, save_every, mechanism=digests(mechanism))
        return made.checked()

    def checked(self) -> Recipe:
        """The recipe, or InputError for a span, a period or options that are not valid."""
        for name in self.options:
            if name not in OPTIONS:
                raise InputError(f"unknown option {name!r}{near(name, OPTIONS)}")
        span_of(self.t_span)
        for what, kind in (("files", dict), ("mechanism", dict | None)):
            if not isinstance(value := getattr(self, what), kind):
                raise InputError(f"invalid hashes of its {what}: {value!r}")
        period = None if self.save_every is None else positive_time(self.save_every, "save_every")
        return replace(self, save_every=period)

    def plain(self) -> dict:
        """The recipe as plain data for JSON."""
        return asdict(self) | {"options": {name: _option(each, name) for name, each in self.options.items()}}

    def given_forces(self) -> tuple:
        """The forces given in addition to the scene's, from their records."""
        return tuple(force_record(number, entry) for number, entry in enumerate(self.forces or (), start=1))

    def ends(self) -> list[float]:
        """The ends of the parts of the run, checkpoints, the last one the end of the span."""
        (start, end), period = self.t_span, self.save_every
        if period is None:
            return [end]
        count = max(1, ceil(abs(end - start) / period - 1e-9))
        if count > MAX_PARTS:
            raise InputError(
                f"save_every = {period:g} s divides {abs(end - start):g} s into {count} parts; at most {MAX_PARTS}"
            )
        sign = 1.0 if end >= start else -1.0
        return [start + sign * k * period for k in range(1, count)] + [end]


def _plain(value, name):
    """The value in a form that JSON stores exactly, or InputError."""
    try:
        text = json.dumps(value, default=lambda each: dict(each) if isinstance(each, Mapping) else each.tolist())
    except (TypeError, ValueError, AttributeError):
        raise InputError(f"{name} = {value!r} cannot be stored in a file; only numbers and names can") from None
    return json.loads(text)


def _option(value, name):
    """Like `_plain`; a pair (of tolerances) is kept distinct from a list."""
    plain = _plain(value, name)
    return {"pair": plain} if isinstance(value, tuple) and len(value) == 2 else plain


def carry_out(recipe, mechanism, file, *, begun=None, callback=None):
    """Make the run of a recipe with a mechanism on which all forces act, and return its solution.

    It is saved in `file`, unless that is None, at its end and at checkpoints. Each save writes the whole run so far;
    checkpoints are skipped if saving would take more than a tenth of the time. A run that has `begun` continues from
    its last checkpoint. SavingError, with the solution, is raised if the end cannot be written.
    """
    parts, due, (_, t_end) = _Parts(recipe, mechanism, callback, begun), 0.0, recipe.t_span
    with deferred(late=False):
        try:
            for end in parts.ends:
                parts.add(parts.run(end), end)
                if parts.last.status != 0:
                    break
                if end != t_end and file is not None and (began := time.monotonic()) >= due:
                    try:
                        saved(parts.solution(), file)
                    except SavingError as error:  # a disk that is full now may have room at the next checkpoint
                        _log.warning("%s, at t = %g; the run continues and is saved at the next checkpoint", error, end)
                    due = time.monotonic() + 10 * (time.monotonic() - began)
        except (PinconsistError, KeyboardInterrupt, MemoryError) as error:
            if parts.last is None:  # there is nothing yet that could be lost
                raise
            parts.stop(error)
        return parts.solution() if file is None else saved(parts.solution(), file)


def saved(solution, file):
    """Save a solution; SavingError, with the solution, if that fails."""
    try:
        with deferred(impatient=False):
            solution.save(file)
    except OSError as error:
        raise SavingError(f"{file} cannot be written: {error.strerror or error}", solution=solution) from error
    return solution


class _Parts:
    """The rows so far, and the state from which the next part begins."""

    def __init__(self, recipe, mechanism, callback, begun):
        control = recipe.options.get("control")
        self.recipe, self.mechanism = recipe, mechanism if control is None else mechanism.with_control(control)
        self.callback = None if callback is None else _Callback(callback)
        self.contacts: list[tuple] = []
        self.parts, self.counted, self.rejected, self.last, self.ends = [], Counter(), Counter(), None, recipe.ends()
        if at := recipe.checkpoint:
            rows, steps = at["rows"], min(len(begun.h), max(at["rows"] - 1, 0))
            self.parts = [{n: getattr(begun, n)[:rows] for n in ROWS} | {n: getattr(begun, n)[:steps] for n in STEPS}]
            self.contacts = [(begun.contacts, at["t"])]
            self.last, self.counted, self.rejected = begun, Counter(at["counted"]), Counter(at["rejected"])
            self.ends = self.ends[self.ends.index(at["t"]) + 1 :]

    def run(self, end):
        at, options, start = self.recipe.checkpoint, dict(self.recipe.options), self._reached()
        options.pop("control", None)  # the mechanism has it already
        if at is not None and options.get("max_steps") is not None:
            options["max_steps"] -= self.counted["nsteps"]
            if options["max_steps"] <= 0:
                raise PinconsistError(self._used_up(start))
        if options.get("t_eval") is not None:
            low, high = min(start, end), max(start, end)
            requested = [t for t in options["t_eval"] if low <= t <= high and (at is None or t != start)]
            options["t_eval"] = requested if end in requested else [*requested, end]
        if at is None:
            first = self.recipe.q0, self.recipe.v0
            return simulate(self.mechanism, (start, end), *first, callback=self.callback, **options)
        options.pop("first_step", None)
        if self.callback:
            self.callback.skip = True
        q, v = np.array(at["q"]), np.array(at["v"])
        return integrate(self.mechanism, (start, end), q, v, callback=self.callback, **options)

    def add(self, run, end):
        """Keep the rows of a part; its first one is the last of the part before."""
        requested, first, last = self.recipe.options.get("t_eval"), 0, len(run.t)
        if requested is None:
            first = 1 if self.parts else 0
        elif end not in requested and last and run.t[-1] == end:  # a row to continue from, which was not requested
            last -= 1
        self.parts.append({n: getattr(run, n)[first:last] for n in ROWS} | {n: getattr(run, n) for n in STEPS})
        self.contacts.append((run.contacts, end))
        self.counted.update({name: getattr(run, name) for name in COUNTERS})
        self.rejected.update(run.rejected)
        status, message, t_end = run.status, run.message, self.recipe.t_span[1]
        if status == -1 and self.counted["nsteps"] >= (self.recipe.options.get("max_steps") or np.inf):
            message = self._used_up(run.t[-1] if len(run.t) else self.recipe.t_span[0])
        if self.callback and self.callback.error:
            status, message = -1, f"{self.callback.error} (reached t = {self.callback.t:.6g})"
        if status == 0 and end == t_end:
            self.recipe = replace(self.recipe, checkpoint=None)
        elif status == 0:
            message = f"saved at t = {end:g} of {t_end:g}; continue it with pinconsist resume"
            at = {
                "t": end, "q": run.q[-1].tolist(), "v": run.v[-1].tolist(),
                "rows": sum(len(part["t"]) for part in self.parts),
                "counted": dict(self.counted), "rejected": dict(self.rejected),
            }  # fmt: skip
            self.recipe = replace(self.recipe, checkpoint=at)
        self.last = replace(run, status=status, message=message)

    def _reached(self):
        return self.recipe.t_span[0] if self.recipe.checkpoint is None else self.recipe.checkpoint["t"]

    def _used_up(self, t):
        return f"max_steps = {self.recipe.options['max_steps']} used up at t = {t:.6g} of {self.recipe.t_span[1]:.6g}"

    def stop(self, error):
        """End the run by an error that was raised between two parts."""
        at, status, message = f"t = {self._reached():.6g}", -1, str(error)
        if isinstance(error, KeyboardInterrupt):
            status, message = 1, f"interrupted at {at}; the solution holds what was reached"
        elif isinstance(error, MemoryError):
            message = f"out of memory after {at}; t_eval= keeps fewer rows"
        self.last = replace(self.last, status=status, message=message)

    def solution(self):
        """The solution so far; status 1 if the run is not complete."""
        arrays = {name: np.concatenate([part[name] for part in self.parts]) for name in (*ROWS, *STEPS)}
        for array in arrays.values():
            array.setflags(write=False)
        status = 1 if self.last.status == 0 and self.recipe.checkpoint is not None else self.last.status
        return replace(
            self.last, **arrays, **self.counted, rejected=dict(self.rejected), status=status, success=status >= 0,
            recipe=self.recipe.plain(), versions={}, contacts=ContactHistory.joined(self.contacts),
        )  # fmt: skip


class _Callback:
    """A user's callback; an exception in it ends the run instead of losing it."""

    def __init__(self, callback):
        self.callback, self.order, self.t, self.error = callback, 0, 0.0, None
        self.each_step = getattr(callback, "each_step", True)
        self.skip = False  # the first row of a part that continues from a checkpoint

    def __call__(self, t, *about):
        if self.skip and self.each_step:
            self.skip = False
            return False
        self.t = t
        if hasattr(self.callback, "order"):
            self.callback.order = self.order
        try:
            return self.callback(t, *about)
        except Exception as error:
            self.error = UserFunctionError("the callback", t, error)
            return True
