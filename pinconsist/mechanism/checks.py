"""Checks shared by forces, loops and motions: of fields, of models and their names, of user-defined functions."""

import difflib
import os
from collections.abc import Mapping
from math import atan2, inf, isfinite
from weakref import ref

import numpy as np
import pinocchio as pin

from ..errors import InputError, UserFunctionError

UNIT = 1e-9  # largest deviation of an orientation from unit length
ROTATION = 1e-6  # largest deviation of RᵀR of a placement from the unit matrix


def put(record, **values) -> None:
    """Set fields of a frozen record."""
    for name, value in values.items():
        object.__setattr__(record, name, value)


def number(value, what: str, least: float = -inf, above: float = -inf) -> float:
    """A finite float from user input, at least `least` and greater than `above`; else InputError."""
    if type(value) is float:  # as in loops of controllers
        result = value
    else:
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
    """Replace fields of a record by the result of a check: :func:`number`, :func:`triple` or :func:`name`."""
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
        given = np.asarray(value)
        if given.dtype.kind not in "biufO":  # numpy would convert "0.1" and drop imaginary parts
            raise TypeError
        if given.dtype.kind == "O" and None in given.ravel().tolist():  # numpy would convert it to NaN
            raise TypeError
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{what}: expected numbers, got {value!r}") from None
    if not np.isfinite(array).all():
        raise InputError(f"{what} has a number that is not finite (NaN or infinity)")
    return array


def several(values) -> tuple:
    """The values of an argument that may also be a single value."""
    alone = isinstance(values, str | os.PathLike) or not hasattr(values, "__iter__")
    return (values,) if alone else tuple(values)


def name(value, what: str) -> str:
    """The name of a joint or frame; else InputError."""
    if not isinstance(value, str) or not value:
        raise InputError(f"{what} must be a name, got {value!r}")
    return value


def names(values, what: str) -> tuple[str, ...]:
    """One name or a sequence of names as a tuple; else InputError."""
    if not (isinstance(values, str) or (hasattr(values, "__iter__") and _ndim(values) < 2)):
        raise InputError(f"{what} must be a sequence of names, got {values!r}")
    return tuple(name(each, what) for each in several(values))


def choice(value, known, what: str) -> str:
    """One of the texts `known`; else InputError."""
    if not (isinstance(value, str) and value in known):
        raise InputError(f"{what}={value!r} is not one of {', '.join(map(repr, known))}")
    return value


def flag(value, what: str) -> bool:
    """True or False; InputError for a value that is neither, such as an array."""
    try:
        return bool(value)
    except ValueError:
        raise InputError(f"{what} must be True or False, got {value!r}") from None


def require_functions(record, who: str, of: str, *fields: str, optional: tuple[str, ...] = ()) -> None:
    """Raise InputError if one of these fields is not a function; `optional` fields may be None."""
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
    """`amounts` as an array (nv,); with `alike`, a single number applies to every velocity of its joint."""
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
    """``"; similar: …"`` for the end of a message, with up to four similar `names`; empty if there are none."""
    found = difflib.get_close_matches(str(name), sorted(set(names)), n=4, cutoff=0.5)
    return f"; similar: {', '.join(found)}" if found else ""


def joint_index(model, joint: str, what: str) -> int:
    """The index of a joint; InputError with similar names if the model has no such joint."""
    i = model.getJointId(joint) if isinstance(joint, str) else 0
    if not 0 < i < model.njoints:
        raise InputError(f"{what}: the model has no joint {joint!r}{near(joint, list(model.names)[1:])}")
    return i


def places(model, i: int) -> tuple[slice, slice]:
    """The slices of joint `i` in a configuration and in a velocity."""
    q, v = model.idx_qs[i], model.idx_vs[i]
    return slice(q, q + model.nqs[i]), slice(v, v + model.nvs[i])


def columns(model, joint: str, what: str) -> slice:
    """The columns of a joint in v; raises InputError like :func:`joint_index`."""
    return places(model, joint_index(model, joint, what))[1]


def coordinates(model, joint: str, q) -> tuple[float, ...]:
    """The numbers of a joint in `q`, as for ``Mechanism.configuration``: one angle in place of (cos, sin)."""
    i = model.getJointId(joint)
    part = tuple(q[places(model, i)[0]].tolist())
    return (atan2(part[1], part[0]),) if len(part) == 2 and model.nvs[i] == 1 else part


def frame_of(model, frame: str, what: str):
    """The frame with this name; InputError if there is none or more than one."""
    names = [each.name for each in model.frames]
    if not isinstance(frame, str) or frame not in names:
        raise InputError(f"{what}: the model has no frame {frame!r}{near(frame, names)}")
    if names.count(frame) > 1:
        raise InputError(
            f"{what}: the name {frame!r} belongs to a link and to a joint that is elsewhere; rename one of them"
        )
    return model.frames[model.getFrameId(frame)]


def checked_model(model: pin.Model) -> pin.Model:
    """A copy with a frame for each joint, unless a frame has its name; models built in Python often lack them.

    InputError for a model for which Pinocchio's algorithms are silently wrong, or with impossible inertias.
    """
    model = model.copy()
    named = {frame.name for frame in model.frames}
    for joint, name in enumerate(model.names):
        if "Mimic" in model.joints[joint].shortname():
            raise InputError(
                f"joint {name!r} of model {model.name!r} is one of Pinocchio's mimic joints, which most of its "
                "algorithms do not support. Build the model without them (mimic=False) and add a Coupling to the "
                "loops, as load() does with a URDF file"
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


_own: dict = {}  # models of mechanisms, by identity


def own_model(model: pin.Model) -> pin.Model:
    """The checked copy that a mechanism keeps; the model of another mechanism, which nobody changes, is shared."""
    known = _own.get(id(model))
    if known is not None and known() is model:
        return model
    checked = checked_model(model)
    place = id(checked)
    _own[place] = ref(checked, lambda _: _own.pop(place, None))
    return checked


def workspace(model: pin.Model) -> pin.Data:
    """Pinocchio's data of a model; InputError if they do not fit into the memory of the machine.

    They hold eight arrays of nv³ numbers. A process that asks for too many is ended without a word.
    """
    needed, memory = 64.0 * model.nv**3, _memory()
    refused = InputError(
        f"{model.name}: {model.nv} velocities are too many: Pinocchio's workspace for them takes "
        f"{needed / 1e9:.0f} GB, and this machine has {memory / 1e9:.0f} GB"
    )
    if needed > memory:
        raise refused
    try:
        return model.createData()
    except MemoryError:
        raise refused from None


def _memory() -> float:
    """The memory of the machine, bytes; infinite where the system does not say."""
    try:
        return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, ValueError, OSError):
        return inf


def require_mechanism(mechanism, caller: str) -> None:
    """Raise InputError for anything but a Mechanism, recognised by an attribute: its module imports this one."""
    if not hasattr(type(mechanism), "anchored_loops"):
        raise InputError(f"{caller} needs a Mechanism, got {type(mechanism).__name__}; see pinconsist.load()")


def require_no_contacts(mechanism, caller: str, why: str = "") -> None:
    """Raise InputError for a mechanism with contacts, where these would be left out without a word."""
    if names := [each.name for each in mechanism.contacts]:
        raise InputError(
            f"{mechanism.name}: {caller} does not support contacts{why}, and this mechanism has {', '.join(names[:4])}"
            f"{', …' * (len(names) > 4)}; mech.with_contacts() removes them; replace lasting contacts by loops"
        )


def normalized(model, q, who: str) -> np.ndarray:
    """A configuration with quaternions and (cos, sin) pairs of unit length; InputError if one has length zero."""
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
    """Call a user's function with read-only arrays; its exceptions become a UserFunctionError."""
    try:
        return function(t, *map(read_only, state))
    except Exception as error:
        raise UserFunctionError(what, t, error) from error


def returned(function, what: str, shape: tuple, t: float, *state, hint: str = "") -> np.ndarray:
    """Call a user's function that must return a float array of this shape; else InputError."""
    return real_array(called(function, what, t, *state), what, shape, t, hint)


def real_array(value, what: str, shape: tuple, t: float, hint: str = "") -> np.ndarray:
    """A value that a user's function returned, as a float array of this shape; else InputError."""
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "biuf":
            raise TypeError("complex numbers" if array.dtype.kind == "c" else f"{value!r}")
    except (TypeError, ValueError) as error:
        raise InputError(f"{what} did not return real numbers at t = {t:.6g}: {error}") from None
    if array.shape != shape:
        wanted = str(shape) if shape else "one number"
        raise InputError(f"{what} returned shape {array.shape} at t = {t:.6g}; it must return {wanted}{hint}")
    return array.astype(float, copy=False)


def read_only(array):
    """A view that a user's function cannot write to."""
    view = array.view()
    view.flags.writeable = False
    return view


def function_name(function) -> str:
    """The name of a function in messages."""
    return getattr(function, "__qualname__", None) or repr(function)


def _ndim(value) -> int:
    """Number of dimensions; 0 for anything but an array or a sequence, -1 for ragged nested sequences."""
    try:
        return np.ndim(value)
    except ValueError:
        return -1
