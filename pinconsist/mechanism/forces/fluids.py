"""Drag of bodies in a fluid that is at rest or a steady wind, as MuJoCo has it."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np
import pinocchio as pin

from ..axes import SMOOTH
from ..checks import frame_of, name, number, put_checked, triple
from ..lie import integrate
from ..motion import first
from .bodies import ZERO
from .force import BoundForce, ForceRecord


class _BoundDrag(BoundForce):
    def __init__(self, drag, model):
        frame = frame_of(model, drag.frame, drag._who)
        self._model, self._data, self._joint = model, model.createData(), frame.parentJoint
        own = pin.SE3(pin.rpy.rpyToMatrix(*drag.rpy), np.array(drag.xyz))
        self._place, self._wind = frame.placement * own, np.array(drag.wind)
        a, b, c = drag.sizes
        mean = (a + b + c) / 3.0
        self._linear = drag.viscosity * np.array([3.0 * pi * mean] * 3 + [pi * mean**3] * 3)
        areas, turns = (b * c, a * c, a * b), (a * (b**4 + c**4), b * (a**4 + c**4), c * (a**4 + b**4))
        self._squared = drag.density * np.array([0.5 * area for area in areas] + [turn / 64.0 for turn in turns])
        self.smooth = not self._squared.any()

    def _motion(self, q, v):
        """The velocity relative to the fluid, (6,), and its Jacobian, in the axes of the body's box; its pose."""
        pin.computeJointJacobians(self._model, self._data, q)
        J = pin.getJointJacobian(self._model, self._data, self._joint, pin.LOCAL).reshape(6, -1)
        J = self._place.toActionMatrixInverse() @ J
        pose = self._data.oMi[self._joint] * self._place
        speed = J @ v
        speed[:3] -= pose.rotation.T @ self._wind
        return speed, J, pose

    def torque(self, t, q, v):
        speed, J, _ = self._motion(q, v)
        return J.T @ self._load(speed)

    def _load(self, speed):
        return -(self._linear + self._squared * np.abs(speed)) * speed

    def derivatives(self, t, q, v):
        """∂τ/∂v exact, ∂τ/∂q by differences."""
        speed, J, _ = self._motion(q, v)
        by_q, moving = np.zeros((len(v), len(v))), np.flatnonzero(J.any(axis=0))
        for column in moving:
            unit = np.arange(len(v)) == column
            by_q[:, column] = first(lambda s, e=unit: self.torque(t, integrate(self._model, q, s * e), v), SMOOTH)
        return by_q, -J.T @ ((self._linear + 2.0 * self._squared * np.abs(speed))[:, None] * J)

    def loads(self, t, q, v):
        speed, _, pose = self._motion(q, v)
        load = self._load(speed)
        return [(self._joint, pose.translation, pose.rotation @ load[:3], pose.rotation @ load[3:])]


@dataclass(frozen=True)
class FluidDrag(ForceRecord):
    """The drag of a body in a fluid, that of a box: MuJoCo's model of the inertia box.

    Parameters
    ----------
    frame : str
        A frame of the body.
    sizes : tuple of 3 float
        Of the box, m.
    density, viscosity : float
        Of the fluid, kg/m³ and Pa·s.
    wind : tuple of 3 float
        Velocity of the fluid in world axes, m/s.
    xyz, rpy : tuple of 3 float
        Centre and axes of the box in the frame.
    """

    frame: str
    sizes: tuple[float, float, float]
    density: float = 0.0
    viscosity: float = 0.0
    wind: tuple[float, float, float] = ZERO
    xyz: tuple[float, float, float] = ZERO
    rpy: tuple[float, float, float] = ZERO

    _kind, _acts_on, _law = "drag", "frame", _BoundDrag
    _who = property(lambda self: f"drag of {self.frame!r}")

    def __post_init__(self):
        put_checked(self, "FluidDrag", name, "frame")
        put_checked(self, self._who, triple, "sizes", "wind", "xyz", "rpy")
        put_checked(self, self._who, number, "density", "viscosity", least=0.0)
