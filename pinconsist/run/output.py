"""What a run keeps: rows, step history, interpolants."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..errors import PinconsistError, UserFunctionError
from .dense import DenseOutput, Made
from .events import Event

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

    Attributes
    ----------
    reached : float
        The time reached, s.
    nsteps : int
        Number of steps.
    """

    def __init__(self, output: Output, t_span, finish, interrupted):
        self.output = output
        self.span = t_span
        self.reached = t_span[0]
        self.nsteps = 0
        self._finish = finish
        self._interrupted = interrupted
        self._orders: list = []
        self._curves: list = []
        self._blocks: list = []  # rows with the multipliers of the rows of constraints that are kept now
        self._finished: list = []
        self._ordered = hasattr(output.callback, "order")
        self._ended: BaseException | None = None  # by the callback

    @property
    def at_steps(self) -> bool:
        """Whether the rows are the ends of steps."""
        return self.output.t_eval is None

    @property
    def due(self):
        """The times of rows after the first one."""
        times = self.output.t_eval
        return times[1:] if len(times) and times[0] == self.span[0] else times

    def first(self, t, p, v, lam) -> None:
        """The initial row."""
        if self.at_steps or len(self.due) < len(self.output.t_eval):
            self._row(t, p, v, lam)
        if self.output.each_step and self.sees(t, p, v, lam, None):
            raise self._ended

    @property
    def begun(self) -> bool:
        """Whether there is a row."""
        return bool(self._blocks or self._finished)

    @property
    def forward(self) -> bool:
        """Whether the run goes forward in time."""
        return bool(self.span[1] >= self.span[0])

    def last(self):
        """t, p, v and λ of the last row."""
        rows = [each[-1] for each in (self._blocks or self._finished)[-1]]
        lam = self._finish(rows[1], rows[3], rows[2]) if self._blocks else rows[3]
        return float(rows[0]), rows[1], rows[2], lam

    def add(self, made: Made) -> None:
        """Add steps; raises what the callback has ended them with."""
        if len(made.rows[0]):
            self._blocks.append(made.rows)
            if self.at_steps:
                self._orders.append(made.orders)
        if made.steps:
            self.nsteps += made.steps
            self.reached, size, order = made.reached
            if self.output.dense:
                self._curves.append(made.curve)
            if self.output.callback is not None and not self.output.each_step:
                self.output.callback(self.reached, size, order, made.steps)
        if self._ended is not None:
            raise self._ended

    def jump(self, t, p, v, lam) -> None:
        """The state after an event or a jump of forces: a second row at the same time; with `t_eval` the only one."""
        if self.at_steps:
            self._row(t, p, v, lam)
        elif self._blocks and self._blocks[-1][0][-1] == t:
            self._blocks[-1] = tuple(each[:-1] for each in self._blocks[-1])
            self._row(t, p, v, lam)

    def _row(self, t, *state):
        self._blocks.append((np.array([t]), *(each[None] for each in state)))
        if self.at_steps:
            self._orders.append([0])

    def since(self, t):
        """(t, p, v) and the order of each step after a time, the latest ones last."""
        rows, orders = [], []
        sign = 1.0 if self.forward else -1.0
        for block, order in zip(reversed(self._blocks), reversed(self._orders), strict=False):
            n = int(np.searchsorted(sign * block[0], sign * t, side="right"))
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
        if not self.at_steps:
            return np.zeros(0), np.zeros(0, int)
        return t[1:] - t[:-1], np.concatenate([np.zeros(0, int), *self._orders[1:]])

    def dense(self):
        """The continuous solution, if requested."""
        return DenseOutput(self._curves) if self._curves else None

    def sees(self, t, p, v, lam, order) -> bool:
        """Call the user's callback with the end of a step; returns whether it ends the run."""
        row = p, v, self._finish(p, lam, v)
        for each in row:
            each.setflags(write=False)
        self._ended = self._called_back((t, *row), order if self._ordered else None)
        return self._ended is not None

    def _called_back(self, row, order):
        """Call the user's callback with a row; returns the reason to end the run there, or None."""
        callback = self.output.callback
        try:
            if order is not None:
                callback.order = int(order)
            if callback(*row):
                return Stop(STOPPED, f"stopped by the callback at t = {row[0]:.6g}")
            return KeyboardInterrupt() if self._interrupted() else None
        except PinconsistError as error:
            return error
        except Exception as error:
            raised = UserFunctionError("the callback", row[0], error)
            raised.__cause__ = error
            return raised
        except BaseException as error:
            return error
