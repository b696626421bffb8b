"""The one coordinate of a joint: an angle or a length read from q, whichever way Pinocchio stores it."""

from __future__ import annotations

import math

from ...errors import InputError
from ..checks import joint_index


class Coordinate:
    """Where the coordinate of a joint with one degree of freedom stands.

    Parameters
    ----------
    model : pin.Model
    joint : str
    whose : str
        By what name messages speak of the record that wants it, for instance ``"drive 'motor'"``.
    purpose : str
        What such a joint is wanted for.

    Attributes
    ----------
    column : int
        Its place in v.
    wraps : bool
        The joint stores (cos, sin): its angle is known up to whole turns only.

    Raises
    ------
    InputError
        No such joint, or one with several degrees of freedom.
    """

    def __init__(self, model, joint: str, whose: str, purpose: str):
        index = joint_index(model, joint, whose)
        if model.nvs[index] != 1:
            raise InputError(
                f"{whose}: joint {joint!r} has {model.nvs[index]} degrees of freedom; "
                f"only joints with one can be {purpose}"
            )
        self.column, self.wraps = model.idx_vs[index], model.nqs[index] == 2
        self._q = model.idx_qs[index]

    @property
    def place(self) -> tuple[int, int, int]:
        """Column of v, place in q and whether it wraps, for the compiled twin."""
        return self.column, self._q, int(self.wraps)

    def value(self, q) -> float:
        """rad or m; in (-π, π] where the joint wraps."""
        return math.atan2(q[self._q + 1], q[self._q]) if self.wraps else float(q[self._q])


def nearest(gap: float, period: float | None) -> float:
    """What is left of `gap` when whole periods are taken out; `gap` itself where nothing wraps."""
    return gap if period is None else math.remainder(gap, period)
