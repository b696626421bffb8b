"""The state of a multistep run and how it moves by one accepted step."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np

from ..errors import PinconsistError
from . import bdf, consistency, start
from .dense import Segment
from .foresight import REMEMBERED
from .newton import Newton
from .sizes import largest

SMALLEST = 16.0  # spacings of t: a step below this cannot be told from zero
NEAR_ROUNDING = 1e-9  # rtol down to which no error is believed to be rounding
HALF = 1e-8  # of the velocities, half their digits: nor is a larger error
SLOW = 0.5  # of the order: errors that fall more slowly with the step are rounding
PATIENCE = 0.05  # s after which no more steps are made in one call
SETBACKS, PROGRESS = 100, 1e-6  # failed tries that end a run, if it came on by less than this part meanwhile


@dataclass(slots=True)
class Stretch:
    """Accepted steps that were made in one call.

    Attributes
    ----------
    failure : str
        Why there are no more, or empty.
    error : BaseException or None
        What a user's function raised after these steps.
    pieces : list of (rows, segment, order)
        For each step its rows (t, p, v, λ), interpolant (None unless wished for) and order.
    block : tuple or None
        Instead of pieces (t, p, v, λ, order) as arrays over all steps.
    """

    failure: str = ""
    error: BaseException | None = None
    pieces: list = field(default_factory=list)
    block: tuple | None = None


class Stepper:
    """Backward differences, step and order of one run.

    Parameters
    ----------
    system : Index3System
    method : Method
        Order, control and consistency.

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
    at_once : int
        Steps that one call of :meth:`stretch` makes at most.
    backend : str
        Who makes the steps, for the record.
    """

    at_once, backend = 50, "python"

    def __init__(self, system, method):
        self.system, self.method, self.control = system, method, method.control
        self.control.fit(system)
        self.newton = Newton(system, correct=method.consistency == "every-step")
        self._begun = False

    def close(self) -> None:
        """Let go of what only a run needs: the twin holds the user's functions, unseen by the garbage collector."""

    def change_system(self, system) -> None:
        """Go on with another system of the same sizes, from the next :meth:`begin` on; the work is counted on."""
        before, self.system = self.newton, system
        self.newton = Newton(system, before.correct)
        self.newton.nfev, self.newton.njev, self.newton.nlu = before.nfev, before.njev, before.nlu

    def begin(self, t, p, v, t_end):
        """Start, or start again after a discontinuity, with a full-order history.

        Returns
        -------
        list of (t, p, v, λ)
            The states of the history, from `t` on; the run stands at the last of them.
        """
        system, method = self.system, self.method
        self.control.restart()
        self.newton.forget()
        self._felt, self._trusted = 0.0, 0  # up to which length steps are known to feel rounding, and how many
        if method.step is not None:
            steps = max(1, int(np.ceil(abs(t_end - t) / method.step - 1e-9)))
            if self._begun and abs(t_end - t) > 1e-3 * method.step:
                steps = max(steps, method.order)  # after an event, too few rows would make a poor interpolant
            self.h, self.k = (t_end - t) / steps, method.order
            states = start.equidistant_history(system, t, p, v, self.h, min(self.k, steps + 1))
            self._start, self._steps, self._taken = t, steps, len(states) - 1
        else:
            self.k, self._taken = method.order, 0
            self.h, states = start.adaptive_history(system, t, p, v, t_end, self.k, self.control, method.first_step)
        if abs(states[-1][0] - t_end) <= 1e-9 * abs(self.h):
            states[-1] = (t_end, *states[-1][1:])  # else a step of a few spacings of t would be left
        self.t, self.p = states[-1][:2]
        self._since = self._mark = self.t
        self._setbacks = 0  # since the time of the mark
        self._turns = None if system.vector_like else bdf.turning_coordinates(system, p)
        if self._turns is not None and (too_fast := self._turns_too_far(states[-1][2])):
            raise PinconsistError(f"no start at t = {t:.6g}: {too_fast}")
        self.base, filled = start.fill_table(system, states, self.k)
        if method.consistency == "initial":
            self._make_consistent(filled, states)
        self.Z = np.zeros((bdf.ROWS, filled.shape[1]))
        self.Z[: len(filled)] = filled
        self.t_old, self.y, self.used = states[0][0], self.Z[0].copy(), (self.h, 0)
        self._points, self._choice, self._begun = len(states), (self.h, self.k), True
        return states

    def stretch(self, t_end, most, watched) -> Stretch:
        """Accepted steps towards `t_end`, at most `most`, with interpolants where they are `watched`."""
        stretch, due = Stretch(), time.monotonic() + PATIENCE
        try:
            while len(stretch.pieces) < most and self.t != t_end and not (stretch.pieces and time.monotonic() > due):
                self.prepare_next()
                stretch.failure = self.advance(t_end)
                if stretch.failure:
                    break
                rows = [(self.t, self.p, *self.velocity_and_multipliers())]
                stretch.pieces.append((rows, self.segment() if watched else None, self.used[1]))
        except BaseException as error:  # what was reached is kept; the caller raises it
            stretch.error = error
        return stretch

    def advance(self, t_end) -> str:
        """One accepted step towards `t_end`; returns why there is none, or an empty string."""
        system, control = self.system, self.control
        if self._turns is not None and (too_fast := self._turns_too_far(self.velocity_and_multipliers()[0])):
            return too_fast
        tried = (0.0, 0.0)  # length of the step that failed the error test last, and its error
        while True:
            t_next = self._next_time(t_end)
            h, k, Z = self.h, self.k, self.Z
            self.base, predicted, psi = bdf.predict(system, k, self.base, Z)
            weight, tol = control.weights(system, predicted, self.base)
            step = self.newton.attempt(t_next, self.base, psi, predicted, h / bdf.alpha(k), weight, tol)
            if step.failure:
                smaller = control.after_failure(h)
                if smaller is None:
                    return step.failure
            else:
                d = step.change
                error = control.error(step, k)
                if error <= 1.0 or self._is_rounding(t_next, step, weight, error, tried):
                    break
                tried = abs(h), error
                smaller, self.k = control.after_rejection(system, Z, d, k, h, error, weight)
            self.newton.forget()
            self._setbacks += 1
            if abs(smaller) < SMALLEST * np.spacing(abs(self.t)) or self._setbacks > SETBACKS:
                return step.failure or "the error test fails at any step size"
            self.rescale(smaller, k)
        Z[k + 2] = d
        self.Z = Z = bdf.advance(k).dot(Z)
        self.t_old, self.t, self.p, self.y, self.used, self._points = self.t, t_next, step.p, step.y, (h, k), k + 1
        self._taken += 1
        if error > 1.0:  # rounding: a longer step that was tried is as good
            self._choice = float(np.copysign(max(abs(h), tried[0]), h)), k
            control.restart()
        else:
            self._choice = control.next_step(system, Z, k, h, error, weight)
        self._trusted -= 1
        if abs(self.t - self._mark) > PROGRESS * abs(self.t - self._since):
            self._mark, self._setbacks = self.t, 0
        return ""

    def _is_rounding(self, t, step, weight, error, tried) -> bool:
        """Whether it is rounding that fails the error test, which a shorter step would feel as much.

        Only tolerances near rounding ask. And it has to show: a longer step, tried from the same point, had no error to
        match its order. For a while steps up to that length are then believed at once, as far as the bound allows.
        """
        h = abs(self.h)
        longer, its_error = tried
        if self.control.tightest[0] > NEAR_ROUNDING:
            return False
        shown = h < longer and error >= its_error * (h / longer) ** (SLOW * (self.k + 1))
        known = self._trusted > 0 and h <= self._felt
        if not (shown or known) or error > self._rounding_error(t, step, weight):
            return False
        if shown:
            self._felt, self._trusted = max(self._felt if known else 0.0, longer), REMEMBERED
        return True

    def prepare_next(self) -> None:
        """Change to the step and order that the control chose; the last step's segment is gone after this."""
        h, k = self._choice
        charted = self._turns is not None and self.method.step is None
        if charted:
            h = np.copysign(min(abs(h), self._longest_step(self.velocity_and_multipliers()[0], k)), h)
        if h != self.h:
            self.rescale(h, k)
        self.k = k
        if charted:
            self._slow_down()

    def _slow_down(self) -> None:
        """Shorten the step where the velocity it leads to would turn a joint beyond its chart."""
        nx, nv, h = self.system.nx, self.system.nv, self.h
        while self._longest_step(self.Z[: self.k + 1, nx : nx + nv].sum(axis=0), self.k) < (1.0 - 1e-9) * abs(self.h):
            self.rescale(0.7 * self.h, self.k)
        if self.h != h:
            self.control.restart()

    def segment(self) -> Segment:
        """The interpolant of the last accepted step (or of the starting history)."""
        rows = self._points
        t = self.t
        return Segment(self.t_old, t, t, self.used[0], rows - 1, self.base, self.Z[:rows].copy(), self.system)

    def velocity_and_multipliers(self):
        """v and λ at the time reached."""
        nx, nv = self.system.nx, self.system.nv
        return self.y[nx : nx + nv], self.y[nx + nv :]

    def rescale(self, h, k) -> None:
        """Change the step to `h`, keeping the interpolating polynomial of degree k."""
        self.Z[: k + 1] = bdf.rescale(k, h / self.h).dot(self.Z[: k + 1])
        self.h = float(h)

    def _longest_step(self, v, k) -> float:
        """The step with which the k+2 intervals that a chart spans stay below half a turn of every joint."""
        speed = bdf.fastest_turn(self._turns, self.system.rate(self.t, self.p, v))
        return bdf.MAX_CHART_TURN / ((k + 2) * speed) if speed else np.inf

    def _turns_too_far(self, v) -> str:
        """Why a fixed step is too long for the charts, or an empty string."""
        if self.method.step is None:
            return ""
        longest = self._longest_step(v, self.k)
        if abs(self.h) <= longest:
            return ""
        return (
            f"a joint turns so fast that the {self.k + 2} steps which order {self.k} looks back on make half a turn, "
            f"and the charts of rotations end there; take step <= {longest:.3g} s"
        )

    def _next_time(self, t_end):
        """The time of the next step; the last steps of a variable run are fitted to the end."""
        if self.method.step is not None:
            return self._start + (self._taken + 1) * self.h if self._taken + 1 < self._steps else t_end
        left = (t_end - self.t) / self.h
        if left >= 2.0:
            return self.t + self.h
        last = left < 1.0 + 1e-9
        self.rescale((t_end - self.t) / (1 if last else 2), self.k)  # two equal steps: no tiny last one
        self.control.restart()
        return t_end if last else self.t + self.h

    def _rounding_error(self, t, step, weight) -> float:
        """The error that rounding leaves in this step: beside a singular position smaller steps cannot lower it."""
        system, k = self.system, self.k
        noise = np.zeros(len(weight))
        v = step.y[system.nx :][: system.nv]
        size = min(consistency.velocity_rounding(system, t, step.p, v), HALF * largest(v))
        noise[system.nx :] = 2.0 ** (k + 1) * size
        return self.control.error_in(system, noise, k, weight)

    def _make_consistent(self, Z, states):
        system, k = self.system, self.k
        t0, p0, v0, _ = states[0]
        if k == 1:
            velocities = [consistency.consistent_initial_velocity(system, t0, p0, v0, self.h)]
        else:
            velocities = consistency.consistent_history(system, self.h, k, self.base, Z, states)
        D = bdf.differences(len(states) - 1)
        Z[: len(states), system.nx : system.nx + system.nv] = D @ np.array(velocities[::-1])
