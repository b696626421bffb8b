"""Forces of joints: viscous damping, dry friction, springs, servos."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ...errors import InputError
from ..breakpoints import MovingCurve, time_function
from ..checks import (
    amounts,
    joint_index,
    name,
    number,
    numbers,
    places,
    put,
    put_checked,
    require_functions,
    spread,
)
from ..joint_constraints import Coordinate
from ..loops import unit
from ..motion import Motion
from .force import BoundForce, CompiledForce, ForceRecord, StoringForce


class _ViscousDamping(CompiledForce):
    smooth = True

    def __init__(self, damping, model):
        super().__init__(model)
        self._coefficients = spread(model, damping.coefficients, "JointDamping", alike=True)

    def hand_over(self, compiled) -> None:
        compiled.add_damping(self._coefficients)


@dataclass(frozen=True)
class JointDamping(ForceRecord):
    """Viscous damping τ = -d v, the `damping` of URDF joints.

    Parameters
    ----------
    coefficients : mapping or sequence of nv numbers
        Joint name → d ≥ 0, N·m·s/rad (or N·s/m); a single number applies to each velocity of its joint. Or one number
        for each of the nv joint velocities.

    Raises
    ------
    InputError
        Negative or invalid numbers; on a model, unknown joints and wrong sizes.
    """

    coefficients: Mapping[str, float | tuple] | tuple[float, ...]

    _kind, _acts_on, _law = "damping", "coefficients", _ViscousDamping

    def __post_init__(self):
        put(self, coefficients=amounts(self.coefficients, "JointDamping", least=0.0))


class _SmoothFriction(CompiledForce):
    def __init__(self, friction, model):
        super().__init__(model)
        self._coefficients = spread(model, friction.coefficients, "JointFriction", alike=True)
        self._width = friction.width
        self.widths = np.where(self._coefficients > 0.0, friction.width, np.inf)

    def hand_over(self, compiled) -> None:
        compiled.add_friction(self._coefficients, self._width)


@dataclass(frozen=True)
class JointFriction(ForceRecord):
    """Dry (Coulomb) friction, smoothed: τ = -f tanh(v / width), the `friction` of URDF joints.

    The smoothed law does not stick. A joint that dry friction would hold creeps at v = width·artanh(load / f): 0.11 mm
    in 10 s at 80 % of f and the default width. Velocities that are near zero are resolved to the width, whatever the
    tolerances; a smaller width, down to 1e-6, changes the number of steps little, but with BDF at tight tolerances
    Newton's iteration may fail where joints are released from rest. At a fixed step it fails where joints come to rest,
    unless the width is at least a third of the change of velocity that friction makes in a step.

    Parameters
    ----------
    coefficients : mapping or sequence of nv numbers
        Joint name → friction torque f ≥ 0, N·m (or N); a single number applies to each velocity of its joint. Or one
        number for each of the nv joint velocities.
    width : float
        Velocity at which friction reaches 76 % of its full value, rad/s (or m/s); 96 % at twice this velocity. The
        friction of files has the default.

    Raises
    ------
    InputError
        Negative or invalid numbers; on a model, unknown joints and wrong sizes.
    """

    coefficients: Mapping[str, float | tuple] | tuple[float, ...]
    width: float = 1e-5

    _kind, _acts_on, _law = "friction", "coefficients", _SmoothFriction

    def __post_init__(self):
        put(self, coefficients=amounts(self.coefficients, "JointFriction", least=0.0))
        put(self, width=number(self.width, "JointFriction: width", above=0.0))


class _BoundServo(CompiledForce):
    by_time = True

    def __init__(self, servo, model):
        super().__init__(model)
        self._servo = servo
        self._coordinate = Coordinate(model, servo.joint, servo._who, "servo-controlled")
        self._target = servo.target if callable(servo.target) else Motion(servo.target)
        if type(self._target) is not Motion or servo.rate is not None:
            self._target = MovingCurve(servo, "target", servo._who, ("rate",))
            self.curves.append(self._target)
        self.smooth = not self.curves

    def wanted(self, t) -> tuple[float, float]:
        """The target, and its rate if there is a damper."""
        return self._target(t), self._target.rate(t) if self._servo.damping else 0.0

    def functions_of_time(self, q, v):
        servo, found = self._servo, []
        for curve in self.curves:
            found.append(time_function(servo.target, curve.value, 1 if servo.damping else 0))  # its rate jumps, too
            if servo.damping and servo.rate is not None:
                found.append(time_function(servo.rate, curve.derivatives["rate"].value))
        return found

    def hand_over(self, compiled) -> None:
        servo, joint = self._servo, self._coordinate
        target = self._target if self.curves else self._target.numbers
        compiled.add_servo(joint.place, joint.period or 0.0, target, servo.stiffness, servo.damping)


class _BoundSpring(StoringForce):
    smooth = True

    def __init__(self, spring, model):
        super().__init__(model)
        self._spring, self._coordinate = spring, Coordinate(model, spring.joint, spring._who, "sprung")

    def hand_over(self, compiled) -> None:
        spring, joint = self._spring, self._coordinate
        compiled.add_joint_spring(joint.place, joint.period or 0.0, spring.rest, spring.stiffness, spring.damping)


class _BoundSum(BoundForce):
    """A spring of a sum of joints, or one that is slack between two lengths."""

    stores = True

    def __init__(self, spring, model):
        shares = spring.joint if isinstance(spring.joint, Mapping) else {spring.joint: 1.0}
        self._joints = [Coordinate(model, joint, spring._who, "sprung") for joint in shares]
        if any(joint.period for joint in self._joints):
            raise InputError(f"{spring._who}: a joint that stores cosine and sine has no unique share in a sum")
        self._columns, self._shares = [joint.column for joint in self._joints], np.array(list(shares.values()))
        rest = spring.rest if isinstance(spring.rest, tuple) else (spring.rest, spring.rest)
        self._lower, self._upper = rest
        self._stiffness, self._damping = spring.stiffness, spring.damping
        self.smooth = self._lower == self._upper

    def _deflection(self, q) -> float:
        length = self._shares.dot([joint.value(q) for joint in self._joints])
        return max(length - self._upper, 0.0) + min(length - self._lower, 0.0)

    def torque(self, t, q, v):
        tau = np.zeros(len(v))
        rate = self._shares.dot(v[self._columns])
        tau[self._columns] = -self._shares * (self._stiffness * self._deflection(q) + self._damping * rate)
        return tau

    def derivatives(self, t, q, v):
        by_q, by_v = np.zeros((2, len(v), len(v)))
        places, squares = np.ix_(self._columns, self._columns), np.outer(self._shares, self._shares)
        if self.smooth or self._deflection(q):
            by_q[places] = -self._stiffness * squares
        by_v[places] = -self._damping * squares
        return by_q, by_v if self._damping else None

    def stored(self, q, v) -> tuple[float, float]:
        deflection = self._deflection(q)
        load = self._stiffness * deflection
        return 0.5 * load * deflection, load * self._shares.dot(v[self._columns])


class _BoundBall(BoundForce):
    """A spring of a ball, τ = -k log(rest⁻¹ q), or of a free joint, also with -k times its displacement."""

    smooth = stores = True

    def __init__(self, spring, model):
        i = joint_index(model, spring.joint, spring._who)
        self._model, (self._q, self._v) = model, places(model, i)
        size = model.nqs[i]
        rest = spring.rest if isinstance(spring.rest, tuple) else ()
        if not rest and not spring.rest:
            rest = (*[0.0] * (size - 4), 0.0, 0.0, 0.0, 1.0)
        if len(rest) != size:
            raise InputError(f"{spring._who}: rest needs {size} numbers, those of the joint in q; got {spring.rest!r}")
        self._at, self._turn = np.array(rest[:-4]), pin.Quaternion(unit(rest[-4:])).toRotationMatrix()
        self._stiffness, self._damping = spring.stiffness, spring.damping

    def _deflection(self, q):
        """The rotation from the rest, its vector, and the displacement in the axes of the body."""
        own = q[self._q]
        rotation = pin.Quaternion(own[-4:]).toRotationMatrix()
        turn = self._turn.T @ rotation
        move = rotation.T @ (own[:-4] - self._at) if len(self._at) else np.zeros(0)
        return turn, np.concatenate((move, pin.log3(turn)))

    def torque(self, t, q, v):
        tau = np.zeros(len(v))
        tau[self._v] = -self._stiffness * self._deflection(q)[1] - self._damping * v[self._v]
        return tau

    def derivatives(self, t, q, v):
        by_q, by_v = np.zeros((2, len(v), len(v)))
        turn, deflection = self._deflection(q)
        own = np.zeros((len(deflection), len(deflection)))
        own[-3:, -3:] = pin.Jlog3(turn)
        if len(self._at):
            own[:3, :3], own[:3, 3:] = np.eye(3), pin.skew(deflection[:3])
        by_q[self._v, self._v] = -self._stiffness * own
        by_v[self._v, self._v] = -self._damping * np.eye(len(deflection))
        return by_q, by_v if self._damping else None

    def stored(self, q, v) -> tuple[float, float]:
        deflection = self._deflection(q)[1]
        return 0.5 * self._stiffness * deflection @ deflection, self._stiffness * deflection @ v[self._v]


_RESTS = (2, 4, 7)  # numbers of a slack spring, of a ball and of a free joint


def _bound_spring(spring, model):
    if isinstance(spring.joint, Mapping):
        return _BoundSum(spring, model)
    turns = model.joints[joint_index(model, spring.joint, spring._who)].shortname()
    if turns in ("JointModelSpherical", "JointModelFreeFlyer"):
        return _BoundBall(spring, model)
    return (_BoundSum if isinstance(spring.rest, tuple) else _BoundSpring)(spring, model)


@dataclass(frozen=True)
class JointSpring(ForceRecord):
    """A linear spring and damper in a joint, τ = -k (q_joint - rest) - d q̇_joint.

    Parameters
    ----------
    joint : str or mapping
        A joint with one degree of freedom, a ball or a free joint; or joint → its share in a length Σ share·q on which
        the spring acts, as for a tendon. If a joint stores (cos, sin), as Pinocchio's unbounded revolute joints do,
        full turns are not counted: the deflection is then the shorter way round, within half a turn. For a ball τ is -k
        times the rotation vector from the rest position.
    stiffness : float
        k, N·m/rad (or N/m).
    rest : float or tuple of float
        Position of the unloaded spring, rad (or m); two positions, between which it is slack; or the coordinates of a
        ball or free joint in q, a quaternion x, y, z, w last.
    damping : float
        d ≥ 0, N·m·s/rad (or N·s/m).

    Raises
    ------
    InputError
        Invalid numbers; on a model, an unknown joint, or a joint with several degrees of freedom other than these.
    """

    joint: str | Mapping[str, float]
    stiffness: float
    rest: float | tuple[float, ...] = 0.0
    damping: float = 0.0

    _kind, _acts_on, _law = "spring", "joint", staticmethod(_bound_spring)
    _who = property(lambda self: f"joint spring {', '.join(map(repr, self._named))}")
    _named = property(lambda self: [self.joint] if isinstance(self.joint, str) else list(self.joint))

    @property
    def plain(self) -> bool:
        """Whether it is a spring of one joint, with one position and without a damper."""
        return isinstance(self.joint, str) and isinstance(self.rest, float) and not self.damping

    def __post_init__(self):
        if isinstance(self.joint, Mapping):
            who = "JointSpring"
            shares = {name(joint, who): number(share, f"{who}: {joint}") for joint, share in self.joint.items()}
            if not shares:
                raise InputError("JointSpring: joint needs a joint, or joints with their shares")
            put(self, joint=shares)
        else:
            put_checked(self, "JointSpring", name, "joint")
        put_checked(self, self._who, number, "stiffness")
        put_checked(self, self._who, number, "damping", least=0.0)
        if isinstance(self.rest, (tuple, list, np.ndarray)):
            rest = numbers(self.rest, f"{self._who}: rest")
            if len(rest) not in _RESTS:
                raise InputError(f"{self._who}: rest must be a number, two, or those of a ball in q; got {self.rest!r}")
            if len(rest) == 2 and rest[0] > rest[1]:
                raise InputError(f"{self._who}: of two positions the lower one is first, got {rest}")
            put(self, rest=rest)
        else:
            put_checked(self, self._who, number, "rest")


@dataclass(frozen=True)
class Servo(ForceRecord):
    """PD control of a joint: τ = k (θ_d(t) - θ) + d (θ̇_d(t) - θ̇).

    A servo deflects under load; a :class:`Drive` follows its curve exactly, whatever torque this requires.

    Parameters
    ----------
    joint : str
        A joint of one degree of freedom. If it stores (cos, sin), as Pinocchio's unbounded revolute joints do, it
        turns to the target the shorter way round.
    target : float or callable
        θ_d: a number, or a function of time such as a :class:`Motion`, rad (or m).
    stiffness : float
        k, N·m/rad (or N/m).
    damping : float
        d, N·m·s/rad (or N·s/m).
    rate : callable, optional
        θ̇_d as a function of time. Default: the method ``rate`` of the target if it has one, as a Motion does, else
        sixth-order differences over 1 ms, or less if the target is faster, accurate to about 1e-12.

    Raises
    ------
    InputError
        Invalid numbers, negative gains; on a model, an unknown joint or one with several degrees of freedom.
    UserFunctionError
        The target or its rate raised an exception.
    """

    joint: str
    target: float | Callable
    stiffness: float
    damping: float = 0.0
    rate: Callable | None = None

    _kind, _acts_on, _law = "servo", "joint", _BoundServo
    _who = property(lambda self: f"servo {self.joint!r}")

    def __post_init__(self):
        put_checked(self, "Servo", name, "joint")
        if not callable(self.target):
            put(self, target=number(self.target, f"{self._who}: target"))
            if self.rate is not None:
                raise InputError(
                    f"{self._who}: a rate requires a target that is a function of time, got {self.target!r}"
                )
        require_functions(self, self._who, "time", optional=("rate",))
        put_checked(self, self._who, number, "stiffness", "damping", least=0.0)
