"""Loops and motors in a URDF: ``<loop_joint>``, ``<loop>``, ``<constraint>``, ``<coupling>``, ``<mimic>``,
``<transmission>``, true loops, frames whose names close loops, and what Gazebo, Drake and MuJoCo add.

None of these but ``<mimic>`` and ``<transmission>`` is part of URDF. The following elements mean the same, an anchor on
each of two links; in a closed loop the anchors coincide, up to the motion that the type leaves free::

    <loop_joint name="tip" type="revolute">
      <link1 link="left" xyz="1 0 0" rpy="0 0 0"/>
      <link2 link="right" xyz="1 0 0" rpy="0 0 0"/>
      <axis xyz="0 1 0"/>
    </loop_joint>
    <loop name="tip" type="revolute">
      <predecessor link="left"><origin xyz="1 0 0" rpy="0 0 0"/></predecessor>
      <successor link="right"><origin xyz="1 0 0" rpy="0 0 0"/></successor>
      <axis xyz="0 1 0"/>
    </loop>
    <constraint name="tip" type="spherical_joint">
      <parent link="left"/><parent_origin xyz="1 0 0" rpy="0 0 0"/>
      <child link="right"/><child_origin xyz="1 0 0" rpy="0 0 0"/>
    </constraint>

``<loop_joint>`` comes from a former reader of Drake (no type: a hinge), and from Isaac Sim's (of which it supports
``spherical`` only); ``<loop>`` and ``<coupling>`` from URDF+ (Chignoli et al. 2024), ``<constraint>`` from a fork of
urdfdom. A URDF that lets a link be the child of two joints is cut into a tree, see ``cut_loops``. ``axis`` has the
same components in both anchors; its default is x, as in URDF.

The types, the motion that they leave free, and the kinds of loop that they become::

    fixed, weld, 6d                  none                              frame
    revolute, continuous or no type  rotation about the axis           hinge
    prismatic                        translation along the axis        slider
    cylindrical                      both                              cylinder
    planar                           motion in the plane normal to it  plane
    spherical, ball, 3d              all rotations                     point

Limits, damping and friction of a loop joint have no effect; if they are given, a warning says so.

``<mimic>`` becomes a coupling: a joint follows another, q = multiplier·q_other + offset. So does ``<coupling>``:
ratio times the sum of the joints from the nearest common ancestor to the predecessor is the sum of those to the
successor.

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
from collections.abc import Iterator
from dataclasses import replace
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from ..errors import FormatError, warn
from ..mechanism.forces import Actuator
from ..mechanism.joint_constraints import Coupling
from ..mechanism.loops import Loop, anchor
from . import drake, gazebo
from .closures import AXIS_ONLY, WITH_AXIS, Closure, kind_of
from .extensions import LOOP_TAGS, Names, pose, warn_without_effect, word
from .reading import DRAKE, Node, closing, finite, floats, located, near, refuse, short_repr

_OWN = (*LOOP_TAGS, "link", "joint", "coupling", "material", "transmission", "gazebo", "mujoco", *drake.TAGS)
_ENDS = (
    ("link1", "predecessor", "parent", "link_a", "linkA", "body1"),
    ("link2", "successor", "child", "link_b", "linkB", "body2"),
)
"""Children that name the two links of a loop."""
_OWN_EQUALITIES = ("connect", "weld", "joint")
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


def refuse_foreign(robot: Element, content) -> None:
    """Raise FormatError for unsupported extensions that close loops; see :func:`refuse`."""
    found = closing(robot, (*_OWN, "drake:joint"))
    for equality in robot.iterfind("mujoco/equality"):
        found += [("mujoco/equality", each) for each in equality if each.tag not in _OWN_EQUALITIES]
        found += [("mujoco/equality", equality)] * (len(equality) == 0)
    found += [(f"gazebo/{tag}", each) for tag in ("link", "model") for each in robot.iterfind(f"gazebo/{tag}")]
    followers = {joint.get("name") for joint in robot.findall("joint") if joint.find("mimic") is not None}
    for tag, element in (pair for each in robot.findall("gazebo") for pair in closing(each, ("joint",))):
        repeats = "mimic" in f"{tag}{element.get('filename', '')}" and element.findtext("joint") in followers
        if not repeats and not gazebo.reads(element):  # not one that repeats a <mimic> for Gazebo
            found.append((tag, element))
    refuse(found, robot, content, "write it as <loop_joint>, <mimic> or in a loop file")


def joined(robot: Element, model, ignored) -> Iterator:
    """The loops, couplings and forces of all extensions of a parsed ``<robot>``, with a model of its tree."""
    links = [link.get("name") for link in robot.findall("link")]
    fixed = [joint.get("name") for joint in robot.findall("joint") if joint.get("type") == "fixed"]
    names = Names(robot.get("name", ""), links, list(model.names)[1:], _frames(robot), fixed)
    top, leaders = Node(robot), {}
    for coupling in couplings(robot):
        leaders[coupling.joint] = coupling
        yield coupling
    for tag in LOOP_TAGS:
        for name, node in top.named(tag).items():
            yield _loop(name, node, names, tag)
    for name, node in top.named("coupling").items():
        yield _gear(name, node, names, robot)
    yield from drake.joined(top, names, ignored)
    for holder in top.children("gazebo"):
        for node in holder.children("joint"):
            yield gazebo.injected_joint(node, names, model)
        for record in gazebo.joined(holder, names, ignored):
            if not isinstance(record, Coupling) or record.joint not in leaders:
                yield record
    for holder in top.children("mujoco"):
        for number, node in enumerate(each for eq in holder.children("equality") for each in _all(eq)):
            yield from _equality(node, names, number, ignored)


def _frames(robot):
    """The ``<frame>`` elements of a URDF that Drake and others read: name → (link, place on it)."""
    found = {}
    for tag in ("frame", DRAKE + "frame"):
        for node in Node(robot).children(tag):
            if node.get("name") and node.get("link"):
                place = pose(node.numbers("xyz", 3, ZERO), node.numbers("rpy", 3, ZERO))
                found[node.get("name")] = node.get("link"), place
    return found


def _all(node):
    return [type(node)(each, str(each.tag)) for each in node.xml]


def _loop(name, node, names, tag):
    given = node.get("type") or "revolute"
    kind = kind_of(given)
    if kind not in AXIS_ONLY:
        raise node.error(f"type {given[:40]!r} is not one of {', '.join(_TYPES)}")
    warn_without_effect(node, "limit", "dynamics", "mimic")
    fields = {}
    for number, tags in enumerate(_ENDS, start=1):
        frame, place = _anchor(node, tags, names)
        fields |= {f"frame{number}": frame} | place_fields(number, *place)
    if fields["frame1"] == fields["frame2"]:
        raise node.error(f"both ends are on the link {fields['frame1']!r}")
    if kind in WITH_AXIS:
        fields["axis"] = node.child("axis").numbers("xyz", 3, X_AXIS)
        if not any(fields["axis"]):
            raise node.error("the axis is the zero vector")
    with located(element=node.name, prefix=f"loop {name!r}: "):
        return Loop(name, kind, **fields)


_TYPES = ("fixed", "revolute", "continuous", "prismatic", "cylindrical", "planar", "spherical", "ball")


def place_fields(number, xyz, rpy):
    return {f"xyz{number}": xyz, f"rpy{number}": rpy}


def _anchor(node, tags, names):
    """The link of one end of a loop, and (xyz, rpy) of its anchor."""
    tag = next((tag for tag in tags if node.child(tag) or node.get(tag)), None)
    if tag is None:
        raise node.error(f"<{tags[0]}> is missing: the link of this end (or <{tags[1]}>, <{tags[2]}>)")
    end = node.child(tag)
    link = names.link(word(node, tag), end.name if end else node.name)
    origins = (end.child("origin"), node.child(f"{tag}_origin"), node.child(f"origin_{tag}"), end)
    place = next((each for each in origins if each and (each.get("xyz") or each.get("rpy"))), end)
    return link, tuple(place.numbers(key, 3, ZERO) for key in ("xyz", "rpy"))


def _gear(name, node, names, robot):
    """The coupling of a ``<coupling>``: Σ to the successor = ratio · Σ to the predecessor."""
    ends = [names.link(word(node, *tags), node.name) for tags in _ENDS]
    chains, above = [], {}
    for joint in robot.findall("joint"):
        above[joint.find("child").get("link")] = joint
    for link in ends:
        chain = []
        while link in above:
            chain.append(above[link].get("name"))
            link = above[link].find("parent").get("link")
        chains.append(chain)
    leading, following = ([joint for joint in chain if joint not in other and joint in names.joints]
                          for chain, other in (chains, chains[::-1]))  # fmt: skip
    if not leading or not following:
        raise node.error("one of its links does not move relative to their common ancestor")
    ratio = node.child("ratio")
    factor = floats(ratio.get("value") or ratio.text(), 1, ratio.name)[0] if ratio else node.number("ratio")
    first, *rest = following
    others = {joint: factor for joint in leading} | {joint: -1.0 for joint in rest}
    if len(others) == 1:
        return Coupling(name, first, leading[0], factor)
    return Coupling(name, first, others)


def _equality(node, names, number, ignored):
    """A ``connect``, ``weld`` or ``joint`` equality of MuJoCo, which its own reader of URDF leaves out."""
    if node.get("active", "true").lower() in ("false", "0"):
        ignored.add("inactive equality")
        return
    tag = node.xml.tag
    name = node.get("name") or f"{tag}{number + 1}"
    node.name = f"mujoco/equality {name!r}"
    if tag == "joint":
        joints = [names.joint(node.get(key), node.name) for key in ("joint1", "joint2") if node.get(key)]
        offset, ratio, *higher = floats(node.get("polycoef") or "0 1 0 0 0", 5, node.name, "polycoef=")
        if len(joints) < 2:
            raise node.error("joint2 is missing: an equality of one joint makes it fixed")
        yield Coupling(name, *joints, ratio, offset, tuple(higher))
        return
    ends = [names.link(node.get(key) or "world", node.name) for key in ("body1", "body2")]
    if tag == "connect":
        yield Closure(name, "point", *ends, pose(node.numbers("anchor", 3), ZERO))
    elif node.get("relpose"):
        *xyz, w, x, y, z = node.numbers("relpose", 7)
        place = pin.SE3(pin.Quaternion(w, x, y, z).normalized().toRotationMatrix(), np.array(xyz))
        yield Loop(name, "frame", *ends, **anchor(1, place))
    else:
        yield Closure(name, "frame", *ends, pin.SE3.Identity())


def cut_loops(robot: Element) -> tuple[Loop, ...]:
    """Cut true loops: remove from a parsed ``<robot>`` the joints of links that have another one; return the loops.

    Of the joints of a link, one with a force or a motor stays in the tree, or the one with most rows; between equal
    ones, that of the shortest chain. The anchors are the frames of the joint that is cut, as if it were in the tree.
    """
    Node(robot).named("joint")  # names are unique
    joints = [joint for joint in robot.findall("joint") if joint.find("parent") is not None]
    joints = [joint for joint in joints if joint.find("child") is not None]
    ends = [(joint.find("parent").get("link"), joint.find("child").get("link")) for joint in joints]
    children = [child for _, child in ends]
    if len(set(children)) == len(children):
        return ()
    moved = {node.get("name") for node in robot.iterfind("transmission/joint")}
    moved |= {joint.find("mimic").get("joint") for joint in joints if joint.find("mimic") is not None}
    weights = [_worth(joint, moved) for joint in joints]
    kept = _tree(ends, weights)
    cut = [i for i in range(len(joints)) if i not in kept]
    loops = tuple(_true_loop(joints[i], *ends[i]) for i in cut)
    for i in cut:
        robot.remove(joints[i])
    return tuple(loop for loop in loops if loop)


def _tree(ends, weights) -> set[int]:
    """The joints (parent, child) of a tree: for each link that of the largest weight, if this leads to a root."""
    children = {child for _, child in ends}
    depth = {parent: 0 for parent, _ in ends if parent not in children}
    for link in (waiting := list(depth)):
        inner = [child for parent, child in ends if parent == link and child not in depth]
        depth |= dict.fromkeys(inner, depth[link] + 1)
        waiting += dict.fromkeys(inner)
    options: dict[str, list[int]] = {}
    for i, (_, child) in enumerate(ends):
        options.setdefault(child, []).append(i)
    for joints in options.values():
        joints.sort(key=lambda i: (-weights[i], depth.get(ends[i][0], len(ends)), i))
    chosen = {child: joints[0] for child, joints in options.items()}
    while True:
        reached = {link for link in depth if link not in children}
        grown = True
        while grown:
            grown = [child for child, i in chosen.items() if child not in reached and ends[i][0] in reached]
            reached.update(grown)
        stuck = [(child, i) for child, joints in options.items() if child not in reached for i in joints]
        change = next(((child, i) for child, i in stuck if ends[i][0] in reached), None)
        if change is None:
            return set(chosen.values())
        chosen[change[0]] = change[1]


def _worth(joint, moved) -> int:
    """The number of rows of a joint, and more if a force or a motor needs its coordinate."""
    rows = {"fixed": 6, "revolute": 5, "continuous": 5, "prismatic": 5, "planar": 3, "floating": 0}
    dynamics = joint.find("dynamics")
    acts = dynamics is not None and any(dynamics.get(key, "0").strip("0. ") for key in ("damping", "friction"))
    acts = acts or joint.find("mimic") is not None or joint.get("name") in moved
    return rows.get(joint.get("type", ""), 5) + 10 * acts


def _true_loop(joint, parent, child):
    node = Node(joint, f"joint {joint.get('name')!r}")
    if joint.get("type") == "floating":
        return None
    kind = kind_of(joint.get("type", ""))
    if kind is None:
        raise node.error(f"type {joint.get('type')!r} cannot close a loop")
    warn_without_effect(node, "dynamics", "mimic")
    origin = node.child("origin")
    place = place_fields(1, origin.numbers("xyz", 3, ZERO), origin.numbers("rpy", 3, ZERO))
    axis = node.child("axis").numbers("xyz", 3, X_AXIS) if kind in WITH_AXIS else None
    with located(element=node.name, prefix=f"loop {joint.get('name')!r}: "):
        return Loop(joint.get("name"), kind, parent, child, **place, axis=axis)


def couplings(robot: Element) -> tuple[Coupling, ...]:
    """The ``<mimic>`` elements of a parsed ``<robot>``, each named like the joint that follows."""
    kinds = {joint.get("name"): joint.get("type") for joint in robot.findall("joint")}
    found = {}
    for joint in Node(robot).children("joint"):
        name = joint.get("name")
        nodes = joint.children("mimic")
        if nodes and kinds[name] == "fixed":  # a reduced model, in which it is left over
            warn(f"joint {name!r}: <mimic> has no effect, as the joint is fixed")
            continue
        for node in nodes:
            node.name = f"joint {name!r}: mimic"
            if len(nodes) > 1:
                raise node.error("a joint can follow only one other joint")
            other = node.get("joint")
            if other not in kinds:
                meant = near(other, kinds)
                raise node.error(
                    f"there is no joint {other!r} to follow{meant}; ignore=['mimic'] loads it without them"
                )
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
        if not (joints or actuators):
            continue
        mixed = _MIXED.get(node.child("type").text().rpartition("/")[2])
        names = [joint.get("name") for joint in joints]
        reason = _no_force(model, names, joints, actuators, 2 if mixed else 1)
        if reason:
            warn(f"{node.name}: it exerts no force here: {reason}")
            continue
        for motor, actuator in _actuators(node, mixed, names, joints, actuators, model, unlimited):
            label = motor if motor not in found else f"{motor} {number}"
            found[label] = replace(actuator, name=label)
    return tuple(found.values())


def _no_force(model, names, joints, actuators, count) -> str:
    """Why a transmission of `count` actuators exerts no force, or an empty string."""
    if len(joints) != count or len(actuators) != count:
        return "it connects several actuators or joints"
    known = list(model.names)[1:]
    wrong = [name for name in names if name not in known or model.nvs[model.getJointId(name)] != 1]
    if wrong:
        return f"{wrong[0]!r} is not a joint with one degree of freedom"
    words = _not_numbers(joints, actuators)
    return f"{words} is no number" if words else ""


def _actuators(node, mixed, names, joints, actuators, model, unlimited):
    """(name, Actuator) of a transmission; adds its rotors to the armature of the model. `mixed` gives shares of two."""
    count = len(joints)
    columns = [model.idx_vs[model.getJointId(name)] for name in names]
    rows = mixed(*(_number(_REDUCTION, (joint,), 1.0) for joint in joints)) if mixed else ((1.0,),)
    coupled = np.zeros((count, count))
    found = []
    for actuator, row in zip(actuators, rows, strict=True):
        reduction = _number(_REDUCTION, (actuator,) if mixed else (actuator, joints[0], node), 1.0)
        inertia = _number(_INERTIAS, (actuator,), 0.0)
        arms = reduction * np.array(row)
        if not arms.any() or inertia < 0.0:
            raise node.error("a reduction is zero, or a rotor inertia is negative")
        coupled += inertia * np.outer(arms, arms)
        shares = {name: share for name, share in zip(names, row, strict=True) if share}
        motor = actuator.get("name") or names[0]
        limit = float(model.upperEffortLimit[columns[0]])
        ends = (-limit / abs(reduction), limit / abs(reduction)) if 0.0 < limit < unlimited and not mixed else ()
        found.append((motor, Actuator(motor, shares if mixed else names[0], gear=reduction, force_range=ends)))
    model.armature[columns] += np.diagonal(coupled)
    if np.abs(coupled - np.diag(np.diagonal(coupled))).max() > 1e-12 * np.abs(coupled).max():
        warn(f"{node.name}: its rotors couple the two joints, which is ignored")
    return found


def _not_numbers(joints, actuators) -> str:
    """A reduction that is not a number, as templates leave it: its element and text."""
    for child in (child for node in (*joints, *actuators) for tag in _REDUCTION if (child := node.child(tag))):
        given = child.get("value") or child.text()
        if finite(given) is None:
            return f"{child.name} {short_repr(given)}"
    return ""


def _number(tags, nodes, default) -> float:
    """The number in the first of the elements `tags` that is found in one of the nodes."""
    children = (child for node in nodes for tag in tags if (child := node.child(tag)))
    return next((_one_number(child) for child in children), default)


def _one_number(node) -> float:
    """The number in an element, as its text, or in the attribute ``value`` as Drake writes it."""
    return floats(node.get("value") or node.text(), 1, node.name)[0]
