"""Controllers of Gazebo, plugins of a model, as actuators of its joints.

``ApplyJointForce`` is a motor. ``JointPositionController`` holds ``<initial_position>`` by its proportional and
derivative gains, ``JointController`` with ``<use_force_commands>`` ``<initial_velocity>`` by its proportional one, both
within cmd_min … cmd_max; the joint's effort limit counts, too. Integral gains are left out. Source: API of gz-sim.
"""

import math

from ...mechanism.checks import warn
from ...mechanism.forces import Actuator
from .frames import join

_LAWS = {  # default gains (proportional, integral, derivative), what says that forces act, and the first command
    "ApplyJointForce": ((0.0, 0.0, 0.0), "", ""),
    "JointPositionController": ((1.0, 0.1, 0.01), "use_velocity_commands", "initial_position"),
    "JointController": ((1.0, 0.0, 0.0), "use_force_commands", "initial_velocity"),
}
_GAINS = ("p_gain", "i_gain", "d_gain")


def actuators(document, joints, model) -> tuple[Actuator, ...]:
    """The actuators of a file, called as their joints are; a warning for what exerts no force here."""
    known, found = {joint.name: joint for joint in joints}, {}
    for node, scope in document.plugins:
        kind = node.get("name").rpartition("::")[2]
        for given in node.children("joint_name") if kind in _LAWS else ():
            short = document.lookup.short(join(scope, given.text()))
            joint = known.get(short) or known.get(f"{short}_joint")
            if joint is None:
                raise given.error(f"there is no joint {short[:80]!r}")
            number = int(node.value("joint_index"))
            name = joint.parts[number] if (there := 0 <= number < len(joint.parts)) else joint.name
            reasons = {
                "its joint closes a loop, or has no such axis": not (there and model.existJointName(name))
                or model.nvs[model.getJointId(name)] != 1,
                "it moves its joint whatever that takes, as a Drive does": kind != "ApplyJointForce"
                and node.flag(_LAWS[kind][1]) == (kind == "JointPositionController"),
            }
            if why := next((reason for reason, holds in reasons.items() if holds), ""):
                warn(f"{kind} {name!r}: it exerts no force here: {why}")
                continue
            label = name if name not in found else f"{name} {len(found) + 1}"
            found[label] = _actuator(label, name, kind, node, joint.axes[number].effort)
    return tuple(found.values())


def _actuator(label, joint, kind, node, effort) -> Actuator:
    """u by itself, p (u - θ) - d θ', or p (u - θ'), in Gazebo's limits."""
    defaults, _, first = _LAWS[kind]
    ends = () if math.isinf(effort) else (-effort, effort)
    if kind == "ApplyJointForce":
        return Actuator(label, joint, force_range=ends)
    p, i, d = (node.value(tag, default) for tag, default in zip(_GAINS, defaults, strict=True))
    offset, holds = node.value("cmd_offset"), kind == "JointPositionController"
    for tag, gain in (("i_gain", i), *(() if holds else (("d_gain", d),))):
        if gain:
            warn(f"{kind} {joint!r}: its {tag} of {gain:g} is left out")
    low, high = node.value("cmd_min", -1000.0), node.value("cmd_max", 1000.0)
    if low <= high:
        ends = tuple(min(max(end, -effort), effort) for end in (low, high))
    bias = (offset, -p, -d) if holds else (offset, 0.0, -p)
    return Actuator(label, joint, (p, 0.0, 0.0), bias, control=node.value(first), force_range=ends)
