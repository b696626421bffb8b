"""The stepper whose accepted steps are made in C++; events and records stay in Python."""

import logging
from functools import cache

import numpy as np

from ..dae import bdf
from ..dae.control import ErrorControl
from ..dae.dense import StepBatch, Tables
from ..dae.integrate import python_stepper
from ..dae.stepper import Stepper
from ..errors import InputError, PinconsistError
from . import load
from .compiled_radau import CompiledRadauStepper
from .compiled_system import CompiledIndex1, CompiledRun

log = logging.getLogger(__name__)

BACKENDS = ("auto", "compiled", "python")


def stepper_for(system, method, backend: str = "auto") -> Stepper:
    """The stepper of a backend: compiled if available, else in Python.

    Raises
    ------
    InputError
        ``backend="compiled"`` if the compiled part is not available.
    """
    if backend == "python":
        return python_stepper(system, method)
    module, why = load()
    if module is not None:
        return (CompiledStepper if method.stages is None else CompiledRadauStepper)(system, method)
    if backend == "compiled":
        raise InputError(f"backend='compiled' is not available: {why}. backend='auto' uses Python instead")
    _warn_once(why)
    stepper = python_stepper(system, method)
    stepper.backend = f"python ({why})"
    return stepper


@cache
def _warn_once(why) -> None:
    """Say why runs are slow: in the log or, if nobody listens to it, on stderr; warnings are often filtered."""
    text = f"the Python method is used, which is about fifty times slower, because {why}"
    if _heard():
        log.warning("%s", text)
    elif logging.lastResort is not None:  # the handler on stderr of logs without one, which the null handler replaces
        message = f"pinconsist: warning: {text}"
        logging.lastResort.handle(log.makeRecord(log.name, logging.WARNING, __file__, 0, message, (), None))


def _heard() -> bool:
    """Whether a handler of the application receives the warnings of this log."""
    of = log if log.isEnabledFor(logging.WARNING) else None
    while of is not None:
        if any(each.level <= logging.WARNING and not isinstance(each, logging.NullHandler) for each in of.handlers):
            return True
        of = of.parent if of.propagate else None
    return False


class CompiledStepper(CompiledRun):
    """A :class:`~pinconsist.dae.stepper.Stepper` that makes many steps in one call."""

    def change_system(self, system) -> None:
        super().change_system(system)
        method, control, before = self.method, self.control, self._core
        self._core = load()[0].Stepper(self._compiled, method.consistency == "every-step", method.switches)
        if isinstance(control, ErrorControl):
            sizes = control.sizes if before is None else before.sizes
            self._core.control_error(*control.spread, sizes, control.max_order, control.max_step, control.noise)

    def _hand_turns(self):
        self._core.turns = np.zeros((0, self.system.nx)) if self._turns is None else self._turns

    def begin(self, t, p, v, t_end, known=None):
        states = super().begin(t, p, v, t_end, known)
        self._hand_turns()
        self._core.begin(t, self.t, self.h, self.k, self.p, self.y, self.base, self.Z)
        if self.method.step is not None:
            self._core.fix_step(self._start, self._taken, self._steps)
        return states

    def passes_changes(self, with_curve):
        return not with_curve and self.method.first_step is None and self._starts_at_once

    @property
    def _starts_at_once(self) -> bool:
        """Whether starts are made in one call; Python handles those that a jump of the constraints may prevent."""
        return self.method.step is None and isinstance(self.index1, CompiledIndex1) and not self.system.moving

    def _history(self, t, p, v, t_end):
        found = None
        if self._starts_at_once:
            self._hand_turns()
            found = self._core.history(self._compiled, t, p, v, t_end, self.method.first_step or 0.0)
        return found or super()._history(t, p, v, t_end)

    def segment(self):
        self.base, self.Z = self._core.base, self._core.Z
        return super().segment()

    def _why_no_start(self):
        """The error that a start from the current state raises."""
        try:
            super()._history(self.t, self.p, self.velocity_and_multipliers()[0], self.t + self.h)
        except PinconsistError as raised:
            return raised
        return None

    def batch_of(self, made, with_curve) -> StepBatch:
        core, system, t_old = self._core, self.system, self.t
        failure, error, t, p, v, lam, h, k, tables, jumps = made
        self.t, self.h, self.k, self.p, self.y = core.t, core.h, core.k, core.p, core.y
        why, curve = self._counted(failure), None
        if len(t):
            self.t_old, self.used, self._points = t[-2] if len(t) > 1 else t_old, (h[-1], k[-1]), k[-1] + 1
        if failure == "turns_too_far":
            why = self._turns_too_far(self.velocity_and_multipliers()[0])
        if failure == "no_start":
            error = self._why_no_start()
        if with_curve and len(t):
            base, Z = tables[0].reshape(len(t), -1), tables[1].reshape(len(t), bdf.ROWS, -1)
            changes = np.full(len(t), None)
            changes[:] = [bdf.UNCHANGED] * len(t)
            changes[0], self._changed = self._changed, bdf.UNCHANGED
            for i, matrix in zip(tables[2], tables[3].reshape(-1, bdf.ROWS, bdf.ROWS), strict=True):
                changes[i] = matrix
            curve = Tables(np.append(t_old, t[:-1]), t, t, h, k, base, Z, changes, system, self._chart_points)
        return StepBatch(t, p, v, lam, k, curve, why, error, jumps)
