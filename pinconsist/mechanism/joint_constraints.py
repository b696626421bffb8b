"""Constraints on joint coordinates: a joint driven along a curve, and a joint that follows another one."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any, ClassVar

import numpy as np

from ..errors import InputError
from .breakpoints import NONE, Breakpoints, MovingCurve, TimeFunction, knots_of, time_function
from .checks import joint_index, name, number, numbers, put, put_checked, require_functions
from .curve import spline_of
from .motion import Motion, check_rate

TURN = math.tau
CHECKED_OVER = (1e-3, 1e-5, 1e-7, 1e-9)  # s, steps with which user-defined derivatives are checked


class Coordinate:
    """The coordinate of a joint with one degree of freedom, in any storage of Pinocchio; InputError for other joints.

    ``column`` is its index in v. ``period`` is 2π if the joint stores (cos, sin), so that its angle is known only up to
    whole turns, else None.
    """

    def __init__(self, model, joint: str, whose: str, purpose: str):
        index = joint_index(model, joint, whose)
        if model.nvs[index] != 1:
            raise InputError(
                f"{whose}: joint {joint!r} has {model.nvs[index]} degrees of freedom; only joints with one can be "
                f"{purpose}"
            )
        self.column, self._q = model.idx_vs[index], model.idx_qs[index]
        self.period = TURN if model.nqs[index] == 2 else None

    @property
    def place(self) -> tuple[int, int, int]:
        """Column of v, index in q and whether the angle wraps, for the compiled system."""
        return self.column, self._q, int(self.period is not None)

    def value(self, q) -> float:
        """The coordinate, rad or m; in (-π, π] if it wraps."""
        return float(q[self._q]) if self.period is None else math.atan2(q[self._q + 1], q[self._q])


class Rows:
    """The rows of one record on a model; by default they do not depend on time, and only Python evaluates them.

    ``turns`` marks the rows in rad, ``moving`` is True if Φ depends on time, ``steady`` is True if J does not.
    ``difference_step`` is the step of the difference quotients that replace J, or inf if J is exact. Subclasses also
    have ``hand_over(compiled)`` or, if only Python evaluates them, ``evaluate(q, t)``, which returns Φ and J, and
    ``acceleration_bias(t, q, v)``, which returns J̇ v and the terms from Φ's dependence on time.
    """

    moving, steady, difference_step = False, True, math.inf
    breakpoints: Breakpoints = NONE  # of the system
    turns: tuple[bool, ...] = (True,)  # a row of joint coordinates is not scaled

    def rate(self, t, q):
        """Φ_t."""
        return np.zeros(len(self.turns))

    def check_derivatives(self, t, q) -> None:
        """Raise InputError if user-defined derivatives contradict their functions."""

    def set_breakpoints(self, breakpoints) -> None:
        self.breakpoints = breakpoints

    def functions_of_time(self, q, v) -> list[TimeFunction]:
        """Φ as a function of time, at this configuration."""
        return []

    def hand_over(self, compiled) -> bool:
        """Add the rows to the compiled system; False if they must be evaluated in Python."""
        return False


class JointConstraint(ABC):
    """Base of constraints on joint coordinates, whose multiplier is the torque (or force) on the first of `joints`."""

    name: str

    @property
    @abstractmethod
    def joints(self) -> tuple[str, ...]:
        """The names of all its joints."""


@dataclass(frozen=True)
class Drive(JointConstraint):
    """Drive a joint along q_joint = curve(t); passed with the loops of a mechanism.

    Its multiplier is the motor torque that this requires, N·m (or N), positive along the joint's velocity.

    Parameters
    ----------
    name : str
    joint : str
        A joint of one degree of freedom.
    curve : callable or (times, values)
        ``curve(t)``, rad or m, twice differentiable between its knots; for instance a :class:`Motion`, which can be
        saved to a file. For a table, the curve is the cubic spline through its values with zero end velocities,
        constant before and after; its derivatives are exact. (Linear interpolation would require infinite torques. For
        another spline, pass one of SciPy, which has its own knots.)
    rate, acceleration : callable, optional
        Its derivatives. Default: the methods ``rate`` and ``acceleration`` of a curve that has them, as a Motion does;
        else differences over 1 ms, or less if the curve is faster, accurate to about 1e-12 and 1e-9 of the
        curve's size; the multipliers have the same error. User-defined derivatives are compared with the curve at the
        start of a run.
    knots : sequence of float
        Times, s, at which the curve's acceleration jumps, if known: steps end there, and finite differences do not
        extend across them. Otherwise the curve is sampled before a run, see :func:`simulate`.

    Raises
    ------
    InputError
        An argument that is not a name or not a function, a table whose times do not increase; on a model, an unknown
        joint or one with several degrees of freedom; a rate or an acceleration that contradicts the curve, numbers that
        are not finite.
    UserFunctionError
        One of the functions raised an exception.
    """

    name: str
    joint: str
    curve: Callable
    rate: Callable | None = None
    acceleration: Callable | None = None
    knots: Sequence[float] = ()

    kind: ClassVar[str] = "drive"
    rows: ClassVar[tuple[str, ...]] = ("motor",)

    def __post_init__(self):
        who = f"drive {self.name!r}"
        put_checked(self, who, name, "name", "joint")
        if isinstance(self.curve, list | tuple | np.ndarray | Real):
            put(self, curve=spline_of(self.curve, f"{who}: its curve"))
        require_functions(self, who, "time", "curve", optional=("rate", "acceleration"))
        put(self, knots=knots_of(self.knots, f"{who}: knots"))

    @property
    def joints(self) -> tuple[str, ...]:
        return (self.joint,)


def _curve_of(drive) -> MovingCurve:
    return MovingCurve(drive, "curve", f"drive {drive.name!r}", ("rate", "acceleration"), finite=True)


class DriveRow(Rows):
    """The row of a drive on a model: Φ = q_joint - curve(t)."""

    moving = True

    def __init__(self, model, drive: Drive):
        self.loop = drive
        self._joint = Coordinate(model, drive.joint, f"drive {drive.name!r}", "driven")
        self.period = self._joint.period
        self._curve = _curve_of(drive)

    def __copy__(self):
        fresh = object.__new__(DriveRow)
        vars(fresh).update(vars(self), _curve=_curve_of(self.loop))
        return fresh

    def set_breakpoints(self, breakpoints) -> None:
        self._curve.breakpoints = breakpoints

    def functions_of_time(self, q, v):
        drive = self.loop
        if type(drive.curve) is Motion and not drive.knots:
            return []
        return [time_function(drive.curve, self._curve.value, 2, drive.knots)]

    def rate(self, t, q):
        return np.array([-self._curve.rate(t)])

    def hand_over(self, compiled) -> bool:
        curve: Any = self.loop.curve
        if type(curve) is not Motion or self.loop.rate is not None:
            compiled.add_drive(self._joint.place, self.period or 0.0, self._curve)
        else:
            compiled.add_drive(self._joint.place, self.period or 0.0, curve.numbers)
        return True

    def check_derivatives(self, t, q) -> None:
        curves = {"curve": self._curve, **self._curve.derivatives}
        for field, of in ("rate", "curve"), ("acceleration", "rate"):
            if {field, of} <= curves.keys():
                what = f"drive {self.loop.name!r}: its {field}"
                check_rate(what, of, curves[of].value, curves[field].value, t, CHECKED_OVER)


@dataclass(frozen=True)
class Coupling(JointConstraint):
    """Couple two joints: q_joint = offset + ratio·q_other + Σ higher[i]·q_other^(i+2); passed with the loops.

    Its multiplier is the generalised force on `joint`, N·m (or N for a sliding joint), positive along the joint's
    velocity; `other` receives -dq_joint/dq_other times it. Each may be several joints, like those of a tendon or the
    sun, ring and carrier of a planetary gear: q is then Σ share·q, and each joint receives its share.

    Parameters
    ----------
    name : str
    joint, other : str or mapping
        Two joints of one degree of freedom, or joint → its share in the sum. For joints that store (cos, sin),
        Pinocchio's unbounded revolutes, the angle is known up to whole turns only, and the coupling then holds up to
        whole turns: the nearest turn is kept. If both joints are of that kind, the ratio must be an integer or the
        reciprocal of one. `higher` requires an `other` that counts its turns, such as a plain revolute; so does a sum.
    ratio : float
        dq_joint/dq_other, in rad or m per rad or m. For a pair of external gears, -teeth_other/teeth_joint.
    offset : float
        q_joint at q_other = 0, rad or m.
    higher : tuple of float
        Coefficients of the second and higher powers of q_other.

    Raises
    ------
    InputError
        An argument that is not a name or not a number, a joint coupled to itself.
    """

    name: str
    joint: str | Mapping[str, float]
    other: str | Mapping[str, float]
    ratio: float = 1.0
    offset: float = 0.0
    higher: tuple[float, ...] = ()

    kind: ClassVar[str] = "coupling"
    rows: ClassVar[tuple[str, ...]] = ("coupling",)

    def __post_init__(self):
        who = f"coupling {self.name!r}"
        put_checked(self, who, name, "name")
        for field in ("joint", "other"):
            given = getattr(self, field)
            if not isinstance(given, Mapping):
                put_checked(self, who, name, field)
                continue
            shares = {name(joint, who): number(share, f"{who}: {joint}") for joint, share in given.items()}
            if not shares or not all(shares.values()):
                raise InputError(f"{who}: {field} needs joints with shares that are not zero, got {given!r}")
            put(self, **{field: shares})
        if both := sorted(set.intersection(*map(set, self.shares))):
            raise InputError(f"{who}: joint {both[0]!r} cannot follow itself")
        put_checked(self, who, number, "ratio", "offset")
        put(self, higher=numbers(self.higher, f"{who}: higher"))

    @property
    def shares(self) -> tuple[dict[str, float], dict[str, float]]:
        """Joint → its share, of ``joint`` and of ``other``."""
        one, two = (dict(each) if isinstance(each, Mapping) else {each: 1.0} for each in (self.joint, self.other))
        return one, two

    @property
    def joints(self) -> tuple[str, ...]:
        return tuple(joint for shares in self.shares for joint in shares)


class _Sum:
    """Σ share · q of some joints of a model."""

    def __init__(self, model, shares, who):
        self.joints = [Coordinate(model, joint, who, "coupled") for joint in shares]
        self.shares = list(shares.values())
        self.period = self.joints[0].period if self.alone else None
        wraps = [joint for joint, each in zip(shares, self.joints, strict=True) if each.period]
        if wraps and not self.alone:
            raise InputError(
                f"{who}: joint {wraps[0]!r} stores cosine and sine, so that its share in a sum is not unique; make it "
                "a plain revolute joint, which counts its turns"
            )

    @property
    def alone(self) -> bool:
        """Whether this is the position of one joint."""
        return self.shares == [1.0]

    @property
    def places(self) -> list[tuple]:
        """The places of the joints, with their shares, for the compiled system."""
        return [(joint.place, share) for joint, share in zip(self.joints, self.shares, strict=True)]


class CouplingRow(Rows):
    """The row of a coupling on a model: Φ = q_joint - law(q_other)."""

    def __init__(self, model, coupling: Coupling):
        self.loop, who = coupling, f"coupling {coupling.name!r}"
        self._joint, self._other = (_Sum(model, shares, who) for shares in coupling.shares)
        self._law = (coupling.offset, coupling.ratio, *coupling.higher)
        self.period = self._common_period(coupling)

    def _common_period(self, coupling) -> float | None:
        """The period of Φ: adding it moves no body, as it stands for whole turns of the joints that wrap."""
        joint, other, ratio = self._joint, self._other, abs(coupling.ratio)
        if not other.period:
            return joint.period
        whole = 1.0 / ratio if 0.0 < ratio < 1.0 else ratio
        problem = "its powers are not unique" if any(coupling.higher) else ""
        if joint.period and abs(whole - round(whole)) > 1e-12 * whole:
            problem = problem or f"the ratio {coupling.ratio:g} is neither a whole number nor the reciprocal of one"
        if problem:
            raise InputError(
                f"coupling {coupling.name!r}: joint {coupling.other!r} stores cosine and sine, so that its angle is "
                f"known only up to whole turns, and {problem}; make it a plain revolute joint, which counts its turns"
            )
        return min((period for period in (joint.period, TURN * ratio) if period), default=None)

    def hand_over(self, compiled) -> bool:
        compiled.add_coupling(self._joint.places, self._other.places, self.period or 0.0, np.array(self._law))
        return True
