"""Mechanism → SDF 1.9. The links stand where the loops are closed, since an SDF joint has one pose.

Positions of joints are therefore counted from there: a joint that stands at 0.3 rad is at zero in the file, and its
limits, the rest of its spring and the offset of what follows it are counted from there, too.
"""

from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np
import pinocchio as pin

from ..mechanism.checks import places
from ..mechanism.forces import Actuator, SpringDamper
from ..mechanism.forces.force import label_of
from ..mechanism.loops import Loop
from .reading import text
from .saying import Motion1, Said, Unsaid, in_world, require_same_motion, said
from .urdf import INERTIA

_JOINTS = {"revolute": "revolute", "prismatic": "prismatic", "ball": "ball", "helical": "screw"}
_LOOPS = {"point": "ball", "hinge": "revolute", "slider": "prismatic", "frame": "fixed", "universal": "universal"}
WORLD = "world"


def document(mechanism, name: str, links, frames) -> str:
    """The text of a mechanism; Unsaid for what SDF cannot say. `frames` are (name, joint, placement)."""
    taken = {*mechanism.joints, *(loop.name for loop in mechanism.loops), WORLD}  # no two elements have one name
    links = [_unused(link, taken, "_link") for link in links]
    parts = said(mechanism, "SDF", links)
    root = Element("sdf", version="1.9")
    world = SubElement(root, "world", name=name)
    _text(world, "gravity", mechanism.model.gravity.linear)
    model = SubElement(world, "model", name=name)
    follows = _followers(parts)
    for joint in parts.joints:
        _link(model, parts, joint)
    for joint in parts.joints:
        _joint(model, parts, joint, follows.get(joint.name))
    for loop in parts.loops:
        _loop(model, parts, loop)
    for frame, joint, place in frames:
        if joint:
            own = SubElement(model, "frame", name=_unused(frame, taken, "_frame"), attached_to=links[joint])
            _pose(own, place)
    for force in parts.forces:
        _force(model, parts, force)
    if any(str(each.tag).startswith("drake:") for each in root.iter()):
        root.set("xmlns:drake", "http://drake.mit.edu")
    indent(root)
    return '<?xml version="1.0"?>\n' + tostring(root, encoding="unicode") + "\n"


def _unused(name, taken, ending) -> str:
    while name in taken:
        name += ending
    taken.add(name)
    return name


def floats(mechanism) -> bool:
    """Whether nothing is joined to the world, which is how SDF says that a model floats."""
    model = mechanism.model
    joined = any(not parent and nv != 6 for parent, nv in list(zip(model.parents, model.nvs, strict=True))[1:])
    anchored = (loop for loop in mechanism.loops if isinstance(loop, Loop))
    frames = [model.frames[model.getFrameId(each)] for loop in anchored for each in (loop.frame1, loop.frame2)]
    return not joined and all(frame.parentJoint for frame in frames)


def require_same(mechanism, back) -> None:
    """Raise Unsaid unless the file that was read back is the same machine."""
    q = said(mechanism, "SDF", [""] * mechanism.model.njoints).q
    model, float_in_world = mechanism.model, in_world(mechanism)

    def convert(name, own):
        i = model.getJointId(name)
        at = q[places(model, i)[0]]
        if model.nqs[i] == 1:
            return own - at
        if model.nqs[i] == 4:
            one, two = (pin.Quaternion(np.array(each)) for each in (at, own))
            return (one.inverse() * two).coeffs()
        return float_in_world(name, own)

    require_same_motion(mechanism, back, convert)


def _text(parent, tag, *values):
    node = SubElement(parent, tag)
    node.text = text(*np.ravel(values)) if values and not isinstance(values[0], str) else values[0]
    return node


def _pose(parent, place, **attributes):
    node = SubElement(parent, "pose", attributes)
    node.set("rotation_format", "quat_xyzw")
    node.text = text(*place.translation, *pin.Quaternion(place.rotation).coeffs())


def _link(model, parts: Said, joint: Motion1):
    link = SubElement(model, "link", name=parts.links[joint.index])
    _pose(link, parts.poses[joint.index])
    own = parts.mechanism.model.inertias[joint.index]
    node = SubElement(link, "inertial")
    _pose(node, pin.SE3(np.eye(3), own.lever))
    _text(node, "mass", own.mass)
    inertia = SubElement(node, "inertia")
    for key, value in zip(INERTIA, own.inertia[np.triu_indices(3)], strict=True):
        _text(inertia, key, value)


def _joint(model, parts: Said, joint: Motion1, follows):
    if joint.kind == "free":
        several = sum(each.kind == "free" for each in parts.joints) > 1
        if parts.mechanism.model.parents[joint.index] or several:
            raise Unsaid(f"SDF has no free joint between bodies, as {joint.name!r} is; one body of a model can float")
        return
    if joint.kind not in _JOINTS:
        raise Unsaid(f"SDF has no joint like {joint.name!r}, which is {joint.kind}")
    if joint.armature:
        if joint.axis is None:
            raise Unsaid(f"SDF has no rotor inertia for joint {joint.name!r}, which has several axes")
    parent = parts.mechanism.model.parents[joint.index]
    node = SubElement(model, "joint", name=joint.name, type=_JOINTS[joint.kind])
    _text(node, "parent", parts.links[parent] if parent else WORLD)
    _text(node, "child", parts.links[joint.index])
    if joint.kind == "helical":
        _text(node, "screw_thread_pitch", 2 * np.pi * joint.pitch)
    if joint.armature:
        _text(node, "drake:rotor_inertia", joint.armature)
    axis = SubElement(node, "axis")
    if joint.axis is not None:
        _text(axis, "xyz", joint.axis)
    at = parts.q[parts.mechanism.model.idx_qs[joint.index]] if joint.axis is not None else 0.0
    _dynamics(axis, joint, at)
    _limits(axis, joint, at)
    if follows is not None:
        other, ratio, offset = follows
        mimic = SubElement(axis, "mimic", joint=other)
        for tag, value in (("multiplier", ratio), ("offset", offset), ("reference", 0.0)):
            _text(mimic, tag, value)


def _dynamics(axis, joint, at):
    if not (joint.damping or joint.friction or joint.stiffness):
        return
    if joint.stiffness and joint.axis is None:
        raise Unsaid(f"SDF has no spring for joint {joint.name!r}, which has several axes")
    dynamics = SubElement(axis, "dynamics")
    _text(dynamics, "damping", joint.damping)
    _text(dynamics, "friction", joint.friction)
    if joint.stiffness:
        _text(dynamics, "spring_stiffness", joint.stiffness)
        _text(dynamics, "spring_reference", joint.rest - at)


def _limits(axis, joint, at):
    given = {"lower": joint.lower - at, "upper": joint.upper - at, "effort": joint.effort}
    given = {tag: value for tag, value in given.items() if abs(value) < 1e16}
    if given and joint.axis is not None:
        limit = SubElement(axis, "limit")
        for tag, value in given.items():
            _text(limit, tag, value)


def _loop(model, parts: Said, loop):
    if loop.kind == "distance":
        _points(model, parts, "distance_constraint", [parts.anchor(loop, end) for end in (1, 2)], distance=loop.length)
        return
    if loop.kind not in _LOOPS:
        raise Unsaid(f"SDF has no joint like the loop {loop.name!r}, of kind {loop.kind!r}")
    (joint1, place1), (joint2, place2) = (parts.anchor(loop, end) for end in (1, 2))
    axes = [np.array(each) for each in (loop.axis, loop.axis2) if each is not None]
    pose1, pose2 = parts.poses[joint1] * place1, parts.poses[joint2] * place2
    if len(axes) == 2:
        axes[1] = pose1.rotation.T @ pose2.rotation @ axes[1]
    parent, child, there = joint1, joint2, pose1
    if child == 0:
        parent, child, there, axes = child, parent, pose2, axes[::-1]
        turn = pose2.rotation.T @ pose1.rotation
        axes = [turn @ axis for axis in axes] if len(axes) == 2 else axes
    node = SubElement(model, "joint", name=loop.name, type=_LOOPS[loop.kind])
    _text(node, "parent", parts.links[parent] if parent else WORLD)
    _text(node, "child", parts.links[child])
    _pose(node, parts.poses[child].actInv(there))
    for tag, direction in zip(("axis", "axis2"), axes, strict=False):
        _text(SubElement(node, tag), "xyz", direction)
    simbody = SubElement(SubElement(node, "physics"), "simbody")
    _text(simbody, "must_be_loop_joint", "true")


def _followers(parts: Said) -> dict:
    """Joint → (its leader, ratio, offset), counted from where the joints stand."""
    model, found = parts.mechanism.model, {}
    for coupling in parts.couplings:
        whole = [joint for joint in parts.joints if joint.name in coupling.joints]
        plain = isinstance(coupling.joint, str) and isinstance(coupling.other, str) and not any(coupling.higher)
        if not plain or any(joint.axis is None for joint in whole) or coupling.joint in found:
            raise Unsaid(f"SDF has no mimic joint like the coupling {coupling.name!r}: one joint, linear in another")
        at = {joint.name: parts.q[model.idx_qs[joint.index]] for joint in whole}
        offset = coupling.offset + coupling.ratio * at[coupling.other] - at[coupling.joint]
        found[coupling.joint] = coupling.other, coupling.ratio, offset
    return found


def _points(model, parts, tag, ends, **numbers):
    """An element of Drake between two points, (joint, placement) each."""
    node = SubElement(model, f"drake:{tag}")
    for (joint, place), (body, point) in zip(ends, (("A", "p_AP"), ("B", "p_BQ")), strict=True):
        _text(node, f"drake:{tag}_body_{body}", parts.links[joint] if joint else WORLD)
        _text(node, f"drake:{tag}_{point}", place.translation)
    for word, value in numbers.items():
        _text(node, f"drake:{tag}_{word}", value)


def _force(model, parts, force):
    if isinstance(force, SpringDamper):
        bound = force.bind(parts.mechanism.model).ends
        ends = [(joint, pin.SE3(np.eye(3), np.array(point))) for joint, point in bound]
        numbers = {"free_length": force.length, "stiffness": force.stiffness, "damping": force.damping}
        _points(model, parts, "linear_spring_damper", ends, **numbers)
        return
    plain = isinstance(force, Actuator) and isinstance(force.joint, str) and force.gear == 1.0
    if not plain or force.gain != (1.0, 0.0, 0.0) or any(force.bias) or force.control != 0.0 or force.control_range:
        label = label_of(force)
        raise Unsaid(f"SDF has no force like {label!r}; leave it out: mech.with_forces(…)")
    plugin = SubElement(model, "plugin", name="gz::sim::systems::ApplyJointForce")
    plugin.set("filename", "gz-sim-apply-joint-force-system")
    _text(plugin, "joint_name", force.joint)
