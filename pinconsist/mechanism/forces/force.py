"""What a force is: the protocol, the records in plain numbers, and what they become on a model."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, Protocol

import numpy as np

MOST_NAMED = 3  # joints in a label


class Force(Protocol):
    """What acts on the joints: generalised torque τ, shape (nv,), N·m (or N).

    A force that needs to know the model has instead a method ``bind(model)`` that returns such an object. It may also
    have a ``label``, its name in reports, and a method ``stored(q, v) -> (energy, rate)``, J and W, for the part of it
    that is elastic.
    """

    def torque(self, t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """τ at a state."""

    def derivatives(self, t: float, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray | None, np.ndarray | None]:
        """(∂τ/∂q, ∂τ/∂v), each (nv, nv) in the tangent space, or None where it is zero or small."""


class ForceRecord:
    """A force in plain numbers, by the names of joints and frames; it knows no model yet."""

    _kind: ClassVar[str]
    _acts_on: ClassVar[str]  # the field that says where
    _law: ClassVar[Any]  # (record, model) → BoundForce

    @property
    def label(self) -> str:
        """The name of the force in energy reports and messages: "damping crank, rocker", without joints if many."""
        where = getattr(self, self._acts_on)
        if isinstance(where, Mapping):
            where = ", ".join(where) if len(where) <= MOST_NAMED else ""
        return f"{self._kind} {where}" if where and isinstance(where, str) else self._kind

    def bind(self, model) -> Any:
        """The force on one model; systems call it, users need not.

        Parameters
        ----------
        model : pin.Model
            The model that the names of joints and frames belong to.

        Returns
        -------
        Force
            An object with ``torque(t, q, v)`` and ``derivatives(t, q, v)``, see
            :class:`pinconsist.mechanism.forces.Force`; it holds what it needs of the model.

        Raises
        ------
        InputError
            A joint or frame that the model does not have, or has several times; numbers that do not fit its velocities.
        """
        return self._law(self, model)


class BoundForce(ABC):
    """A record on a model, by default one that depends on time alone and that only Python can evaluate."""

    @abstractmethod
    def torque(self, t, q, v): ...

    def derivatives(self, t, q, v):
        return None, None

    def hand_over(self, twin) -> bool:
        """Add this law to the compiled system; False where that has to call Python."""
        return False


def unused(wanted: str, taken) -> str:
    """`wanted`, or "wanted 2", "wanted 3", … where that is taken."""
    found, count = wanted, 1
    while found in taken:
        count += 1
        found = f"{wanted} {count}"
    return found
