"""The forces of one call, on top of a mechanism's own."""

from __future__ import annotations

from collections.abc import Mapping

from ..errors import InputError
from .mechanism import Mechanism


def acting(mechanism, forces, caller: str) -> Mechanism:
    """The mechanism with these forces too, after a check of both; one force may stand for itself."""
    if not isinstance(mechanism, Mechanism):
        raise InputError(f"{caller} needs a Mechanism, got {type(mechanism).__name__}; see pinconsist.load()")
    if callable(forces) or isinstance(forces, Mapping) or hasattr(forces, "torque") or hasattr(forces, "bind"):
        forces = (forces,)
    elif isinstance(forces, str) or not hasattr(forces, "__iter__"):
        raise InputError(f"forces must be a sequence of forces, got {forces!r}")
    forces = tuple(forces)
    return mechanism.with_forces(*forces) if forces else mechanism
