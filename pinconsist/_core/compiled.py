"""The stepper whose accepted steps are made in C++; events and records stay in Python."""

from __future__ import annotations

import logging
from functools import cache

import numpy as np

from ..dae.control import ErrorControl
from ..dae.dense import Segment
from ..dae.index1 import (
    Index1,
    NotFiniteError,
    chart_state,
    integration_failed_message,
    not_closed_message,
    not_finite_message,
)
from ..dae.integrate import python_stepper
from ..dae.kkt import singular_message
from ..dae.newton import culprits
from ..dae.stepper import StepBatch, Stepper
from ..dae.tuning import FAILURES
from ..errors import AssemblyError, InputError, PinconsistError, SingularSystemError
from . import load

log = logging.getLogger(__name__)

BACKENDS = ("auto", "compiled", "python")


def stepper_for(system, method, backend: str = "auto") -> Stepper:
    """The stepper of a backend: compiled where it can be had, else in Python.

    Raises
    ------
    InputError
        ``backend="compiled"`` where the compiled part is not there.
    """
    if backend == "python":
        return python_stepper(system, method)
    module, why = load()
    if module is not None:
        from .compiled_radau import CompiledRadauStepper

        return (CompiledStepper if method.stages is None else CompiledRadauStepper)(system, method)
    if backend == "compiled":
        raise InputError(f"backend='compiled' is not available: {why}. backend='auto' uses Python instead")
    _warn_once(why)
    stepper = python_stepper(system, method)
    stepper.backend = f"python ({why})"
    return stepper


@cache
def _warn_once(why) -> None:
    log.warning("%s; the Python method is used, which gives the same results about ten times slower", why)


def compiled_system(system):
    """The compiled equations of a system: those of a mechanism, or callbacks into any other."""
    module = load()[0]
    if not hasattr(system, "hand_over"):
        return module.CallbackSystem(system)
    compiled = module.MechanismSystem(system.model, system.data)
    system.hand_over(compiled)
    return compiled


class CompiledSystem:
    """What the compiled steppers have in common: their compiled equations, and the counting of their work.

    They hold the user's functions where the garbage collector does not see them, until they are closed.
    """

    batch, backend = 1000, "compiled"

    def change_system(self, system) -> None:
        super().change_system(system)
        self._compiled = compiled_system(system)
        native = not isinstance(self._compiled, load()[0].CallbackSystem)
        if native:
            self.index1 = CompiledIndex1(system, self._compiled)
        self._all_rows = None
        if native and not system.dropped_are_zero:
            self._all_rows = load()[0].MechanismSystem(system.model, system.data)
            system.hand_over_all_rows(self._all_rows)

    def close(self) -> None:
        self._compiled = self._core = self._all_rows = None
        self.index1 = Index1(self.system)

    def full_multipliers(self, p, lam):
        return self.system.full_multipliers(p, lam, self._all_rows and self._all_rows.complete)

    def opened(self, times, positions):
        return self.system.opened(times, positions, self._all_rows and self._all_rows.gaps)

    def _count(self) -> None:
        """Add the compiled method's work to the counters."""
        newton, reasons = self.newton, self.control.reasons
        nfev, njev, nlu, *rejected = self._core.work()
        newton.nfev += nfev
        newton.njev += njev
        newton.nlu += nlu
        for reason, count in zip(reasons, rejected, strict=False):  # a fixed step rejects nothing
            reasons[reason] += count


class CompiledStepper(CompiledSystem, Stepper):
    """A :class:`~pinconsist.dae.stepper.Stepper` that makes many steps in one call."""

    def change_system(self, system) -> None:
        super().change_system(system)
        method, control = self.method, self.control
        self._core = load()[0].Stepper(self._compiled, method.consistency == "every-step", method.switches)
        if isinstance(control, ErrorControl):
            self._core.control_error(*control.spread, control.max_order, control.max_step)

    def begin(self, t, p, v, t_end):
        states = super().begin(t, p, v, t_end)
        self._core.turns = np.zeros((0, self.system.nx)) if self._turns is None else self._turns
        self._core.begin(t, self.t, self.h, self.k, self.p, self.y, self.base, self.Z)
        if self.method.step is not None:
            self._core.fix_step(self._start, self._taken, self._steps)
        return states

    def steps(self, t_end, most, with_segments) -> StepBatch:
        core, system, t_old = self._core, self.system, self.t
        failure, error, t, p, v, lam, h, k, base, Z = core.run(self._compiled, t_end, most, with_segments)
        self.t, self.h, self.k, self.p, self.y = core.t, core.h, core.k, core.p, core.y
        self._count()
        why = FAILURES.get(failure, "")
        if failure == "not_finite":
            why += culprits(system, *core.culprit)
        elif failure == "turns_too_far":
            why = self._turns_too_far(self.velocity_and_multipliers()[0])
        if not with_segments:
            return StepBatch(why, error, block=(t, p, v, lam, k))
        pieces = []
        for i in range(len(t)):
            segment = Segment(t_old, t[i], t[i], h[i], int(k[i]), base[i], Z[i, : k[i] + 1], system)
            pieces.append(([(t[i], p[i], v[i], lam[i])], segment, int(k[i])))
            t_old = t[i]
        return StepBatch(why, error, pieces)


class CompiledIndex1(Index1):
    """The answers of :class:`~pinconsist.dae.index1.Index1`, in C++."""

    def __init__(self, system, compiled):
        super().__init__(system)
        self._projection = load()[0].Projection(compiled)

    def acceleration(self, t, p, v):
        """Acceleration and multipliers of the differential equation."""
        solution = self._projection.acceleration(t, p, v)
        if solution is None:
            raise SingularSystemError(singular_message(t))
        a, lam, finite = solution
        if not finite:
            raise NotFiniteError(not_finite_message(self.system, t, p, v))
        return a, lam

    def state(self, t, p, v):
        """(t, p, v, λ) with p and v put on the constraints."""
        p, v, failure, gap = self._projection.project(t, p, v)
        if failure:
            raise (
                SingularSystemError(singular_message(t))
                if failure == "singular"
                else AssemblyError(not_closed_message(gap))
            )
        return t, p, v, self.acceleration(t, p, v)[1]

    def one_step(self, base, t0, p0, v0, t_end, rtol, atol, max_step=np.inf, dense=False):
        """A run of DOP853."""
        y0 = chart_state(self.system, base, p0, v0)
        return CompiledOneStep(self.system, self._projection.one_step(base, t0, y0, t_end, rtol, atol, max_step, dense))


class CompiledOneStep:
    """The answers of :class:`~pinconsist.dae.index1.OneStep`, in C++."""

    def __init__(self, system, run):
        self._system, self._run, self.sample = system, run, run.sample

    t = property(lambda self: self._run.t)
    y = property(lambda self: self._run.y)
    step_size = property(lambda self: self._run.step_size)
    finished = property(lambda self: self._run.finished)
    evaluations = property(lambda self: self._run.evaluations)

    def step(self) -> None:
        """One step, as of :class:`~pinconsist.dae.index1.OneStep`."""
        run = self._run
        reason = run.step()
        if reason == "singular":
            raise SingularSystemError(singular_message(run.culprit[0]))
        if reason:
            cause = NotFiniteError(not_finite_message(self._system, *run.culprit)) if run.culprit else None
            raise PinconsistError(integration_failed_message(run.t, cause or reason)) from cause
