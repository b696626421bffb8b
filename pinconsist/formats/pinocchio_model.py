"""Pinocchio's own objects → Mechanism."""

from __future__ import annotations

import pinocchio as pin

from ..errors import InputError
from ..mechanism.constraints.constraint_models import loops_of
from ..mechanism.mechanism import Mechanism
from .closure import closed_by


def read(source, *, loops=(), closure=None) -> Mechanism:
    """A mechanism from a ``pin.Model``, or from a RobotWrapper, of which the model alone is taken.

    Parameters
    ----------
    source : pin.Model or RobotWrapper
        Not changed. Shapes of a RobotWrapper are left out.
    loops : sequence
        Pinocchio's constraint models, and records such as Loop, Drive and Coupling.
    closure : str, optional
        Close every loop in this way instead, as :func:`~pinconsist.load` does.

    Raises
    ------
    InputError
        Something else, or constraints that are no loops.
    """
    if isinstance(source, Mechanism):
        raise InputError(f"{source.name!r} is a Mechanism already; its with_loops() gives it other loops")
    model = source if isinstance(source, pin.Model) else getattr(source, "model", None)
    if not isinstance(model, pin.Model):
        raise InputError(f"load needs a model's name, a path, a pin.Model or a RobotWrapper, got {_what(source)}")
    if isinstance(loops, str) or not hasattr(loops, "__iter__"):
        raise InputError(f"loops= of a pin.Model needs a sequence of constraint models or Loops, got {_what(loops)}")
    loops = tuple(loops)
    ours = [hasattr(each, "kind") and hasattr(each, "rows") for each in loops]
    found, model = loops_of([each for each, own in zip(loops, ours, strict=True) if not own], model)
    theirs = iter(found)
    records = [each if own else next(theirs) for each, own in zip(loops, ours, strict=True)]
    return Mechanism(model, closed_by(records, closure), name=model.name or "mechanism")


def _what(value):
    return type(value).__name__
