"""Derivatives propagated along the steps of BDF and of Radau IIA, in C++."""

from dataclasses import replace

import numpy as np

from ..dae import bdf
from ..dae.kkt import singular_message
from ..dae.segments import not_made_again
from ..errors import SingularSystemError
from . import required
from .systems import CompiledIndex1, compiled_system, with_all_rows
from .tree import workspace


def index1_of(system) -> CompiledIndex1:
    """The equations of index 1 of a mechanism's system."""
    return CompiledIndex1(system, compiled_system(system))


def _known_rates(parameters):
    """The known derivatives, or None if there are none."""
    if not parameters.known:
        return None
    rates = required().Rates(workspace(required(), *parameters.workspace))
    for columns, parts in parameters.known:
        for weight, part in parts:
            part.hand_over(rates, columns, weight)
    return rates


def all_rows(index1):
    """The function of a configuration that returns J of all rows of a mechanism's loops, (n_multipliers, nv)."""
    system = index1.system
    compiled, still = with_all_rows(system), np.zeros(system.nv)
    return lambda q: compiled.evaluate(system.chosen_at, q, still, still)[2]


class Propagator:
    """Propagates derivatives by parameters along steps of the system of `index1`, forwards and backwards.

    Each of the `parameters` is a list of (weight, Index1); the weighted sum of their residuals is the derivative of the
    residual by the parameter.
    """

    kind: str

    def __init__(self, index1, parameters):
        self.system, self.parameters = index1.system, parameters
        core = self._core = getattr(required(), self.kind)(index1.compiled)
        if not len(parameters):
            return
        core.use_parameters(len(parameters))
        for column, terms in parameters.beside.items():
            for weight, other in terms:
                core.add_term(column, weight, other.compiled)
        if (rates := _known_rates(parameters)) is not None:
            core.use_known(rates)

    def _rates(self):
        return np.zeros(len(self.parameters))

    @staticmethod
    def _check(singular, times) -> None:
        if singular >= 0:
            raise SingularSystemError(singular_message(times[singular]))


def _rows(array):
    """An array as a table with a row for each value of its first index; writes change the array."""
    return array.reshape(len(array), array[0].size if len(array) else 0)


class Follower(Propagator):
    """Propagates derivatives along legs of BDF."""

    kind = "Derivatives"

    def forward(self, leg, S) -> None:
        """Fill the leg's `tables` from `S` of its history."""
        leg.tables = np.empty((1 + len(leg.t), *S.shape))
        leg.tables[0] = S
        self._check(self._core.forward(self._steps(leg), _rows(leg.tables)), leg.t)

    def backward(self, leg, seeds):
        """The derivative of a number by the parameters through the steps, (P,): the transpose of :meth:`forward`.

        `seeds`, (1+n, ROWS, nx+nv+nc), are the direct derivatives of the number by each of the tables S. The first one
        becomes the total derivative by the table of the history.
        """
        rates = self._rates()
        self._check(self._core.backward(self._steps(leg), _rows(seeds), rates), leg.t)
        return rates

    @staticmethod
    def _steps(leg):
        t, h, k, base, Z = leg.curve()
        changed = np.array([False, *(changes is not bdf.UNCHANGED for changes in leg.changes)])
        changes = np.array([each.ravel() for each in leg.changes[changed[1:]]]).reshape(-1, bdf.ROWS**2)
        return required().Leg(t, h, k, base, _rows(Z), np.where(changed, np.cumsum(changed) - 1, -1), changes)


class StagePropagator(Propagator):
    """Propagates derivatives along steps of Radau IIA, which are :class:`~pinconsist.dae.segments.RadauSegment`."""

    kind = "StageDerivatives"

    def again(self, steps):
        """Solve steps to rounding that are not solved yet, see ``RadauSegment.ending_at``."""
        if not steps:
            return []
        made = self._steps(steps)
        if (failed := self._core.again(made)) >= 0:
            raise not_made_again(steps[failed].end)
        parts = np.split(made.W, np.cumsum([step.W.size for step in steps])[:-1])
        columns = zip(steps, parts, made.p, made.v, strict=True)
        return [replace(step, W=own.reshape(step.W.shape), p=q, v=rate) for step, own, q, rate in columns]

    def forward(self, steps, S, ends):
        """Write the derivatives at the ends of steps to `ends`, from those at their starts, `S`, which may overlap."""
        self._check(self._core.forward(self._steps(steps), _rows(S), _rows(ends)), [step.end for step in steps])

    def backward(self, steps, given, bars):
        """The transpose, from the last step to the first: add to `bars`; return the derivative by parameters, (P,)."""
        total = self._rates()
        self._check(self._core.backward(self._steps(steps), given, bars, total), [step.end for step in steps])
        return total

    def multipliers(self, t, p, v, s):
        """λ at states, (n, nc), and its derivatives, (n, P, nc), from those of the states."""
        lam, of_lam = np.empty((len(t), self.system.nc)), np.empty((*s.shape[:2], self.system.nc))
        self._check(self._core.multipliers(t, p, v, _rows(s), lam, _rows(of_lam)), t)
        return lam, of_lam

    def multipliers_back(self, t, p, v, lam, bars):
        """The transpose for one number: add to `bars`, (n, nx+nv); return the derivative by the parameters, (P,)."""
        total = self._rates()
        self._check(self._core.multipliers_back(t, p, v, lam, bars, total), t)
        return total

    def _steps(self, steps):
        sizes = {"t_old": (), "end": (), "h": ()}
        sizes |= {"p0": (self.system.npos,), "v0": (self.system.nv,), "p": (self.system.npos,), "v": (self.system.nv,)}
        columns = [np.array([getattr(each, name) for each in steps], float) for name in sizes]
        shaped = [column.reshape(len(steps), *size) for column, size in zip(columns, sizes.values(), strict=True)]
        stages = np.array([step.table.s for step in steps], np.int64)
        W = np.concatenate([np.zeros(0), *(step.W.ravel() for step in steps)])
        return required().StageSteps(*shaped, stages, W)
