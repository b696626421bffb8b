"""Forces: what acts on a mechanism beside gravity and the loops.

============= ============================================================ ==========================================
record        law                                                          unit
============= ============================================================ ==========================================
JointDamping  τ = -d v                                                     N·m·s/rad or N·s/m
JointFriction τ = -f tanh(v / width)                                       N·m or N; width 0.01 rad/s or m/s
JointSpring   τ = -k (q_joint - rest)                                      N·m/rad or N/m
SpringDamper  tension k (l - l₀) + d dl/dt between two points              N/m, N·s/m
JointTorque   τ by joint name, constant or a function of time              N·m or N
Servo         τ = k (θ_d(t) - θ) + d (θ̇_d(t) - θ̇)                          N·m/rad, N·m·s/rad or N/m, N·s/m
Wrench        a force and a moment on a frame, in world or its own axes    N, N·m
Torque        τ = f(t, q, v), a user's function                            N·m or N
============= ============================================================ ==========================================

They are records in plain numbers, by the names of joints and frames; ``bind(model)`` makes what a system evaluates.
The equations are M v' + nle = τ + Jᵀλ, so that τ·v is the power that goes into the mechanism.
"""

from .force import Force, as_force, bound_forces, model_forces
from .joints import FRICTION_WIDTH, JointDamping, JointFriction, JointSpring, ViscousDamping
from .servo import Servo
from .springs import SpringDamper
from .torques import JointTorque, SteadyTorque, Torque
from .wrench import Wrench

__all__ = [
    "FRICTION_WIDTH",
    "Force",
    "JointDamping",
    "JointFriction",
    "JointSpring",
    "JointTorque",
    "Servo",
    "SpringDamper",
    "SteadyTorque",
    "Torque",
    "ViscousDamping",
    "Wrench",
    "as_force",
    "bound_forces",
    "model_forces",
]
