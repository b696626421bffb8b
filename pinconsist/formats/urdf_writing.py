"""A Mechanism's tree → URDF text, and what of the tree URDF has no word for.

A joint's body is a link, named like the first body frame that lies on the joint; every other frame is a massless link
fixed where it lies. Numbers are written in full.
"""

from __future__ import annotations

from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np
import pinocchio as pin

from ..errors import InputError
from .model_settings import VALUES
from .urdf_tree import UNLIMITED
from .xml_reading import parsed, text

_REVOLUTE, _SLIDING = "revolute", "prismatic"
_TURNING = ("RX", "RY", "RZ", "RevoluteUnaligned")
_UNBOUNDED = ("RUBX", "RUBY", "RUBZ", "RevoluteUnboundedUnaligned")
_MOVING = ("PX", "PY", "PZ", "PrismaticUnaligned")
_SCREWS = ("HX", "HY", "HZ", "HelicalUnaligned")
_WHOLE = {  # joint → (type in URDF, axis, type in the loop file)
    "FreeFlyer": ("floating", None, None),
    "Planar": ("planar", (0.0, 0.0, 1.0), None),
    "Spherical": (_REVOLUTE, (1.0, 0.0, 0.0), "spherical"),
    "Translation": (_SLIDING, (1.0, 0.0, 0.0), "translation"),
}
_NO_MOTION = pin.SE3.Identity()


def urdf_text(mechanism, name: str) -> tuple[str, dict]:
    """A URDF document, and the settings of joints that stand in the loop file (its key ``joints``).

    Raises
    ------
    InputError
        A kind of joint that has no place in either.
    """
    model = mechanism.model
    robot = Element("robot", name=name)
    settings, names = {}, _Names(model)
    shapes = _shapes(mechanism.geometry)
    for joint in range(model.njoints):
        link = _link(robot, names.link[joint], shapes)
        if joint == 0 and model.inertias[0].mass == 0:
            continue
        _inertial(link, model.inertias[joint])
    for joint in range(1, model.njoints):
        given = _joint(robot, mechanism, joint, names.link)
        if given:
            settings[model.names[joint]] = given
    for mount, link, joint, place in names.mounted:
        _link(robot, link, shapes)
        _join(robot, mount, "fixed", names.link[joint], link, place)
    indent(robot)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + tostring(robot, encoding="unicode") + "\n", settings


class _Names:
    """Which link each joint carries, and the frames that are mounted on links: (joint name, link, joint, place)."""

    def __init__(self, model):
        self.joints = list(model.names)
        frames = list(enumerate(model.frames))[1:]
        bodies = [(i, frame) for i, frame in frames if frame.type == pin.FrameType.BODY]
        fixed = {i: frame for i, frame in frames if frame.type == pin.FrameType.FIXED_JOINT}
        self.taken_links = {"universe"} | {frame.name for _, frame in frames}
        self.taken_joints = set(self.joints) | {frame.name for frame in fixed.values()}
        self.link, carried, mounts = {}, set(), {}
        for i, frame in bodies:
            if frame.parentJoint not in self.link and _near(frame.placement, _NO_MOTION):
                self.link[frame.parentJoint] = frame.name
                carried.add(i)
            elif frame.parentFrame in fixed and _near(frame.placement, fixed[frame.parentFrame].placement):
                mounts.setdefault(frame.parentFrame, i)
        for joint in range(model.njoints):
            if joint not in self.link:
                self.link[joint] = self._new_link("ground" if joint == 0 else f"{model.names[joint]}_body")
        self.mounted = []
        for i, frame in fixed.items():
            body = mounts.get(i)
            link = model.frames[body].name if body else self._new_link(f"{frame.name}_body")
            carried |= {i, body}
            self.mounted.append((frame.name, link, frame.parentJoint, frame.placement))
        for i, frame in frames:
            of_joint = frame.name == model.names[frame.parentJoint] and _near(frame.placement, _NO_MOTION)
            if i not in carried and not of_joint:
                mount = self._new_joint(f"{frame.name}_mount")
                self.mounted.append((mount, frame.name, frame.parentJoint, frame.placement))

    def _new_link(self, name):
        return _unused(name, self.taken_links)

    def _new_joint(self, name):
        return _unused(name, self.taken_joints)


def _unused(name, taken):
    while name in taken:
        name += "_"
    taken.add(name)
    return name


def _near(place, other):
    return np.array_equal(place.homogeneous, other.homogeneous)


def _shapes(geometry):
    if geometry is None:
        return {}
    links = parsed(geometry.urdf.encode()).findall("link")
    return {link.get("name"): [*link.findall("visual"), *link.findall("collision")] for link in links}


def _link(robot, name, shapes):
    link = SubElement(robot, "link", name=name)
    link.extend(shapes.get(name, ()))
    return link


def _inertial(link, inertia):
    node = SubElement(link, "inertial")
    SubElement(node, "origin", xyz=text(*inertia.lever))
    SubElement(node, "mass", value=text(inertia.mass))
    I = inertia.inertia
    words = {f"i{'xyz'[i]}{'xyz'[j]}": text(I[i, j]) for i in range(3) for j in range(i, 3)}
    SubElement(node, "inertia", words)


def _join(robot, name, kind, parent, child, place):
    joint = SubElement(robot, "joint", name=name, type=kind)
    rpy = pin.rpy.matrixToRpy(place.rotation) + 0.0
    SubElement(joint, "origin", xyz=text(*place.translation), rpy=text(*rpy))
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)
    return joint


def _joint(robot, mechanism, joint, links):
    """Write a joint; returns what of it belongs into the loop file."""
    model, name = mechanism.model, mechanism.model.names[joint]
    kind, axis, replaced = _kind(mechanism, joint)
    parent = links[model.parents[joint]]
    node = _join(robot, name, kind, parent, links[joint], model.jointPlacements[joint])
    given = {} if replaced is None else {"type": replaced}
    start, size = model.idx_vs[joint], model.nvs[joint]
    values = {key: getattr(model, VALUES[key][0])[start : start + size].tolist() for key in VALUES}
    if axis is not None:
        SubElement(node, "axis", xyz=text(*axis))
    if size == 1:
        dynamics = {key: text(*values.pop(key)) for key in ("damping", "friction")}
        if set(dynamics.values()) != {"0"}:
            SubElement(node, "dynamics", dynamics)
        _limit(node, model, joint)
    for key, amounts in values.items():
        if any(amounts):
            given[key] = amounts if len(set(amounts)) > 1 else amounts[0]
    return given


def _limit(node, model, joint):
    q, v = model.idx_qs[joint], model.idx_vs[joint]
    limits = {"effort": model.upperEffortLimit[v], "velocity": model.upperVelocityLimit[v]}
    if model.nqs[joint] == 1:
        limits |= {"lower": model.lowerPositionLimit[q], "upper": model.upperPositionLimit[q]}
    given = {key: text(value) for key, value in limits.items() if abs(value) < UNLIMITED}
    if given:
        SubElement(node, "limit", given)


def _kind(mechanism, joint):
    """(type in URDF, axis, type in the loop file) of a joint."""
    model = mechanism.model
    which = model.joints[joint].shortname().removeprefix("JointModel")
    if which in _WHOLE:
        return _WHOLE[which]
    if which not in (*_TURNING, *_UNBOUNDED, *_MOVING, *_SCREWS):
        raise InputError(
            f"{mechanism.name}: joint {model.names[joint]!r} is a {which} joint, for which neither URDF nor a loop "
            "file has a word; build it of hinges and sliders"
        )
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    column = model.idx_vs[joint]
    twist = np.reshape(pin.getJointJacobian(model, data, joint, pin.LOCAL), (6, model.nv))[:, column]
    if which in _MOVING:
        return _SLIDING, twist[:3], None
    axis = twist[3:]
    if which in _SCREWS:
        return _REVOLUTE, axis, f"helical {float(twist[:3] @ axis)!r}"
    return _REVOLUTE, axis, "unbounded" if which in _UNBOUNDED else None
