"""Simple transmissions of URDF files: a motor, its reduction and its rotor inertia, which act on one joint.

``<mechanicalReduction>`` n is read in the actuator, the joint or the transmission; the command of the actuator is the
motor's torque, N·m, and n times that acts on the joint, within the joint's effort limit. ``<rotorInertia>`` (or
``<motorInertia>``) of the actuator, kg·m², adds n² times itself to the joint's armature. Transmissions that join
several actuators or joints exert no force, and a warning says so.
"""

from __future__ import annotations

import logging
from xml.etree.ElementTree import Element

import numpy as np

from ..mechanism.forces import Actuator
from .reading import Node, floats

_INERTIAS = ("rotorInertia", "motorInertia")
_log = logging.getLogger(__name__)


def transmissions(robot: Element, model, unlimited: float) -> tuple[Actuator, ...]:
    """The actuators of a file; adds their rotors to the armature of the model."""
    found: dict[str, Actuator] = {}
    for number, node in enumerate(Node(robot).children("transmission"), start=1):
        name = node.get("name") or str(number)
        node.name = f"transmission {name!r}"
        joints, actuators = node.children("joint"), node.children("actuator")
        if len(joints) != 1 or len(actuators) != 1:
            if joints or actuators:
                _log.warning("%s: it exerts no force here: it joins several actuators or joints", node.name)
            continue
        joint = joints[0].get("name")
        i = model.getJointId(joint) if joint in list(model.names)[1:] else 0
        if not i or model.nvs[i] != 1:
            _log.warning("%s: it exerts no force here: %r is no joint with one degree of freedom", node.name, joint)
            continue
        reduction = _number(("mechanicalReduction",), (actuators[0], joints[0], node), 1.0)
        inertia = _number(_INERTIAS, actuators, 0.0)
        if reduction == 0.0 or inertia < 0.0:
            raise node.error("a reduction of zero, or a negative rotor inertia")
        column = model.idx_vs[i]
        model.armature[column] += reduction**2 * inertia
        effort = float(getattr(model, "upperEffortLimit", np.full(model.nv, np.inf))[column])
        limit = effort / abs(reduction)
        ends = (-limit, limit) if 0.0 < effort < unlimited else ()
        motor = actuators[0].get("name") or joint
        label = motor if motor not in found else f"{motor} {number}"
        found[label] = Actuator(label, joint, gear=reduction, force_range=ends)
    return tuple(found.values())


def _number(tags, nodes, default) -> float:
    """The number in the first of these elements that one of the nodes has."""
    for node in nodes:
        for tag in tags:
            if child := node.child(tag):
                return floats(child.xml.text or "", 1, child.name)[0]
    return default
