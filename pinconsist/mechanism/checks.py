"""Checks that the records of forces, loops and motions share: of fields, of models and their names, of functions."""

import difflib
import os
import sys
import warnings
from collections.abc import Mapping
from math import atan2, inf, isfinite

import numpy as np
import pinocchio as pin

from ..errors import InputError, UserFunctionError

UNIT = 1e-9  # how far from unit length an orientation may be
ROTATION = 1e-6  # how far from the unit matrix RᵀR of a placement may be


def put(record, **values) -> None:
    """Set fields of a frozen record."""
    for name, value in values.items():
        object.__setattr__(record, name, value)


def number(value, what: str, least: float = -inf, above: float = -inf) -> float:
    """A finite float from what a user gave, at least `least` and greater than `above`; else InputError."""
    try:
        if isinstance(value, str | bytes | bool | np.bool_) or _ndim(value):
            raise TypeError
        result = float(value)
    except (TypeError, ValueError):
        raise InputError(f"{what} must be a number, got {value!r}") from None
    if not isfinite(result):
        raise InputError(f"{what} has a number that is not finite: {value!r}")
    if result < least or result <= above:
        bound = f"at least {least:g}" if result < least else f"greater than {above:g}"
        raise InputError(f"{what} must be {bound}, got {result:g}")
    return result


def put_checked(record, who: str, check, *fields: str, **bounds) -> None:
    """Replace fields of a record by what a check returns of them: :func:`number`, :func:`triple` or :func:`name`."""
    for field in fields:
        put(record, **{field: check(getattr(record, field), f"{who}: {field}", **bounds)})


def numbers(values, what: str, least: float = -inf) -> tuple[float, ...]:
    """A tuple of finite floats from a sequence of numbers; else InputError."""
    if isinstance(values, str | bytes | Mapping) or _ndim(values) != 1:
        raise InputError(f"{what} must be a sequence of numbers, got {values!r}")
    return tuple(number(each, what, least) for each in values)


def triple(values, what: str) -> tuple[float, float, float]:
    """Three finite floats; else InputError."""
    result = numbers(values, what)
    if len(result) != 3:
        raise InputError(f"{what} needs three numbers, got {values!r}")
    return result


def finite_array(value, what: str) -> np.ndarray:
    """A float array copied from user input, or InputError."""
    if isinstance(value, float) and isfinite(value):  # most often
        return np.array(value, dtype=float)
    try:
        if np.asarray(value).dtype.kind not in "biufO":  # numpy would read "0.1" and drop imaginary parts
            raise TypeError
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{what}: expected numbers, got {value!r}") from None
    if not np.isfinite(array).all():
        raise InputError(f"{what} has a number that is not finite (NaN or infinity)")
    return array


def several(values) -> tuple:
    """The values of an argument that may also be given as one."""
    alone = isinstance(values, str | os.PathLike) or not hasattr(values, "__iter__")
    return (values,) if alone else tuple(values)


def name(value, what: str) -> str:
    """The name of a joint or frame; else InputError."""
    if not isinstance(value, str) or not value:
        raise InputError(f"{what} must be a name, got {value!r}")
    return value


def require_functions(record, who: str, of: str, *fields: str, optional: tuple[str, ...] = ()) -> None:
    """Raise InputError where one of these fields is not a function `of` its arguments; the `optional` may be None."""
    for field in (*fields, *optional):
        given = getattr(record, field)
        if not (callable(given) or (given is None and field in optional)):
            raise InputError(f"{who}: {field} must be a function of {of}, got {given!r}")


def amounts(values, what: str, least: float = -inf, functions: bool = False):
    """Joint name → number, or → one number for each of its velocities; or a tuple of numbers for the whole velocity.

    With `functions`, a function of time may stand for a joint's numbers.
    """
    if not isinstance(values, Mapping):
        return numbers(values, what, least)
    checked = {}
    for joint, value in values.items():
        of_joint = f"{what} of joint {name(joint, f'{what}: a joint')!r}"
        if not (functions and callable(value)):
            value = number(value, of_joint, least) if _ndim(value) == 0 else numbers(value, of_joint, least)
        checked[joint] = value
    return checked


def spread(model, values, what: str, alike: bool = False) -> np.ndarray:
    """`amounts` on a model, shape (nv,); with `alike` one number counts for each velocity of its joint."""
    if not isinstance(values, Mapping):
        if len(values) != model.nv:
            raise InputError(
                f"{what} needs {model.nv} numbers, one for each joint velocity; got shape ({len(values)},)"
            )
        return np.array(values)
    full = np.zeros(model.nv)
    for joint, value in values.items():
        part = full[columns(model, joint, what)]
        if not (np.size(value) == part.size or (alike and np.ndim(value) == 0)):
            raise InputError(f"{what}: joint {joint!r} needs {part.size} number(s), got {np.size(value)}")
        part[:] = value
    return full


def near(name, names) -> str:
    """``"; near it: …"`` for the end of a message, with up to four of `names`; empty where nothing resembles."""
    found = difflib.get_close_matches(str(name), sorted(set(names)), n=4, cutoff=0.5)
    return f"; near it: {', '.join(found)}" if found else ""


def joint_index(model, joint: str, what: str) -> int:
    """The index of a joint; InputError with similar names where the model has none of this name."""
    i = model.getJointId(joint) if isinstance(joint, str) else 0
    if not 0 < i < model.njoints:
        raise InputError(f"{what}: the model has no joint {joint!r}{near(joint, list(model.names)[1:])}")
    return i


def places(model, i: int) -> tuple[slice, slice]:
    """Where the numbers of joint `i` stand in a configuration, and in a velocity."""
    q, v = model.idx_qs[i], model.idx_vs[i]
    return slice(q, q + model.nqs[i]), slice(v, v + model.nvs[i])


def columns(model, joint: str, what: str) -> slice:
    """The columns of a joint in v; InputError as by :func:`joint_index`."""
    return places(model, joint_index(model, joint, what))[1]


def coordinates(model, joint: str, q) -> tuple[float, ...]:
    """The numbers of a joint in a configuration as ``Mechanism.configuration`` takes them, one angle for (cos, sin)."""
    i = model.getJointId(joint)
    part = tuple(q[places(model, i)[0]].tolist())
    return (atan2(part[1], part[0]),) if len(part) == 2 and model.nvs[i] == 1 else part


def frame_of(model, frame: str, what: str):
    """The frame of a name; InputError where there is none, or several."""
    names = [each.name for each in model.frames]
    if frame not in names:
        raise InputError(f"{what}: the model has no frame {frame!r}{near(frame, names)}")
    if names.count(frame) > 1:
        raise InputError(
            f"{what}: the name {frame!r} belongs to a link and to a joint that is elsewhere; rename one of them"
        )
    return model.frames[model.getFrameId(frame)]


def checked_model(model: pin.Model) -> pin.Model:
    """A copy in which each joint is a frame, unless one has its name; models built in Python often lack these.

    InputError for a model that makes Pinocchio's algorithms silently wrong, or whose inertias are impossible.
    """
    model = model.copy()
    named = {frame.name for frame in model.frames}
    for joint, name in enumerate(model.names):
        if "Mimic" in model.joints[joint].shortname():
            raise InputError(
                f"joint {name!r} of model {model.name!r} is one of Pinocchio's mimic joints, which most of its "
                "algorithms do not support. Build the model without (mimic=False), with a Coupling among the loops; "
                "load() of the URDF file does that"
            )
        if joint > 1 and model.parents[joint] not in set(model.supports[joint - 1]):
            raise InputError(
                f"the joints of model {model.name!r} are not in depth-first order: {name!r} follows "
                f"{model.names[joint - 1]!r} but its parent is {model.names[model.parents[joint]]!r}. Pinocchio's crba "
                "and derivative algorithms are then silently wrong; add each branch completely before the next one"
            )
        inertia, armature = model.inertias[joint], model.armature[places(model, joint)[1]] if joint else 0.0
        if not np.isfinite([inertia.mass, *inertia.lever, *inertia.inertia.ravel()]).all():
            raise InputError(f"the inertia of the body at joint {name!r} is not finite")
        if inertia.mass < 0:
            raise InputError(f"the body at joint {name!r} has negative mass {inertia.mass:g} kg")
        if not np.all(np.isfinite(armature) & (armature >= 0.0)):
            raise InputError(f"the armature of joint {name!r} is negative or not finite")
        if name not in named:
            model.addFrame(pin.Frame(name, joint, 0, pin.SE3.Identity(), pin.FrameType.JOINT), False)
    if model.nv == 0:
        raise InputError(f"model {model.name!r} has no joints: nothing can move")
    poses = [(pose, f"joint {name!r}") for pose, name in zip(model.jointPlacements, model.names, strict=True)]
    for pose, what in (*poses, *((frame.placement, f"frame {frame.name!r}") for frame in model.frames)):
        R = pose.rotation
        if not (np.isfinite(pose.translation).all() and np.abs(R.T @ R - np.eye(3)).max() < ROTATION):
            raise InputError(f"the placement of {what} is not finite, or its rotation matrix is not a rotation")
    if not np.isfinite(model.gravity.vector).all():
        raise InputError(f"the gravity of model {model.name!r} is not finite")
    return model


def require_mechanism(mechanism, caller: str) -> None:
    """Raise InputError for anything but a Mechanism, recognised by its class: that imports this file."""
    if not hasattr(type(mechanism), "anchored_loops"):
        raise InputError(f"{caller} needs a Mechanism, got {type(mechanism).__name__}; see pinconsist.load()")


def normalized(model, q, who: str) -> np.ndarray:
    """A configuration with its quaternions and (cos, sin) pairs at unit length; InputError where one has none."""
    if model.nq == model.nv:  # no joint has an orientation
        return np.array(q)
    q = pin.normalize(model, q)
    for joint in range(1, model.njoints if not pin.isNormalized(model, q, UNIT) else 0):
        part, alone = places(model, joint)[0], pin.neutral(model)
        alone[part] = q[part]
        if not pin.isNormalized(model, alone, UNIT):
            raise InputError(f"{who}: joint {model.names[joint]!r} has an orientation of length zero")
    return q


def called(function, what: str, t: float, *state):
    """What a user's function returns for arrays that it cannot write to; exceptions become a UserFunctionError."""
    try:
        return function(t, *map(read_only, state))
    except Exception as error:
        raise UserFunctionError(what, t, error) from error


def returned(function, what: str, shape: tuple, t: float, *state, hint: str = "") -> np.ndarray:
    """The float array of this shape that a user's function returns; InputError where it returns another."""
    return real_array(called(function, what, t, *state), what, shape, t, hint)


def real_array(value, what: str, shape: tuple, t: float, hint: str = "") -> np.ndarray:
    """The float array of this shape that a user's function has returned; else InputError."""
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "biuf":
            raise TypeError("complex numbers" if array.dtype.kind == "c" else f"{value!r}")
    except (TypeError, ValueError) as error:
        raise InputError(f"{what} returned no numbers at t = {t:.6g}: {error}") from None
    if array.shape != shape:
        wanted = str(shape) if shape else "one number"
        raise InputError(f"{what} returned shape {array.shape} at t = {t:.6g}; it must return {wanted}{hint}")
    return array.astype(float, copy=False)


def warn(message: str) -> None:
    """A UserWarning at the line of the user's code that called this package."""
    frame, level = sys._getframe(1), 2
    while frame.f_back is not None and frame.f_globals.get("__name__", "").split(".")[0] == "pinconsist":
        frame, level = frame.f_back, level + 1
    warnings.warn(message, stacklevel=level)


def read_only(array):
    """A view that a user's function cannot write to."""
    view = array.view()
    view.flags.writeable = False
    return view


def function_name(function) -> str:
    """A function for messages."""
    return getattr(function, "__qualname__", None) or repr(function)


def _ndim(value) -> int:
    """Dimensions of an array; 0 of anything else, -1 of nested sequences that do not match."""
    try:
        return np.ndim(value)
    except ValueError:
        return -1
