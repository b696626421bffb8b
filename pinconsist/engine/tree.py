"""The tree of a Pinocchio model in numbers, from which the compiled part builds its own."""

from weakref import ref

import numpy as np

AXES = {"X": (1.0, 0.0, 0.0), "Y": (0.0, 1.0, 0.0), "Z": (0.0, 0.0, 1.0)}
ALIGNED = {"R": "revolute", "RUB": "unbounded", "P": "prismatic", "H": "helical"}
SIMPLE = {
    "JointModelFreeFlyer": "free flyer",
    "JointModelPlanar": "planar",
    "JointModelSpherical": "spherical",
    "JointModelSphericalZYX": "spherical ZYX",
    "JointModelTranslation": "translation",
}
UNALIGNED = {
    "JointModelRevoluteUnaligned": "revolute",
    "JointModelRevoluteUnboundedUnaligned": "unbounded",
    "JointModelPrismaticUnaligned": "prismatic",
    "JointModelHelicalUnaligned": "helical",
}

# By identity: Pinocchio compares all numbers, and data with a NaN are not equal to themselves.
_branches: dict = {}
_copies: dict = {}  # model → one that differs from it in the bodies of some joints, and these
_trees: dict = {}
_workspaces: dict = {}


def workspace(module, model, owner=None):
    """The compiled workspace of an `owner`, any object; a new one without. Trees are built once per model."""
    if owner is None:
        return module.Workspace(_kept(_trees, model, lambda: tree(module, model)))
    return _kept(_workspaces, owner, lambda: workspace(module, model))


def _kept(kept: dict, key, build):
    """What was built for this very object, as long as it exists."""
    number = id(key)
    if number not in kept:
        kept[number] = build(), ref(key, lambda _: kept.pop(number))
    return kept[number][0]


def tree(module, model):
    """A new compiled tree of a model."""
    branches = [branch for _, branch in _branches_of(module, model)]
    return module.Tree(branches, model.armature, model.gravity.linear)


def with_other_bodies(model, before, joints) -> None:
    """Let it be known that a model is a copy of the model `before`, whose tree has other bodies at some joints."""
    before, others = _copies[id(before)][0] if id(before) in _copies else (before, ())
    _kept(_copies, model, lambda: (before, (*others, *joints)))


def _branches_of(module, model) -> list:
    """The joints of a model, alone and with their bodies; of copies only other bodies are read."""
    if id(model) not in _copies:
        return _kept(_branches, model, lambda: [_joint_and_branch(module, model, i) for i in range(1, model.njoints)])
    before, changed = _copies[id(model)][0]
    branches = list(_branches_of(module, before))
    for i in changed:
        joint = branches[i - 1][0]
        branches[i - 1] = joint, _branch(module, model, i, joint)
    return branches


def _joint_and_branch(module, model, i):
    joint = _joint(module, model.joints[i].extract())
    return joint, _branch(module, model, i, joint)


def _branch(module, model, i, joint):
    inertia = model.inertias[i]
    placement = model.jointPlacements[i].homogeneous
    return module.Branch(joint, int(model.parents[i]), placement, inertia.mass, inertia.lever, inertia.inertia)


def _joint(module, joint):
    kind, numbers, parts = _numbers(joint)
    placed = [(_joint(module, part), placement) for part, placement in parts]
    return module.JointNumbers(kind, [float(number) for number in numbers], placed)


def _numbers(joint):
    """(kind, numbers, parts with their placements) of a joint."""
    name = joint.shortname()
    if name in SIMPLE:
        return SIMPLE[name], (), ()
    if name in UNALIGNED:
        kind = UNALIGNED[name]
        if kind == "helical":
            return kind, (*joint.axis, joint.pitch), ()
        twist = joint.createData().S  # of unit velocity; not every joint shows its axis
        return kind, twist[:3] if kind == "prismatic" else twist[3:], ()
    if name == "JointModelUniversal":
        return "universal", (*joint.axis1, *joint.axis2), ()
    if name == "JointModelEllipsoid":
        return "ellipsoid", (joint.radius_x, joint.radius_y, joint.radius_z), ()
    if name == "JointModelComposite":
        placements = [np.array(placement.homogeneous) for placement in joint.jointPlacements]
        parts = [getattr(part, "extract", lambda part=part: part)() for part in joint.joints]
        return "composite", (), tuple(zip(parts, placements, strict=True))
    short = name.removeprefix("JointModel")
    kind, axis = ALIGNED[short[:-1]], AXES[short[-1]]
    return kind, (*axis, joint.pitch) if kind == "helical" else axis, ()
