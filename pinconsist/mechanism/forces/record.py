"""What every record of a force answers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any


class ForceRecord(ABC):
    """A force in plain numbers, by the names of joints and frames; it knows no model yet."""

    @abstractmethod
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
