"""A motion to be followed: the law that all simulators get, torques of the true dynamics and a PD law around them."""

from __future__ import annotations

from collections.abc import Mapping
from math import pi

import numpy as np

from ..errors import FormatError, InputError
from ..mechanism.assembly import assemble
from ..mechanism.checks import near, places
from ..mechanism.curve import spline_of
from ..mechanism.forces import JointTorque, Servo
from ..mechanism.joint_constraints import Drive
from ..mechanism.system import MechanismSystem
from ..run.simulation import simulate
from .log import columns_of
from .reference import even_times

FREQUENCY = 10.0  # Hz, of the PD law, which is critically damped
RTOL = 1e-8


def following(mechanism, motion, span, assembly):
    """The mechanism with the law of a motion (joint → curve or table) in addition to its forces, and its start."""
    if not isinstance(motion, Mapping) or not motion:
        raise InputError(f"motion= needs a mapping joint → function of time or table (times, values), got {motion!r}")
    curves = {joint: _curve(mechanism, joint, curve) for joint, curve in motion.items()}
    driven = mechanism.add_loops(*(Drive(_name(mechanism, joint), joint, curve) for joint, curve in curves.items()))
    start = _with(mechanism, assembly.q, {joint: float(curve(span[0])) for joint, curve in curves.items()})
    sol = simulate(driven, span, start, rtol=RTOL, atol=RTOL)
    if not sol.success:
        raise InputError(f"{mechanism.name}: the joints cannot follow the motion: {sol.message}")
    rows = sol.at(even_times(span))
    forces = []
    for joint, curve in curves.items():
        torque = _Torque(rows.t, rows.torque(_name(mechanism, joint)))
        inertia = felt_inertia(mechanism, joint, rows.q[0], span[0])
        w = 2 * pi * FREQUENCY
        forces += [JointTorque({joint: torque.curve}), Servo(joint, curve, inertia * w**2, 2 * inertia * w)]
    followed = mechanism.add_forces(*forces)
    return followed, assemble(followed, rows.q[0], rows.v[0], t=span[0])


def motion_of(file, mechanism) -> dict:
    """Joint → table (times, values) of a CSV file whose columns are ``t`` and positions of joints, as in a log."""
    columns = columns_of(file)
    times = columns.pop("t", columns.pop("time", None))
    if times is None:
        raise FormatError("there is no column of times, t", path=file)
    found = {}
    for name, values in columns.items():
        joint = name.removeprefix("q.")
        if joint not in mechanism.joints:
            reason = f"{mechanism.name} has no joint {joint!r}{near(joint, mechanism.joints)}"
            raise FormatError(reason, path=file, element=f"column {name!r}")
        found[joint] = times, values
    return found


def without_drives(mechanism, motion):
    """The mechanism without its drives, and `motion` with their curves."""
    drives = [loop for loop in mechanism.loops if isinstance(loop, Drive)]
    if not drives:
        return mechanism, motion
    curves = {drive.joint: drive.curve for drive in drives} | dict(motion or {})
    return mechanism.with_loops(*(loop for loop in mechanism.loops if not isinstance(loop, Drive))), curves


class _Torque:
    """A cubic spline through torques at times, with its knots known to a run."""

    def __init__(self, times, values):
        from scipy.interpolate import CubicSpline

        self.curve = CubicSpline(times, values)


def _curve(mechanism, joint, curve):
    mechanism.joint_index(joint)
    return curve if callable(curve) else spline_of(curve, f"the motion of joint {joint!r}")


def _name(mechanism, joint) -> str:
    taken, name = {loop.name for loop in mechanism.loops}, f"motion of {joint}"
    while name in taken:
        name += "_"
    return name


def _with(mechanism, q, values):
    """A configuration with the given values of some joints of one degree of freedom."""
    q = q.copy()
    for joint, value in values.items():
        part = places(mechanism.model, mechanism.joint_index(joint))[0]
        q[part] = [value] if part.stop - part.start == 1 else [np.cos(value), np.sin(value)]
    return q


def felt_inertia(mechanism, joint, q, t=0.0) -> float:
    """The inertia that a torque on a joint feels through the loops, kg·m² or kg: torque by acceleration."""
    from ..engine.index1 import Index1

    system, still = MechanismSystem(mechanism.with_forces(), q, t), np.zeros(mechanism.nv)
    pushed = MechanismSystem(mechanism.with_forces({joint: 1.0}), q, t)
    column = mechanism.columns(joint)
    gained = (Index1(pushed).acceleration(t, q, still)[0] - Index1(system).acceleration(t, q, still)[0])[column]
    if not gained[0] > 0.0:
        raise InputError(f"{mechanism.name}: a torque on joint {joint!r} moves nothing: the loops hold it")
    return float(1.0 / gained[0])
