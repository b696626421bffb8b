"""The stepper whose accepted steps are made by the compiled twin; starts, events and records stay in Python."""

from __future__ import annotations

import logging
from functools import cache

import numpy as np

from .. import _core
from ..errors import InputError
from .dense import Segment
from .newton import culprits
from .stepper import Stepper, Stretch
from .stepsize import ErrorControl

log = logging.getLogger(__name__)

BACKENDS = ("auto", "compiled", "python")
FAILURES = (  # in the order of `Failure` in newton.hpp
    "",
    "the KKT matrix is singular",
    "the residual is not finite",
    "Newton diverged",
    "Newton did not converge",
    "the error test fails at any step size",
    "",
)
NOT_FINITE, TURNS_TOO_FAR = 2, 6


def stepper_for(system, method) -> Stepper:
    """The stepper that a method's ``backend`` asks for.

    Raises
    ------
    InputError
        ``backend="compiled"`` for what has no compiled twin.
    """
    if method.backend == "python":
        return Stepper(system, method)
    twin, why = twin_of(system)
    if twin is not None:
        return CompiledStepper(system, method, twin)
    if method.backend == "compiled":
        raise InputError(f"backend='compiled' cannot be had: {why}. backend='auto' takes Python then")
    stepper = Stepper(system, method)
    stepper.backend = f"python ({why})"
    return stepper


def twin_of(system):
    """(the compiled twin of a system, "") or (None, why there is none)."""
    if not hasattr(system, "hand_over"):
        return None, "only mechanisms have compiled equations"
    module, why = _core.load()
    if module is None:
        _say_once(why)
        return None, why
    twin = module.System(system.model, system.data)
    system.hand_over(twin)
    return twin, ""


@cache
def _say_once(why) -> None:
    log.warning("%s; the Python method is used, which gives the same results about ten times slower", why)


class CompiledStepper(Stepper):
    """A :class:`~pinconsist.dae.stepper.Stepper` that runs many steps in one call."""

    at_once = 1000
    backend = "compiled"

    def __init__(self, system, method, twin):
        super().__init__(system, method)
        self._take(twin)

    def _take(self, twin) -> None:
        self._twin, control, module = twin, self.control, _core.load()[0]
        self._core = module.Stepper(twin, self.newton.correct)
        self.system.twin = module.Projection(twin)
        if not getattr(self.system, "dropped_are_zero", True):
            self.system.twin_of_all_rows = module.System(self.system.model, self.system.data)
            self.system.hand_over_all_rows(self.system.twin_of_all_rows)
        if isinstance(control, ErrorControl):
            self._core.control_error(*control.spread, control.max_order, control.max_step)

    def change_system(self, system) -> None:
        self.system.twin = None
        super().change_system(system)
        self._take(twin_of(system)[0])

    def close(self) -> None:
        self._twin = self._core = self.system.twin = None

    def begin(self, t, p, v, t_end):
        states = super().begin(t, p, v, t_end)
        self._core.turns = np.zeros((0, self.system.nx)) if self._turns is None else self._turns
        self._core.begin(self.t, self.h, self.k, self.p, self.y, self.base, self.Z)
        if self.method.step is not None:
            self._core.fix_step(self._start, self._taken, self._steps)
        return states

    def stretch(self, t_end, most, watched) -> Stretch:
        core, system, t_old = self._core, self.system, self.t
        failure, error, t, p, v, lam, h, k, base, Z = core.run(self._twin, t_end, most, watched)
        self.t, self.h, self.k, self.p, self.y = core.t, core.h, core.k, core.p, core.y
        self._count()
        why = FAILURES[failure]
        if failure == NOT_FINITE:
            why += culprits(system, *core.culprit)
        elif failure == TURNS_TOO_FAR:
            why = self._turns_too_far(self.velocity_and_multipliers()[0])
        if not watched:
            return Stretch(why, error, block=(t, p, v, lam, k))
        pieces = []
        for i in range(len(t)):
            segment = Segment(t_old, t[i], t[i], h[i], int(k[i]), base[i], Z[i, : k[i] + 1], system)
            pieces.append(([(t[i], p[i], v[i], lam[i])], segment, int(k[i])))
            t_old = t[i]
        return Stretch(why, error, pieces)

    def _count(self) -> None:
        """Add the twin's work to the counters."""
        newton, reasons = self.newton, self.control.reasons
        nfev, njev, nlu, *rejected = self._core.work()
        newton.nfev += nfev
        newton.njev += njev
        newton.nlu += nlu
        for reason, count in zip(reasons, rejected, strict=False):  # a fixed step rejects nothing
            reasons[reason] += count
