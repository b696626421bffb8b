"""Transmissions of URDF files: motors, their reductions and rotor inertias, which act on joints.

``<mechanicalReduction>`` n is read in the actuator, the joint or the transmission; the command of the actuator is the
motor's torque, N·m, and n times that acts on the joint, within the joint's effort limit. ``<rotorInertia>`` (or
``<motorInertia>``) of the actuator, kg·m², adds n² times itself to the joint's armature.

A ``DifferentialTransmission`` and a ``FourBarLinkageTransmission`` of two actuators and two joints, in the order of
their roles, have the laws of ROS: actuators and joints have a reduction each, and no limit. Rotors that couple the two
joints do so in their armature alone, which a warning says. Other transmissions exert no force, and a warning says so.
"""

from xml.etree.ElementTree import Element

import numpy as np

from ..mechanism.checks import warn
from ..mechanism.forces import Actuator
from .reading import Node, floats

_INERTIAS = ("rotorInertia", "motorInertia")
_REDUCTION = ("mechanicalReduction",)
_MIXED = {  # reductions of two joints → of each actuator, what it turns in them
    "DifferentialTransmission": lambda first, second: ((first, second), (first, -second)),
    "FourBarLinkageTransmission": lambda first, second: ((first, -first * second), (0.0, second)),
}


def transmissions(robot: Element, model, unlimited: float) -> tuple[Actuator, ...]:
    """The actuators of a file; adds their rotors to the armature of the model."""
    found: dict[str, Actuator] = {}
    for number, node in enumerate(Node(robot).children("transmission"), start=1):
        node.name = f"transmission {(node.get('name') or str(number))!r}"
        joints, actuators = (
            sorted(node.children(tag), key=lambda each: _text(each, "role")) for tag in ("joint", "actuator")
        )
        mixed = _MIXED.get(_text(node, "type").rpartition("/")[2])
        if len(joints) != (count := 2 if mixed else 1) or len(actuators) != count:
            if joints or actuators:
                warn(f"{node.name}: it exerts no force here: it joins several actuators or joints")
            continue
        names, known = [joint.get("name") for joint in joints], list(model.names)[1:]
        wrong = [name for name in names if name not in known or model.nvs[model.getJointId(name)] != 1]
        if wrong:
            warn(f"{node.name}: it exerts no force here: {wrong[0]!r} is no joint with one degree of freedom")
            continue
        columns = [model.idx_vs[model.getJointId(name)] for name in names]
        rows = mixed(*(_number(_REDUCTION, (joint,), 1.0) for joint in joints)) if mixed else ((1.0,),)
        coupled = np.zeros((count, count))
        for actuator, row in zip(actuators, rows, strict=True):
            reduction = _number(_REDUCTION, (actuator,) if mixed else (actuator, joints[0], node), 1.0)
            inertia, arms = _number(_INERTIAS, (actuator,), 0.0), reduction * np.array(row)
            if not arms.any() or inertia < 0.0:
                raise node.error("a reduction of zero, or a negative rotor inertia")
            coupled += inertia * np.outer(arms, arms)
            shares = {name: share for name, share in zip(names, row, strict=True) if share}
            motor = actuator.get("name") or names[0]
            label = motor if motor not in found else f"{motor} {number}"
            ends = () if mixed else _ends(model, columns[0], reduction, unlimited)
            found[label] = Actuator(label, shares if mixed else names[0], gear=reduction, force_range=ends)
        model.armature[columns] += np.diagonal(coupled)
        if np.abs(coupled - np.diag(np.diagonal(coupled))).max() > 1e-12 * np.abs(coupled).max():
            warn(f"{node.name}: its rotors couple the two joints, which is left out")
    return tuple(found.values())


def _ends(model, column, reduction, unlimited) -> tuple[float, ...]:
    effort = float(model.upperEffortLimit[column])
    limit = effort / abs(reduction)
    return (-limit, limit) if 0.0 < effort < unlimited else ()


def _text(node, tag) -> str:
    return (child.xml.text or "").strip() if (child := node.child(tag)) else ""


def _number(tags, nodes, default) -> float:
    """The number in the first of these elements that one of the nodes has."""
    for node in nodes:
        for tag in tags:
            if child := node.child(tag):
                return floats(child.xml.text or "", 1, child.name)[0]
    return default
