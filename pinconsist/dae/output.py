"""What a run keeps: rows, step history, interpolants."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..errors import PinconsistError, UserFunctionError
from .dense import DenseOutput
from .events import Event

SUCCESS, STOPPED, FAILED = 0, 1, -1


@dataclass
class Output:
    """What to record beside the steps.

    Attributes
    ----------
    t_eval : ndarray or None
        Times of the rows; None records every accepted step.
    dense : bool
        Keep the interpolants.
    events : tuple of Event
    callback : callable or None
        ``callback(t, p, v, lam)`` after every accepted step; a true value stops the run. Its attribute ``order``,
        if it has one, is set to the order of the step first.
    """

    t_eval: np.ndarray | None = None
    dense: bool = False
    events: tuple[Event, ...] = ()
    callback: Callable | None = None


class Stop(Exception):
    """Ends a run with a status and a message."""

    def __init__(self, status: int, message: str):
        super().__init__(message)
        self.status = status


class Record:
    """Keeps what was asked for, in the order of the run.

    ``finish(p, lam)`` gives the multipliers as the user sees them, of one row or a stack of rows.
    """

    def __init__(self, output: Output, t_span, finish):
        self.output, self.reached, self.nsteps, self._finish = output, t_span[0], 0, finish
        self.needs_segments = output.dense or output.t_eval is not None
        self._sign = 1.0 if t_span[1] >= t_span[0] else -1.0
        self._rows, self._orders, self._segments = [], [], []
        self._blocks, self._finished = [], []
        self._pending = None if output.t_eval is None else list(output.t_eval[::-1])

    def first(self, t, p, v, lam) -> None:
        """The initial row."""
        if self._pending is None or (self._pending and self._pending[-1] == t):
            self._rows.append((t, p, v, lam))
            if self._pending:
                self._pending.pop()
        self._call_back(t, p, v, lam)

    def steps_of(self, rows, segment, order) -> None:
        """States (t, p, v, λ) reached by steps of this order, and the interpolant over them."""
        if not rows:
            return
        end = rows[-1][0]
        self.nsteps += len(rows)
        if self.output.dense:
            self._segments.append(segment.until(end))
        self.reached = end
        if self._pending is None:
            self._orders += [order] * len(rows)
            self._rows += rows
        while self._pending and self._sign * (self._pending[-1] - end) <= 0:
            t = self._pending.pop()
            self._rows.append((t, *segment(t)))
        self._report(rows, order)

    def block(self, t, p, v, lam, orders) -> None:
        """Rows as arrays, where nothing but the steps was asked for."""
        if not len(t):
            return
        self.nsteps += len(t)
        self.reached = t[-1]
        self._flush()
        self._orders += orders.tolist()
        self._blocks.append((t, p, v, lam))
        self._report(zip(t, p, v, lam, strict=True), int(orders[-1]))

    def jump(self, t, p, v, lam) -> None:
        """The state after an event: a second row at the same time."""
        if self._pending is None:
            self._rows.append((t, p, v, lam))
            self._orders.append(0)

    def complete_multipliers(self) -> None:
        """Complete the multipliers recorded so far, by the constraint rows that were kept for them."""
        self._flush()
        self._finished += [(t, p, v, self._finish(p, lam)) for t, p, v, lam in self._blocks]
        self._blocks = []

    def _flush(self) -> None:
        """The rows so far as a block of arrays."""
        if self._rows:
            t, *states = zip(*self._rows, strict=True)
            p, v, lam = (np.concatenate(column).reshape(len(t), -1) for column in states)  # faster than np.array
            self._blocks.append((np.array(t), p, v, lam))
            self._rows = []

    def arrays(self, system):
        """t, p, v, λ as arrays."""
        self.complete_multipliers()
        if not self._finished:
            return np.zeros(0), *(np.zeros((0, n)) for n in (system.npos, system.nv, system.n_multipliers))
        return tuple(map(np.concatenate, zip(*self._finished, strict=True)))

    def steps(self, t):
        """Step and order by which each of the rows at times `t` was reached; empty where rows are not steps."""
        if self._pending is not None:
            return np.zeros(0), np.zeros(0, int)
        return np.diff(t), np.array(self._orders, dtype=int)

    def dense(self):
        """The continuous solution, if asked for."""
        return DenseOutput(self._segments) if self._segments else None

    def _report(self, rows, order) -> None:
        callback = self.output.callback
        if callback is not None:
            if hasattr(callback, "order"):
                callback.order = order
            for row in rows:
                self._call_back(*row)

    def _call_back(self, t, p, v, lam):
        callback = self.output.callback
        if callback is None:
            return
        try:
            stop = callback(t, *map(_read_only, (p, v, self._finish(p, lam))))
        except PinconsistError:
            raise
        except Exception as error:
            raise UserFunctionError("the callback", t, error) from error
        if stop:
            raise Stop(STOPPED, f"stopped by the callback at t = {t:.6g}")


def _read_only(array):
    view = array.view()
    view.flags.writeable = False
    return view
