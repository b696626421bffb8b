"""Derivatives propagated along the steps of Radau IIA, in C++."""

from dataclasses import dataclass, replace

import numpy as np

from ..engine import required
from ..engine.index1 import singular_message
from ..engine.radau_table import Table, table
from ..engine.systems import with_all_rows
from ..engine.tree import workspace
from ..errors import PinconsistError, SingularSystemError

NOT_MADE_AGAIN = "the step of Radau IIA could not be repeated up to t = {:.6g}"


@dataclass(frozen=True)
class Step:
    """A step of Radau IIA of size h with the formula `table`, from (p0, v0) at `t_old`, used up to `end`.

    `W` has the accelerations at its stages, a row for each; (p, v) is the state at its end.
    """

    t_old: float
    end: float
    h: float
    table: Table
    p0: np.ndarray
    v0: np.ndarray
    W: np.ndarray
    p: np.ndarray
    v: np.ndarray

    @staticmethod
    def of(curve, i: int) -> "Step":
        """A step of a :class:`~pinconsist.run.stage_curve.StageCurve`."""
        t, h, s, p0, v0, W, p, v = curve.step(i)
        return Step(t, curve.ends[i], h, table(s), p0, v0, W, p, v)

    def ending_at(self, t: float) -> "Step":
        """The step with its end at another time; its accelerations, from the polynomial, are a guess for Newton."""
        h = t - self.t_old
        W = self.table.values(h * self.table.c / self.h) @ self.W
        return replace(self, end=t, h=h, W=W)


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


def _rows(array):
    """An array as a table with a row for each value of its first index; writes change the array."""
    return array.reshape(len(array), array[0].size if len(array) else 0)


class Propagator:
    """Propagates derivatives by parameters along steps of Radau IIA of the system of `index1`, forwards and backwards.

    Each of the `parameters` is a list of (weight, Index1); the weighted sum of their residuals is the derivative of the
    residual by the parameter.
    """

    def __init__(self, index1, parameters):
        self.system, self.parameters = index1.system, parameters
        derivatives = self._derivatives = required().Derivatives(index1.compiled)
        if not len(parameters):
            return
        derivatives.use_parameters(len(parameters))
        for column, terms in parameters.beside.items():
            for weight, other in terms:
                derivatives.add_term(column, weight, other.compiled)
        if (rates := _known_rates(parameters)) is not None:
            derivatives.use_known(rates)

    def _rates(self):
        return np.zeros(len(self.parameters))

    @staticmethod
    def _check(singular, times) -> None:
        if singular >= 0:
            raise SingularSystemError(singular_message(times[singular]))

    def again(self, steps):
        """Solve steps to rounding that are not solved yet, see :meth:`Step.ending_at`."""
        if not steps:
            return []
        made = self._steps(steps)
        if (failed := self._derivatives.again(made)) >= 0:
            raise PinconsistError(NOT_MADE_AGAIN.format(steps[failed].end))
        parts = np.split(made.W, np.cumsum([step.W.size for step in steps])[:-1])
        columns = zip(steps, parts, made.p, made.v, strict=True)
        return [replace(step, W=own.reshape(step.W.shape), p=q, v=rate) for step, own, q, rate in columns]

    def forward(self, steps, S, ends):
        """Write the derivatives at the ends of steps to `ends`, from those at their starts, `S`, which may overlap."""
        self._check(self._derivatives.forward(self._steps(steps), _rows(S), _rows(ends)), [step.end for step in steps])

    def solved(self, t, p, v, stages, accelerations):
        """Steps between states at times t (1+n,), p and v, with numbers of stages (n,), solved to rounding.

        `accelerations` (1+n, nv) are those at the states, from which Newton's iteration starts. The steps, their last
        position and their last velocity are returned.
        """
        first, change = accelerations[:-1], np.diff(accelerations, axis=0)
        W = [a + table(int(s)).c[:, None] * b for a, b, s in zip(first, change, stages, strict=True)]
        W = np.concatenate([each.ravel() for each in W])
        made = required().StageSteps(t[:-1], t[1:], np.diff(t), p[:-1], v[:-1], p[1:], v[1:], stages, W)
        if (failed := self._derivatives.again(made)) >= 0:
            raise PinconsistError(NOT_MADE_AGAIN.format(t[failed + 1]))
        return made, made.p[-1], made.v[-1]

    def taken(self, steps):
        """The same of steps that are solved."""
        return self._steps(steps), steps[-1].p, steps[-1].v

    def through(self, made, times, start):
        """S at the end of solved steps, (P, nx+nv), from that at their start; `times` are those of their ends."""
        tables = np.empty((1 + len(times), *start.shape))
        tables[0] = start
        self._check(self._derivatives.forward(made, _rows(tables[:-1]), _rows(tables[1:])), times)
        return tables[-1]

    def backward(self, steps, given, bars):
        """The transpose, from the last step to the first: add to `bars`; return the derivative by parameters, (P,)."""
        total = self._rates()
        self._check(self._derivatives.backward(self._steps(steps), given, bars, total), [step.end for step in steps])
        return total

    def multipliers(self, t, p, v, s):
        """λ at states, (n, nc), and its derivatives, (n, P, nc), from those of the states."""
        lam, of_lam = np.empty((len(t), self.system.nc)), np.empty((*s.shape[:2], self.system.nc))
        self._check(self._derivatives.multipliers(t, p, v, _rows(s), lam, _rows(of_lam)), t)
        return lam, of_lam

    def multipliers_back(self, t, p, v, lam, bars):
        """The transpose for one number: add to `bars`, (n, nx+nv); return the derivative by the parameters, (P,)."""
        total = self._rates()
        self._check(self._derivatives.multipliers_back(t, p, v, lam, bars, total), t)
        return total

    def _steps(self, steps):
        sizes = {"t_old": (), "end": (), "h": ()}
        sizes |= {"p0": (self.system.npos,), "v0": (self.system.nv,), "p": (self.system.npos,), "v": (self.system.nv,)}
        columns = [np.array([getattr(each, name) for each in steps], float) for name in sizes]
        shaped = [column.reshape(len(steps), *size) for column, size in zip(columns, sizes.values(), strict=True)]
        stages = np.array([step.table.s for step in steps], np.int64)
        W = np.concatenate([np.zeros(0), *(step.W.ravel() for step in steps)])
        return required().StageSteps(*shaped, stages, W)
