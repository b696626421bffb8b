"""What a model must be so that Pinocchio's algorithms are right on it."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ..errors import InputError

ROTATION = 1e-6
"""How far from the unit matrix RᵀR of a placement may be."""


def check_model(model: pin.Model) -> None:
    """Refuse a model that makes Pinocchio's algorithms silently wrong, or whose inertias are impossible."""
    mimic = [name for name, joint in zip(model.names, model.joints, strict=True) if "Mimic" in joint.shortname()]
    if mimic:
        raise InputError(
            f"joint {mimic[0]!r} of model {model.name!r} is one of Pinocchio's mimic joints, which most of its "
            "algorithms do not support. Build the model without (mimic=False), with a Coupling among the loops; "
            "load() of the URDF file does that"
        )
    if model.nv == 0:
        raise InputError(f"model {model.name!r} has no joints: nothing can move")
    for joint in range(2, model.njoints):
        ancestors = set(model.supports[joint - 1])
        if model.parents[joint] not in ancestors:
            raise InputError(
                f"the joints of model {model.name!r} are not in depth-first order: {model.names[joint]!r} follows "
                f"{model.names[joint - 1]!r} but hangs on {model.names[model.parents[joint]]!r}. Pinocchio's crba and "
                "derivative algorithms are then silently wrong; add each branch completely before the next one"
            )
    for name, inertia in zip(model.names, model.inertias, strict=True):
        numbers = np.concatenate(([inertia.mass], inertia.lever, inertia.inertia.ravel()))
        if not np.isfinite(numbers).all():
            raise InputError(f"the inertia of the body at joint {name!r} is not finite")
        if inertia.mass < 0:
            raise InputError(f"the body at joint {name!r} has negative mass {inertia.mass:g} kg")
    _check_poses([pose for pose in model.jointPlacements], [f"joint {name!r}" for name in model.names])
    _check_poses([frame.placement for frame in model.frames], [f"frame {frame.name!r}" for frame in model.frames])
    if not np.isfinite(model.gravity.vector).all():
        raise InputError(f"the gravity of model {model.name!r} is not finite")
    bad = np.flatnonzero(~(np.isfinite(model.armature) & (model.armature >= 0)))
    if len(bad):
        joint = next(j for j in range(1, model.njoints) if bad[0] < model.idx_vs[j] + model.nvs[j])
        raise InputError(f"the armature of joint {model.names[joint]!r} is negative or not finite")


def _check_poses(poses, whose):
    places, turns = np.array([pose.translation for pose in poses]), np.array([pose.rotation for pose in poses])
    unit = np.abs(turns.transpose(0, 2, 1) @ turns - np.eye(3)).max(axis=(1, 2))
    wrong = np.flatnonzero(~(np.isfinite(places).all(axis=1) & (unit < ROTATION)))
    if len(wrong):
        raise InputError(f"the placement of {whose[wrong[0]]} is not finite, or its rotation matrix is none")
