"""The compiled stepper of Radau IIA."""

from __future__ import annotations

from ..dae.control import ErrorControl
from ..dae.dense import Curve, RadauSegment
from ..dae.newton import culprits
from ..dae.radau import table
from ..dae.radau_stepper import RadauStepper
from ..dae.stepper import StepBatch
from ..dae.tuning import FAILURES, STAGES
from . import load
from .compiled_system import CompiledRun


class CompiledRadauStepper(CompiledRun, RadauStepper):
    """A :class:`~pinconsist.dae.radau_stepper.RadauStepper` that makes many steps in one call."""

    def change_system(self, system) -> None:
        super().change_system(system)
        self._core, control = load()[0].RadauStepper(self._compiled, self.method.switches), self.control
        for s in STAGES:
            of = table(s)
            factor = 1.0 if self.method.step is not None else control.for_stages(s, system)[2]
            self._core.add_table(of.c, of.A, of.inverse, of.inverse2, of.modes, factor)
        if isinstance(control, ErrorControl):
            self._core.control_error(*control.spread, control.max_step)

    def begin(self, t, p, v, t_end):
        states = super().begin(t, p, v, t_end)
        self._hand_state()
        self._core.turns, self._core.h = self._turns, self.h
        if self.method.step is not None:
            self._core.fix_step(self._start, self._steps)
        return states

    def _hand_state(self):
        self._core.begin(self.t, self.s, self.p, self.v, self.a, self.lam)

    def _first_step(self, t_end):
        if self.method.first_step is not None:
            return super()._first_step(t_end)
        self._hand_state()
        return self._core.first_step(t_end)

    def steps(self, t_end, most, with_curve) -> StepBatch:
        core, t_old, p_old, v_old = self._core, self.t, self.p, self.v
        failure, error, t, p, v, lam, h, k, W, U = core.run(self._compiled, t_end, most, with_curve)
        self.t, self.h, self.s = core.t, core.h, core.s
        self.p, self.v, self.a, self.lam = core.p, core.v, core.a, core.lam
        if len(t):
            self.used = float(h[-1]), int(k[-1])
        self._count()
        why = FAILURES.get(failure, "")
        if failure == "not_finite":
            why += culprits(self.system, *core.culprit)
        segments, nv, nx = [], self.system.nv, self.system.nx
        for i in range(len(t) if with_curve else 0):
            s = (int(k[i]) + 1) // 2
            here, W = W[: s * nv].reshape(s, nv), W[s * nv :]
            rates, U = U[: s * nx].reshape(s, nx), U[s * nx :]
            segments.append(
                RadauSegment(t_old, t[i], h[i], table(s), p_old, v_old, here, rates, p[i], v[i], self.system)
            )
            t_old, p_old, v_old = t[i], p[i], v[i]
        return StepBatch(t, p, v, lam, k, Curve(segments) if segments else None, why, error)
