"""The steppers: runs of BDF and of Radau IIA whose steps are made in C++."""

from abc import ABC, abstractmethod
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from ..engine import bdf, required
from ..engine.charts import longest_step, turning_coordinates
from ..engine.consistency import consistent_velocities
from ..engine.failure import FAILURES, culprits
from ..engine.index1 import Index1, NotFiniteError, singular_message
from ..engine.norms import largest
from ..engine.systems import blank_system, choice_of_rows, compiled_system, with_all_rows
from ..errors import PinconsistError, SingularSystemError
from ..mechanism.mode_system import ModeSystem
from .dense import Made, Tables
from .stage_curve import StageCurve


def stepper_for(system, method, compiled=None) -> "Stepper":
    """The stepper of a method; of a system in C++, if it is there already."""
    return (BdfStepper if method.stages is None else RadauStepper)(system, method, compiled)


class Advance(NamedTuple):
    """Why the engine has returned.

    ``reason`` is one of those of ``engine/run.hpp``; ``why`` says in words what has failed, or is empty; ``error`` is
    what a user's function raised after the steps that were made, or None.
    """

    reason: str
    why: str
    error: BaseException | None


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
        Steps that one call of :meth:`advance` makes at most.
    newton : namespace
        The numbers nfev, njev, nlu of evaluations, Newton matrices and factorisations.
    """

    batch = 1000
    rows_watched = 5  # steps after which the choice of constraint rows is checked
    _core: Any = None  # the run in C++
    _compiled: Any = None  # its equations

    def __init__(self, system, method, compiled=None):
        self.method = method
        self.control = method.control
        self.control.fit(system)
        self.newton = SimpleNamespace(nfev=0, njev=0, nlu=0)
        # modes of contacts → their compiled equations
        self._compiled_modes: dict = {} if compiled is None else {system: compiled}
        self.change_system(system)

    t = property(lambda self: self._core.t)
    h = property(lambda self: self._core.h)
    k = property(lambda self: self._core.k)
    p = property(lambda self: self._core.p)
    v = property(lambda self: self._core.velocity)
    lam = property(lambda self: self._core.multipliers)

    def change_system(self, system) -> None:
        """Continue with another system of the same sizes, from the next :meth:`place` on; counters are kept."""
        before = self._core
        self.system = system
        self._compiled = self._compiled_modes.get(system) or compiled_system(system)
        if isinstance(system, ModeSystem):  # to which a run returns
            self._compiled_modes[system] = self._compiled
        native = system.mechanism is not None
        self._keeps_curves = native and not self._compiled.calls_python
        self.index1: Index1 = Index1(system, self._compiled)
        self._all_rows = with_all_rows(system) if native and not system.dropped_are_zero else None
        self._core = self._new_core()
        self._core.first = self.method.first_step or 0.0
        self._core.step = self.method.step or 0.0
        self._core.moving = system.moving
        self._core.waits = self.method.consistency == "initial"
        if self._all_rows is not None:
            self._core.watch_rows(choice_of_rows(system, self._all_rows), self.rows_watched)
        self._turns = None
        if before is not None:
            self._core.take_over(before)
        if self.method.step is None:
            sizes = np.zeros(system.nx + system.nv) if before is None else before.sizes
            rtol, atol = self.control.wanted
            self._control(rtol, atol, sizes)

    def ask_rows(self, times, exact) -> None:
        """Make rows at these times only; `exact`: steps end there."""
        self._core.ask_rows(times.tolist(), exact)

    def stand_for(self, system) -> None:
        """Let `system` be that of the run, whose compiled equations have been changed to have its numbers."""
        self.system = system
        self._compiled_modes = {system: self._compiled}
        self.index1 = Index1(system, self._compiled)

    def forget(self) -> None:
        """Forget the run: the next :meth:`begin` is that of a new one, of the same system."""
        self._core.read(self._compiled)
        self._core.work()  # its counters begin anew
        self.newton.nfev = self.newton.njev = self.newton.nlu = 0
        for reason in self.control.reasons:
            self.control.reasons[reason] = 0
        self._core.first = self.method.first_step or 0.0
        rtol, atol = self.control.wanted
        self._control(rtol, atol, np.zeros(self.system.nx + self.system.nv))

    @property
    def core(self):
        """The run in C++; None if it calls functions of the user's."""
        return None if self._compiled.calls_python else self._core

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
        self._compiled_modes = {}
        self.index1 = Index1(self.system)

    def full_multipliers(self, p, lam, v=None):
        """The multipliers as the user sees them, of one row or a stack of rows, which have the velocities `v`."""
        return self.system.full_multipliers(p, lam, self._all_rows and self._all_rows.complete, v)

    def opened(self, times, positions):
        """The first row at which a constraint that was left out is violated, see :meth:`Index3System.opened`."""
        return self.system.opened(times, positions, self._all_rows and self._all_rows.gaps)

    def events(self, events, interrupted, finish):
        """The events of the run, in C++; the caller must keep these arguments alive."""
        system = self.system
        places = system.kept.tolist() if system.mechanism is not None else list(range(system.nc))
        contacts = system.mechanism is not None and bool(system.mechanism.contacts)
        finish = None if system.dropped_are_zero and not contacts else finish
        return required().Events(events, interrupted, finish, places, system.n_multipliers)

    def restart_events(self, events, fired, moved, t, p, v, known, forward) -> int:
        """Take the signs after events; returns the index of one that accumulates, or -1."""
        return events.restart_after(self._compiled, fired, moved, t, p, v, *known, forward)

    def place(self, t, p, v, known=None) -> None:
        """Start, or start again after a discontinuity, in the next :meth:`advance`.

        `known` are acceleration and multipliers there, if (p, v) is on the constraints already.
        """
        if known is None:
            if self.method.consistency == "every-step":
                p, v = self.index1.projected(t, p, v)
            known = self.index1.acceleration(t, p, v)
        if self._turns is None:
            self._core.turns = self._turns = turning_coordinates(self.system, p)
        self._core.place(t, p, v, *known)

    def resume(self) -> None:
        """Continue in the next :meth:`advance` where the last one has ended, with other forces, or to another end."""
        self._core.resume_here()

    def advance(self, t_end, most=None, jumped=False, with_curve=False, events=None, sees=None, forces=None) -> Advance:
        """Make steps towards `t_end`, at most `most`, until there is a reason to return; :meth:`read` gives them.

        Parameters
        ----------
        t_end, most : float, int
        jumped : bool
            Forces have jumped since the last call.
        with_curve : bool
            Keep the polynomials of the steps.
        events : Events, optional
            They are looked for, and found in order of time; :attr:`hit` has those that change the run.
        sees : callable, optional
            ``sees(t, p, v, λ, order)`` is called with each step; a true value ends the call.
        forces : Index3System, optional
            Gives the times at which forces jump, and makes them jump.
        """
        most = self.batch if most is None else min(most, self.batch)
        reason, failure, error = self._core.advance(
            self._compiled, t_end, most, jumped, with_curve, events, sees, forces
        )
        why = self._counted(failure)
        return Advance(reason, why, error or self._error_of(reason, failure, why))

    def _error_of(self, reason, failure, why) -> PinconsistError | None:
        """The error for failures that are not those of a step."""
        if failure == "singular_between":
            return SingularSystemError(singular_message(self._core.singular_at))
        if failure == "constraint_jumps":
            system = self.system
            phi = system.constraint(self.t, self.p, system.rate(self.t, self.p, self.v))[0]
            row = system.describe_row(int(np.argmax(np.abs(phi))))
            return PinconsistError(
                f"the run cannot continue at t = {self.t:.6g}: {row} jumps there, by {largest(phi):.3g}"
            )
        if reason == "no_start":
            kind = NotFiniteError if failure == "not_finite" else PinconsistError
            return kind(f"the run cannot start at t = {self.t:.6g}: {why}")
        return None

    @property
    def hit(self) -> tuple | None:
        """Indices of the events at which the run has stopped, (t, p, v, λ) there, and whether they end it; or None."""
        return self._core.hit

    @property
    def steps_to_come(self) -> float:
        """The number of steps up to the end, by the pace of the last ones, where the engine found the run slow."""
        return self._core.to_come

    def read(self) -> Made:
        """What was made since the last call."""
        steps, rows, orders, curves = self._core.read(self._compiled)
        for array in rows:  # passed to users' functions
            array.flags.writeable = False
        return Made(steps, rows, orders, curves and self._curve(*curves), self._core.reached)

    def reach(self, t_end, jumped, events, forces):
        """Integrate to a time without returning the steps: (t, p, v) there; None if it is not reached, or at events."""
        reached = self._core.reach(self._compiled, t_end, self.batch, jumped, events, forces)
        if reached is not None:
            for state in reached[1:]:
                state.setflags(write=False)
        return reached

    @abstractmethod
    def _curve(self, starts, ends, polynomials):
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
        why = FAILURES.get(failure, "")
        return why + culprits(self.system, *self._core.culprit) if failure == "not_finite" else why


class BdfStepper(Stepper):
    """Backward differences of variable order."""

    _chart_points: Any = None  # see Tables in run/dense.py; it holds no function of the user's

    def _new_core(self):
        system = self.system
        if system.mechanism is not None and not system.vector_like:
            self._chart_points = blank_system(system.model, system.workspace).chart_points
        core = required().Stepper(self._compiled, self.method.consistency == "every-step", self.method.switches)
        core.fix_order(self.method.order)
        return core

    def _control(self, rtol, atol, sizes):
        control = self.control
        order, rounding = control.max_order, control.rounding
        self._core.control_error(rtol, atol, sizes, order, rounding, control.max_step, control.noise)

    def advance(self, *arguments, **named):
        made = super().advance(*arguments, **named)
        if made.reason == "started":
            states = self._core.history
            self._core.take_velocities(np.array(consistent_velocities(self.index1, states, self.h, self._trial())))
        return made

    def _trial(self):
        """(t, p, v) at the end of an uncorrected first step."""
        p, v, failure = self._core.trial()
        if failure:
            why = FAILURES[failure]
            raise SingularSystemError(f"the trial step from t = {self.t:.6g} with h = {self.h:.3g} failed: {why}")
        return self.t + self.h, p, v

    def _curve(self, starts, ends, polynomials):
        t, h, k, base, Z = polynomials
        base = base.reshape(len(t), -1)
        Z = Z.reshape(len(t), bdf.ROWS, -1)
        return Tables(starts[0], ends, t, h, k, base, Z, self.system, self._chart_points)

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
        if not self._keeps_curves:
            self._sampler.clear()

    def forget(self):
        self._core.renew()
        super().forget()

    def close(self):
        super().close()
        self._forget_functions()

    def steps_since(self, t):
        """The steps since a time, as StageSteps; None if a force has jumped since then, or if they are too many."""
        found = self._core.steps_since(t)
        return None if found is None else required().StageSteps(*found)

    def _curve(self, starts, ends, polynomials):
        return StageCurve(polynomials, starts[0], ends, self.system, self._sampler)
