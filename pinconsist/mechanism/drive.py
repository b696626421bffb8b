"""A joint driven along a given curve: a constraint that moves, whose multiplier is the motor torque."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite
from typing import ClassVar

import numpy as np

from ..errors import InputError, UserFunctionError
from .coordinate import Coordinate, nearest
from .differences import first, second

STEP = 1e-3  # s, of the difference quotients that stand in for missing derivatives


@dataclass(frozen=True)
class Drive:
    """Drive a joint along q_joint = curve(t). Stands among the loops of a mechanism.

    Its multiplier is the motor torque that this takes, N·m (or N), positive along the joint's velocity.

    Parameters
    ----------
    name : str
    joint : str
        A joint of one degree of freedom.
    curve : callable
        ``curve(t)``, rad or m, twice differentiable; a :class:`Motion` where plain numbers do.
    rate, acceleration : callable, optional
        Its derivatives. Default: the methods ``rate`` and ``acceleration`` of a curve that has them, as a Motion does;
        else sixth-order differences over 1 ms, good to about 1e-12 and 1e-9 of the curve's size: the multipliers
        inherit that.
    """

    name: str
    joint: str
    curve: Callable
    rate: Callable | None = None
    acceleration: Callable | None = None

    kind: ClassVar[str] = "drive"
    rows: ClassVar[tuple[str, ...]] = ("motor",)

    def __post_init__(self):
        for field in ("curve", "rate", "acceleration"):
            function = getattr(self, field)
            if not (callable(function) or (function is None and field != "curve")):
                raise InputError(f"drive {self.name!r}: {field} must be a function of time, got {function!r}")


class DriveRow:
    """The row of a drive on a model."""

    moving, steady, turns = True, True, (True,)  # a row in rad or m: measured by its own joint

    def __init__(self, model, drive: Drive):
        self.loop = drive
        self._joint = Coordinate(model, drive.joint, f"drive {drive.name!r}", "driven")
        self._period = 2.0 * np.pi if self._joint.wraps else None
        self._rate = drive.rate or getattr(drive.curve, "rate", None)
        self._acceleration = drive.acceleration or getattr(drive.curve, "acceleration", None)
        self._J = np.zeros((1, model.nv))
        self._J[0, self._joint.column] = 1.0

    def evaluate(self, data, q, t):
        """Φ and J."""
        gap = self._joint.value(q) - self._call(self.loop.curve, t)
        return np.array([nearest(gap, self._period)]), self._J.copy()

    def rate(self, t, q):
        """Φ_t."""
        if self._rate is not None:
            return -np.array([self._call(self._rate, t)])
        return -first(lambda s: self._call(self.loop.curve, t + s), STEP).reshape(1)

    def acceleration_bias(self, data, t, q, v):
        """Φ_tt; J is constant."""
        if self._acceleration is not None:
            return -np.array([self._call(self._acceleration, t)])
        return -second(lambda s: self._call(self.loop.curve, t + s), STEP).reshape(1)

    def _call(self, function, t) -> float:
        try:
            value = float(function(t))
        except Exception as error:
            raise UserFunctionError(f"the curve of drive {self.loop.name!r}", t, error) from error
        if not isfinite(value):
            raise InputError(f"the curve of drive {self.loop.name!r}, or a derivative of it, is {value} at t = {t:.6g}")
        return value
