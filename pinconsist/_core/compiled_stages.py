"""The compiled way along steps of Radau IIA, for gradients."""

from dataclasses import replace

import numpy as np

from ..dae.kkt import singular_message
from ..dae.segments import not_made_again
from ..errors import SingularSystemError
from . import load
from .compiled_gradient import use_parameters


class CompiledStageWay:
    """Answers what :class:`~pinconsist.gradients.stage_leg.StageWay` does."""

    def __init__(self, index1, parameters):
        self.system, self.parameters = index1.system, parameters
        self._compiled, self._core = index1.compiled, load()[0].StageDerivatives(index1.compiled)
        use_parameters(self._core, parameters)

    def again(self, steps):
        if not steps:
            return []
        columns = self._columns(steps, np.zeros(len(steps)))
        p, v, W = (columns[i].copy() for i in (5, 6, -1))
        failed = self._core.again(self._compiled, columns, W, p, v)
        if failed >= 0:
            raise not_made_again(steps[failed].end)
        parts = np.split(W, np.cumsum([step.W.size for step in steps])[:-1])
        columns = zip(steps, parts, p, v, strict=True)
        return [replace(step, W=own.reshape(step.W.shape), p=q, v=rate) for step, own, q, rate in columns]

    def forward(self, steps, begins, S, ends):
        self._check(self._core.forward(self._compiled, self._columns(steps, begins), S, ends), steps)

    def backward(self, steps, begins, given, bars):
        total = np.zeros(len(self.parameters))
        self._check(self._core.backward(self._compiled, self._columns(steps, begins), given, bars, total), steps)
        return total

    def linear(self, t, p, v):
        if (found := self._core.linear(t, p, v)) is None:
            raise SingularSystemError(singular_message(t))
        return found

    def multipliers(self, t, p, v, s):
        lam, of_lam = np.empty((len(t), self.system.nc)), np.empty((*s.shape[:2], self.system.nc))
        self._check(self._core.multipliers(self._compiled, t, p, v, s, lam, of_lam), t)
        return lam, of_lam

    def multipliers_back(self, t, p, v, lam, bars):
        total = np.zeros(len(self.parameters))
        self._check(self._core.multipliers_back(self._compiled, t, p, v, lam, bars, total), t)
        return total

    @staticmethod
    def _check(singular, places):
        if singular >= 0:
            raise SingularSystemError(singular_message(getattr(places[singular], "end", places[singular])))

    def _columns(self, steps, begins):
        """What C++ reads of steps."""
        n, npos, nv = len(steps), self.system.npos, self.system.nv
        times = [np.array([getattr(step, name) for step in steps], float) for name in ("t_old", "end", "h")]
        states = [
            np.array([getattr(step, name) for step in steps], float).reshape(n, size)
            for name, size in (("p0", npos), ("v0", nv), ("p", npos), ("v", nv))
        ]
        stages = np.array([step.table.s for step in steps], np.int64)
        W = np.concatenate([np.zeros(0), *(step.W.ravel() for step in steps)])
        return *times, *states, stages, np.asarray(begins, np.int64), W
