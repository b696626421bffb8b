"""Forces: what acts on a mechanism besides gravity and the loops.

============= ============================================================ ==========================================
record        law                                                          unit
============= ============================================================ ==========================================
JointDamping  τ = -d v                                                     N·m·s/rad or N·s/m
JointFriction τ = -f tanh(v / width)                                       N·m or N; width 0.01 rad/s or m/s
JointSpring   τ = -k (q_joint - rest)                                      N·m/rad or N/m
SpringDamper  tension k (l - l₀) + d dl/dt between two points              N/m, N·s/m
JointTorque   τ by joint name, constant or a function of time              N·m or N
Servo         τ = k (θ_d(t) - θ) + d (θ̇_d(t) - θ̇)                          N·m/rad, N·m·s/rad or N/m, N·s/m
Actuator      τ = gear f, f affine in its command, position and velocity   N·m or N
Wrench        a force and a moment on a frame, in world or its own axes    N, N·m
HeldTorque    τ of a table, each held until the next                       N·m or N
Sampled       τ = law(t, q, v) once a period, held until the next time     N·m or N
Torque        τ = f(t, q, v), a user's function                            N·m or N
============= ============================================================ ==========================================

They are records in plain numbers, by the names of joints and frames; ``bind(model)`` makes what a system evaluates.
The equations are M v' + nle = τ + Jᵀλ, so that τ·v is the power that goes into the mechanism.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ...errors import InputError
from .actuators import Actuator
from .bodies import SpringDamper, Wrench
from .force import BoundForce, Force, JointTorque, Torque, UserForce, unused
from .held import HeldTorque, Sampled
from .joints import JointDamping, JointFriction, JointSpring, Servo

__all__ = [
    "Actuator", "Force", "HeldTorque", "JointDamping", "JointFriction", "JointSpring", "JointTorque", "Sampled",
    "Servo", "SpringDamper", "Torque", "Wrench", "as_force", "bound_forces", "model_forces", "unused",
]  # fmt: skip


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
    friction = getattr(model, "upperDryFrictionLimit", model.friction)
    own = (JointDamping, model.damping), (JointFriction, friction)
    return tuple(record(coefficients) for record, coefficients in own if np.any(coefficients))


def bound_forces(model, forces) -> dict[str, Force]:
    """The model's own forces and the given ones, ready to be evaluated, under different labels; InputError by them."""
    bound: dict[str, Force] = {}
    for force in (*model_forces(model), *forces):
        label = unused(getattr(force, "label", "") or type(force).__name__, bound)
        force = force.bind(model) if hasattr(force, "bind") else force
        bound[label] = force if isinstance(force, Torque | BoundForce) else UserForce(force, label)
    return bound
