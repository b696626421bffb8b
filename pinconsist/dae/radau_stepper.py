"""A run of Radau IIA: one step after another, each depending only on (q, v)."""

from dataclasses import dataclass, replace
from math import copysign, hypot

import numpy as np

from ..errors import PinconsistError
from . import tuning
from .charts import fastest_turn, turning_coordinates
from .events import located
from .index1 import moved_by, projected, solve_acceleration
from .kkt import kkt_at
from .norms import EPS, largest, weighted_norm
from .radau import StageNewton, Stages
from .radau_control import exponent
from .radau_table import polynomials, table
from .rounding import shortest_step
from .segments import RadauSegment
from .stepper import Stepper
from .unseen import crosses, unstirred, with_unseen

TINY = 1e-300  # replaces zero in a denominator


@dataclass(slots=True)
class Landing:
    """The end of a step: p and v on the constraints, a and λ of the differential equation there."""

    p: np.ndarray
    v: np.ndarray
    a: np.ndarray
    lam: np.ndarray
    error: float
    stiff: bool


class RadauStepper(Stepper):
    """Step and stages of one run; see :class:`~pinconsist.dae.stepper.Stepper` for its methods.

    Attributes
    ----------
    t, p, v, a, lam : float, ndarray
        The state reached.
    h : float
        The next step, signed.
    s : int
        Stages of the next step.
    shape : (Stages, ndarray) or None
        The last step: the polynomial of its accelerations, given by coefficients, starts Newton's iteration. If None,
        a linear one does, with the slope from which the first step was chosen.
    """

    def __init__(self, system, method):
        super().__init__(system, method)
        self.newton, self.s = StageNewton(), method.stages or tuning.FIRST_STAGES

    def change_system(self, system) -> None:
        super().change_system(system)
        self._turns = None

    rows_watched = 1  # steps are long
    k = property(lambda self: 2 * self.s - 1)
    y = property(lambda self: np.concatenate((np.zeros(self.system.nx), self.v, self.lam)))

    def begin(self, t, p, v, t_end, known=None):
        """Start or restart at a state, which is projected onto the constraints; no history is needed."""
        system, method = self.system, self.method
        self.t = self.t_old = t
        self.p, self.v = self.index1.projected(t, p, v) if known is None else (p, v)
        self.a, self.lam = known or self.index1.acceleration(t, self.p, self.v)
        self._hand_state()
        self.control.restart()
        self.headway.restart(t, t)
        if self._turns is None:
            self._turns = turning_coordinates(system, p)
        self.shape, self.stages, self.stage_a, self.slope = None, None, self.a, np.zeros(system.nv)
        self._taken = 0
        if method.step is not None:
            self._divide(t_end)
        else:
            careful, before = self._first_step(t_end), abs(self.h) if self._begun else 0.0
            self.h = copysign(min(max(abs(careful), before), tuning.RESTARTED * abs(careful)), careful)
        self.used, self._begun = (self.h, 0), True
        return [(t, self.p, self.v, self.lam)]

    def _hand_state(self):
        """Pass the state to the object that makes the steps, if that is not this one."""

    def _divide(self, t_end):
        """The size of fixed steps from here to an end."""
        self._steps = max(1, int(np.ceil(abs(t_end - self.t) / self.method.step - 1e-9)))
        self._start, self.h, self._taken = self.t, (t_end - self.t) / self._steps, 0

    def resume(self, t_end):
        self.jump()
        if self.method.step is not None:
            self._divide(t_end)
        return [(self.t, self.p, self.v, self.lam)]

    def jump(self) -> None:
        """Forces have jumped: the accelerations that start Newton's iteration change by the same amount."""
        before = self.a
        self.a, self.lam = self.index1.acceleration(self.t, self.p, self.v)
        self.stage_a = self.stage_a + (self.a - before)
        if self.shape is not None:
            self.shape[1][0] += self.a - before

    def _first_step(self, t_end):
        """A first step with error FIRST_ERROR, from the time in which the acceleration changes by its own size."""
        system, control, limit = self.system, self.control, abs(t_end - self.t)
        if self.method.first_step is not None:
            return np.copysign(min(self.method.first_step, limit, control.max_step), t_end - self.t)
        weight = self._weights()[0][system.nx :]

        def size(x):
            return float(np.sqrt(np.mean((weight * x) ** 2)))

        near = tuning.FIRST_REACH * (1.0 + largest(self.p))
        trial = min(limit, near / max(largest(self.v), TINY), np.sqrt(near / max(largest(self.a), TINY)))
        for _ in range(tuning.FIRST_TRIALS):
            h = np.copysign(trial, t_end - self.t)
            v = self.v + h * self.a
            p = system.integrate(self.p, h * system.rate(self.t, self.p, 0.5 * (self.v + v)))
            try:
                a = self.index1.acceleration(self.t + h, p, v)[0]
                change, largest_a, self.slope = size(a - self.a), max(size(self.a), size(a)), (a - self.a) / h
            except PinconsistError:
                change, largest_a, self.slope = np.inf, 1.0, np.zeros(system.nv)
            if change <= tuning.FIRST_CHANGE * largest_a:
                break
            trial *= 0.25
        time = min(limit, trial * largest_a / max(change, TINY))
        h = time * min(1.0, (tuning.FIRST_ERROR / max(largest_a * time, TINY)) ** (1.0 / exponent(self.s)))
        return np.copysign(max(min(h, control.max_step), shortest_step(self.t, t_end)), t_end - self.t)

    def prepare_next(self) -> None:
        """Shorten the step if it would turn a joint beyond its chart."""
        if self.method.step is None and (speed := fastest_turn(self._turns, self.system.rate(self.t, self.p, self.v))):
            self.h = np.copysign(min(abs(self.h), tuning.MAX_CHART_TURN / speed), self.h)

    def advance(self, t_end) -> str:
        """Make one accepted step towards `t_end`; return the reason of a failure, or an empty string."""
        control = self.control
        control.reached(self.system, self._columns(), self.p)
        while True:
            wanted, t_next = self.h, self._next_time(t_end)
            if t_next == self.t:
                return tuning.FAILURES["error_test"]
            stages = self._solved(t_next)
            landing = None if stages.failure else self.landed(stages)
            if landing is not None:
                if landing.error <= 1.0:
                    break
                smaller = control.after_rejection(self.s, self.h, landing.error)
                self.shape = stages, stages.table.coefficients(stages.W, self.a, stages.W[-1])
            else:
                smaller = control.after_failure(self.h)
                if smaller is None:
                    return stages.failure
            if stages.failure or abs(smaller) <= tuning.MIN_FACTOR * abs(self.h):
                self._use(control.chosen_after_failure())
                self.shape, self.slope = None, 0.0 * self.slope  # the stages may be those of another closed position
            if self.headway.setback() or abs(smaller) < shortest_step(self.t):
                return stages.failure or tuning.FAILURES["error_test"]
            self.h = smaller
        self.used, self.stages = (stages.h, self.k), stages
        self.ends = self.a, landing.a
        self.shape = stages, stages.table.coefficients(stages.W, *self.ends)
        self.t_old, self.t = self.t, t_next
        self.p, self.v, self.a, self.lam = landing.p, landing.v, landing.a, landing.lam
        self.landing, self.stage_a = landing, stages.W[-1]
        self._taken += 1
        if self.method.step is None:
            cut, self.h = self.h != wanted, control.next_step(self.s, stages.h, landing.error)
            self._use(control.chosen_after_step(stages.rate, cut))
        self.headway.reached(self.t)
        return ""

    def _use(self, s):
        """Continue with `s` stages."""
        if s != self.s:
            self.s = s
            self.control.use(s)

    def _solved(self, t_next) -> Stages:
        """The stages of a step to `t_next`."""
        h = t_next - self.t
        times = self.t + h * table(self.s).c
        if self.shape is not None and abs(h) < tuning.FORESEEN * abs((last := self.shape[0]).h):
            W = polynomials((times - last.t) / last.h, last.table.s + 1) @ self.shape[1]
        else:
            W = self.a + np.outer(times - self.t, self.slope)
        stages = self._iterated(Stages(self.system, table(self.s), self.t, self.p, self.v, h, W))
        if not stages.failure and fastest_turn(self._turns, stages.xi) > tuning.MAX_CHART_TURN:
            stages.failure = tuning.FAILURES["turns_too_far"]
        return stages

    def _iterated(self, stages) -> Stages:
        weight, tol = self._weights()
        return self.newton.solve(stages, weight, self.control.newton_factor if self.method.step is None else tol)

    def _weights(self):
        return self.control.weights(self.system, self._columns(), self.p, np.inf)

    def _columns(self):
        """[ξ | v], relative to whose size errors are weighted."""
        return np.concatenate((self.p if self.system.vector_like else np.zeros(self.system.nx), self.v))

    def landed(self, stages) -> Landing | None:
        """The end of a step; one factorisation at the last stage serves the projections and the error estimate.

        None, with the `failure` of the stages set, if the constraints cannot be fulfilled there.
        """
        system, t, p, v = self.system, stages.times[-1], stages.P[-1], stages.V[-1]
        kkt, _, G, W = kkt_at(system, t, p, v)
        self.newton.nlu += 1
        p, v = projected(system, kkt, G, t, p, v)
        if p is None:
            stages.failure = tuning.FAILURES["not_converged"]
            return None
        weight, _ = self._weights()
        v, stiff = unstirred(stages, kkt, G, W, v, weight[system.nx :])
        a, lam = self.index1.acceleration(t, p, v)
        return Landing(p, v, a, lam, self._error(stages, kkt, G, W, p, v, weight), stiff)

    def _error(self, stages, kkt, G, W, p, v, weight):
        """The error of a step over its tolerance, from the highest modes of the accelerations along the constraints."""
        if self.method.step is not None:
            return 0.0
        system, table, h = self.system, stages.table, stages.h

        def size(values):
            free = values
            if system.nc < system.nv:  # if no velocity is free, the error between the steps counts
                free = values - kkt.solve(np.concatenate((np.zeros(system.nv), W @ values)))[: system.nv]
            moved = h * moved_by(system, stages.times[-1], p, v, free)
            return abs(h) * weighted_norm(np.concatenate((moved, free)), weight, system.nv)

        at_start = table.values([0.0])[0]
        if table.s < 3:  # the degree is raised by the acceleration at the start
            exact = table.s == 1 and system.nc == system.nv  # v only after the projection
            return size(((v - stages.v) / h if exact else at_start @ stages.W) - self.a)
        modes = table.modes @ stages.W
        highest, middle, before, *further = (size(mode) for mode in modes[:-5:-1])
        if further:  # a single mode may pass through zero, two rarely do so together
            upper, lower = hypot(highest, middle), hypot(before, *further)
        else:
            upper = highest = max(highest, middle**2 / max(middle, before, TINY))
            lower = before
        decay = upper / (lower + tuning.LAST_MODE * upper + TINY)  # over two degrees
        highest = max(highest, np.sqrt(min(decay, 1.0)) * middle)
        beside, earlier = size(at_start @ stages.W - self.a), size(self.stage_a - self.a)
        leading, starting = (np.linalg.norm(row @ table.inverse2) for row in (table.modes[-1], at_start))
        crossing = system.widths is not None and crosses(stages)

        def left(noise):
            """The error that is not rounding, if `noise` is the rounding of the highest mode."""
            last = np.sqrt(max(highest**2 - noise**2, 0.0))
            missed = np.sqrt(max(beside**2 - (noise * starting / leading) ** 2, 0.0))
            # Forces that change before the first stage, as friction does at rest, hardly appear in the modes. With
            # stiff forces, the stages of the last step miss the acceleration as well.
            turn = 0.5 * table.c[0] * (missed - earlier - last) * self.control.slack
            if crossing:
                turn = max(turn, last * self.control.slack)  # what the stages do not see need not decay further
            return float(max(last * decay, turn))

        noise = tuning.FELT * EPS * (1.0 + largest(p)) / abs(h) * largest(weight[system.nx :]) * leading
        error = left(noise)
        if error > tuning.STAGE_SAFETY ** exponent(table.s):  # the next step would be shorter
            error = left(max(noise, self._rounding_of_forces(stages, kkt, p, v, size)))
        if error <= 1.0 and system.sharp:
            return with_unseen(error, stages, kkt, G, W, self.control.slack * weight[system.nx :])
        return error

    def _rounding_of_forces(self, stages, kkt, p, v, size):
        """The rounding of the highest mode, in tolerances, where constraint rows are nearly dependent; else 0.

        Loops closed to rounding leave positions undetermined by far more there, and with them the forces.
        """
        system, t, reach = self.system, stages.times[-1], 1.0 + largest(p)
        nv, nc = system.nv, system.nc
        if not 0 < nc < nv:
            return 0.0
        signs = np.where(np.arange(nc) % 2, 1.0, -1.0)
        signs = np.copysign(1.0, kkt.solve(np.concatenate((np.zeros(nv), signs)))[nv:])  # of the weakest rows
        moved = kkt.solve(np.concatenate((np.zeros(nv), tuning.CLOSED * reach * signs)))[:nv]
        if largest(moved) < tuning.BESIDE * reach:
            return 0.0
        row = stages.table.modes[-1]
        turned = moved * (tuning.TURNED * reach / largest(moved))  # rounding is too small to be seen in the forces
        there = system.integrate(p, moved_by(system, t, p, v, turned))
        speed = np.linalg.norm(row @ stages.table.inverse) / np.linalg.norm(row) / stages.h
        try:
            a, turned_a = (solve_acceleration(system, t, *at)[0] for at in ((p, v), (there, v + speed * turned)))
        except PinconsistError:
            return 0.0
        return size((turned_a - a) * (largest(moved) / largest(turned))) * np.linalg.norm(row)

    def segment(self):
        """The interpolant of the last step; None if there is none."""
        if (of := self.stages) is None:
            return None
        end, step = self.landing, (of.t, self.t, of.h, of.table, of.p, of.v, of.W, of.U)
        return RadauSegment(*step, end.p, end.v, self.system, self.ends, end.stiff)

    def _looks(self, state, with_multipliers):
        segment, parts = self.segment(), np.arange(1, tuning.LOOKS) / tuning.LOOKS  # steps are long
        times = (self.t_old + (self.t - self.t_old) * parts).tolist()
        return [*((t, *segment.look(t, with_multipliers)) for t in times), state]

    def locate(self, signs, i):
        return located(self.segment(), signs, i, lambda step, t: self._made(step.ending_at(t), step.ends[0]) or step)

    def interpolant(self):
        step, fixed = self.segment(), self.method.step is not None
        return step if fixed else step.refined(self.control.slack * self._weights()[0][self.system.nx :], self._made)

    def _made(self, of, a):
        """A step from a state with the acceleration `a`, solved from the guess it has; None if it fails."""
        stages = self._iterated(Stages(of.system, of.table, of.t_old, of.p0, of.v0, of.h, of.W))
        end = None if stages.failure else self.landed(stages)
        return end and replace(of, W=stages.W, U=stages.U, p=end.p, v=end.v, ends=(a, end.a), stiff=end.stiff)

    def velocity_and_multipliers(self):
        return self.v, self.lam

    def _shorten(self, h):
        self.h = h
