"""The polynomials of steps of Radau IIA, evaluated in C++."""

import numpy as np

from ..engine import required
from ..engine.index1 import singular_message
from ..engine.systems import compiled_system
from ..errors import SingularSystemError
from .dense import Curve


class StageCurve(Curve):
    """The polynomials of steps of Radau IIA, see ``engine/collocation.hpp``.

    Between the ends, a state is projected onto both constraints, which removes most of its error; λ follows by the
    equations of index 1. Events use the polynomials without projection; the step is repeated up to an event that is
    found. If forces are stiff, what the projection moves along them is taken back, as at the end of a step. Where the
    polynomials are not accurate between the ends, a step has those of two steps of half the size.

    `sampler` holds the object that evaluates them, as long as that may be kept.
    """

    def __init__(self, steps, start, ends, system, sampler: list):
        self._steps = steps
        self.start = start
        self.ends = ends
        self.system = system
        self._sampler = sampler

    def step(self, i) -> tuple:
        """Of a step: start, size, number of stages; p and v there; accelerations of stages; p and v at its end."""
        return self._steps.step(i)

    def __call__(self, times):
        found = self._sampling().rows(self._steps, self.holders(times), times)
        if isinstance(found, int):
            raise SingularSystemError(singular_message(times[found]))
        return found

    def _sampling(self):
        """The object that evaluates the polynomials; a curve that outlives its run keeps none with user's functions."""
        return self._sampler[0] if self._sampler else required().Sampler(compiled_system(self.system))

    def with_others(self, curves):
        steps = self._steps.joined([each._steps for each in curves])
        ends = np.concatenate([each.ends for each in (self, *curves)])
        return StageCurve(steps, self.start, ends, self.system, self._sampler)
