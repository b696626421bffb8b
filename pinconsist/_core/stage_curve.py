"""The polynomials of steps of Radau IIA, evaluated in C++."""

from dataclasses import dataclass

import numpy as np

from ..dae.dense import Curve
from ..dae.radau_table import table
from ..dae.segments import RadauSegment


class StageCurve(Curve):
    """The polynomials of compiled steps: those of :class:`RadauSegment`, evaluated in C++.

    `sampler` holds the object that evaluates them, as long as that may be kept.
    """

    def __init__(self, core, start, ends, system, sampler: list):
        self._core, self._start, self.ends, self.system, self._sampler = core, start, ends, system, sampler

    @property
    def start(self):
        return self._start

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
