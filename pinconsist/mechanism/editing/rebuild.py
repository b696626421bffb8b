"""A model built once more, joint by joint, with some joints other than they were."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pinocchio as pin

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


def rebuilt(
    model: pin.Model,
    parts: Mapping[str, Sequence[tuple[str, object]]],
    poses: Mapping[str, pin.SE3] = {},
    order: Sequence[int] | None = None,
) -> pin.Model:
    """A copy of a model with joints replaced; frames keep their names and indices, bodies their inertia.

    (``pin.buildReducedModel`` needs a frame for each joint, which models built in code need not have.)

    Parameters
    ----------
    model : pin.Model
        Not changed.
    parts : mapping
        Joint name → the (name, joint model) that stand for it, one after the other; the last carries its body. Damping,
        friction and armature act on each new velocity. An empty sequence fixes the joint: its body becomes one with its
        parent's.
    poses : mapping, optional
        Name of a fixed joint → pose of its body in its joint frame.
    order : sequence of int, optional
        The joints in the order in which they are to be added, parents before children.
    """
    new = pin.Model()
    new.name, new.gravity = model.name, model.gravity
    new.inertias[0] = model.inertias[0]
    carriers = {0: (0, pin.SE3.Identity())}  # old joint → new joint that carries its body, and where
    for old in order or range(1, model.njoints):
        name = model.names[old]
        carrier, place = carriers[model.parents[old]]
        place = place * model.jointPlacements[old]
        stand_ins = parts.get(name, [(name, model.joints[old])])
        for part, joint in stand_ins:
            carrier, place = new.addJoint(carrier, joint, place, part), pin.SE3.Identity()
            _copy_values(model, old, new, carrier, name not in parts)
        if not stand_ins:
            place = place * poses[name]
        carriers[old] = carrier, place
        own = place.act(model.inertias[old])
        new.inertias[carrier] = own if stand_ins else new.inertias[carrier] + own
    fixed = {name for name, stand_ins in parts.items() if not stand_ins}
    for frame in list(model.frames)[1:]:
        carrier, place = carriers[frame.parentJoint]
        is_fixed = frame.type == pin.FrameType.JOINT and frame.name in fixed
        kind = pin.FrameType.FIXED_JOINT if is_fixed else frame.type
        moved = pin.Frame(frame.name, carrier, frame.parentFrame, place * frame.placement, kind, frame.inertia)
        new.addFrame(moved, False)
    return new


def _copy_values(model, old, new, joint, same_joint):
    here, there = model.idx_vs[old], new.idx_vs[joint]
    for key in _PER_VELOCITY:
        getattr(new, key)[there : there + new.nvs[joint]] = getattr(model, key)[here : here + model.nvs[old]]
    if same_joint:
        here, there = model.idx_qs[old], new.idx_qs[joint]
        for key in _PER_COORDINATE:
            getattr(new, key)[there : there + new.nqs[joint]] = getattr(model, key)[here : here + model.nqs[old]]
