"""Motors in robot files: transmissions of URDF, and Gazebo's controllers, which are plugins of an SDF model.

The reduction n, ``<mechanicalReduction>``, may stand in the actuator, the joint or the transmission. The command of the
actuator is the motor's torque in N·m; n times this torque acts on the joint, within the joint's effort limit.
``<rotorInertia>`` (or ``<motorInertia>``) of the actuator, in kg·m², is multiplied by n² and added to the armature.

``DifferentialTransmission`` and ``FourBarLinkageTransmission`` connect two actuators and two joints, in the order of
their roles, by the equations of ROS: each actuator and each joint has a reduction, and there are no limits. If the
rotors couple the inertias of the two joints, only the diagonal terms are used, with a warning. Other transmissions
exert no force, also with a warning.

``ApplyJointForce`` is a motor. ``JointPositionController`` holds ``<initial_position>`` with its proportional and
derivative gains; ``JointController`` with ``<use_force_commands>`` holds ``<initial_velocity>`` with its proportional
gain. Both stay within cmd_min … cmd_max and the joint's effort limit. Integral gains are ignored, with a warning.
Source: API of gz-sim.
"""

import math
from xml.etree.ElementTree import Element

import numpy as np

from ..mechanism.checks import warn
from ..mechanism.forces import Actuator
from .reading import Node, floats

_INERTIAS = ("rotorInertia", "motorInertia")
_REDUCTION = ("mechanicalReduction",)
_MIXED = {  # reductions of two joints → for each actuator, its factor on each joint
    "DifferentialTransmission": lambda first, second: ((first, second), (first, -second)),
    "FourBarLinkageTransmission": lambda first, second: ((first, -first * second), (0.0, second)),
}
_LAWS = {  # default gains (proportional, integral, derivative), flag of the command mode, element of the command
    "ApplyJointForce": ((0.0, 0.0, 0.0), "", ""),
    "JointPositionController": ((1.0, 0.1, 0.01), "use_velocity_commands", "initial_position"),
    "JointController": ((1.0, 0.0, 0.0), "use_force_commands", "initial_velocity"),
}
_GAINS = ("p_gain", "i_gain", "d_gain")


def transmissions(robot: Element, model, unlimited: float) -> tuple[Actuator, ...]:
    """The actuators of a URDF file; adds their rotors to the armature of the model."""
    found: dict[str, Actuator] = {}
    for number, node in enumerate(Node(robot).children("transmission"), start=1):
        node.name = f"transmission {(node.get('name') or str(number))!r}"
        joints, actuators = (
            sorted(node.children(tag), key=lambda each: each.child("role").text()) for tag in ("joint", "actuator")
        )
        mixed = _MIXED.get(node.child("type").text().rpartition("/")[2])
        if len(joints) != (count := 2 if mixed else 1) or len(actuators) != count:
            if joints or actuators:
                warn(f"{node.name}: it exerts no force here: it connects several actuators or joints")
            continue
        names, known = [joint.get("name") for joint in joints], list(model.names)[1:]
        wrong = [name for name in names if name not in known or model.nvs[model.getJointId(name)] != 1]
        if wrong:
            warn(f"{node.name}: it exerts no force here: {wrong[0]!r} is not a joint with one degree of freedom")
            continue
        columns = [model.idx_vs[model.getJointId(name)] for name in names]
        rows = mixed(*(_number(_REDUCTION, (joint,), 1.0) for joint in joints)) if mixed else ((1.0,),)
        coupled = np.zeros((count, count))
        for actuator, row in zip(actuators, rows, strict=True):
            reduction = _number(_REDUCTION, (actuator,) if mixed else (actuator, joints[0], node), 1.0)
            inertia, arms = _number(_INERTIAS, (actuator,), 0.0), reduction * np.array(row)
            if not arms.any() or inertia < 0.0:
                raise node.error("a reduction is zero, or a rotor inertia is negative")
            coupled += inertia * np.outer(arms, arms)
            shares = {name: share for name, share in zip(names, row, strict=True) if share}
            motor = actuator.get("name") or names[0]
            label = motor if motor not in found else f"{motor} {number}"
            limit = float(model.upperEffortLimit[columns[0]])
            ends = (-limit / abs(reduction), limit / abs(reduction)) if 0.0 < limit < unlimited and not mixed else ()
            found[label] = Actuator(label, shares if mixed else names[0], gear=reduction, force_range=ends)
        model.armature[columns] += np.diagonal(coupled)
        if np.abs(coupled - np.diag(np.diagonal(coupled))).max() > 1e-12 * np.abs(coupled).max():
            warn(f"{node.name}: its rotors couple the two joints, which is ignored")
    return tuple(found.values())


def _number(tags, nodes, default) -> float:
    """The number in the first of the elements `tags` that is found in one of the nodes."""
    children = (child for node in nodes for tag in tags if (child := node.child(tag)))
    return next((floats(child.text(), 1, child.name)[0] for child in children), default)


def controllers(document, joints, model) -> tuple[Actuator, ...]:
    """The actuators of an SDF file, named after their joints; warns of controllers that exert no force here."""
    known, found = {joint.name: joint for joint in joints}, {}
    for node, scope in document.plugins:
        kind = node.get("name").rpartition("::")[2]
        for given in node.children("joint_name") if kind in _LAWS else ():
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
                and node.flag(_LAWS[kind][1]) == (kind == "JointPositionController"),
            }
            if why := next((reason for reason, holds in reasons.items() if holds), ""):
                warn(f"{kind} {name!r}: it exerts no force here: {why}")
                continue
            label = name if name not in found else f"{name} {len(found) + 1}"
            found[label] = _controller(label, name, kind, node, joint.axes[number].effort)
    return tuple(found.values())


def _controller(label, joint, kind, node, effort) -> Actuator:
    """The force u, p (u - θ) - d θ', or p (u - θ'), within Gazebo's limits."""
    defaults, _, first = _LAWS[kind]
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
