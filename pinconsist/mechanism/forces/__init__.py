"""Forces on a mechanism, in addition to gravity and the loop forces.

============= ============================================================ ==========================================
record        law                                                          unit
============= ============================================================ ==========================================
JointDamping  τ = -d v                                                     N·m·s/rad or N·s/m
JointFriction τ = -f tanh(v / width)                                       N·m or N; width 1e-5 rad/s or m/s
JointSpring   τ = -k (q_joint - rest) - d v                                N·m/rad, N·m·s/rad or N/m, N·s/m
SpringDamper  tension k (l - l₀) + d dl/dt between two points              N/m, N·s/m
Bushing       -(k y + d ẏ) in six coordinates y between two frames         N/m, N·m/rad; N·s/m, N·m·s/rad
JointTorque   τ by joint name, constant or a function of time              N·m or N
Servo         τ = k (θ_d(t) - θ) + d (θ̇_d(t) - θ̇)                          N·m/rad, N·m·s/rad or N/m, N·s/m
Actuator      τ = gear f, f affine in its command, position and velocity   N·m or N
Wrench        a force and a moment on a frame, in world or its own axes    N, N·m
HeldTorque    τ from a table, held until the next time, or linear          N·m or N
Sampled       τ = law(t, q, v) once per period, held until the next        N·m or N
Torque        τ = f(t, q, v), a user-defined function                      N·m or N
Piecewise     any of these, with the times at which it jumps
============= ============================================================ ==========================================

They are records of plain numbers that refer to joints and frames by name; ``bind(model)`` returns the object that a
system evaluates. The equations are M v' + nle = τ + Jᵀλ, so that τ·v is the power supplied to the mechanism.
"""

from .actuators import Actuator
from .bodies import Bushing, SpringDamper, Wrench
from .fluids import FluidDrag, FluidEllipsoid
from .force import BoundForce, Force, JointTorque, Torque, as_force, bound_force, label_of, unused
from .held import HeldTorque, Sampled
from .joints import JointDamping, JointFriction, JointSpring, Servo
from .piecewise import Piecewise
from .points import shared_points

__all__ = [
    "Actuator", "Bushing", "FluidDrag", "FluidEllipsoid", "Force", "HeldTorque", "JointDamping", "JointFriction",
    "JointSpring", "JointTorque", "Piecewise", "Sampled", "Servo", "SpringDamper", "Torque", "Wrench", "as_force",
    "bound_forces", "model_forces", "unused",
]  # fmt: skip


def model_forces(model) -> tuple[JointDamping | JointFriction, ...]:
    """The forces of the model itself: damping and dry friction of its joints, unless they are zero."""
    own = (JointDamping, model.damping), (JointFriction, model.upperDryFrictionLimit)
    return tuple(record(coefficients) for record, coefficients in own if coefficients.any())


def bound_forces(model, forces) -> dict[str, BoundForce]:
    """The model's own forces and the given ones, bound to the model, by unique labels; passes on their InputErrors."""
    bound: dict[str, BoundForce] = {}
    with shared_points():
        for force in (*model_forces(model), *forces):
            label = unused(label_of(force), bound)
            bound[label] = bound_force(model, force, label)
    return bound
