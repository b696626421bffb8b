"""Joints of SDF: types, axes, joint forces, gearboxes, mimic joints, and Gazebo's controllers, plugins of a model.

``ApplyJointForce`` is a motor. ``JointPositionController`` holds ``<initial_position>`` with its proportional and
derivative gains; ``JointController`` with ``<use_force_commands>`` holds ``<initial_velocity>`` with its proportional
gain. Both stay within cmd_min … cmd_max and the joint's effort limit. Integral gains are ignored, with a warning.
Source: API of gz-sim.
"""

import math
from dataclasses import replace

import numpy as np

from ...errors import warn
from ...mechanism.forces import Actuator
from ...mechanism.loops import unit
from ..graph import Axis, Follower, Joint
from ..reading import DRAKE
from .document import FRAMES, WORLD, Document, SdfNode

AXES = dict.fromkeys(("revolute", "continuous", "prismatic", "screw"), 1) | dict.fromkeys(
    ("ball", "fixed", "planar"), 0
)
AXES |= dict.fromkeys(("universal", "revolute2", "gearbox"), 2)
"""Joint type → its number of axes."""
PARALLEL = 1e-6  # sine of the angle between two axes below which they count as parallel
_PARTS = ("parent", "child", "pose", "axis", "axis2", "physics", "sensor", "gearbox_ratio", "gearbox_reference_body")
_PARTS += ("thread_pitch", "screw_thread_pitch", "damping")
_IN_AXIS = ("xyz", "dynamics", "limit", "mimic", "use_parent_model_frame", "initial_position")
LAWS = {  # default gains (proportional, integral, derivative), flag of the command mode, element of the command
    "ApplyJointForce": ((0.0, 0.0, 0.0), "", ""),
    "JointPositionController": ((1.0, 0.1, 0.01), "use_velocity_commands", "initial_position"),
    "JointController": ((1.0, 0.0, 0.0), "use_force_commands", "initial_velocity"),
}
_GAINS = ("p_gain", "i_gain", "d_gain")


def read_joints(document: Document) -> list[Joint]:
    """The joints of a file, without those in static models; FormatError for the first invalid one."""
    return [_Reader(document, scope).joint(full, node) for full, node, scope in document.joints]


class _Reader:
    def __init__(self, document, scope):
        self.document, self.version, self.scope = document, document.version_of(scope), scope

    def joint(self, full, node) -> Joint:
        name = self.document.short(full)
        node.name = f"joint {name!r}"
        node.warn_unknown(_PARTS)
        kind = node.get("type").lower()
        if kind not in AXES:
            raise node.error(f"type {node.get('type')[:40]!r} is not one of {', '.join(AXES)}")
        parent, child = self._body(node, "parent"), self._body(node, "child")
        if child == WORLD:
            raise node.error("the world cannot be a child; exchange parent and child")
        if parent == child:
            raise node.error(f"parent and child are the same body {parent!r}")
        pose = self.document.pose(full)
        axes = tuple(self._axis(node.child(tag), pose) for tag in ("axis", "axis2")[: AXES[kind]])
        if kind in ("universal", "revolute2"):
            if np.linalg.norm(np.cross(axes[0].direction, axes[1].direction)) < PARALLEL:
                raise node.error("its two axes are parallel")
        elif kind == "continuous":
            axes = (replace(axes[0], lower=-math.inf, upper=math.inf),)
        elif kind == "ball":
            axes = (_ball(node.child("axis")),)
        elif kind == "planar":
            kind, axes = "compound", _planar(node)
        pitch = _pitch(node) if kind == "screw" else 0.0
        ratio = node.value("gearbox_ratio", 1.0)
        reference = self._body(node, "gearbox_reference_body") if kind == "gearbox" else ""
        must_cut = node.child("physics").child("simbody").flag("must_be_loop_joint")
        kind = {"continuous": "revolute", "revolute2": "universal"}.get(kind, kind)
        armature = _armature(node)
        ends = [pose if body == WORLD else self.document.bodies[body].pose.actInv(pose) for body in (parent, child)]
        return Joint(name, kind, parent, child, *ends, axes, pitch, ratio, reference, must_cut, armature)

    def _body(self, node, tag):
        return self.document.body(self.document.resolve(self.scope, node.word(tag), f"{node.name}: {tag}"))

    def _axis(self, node, pose) -> Axis:
        if not node:
            warn(f"{node.name}: the element is missing, and the axis is z, the default of SDF")
        node.warn_unknown(_IN_AXIS)
        direction = np.array(node.values("xyz", (0.0, 0.0, 1.0)))
        if not direction.any():
            raise node.error("the axis is the zero vector")
        direction = unit(direction)
        if frame := self._expressed_in(node):
            there = self.document.pose(self.document.resolve(self.scope, frame, f"{node.name}: xyz"))
            direction = pose.rotation.T @ there.rotation @ direction
        limits = node.child("limit")
        lower, upper = limits.limit("lower", -math.inf), limits.limit("upper", math.inf)
        if lower > upper:
            raise limits.error(f"lower {lower:g} is above upper {upper:g}; exchange them")
        largest = [limits.limit(tag, math.inf) for tag in ("effort", "velocity")]
        bounds = (lower, upper, *(each if each >= 0 else math.inf for each in largest))  # negative: not enforced
        acting, follows = _dynamics(node.child("dynamics")), self._follower(node.child("mimic"))
        return Axis(direction, *acting, *bounds, node.value("initial_position"), follows)

    def _expressed_in(self, node):
        """The frame in which an axis is expressed; empty: the joint's own."""
        frame = node.child("xyz").get("expressed_in")
        if self.version <= (1, 4):
            return "__model__"
        if self.version < FRAMES and not frame:  # the flag was later replaced by expressed_in
            return "__model__" if node.flag("use_parent_model_frame") else ""
        return frame

    def _follower(self, node):
        if not node:
            return None
        axis, axes = node.get("axis") or "axis", ("axis", "axis2")
        if axis not in axes:
            raise node.error(f"axis={axis[:40]!r} is neither axis nor axis2")
        ratio, offset = node.value("multiplier", 1.0), node.value("offset")
        leader = self.document.short_in(self.scope, node.get("joint"))
        return Follower(leader, axes.index(axis), ratio, offset - ratio * node.value("reference"))


def _ball(node):
    """The axis of a ball: simulators apply its damping and friction about all axes; its direction has no meaning."""
    damping, friction, stiffness, _ = _dynamics(node.child("dynamics"))
    if stiffness:
        raise node.error("a ball joint has no axis about which a spring could act")
    return Axis(np.zeros(3), damping, friction)


def _planar(node):
    """The axes of a planar joint of Drake, which moves in the x-y plane of its frame."""
    damping = node.values("damping", (0.0, 0.0, 0.0))
    axes = zip(np.eye(3), damping, ("prismatic", "prismatic", "revolute"), ("x", "y", "turn"), strict=True)
    return tuple(Axis(axis, each, kind=kind, label=label) for axis, each, kind, label in axes)


def _dynamics(node: SdfNode) -> list[float]:
    """Damping, friction, stiffness and reference, as in :class:`Axis`."""
    values = []
    for tag in ("damping", "friction", "spring_stiffness"):
        values.append(node.value(tag))
        if values[-1] < 0:
            raise node.child(tag).error(f"{values[-1]:g} is negative")
    return [*values, node.value("spring_reference")]


def _armature(node: SdfNode) -> float:
    """The inertia of a motor's rotor as the joint feels it: the gear ratio squared times the rotor inertia."""
    inertia, gear = node.value(DRAKE + "rotor_inertia"), node.value(DRAKE + "gear_ratio", 1.0)
    if inertia < 0.0:
        raise node.error(f"its rotor inertia is negative: {inertia:g}")
    return gear**2 * inertia


def add_armature(joints, model) -> None:
    """Add the rotors of the joints of a file to the armature of the model; warns of those without effect."""
    for joint in joints:
        if not joint.armature:
            continue
        if len(joint.parts) == 1 and model.existJointName(joint.name):
            i = model.getJointId(joint.name)
            if model.nvs[i] == 1:
                model.armature[model.idx_vs[i]] += joint.armature
                continue
        warn(f"joint {joint.name!r}: its rotor inertia has no effect: it closes a loop or does not have one axis")


def _pitch(node: SdfNode) -> float:
    """The pitch in m per revolution, positive for a right-handed thread, as in libsdformat.

    The older element ``thread_pitch`` is in rad per m, and positive for a left-handed thread.
    """
    old = node.child("thread_pitch")
    if node.child("screw_thread_pitch") or not old:
        return node.value("screw_thread_pitch", 1.0)
    pitch = node.value("thread_pitch")
    if abs(pitch) < 1e-100:
        raise old.error("zero means infinite travel")
    return -2 * math.pi / pitch


def controllers(document, joints, model) -> tuple[Actuator, ...]:
    """The actuators of an SDF file, named after their joints; warns of controllers that exert no force here."""
    known, found = {joint.name: joint for joint in joints}, {}
    for node, scope in document.plugins:
        kind = node.get("name").rpartition("::")[2]
        for given in node.children("joint_name") if kind in LAWS else ():
            short = document.short_in(scope, given.text())
            joint = known.get(short) or known.get(f"{short}_joint")
            if joint is None:
                raise given.error(f"there is no joint {short[:80]!r}")
            number = int(node.value("joint_index"))
            name = joint.parts[number] if (there := 0 <= number < len(joint.parts)) else joint.name
            reasons = {
                "its joint closes a loop, or has no such axis": not (there and model.existJointName(name))
                or model.nvs[model.getJointId(name)] != 1,
                "it prescribes the motion of its joint, as a Drive does": kind != "ApplyJointForce"
                and node.flag(LAWS[kind][1]) == (kind == "JointPositionController"),
            }
            if why := next((reason for reason, holds in reasons.items() if holds), ""):
                warn(f"{kind} {name!r}: it exerts no force here: {why}")
                continue
            label = name if name not in found else f"{name} {len(found) + 1}"
            found[label] = _controller(label, name, kind, node, joint.axes[number].effort)
    return tuple(found.values())


def _controller(label, joint, kind, node, effort) -> Actuator:
    """The force u, p (u - θ) - d θ', or p (u - θ'), within Gazebo's limits."""
    defaults, _, first = LAWS[kind]
    ends = () if math.isinf(effort) else (-effort, effort)
    if kind == "ApplyJointForce":
        return Actuator(label, joint, force_range=ends)
    p, i, d = (node.value(tag, default) for tag, default in zip(_GAINS, defaults, strict=True))
    offset, holds = node.value("cmd_offset"), kind == "JointPositionController"
    for tag, gain in (("i_gain", i), *(() if holds else (("d_gain", d),))):
        if gain:
            warn(f"{kind} {joint!r}: its {tag} of {gain:g} is ignored")
    low, high = node.value("cmd_min", -1000.0), node.value("cmd_max", 1000.0)
    if low <= high:
        ends = tuple(min(max(end, -effort), effort) for end in (low, high))
    bias = (offset, -p, -d) if holds else (offset, 0.0, -p)
    return Actuator(label, joint, (p, 0.0, 0.0), bias, control=node.value(first), force_range=ends)
