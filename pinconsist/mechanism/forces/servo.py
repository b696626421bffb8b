"""A joint servo: proportional and derivative feedback to a trajectory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...errors import InputError
from ..checks import name, number, put, require_functions, returned
from ..constraints.coordinate import Coordinate, nearest
from ..constraints.differences import first
from ..constraints.motion import Motion
from .record import ForceRecord

TURN = 2.0 * np.pi
STEP = 1e-3  # s, of the differences that stand in for a missing rate


@dataclass(frozen=True)
class Servo(ForceRecord):
    """PD control of a joint: τ = k (θ_d(t) - θ) + d (θ̇_d(t) - θ̇).

    A servo gives way and forces nothing exactly; a :class:`Drive` holds its curve whatever torque that takes.

    Parameters
    ----------
    joint : str
        A joint of one degree of freedom. Where it stores (cos, sin), as Pinocchio's unbounded revolute joints do, it
        turns to the target the shorter way round.
    target : float or callable
        θ_d: a number, or a function of time such as a :class:`Motion`, rad (or m).
    stiffness : float
        k, N·m/rad (or N/m).
    damping : float
        d, N·m·s/rad (or N·s/m).
    rate : callable, optional
        θ̇_d as a function of time. Default: the target's own ``rate`` where it has one, as a Motion does, else
        sixth-order differences over 1 ms, good to about 1e-12.

    Raises
    ------
    InputError
        Impossible numbers, negative gains; on a model, a joint that is not there or has several degrees of freedom.
    UserFunctionError
        The target or its rate raised an exception.
    """

    joint: str
    target: float | Callable
    stiffness: float
    damping: float = 0.0
    rate: Callable | None = None

    def __post_init__(self):
        who = f"servo {name(self.joint, 'Servo: joint')!r}"
        if not callable(self.target):
            put(self, target=number(self.target, f"{who}: target"))
            if self.rate is not None:
                raise InputError(f"{who}: a rate goes with a target that is a function of time, not {self.target!r}")
        require_functions(self, who, "time", optional=("rate",))
        for field in ("stiffness", "damping"):
            put(self, **{field: number(getattr(self, field), f"{who}: {field}", least=0.0)})

    @property
    def label(self) -> str:
        """By what name energy reports and messages speak of it."""
        return f"servo {self.joint}"

    def bind(self, model) -> _BoundServo:
        return _BoundServo(self, model)


class _BoundServo:
    """A Servo on a model."""

    def __init__(self, servo, model):
        self._servo, self._nv, who = servo, model.nv, f"servo {servo.joint!r}"
        self._coordinate = Coordinate(model, servo.joint, who, "servo-controlled")
        self._period = TURN if self._coordinate.wraps else None
        self._target, self._rate = f"the target of {who}", f"the rate of {who}"
        i = self._coordinate.column
        self._by_q, self._by_v = np.zeros((2, model.nv, model.nv))
        self._by_q[i, i], self._by_v[i, i] = -servo.stiffness, -servo.damping

    def torque(self, t, q, v):
        servo, i = self._servo, self._coordinate.column
        target, rate = self._wanted(t)
        lag = -nearest(self._coordinate.value(q) - target, self._period)
        tau = np.zeros(self._nv)
        tau[i] = servo.stiffness * lag + servo.damping * (rate - v[i])
        return tau

    def derivatives(self, t, q, v):
        return self._by_q, self._by_v

    def hand_over(self, twin) -> bool:
        """Tell the compiled twin of this law; False where it has to ask Python."""
        servo, target = self._servo, self._servo.target
        motion = target if callable(target) else Motion(target)
        own = type(motion) is Motion and servo.rate is None
        if own:
            twin.add_servo(self._coordinate.place, self._period or 0.0, motion.numbers, servo.stiffness, servo.damping)
        return own

    def _wanted(self, t) -> tuple[float, float]:
        """θ_d and θ̇_d."""
        target = self._servo.target
        if not callable(target):
            return target, 0.0
        here = float(returned(target, self._target, (), t))
        if not self._servo.damping:
            return here, 0.0
        rate = self._servo.rate or getattr(target, "rate", None)
        if rate is not None:
            return here, float(returned(rate, self._rate, (), t))
        return here, float(first(lambda s: returned(target, self._target, (), t + s), STEP))
