"""Bodies of MJCF → the tree of a pin.Model.

Several joints of one body become a chain of joints with massless bodies between them: Pinocchio's composite joints have
wrong ``computeRNEADerivatives``. The value of a joint is MuJoCo's ``qpos``: ``ref`` where its body stands as the file
places it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ...errors import FormatError
from ...mechanism.forces import JointSpring, Wrench
from .bodies import Body
from .inertia import TINY, body_inertia, scaled
from .joints import Joint
from .names import FrameNames
from .settings import Compiler, Option

_AXES = {(1.0, 0.0, 0.0): "X", (0.0, 1.0, 0.0): "Y", (0.0, 0.0, 1.0): "Z"}
_ALIGNED = {
    "hinge": {"X": pin.JointModelRX, "Y": pin.JointModelRY, "Z": pin.JointModelRZ},
    "slide": {"X": pin.JointModelPX, "Y": pin.JointModelPY, "Z": pin.JointModelPZ},
}
_UNALIGNED = {"hinge": pin.JointModelRevoluteUnaligned, "slide": pin.JointModelPrismaticUnaligned}
_ROUND = {"ball": pin.JointModelSpherical, "free": pin.JointModelFreeFlyer}


@dataclass(frozen=True)
class Tree:
    """What became of the bodies.

    Attributes
    ----------
    model : pin.Model
    names : FrameNames
    reference : ndarray, shape (nq,)
        The configuration in which the bodies stand as the file places them, MuJoCo's ``qpos0``.
    joints : dict[str, Joint]
        The joints by name, in the order of the model.
    forces : tuple
        Springs of joints, and forces that compensate gravity.
    """

    model: pin.Model
    names: FrameNames
    reference: np.ndarray
    joints: dict[str, Joint]
    forces: tuple


def build(bodies: list[Body], compiler: Compiler, option: Option, name: str) -> Tree:
    """The tree of all bodies; FormatError where an inertia is impossible or not known."""
    model, names = pin.Model(), FrameNames(bodies)
    model.name, model.gravity.linear = name, np.array(option.gravity)
    joints, reference, stands = {}, [], []
    for body, link, joint_names in zip(bodies, names.links, names.joints, strict=True):
        joint, place, frame = stands[body.parent] if stands else (0, pin.SE3.Identity(), 0)
        place = place * body.place
        for joint_name, record in zip(joint_names, body.joints, strict=True):
            before, after, values = _motion(record, place)
            joint = model.addJoint(joint, _joint_model(record), before, joint_name)
            frame = model.addJointFrame(joint, frame)
            _set_numbers(model, joint, record, option.disabled)
            joints[joint_name], place = record, after
            reference += values
        frame = model.addBodyFrame(link, joint, place, frame)
        stands.append((joint, place, frame))
        for site, at in body.sites.items():
            model.addFrame(pin.Frame(names.sites[site], joint, frame, place * at, pin.FrameType.OP_FRAME))
    inertias = _inertias(bodies, [joint > 0 for joint, _, _ in stands], compiler)
    for (joint, place, _), inertia in zip(stands, inertias, strict=True):
        if joint:
            model.appendBodyToJoint(joint, inertia, place)
    forces = [] if "spring" in option.disabled else _springs(joints)
    if not {"spring", "damper"} <= option.disabled:  # MuJoCo switches off all passive forces with both
        forces += _lifts(bodies, names, inertias, model.gravity.linear)
    return Tree(model, names, np.array(reference), joints, tuple(forces))


def _motion(record: Joint, place: pin.SE3):
    """Where a joint stands on the body before it, where the body stands on it, and its value in the reference."""
    there, back = pin.SE3(np.eye(3), record.pos), pin.SE3(np.eye(3), -record.pos)
    if record.kind == "hinge":
        turn = pin.SE3(pin.AngleAxis(-record.ref, record.axis).toRotationMatrix(), np.zeros(3))
        return place * there * turn, back, [record.ref]
    if record.kind == "slide":
        return place * pin.SE3(np.eye(3), -record.ref * record.axis), pin.SE3.Identity(), [record.ref]
    if record.kind == "ball":
        return place * there, back, [0.0, 0.0, 0.0, 1.0]
    return pin.SE3.Identity(), pin.SE3.Identity(), list(pin.SE3ToXYZQUAT(place))


def _joint_model(record: Joint):
    if record.kind in _ROUND:
        return _ROUND[record.kind]()
    aligned = _AXES.get(tuple(record.axis.tolist()))
    return _ALIGNED[record.kind][aligned]() if aligned else _UNALIGNED[record.kind](record.axis)


def _set_numbers(model, joint, record, disabled):
    v = slice(model.idx_vs[joint], model.idx_vs[joint] + model.nvs[joint])
    model.armature[v] = record.armature
    model.damping[v] = 0.0 if "damper" in disabled else record.damping
    friction = 0.0 if {"frictionloss", "constraint"} & disabled else record.frictionloss
    model.lowerDryFrictionLimit[v], model.upperDryFrictionLimit[v] = -friction, friction
    if model.nqs[joint] == 1:
        q = model.idx_qs[joint]
        model.lowerPositionLimit[q], model.upperPositionLimit[q] = record.limits


def _springs(joints):
    return [JointSpring(name, joint.stiffness, joint.springref) for name, joint in joints.items() if joint.stiffness]


def _lifts(bodies, names, inertias, gravity):
    """The forces of `gravcomp`, which carry a share of the weight of a body."""
    return [
        Wrench(link, tuple(-body.gravcomp * inertia.mass * gravity), xyz=tuple(inertia.lever))
        for body, link, inertia in zip(bodies, names.links, inertias, strict=True)
        if body.gravcomp and inertia.mass
    ]


def _inertias(bodies, moving, compiler):
    """The inertia of each body in its axes, zero for those that do not move."""
    nothing, of_all = pin.Inertia.Zero(), compiler.totalmass > 0
    inertias = [nothing]
    for body, moves in zip(bodies[1:], moving[1:], strict=True):
        parts = body.inertial, body.geoms, body.place
        inertias.append(body_inertia(*parts, compiler, body.element) if moves or of_all else nothing)
    if of_all:
        total = sum(inertia.mass for inertia in inertias)
        if total < TINY:
            raise FormatError("settotalmass: no body has a mass that could be scaled", element="compiler")
        inertias = [scaled(each, compiler.totalmass / total, "compiler: settotalmass") for each in inertias]
    return [inertia if moves else nothing for inertia, moves in zip(inertias, moving, strict=True)]
