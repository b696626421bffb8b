"""What the compiled steppers have in common: compiled equations, in a run and of index 1."""

from typing import Any

import numpy as np

from ..dae.dense import StepBatch
from ..dae.index1 import (
    Index1,
    NotFiniteError,
    chart_state,
    integration_failed_message,
    not_closed_message,
    not_finite_message,
)
from ..dae.kkt import singular_message
from ..dae.newton import culprits
from ..dae.stepper import Stepper
from ..dae.tuning import FAILURES
from ..errors import AssemblyError, PinconsistError, SingularSystemError
from . import load
from .tree import workspace


def compiled_system(system):
    """The compiled equations of a system: those of a mechanism, or callbacks into any other."""
    module = load()[0]
    if not hasattr(system, "hand_over"):
        return module.CallbackSystem(system)
    compiled = blank_system(system.model, system.data)
    system.hand_over(compiled)
    return compiled


def with_all_rows(system):
    """A compiled system of a mechanism with all rows of its loops, dependent ones included, without forces."""
    compiled = blank_system(system.model, system.data)
    system.all_rows().hand_over(compiled)
    return compiled


def blank_system(model, data=None):
    """A compiled system of a model without rows and forces; None without the compiled part.

    Systems with the same `data` of Pinocchio share a workspace; without, it has one of its own.
    """
    module = load()[0]
    return None if module is None else module.MechanismSystem(workspace(module, model, data))


class CompiledRun(Stepper):
    """A stepper in C++: its compiled equations, and the counting of its work.

    Until it is closed, it holds references to the user's functions that the garbage collector does not see.
    """

    batch, backend = 1000, "compiled"
    _compiled: Any = None
    _core: Any = None  # the C++ stepper
    _chart_points: Any = None  # see Tables in dae/dense.py; it holds no function of the user's

    def change_system(self, system) -> None:
        super().change_system(system)
        self._compiled = compiled_system(system)
        native = not isinstance(self._compiled, load()[0].CallbackSystem)
        self._chart_points, self.ahead = None, native and not self._compiled.calls_python
        if native:
            self.index1 = CompiledIndex1(system, self._compiled)
            if not system.vector_like:
                self._chart_points = blank_system(system.model, system.data).chart_points
        self._all_rows = with_all_rows(system) if native and not system.dropped_are_zero else None

    def close(self) -> None:
        self._compiled = self._core = self._all_rows = None
        self.index1 = Index1(self.system)

    def full_multipliers(self, p, lam):
        return self.system.full_multipliers(p, lam, self._all_rows and self._all_rows.complete)

    def opened(self, times, positions):
        return self.system.opened(times, positions, self._all_rows and self._all_rows.gaps)

    def signs(self, *about):
        """Compiled signs; the caller must keep their arguments alive."""
        system, (*about, finish) = self.system, about
        places = getattr(system, "kept", np.arange(system.nc)).tolist()
        return load()[0].Signs(*about, None if system.dropped_are_zero else finish, places, system.n_multipliers)

    def steps(self, t_end, most, with_curve, signs=None, sees=None, forces=None) -> StepBatch:
        return self.batch_of(self.made(t_end, most, with_curve, signs, sees, forces), with_curve)

    def made(self, t_end, most, with_curve, signs=None, sees=None, forces=None):
        """Steps as the compiled method returns them: its failure, an exception, t, p, v, λ, …"""
        return self._core.run(self._compiled, t_end, most, with_curve, signs, sees, forces)

    def watched(self, signs):
        if super().watched(signs):
            return True
        if self._core.watched(signs):
            raise SingularSystemError(singular_message(signs.end))
        return signs.changed

    def reach(self, t_end, jumped, forces):
        """Integrate to a time without returning the steps: (t, p, v) there, or None; see :meth:`unread`."""
        reached = self._core.reach(self._compiled, t_end, self.batch, jumped, forces)
        if reached is not None:
            for state in reached[1:]:
                state.setflags(write=False)
        return reached

    def unread(self) -> StepBatch:
        """The steps of :meth:`reach` since the last call of this method; the run is at their end."""
        return self.batch_of(self._core.unread(self._compiled), False)

    def batch_of(self, made, with_curve) -> StepBatch:
        """The batch of the steps made last; the run is at its end."""
        raise NotImplementedError

    def _counted(self, failure) -> str:
        """Add the compiled method's work to the counters; returns why there are no more steps, or an empty string."""
        newton, reasons = self.newton, self.control.reasons
        nfev, njev, nlu, *rejected = self._core.work()
        newton.nfev += nfev
        newton.njev += njev
        newton.nlu += nlu
        for reason, count in zip(reasons, rejected, strict=False):  # a fixed step rejects nothing
            reasons[reason] += count
        why = FAILURES[failure] if failure else ""
        return why + culprits(self.system, *self._core.culprit) if failure == "not_finite" else why


class CompiledIndex1(Index1):
    """The methods of :class:`~pinconsist.dae.index1.Index1`, in C++."""

    def __init__(self, system, compiled):
        super().__init__(system)
        self.compiled = compiled
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

    def projected(self, t, p, v):
        """(p, v) put on the constraints."""
        p, v, failure, gap = self._projection.project(t, p, v)
        if failure:
            singular = failure == "singular"
            raise SingularSystemError(singular_message(t)) if singular else AssemblyError(not_closed_message(gap))
        return p, v

    def one_step(self, base, t0, p0, v0, t_end, rtol, atol, max_step=np.inf, dense=False):
        """A run of DOP853."""
        y0 = chart_state(self.system, base, p0, v0)
        return CompiledOneStep(self.system, self._projection.one_step(base, t0, y0, t_end, rtol, atol, max_step, dense))


class CompiledOneStep:
    """The methods of :class:`~pinconsist.dae.index1.OneStep`, in C++."""

    def __init__(self, system, run):
        self._system, self._run = system, run

    def __getattr__(self, name):
        return getattr(self._run, name)

    def step(self) -> None:
        """One step, as in :class:`~pinconsist.dae.index1.OneStep`."""
        run = self._run
        reason = run.step()
        if reason == "singular":
            raise SingularSystemError(singular_message(run.culprit[0]))
        if reason:
            cause = NotFiniteError(not_finite_message(self._system, *run.culprit)) if run.culprit else None
            raise PinconsistError(integration_failed_message(run.t, cause or reason)) from cause
