"""The compiled stepper of Radau IIA."""

from dataclasses import dataclass

import numpy as np

from ..dae.dense import Curve, StepBatch
from ..dae.events import BESIDE, nearness
from ..dae.radau_control import RadauControl
from ..dae.radau_stepper import RadauStepper
from ..dae.radau_table import table
from ..dae.segments import RadauSegment
from ..dae.tuning import FEWEST_STAGES, FIRST_STAGES, MOST_STAGES
from . import load
from .compiled_system import CompiledRun


class StageCurve(Curve):
    """The polynomials of compiled steps: those of :class:`RadauSegment`, evaluated in C++.

    `sampler` holds the object that evaluates them, as long as that may be kept.
    """

    def __init__(self, core, start, ends, system, sampler: list):
        self._core, self.start, self.ends, self.system, self._sampler = core, start, ends, system, sampler

    def segment(self, i):
        return StageSegment(self, i, self.ends[i - 1] if i else self.start, self.ends[i])

    def plain(self, i) -> RadauSegment:
        return self._plain(self.ends[i], *self._core.step(i))

    def _plain(self, end, t, h, s, *parts):
        *arrays, halves = parts
        named = dict(zip(("p0", "v0", "W", "U", "p", "v", "ends", "stiff"), arrays, strict=True))
        ends = (halves[1][0], end) if halves else ()
        halves = tuple(self._plain(at, *half) for at, half in zip(ends, halves, strict=True))
        return RadauSegment(t, end, h, table(s), **named, system=self.system, halves=halves)

    def _cut(self, last, end):
        ends = np.append(self.ends[:last], end)
        return StageCurve(self._core.first(last + 1), self.start, ends, self.system, self._sampler)

    def __call__(self, times):
        found = self._sampler[0].rows(self._core, self.holders(times), times) if self._sampler else None
        return found or super().__call__(times)

    def row(self, i, t):
        """(p, v, λ) at a time of a step."""
        found = self._sampler[0].row(self._core, i, t) if self._sampler else None
        return found or self.plain(i)(t)

    def with_others(self, curves):
        core, ends = self._core.joined([each._core for each in curves]), [each.ends for each in (self, *curves)]
        return StageCurve(core, self.start, np.concatenate(ends), self.system, self._sampler)


@dataclass(frozen=True)
class StageSegment:
    """One step of a curve."""

    curve: StageCurve
    i: int
    t_old: float
    end: float

    def __call__(self, t):
        return self.curve.row(self.i, t)


class CompiledRadauStepper(CompiledRun, RadauStepper):
    """A :class:`~pinconsist.dae.radau_stepper.RadauStepper` that makes many steps in one call."""

    def __init__(self, system, method):
        self._sampler = []
        super().__init__(system, method)

    def change_system(self, system) -> None:
        super().change_system(system)
        control, before = self.control, self._core
        self._core = load()[0].RadauStepper(self._compiled, self.method.switches)
        self._forget_functions()
        self._sampler = [load()[0].Sampler(self._compiled)]
        chooses = self.method.stages == 0
        if isinstance(control, RadauControl):
            for s in (FEWEST_STAGES, FIRST_STAGES, MOST_STAGES) if chooses else (self.method.stages,):
                self._core.allow(s, *control.of_stages(s))
            sizes = control.sizes if before is None else before.sizes
            self._core.control_error(*control.wanted, sizes, control.max_step, chooses, control.worth_most)

    def begin(self, t, p, v, t_end, known=None):
        first = self._turns is None
        states = super().begin(t, p, v, t_end, known)
        if first:
            self._core.turns = self._turns
        self._core.h = self.h
        self._core.divide(self.method.step or 0.0, t_end)
        return states

    def close(self) -> None:
        super().close()
        self._forget_functions()

    def _forget_functions(self):
        """Curves outlive the run if they hold no user-defined function."""
        if not self.ahead:
            self._sampler.clear()

    def segment(self):
        return StageCurve(self._core.last_step, self.t_old, [self.t], self.system, self._sampler).plain(0)

    def locate(self, signs, i):
        found = None
        if signs.values[i]:
            found = self._core.locate(signs, i, nearness(signs.begin, signs.end, True), BESIDE)
        return found or super().locate(signs, i)

    def passes_changes(self, with_curve):
        return not self.system.moving  # the velocities may jump with a constraint

    def resume(self, t_end):
        states = super().resume(t_end)
        self._core.divide(self.method.step or 0.0, t_end)
        return states

    def jump(self) -> None:
        if not self._core.jump():
            self.index1.acceleration(self.t, self.p, self.v)  # says why
        self.lam = self._core.lam

    def _hand_state(self):
        self._core.begin(self.t, self.s, self.p, self.v, self.a, self.lam)

    def _first_step(self, t_end):
        if self.method.first_step is not None:
            return super()._first_step(t_end)
        return self._core.first_step(t_end)

    def batch_of(self, made, with_curve) -> StepBatch:
        core, t_old = self._core, self.t
        failure, error, t, p, v, lam, h, k, steps, jumps = made
        self.t, self.h, self.s = core.t, core.h, core.s
        if len(t):
            self.t_old = t[-2] if len(t) > 1 else t_old
            self.p, self.v, self.lam, self.used = p[-1], v[-1], lam[-1], (float(h[-1]), int(k[-1]))
        curve = StageCurve(steps, t_old, t, self.system, self._sampler) if steps is not None else None
        return StepBatch(t, p, v, lam, k, curve, self._counted(failure), error, jumps)
