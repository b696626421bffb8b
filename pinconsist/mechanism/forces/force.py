"""What a force is, what users may give for one, and the forces of a model together."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from ...errors import InputError
from .joints import JointDamping, JointFriction
from .label import unused
from .torques import Checked, JointTorque, Torque


class Force(Protocol):
    """What acts on the joints: generalised torque τ, shape (nv,), N·m (or N).

    A force that needs to know the model has instead a method ``bind(model)`` that returns such an object. It may also
    have a ``label``, by which reports speak of it, and a method ``stored(q, v) -> (energy, rate)``, J and W, for the
    part of it that is elastic.
    """

    def torque(self, t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """τ at a state."""

    def derivatives(self, t: float, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray | None, np.ndarray | None]:
        """(∂τ/∂q, ∂τ/∂v), each (nv, nv) in the tangent space, or None where it is zero or small."""


def as_force(force) -> Any:
    """A force from what a user may give: a Force, joint torques by name or as an array, or a callable f(t, q, v)."""
    if isinstance(force, type):
        raise InputError(f"a force must be an object, not the class {force.__name__}: give {force.__name__}(…)")
    if hasattr(force, "bind") or (hasattr(force, "torque") and hasattr(force, "derivatives")):
        return force
    if isinstance(force, Mapping):
        return JointTorque(force)
    if callable(force):
        return Torque(force)
    if isinstance(force, str | bytes) or np.ndim(force) != 1:
        raise InputError(
            "a force must be a Force, a mapping joint → torque, an array of joint torques or a callable f(t, q, v), "
            f"got {force!r}"
        )
    return JointTorque(force)


def model_forces(model) -> tuple[JointDamping | JointFriction, ...]:
    """The forces a model carries itself: its joints' damping and dry friction, where they are not zero."""
    forces: list[JointDamping | JointFriction] = []
    if np.any(model.damping):
        forces.append(JointDamping(model.damping))
    friction = getattr(model, "upperDryFrictionLimit", model.friction)
    if np.any(friction):
        forces.append(JointFriction(friction))
    return tuple(forces)


def bound_forces(model, forces) -> dict[str, Force]:
    """The model's own forces and the given ones, ready to be evaluated, under different labels.

    Raises
    ------
    InputError
        Joints or frames that the model does not have, wrong sizes.
    """
    bound: dict[str, Force] = {}
    for force in (*model_forces(model), *forces):
        label = unused(getattr(force, "label", "") or type(force).__name__, bound)
        force = force.bind(model) if hasattr(force, "bind") else force
        bound[label] = force if isinstance(force, Torque) or hasattr(force, "hand_over") else Checked(force, label)
    return bound
