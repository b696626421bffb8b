"""Actuators, of which only the names of the joints are kept, and tendons, which are refused where they act."""

from __future__ import annotations

import logging
from xml.etree.ElementTree import Element

import numpy as np

from ...errors import FormatError
from ..reading import near
from .document import sections
from .settings import ACTUATORS, Defaults
from .tree import Tree
from .values import named, vector

_PASSIVE = ("armature", "damping")  # they act on the joint whatever the control does
_TENDON_FORCES = ("stiffness", "damping", "frictionloss", "armature")
_log = logging.getLogger(__name__)


def actuated(root: Element, tree: Tree, defaults: Defaults) -> tuple[str, ...]:
    """The joints on which actuators act, each once. No actuator exerts a force here.

    Raises
    ------
    FormatError
        Unknown kinds and joints, passive forces of an actuator.
    """
    joints, known = {}, {name: name for name in tree.joints}
    for number, node in enumerate(sections(root, "actuator"), start=1):
        element = f"actuator {node.get('name', '') or number!r}"
        if node.tag not in ACTUATORS:
            raise FormatError(f"{node.tag!r} is not known{near(node.tag, ACTUATORS)}", element=element)
        given = defaults.of(node, element)
        for key in _PASSIVE:
            if np.any(vector(given, key, element, (1, 3), (0.0,))):
                raise FormatError(f"{key} of an actuator is not computed here; give it to the joint", element=element)
        key = next((key for key in ("joint", "jointinparent") if key in given), None)
        if key is None:
            _log.warning("%s: it acts on no joint, and is left out", element)
            continue
        joints[named(known, {"joint": given[key]}, "joint", element)] = None
    return tuple(joints)


def refuse_tendons(root: Element, defaults: Defaults) -> None:
    """FormatError for a tendon that moves bodies by itself; its limits have no effect here."""
    for number, node in enumerate(sections(root, "tendon"), start=1):
        element = f"tendon {node.get('name', '') or number!r}"
        given = defaults.of(node, element, kind="tendon")
        for key in _TENDON_FORCES:
            if np.any(vector(given, key, element, (1, 3), (0.0,))):
                raise FormatError(
                    f"{key} of a tendon is not computed here; a SpringDamper can join two points", element=element
                )
