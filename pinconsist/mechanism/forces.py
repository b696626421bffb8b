"""Forces: joint damping and friction, torque laws. Each gives τ(t, q, v) and, where it can, its derivatives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..errors import InputError, UserFunctionError

FRICTION_WIDTH = 1e-2
"""Velocity over which dry friction changes sign, rad/s or m/s."""


class Force(Protocol):
    """What acts on the joints: generalised torque τ, shape (nv,), N·m (or N).

    A force that needs the model's kinematics has instead a method ``bind(model)`` that returns such an object.
    """

    def torque(self, t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """τ at a state."""

    def derivatives(self, t: float, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray | None, np.ndarray | None]:
        """(∂τ/∂q, ∂τ/∂v), each (nv, nv) in the tangent space, or None where it is zero or small."""


@dataclass(frozen=True, eq=False)
class JointDamping:
    """Viscous damping τ = -d v, the `damping` of URDF joints.

    Parameters
    ----------
    coefficients : ndarray
        d per joint velocity, N·m·s/rad (or N·s/m), shape (nv,).
    """

    coefficients: np.ndarray

    def __post_init__(self):
        _set_numbers(self, "coefficients")

    def torque(self, t, q, v):
        return -self.coefficients * v

    def derivatives(self, t, q, v):
        return None, -np.diag(self.coefficients)


@dataclass(frozen=True, eq=False)
class JointFriction:
    """Dry (Coulomb) friction, smoothed: τ = -f tanh(v / width), the `friction` of URDF joints.

    At rest the smoothed law creeps: |v| stays below width·artanh(load / f).

    Parameters
    ----------
    coefficients : ndarray
        Friction torque f per joint, N·m (or N), shape (nv,).
    width : float
        Velocity over which the sign changes, rad/s (or m/s).
    """

    coefficients: np.ndarray
    width: float = FRICTION_WIDTH

    def __post_init__(self):
        _set_numbers(self, "coefficients")
        if not (np.isscalar(self.width) and self.width > 0):
            raise InputError(f"the width of JointFriction must be positive, got {self.width!r}")

    def torque(self, t, q, v):
        return -self.coefficients * np.tanh(v / self.width)

    def derivatives(self, t, q, v):
        sech = 1.0 / np.cosh(np.minimum(np.abs(v) / self.width, 300.0))
        return None, np.diag(-self.coefficients * sech**2 / self.width)


@dataclass(frozen=True, eq=False)
class ConstantTorque:
    """Constant joint torques.

    Parameters
    ----------
    value : ndarray
        τ, N·m (or N), shape (nv,).
    """

    value: np.ndarray

    def __post_init__(self):
        _set_numbers(self, "value")

    def torque(self, t, q, v):
        return self.value

    def derivatives(self, t, q, v):
        return None, None


@dataclass(frozen=True, eq=False)
class Torque:
    """A user's own law τ = f(t, q, v).

    Parameters
    ----------
    function : callable
        ``f(t, q, v) -> array (nv,)``; called with read-only arrays.
    gradient : callable, optional
        ``g(t, q, v) -> (∂τ/∂q, ∂τ/∂v)`` in the tangent space, either may be None. Without it the velocity part is
        taken by finite differences, and the position part is left out of Newton's matrix (never of the residual).
    """

    function: Callable
    gradient: Callable | None = None

    def torque(self, t, q, v):
        try:
            value = self.function(t, _read_only(q), _read_only(v))
        except Exception as error:
            raise UserFunctionError(f"the torque function {_name(self.function)}", t, error) from error
        try:
            value = np.asarray(value)
            if value.dtype.kind == "c":
                raise TypeError("complex numbers")
            value = value.astype(float, copy=False)
        except (TypeError, ValueError) as error:
            raise InputError(f"the torque function {_name(self.function)} returned no numbers: {error}") from None
        if value.shape != v.shape:
            raise InputError(
                f"the torque function {_name(self.function)} returned shape {value.shape} at t = {t:.6g}; "
                f"it must return {v.shape}, one number for each joint velocity"
            )
        return value

    def derivatives(self, t, q, v):
        if self.gradient is not None:
            return self._given_gradient(t, q, v)
        at = self.torque(t, q, v)
        columns = np.empty((len(v), len(v)))
        for i, step in enumerate(1e-7 * (1.0 + np.abs(v))):
            moved = v.copy()
            moved[i] += step
            columns[:, i] = (self.torque(t, q, moved) - at) / step
        return None, columns

    def _given_gradient(self, t, q, v):
        nv = len(v)
        try:
            by_q, by_v = self.gradient(t, _read_only(q), _read_only(v))
        except (TypeError, ValueError) as error:
            raise InputError(f"the gradient {_name(self.gradient)} failed at t = {t:.6g}: {error}") from error
        for part in (by_q, by_v):
            if part is not None and np.shape(part) != (nv, nv):
                raise InputError(
                    f"the gradient {_name(self.gradient)} returned shape {np.shape(part)} at t = {t:.6g}; it must "
                    f"return two matrices of shape {(nv, nv)}, or None for either"
                )
        return by_q, by_v


def as_force(force, nv: int) -> Force:
    """A Force from what a user may give: a Force, an array of constant torques, or a callable."""
    if not (hasattr(force, "bind") or (hasattr(force, "torque") and hasattr(force, "derivatives"))):
        force = Torque(force) if callable(force) else ConstantTorque(force)
    numbers = {ConstantTorque: "value", JointDamping: "coefficients", JointFriction: "coefficients"}.get(type(force))
    if numbers and (shape := getattr(force, numbers).shape) != (nv,):
        raise InputError(f"{type(force).__name__} needs {nv} numbers, one for each joint velocity; got shape {shape}")
    return force


def _set_numbers(force, name):
    """Replace a field of a force by a read-only float array."""
    given = getattr(force, name)
    try:
        array = np.array(given, dtype=float)
    except (TypeError, ValueError):
        what = "a force must be a Force, an array or a callable f(t, q, v)"
        raise InputError(f"{what}; {type(force).__name__}.{name} cannot be {given!r}") from None
    if not np.isfinite(array).all():
        raise InputError(f"{type(force).__name__}.{name} has a number that is not finite")
    array.setflags(write=False)
    object.__setattr__(force, name, array)


def model_forces(model) -> tuple[Force, ...]:
    """The forces a model carries itself: its joints' damping and dry friction, where they are not zero."""
    forces: list[Force] = []
    if np.any(model.damping):
        forces.append(JointDamping(np.array(model.damping)))
    friction = np.array(getattr(model, "upperDryFrictionLimit", model.friction))
    if np.any(friction):
        forces.append(JointFriction(friction))
    return tuple(forces)


def _read_only(array):
    view = array.view()
    view.flags.writeable = False
    return view


def _name(function) -> str:
    return getattr(function, "__qualname__", None) or repr(function)
