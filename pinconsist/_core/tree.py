"""The tree of a Pinocchio model in numbers, from which the compiled part builds its own."""

from weakref import WeakKeyDictionary

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

_trees: WeakKeyDictionary = WeakKeyDictionary()
_workspaces: WeakKeyDictionary = WeakKeyDictionary()


def workspace(module, model, data=None):
    """The compiled workspace that belongs to Pinocchio's `data`, a new one without; trees are built once per model."""
    if data is not None and (found := _workspaces.get(data)) is not None:
        return found
    tree = _trees.get(model)
    if tree is None:
        tree = _trees[model] = _built(module, model)
    found = module.Workspace(tree)
    if data is not None:
        _workspaces[data] = found
    return found


def _built(module, model):
    branches = []
    for i in range(1, model.njoints):
        inertia = model.inertias[i]
        branches.append(
            module.Branch(
                joint=_joint(module, model.joints[i].extract()),
                parent=int(model.parents[i]),
                placement=model.jointPlacements[i].homogeneous,
                mass=inertia.mass,
                centre=inertia.lever,
                inertia=inertia.inertia,
            )
        )
    return module.Tree(branches, model.armature, model.gravity.linear)


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
