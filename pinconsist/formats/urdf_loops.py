"""Loops and motors in a URDF: ``<loop_joint>``, ``<mimic>``, ``<transmission>``; frames whose names close loops.

``<loop_joint>`` is a joint that closes a loop::

    <loop_joint name="tip" type="revolute">
      <link1 link="left" xyz="1 0 0" rpy="0 0 0"/>
      <link2 link="right" xyz="1 0 0" rpy="0 0 0"/>
      <axis xyz="0 1 0"/>
    </loop_joint>

This element is not part of URDF. It comes from two other readers: a former one of Drake (no type: the origins coincide
and the axes are aligned), and Isaac Sim's (with ``type``, of which it supports ``spherical`` only). Both forms are
supported here. ``xyz`` and ``rpy`` place an anchor on its link; in a closed loop the anchors coincide, up to the motion
that the type leaves free. ``axis`` has the same components in both anchors; its default is x, as in URDF.

The types, the motion that they leave free, and the kinds of loop that they become::

    fixed                            none                              frame
    revolute, continuous or no type  rotation about the axis           hinge
    prismatic                        translation along the axis        slider
    planar                           motion in the plane normal to it  plane
    spherical, ball                  all rotations                     point

Limits, damping and friction of a loop joint have no effect; if they are given, a warning says so.

``<mimic>`` becomes a coupling: a joint follows another, q = multiplier·q_other + offset.

If nothing else defines the loops of a robot, pairs of frames with the following names are the two ends of a loop:

* ``closing_x_1`` and ``closing_x_2`` of onshape-to-robot become a point, because the exporter does not write the type
  of the mate. The axis of its hinges is the z axis of the frames.
* ``closedloopX_A`` and ``closedloopX_B`` of the collection example-parallel-robots become a frame (its default), or a
  point if the name contains 3D: ``closedloop3D_1A``, ``closedloop2_A_3D``.

``load(..., closure=...)`` selects another kind for all of them.

``<transmission>`` becomes an actuator. The reduction n, ``<mechanicalReduction>``, may stand in the actuator, the joint
or the transmission. The command of the actuator is the motor's torque in N·m; n times this torque acts on the joint,
within the joint's effort limit. ``<rotorInertia>`` (or ``<motorInertia>``) of the actuator, in kg·m², is multiplied by
n² and added to the armature. ``<drake:gear_ratio value="n"/>`` and ``<drake:rotor_inertia>`` of the actuator, which
Drake reads, mean the same. ``DifferentialTransmission`` and ``FourBarLinkageTransmission`` connect two actuators and
two joints, in the order of their roles, by the equations of ROS: each actuator and each joint has a reduction, and
there are no limits. If the rotors couple the inertias of the two joints, only the diagonal terms are used, with a
warning. Other transmissions exert no force, also with a warning.
"""

import re
from xml.etree.ElementTree import Element

import numpy as np

from ..errors import FormatError, warn
from ..mechanism.forces import Actuator
from ..mechanism.joint_constraints import Coupling
from ..mechanism.loops import Loop
from .reading import DRAKE, Node, closing, floats, located, refuse, require_known

_KINDS = {"fixed": "frame", "revolute": "hinge", "continuous": "hinge", "prismatic": "slider", "planar": "plane"}
_KINDS |= {"spherical": "point", "ball": "point"}
_WITH_AXIS = ("hinge", "slider", "plane")
_OWN = ("link", "joint", "loop_joint", "material", "transmission", "gazebo", "mujoco")
ZERO, X_AXIS = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0)
_CAN_FOLLOW = ("revolute", "continuous", "prismatic")
_ONSHAPE = re.compile(r"(closing_.+)_([12])")
_COLLECTION = re.compile(r"(closedloop.*?)_?([AB])(_?[36]D)?", re.IGNORECASE)
_INERTIAS = ("rotorInertia", "motorInertia", DRAKE + "rotor_inertia")
_REDUCTION = ("mechanicalReduction", DRAKE + "gear_ratio")
_MIXED = {  # reductions of two joints → for each actuator, its factor on each joint
    "DifferentialTransmission": lambda first, second: ((first, second), (first, -second)),
    "FourBarLinkageTransmission": lambda first, second: ((first, -first * second), (0.0, second)),
}


def refuse_foreign(robot: Element, ignore, content) -> None:
    """Raise FormatError for unsupported extensions that close loops; see :func:`refuse`."""
    found = closing(robot, _OWN) + [("mujoco/equality", each) for each in robot.iterfind("mujoco/equality")]
    found += [("gazebo/joint", each) for each in robot.iterfind("gazebo/joint")]  # an element of SDF
    followers = {joint.get("name") for joint in robot.findall("joint") if joint.find("mimic") is not None}
    for tag, element in (pair for each in robot.findall("gazebo") for pair in closing(each, ("joint",))):
        if "mimic" not in f"{tag}{element.get('filename', '')}" or element.findtext("joint") not in followers:
            found.append((tag, element))  # not one that repeats a <mimic> for Gazebo
    refuse(found, ignore, robot, content, "write it as <loop_joint>, <mimic> or in a loop file")


def loop_joints(robot: Element) -> tuple[Loop, ...]:
    """The ``<loop_joint>`` elements of a parsed ``<robot>``."""
    links = {link.get("name") for link in robot.findall("link")}
    return tuple(_loop(name, node, links) for name, node in Node(robot).named("loop_joint").items())


def _loop(name, node, links):
    kind = node.get("type", "revolute")
    if kind not in _KINDS:
        raise node.error(f"type {kind!r} is not one of {', '.join(_KINDS)}")
    for tag in ("limit", "dynamics", "mimic"):
        if node.child(tag):
            warn(f"{node.name}: <{tag}> does not act on a joint that closes a loop")
    fields = {}
    for number in (1, 2):
        end = node.child(f"link{number}", required=True)
        fields[f"frame{number}"] = link = end.get("link")
        require_known(link, links, f"there is no link {link!r}", end.name)
        fields |= {f"{key}{number}": end.numbers(key, 3, ZERO) for key in ("xyz", "rpy")}
    if fields["frame1"] == fields["frame2"]:
        raise node.error(f"both ends are on the link {fields['frame1']!r}")
    if _KINDS[kind] in _WITH_AXIS:
        fields["axis"] = node.child("axis").numbers("xyz", 3, X_AXIS)
        if not any(fields["axis"]):
            raise node.error("the axis is the zero vector")
    with located(element=node.name, prefix=f"loop {name!r}: "):
        return Loop(name, _KINDS[kind], **fields)


def couplings(robot: Element) -> tuple[Coupling, ...]:
    """The ``<mimic>`` elements of a parsed ``<robot>``, each named like the joint that follows."""
    kinds = {joint.get("name"): joint.get("type") for joint in robot.findall("joint")}
    found = {}
    for joint in Node(robot).children("joint"):
        name = joint.get("name")
        nodes = joint.children("mimic")
        for node in nodes:
            node.name = f"joint {name!r}: mimic"
            if len(nodes) > 1:
                raise node.error("a joint can follow only one other joint")
            other = node.get("joint")
            require_known(other, kinds, f"there is no joint {other!r} to follow", node.name)
            for each, what in ((name, "follow another joint"), (other, "be followed")):
                if (kind := kinds[each]) not in _CAN_FOLLOW:
                    only = f"only {', '.join(_CAN_FOLLOW)} joints can"
                    raise node.error(f"joint {each!r} is {kind} and cannot {what}; {only}")
            if other == name:
                raise node.error("the joint follows itself")
            found[name] = Coupling(name, name, other, node.number("multiplier", 1.0), node.number("offset", 0.0))
    for name in found:
        path = [name]
        while path[-1] in found and path.count(path[-1]) == 1:
            path.append(found[path[-1]].other)
        if path.count(path[-1]) > 1:
            raise FormatError(f"joints follow each other in a cycle: {' → '.join(path)}", element=f"joint {name!r}")
    return tuple(found.values())


def closing_frames(model, path, closure=None) -> tuple[Loop, ...]:
    """The loops between closing frames of a model; with `closure` "hinge", hinges about the exporter's axis."""
    pairs, found = {}, []
    for frame in model.frames:
        if match := _ONSHAPE.fullmatch(frame.name):
            pairs.setdefault((match[1], "onshape"), {})[match[2]] = frame.name
        elif match := _COLLECTION.fullmatch(frame.name):
            pairs.setdefault((match[1] + (match[3] or ""), "collection"), {})[match[2].upper()] = frame.name
    for (name, source), ends in pairs.items():
        if len(ends) < 2:
            reason = "the other frame of the pair is missing"
            warn(f"{path}: the frame {next(iter(ends.values()))!r} does not close a loop: {reason}")
            continue
        kind, axis = "point" if source == "onshape" or "3D" in name.upper() else "frame", None
        if source == "onshape" and closure == "hinge":
            kind, axis = "hinge", (0.0, 0.0, 1.0)
        found.append(Loop(name, kind, *(ends[side] for side in sorted(ends)), axis=axis))
    if found:
        reason = "its loops are taken from the names of its frames"
        listed = ", ".join(f"{loop.name} ({loop.kind})" for loop in found)
        warn(f"{path} has no loop file; {reason}: {listed}. closure= or a loop file overrides this")
    return tuple(found)


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
    return next((_one_number(child) for child in children), default)


def _one_number(node) -> float:
    """The number in an element, as its text, or in the attribute ``value`` as Drake writes it."""
    return floats(node.get("value") or node.text(), 1, node.name)[0]
