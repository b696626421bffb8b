"""Forces of joints: viscous damping, dry friction, springs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..checks import amounts, name, number, put, spread
from ..constraints.coordinate import Coordinate, nearest
from ..constraints.motion import Motion
from .label import label
from .record import ForceRecord

FRICTION_WIDTH = 1e-2
"""Velocity over which dry friction changes sign, rad/s or m/s."""
TURN = 2.0 * np.pi


@dataclass(frozen=True)
class JointDamping(ForceRecord):
    """Viscous damping τ = -d v, the `damping` of URDF joints.

    Parameters
    ----------
    coefficients : mapping or sequence of nv numbers
        d ≥ 0 of joints by name, N·m·s/rad (or N·s/m); one number counts for each velocity of its joint. Or of every
        joint velocity.

    Raises
    ------
    InputError
        Negative or impossible numbers; on a model, unknown joints and wrong sizes.
    """

    coefficients: Mapping[str, float | tuple] | tuple[float, ...]

    def __post_init__(self):
        put(self, coefficients=amounts(self.coefficients, "JointDamping", least=0.0))

    @property
    def label(self) -> str:
        """By what name energy reports and messages speak of it."""
        return label("damping", self.coefficients)

    def bind(self, model) -> ViscousDamping:
        return ViscousDamping(spread(model, self.coefficients, "JointDamping", alike=True))


class ViscousDamping:
    """JointDamping on a model; systems add up several of them."""

    def __init__(self, coefficients):
        self.coefficients, self._by_v = coefficients, -np.diag(coefficients)

    def torque(self, t, q, v):
        return -self.coefficients * v

    def derivatives(self, t, q, v):
        return None, self._by_v

    def hand_over(self, twin) -> bool:
        """Tell the compiled twin of this law."""
        twin.add_damping(self.coefficients)
        return True


@dataclass(frozen=True)
class JointFriction(ForceRecord):
    """Dry (Coulomb) friction, smoothed: τ = -f tanh(v / width), the `friction` of URDF joints.

    At rest the smoothed law creeps: |v| stays below width·artanh(load / f).

    Parameters
    ----------
    coefficients : mapping or sequence of nv numbers
        Friction torque f ≥ 0 of joints by name, N·m (or N); one number counts for each velocity of its joint. Or of
        every joint velocity.
    width : float
        Velocity at which friction has 76 % of its full size, rad/s (or m/s); 96 % at twice that.

    Raises
    ------
    InputError
        Negative or impossible numbers; on a model, unknown joints and wrong sizes.
    """

    coefficients: Mapping[str, float | tuple] | tuple[float, ...]
    width: float = FRICTION_WIDTH

    def __post_init__(self):
        put(self, coefficients=amounts(self.coefficients, "JointFriction", least=0.0))
        put(self, width=number(self.width, "JointFriction: width", above=0.0))

    @property
    def label(self) -> str:
        """By what name energy reports and messages speak of it."""
        return label("friction", self.coefficients)

    def bind(self, model) -> SmoothFriction:
        return SmoothFriction(spread(model, self.coefficients, "JointFriction", alike=True), self.width)


class SmoothFriction:
    """JointFriction on a model."""

    def __init__(self, coefficients, width):
        self.coefficients, self.width = coefficients, width

    def torque(self, t, q, v):
        return -self.coefficients * np.tanh(v / self.width)

    def derivatives(self, t, q, v):
        sech = 1.0 / np.cosh(np.minimum(np.abs(v) / self.width, 300.0))
        return None, np.diag(-self.coefficients * sech**2 / self.width)

    def hand_over(self, twin) -> bool:
        """Tell the compiled twin of this law."""
        twin.add_friction(self.coefficients, self.width)
        return True


@dataclass(frozen=True)
class JointSpring(ForceRecord):
    """A linear spring in a joint, τ = -k (q_joint - rest).

    Parameters
    ----------
    joint : str
        A joint of one degree of freedom. Where it stores (cos, sin), as Pinocchio's unbounded revolute joints do, its
        turns are not counted: the deflection is then the shorter way round, within half a turn.
    stiffness : float
        k, N·m/rad (or N/m).
    rest : float
        Where the spring is slack, rad (or m).

    Raises
    ------
    InputError
        Impossible numbers; on a model, a joint that is not there or has several degrees of freedom.
    """

    joint: str
    stiffness: float
    rest: float = 0.0

    def __post_init__(self):
        who = f"joint spring {name(self.joint, 'JointSpring: joint')!r}"
        put(self, stiffness=number(self.stiffness, f"{who}: stiffness"), rest=number(self.rest, f"{who}: rest"))

    @property
    def label(self) -> str:
        """By what name energy reports and messages speak of it."""
        return f"spring {self.joint}"

    def bind(self, model) -> _BoundJointSpring:
        return _BoundJointSpring(self, model)


class _BoundJointSpring:
    """A JointSpring on a model."""

    def __init__(self, spring, model):
        self._spring, self._nv = spring, model.nv
        self._coordinate = Coordinate(model, spring.joint, f"joint spring {spring.joint!r}", "sprung")
        self._period = TURN if self._coordinate.wraps else None
        self._by_q = np.zeros((model.nv, model.nv))
        self._by_q[self._coordinate.column, self._coordinate.column] = -spring.stiffness

    def _deflection(self, q):
        return nearest(self._coordinate.value(q) - self._spring.rest, self._period)

    def torque(self, t, q, v):
        tau = np.zeros(self._nv)
        tau[self._coordinate.column] = -self._spring.stiffness * self._deflection(q)
        return tau

    def derivatives(self, t, q, v):
        return self._by_q, None

    def hand_over(self, twin) -> bool:
        """Tell the compiled twin of this law: a servo that holds one place."""
        held = Motion(self._spring.rest).numbers
        twin.add_servo(self._coordinate.place, self._period or 0.0, held, self._spring.stiffness, 0.0)
        return True

    def stored(self, q, v) -> tuple[float, float]:
        """Elastic energy, J, and its rate, W."""
        deflection = self._deflection(q)
        load = self._spring.stiffness * deflection
        return 0.5 * load * deflection, load * v[self._coordinate.column]
