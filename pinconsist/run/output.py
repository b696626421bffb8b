"""What a run keeps: rows, step history, interpolants."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import repeat

import numpy as np

from ..errors import PinconsistError, UserFunctionError
from .dense import DenseOutput, StepBatch
from .events import Event, read_only

SUCCESS, STOPPED, FAILED = 0, 1, -1


@dataclass
class Output:
    """What to record besides the steps.

    Attributes
    ----------
    t_eval : ndarray or None
        Times of the rows; None records every accepted step.
    dense : bool
        Keep the interpolants.
    events : tuple of Event
    callback : callable or None
        ``callback(t, p, v, lam)`` after every accepted step; a true value stops the run. Its attribute ``order``,
        if it has one, is set to the order of the step first. If its attribute ``each_step`` is false, it only reports
        progress: ``callback(t, step, order, count)`` is called now and then, after `count` more steps, the last one to
        t.
    exact : bool
        Steps end at the times of `t_eval`, so that no row is interpolated.
    """

    t_eval: np.ndarray | None = None
    dense: bool = False
    events: tuple[Event, ...] = ()
    callback: Callable | None = None
    exact: bool = False

    @property
    def each_step(self) -> bool:
        """Whether the callback is called with each step."""
        return self.callback is not None and getattr(self.callback, "each_step", True)


class Stop(Exception):
    """Ends a run with a status and a message."""

    def __init__(self, status: int, message: str):
        super().__init__(message)
        self.status = status


class Record:
    """Keeps what was requested, in the order of the run.

    ``finish(p, lam, v)`` returns the multipliers as the user sees them, of one row or a stack of rows;
    ``interrupted()`` says after each call of the callback whether to end the run.
    """

    def __init__(self, output: Output, t_span, finish, interrupted):
        self.output, self.reached, self.nsteps, self._finish, self.span = output, t_span[0], 0, finish, t_span
        self._interrupted = interrupted
        self.needs_curve = output.dense or output.t_eval is not None
        self._sign = 1.0 if t_span[1] >= t_span[0] else -1.0
        self._orders, self._curves = [], []
        self._blocks, self._finished = [], []
        self._due = output.t_eval  # times of rows not reached yet
        self._ordered = hasattr(output.callback, "order")
        self._called, self._ended = 0, None  # rows of the next batch already called back, and what ends the run

    def first(self, t, p, v, lam) -> None:
        """The initial row."""
        if self._due is None or (len(self._due) and self._due[0] == t):
            self._row(t, p, v, lam)
            self._due = self._due if self._due is None else self._due[1:]
        if self.output.each_step:
            ended = self._call_back(np.array([t]), [each[None] for each in (p, v, lam)], None)[1]
            if ended is not None:
                raise ended

    def next_stop(self, t, t_end) -> float:
        """The first time after `t` at which a step has to end, or `t_end`."""
        if not self.output.exact or not len(self._due):
            return t_end
        return min(float(self._due[0]), t_end, key=lambda time: abs(time - t))

    @property
    def begun(self) -> bool:
        """Whether there is a row."""
        return bool(self._blocks or self._finished)

    @property
    def forward(self) -> bool:
        """Whether the run goes forward in time."""
        return self._sign > 0.0

    def last(self):
        """t, p, v and λ of the last row."""
        rows = [each[-1] for each in (self._blocks or self._finished)[-1]]
        lam = self._finish(rows[1], rows[3], rows[2]) if self._blocks else rows[3]
        return float(rows[0]), rows[1], rows[2], lam

    def add(self, batch: StepBatch) -> None:
        """Add accepted steps, up to the one at which the callback stops the run."""
        if not len(batch.t):
            return
        seen, ended = self._report(batch)
        self._keep(batch if ended is None else batch.first(seen))
        if ended is not None:
            raise ended

    def _keep(self, batch) -> None:
        end = batch.t[-1]
        self.nsteps += len(batch.t)
        self.reached = float(end)
        if self.output.dense:
            self._curves.append(batch.curve)
        if self._due is None:
            at, lam = batch.jumps
            if len(at) and at[0] == 0:  # at the end of the previous batch
                self.jump(*self.last()[:3], lam[0])
                batch.jumps = at[1:], lam[1:]
            *rows, order = batch.with_jumps()
            self._orders.append(order)
            self._blocks.append(tuple(rows))
            return
        n = int(np.searchsorted(self._sign * self._due, self._sign * end, side="right"))
        if n:
            self._blocks.append((self._due[:n], *batch.curve(self._due[:n])))
            self._due = self._due[n:]

    def jump(self, t, p, v, lam) -> None:
        """The state after an event or a jump of forces: a second row at the same time; with `t_eval` the only one."""
        if self._due is None:
            self._row(t, p, v, lam)
            self._orders.append([0])
        elif self._blocks and self._blocks[-1][0][-1] == t:
            self._blocks[-1] = tuple(each[:-1] for each in self._blocks[-1])
            self._row(t, p, v, lam)

    def _row(self, t, *state):
        self._blocks.append((np.array([t]), *(each[None] for each in state)))

    def since(self, t):
        """(t, p, v) and the order of each step after a time, the latest ones last."""
        rows, orders = [], []
        for block, order in zip(reversed(self._blocks), reversed(self._orders), strict=False):
            n = int(np.searchsorted(self._sign * block[0], self._sign * t, side="right"))
            rows[:0] = zip(*(each[n:] for each in block[:3]), strict=True)
            orders[:0] = order[n:]
            if n:
                break
        return rows, orders

    def complete_multipliers(self) -> None:
        """Complete the multipliers recorded so far, by the constraint rows that were kept for them."""
        if self._blocks:
            t, p, v, lam = map(np.concatenate, zip(*self._blocks, strict=True))
            self._finished.append((t, p, v, self._finish(p, lam, v)))
            self._blocks = []

    def arrays(self, system):
        """t, p, v, λ as arrays."""
        self.complete_multipliers()
        if not self._finished:
            return np.zeros(0), *(np.zeros((0, n)) for n in (system.npos, system.nv, system.n_multipliers))
        if len(self._finished) == 1:
            return self._finished[0]
        return tuple(map(np.concatenate, zip(*self._finished, strict=True)))

    def steps(self, t):
        """Step and order by which each of the rows at times `t` was reached; empty if rows are not steps."""
        if self._due is not None:
            return np.zeros(0), np.zeros(0, int)
        return t[1:] - t[:-1], np.concatenate([np.zeros(0, int), *self._orders])

    def dense(self):
        """The continuous solution, if requested."""
        return DenseOutput(self._curves) if self._curves else None

    def _report(self, batch):
        if self.output.each_step:
            return self._call_back(batch.t, batch.states, batch.order)
        if self.output.callback is not None:
            start = batch.t[-2] if len(batch.t) > 1 else self.reached
            self.output.callback(batch.t[-1], abs(batch.t[-1] - start), int(batch.order[-1]), len(batch.t))
        return len(batch.t), None

    def sees(self, t, p, v, lam, order) -> bool:
        """Call the user's callback with a step before its batch is added; returns whether it ends the run."""
        row = p, v, self._finish(p, lam, v)
        for each in row:
            each.setflags(write=False)
        self._called, self._ended = self._called + 1, self._called_back((t, *row), order if self._ordered else None)
        return self._ended is not None

    def _call_back(self, times, states, orders):
        """Call the user's callback with each row; returns the number of rows called, and what ends the run or None."""
        seen, ended, (p, v, lam) = self._called, self._ended, states
        self._called, self._ended = 0, None
        if ended is None and seen < len(times):
            left = (read_only(each[seen:]) for each in (p, v, self._finish(p, lam, v)))
            rows = zip(times[seen:].tolist(), *left, strict=True)
            orders = repeat(None) if orders is None or not self._ordered else orders[seen:]
            for row, order in zip(rows, orders, strict=False):
                seen, ended = seen + 1, self._called_back(row, order)
                if ended is not None:
                    break
        return seen, ended

    def _called_back(self, row, order):
        """Call the user's callback with a row; returns the reason to end the run there, or None."""
        callback = self.output.callback
        try:
            if order is not None:
                callback.order = int(order)
            if callback(*row):
                return Stop(STOPPED, f"stopped by the callback at t = {row[0]:.6g}")
            return KeyboardInterrupt() if self._interrupted() else None
        except Exception as error:
            if isinstance(error, PinconsistError):
                return error
            told = UserFunctionError("the callback", row[0], error)
            told.__cause__ = error
            return told
        except BaseException as error:
            return error
