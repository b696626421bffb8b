"""The numbers of configurations and velocities: names, units, conversion of user input, and joint limits."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from math import cos, inf, sin, tau

import numpy as np
import pinocchio as pin

from ..errors import InputError
from .checks import ROTATION, finite_array, places

LIMIT_ROUNDING = 1e-9  # rad or m, beyond a limit


def position_names(model) -> list[str]:
    """A name for each number of a configuration: ``crank``, or ``ball[0]`` if the joint has several."""
    return _names(model, model.nqs)


def velocity_names(model) -> list[str]:
    """A name for each number of a velocity: ``crank``, or ``ball[0]`` if the joint has several."""
    return _names(model, model.nvs)


def body_names(model) -> list[str]:
    """A name for each joint's body, the ground first: that of its first link in the file, else that of the joint."""
    links: dict[int, str] = {}
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY:
            links.setdefault(frame.parentJoint, frame.name)
    return ["ground", *(links.get(joint, model.names[joint]) for joint in range(1, model.njoints))]


def _names(model, sizes):
    pairs = zip(list(model.names)[1:], list(sizes)[1:], strict=True)
    return [f"{joint}[{k}]" if size > 1 else joint for joint, size in pairs for k in range(size)]


def velocity_units(model) -> list[str]:
    """``rad`` or ``m`` for each number of a velocity, without "per second"."""
    neutral, units = pin.neutral(model), []
    for joint in list(model.joints)[1:]:
        data = joint.createData()
        joint.calc(data, neutral, np.zeros(model.nv))  # sets the axes of helical joints
        motions = np.reshape(data.S, (6, -1))
        units += ["rad" if turns else "m" for turns in np.abs(motions[3:]).max(axis=0) > 0.0]
    return units


def position_units(model) -> list[str]:
    """``rad``, ``m``, or empty (for quaternions, and for cosine and sine) for each number of a configuration."""
    of_velocities, units = velocity_units(model), []
    for i in range(1, model.njoints):
        own = of_velocities[places(model, i)[1]]
        shifts = [unit for unit in own if unit == "m"]
        units += own if model.nqs[i] == model.nvs[i] else shifts + [""] * (model.nqs[i] - len(shifts))
    return units


def by_joint(mechanism, numbers) -> dict:
    """Joint → its number, or list of numbers, in a configuration or a velocity."""
    model = mechanism.model
    shares = np.split(np.asarray(numbers), (model.idx_qs if len(numbers) == model.nq else model.idx_vs)[2:])
    return {
        joint: share.item() if share.size == 1 else share.tolist()
        for joint, share in zip(mechanism.joints, shares, strict=True)
    }


def filled(mechanism, values, full, velocity=False):
    """`full`, a configuration or velocity, with the `values` of some joints inserted; or `values`, if an array."""
    model, what = mechanism.model, "velocity" if velocity else "configuration"
    if not isinstance(values, Mapping):
        values = finite_array(values, what)
        if values.shape != full.shape:
            raise InputError(f"{what} needs shape {full.shape} for {mechanism.name!r}, got {values.shape}")
        return values
    for joint, value in values.items():
        i, of_joint = mechanism.joint_index(joint), f"{what} of joint {joint!r}"
        value = finite_array(value, of_joint).ravel() if velocity else _position(model, i, value, of_joint)
        part = full[places(model, i)[velocity]]
        if value.size != part.size:
            also = "" if velocity else _ALSO.get((model.nqs[i], model.nvs[i]), "")
            raise InputError(f"{of_joint} needs {part.size} number(s){also}, got {value.size}")
        part[:] = value
    return full


_ALSO = {
    (7, 6): ", or x, y, z and a rotation matrix, or x, y, z, roll, pitch, yaw, or a pin.SE3",
    (4, 3): ", or fewer: roll, pitch, yaw (for a planar joint x, y and an angle)",
}


def _position(model, i, value, what):
    """The numbers of a joint as stored in a configuration."""
    kind = model.nqs[i], model.nvs[i]
    if kind in ((7, 6), (4, 3)):
        if isinstance(value, pin.SE3):
            value = value.homogeneous
        elif hasattr(value, "__len__") and len(value) == 4 and np.shape(value[3]) == (3, 3):  # x, y, z, R
            value = np.block([[np.array(value[3]), np.reshape(value[:3], (3, 1))], [np.zeros((1, 3)), 1.0]])
    value = finite_array(value, what)
    if kind == (2, 1) and value.size == 1:  # Pinocchio's unbounded revolute: cosine, sine
        return np.array([cos(value.item()), sin(value.item())])
    if kind == (7, 6) and (value.shape == (4, 4) or value.size == 6):
        place, turn = (value[:3, 3], value[:3, :3]) if value.size == 16 else (value.ravel()[:3], value.ravel()[3:])
        return np.concatenate((place, _quaternion(turn, what)))
    if kind == (4, 3) and value.size in (3, 9):
        if model.joints[i].shortname() == "JointModelPlanar" and value.size == 3:
            x, y, angle = value.ravel()
            return np.array([x, y, cos(angle), sin(angle)])
        return _quaternion(value, what)
    return value.ravel()


def _quaternion(turn, what):
    """Pinocchio's quaternion of a rotation matrix, or of roll, pitch and yaw."""
    R = np.array(pin.rpy.rpyToMatrix(*turn.ravel())) if turn.size == 3 else turn.reshape(3, 3)
    if np.abs(R.T @ R - np.eye(3)).max() > ROTATION or np.linalg.det(R) < 0.0:
        raise InputError(f"{what}: its matrix is not a rotation")
    return pin.Quaternion(R).coeffs()


def is_revolute(joint) -> bool:
    """Whether a joint of a model turns about one axis."""
    return re.match("JointModelR(U?B?[XYZ]|evolute)", joint.shortname()) is not None


def joints_in(mechanism, variations) -> tuple[str, ...]:
    """The joints with a considerable share in any column of `variations`, (nv,) or (nv, n)."""
    share = np.abs(variations).reshape(mechanism.nv, -1)
    share = (share / np.maximum(share.max(axis=0), 1e-300)).max(axis=1)
    return tuple(joint for joint in mechanism.joints if share[mechanism.columns(joint)].max(initial=0.0) > 0.3)


@dataclass(frozen=True)
class BeyondLimit:
    """A joint that leaves its limits: the first time t, s, the value farthest out, and the limits, rad or m."""

    joint: str
    t: float
    value: float
    lower: float
    upper: float

    def __str__(self):
        limit = self.upper if self.value > self.upper else self.lower
        value = self.value if abs(self.value) > LIMIT_ROUNDING else 0.0
        return f"{self.joint} reaches {value:.4g} of {limit:.4g}, first at t = {self.t:.6g} s"


def beyond_limits(mechanism, t, q) -> tuple[BeyondLimit, ...]:
    """The joints that are outside their limits in some row; `t` (n,) are times and `q` (n, nq) configurations.

    Whole turns between the start of a joint and its limits are subtracted, but not turns that it makes afterwards. A
    coordinate of a joint with several is called ``joint[k]``; joints that store quaternions, or cosine and sine, have
    no such limits.
    """
    model, found = mechanism.model, []
    lower, upper, columns = model.lowerPositionLimit, model.upperPositionLimit, np.ascontiguousarray(q.T)
    ends = np.array([columns.min(axis=1), columns.max(axis=1)])
    bounded = np.isfinite(lower) & np.isfinite(upper)
    middle = np.add(lower, upper, where=bounded, out=np.zeros(model.nq)) / 2
    turns = np.where(bounded, tau * np.round((q[0] - middle) / tau), 0.0)
    outside = [(least < lower) | (most > upper) for least, most in (ends, ends - turns)]
    for at in np.flatnonzero((lower < upper) & (outside[0] | outside[1])):
        i = int(np.searchsorted(model.idx_qs, at, side="right")) - 1
        if model.nqs[i] != model.nvs[i]:
            continue
        low, high, values = float(lower[at]), float(upper[at]), q[:, at]
        if high - low < inf and model.joints[i].shortname().startswith("JointModelR"):
            values = values - tau * np.round((values[0] - (low + high) / 2) / tau)
        beyond = np.maximum(values - high, low - values)
        if (out := np.flatnonzero(beyond > LIMIT_ROUNDING)).size:
            value = float(values[np.argmax(beyond)])
            found.append(BeyondLimit(position_names(model)[at], float(t[out[0]]), value, low, high))
    return tuple(found)
