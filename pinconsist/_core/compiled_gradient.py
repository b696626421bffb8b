"""What gradients ask of the compiled part."""

import numpy as np

from ..dae import bdf
from ..dae.index1 import Index1
from ..dae.kkt import singular_message
from ..errors import SingularSystemError
from . import load
from .compiled_system import CompiledIndex1, compiled_system


def index1_of(system, compiled: bool) -> Index1:
    """The equations of index 1 of a mechanism's system, compiled where that can be had."""
    if not compiled or load()[0] is None:
        return Index1(system)
    return CompiledIndex1(system, compiled_system(system))


def known_columns(index1, parameters):
    """The function of a state that gives what is known of r_θ, (P, nv); `parameters` as in ``gradients.varied``."""
    if isinstance(index1, CompiledIndex1) and (rates := _known_rates(parameters)) is not None:
        return lambda *state: rates.columns(*state, len(parameters)).T

    def columns(*state):
        r = np.zeros((len(parameters), index1.system.nv))
        for i, row in enumerate(r):
            for weight, other in () if i in parameters.beside else parameters[i]:
                row += weight * other.system.evaluate(*state)[0]
        return r

    return columns


def _known_rates(parameters):
    """The compiled derivatives that are known, or None where there are none."""
    if not parameters.known:
        return None
    rates = load()[0].Rates(*parameters.workspace)
    for columns, parts in parameters.known:
        for weight, part in parts:
            part.hand_over(rates, columns, weight)
    return rates


def use_parameters(core, parameters) -> None:
    """Hand over to what leads derivatives in C++; `parameters` as in ``gradients.varied``, or an empty list."""
    if not len(parameters):
        return
    core.use_parameters(len(parameters))
    for column, terms in parameters.beside.items():
        for weight, other in terms:
            core.add_term(column, weight, other.compiled)
    if (rates := _known_rates(parameters)) is not None:
        core.use_known(rates)


def all_rows(index1):
    """The function of a configuration that gives J of all rows of a mechanism's loops, (n_multipliers, nv)."""
    system = index1.system
    if not isinstance(index1, CompiledIndex1):
        return lambda q: system.loop_rows(q)[1]
    compiled, still = load()[0].MechanismSystem(system.model, system.data), np.zeros(system.nv)
    system.hand_over_all_rows(compiled)
    return lambda q: compiled.evaluate(system.chosen_at, q, still, still)[2]


def follower(index1, residuals):
    """The compiled way along the legs of the system of `index1`, or None; `residuals` as in ``linear.Step``."""
    if not isinstance(index1, CompiledIndex1):
        return None
    core = load()[0].Derivatives(index1.compiled)
    use_parameters(core, residuals)
    return CompiledFollower(index1, core, len(residuals))


class CompiledFollower:
    """Leads derivatives along legs in C++."""

    def __init__(self, index1, core, parameters):
        self._index1, self._core, self._parameters = index1, core, parameters

    def forward(self, leg, S) -> None:
        """See :func:`pinconsist.gradients.forward.follow`."""
        leg.tables = np.empty((1 + len(leg.t), *S.shape))
        leg.tables[0] = S
        singular = self._core.forward(self._index1.compiled, *_columns(leg), leg.tables)
        if singular >= 0:
            raise SingularSystemError(singular_message(leg.t[singular]))

    def backward(self, leg, seeds):
        """See :func:`pinconsist.gradients.forward.follow_back`."""
        rates = np.zeros(self._parameters)
        singular = self._core.backward(self._index1.compiled, *_columns(leg), seeds, rates)
        if singular >= 0:
            raise SingularSystemError(singular_message(leg.t[singular]))
        return rates


def _columns(leg):
    """What the compiled follower reads of a leg."""
    t, h, k, base, Z = leg.curve()
    changed = [i for i, changes in enumerate(leg.changes) if changes is not bdf.UNCHANGED]
    changes = np.array([leg.changes[i] for i in changed]).reshape(-1, bdf.ROWS, bdf.ROWS)
    return t, h, k.astype(np.int64), base, Z, changed, changes
