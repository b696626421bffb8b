"""The compiled stepper of Radau IIA."""

from __future__ import annotations

from ..dae.dense import Curve, RadauSegment
from ..dae.radau import table
from ..dae.radau_control import RadauControl
from ..dae.radau_stepper import RadauStepper
from ..dae.stepper import StepBatch
from ..dae.tuning import FEWEST_STAGES, FIRST_STAGES, MOST_STAGES
from . import load
from .compiled_system import CompiledRun, compiled_system


class CompiledRadauStepper(CompiledRun, RadauStepper):
    """A :class:`~pinconsist.dae.radau_stepper.RadauStepper` that makes many steps in one call."""

    def change_system(self, system) -> None:
        super().change_system(system)
        control, before = self.control, self._core
        self._core = load()[0].RadauStepper(self._compiled, self.method.switches)
        self._sampler = None  # it outlives the run where it holds no function of the user's
        if self.ahead:
            self._sampler = load()[0].Sampler(compiled_system(system))
        chooses = self.method.stages == 0
        for s in (FEWEST_STAGES, FIRST_STAGES, MOST_STAGES) if chooses else (self.method.stages,):
            of = table(s)
            self._core.add_table(of.c, of.A, of.inverse, of.inverse2, of.modes)
            if isinstance(control, RadauControl):
                self._core.add_tolerances(s, *control.for_stages(s, system))
        if isinstance(control, RadauControl):
            sizes = control.sizes if before is None else before.sizes
            self._core.control_error(sizes, control.max_step, chooses, control.worth_most)

    def begin(self, t, p, v, t_end):
        states = super().begin(t, p, v, t_end)
        self._hand_state()
        self._core.turns, self._core.h = self._turns, self.h
        if self.method.step is not None:
            self._core.fix_step(self._start, self._taken, self._steps)
        return states

    def retake(self, segment, t):
        of = segment
        state = self._core.retake(len(of.W), of.t_old, of.h, of.W, of.p0, of.v0, t)
        return segment(t) if state is None else state

    def _sample(self, segment, times):
        of, system = segment, segment.system
        if self._sampler is None or system is not self.system:
            return None
        A, modes = of.table.A, of.table.modes
        return self._sampler.sample(A, modes, of.t_old, of.h, of.W, of.U, of.p0, of.v0, of.p, of.v, system.nc, times)

    def resume(self, t_end):
        states = super().resume(t_end)
        if self.method.step is not None:
            self._core.h = self.h
            self._core.fix_step(self._start, self._taken, self._steps)
        return states

    def _jump(self):
        if not self._core.jump():
            self.index1.acceleration(self.t, self.p, self.v)  # says why
        self.a, self.lam = self._core.a, self._core.lam

    def _hand_state(self):
        self._core.begin(self.t, self.s, self.p, self.v, self.a, self.lam)

    def _first_step(self, t_end):
        if self.method.first_step is not None:
            return super()._first_step(t_end)
        self._hand_state()
        return self._core.first_step(t_end)

    def batch_of(self, made, with_curve) -> StepBatch:
        core, t_old, p_old, v_old = self._core, self.t, self.p, self.v
        failure, error, t, p, v, lam, h, k, W, U = made
        self.t, self.h, self.s = core.t, core.h, core.s
        self.p, self.v, self.a, self.lam = core.p, core.v, core.a, core.lam
        if len(t):
            self.used = float(h[-1]), int(k[-1])
        why = self._counted(failure)
        segments, nv, nx = [], self.system.nv, self.system.nx
        for i in range(len(t) if with_curve else 0):
            s = (int(k[i]) + 1) // 2
            here, W = W[: s * nv].reshape(s, nv), W[s * nv :]
            rates, U = U[: s * nx].reshape(s, nx), U[s * nx :]
            step = t_old, t[i], h[i], table(s), p_old, v_old, here, rates, p[i], v[i]
            segments.append(RadauSegment(*step, self.system, self._sample))
            t_old, p_old, v_old = t[i], p[i], v[i]
        return StepBatch(t, p, v, lam, k, Curve(segments) if segments else None, why, error)
