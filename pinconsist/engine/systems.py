"""Equations in C++: of a mechanism, or callbacks into any other system."""

from . import required
from .tree import with_other_bodies as with_other_bodies
from .tree import workspace


def compiled_system(system):
    """The compiled equations of a system: those of a mechanism, or callbacks into any other."""
    module = required()
    if system.mechanism is None:
        return module.CallbackSystem(system)
    compiled = blank_system(system.model, system.workspace)
    system.hand_over(compiled)
    return compiled


def with_all_rows(system):
    """A compiled system of a mechanism with all rows of its loops, dependent ones included, without forces."""
    compiled = blank_system(system.model, system.workspace)
    system.all_rows().hand_over(compiled)
    return compiled


def choice_of_rows(system, every):
    """What tells whether the rows that a system keeps are a poor choice of all of them, those of `every`, compiled."""
    return required().KeptRows(every, system.kept.tolist(), system.scales, system.chosen_at)


def blank_system(model, owner=None):
    """A compiled system of a model without rows and forces.

    Systems with the same `owner`, any object, share a workspace; without, it has one of its own.
    """
    module = required()
    return module.MechanismSystem(workspace(module, model, owner))


def held_table():
    """A new table of held torques."""
    return required().HeldTable()
