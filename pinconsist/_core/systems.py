"""Equations in C++: of a mechanism, or callbacks into any other system."""

from ..dae.index1 import Index1, NotFiniteError, not_closed_message, not_finite_message
from ..dae.kkt import singular_message
from ..errors import AssemblyError, SingularSystemError
from . import required
from .tree import workspace


def compiled_system(system):
    """The compiled equations of a system: those of a mechanism, or callbacks into any other."""
    module = required()
    if not hasattr(system, "hand_over"):
        return module.CallbackSystem(system)
    compiled = blank_system(system.model, system.data)
    system.hand_over(compiled)
    return compiled


def with_all_rows(system):
    """A compiled system of a mechanism with all rows of its loops, dependent ones included, without forces."""
    compiled = blank_system(system.model, system.data)
    system.all_rows().hand_over(compiled)
    return compiled


def blank_system(model, data=None):
    """A compiled system of a model without rows and forces.

    Systems with the same `data` of Pinocchio share a workspace; without, it has one of its own.
    """
    module = required()
    return module.MechanismSystem(workspace(module, model, data))


class CompiledIndex1(Index1):
    """The methods of :class:`~pinconsist.dae.index1.Index1`, in C++."""

    def __init__(self, system, compiled):
        super().__init__(system)
        self.compiled = compiled
        self._projection = required().Projection(compiled)

    def acceleration(self, t, p, v):
        """Acceleration and multipliers of the differential equation."""
        solution = self._projection.acceleration(t, p, v)
        if solution is None:
            raise SingularSystemError(singular_message(t))
        a, lam, finite = solution
        if not finite:
            raise NotFiniteError(not_finite_message(self.system, t, p, v))
        return a, lam

    def projected(self, t, p, v):
        """(p, v) put on the constraints."""
        p, v, failure, gap = self._projection.project(t, p, v)
        if failure:
            singular = failure == "singular"
            raise SingularSystemError(singular_message(t)) if singular else AssemblyError(not_closed_message(gap))
        return p, v
