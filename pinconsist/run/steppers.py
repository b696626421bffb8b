"""The steppers: runs of BDF and of Radau IIA whose steps are made in C++; events and records stay in Python."""

from abc import ABC, abstractmethod
from types import SimpleNamespace
from typing import Any

import numpy as np

from ..engine import bdf, constant, required
from ..engine.charts import longest_step, turning_coordinates
from ..engine.consistency import consistent_velocities
from ..engine.failure import FAILURES, culprits
from ..engine.index1 import Index1, NotFiniteError, singular_message
from ..engine.systems import blank_system, compiled_system, with_all_rows
from ..errors import PinconsistError, SingularSystemError
from ..mechanism.mode_system import ModeSystem
from .dense import StepBatch, Tables
from .stage_curve import StageCurve


def stepper_for(system, method, compiled=None) -> "Stepper":
    """The stepper of a method; of a system in C++, if it is there already."""
    return (BdfStepper if method.stages is None else RadauStepper)(system, method, compiled)


class Stepper(ABC):
    """The state of one run of a system by a method, and how it advances.

    Until it is closed, it holds references to the user's functions that the garbage collector does not see.

    Attributes
    ----------
    t, h, k : float, float, int
        Time reached, next step (signed), order.
    p, v, lam : ndarray
        The state at `t`.
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
        States of a start at which events have not been evaluated yet.
    newton : namespace
        The numbers nfev, njev, nlu of evaluations, Newton matrices and factorisations.
    """

    batch, rows_watched = 1000, 5
    _core: Any = None  # the run in C++
    _compiled: Any = None  # its equations

    def __init__(self, system, method, compiled=None):
        self.method = method
        self.control = method.control
        self.control.fit(system)
        self.newton = SimpleNamespace(nfev=0, njev=0, nlu=0)
        self.unseen: list[tuple] = []
        self._twins: dict = {} if compiled is None else {system: compiled}  # modes of contacts → compiled equations
        self.change_system(system)

    t = property(lambda self: self._core.t)
    h = property(lambda self: self._core.h)
    k = property(lambda self: self._core.k)
    p = property(lambda self: self._core.p)
    v = property(lambda self: self._core.velocity)
    lam = property(lambda self: self._core.multipliers)

    def change_system(self, system) -> None:
        """Continue with another system of the same sizes, from the next :meth:`begin` on; counters are kept."""
        before = self._core
        self.system = system
        self._compiled = self._twins.get(system) or compiled_system(system)
        if isinstance(system, ModeSystem):  # to which a run returns
            self._twins[system] = self._compiled
        native = system.mechanism is not None
        self.ahead = native and not self._compiled.calls_python
        self.index1: Index1 = Index1(system, self._compiled)
        self._all_rows = with_all_rows(system) if native and not system.dropped_are_zero else None
        self._core = self._new_core()
        self._core.first = self.method.first_step or 0.0
        self._core.step = self.method.step or 0.0
        self._turns = None
        if before is not None:
            self._core.stand(before.t, before.h, before.p, before.velocity)
        if self.method.step is None:
            sizes = np.zeros(system.nx + system.nv) if before is None else before.sizes
            rtol, atol = self.control.wanted
            self._control(rtol, atol, sizes)

    def stand_for(self, system) -> None:
        """Let `system` be that of the run, whose compiled equations have been changed to have its numbers."""
        self.system = system
        self._twins = {system: self._compiled}
        self.index1 = Index1(system, self._compiled)

    def forget(self) -> None:
        """Forget the run: the next :meth:`begin` is that of a new one, of the same system."""
        self._core.unread(self._compiled)
        self._core.work()  # its counters begin anew
        self.newton.nfev = self.newton.njev = self.newton.nlu = 0
        for reason in self.control.reasons:
            self.control.reasons[reason] = 0
        self._core.first = self.method.first_step or 0.0
        rtol, atol = self.control.wanted
        self._control(rtol, atol, np.zeros(self.system.nx + self.system.nv))

    def off(self, t, p, v) -> float:
        """How far a state is from the constraints, m, rad and their rates."""
        _, phi, _, rho = self._compiled.evaluate(t, p, v, v)
        return float(max(np.abs(phi).max(initial=0.0), np.abs(rho).max(initial=0.0)))

    @abstractmethod
    def _new_core(self):
        """The run in C++."""

    @abstractmethod
    def _control(self, rtol, atol, sizes) -> None:
        """Pass the tolerances of a run with variable steps, and the largest sizes of [ξ | v] so far."""

    def close(self) -> None:
        """Release what only a run needs."""
        self._compiled = self._core = self._all_rows = None
        self._twins = {}
        self.index1 = Index1(self.system)

    @abstractmethod
    def passes_changes(self, with_curve: bool) -> bool:
        """Whether :meth:`steps` accepts ``forces``, and continues on its own at the times at which they jump."""

    def full_multipliers(self, p, lam, v=None):
        """The multipliers as the user sees them, of one row or a stack of rows, which have the velocities `v`."""
        return self.system.full_multipliers(p, lam, self._all_rows and self._all_rows.complete, v)

    def opened(self, times, positions):
        """The first row at which a constraint that was left out is violated, see :meth:`Index3System.opened`."""
        return self.system.opened(times, positions, self._all_rows and self._all_rows.gaps)

    def signs(self, *about):
        """The signs of events; the caller must keep their arguments alive."""
        system, (events, multipliers, interrupted, finish, *contacts) = self.system, about
        places = getattr(system, "kept", np.arange(system.nc)).tolist()
        finish = None if system.dropped_are_zero and not contacts else finish
        given = events, multipliers, interrupted, finish, places, system.n_multipliers
        return required().Signs(*given, contacts[0] if contacts else None)

    @abstractmethod
    def begin(self, t, p, v, t_end, known=None) -> list:
        """Start, or start again after a discontinuity.

        `known` are acceleration and multipliers there, if (p, v) is on the constraints already.

        Returns
        -------
        list of (t, p, v, λ)
            The states from `t` on; the last one is the current state of the run.
        """

    def _charts(self, p):
        if self._turns is None:
            self._core.turns = self._turns = turning_coordinates(self.system, p)

    @abstractmethod
    def resume(self, t_end) -> list:
        """Continue after a jump of forces at the time reached; returns what :meth:`begin` does."""

    def watched(self, signs) -> bool:
        """Evaluate the signs in the unseen part of the last step until one has changed; returns whether one has."""
        if self._core.watched(signs):
            raise SingularSystemError(singular_message(signs.end))
        return signs.changed

    def locate(self, signs, i):
        """The time of an event between the last two evaluations, and (p, v, λ) there."""
        found = self._core.locate(signs, i)
        if found is None:
            raise SingularSystemError(singular_message(signs.end))
        return found

    def sooner(self, signs, i, limit):
        """The same of an event that a shorter step, up to the time `limit`, shows to be earlier; None if it is not."""
        return self._core.locate(signs, i, limit)

    def steps(self, t_end, most, with_curve, signs=None, sees=None, forces=None) -> StepBatch:
        """Accepted steps towards `t_end`, at most `most`, with their polynomials where requested.

        They end where `signs`, if not None, have changed. ``sees(t, p, v, λ, order)``, if not None, is called with each
        step before the next is made; a true value ends the batch. `forces`, if not None, gives the times before `t_end`
        at which forces jump.
        """
        t_old = self.t
        return self._batch(self.made(t_end, most, with_curve, signs, sees, forces), t_old, with_curve)

    def made(self, t_end, most, with_curve, signs, sees, forces) -> tuple:
        """The same, as C++ returns them: the time in here is that without Python."""
        return self._core.run(self._compiled, t_end, most, with_curve, signs, sees, forces)

    def reach(self, t_end, jumped, forces):
        """Integrate to a time without returning the steps: (t, p, v) there, or None; see :meth:`unread`."""
        reached = self._core.reach(self._compiled, t_end, self.batch, jumped, forces)
        if reached is not None:
            for state in reached[1:]:
                state.setflags(write=False)
        return reached

    def unread(self) -> StepBatch:
        """The steps of :meth:`reach` since the last call of this method; the run is at their end."""
        return self._batch(self._core.unread(self._compiled), self.t, False)

    def _batch(self, made, t_old, with_curve) -> StepBatch:
        """The batch of the steps made last, which begin at `t_old`; the run is at its end."""
        failure, error, t, p, v, lam, h, k, polynomials, jumps = made
        why = self._counted(failure)
        curve = self._curve(t_old, t, h, k, polynomials) if with_curve and len(t) else None
        return StepBatch(t, p, v, lam, k, curve, why, error, jumps)

    @abstractmethod
    def _curve(self, t_old, t, h, k, polynomials):
        """The polynomials of steps."""

    def _counted(self, failure) -> str:
        """Add the work done to the counters; returns why there are no more steps, or an empty string."""
        newton, reasons = self.newton, self.control.reasons
        nfev, njev, nlu, *rejected = self._core.work()
        newton.nfev += nfev
        newton.njev += njev
        newton.nlu += nlu
        for reason, count in zip(reasons, rejected, strict=False):  # a fixed step rejects nothing
            reasons[reason] += count
        why = FAILURES[failure] if failure else ""
        return why + culprits(self.system, *self._core.culprit) if failure == "not_finite" else why


class BdfStepper(Stepper):
    """Backward differences of variable order."""

    _chart_points: Any = None  # see Tables in run/dense.py; it holds no function of the user's

    def _new_core(self):
        system = self.system
        if system.mechanism is not None and not system.vector_like:
            self._chart_points = blank_system(system.model, system.data).chart_points
        core = required().Stepper(self._compiled, self.method.consistency == "every-step", self.method.switches)
        core.fix_order(self.method.order)
        return core

    def _control(self, rtol, atol, sizes):
        control = self.control
        order, rounding = control.max_order, control.rounding
        self._core.control_error(rtol, atol, sizes, order, rounding, control.max_step, control.noise)

    def passes_changes(self, with_curve):
        method = self.method
        return not with_curve and method.step is None and method.first_step is None and not self.system.moving

    def begin(self, t, p, v, t_end, known=None):
        self._charts(p)
        if known is None and self.method.consistency == "every-step":
            p, v = self.index1.projected(t, p, v)
        a, lam = known or self.index1.acceleration(t, p, v)
        failure, states = self._core.begin(self._compiled, t, p, v, a, lam, t_end)
        if failure:
            why = self._counted(failure)
            kind = NotFiniteError if failure == "not_finite" else PinconsistError
            raise kind(f"the run cannot start at t = {t:.6g}: {why}")
        if too_fast := self._turns_too_far():
            raise PinconsistError(f"the run cannot start at t = {t:.6g}: {too_fast}")
        if self.method.consistency == "initial":
            self._core.take_velocities(np.array(consistent_velocities(self.index1, states, self.h, self._trial())))
        return states

    def _trial(self):
        """(t, p, v) at the end of an uncorrected first step."""
        p, v, failure = self._core.trial()
        if failure:
            why = FAILURES[failure]
            raise SingularSystemError(f"the trial step from t = {self.t:.6g} with h = {self.h:.3g} failed: {why}")
        return self.t + self.h, p, v

    def resume(self, t_end):
        return self.begin(self.t, self.p, self.v, t_end)

    def watched(self, signs):
        """The same, at the states of a start first."""
        while self.unseen:
            if 0.0 in signs.values:
                beside = signs.end + constant("NUDGE") * (self.unseen[0][0] - signs.end)
                if signs.look(beside, *self._core.inside(beside)):
                    return True
            if signs.look(*self.unseen.pop(0)):
                return True
        return super().watched(signs)

    def curve_of_start(self) -> Tables:
        """The polynomial of the starting history."""
        core = self._core
        end = np.array([core.t])
        return Tables(
            t_old=np.array([core.t_old]), ends=end, t=end, h=np.array([core.used_h]), k=np.array([core.points - 1]),
            base=core.base[None], Z=core.Z[None], system=self.system,
            chart_points=self._chart_points,
        )  # fmt: skip

    def _curve(self, t_old, t, h, k, polynomials):
        base, Z = polynomials
        starts = np.append(t_old, t[:-1])
        base = base.reshape(len(t), -1)
        Z = Z.reshape(len(t), bdf.ROWS, -1)
        return Tables(starts, t, t, h, k, base, Z, self.system, self._chart_points)

    def _counted(self, failure):
        why = super()._counted(failure)
        return (failure == "turns_too_far" and self._turns_too_far()) or why

    def _turns_too_far(self) -> str:
        """Why a fixed step is too long for the charts, or an empty string."""
        if self.method.step is None or self.system.vector_like:
            return ""
        longest = longest_step(self._turns, self.system.rate(self.t, self.p, self.v), self.k)
        if abs(self.h) <= longest:
            return ""
        return (
            f"a joint turns so fast that it makes half a turn in the {self.k + 2} steps that order {self.k} uses, "
            f"which is the limit of a rotation chart; use step <= {longest:.3g} s"
        )


class RadauStepper(Stepper):
    """Radau IIA with a variable number of stages."""

    rows_watched = 1  # steps are long

    def _new_core(self):
        core = required().RadauStepper(self._compiled, self.method.switches)
        if self.method.step is not None:
            core.fix_stages(self.method.stages)
        self._sampler = [required().Sampler(self._compiled)]
        self._forget_functions()
        return core

    def _control(self, rtol, atol, sizes):
        self._core.control_error(rtol, atol, sizes, self.method.stages, self.control.max_step)

    def _forget_functions(self):
        """Curves outlive the run if they hold no user-defined function."""
        if not self.ahead:
            self._sampler.clear()

    def close(self):
        super().close()
        self._forget_functions()

    def passes_changes(self, with_curve):
        return not self.system.moving  # the velocities may jump with a constraint

    def begin(self, t, p, v, t_end, known=None):
        """Start or restart at a state, which is projected onto the constraints; no history is needed."""
        if known is None:
            p, v = self.index1.projected(t, p, v)
            known = self.index1.acceleration(t, p, v)
        self._charts(p)
        self._core.begin(self._compiled, t, p, v, *known, t_end)
        return [(t, p, v, known[1])]

    def resume(self, t_end):
        if not self._core.jump():
            self.index1.acceleration(self.t, self.p, self.v)  # says why
        if self.method.step is not None:
            self._core.divide(t_end)
        return [(self.t, self.p, self.v, self.lam)]

    def _curve(self, t_old, t, h, k, polynomials):
        return StageCurve(polynomials, t_old, t, self.system, self._sampler)
