"""A run as a chain of stretches between checkpoints.

At every checkpoint the integration begins anew from the state there, whether the run was interrupted or not. So the
numbers after it depend on that state alone, and a run that is continued from its file has those of one that went
through.
"""

from __future__ import annotations

import logging
import time
from dataclasses import replace
from math import ceil

import numpy as np

from ..errors import InputError, PinconsistError, SavingError, UserFunctionError
from ..interrupts import deferred
from ..simulation import integrate, simulate

STEPPED = ("h", "order")
ROWS = ("t", "q", "v", "lam")
COUNTERS = ("nsteps", "nfev", "njev", "nlu")
MOST = 100_000
_log = logging.getLogger(__name__)


def checkpoints(t_span, period) -> list[float]:
    """The ends of the stretches, the last one the end of the span."""
    start, end = t_span
    if period is None:
        return [end]
    count = max(1, ceil(abs(end - start) / period - 1e-9))
    if count > MOST:
        raise InputError(
            f"save_every = {period:g} s makes {count} checkpoints of {abs(end - start):g} s; at most {MOST}"
        )
    sign = 1.0 if end >= start else -1.0
    return [start + sign * k * period for k in range(1, count)] + [end]


def carried_out(recipe, mechanism, file, *, begun=None, callback=None):
    """Carry out a recipe with a mechanism on which all forces act, from where it has `begun`, saving as it goes.

    Parameters
    ----------
    recipe : Recipe
    mechanism : Mechanism
    file : path or None
        Where it is saved, at every checkpoint and at the end.
    begun : Solution, optional
        The run as it was saved; it goes on from its last checkpoint.
    callback : callable, optional
        As in :func:`pinconsist.simulate`.

    Raises
    ------
    SavingError
        The end cannot be written; it carries the solution.
    """
    chain, saving = _Chain(recipe, mechanism, callback), _Saving(file)
    if begun is not None and recipe.checkpoint is not None:
        chain.take_up(begun)
    with deferred(late=False):
        try:
            for end in chain.ends_to_come():
                chain.advance(end)
                if chain.status != 0:
                    break
                if end != recipe.t_span[1] and saving.is_due():
                    saving.save(chain.solution())
        except (PinconsistError, KeyboardInterrupt, MemoryError) as error:
            if chain.last is None:  # nothing was reached that could be lost
                raise
            chain.stop(error)
        return chain.solution() if file is None else saved(chain.solution(), file)


def saved(solution, file):
    """Save a solution; SavingError, with the solution, where that fails."""
    try:
        with deferred(impatient=False):
            solution.save(file)
    except OSError as error:
        raise SavingError(f"{file} cannot be written: {error.strerror or error}", solution=solution) from error
    return solution


class _Saving:
    """Saves at checkpoints, but for a tenth of the time at most: each save writes the whole run so far."""

    def __init__(self, file):
        self.file, self.next = file, 0.0

    def is_due(self):
        return self.file is not None and time.monotonic() >= self.next

    def save(self, solution):
        """A disk that is full now may have room at the next checkpoint, and the run itself is whole."""
        began = time.monotonic()
        try:
            saved(solution, self.file)
        except SavingError as error:
            _log.warning("%s, at t = %g; the run goes on, and is saved at the next checkpoint", error, solution.t[-1])
        self.next = time.monotonic() + 10 * (time.monotonic() - began)


class _Chain:
    """The rows so far, and what the next stretch begins with."""

    def __init__(self, recipe, mechanism, callback):
        self.recipe, self.mechanism = recipe, mechanism
        self.watch = None if callback is None else _Watch(callback)
        self.parts, self.counted, self.rejected = [], dict.fromkeys(COUNTERS, 0), {}
        self.last, self.status, self.message, self.whole = None, 0, "", False

    def take_up(self, solution):
        """Begin with the rows of a saved run up to its last checkpoint."""
        at, names = self.recipe.checkpoint, (*ROWS, *STEPPED)
        steps = min(len(solution.h), max(at["rows"] - 1, 0))
        cut = {name: getattr(solution, name)[: steps if name in STEPPED else at["rows"]] for name in names}
        self.parts, self.last = [cut], solution
        self.counted, self.rejected = dict(at["counted"]), dict(at["rejected"])

    def ends_to_come(self):
        ends = checkpoints(self.recipe.t_span, self.recipe.save_every)
        return ends if self.recipe.checkpoint is None else ends[ends.index(self.recipe.checkpoint["t"]) + 1 :]

    def advance(self, end):
        """One stretch."""
        self._add(self._stretch(end), end)

    def _stretch(self, end):
        at, options = self.recipe.checkpoint, dict(self.recipe.options)
        start = self.recipe.t_span[0] if at is None else at["t"]
        if (most := options.get("max_steps")) is not None and at is not None:
            if self.counted["nsteps"] >= most:
                raise PinconsistError(_used_up(most, start, self.recipe.t_span[1]))
            options["max_steps"] = most - self.counted["nsteps"]
        if options.get("t_eval") is not None:
            asked = _within(options["t_eval"], start, end, at is None)
            options["t_eval"] = asked if end in asked else [*asked, end]
        if at is None:
            first = self.recipe.q0, self.recipe.v0
            return simulate(self.mechanism, (start, end), *first, callback=self.watch, **options)
        options.pop("first_step", None)
        if self.watch:
            self.watch.begin()
        q, v = np.array(at["q"]), np.array(at["v"])
        return integrate(self.mechanism, (start, end), q, v, callback=self.watch, **options)

    def _add(self, run, end):
        """The rows of a stretch; its first one is the last of the stretch before."""
        asked, first, last = self.recipe.options.get("t_eval"), 0, len(run.t)
        if asked is None:
            first = 1 if self.parts else 0
        elif end not in asked and last and run.t[-1] == end:  # a row to go on from, which nobody asked for
            last -= 1
        rows = slice(first, last)
        self.parts.append({n: getattr(run, n)[rows] for n in ROWS} | {n: getattr(run, n) for n in STEPPED})
        for name in COUNTERS:
            self.counted[name] += getattr(run, name)
        for reason, count in run.rejected.items():
            self.rejected[reason] = self.rejected.get(reason, 0) + count
        self.last, self.status, self.message = run, run.status, run.message
        most = self.recipe.options.get("max_steps")
        if self.status == -1 and most is not None and self.counted["nsteps"] >= most:
            self.message = _used_up(most, run.t[-1] if len(run.t) else self.recipe.t_span[0], self.recipe.t_span[1])
        if self.watch and self.watch.error:
            self.status, self.message = -1, f"{self.watch.error} (reached t = {self.watch.t:.6g})"
        if self.status == 0 and end != self.recipe.t_span[1]:
            self.message = f"saved at t = {end:g} of {self.recipe.t_span[1]:g}; to be continued by pinconsist resume"
            state = {"t": end, "q": run.q[-1].tolist(), "v": run.v[-1].tolist()}
            state |= {"rows": sum(len(part["t"]) for part in self.parts)}
            counted = {"counted": dict(self.counted), "rejected": dict(self.rejected)}
            self.recipe = replace(self.recipe, checkpoint=state | counted)
        elif self.status == 0:
            self.recipe, self.whole = replace(self.recipe, checkpoint=None), True

    def stop(self, error):
        """End as the error says that came between two stretches; one that came after the last ends nothing."""
        if self.whole:
            return
        where = self.recipe.t_span[0] if self.recipe.checkpoint is None else self.recipe.checkpoint["t"]
        if isinstance(error, KeyboardInterrupt):
            self.status, self.message = 1, f"interrupted at t = {where:.6g}; the solution holds what was reached"
        elif isinstance(error, MemoryError):
            self.status, self.message = -1, f"out of memory after t = {where:.6g}; t_eval= keeps fewer rows"
        else:
            self.status, self.message = -1, str(error)

    def solution(self):
        """What was reached; status 1 where there is more to come."""
        whole = {name: np.concatenate([part[name] for part in self.parts]) for name in (*ROWS, *STEPPED)}
        for array in whole.values():
            array.setflags(write=False)
        on_the_way = self.status == 0 and self.recipe.checkpoint is not None
        return replace(
            self.last, **whole, **self.counted, rejected=self.rejected, message=self.message,
            status=1 if on_the_way else self.status, success=self.status >= 0, recipe=self.recipe.plain(), versions={},
        )  # fmt: skip


def _used_up(most, t, end):
    return f"max_steps = {most} used up at t = {t:.6g} of {end:.6g}"


def _within(times, start, end, with_start):
    """The times in a stretch."""
    low, high = min(start, end), max(start, end)
    return [t for t in times if low <= t <= high and (with_start or t != start)]


class _Watch:
    """A user's callback; an exception in it ends the run instead of losing it."""

    def __init__(self, callback):
        self.callback, self.order, self.t, self.error, self.skip = callback, 0, 0.0, None, False

    def begin(self):
        """A new stretch, of which the first row was told already."""
        self.skip = True

    def __call__(self, t, q, v, lam):
        if self.skip:
            self.skip = False
            return False
        self.t = t
        if hasattr(self.callback, "order"):
            self.callback.order = self.order
        try:
            return self.callback(t, q, v, lam)
        except Exception as error:
            self.error = UserFunctionError("the callback", t, error)
            return True
