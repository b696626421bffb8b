"""One joint that follows another by a fixed law: gears, racks, mimic joints, MJCF's joint equality."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ...errors import InputError
from ..checks import require_names
from .coordinate import Coordinate, nearest

TURN = 2.0 * math.pi


@dataclass(frozen=True)
class Coupling:
    """Couple two joints: q_joint = offset + ratio·q_other + Σ higher[i]·q_other^(i+2). Stands among the loops.

    Its multiplier is the generalised force on `joint`, N·m (or N for a sliding joint), positive along the joint's
    velocity; `other` receives -dq_joint/dq_other times it.

    Parameters
    ----------
    name : str
    joint, other : str
        Two joints of one degree of freedom. Joints that store (cos, sin), Pinocchio's unbounded revolutes, know their
        angle up to whole turns only, and the coupling then holds up to whole turns: it keeps the turn that it is
        nearest to. Where both are of that kind the ratio must be a whole number or one over it; `higher` needs an
        `other` that counts its turns (a plain revolute does).
    ratio : float
        dq_joint/dq_other, in rad or m per rad or m. For a pair of external gears -teeth_other/teeth_joint.
    offset : float
        q_joint where q_other is zero, rad or m.
    higher : tuple of float
        Coefficients of the second and higher powers of q_other.

    Raises
    ------
    InputError
        Names or numbers that are none, a joint coupled to itself.
    """

    name: str
    joint: str
    other: str
    ratio: float = 1.0
    offset: float = 0.0
    higher: tuple[float, ...] = ()

    kind: ClassVar[str] = "coupling"
    rows: ClassVar[tuple[str, ...]] = ("coupling",)

    def __post_init__(self):
        require_names(self, f"coupling {self.name!r}", "name", "joint", "other")
        if self.joint == self.other:
            raise InputError(f"coupling {self.name!r}: joint {self.joint!r} cannot follow itself")
        for field in ("ratio", "offset"):
            object.__setattr__(self, field, self._number(getattr(self, field), field))
        if isinstance(self.higher, str) or not hasattr(self.higher, "__iter__"):
            raise InputError(f"coupling {self.name!r}: higher needs a sequence of numbers, got {self.higher!r}")
        object.__setattr__(self, "higher", tuple(self._number(value, "higher") for value in self.higher))

    def _number(self, value, field) -> float:
        try:
            number = float("nan") if isinstance(value, str | bool) else float(value)
        except (TypeError, ValueError):
            number = math.nan
        if not math.isfinite(number):
            raise InputError(f"coupling {self.name!r}: {field} needs a finite number, got {value!r}")
        return number


class CouplingRow:
    """The row of a coupling on a model: Φ = q_joint - law(q_other)."""

    moving, steady, turns = False, True, (True,)  # a row in rad or m: measured by its own joint

    def __init__(self, model, coupling: Coupling):
        self.loop = coupling
        whose = f"coupling {coupling.name!r}"
        self._joint = Coordinate(model, coupling.joint, whose, "coupled")
        self._other = Coordinate(model, coupling.other, whose, "coupled")
        self._law = (coupling.offset, coupling.ratio, *coupling.higher)
        self._slope, self._bend = _derivative(self._law), _derivative(_derivative(self._law))
        self._period = self._common_period(coupling)
        self._linear = not any(coupling.higher)
        self._J = np.zeros((1, model.nv))
        self._J[0, [self._joint.column, self._other.column]] = 1.0, -coupling.ratio

    def _common_period(self, coupling) -> float | None:
        """What may be added to Φ without changing any body's place: whole turns of the joints that wrap."""
        joint, other, ratio = self._joint, self._other, abs(coupling.ratio)
        if not other.wraps:
            return TURN if joint.wraps else None
        if any(coupling.higher):
            raise InputError(
                f"coupling {coupling.name!r}: joint {coupling.other!r} stores cosine and sine, so that its angle is "
                "known up to whole turns only, and its powers are not known at all; make it a plain revolute joint, "
                "which counts its turns"
            )
        if joint.wraps and not (_is_whole(ratio) or _is_whole(1.0 / ratio)):
            raise InputError(
                f"coupling {coupling.name!r}: joints {coupling.joint!r} and {coupling.other!r} store cosine and sine, "
                f"so that their angles are known up to whole turns only; a ratio of {coupling.ratio:g} needs more "
                "(a whole number or one over it would do): make one of them a plain revolute joint, which counts its "
                "turns"
            )
        period = TURN * ratio
        if not period:
            return TURN if joint.wraps else None
        return min(TURN, period) if joint.wraps else period

    def evaluate(self, data, q, t):
        """Φ and J."""
        other = self._other.value(q)
        J = self._J.copy()
        if not self._linear:
            J[0, self._other.column] = -_horner(self._slope, other)
        return np.array([nearest(self._joint.value(q) - _horner(self._law, other), self._period)]), J

    def hand_over(self, twin) -> bool:
        """Tell the compiled twin of the row."""
        twin.add_coupling(self._joint.place, self._other.place, self._period or 0.0, np.array(self._law))
        return True

    def rate(self, t, q):
        """Φ_t."""
        return np.zeros(1)

    def acceleration_bias(self, data, t, q, v):
        """J̇ v."""
        return np.array([-_horner(self._bend, self._other.value(q)) * v[self._other.column] ** 2])


def _horner(coefficients, x: float) -> float:
    """Σ coefficients[i] xⁱ."""
    total = 0.0
    for coefficient in reversed(coefficients):
        total = total * x + coefficient
    return total


def _derivative(coefficients) -> tuple:
    return tuple(i * coefficient for i, coefficient in enumerate(coefficients))[1:]


def _is_whole(number: float) -> bool:
    return abs(number - round(number)) <= 1e-12 * number
