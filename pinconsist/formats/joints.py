"""Joints replaced by others: the `joint_name` and `joint_type` of robot.yaml."""

from __future__ import annotations

import re

import pinocchio as pin

from ..errors import FormatError
from .reading import near, shown

_AXES = {"X": pin.JointModelRX, "Y": pin.JointModelRY, "Z": pin.JointModelRZ}
_UNIVERSAL = re.compile("UJOINT_([XYZ])([XYZ])")
_PER_VELOCITY = (
    "armature",
    "damping",
    "lowerDryFrictionLimit",
    "upperDryFrictionLimit",
    "lowerEffortLimit",
    "upperEffortLimit",
    "lowerVelocityLimit",
    "upperVelocityLimit",
    "rotorInertia",
    "rotorGearRatio",
)
_PER_COORDINATE = ("lowerPositionLimit", "upperPositionLimit", "positionLimitMargin")


def check_type(joint_type: object) -> str:
    """SPHERICAL, FIXED or UJOINT_AB in capitals; FormatError for all else."""
    text = str(joint_type).upper()
    universal = _UNIVERSAL.fullmatch(text)
    if text in ("SPHERICAL", "FIXED") or (universal and universal[1] != universal[2]):
        return text
    raise FormatError(
        f"the joint type {shown(joint_type)} is not one of SPHERICAL, FIXED, UJOINT_AB (A, B different axes of X, Y, Z)"
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
        Joint name → SPHERICAL or UJOINT_AB.

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
    new = pin.Model()
    new.name, new.gravity = model.name, model.gravity
    new.inertias[0] = model.inertias[0]
    moved = [0]  # old joint → new joint that carries its body
    for old in range(1, model.njoints):
        name = model.names[old]
        parent, place = moved[model.parents[old]], model.jointPlacements[old]
        for part, joint in _parts(name, types.get(name), model.joints[old]):
            if new.existJointName(part):
                raise FormatError("another joint has the name of a new one", element=f"joint {part!r}")
            parent = new.addJoint(parent, joint, place, part)
            place = pin.SE3.Identity()
            _copy_values(model, old, new, parent, name in types)
        new.inertias[parent] = model.inertias[old]
        moved.append(parent)
    for frame in list(model.frames)[1:]:
        joint = moved[frame.parentJoint]
        new.addFrame(pin.Frame(frame.name, joint, frame.parentFrame, frame.placement, frame.type, frame.inertia), False)
    return new


def _parts(name, joint_type, own):
    if joint_type is None:
        return [(name, own)]
    if joint_type == "SPHERICAL":
        return [(name, pin.JointModelSpherical())]
    return [(part, _AXES[part[-1]]()) for part in new_names(name, joint_type)]


def _copy_values(model, old, new, joint, is_replaced):
    here, there = model.idx_vs[old], new.idx_vs[joint]
    for key in _PER_VELOCITY:
        getattr(new, key)[there : there + new.nvs[joint]] = getattr(model, key)[here : here + model.nvs[old]]
    if not is_replaced:
        here, there = model.idx_qs[old], new.idx_qs[joint]
        for key in _PER_COORDINATE:
            getattr(new, key)[there : there + new.nqs[joint]] = getattr(model, key)[here : here + model.nqs[old]]
