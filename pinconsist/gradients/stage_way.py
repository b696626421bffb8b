"""What is done along steps of Radau IIA: steps made again, their derivatives forwards and back, and those of λ."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .._core.compiled_stages import CompiledStageWay
from .._core.compiled_system import CompiledIndex1
from ..dae.index1 import project_position, project_velocity
from ..dae.radau import StageNewton, Stages
from ..dae.rounding import rounding_weights
from ..dae.segments import not_made_again
from .stages import Motion, Multipliers


class StageWay:
    """In Python, one step after another.

    Steps are :class:`~pinconsist.dae.segments.RadauSegment`. `parameters` are lists of (weight, Index1), whose weighted
    residuals are those by the parameter.
    """

    def __init__(self, system, parameters=()):
        self.system, self.parameters = system, parameters

    def again(self, steps):
        """Steps that are not solved yet, see ``RadauSegment.led_to``, solved to rounding."""
        return list(map(self._again, steps))

    def _again(self, step):
        system, t = step.system, step.end
        stages = Stages(system, step.table, step.t_old, step.p0, step.v0, step.h, step.W)
        y = np.concatenate((step.p0 if system.vector_like else np.zeros(system.nx), step.v0))
        if StageNewton().solve(stages, *rounding_weights(system, y)).failure:
            raise not_made_again(t)
        p = project_position(system, t, stages.P[-1], stages.V[-1])
        return replace(step, W=stages.W, U=stages.U, p=p, v=project_velocity(system, t, p, stages.V[-1]))

    def forward(self, steps, begins, S, ends) -> None:
        """Row i of `ends`, (n, P, nx+nv), becomes the end of step i from row begins[i] of `S`."""
        for i, step in enumerate(steps):
            of = Motion(step).linearize()
            ends[i] = of.forward(S[begins[i]], of.rates(self.parameters))

    def backward(self, steps, begins, given, bars):
        """The transpose, from the last step to the first: `bars` are added to; returns what parameters change, (P,)."""
        total = np.zeros(len(self.parameters))
        for i in reversed(range(len(steps))):
            of = Motion(steps[i]).linearize()
            bar, weights = of.backward(given[i])
            bars[begins[i]] += bar
            total += of.rates(self.parameters) @ weights
        return total

    def linear(self, t, p, v):
        """See :meth:`Multipliers.linear`."""
        return Multipliers(self.system, t, p, v).linearize().linear()

    def multipliers(self, t, p, v, s):
        """λ at states, (n, nc), and its derivatives, (n, P, nc), from those of the states."""
        nc = self.system.nc
        points = [Multipliers(self.system, *state).linearize() for state in zip(t, p, v, strict=True)]
        found = [of.forward(row, of.rates(self.parameters)) for of, row in zip(points, s, strict=True)]
        return np.array([of.lam for of in points]).reshape(len(t), nc), np.array(found).reshape(*s.shape[:2], nc)

    def multipliers_back(self, t, p, v, lam, bars):
        """The transpose, of one number: `bars`, (n, nx+nv), are added to; returns what parameters change, (P,)."""
        total = np.zeros(len(self.parameters))
        for i, state in enumerate(zip(t, p, v, strict=True)):
            of = Multipliers(self.system, *state).linearize()
            bar, weights = of.backward(lam[i])
            bars[i] += bar
            total += of.rates(self.parameters) @ weights
        return total


def way_along(index1, parameters) -> StageWay | CompiledStageWay:
    """The way along steps of the system of `index1`, compiled where that can be had."""
    if isinstance(index1, CompiledIndex1):
        return CompiledStageWay(index1, parameters)
    return StageWay(index1.system, parameters)
