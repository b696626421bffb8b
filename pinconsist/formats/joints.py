"""Settings of the tree in a loop file that the robot file cannot express.

::

    joints:
      hip:   {type: spherical, damping: [0.1, 0.1, 0.2]}
      motor: {armature: 0.02}
    gravity: [0, 0, -1.62]
    joint_order: [hip, motor]

``armature``, ``damping`` and ``friction`` replace the values of the robot file: one number for each velocity of the
joint, or one for all of them. ``joint_order`` is the order of the joints in q and v. ``type``, or ``joint_type`` in a
robot.yaml, replaces a joint by::

    SPHERICAL     a ball joint, with a quaternion in q
    TRANSLATION   free translation along all axes, without rotation
    UJOINT_AB     two hinges, about the axes A and B (of X, Y, Z) of the joint frame; CARDAN is an older UJOINT_XY
    HELICAL p     a screw along the axis of the revolute joint that it replaces, with p metres per radian
    UNBOUNDED     a revolute joint that stores the cosine and sine of its angle and does not count turns
    FIXED         no joint: held at zero
"""

import re

import numpy as np
import pinocchio as pin

from ..errors import FormatError
from ..mechanism.checks import places
from ..mechanism.editing import rebuilt
from .reading import finite, located, require_known, short_repr
from .records import amount, known_keys, mapping, name

_FRICTION = ("upperDryFrictionLimit", "lowerDryFrictionLimit")
VALUES = {"armature": ("armature",), "damping": ("damping",), "friction": _FRICTION}
"""Key of a joint → the vectors of the model that it sets; a second vector gets the negative value."""
AS_WRITTEN = {"FIXED": "fixed", "UNBOUNDED": "continuous"}
"""Types that replace the type in the URDF text; the others replace the joint in the model."""
_UNIVERSAL = re.compile(r"UJOINT_([XYZ])(?!\1)([XYZ])")
_HELICAL = re.compile(r"HELICAL (\S+)")


def check_type(joint_type: object, element: str = "") -> str:
    """The type in capitals, or FormatError."""
    text = " ".join(str(joint_type).upper().split())
    text = "UJOINT_XY" if text == "CARDAN" else text
    known = text in ("SPHERICAL", "TRANSLATION", *AS_WRITTEN) or _UNIVERSAL.fullmatch(text)
    if known or ((helical := _HELICAL.fullmatch(text)) and finite(helical[1])):
        return text
    raise FormatError(
        f"the joint type {short_repr(joint_type)} is not one of SPHERICAL, TRANSLATION, UJOINT_AB (A, B different axes "
        "of X, Y, Z), HELICAL p (metres per radian, not zero), UNBOUNDED, FIXED",
        element=element,
    )


def new_names(joint: str, joint_type: str) -> tuple[str, ...]:
    """Names of the joints that replace one; a universal joint becomes two: ``ankle_X``, ``ankle_Y``."""
    universal = _UNIVERSAL.fullmatch(joint_type)
    return tuple(f"{joint}_{axis}" for axis in universal.groups()) if universal else (joint,)


def joint_settings(record: dict) -> tuple[dict[str, str], dict[str, dict]]:
    """The settings under ``joints``: name → type, and name → key of VALUES → one or several numbers."""
    types, values = {}, {}
    for joint, given in mapping(record.get("joints") or {}, "joints", "a joint's name").items():
        element = f"joints: {name(joint, 'joints')}"
        known_keys(mapping(given, element, "type, armature"), ("type", *VALUES), element)
        if given.get("type") is not None:
            types[joint] = check_type(given["type"], element)
        values[joint] = {key: amount(given[key], f"{element}: {key}") for key in VALUES if given.get(key) is not None}
        for key, value in values[joint].items():
            if np.min(value, initial=0.0) < 0:
                raise FormatError(f"{short_repr(given[key])} is negative", element=f"{element}: {key}")
    return types, values


def replaced(model: pin.Model, types: dict[str, str]) -> pin.Model:
    """A copy of a model with hinges or sliders replaced.

    A universal joint becomes two hinges about the two named axes of the joint frame, with a massless body between
    them, because ``computeRNEADerivatives`` is wrong for Pinocchio's own universal and composite joints. Limits are
    dropped; damping, friction and armature of the replaced joint act on each new velocity. Frames keep their names and
    indices. FormatError if a joint is unknown or does not have one degree of freedom, or if names clash.
    """
    joints, parts = tuple(model.names)[1:], {}
    for joint, kind in types.items():
        with located(element=f"joint {joint!r}"):
            require_known(joint, joints, "there is no movable joint of this name to replace")
            if model.nvs[model.getJointId(joint)] != 1:
                raise FormatError("only hinges and sliders can be replaced")
            parts[joint] = _parts(joint, kind, model.joints[model.getJointId(joint)])
    names = [joint for joint in model.names if joint not in types]
    names += [part for some in parts.values() for part, _ in some]
    if twice := [joint for joint in names if names.count(joint) > 1]:
        raise FormatError("a new joint has the name of an existing one", element=f"joint {twice[0]!r}")
    return rebuilt(model, parts)


def _parts(joint, kind, own):
    """(name, joint model) of each new joint."""
    if kind in ("SPHERICAL", "TRANSLATION"):
        return [(joint, getattr(pin, f"JointModel{kind.capitalize()}")())]
    if helical := _HELICAL.fullmatch(kind):
        which, pitch = own.shortname(), float(helical[1])
        if which == "JointModelRevoluteUnaligned":
            return [(joint, pin.JointModelHelicalUnaligned(own.extract().axis, pitch))]
        if not re.fullmatch("JointModelR[XYZ]", which):
            raise FormatError("only a revolute joint can be made helical")
        return [(joint, getattr(pin, f"JointModelH{which[-1]}")(pitch))]
    return [(part, getattr(pin, f"JointModelR{part[-1]}")()) for part in new_names(joint, kind)]


def with_values(model: pin.Model, values: dict[str, dict]) -> pin.Model:
    """Set the values of :func:`joint_settings` in the model and return it; FormatError for wrong joints or sizes."""
    for joint, given in values.items():
        require_known(joint, tuple(model.names)[1:], f"the model has no joint {joint!r}", f"joints: {joint}")
        i = model.getJointId(joint)
        part, size = places(model, i)[1], model.nvs[i]
        for key, value in given.items():
            if isinstance(value, tuple) and len(value) != size:
                reason = f"it needs one number or {size}, one for each velocity of the joint; got {len(value)}"
                raise FormatError(reason, element=f"joints: {joint}: {key}")
            for sign, vector in zip((1, -1), VALUES[key], strict=False):
                getattr(model, vector)[part] = sign * np.array(value)
    return model


def in_order(model: pin.Model, order: tuple[str, ...]) -> pin.Model:
    """The model with its joints in another order; FormatError unless it has each joint once, after its parent."""
    names = list(model.names)[1:]
    if not order or list(order) == names:
        return model
    with located(element="joint_order"):
        if sorted(order) != sorted(names):
            strange = [joint for joint in order if joint not in names or order.count(joint) > 1]
            missing = [joint for joint in names if joint not in order]
            raise FormatError(f"it must contain each joint once; unknown or repeated: {strange}, missing: {missing}")
        places = [model.getJointId(joint) for joint in order]
        for place, joint in enumerate(places):
            parent = model.parents[joint]
            if parent and parent not in places[:place]:
                raise FormatError(f"joint {model.names[joint]!r} comes before its parent {model.names[parent]!r}")
        return rebuilt(model, {}, order=places)
