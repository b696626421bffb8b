"""A joint driven along a given curve: a constraint that moves, whose multiplier is the motor torque."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite
from typing import ClassVar

import numpy as np

from ...errors import InputError, PinconsistError
from ..checks import called, require_functions, require_names
from .coordinate import Coordinate, nearest
from .differences import first, is_slope, second
from .motion import Motion

STEP = 1e-3  # s, of the difference quotients that stand in for missing derivatives
CHECKED_OVER = (1e-3, 1e-5, 1e-7, 1e-9)  # s, steps over which given derivatives are compared with their function


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
        inherit that. Given ones are compared with the curve where a run starts.

    Raises
    ------
    InputError
        Names or functions that are none; on a model, a joint that is not there or has several degrees of freedom; a
        rate or an acceleration that contradicts the curve, numbers that are not finite.
    UserFunctionError
        One of the functions raised an exception.
    """

    name: str
    joint: str
    curve: Callable
    rate: Callable | None = None
    acceleration: Callable | None = None

    kind: ClassVar[str] = "drive"
    rows: ClassVar[tuple[str, ...]] = ("motor",)

    def __post_init__(self):
        who = f"drive {self.name!r}"
        require_names(self, who, "name", "joint")
        require_functions(self, who, "time", "curve", optional=("rate", "acceleration"))


class DriveRow:
    """The row of a drive on a model."""

    moving, steady, turns = True, True, (True,)  # a row in rad or m: measured by its own joint

    def __init__(self, model, drive: Drive):
        self.loop = drive
        self._joint = Coordinate(model, drive.joint, f"drive {drive.name!r}", "driven")
        self._period = 2.0 * np.pi if self._joint.wraps else None
        given = {
            "curve": drive.curve,
            "rate": drive.rate or getattr(drive.curve, "rate", None),
            "acceleration": drive.acceleration or getattr(drive.curve, "acceleration", None),
        }
        self._motion = {
            field: (lambda t, function=function: float(function(t)), f"the {field} of drive {drive.name!r}")
            for field, function in given.items()
            if function is not None
        }
        self._J = np.zeros((1, model.nv))
        self._J[0, self._joint.column] = 1.0

    def evaluate(self, data, q, t):
        """Φ and J."""
        gap = self._joint.value(q) - self._call("curve", t)
        return np.array([nearest(gap, self._period)]), self._J.copy()

    def rate(self, t, q):
        """Φ_t."""
        if "rate" in self._motion:
            return -np.array([self._call("rate", t)])
        return -first(lambda s: self._call("curve", t + s), STEP).reshape(1)

    def acceleration_bias(self, data, t, q, v):
        """Φ_tt; J is constant."""
        if "acceleration" in self._motion:
            return -np.array([self._call("acceleration", t)])
        return -second(lambda s: self._call("curve", t + s), STEP).reshape(1)

    def hand_over(self, twin) -> bool:
        """Tell the compiled twin of the row; False where it has to ask Python."""
        curve = self.loop.curve
        if type(curve) is not Motion or self.loop.rate is not None:
            return False
        twin.add_drive(self._joint.place, self._period or 0.0, curve.numbers)
        return True

    def check_derivatives(self, t, q) -> None:
        """Raise InputError where a given rate is not that of the curve, or an acceleration not that of the rate."""
        for name, of in ("rate", "curve"), ("acceleration", "rate"):
            if name not in self._motion or of not in self._motion:
                continue
            slope = self._call(name, t)
            try:
                right = is_slope(slope, lambda s, of=of: self._call(of, t + s), CHECKED_OVER)
            except PinconsistError:  # it need not be defined beyond the span
                continue
            if not right:
                raise InputError(
                    f"drive {self.loop.name!r}: its {name} is {slope:.6g} at t = {t:.6g}, which is not how its {of} "
                    "changes there. Correct it, or leave it out: differences then stand in"
                )

    def _call(self, field, t) -> float:
        function, what = self._motion[field]
        value = called(function, what, t)
        if not isfinite(value):
            raise InputError(f"{what} is {value} at t = {t:.6g}; it must be finite")
        return value
