"""A joint driven along a given curve: a constraint that moves, whose multiplier is the motor torque."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..errors import InputError, UserFunctionError

STEP = 1e-3  # s, of the difference quotients that stand in for missing derivatives


@dataclass(frozen=True, eq=False)
class Drive:
    """Drive a joint along q_joint = curve(t). Stands among the loops of a mechanism.

    Its multiplier is the motor torque that this takes, N·m (or N), positive along the joint's velocity.

    Parameters
    ----------
    name : str
    joint : str
        A joint of one degree of freedom.
    curve : callable
        ``curve(t)``, rad or m, twice differentiable.
    rate, acceleration : callable, optional
        Its derivatives. Without them, sixth-order differences over 1 ms, good to about 1e-12 and 1e-9 of the curve's
        size: the multipliers inherit that.
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

    rotates, moving = False, True

    def __init__(self, model, drive: Drive):
        self.loop = drive
        if drive.joint not in list(model.names)[1:]:
            raise InputError(f"drive {drive.name!r}: the model has no joint {drive.joint!r}")
        joint = model.getJointId(drive.joint)
        self._q, self._pair = model.idx_qs[joint], model.nqs[joint] == 2
        if model.nvs[joint] != 1:
            raise InputError(
                f"drive {drive.name!r}: joint {drive.joint!r} has {model.nvs[joint]} degrees of freedom; "
                "only joints with one can be driven"
            )
        self._J = np.zeros((1, model.nv))
        self._J[0, model.idx_vs[joint]] = 1.0

    def evaluate(self, data, q, t):
        """Φ and J."""
        target = self._call(self.loop.curve, t)
        if self._pair:  # the joint stores (cos, sin)
            c, s = q[self._q : self._q + 2]
            gap = np.arctan2(s * np.cos(target) - c * np.sin(target), c * np.cos(target) + s * np.sin(target))
        else:
            gap = q[self._q] - target
        return np.array([gap]), self._J.copy()

    def rate(self, t):
        """Φ_t."""
        if self.loop.rate is not None:
            return -np.array([self._call(self.loop.rate, t)])
        f = [self._call(self.loop.curve, t + i * STEP) for i in (-3, -2, -1, 1, 2, 3)]
        return -np.dot([-1, 9, -45, 45, -9, 1], f).reshape(1) / (60 * STEP)

    def acceleration_bias(self, data, t):
        """Φ_tt; J is constant."""
        if self.loop.acceleration is not None:
            return -np.array([self._call(self.loop.acceleration, t)])
        f = [self._call(self.loop.curve, t + i * STEP) for i in (-3, -2, -1, 0, 1, 2, 3)]
        return -np.dot([2, -27, 270, -490, 270, -27, 2], f).reshape(1) / (180 * STEP**2)

    def _call(self, function, t) -> float:
        try:
            return float(function(t))
        except Exception as error:
            raise UserFunctionError(f"the curve of drive {self.loop.name!r}", t, error) from error
