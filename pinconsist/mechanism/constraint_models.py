"""Loops from Pinocchio's own constraint models, recognised by their class names and read by their attributes."""

import numpy as np
import pinocchio as pin

from ..errors import InputError
from .loops import GROUND, Loop

_KINDS = {
    "PointAnchorConstraintModel": "point",
    "FrameAnchorConstraintModel": "frame",
    "RigidConstraintModel of type CONTACT_3D": "point",
    "RigidConstraintModel of type CONTACT_6D": "frame",
}
_MUST_VANISH = (
    "desired_constraint_offset",
    "desired_constraint_velocity",
    "desired_constraint_acceleration",
    "desired_contact_velocity",
    "desired_contact_acceleration",
)


def loops_of(constraint_models, model: pin.Model) -> tuple[tuple[Loop, ...], pin.Model]:
    """Loops that hold together what Pinocchio's constraint models do, and the model they belong to.

    Read are point and frame anchors, the legacy rigid constraints in 3D and 6D, and these inside the common constraint
    model; InputError for other kinds, compliance, desired offsets or motions. Baumgarte gains are not needed and
    ignored. A constraint without a name is called by its place, ``loop1``. The model is a copy with one more frame for
    each joint that carries an anchor but no frame of a unique name.
    """
    loops = []
    for number, constraint in enumerate(constraint_models, start=1):
        if hasattr(constraint, "extract"):
            constraint = constraint.extract()
        name = getattr(constraint, "name", "") or f"loop{number}"
        if name in (loop.name for loop in loops):
            name = f"{name} ({number})"
        fields = {"kind": _kind(constraint, name)}
        for end in (1, 2):
            joint = getattr(constraint, f"joint{end}_id")
            if not 0 <= joint < model.njoints:
                raise InputError(f"constraint {name!r}: the model has no joint number {joint}")
            model, frame = _with_frame_on(joint, model)
            place = model.frames[model.getFrameId(frame)].placement.actInv(getattr(constraint, f"joint{end}_placement"))
            fields[f"frame{end}"] = frame
            fields[f"xyz{end}"], fields[f"rpy{end}"] = place.translation, pin.rpy.matrixToRpy(place.rotation)
        loops.append(Loop(name, **fields))
    return tuple(loops), model


def _kind(constraint, name):
    """The kind of the loop; InputError where the constraint is not rigid, or its anchors move."""
    which = type(constraint).__name__
    if which == "RigidConstraintModel":
        which += f" of type {constraint.type}"
    if which not in _KINDS:
        raise InputError(
            f"constraint {name!r}: a {which} cannot be read as a loop; {', '.join(_KINDS)} can. Limits, friction and "
            "contact are not modelled as constraints here (see help(pinconsist.Loop))"
        )
    for attribute in _MUST_VANISH:
        value = getattr(constraint, attribute, 0.0)
        if np.any(getattr(value, "vector", value)):
            raise InputError(
                f"constraint {name!r}: its {attribute} is not zero; a loop is closed, and its anchors do not move"
            )
    if np.any(constraint.retrieveCompliance()):
        raise InputError(f"constraint {name!r}: it is compliant; a loop is rigid, a SpringDamper is not")
    return _KINDS[which]


def _with_frame_on(joint, model):
    """The model and the name of a frame on this joint that no other frame has; a copy gets one if there is none."""
    if joint == 0:
        return model, GROUND
    names = [frame.name for frame in model.frames]
    own = [frame.name for frame in model.frames if frame.parentJoint == joint and names.count(frame.name) == 1]
    if own:
        return model, model.names[joint] if model.names[joint] in own else own[0]
    model, name = model.copy(), model.names[joint]
    while name in names:
        name += "_origin"
    model.addFrame(pin.Frame(name, joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME), False)
    return model, name
