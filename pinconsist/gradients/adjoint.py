"""Derivatives of one number by many parameters: the run's steps are gone through backwards.

The transpose of :mod:`forward`, step by step. What a step passes on does not depend on the parameters; each of them
costs the residuals of two mechanisms along the run, and what it changes at its start.
"""

from __future__ import annotations

import numpy as np

from .lead import through, times_of
from .redundant import Completion
from .starts import begun
from .variants import Variant

STILL = Variant("", 1.0, {}, {}, {}, inert=True, idle=True)  # a direction of the state


class Back:
    """Goes back along the legs of a run; ``total`` is then the derivative of a number by all parameters.

    ``derivatives(leg, times)`` gives those of the number by [q | v | λ] at the rows of a leg, (n, nx+nv+n_multipliers).
    """

    def __init__(self, solution, legs, variants, base, derivatives):
        self.solution, self.legs, self.variants = solution, legs, variants
        self.base, self.derivatives = base, derivatives
        self.sign = 1.0 if legs[-1].span[1] >= legs[0].span[0] else -1.0
        self.total = np.zeros(len(variants))

    def run(self) -> None:
        """Fill ``total``."""
        times, bar = list(times_of(self.solution, self.legs, self.sign)), None
        for i in reversed(range(len(self.legs))):
            leg = self.legs[i]
            seeds = leg.seeds()
            if bar is not None:
                leg.sow(np.array([leg.span[1]]), [self._through(leg, self.legs[i + 1], bar)], seeds)
            leg.sow(times[i], self._pulled(leg, times[i]), seeds)
            residuals = self.variants.residuals(leg.system)
            self.total += leg.follow_back(self.base.index1(leg.system), residuals, seeds)
            bar, rates = leg.begin_back(self.variants, self.base, seeds[0])
            self.total += rates
        self.total += begun(self.variants, self.base, self.legs[0].system) @ bar

    def _through(self, leg, following, bar):
        """The derivative by s where a leg ends, from that by the state where the `following` one begins."""
        n = leg.system.nx + leg.system.nv + leg.system.nc
        s = np.vstack((np.eye(n), np.zeros((len(self.variants), n))))
        both = [STILL] * n + list(self.variants)
        rates = through(leg, following, self.solution, both, self.base, s) @ bar
        self.total += rates[n:]
        return rates[:n]

    def _pulled(self, leg, times):
        """Derivatives by s of the rows, from those by the multipliers as the user sees them."""
        system = leg.system
        nx, nv = system.nx, system.nv
        if not len(times):
            return np.zeros((0, nx + nv + system.nc))
        bars = self.derivatives(leg, times)
        if system.nc == system.n_multipliers:
            return bars
        if system.dropped_are_zero:
            return np.hstack((bars[:, : nx + nv], bars[:, nx + nv :][:, system.kept]))
        p, y = leg.states(times)[:2]
        return np.array([self._of_kept(system, *row) for row in zip(p, y[:, nx + nv :], bars, strict=True)])

    def _of_kept(self, system, q, lam, bar):
        split = system.nx + system.nv
        if not bar[split:].any():
            return np.append(bar[:split], np.zeros(system.nc))
        by_q, by_lam, own = Completion(self.base, system, q, lam).backward(self.variants, bar[split:])
        self.total += own
        return np.concatenate((bar[: system.nx] + by_q, bar[system.nx : split], by_lam))
