"""Drag and lift of bodies in a fluid that is at rest or a steady wind, as MuJoCo has them."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np
import pinocchio as pin

from ...errors import InputError
from ..axes import SMOOTH
from ..checks import frame_of, name, number, numbers, put_checked, triple
from ..lie import integrate
from ..motion import first
from .bodies import ZERO
from .force import BoundForce, ForceRecord
from .points import points_of


class _BoundDrag(BoundForce):
    def __init__(self, drag, model):
        frame = frame_of(model, drag.frame, drag._who)
        self._model, self._points, self._joint = model, points_of(model), frame.parentJoint
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
        self._points.move(q)
        J = pin.getJointJacobian(self._points.model, self._points.data, self._joint, pin.LOCAL).reshape(6, -1)
        J = self._place.toActionMatrixInverse() @ J
        pose = self._points.data.oMi[self._joint] * self._place
        speed = J @ v
        speed[:3] -= pose.rotation.T @ self._wind
        return speed, J, pose

    def torque(self, t, q, v):
        speed, J, _ = self._motion(q, v)
        return J.T @ self._load(speed)

    def _load(self, speed):
        return -(self._linear + self._squared * np.abs(speed)) * speed

    def _load_rate(self, speed):
        """The derivative of the load by the speed, (6, 6)."""
        return -np.diag(self._linear + 2.0 * self._squared * np.abs(speed))

    def derivatives(self, t, q, v):
        """∂τ/∂v exact, ∂τ/∂q by differences."""
        speed, J, _ = self._motion(q, v)
        by_q, moving = np.zeros((len(v), len(v))), np.flatnonzero(J.any(axis=0))
        for column in moving:
            unit = np.arange(len(v)) == column
            by_q[:, column] = first(lambda s, e=unit: self.torque(t, integrate(self._model, q, s * e), v), SMOOTH)
        return by_q, J.T @ self._load_rate(speed) @ J

    def loads(self, t, q, v):
        speed, _, pose = self._motion(q, v)
        load = self._load(speed)
        return [(self._joint, pose.translation, pose.rotation @ load[:3], pose.rotation @ load[3:])]


class _BoundEllipsoid(_BoundDrag):
    def __init__(self, drag, model):
        super().__init__(drag, model)
        self.smooth = not drag.density
        self._axes, self._density, self._viscosity = np.array(drag.sizes), drag.density, drag.viscosity
        self._coefficients = drag.coefficients
        low, middle, high = np.sort(self._axes)
        self._volume, self._largest_area = 4.0 / 3.0 * pi * low * middle * high, pi * high * middle
        others = [np.delete(self._axes, i).max() for i in range(3)]
        self._turns = 8.0 / 15.0 * pi * self._axes * np.array(others) ** 4
        self._largest_turn = 8.0 / 15.0 * pi * middle * high**4
        self._added = drag.density * np.array(drag.added)

    def _load(self, speed):
        """Added mass (without its part of accelerations), quadratic and viscous drag, Magnus and Kutta lift."""
        v, w = speed[:3], speed[3:]
        blunt, slender, angular, kutta, magnus = self._coefficients
        fast, mean = np.sqrt(v @ v), 2.0 / 3.0 * self._axes.sum()
        face = (np.prod(self._axes) / self._axes) ** 2  # squared products of the two other axes
        numerator, denominator = face @ v**2, face**2 @ v**2
        area = pi * np.sqrt(denominator / (numerator if abs(numerator) > TINY else TINY))
        momentum, spin = self._added[:3] * v, self._added[3:] * w
        force = np.cross(momentum, w) + magnus * self._density * self._volume * np.cross(w, v)
        projected = fast * denominator
        cosine = numerator / (projected if abs(projected) > TINY else TINY)
        force += kutta * self._density * cosine * area * np.cross(np.cross(face * v, v), v)
        shape = blunt * area + slender * (self._largest_area - area)
        force -= (3.0 * pi * mean * self._viscosity + self._density * fast * shape) * v
        turning = w * (angular * self._turns + slender * (self._largest_turn - self._turns))
        moment = np.cross(momentum, v) + np.cross(spin, w)
        moment -= (pi * mean**3 * self._viscosity + self._density * np.sqrt(turning @ turning)) * w
        return np.concatenate((force, moment))

    def _load_rate(self, speed):
        """By a complex step, which is exact to rounding."""
        return np.column_stack([self._load(speed + 1j * TINY * unit).imag / TINY for unit in np.eye(6)])


TINY = 1e-15
"""What MuJoCo divides by where a body is at rest in the fluid."""


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


@dataclass(frozen=True)
class FluidEllipsoid(FluidDrag):
    """Drag, lift and added mass of an ellipsoid in a fluid: MuJoCo's ellipsoid model.

    Parameters
    ----------
    sizes : tuple of 3 float
        Half the axes, m.
    coefficients : tuple of 5 float
        Of blunt, slender and angular drag, Kutta lift and Magnus lift.
    added : tuple of 6 float
        Added mass and inertia of a fluid of density 1, m³ and m⁵. As in MuJoCo, its accelerations exert no force.
    """

    coefficients: tuple[float, ...] = (0.5, 0.25, 1.5, 1.0, 1.0)
    added: tuple[float, ...] = (0.0,) * 6

    _kind, _law = "ellipsoid drag", _BoundEllipsoid
    _who = property(lambda self: f"drag of an ellipsoid on {self.frame!r}")

    def __post_init__(self):
        super().__post_init__()
        put_checked(self, self._who, numbers, "coefficients", "added", least=0.0)
        for field, count in (("coefficients", 5), ("added", 6)):
            if len(getattr(self, field)) != count:
                raise InputError(f"{self._who}: {field} needs {count} numbers, got {getattr(self, field)!r}")
