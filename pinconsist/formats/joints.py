"""Joints replaced by others: `joint_name` and `joint_type` of robot.yaml, `joints: {name: {type: …}}` of our own files.

================= ==================================================================================================
type              what the joint becomes
================= ==================================================================================================
SPHERICAL         a ball joint, a quaternion in q
TRANSLATION       free to move along all axes, without turning
UJOINT_AB         two hinges, about the axes A and B (of X, Y, Z) of the joint frame; CARDAN is an older UJOINT_XY
HELICAL p         a screw about the axis of the revolute joint that it replaces, p metres to the radian
UNBOUNDED         a revolute joint that stores cosine and sine of its angle and does not count its turns
FIXED             none: held at zero
================= ==================================================================================================
"""

from __future__ import annotations

import re

import pinocchio as pin

from ..errors import FormatError
from ..mechanism.editing.rebuild import rebuilt
from .reading import finite, near, shown

_AXES = {"X": pin.JointModelRX, "Y": pin.JointModelRY, "Z": pin.JointModelRZ}
_SCREWS = {"RX": pin.JointModelHX, "RY": pin.JointModelHY, "RZ": pin.JointModelHZ}
_UNIVERSAL = re.compile("UJOINT_([XYZ])([XYZ])")
_HELICAL = re.compile(r"HELICAL (\S+)")


def check_type(joint_type: object, element: str = "") -> str:
    """The type in capitals, or FormatError."""
    text = " ".join(str(joint_type).upper().split())
    text = "UJOINT_XY" if text == "CARDAN" else text
    universal, helical = _UNIVERSAL.fullmatch(text), _HELICAL.fullmatch(text)
    if (
        text in ("SPHERICAL", "TRANSLATION", "UNBOUNDED", "FIXED")
        or (universal and universal[1] != universal[2])
        or (helical and finite(helical[1]))
    ):
        return text
    raise FormatError(
        f"the joint type {shown(joint_type)} is not one of SPHERICAL, TRANSLATION, UJOINT_AB (A, B different axes of "
        "X, Y, Z), HELICAL p (metres to the radian, not zero), UNBOUNDED, FIXED",
        element=element,
    )


def new_names(joint: str, joint_type: str) -> tuple[str, ...]:
    """Names of the joints that stand for a replaced one; a universal joint becomes two: ``ankle_X``, ``ankle_Y``."""
    universal = _UNIVERSAL.fullmatch(joint_type)
    return tuple(f"{joint}_{axis}" for axis in universal.groups()) if universal else (joint,)


def replaced(model: pin.Model, types: dict[str, str]) -> pin.Model:
    """A copy of a model with hinges or sliders replaced.

    A universal joint becomes two hinges with a massless body between them, about the two named axes of the joint
    frame in turn: Pinocchio's own universal and composite joints have wrong ``computeRNEADerivatives``. Limits go;
    damping, friction and armature of the replaced joint act on each new velocity. Frames keep names and indices.

    Parameters
    ----------
    model : pin.Model
        The model as read; not changed.
    types : dict[str, str]
        Joint name → SPHERICAL, TRANSLATION, UJOINT_AB or HELICAL p.

    Raises
    ------
    FormatError
        Unknown joint, one that does not have exactly one degree of freedom, or names that clash.
    """
    for name in types:
        if name not in tuple(model.names)[1:]:
            raise FormatError(
                f"there is no movable joint of this name to replace{near(name, tuple(model.names)[1:])}",
                element=f"joint {name!r}",
            )
        if model.nvs[model.getJointId(name)] != 1:
            raise FormatError("only hinges and sliders can be replaced", element=f"joint {name!r}")
    parts = {name: _parts(name, kind, model.joints[model.getJointId(name)]) for name, kind in types.items()}
    names = [name for name in model.names if name not in types] + [part for some in parts.values() for part, _ in some]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise FormatError("another joint has the name of a new one", element=f"joint {twice[0]!r}")
    return rebuilt(model, parts)


def _parts(name, kind, own):
    if kind == "SPHERICAL":
        return [(name, pin.JointModelSpherical())]
    if kind == "TRANSLATION":
        return [(name, pin.JointModelTranslation())]
    if helical := _HELICAL.fullmatch(kind):
        return [(name, _screw(name, own, float(helical[1])))]
    return [(part, _AXES[part[-1]]()) for part in new_names(name, kind)]


def _screw(name, own, pitch):
    which = own.shortname().removeprefix("JointModel")
    if which == "RevoluteUnaligned":
        return pin.JointModelHelicalUnaligned(own.extract().axis, pitch)
    if which in _SCREWS:
        return _SCREWS[which](pitch)
    raise FormatError("only a revolute joint can be made helical", element=f"joint {name!r}")
