"""The state of a multistep run, and how it advances by one accepted step."""

import time

import numpy as np

from ..errors import PinconsistError
from . import bdf, start
from .charts import longest_step, turning_coordinates
from .dense import Curve, StepBatch
from .events import Signs, located
from .index1 import Index1
from .newton import Newton
from .rounding import Headway, RoundingTest, representable, shortest_step, velocity_rounding
from .segments import Segment
from .tuning import FAILURES, LOOKS_OF_BDF, NUDGE, PATIENCE, UNNOTICED


class Stepper:
    """Backward differences, step and order of one run of a system by a method.

    Attributes
    ----------
    t, h, k : float, float, int
        Time reached, next step (signed), order.
    base, Z : ndarray
        Chart centre and table, see :mod:`pinconsist.dae.bdf`.
    y, p : ndarray
        [ξ | v | λ] and position at `t`.
    used : (float, int)
        Step and order of the last accepted step.
    index1 : Index1
        The equations of index 1, for starts and events.
    batch : int
        Steps that one call of :meth:`steps` makes at most.
    ahead : bool
        Whether steps may be made before events and callbacks have seen the previous ones: steps are cheap, and use no
        user's function that an event or a callback might change.
    rows_watched : int
        Steps after which the choice of constraint rows is checked.
    unseen : list of (t, p, v, λ)
        States of the last step, or of a start, at which events have not been evaluated yet.
    signs : type
        Evaluates them, see :class:`~pinconsist.dae.events.Signs`.
    backend : str
        Name of the method, for the record.
    """

    batch, ahead, rows_watched, signs, backend = 50, False, 5, Signs, "python"

    def __init__(self, system, method):
        self.method, self.control = method, method.control
        self.control.fit(system)
        self.newton, self.rounding, self.headway = Newton(), RoundingTest(), Headway()
        self._begun, self.unseen = False, []
        self.change_system(system)

    def close(self) -> None:
        """Release what only a run needs."""

    def change_system(self, system) -> None:
        """Continue with another system of the same sizes, from the next :meth:`begin` on; counters are kept."""
        self.system, self.index1 = system, Index1(system)

    def passes_changes(self, with_curve: bool) -> bool:
        """Whether :meth:`steps` accepts ``forces``, and continues on its own at the times at which they jump."""
        return False

    def full_multipliers(self, p, lam):
        """The multipliers as the user sees them, of one row or a stack of rows."""
        return self.system.full_multipliers(p, lam)

    def opened(self, times, positions):
        """The first row at which a constraint that was left out is violated, see :meth:`Index3System.opened`."""
        return self.system.opened(times, positions)

    def begin(self, t, p, v, t_end, known=None):
        """Start, or start again after a discontinuity, with a full-order history.

        `known` are acceleration and multipliers there, if (p, v) is on the constraints already.

        Returns
        -------
        list of (t, p, v, λ)
            The states of the history, from `t` on; the last one is the current state of the run.
        """
        system, method = self.system, self.method
        self.control.restart()
        self._turns = None if system.vector_like else turning_coordinates(system, p)
        if method.step is not None:
            steps = max(1, int(np.ceil(abs(t_end - t) / method.step - 1e-9)))
            if self._begun and abs(t_end - t) > 1e-3 * method.step:
                steps = max(steps, method.order)  # after an event, too few rows would make a poor interpolant
            self.h, self.k = (t_end - t) / steps, method.order
            states = start.equidistant_history(self.index1, t, p, v, self.h, min(self.k, steps + 1))
            self._start, self._steps, self._taken = t, steps, len(states) - 1
        else:
            self.k, self._taken = method.order, 0
            self.h, states = self._history(t, p, v, t_end)
        if abs(states[-1][0] - t_end) <= 1e-9 * abs(self.h):
            states[-1] = (t_end, *states[-1][1:])  # else a step of a few spacings of t would be left
        self.t, self.p = states[-1][:2]
        self.rounding.restart()
        self.headway.restart(t, self.t)
        if self._turns is not None and (too_fast := self._turns_too_far(states[-1][2])):
            raise PinconsistError(f"the run cannot start at t = {t:.6g}: {too_fast}")
        self.base, self.Z = start.fill_table(system, states)
        method.mode.start(system, self.h, self.k, self.base, self.Z, states)
        self.t_old, self.y, self.used = states[0][0], self.Z[0].copy(), (self.h, 0)
        self._points, self._choice, self._begun = len(states), (self.h, self.k), True
        self._changed, self._changes = bdf.UNCHANGED if len(states) > 1 else None, None
        self._on_trial = False
        return states

    def _history(self, t, p, v, t_end):
        """Step and states of a start with variable steps."""
        return start.adaptive_history(self.index1, t, p, v, t_end, self.k, self.control, self.method.first_step)

    def watched(self, signs) -> bool:
        """Evaluate the signs at the unseen states until one has changed; returns whether one has."""
        while self.unseen:
            if 0.0 in signs.values:
                beside = signs.end + NUDGE * (self.unseen[0][0] - signs.end)
                if signs.look(beside, *self.segment().look(beside, signs.with_multipliers)):
                    return True
            if signs.look(*self.unseen.pop(0)):
                return True
        return False

    def locate(self, signs, i):
        """The time of an event between the last two evaluations, see :func:`~pinconsist.dae.events.located`."""
        return located(self.segment(), signs, i)

    def _looks(self, state, with_multipliers):
        """The states at which events are evaluated in the last step, which ends at `state`."""
        segment, parts = self.segment(), np.arange(1, LOOKS_OF_BDF) / LOOKS_OF_BDF
        times = (self.t - self.used[0] * (1.0 - parts)).tolist()
        return [*((t, *segment.look(t, with_multipliers)) for t in times), state]

    def resume(self, t_end):
        """Continue after a jump of forces at the time reached; returns what :meth:`begin` does."""
        return self.begin(self.t, self.p, self.velocity_and_multipliers()[0], t_end)

    def steps(self, t_end, most, with_curve, signs=None, sees=None) -> StepBatch:
        """Accepted steps towards `t_end`, at most `most`, with their polynomials where requested.

        They end where `signs`, if not None, have changed. ``sees(t, p, v, λ, order)``, if not None, is called with each
        step before the next is made; a true value ends the batch.
        """
        states, orders, segments, due = [], [], [], time.monotonic() + PATIENCE
        failure, error = "", None
        try:
            while len(states) < most and self.t != t_end and not (states and time.monotonic() > due):
                self.prepare_next()
                failure = self.advance(t_end)
                if failure:
                    break
                state, order = (self.t, self.p, *self.velocity_and_multipliers()), self.used[1]
                self.unseen = [] if signs is None else self._looks(state, signs.with_multipliers)
                changed = signs is not None and self.watched(signs)
                states.append(state)
                orders.append(order)
                segments += [self.interpolant()] if with_curve else []
                if changed or (sees is not None and sees(*state, order)):
                    break
                if signs is not None and signs.interrupted():
                    raise KeyboardInterrupt
        except BaseException as raised:  # the steps made so far are kept; the caller raises it
            error = raised
        return StepBatch.of(states, orders, Curve(segments) if segments else None, failure, error)

    def advance(self, t_end) -> str:
        """Make one accepted step towards `t_end`; return the reason of a failure, or an empty string."""
        system, control = self.system, self.control
        control.reached(system, self.y, self.p)
        if self._turns is not None and (too_fast := self._turns_too_far(self.velocity_and_multipliers()[0])):
            return too_fast
        tried = (0.0, 0.0)  # length of the step that failed the error test last, and its error
        while True:
            t_next = self._next_time(t_end)
            if t_next == self.t:  # accepted steps have become too short, as near a pole
                return FAILURES["error_test"]
            h, k, Z = self.h, self.k, self.Z
            self.base, predicted, psi = bdf.predict(system, k, self.base, Z)
            weight, tol = control.weights(system, predicted, self.base, h)
            step = self.newton.attempt(system, t_next, self.base, psi, predicted, h / bdf.alpha(k), weight, tol)
            if step.failure:
                smaller = control.after_failure(h)
                if smaller is None:
                    return step.failure
            else:
                self.method.mode.correct(system, step)
                y = step.y
                d = y - predicted
                error = control.error(system, d, k, weight)
                noisy = error > (1.0 if tried[0] else UNNOTICED) and (tried[0] or not self._on_trial)
                rounding = noisy and self._is_rounding(step, d, weight, tried)
                if error <= 1.0 or rounding:
                    break
                tried = abs(h), error
                smaller, self.k = control.after_rejection(system, Z, d, k, h, error, weight)
            if self.headway.setback() or abs(smaller) < shortest_step(self.t):
                return step.failure or FAILURES["error_test"]
            self.rescale(smaller, k)
        Z[k + 2] = d
        self.Z = Z = bdf.advance(k) @ Z
        self.t_old, self.t, self.p, self.y, self.used, self._points = self.t, t_next, step.p, y, (h, k), k + 1
        self._changed, self._changes = bdf.UNCHANGED, self._changed
        self._taken += 1
        if rounding:
            self._choice = control.after_rounding(h, tried[0]), k
        else:
            self._choice = control.next_step(system, Z, k, h, error, weight)
        # A longer step that is tried after one that would have passed must pass on its own.
        self._on_trial = rounding and error <= 1.0 and abs(self._choice[0]) > max(abs(h), tried[0])
        self.rounding.accepted()
        self.headway.reached(self.t)
        return ""

    def _is_rounding(self, step, d, weight, tried) -> bool:
        h, k, (used, order), known = self.h, self.k, self.used, len(weight)
        expected = (h / used) ** (k + 1) * self.Z[k + 1] if order else d

        def size(d):
            return self.control.error(self.system, d, k, weight)

        def noise():
            return velocity_rounding(self.system, step.t, step.p, step.v)

        return self.rounding.passes(size, h, k, d[:known], expected[:known], tried, step.v, noise)

    def prepare_next(self) -> None:
        """Change to the step and order that the control chose; the last step's segment is no longer available."""
        h, k = self._choice
        charted = self._turns is not None and self.method.step is None
        if charted:
            h = np.copysign(min(abs(h), self._longest_step(self.velocity_and_multipliers()[0], k)), h)
        if h != self.h:
            self.rescale(h, k)
        self.k = k
        if charted:
            self._shorten_to_charts()

    def _shorten_to_charts(self) -> None:
        """Shorten the step if the velocity at its end would turn a joint beyond its chart."""
        nx, nv, h = self.system.nx, self.system.nv, self.h
        while self._longest_step(self.Z[: self.k + 1, nx : nx + nv].sum(axis=0), self.k) < (1.0 - 1e-9) * abs(self.h):
            self.rescale(0.7 * self.h, self.k)
        if self.h != h:
            self.control.restart()

    def segment(self) -> Segment:
        """The interpolant of the last accepted step (or of the starting history)."""
        t, Z = self.t, self.Z.copy()
        return Segment(self.t_old, t, t, self.used[0], self._points - 1, self.base, Z, self._changes, self.system)

    def interpolant(self):
        """The same for rows inside the step."""
        return self.segment()

    def velocity_and_multipliers(self):
        """v and λ at the time reached."""
        nx, nv = self.system.nx, self.system.nv
        return self.y[nx : nx + nv], self.y[nx + nv :]

    def rescale(self, h, k) -> None:
        """Change the step to `h`, keeping the interpolating polynomial of degree k."""
        self._stretch(representable(self.t, h), k)

    def _stretch(self, h, k) -> None:
        change = bdf.rescale(k, h / self.h)
        self.Z[: k + 1], self._changed = change @ self.Z[: k + 1], self._changed.copy()
        self._changed[: k + 1] = change @ self._changed[: k + 1]
        self.h = float(h)

    def _longest_step(self, v, k) -> float:
        return longest_step(self._turns, self.system.rate(self.t, self.p, v), k)

    def _turns_too_far(self, v) -> str:
        """Why a fixed step is too long for the charts, or an empty string."""
        if self.method.step is None or abs(self.h) <= (longest := self._longest_step(v, self.k)):
            return ""
        return (
            f"a joint turns so fast that it makes half a turn in the {self.k + 2} steps that order {self.k} uses, "
            f"which is the limit of a rotation chart; use step <= {longest:.3g} s"
        )

    def _next_time(self, t_end):
        """The time of the next step; the last steps of a variable run are fitted to the end."""
        if self.method.step is not None:
            return self._start + (self._taken + 1) * self.h if self._taken + 1 < self._steps else t_end
        left = (t_end - self.t) / self.h
        if left >= 2.0:
            return self.t + self.h
        last = left < 1.0 + 1e-9
        self._shorten((t_end - self.t) / (1 if last else 2))  # two equal steps avoid a tiny last one
        return t_end if last else self.t + self.h

    def _shorten(self, h) -> None:
        self._stretch(h, self.k)  # not rounded: it leads to the end exactly
        self.control.restart()
