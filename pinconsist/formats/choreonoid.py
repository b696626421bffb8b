"""Choreonoid's bodies (``.body``, YAML) and OpenHRP's (``.wrl``, VRML): links on joints, and ``extraJoints``.

A link stands in its parent at ``translation`` and ``rotation`` (axis and angle); its joint turns or slides about or
along ``jointAxis`` from there. A link and its joint have one name: the body of a joint ``J`` is called ``J_link``. A
``free`` root floats. Masses are those of the link, or of a ``RigidBody`` or ``Segment`` in it. The points of an extra
joint, ``link1LocalPos`` and ``link2LocalPos``, coincide: ``ball`` (``xyz``) leaves all rotations, ``hinge``
(``revolute``) those about its axis, ``fixed`` none. ``xy`` of OpenHRP, a point on an axis, is refused. ``rotorInertia``
acts, multiplied by the square of ``gearRatio``, and the motors are the joints with a ``jointId``. A continuous track is
fixed, as it is there. Shapes are not shown.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree.ElementTree import tostring

import numpy as np
import pinocchio as pin

from ..errors import FormatError, warn
from ..mechanism.file_laws import WATCHED
from ..mechanism.loops import Loop, unit
from .closures import Closure
from .extensions import pose, unique
from .graph import WORLD, Axis, Body, Joint, JointGraph, Scene, build
from .ignored import Ignored
from .loopfile import parsed_yaml
from .plausible import moving_inertias, warn_of_inertias
from .reading import RobotFile, finite, finite_numbers, near, read_bytes, require_known, short_repr
from .urdf import fixed_links
from .webots import Vrml, parse

DEEPEST, MOST = 100, 500_000  # levels, and values, with those that aliases repeat
_TURNS, _SLIDES = ("revolute", "rotate", "hinge", "continuous"), ("prismatic", "slide")
_TRACKS = ("pseudo_continuous_track", "pseudocontinuoustrack", "crawler")
"""Joints that do not move in these programs: the surface of their link does, where it touches something."""
_EXTRA = {"ball": "point", "xyz": "point", "spherical": "point", "fixed": "frame"}
_EXTRA |= {"hinge": "hinge", "revolute": "hinge"}
_AXES = {letter: tuple(float(letter == each) for each in "xyz") for letter in "xyz"}
_NAMES = {  # in both kinds of files; those of the second format of Choreonoid have underscores
    "jointType": "joint_type", "jointAxis": "joint_axis", "jointId": "joint_id", "centerOfMass": "center_of_mass",
    "rotorInertia": "rotor_inertia", "gearRatio": "gear_ratio", "jointRange": "joint_range",
    "jointAngle": "joint_angle", "jointDisplacement": "joint_displacement", "actuationMode": "actuation_mode",
    "extraJoints": "extra_joints", "link1Name": "link1_name", "link2Name": "link2_name",
    "link1LocalPos": "link1_local_pos", "link2LocalPos": "link2_local_pos", "angleUnit": "angle_unit",
    "rootLink": "root_link",
    "link1LocalRotation": "link1_local_rotation", "link2LocalRotation": "link2_local_rotation",
}  # fmt: skip
_LINK = {"name", "parent", "translation", "rotation", "mass", "inertia", "elements", "type", "joint_axis_inertia"}
_LINK |= set(_NAMES) | set(_NAMES.values())
_HARMLESS = {"import", "on", "node", "torqueConst", "encoderPulse", "rotorResistor", "lvlimit"}
_HARMLESS |= {
    "uvlimit",
    "limitOrientation",
    "scaleOrientation",
    "center",
    "scale",
    "children",
    "bboxCenter",
    "bboxSize",
}
_JOINT = {*_NAMES, "equivalentInertia", "translation", "rotation", "children", "name", "llimit", "ulimit", *_HARMLESS}
_SEGMENT = {"mass", "centerOfMass", "momentsOfInertia", "children", "name", "bboxCenter", "bboxSize", "coord"}
_HUMANOID = {"humanoidBody", "joints", "segments", "sites", "name", "info", "version", "viewpoints", "translation"}
_HUMANOID |= {"rotation", "scale", "center", "scaleOrientation", "bboxCenter", "bboxSize", "linkConnections"}
_RIGID = {"type", "name", "mass", "centerOfMass", "inertia", "translation", "rotation", "elements"}
_EXTRA_JOINT = {"link1Name", "link2Name", "link1LocalPos", "link2LocalPos", "jointType", "jointAxis", "name"}
_SHAPES = ("Shape", "Transform", "Group", "Visual", "Collision", "Resource", "Inline")
_DEVICES = (
    "Camera",
    "RangeSensor",
    "RangeCamera",
    "ForceSensor",
    "AccelerationSensor",
    "RateGyroSensor",
    "Imu",
    "Light",
)
_DEVICES += ("SpotLight", "DirectionalLight", "PointLight", "AccelSensor", "Gyro", "VisionSensor", "Device", "Marker")


@dataclass
class Link:
    """A link as its file has it."""

    name: str
    parent: str
    place: pin.SE3  # in the parent, or in the world
    kind: str
    axis: np.ndarray
    inertia: pin.Inertia
    motor: bool = False
    armature: float = 0.0
    limits: tuple[float, ...] = ()
    start: float = 0.0

    @property
    def body(self) -> str:
        """The name of the body, which is not that of its joint."""
        return self.name if self.kind in ("free", "fixed", "", *_TRACKS) else f"{self.name}_link"


@dataclass
class Extra:
    """A joint that closes a loop."""

    name: str
    ends: tuple[str, str]
    kind: str
    points: tuple[tuple[float, ...], tuple[float, ...]]
    axis: tuple[float, ...] | None


@dataclass
class Contents:
    """The links and extra joints of a file."""

    links: list[Link] = field(default_factory=list)
    extra: list[Extra] = field(default_factory=list)
    ignored: Ignored = field(default_factory=Ignored)


def read(path: Path, name: str, folders, *, ignore=()) -> RobotFile:
    """Read a body; see the documentation of the module."""
    content = read_bytes(path)
    contents = _of_vrml(content, path) if path.suffix.lower() == ".wrl" else _of_yaml(content, set(ignore))
    links = {link.name: link for link in contents.links}
    if len(links) < len(contents.links):
        names = [link.name for link in contents.links]
        twice = next(each for each in names if names.count(each) > 1)
        raise FormatError("two links have this name", element=f"link {twice[:60]!r}")
    poses: dict[str, pin.SE3] = {WORLD: pin.SE3.Identity()}
    waiting = list(contents.links)
    while waiting:
        ready = [link for link in waiting if link.parent in poses]
        if not ready:
            lost = waiting[0]
            raise FormatError(
                f"there is no link {lost.parent[:60]!r}{near(lost.parent, links)}", element=f"link {lost.name[:60]!r}"
            )
        for link in ready:
            poses[link.name] = poses[link.parent] * link.place
        waiting = [link for link in waiting if link.name not in poses]
    bodies = {link.name: link.body for link in contents.links} | {WORLD: WORLD}
    joints = [_joint(link, bodies, contents.ignored) for link in contents.links if link.kind != "free"]
    scene = Scene({link.body: Body(poses[link.name]) for link in contents.links}, roots=list(bodies.values())[:-1])
    graph = JointGraph(scene, joints)
    inertias = {link.body: link.inertia for link in contents.links}
    model, guess = build(scene, graph, inertias, name, graph.roots)
    for link in (each for each in contents.links if each.armature and model.existJointName(each.name)):
        model.armature[model.idx_vs[model.getJointId(link.name)]] = link.armature
    warn_of_inertias(path, moving_inertias("link", inertias, model))
    guess |= {link.name: link.start for link in contents.links if link.start and model.existJointName(link.name)}
    loops = tuple(_loop(extra, bodies) for extra in contents.extra)
    actuated = tuple(link.name for link in contents.links if link.motor and model.existJointName(link.name))
    return RobotFile(model, _without_shapes(inertias), loops, (), (), guess, actuated, contents.ignored.lines())


def _without_shapes(bodies) -> str:
    return tostring(fixed_links(bodies)[0], encoding="unicode")


def _joint(link, bodies, ignored) -> Joint:
    kind = "fixed"
    if link.kind in (*_TURNS, *_SLIDES):
        kind = "revolute" if link.kind in _TURNS else "prismatic"
    elif link.kind == "ball":
        kind = "ball"
    elif link.kind in _TRACKS:
        ignored.add("continuous track, which does not run")
    elif link.kind not in ("fixed", ""):
        raise FormatError(f"the joint type {link.kind[:40]!r} is not supported", element=f"link {link.name[:60]!r}")
    limits = dict(zip(("lower", "upper"), link.limits, strict=False))
    if limits:
        ignored.add(WATCHED)
    axes = () if kind == "fixed" else (Axis(link.axis, **limits),)
    name = link.name if axes else f"{link.name}_mount"
    return Joint(name, kind, bodies[link.parent], link.body, link.place, pin.SE3.Identity(), axes)


def _loop(extra, bodies):
    for link in extra.ends:
        require_known(link, bodies, f"there is no link {link[:60]!r}", f"extra joint {extra.name!r}")
    ends = tuple(bodies[link] for link in extra.ends)
    if extra.kind == "point":
        return Loop(extra.name, "point", *ends, xyz1=extra.points[0], xyz2=extra.points[1])
    place = pose(extra.points[0], (0.0, 0.0, 0.0))
    return Closure(extra.name, extra.kind, *ends, place, axis=extra.axis, xyz2=extra.points[1])


def _extra(given, taken) -> Extra:
    """An extra joint from its fields, by name."""
    ends = tuple(str(given.get(f"link{end}Name", "")) for end in (1, 2))
    title = unique(str(given.get("name") or "-".join(ends)), taken)
    element, word = f"extra joint {title[:60]!r}", str(given.get("jointType", "")).lower()
    if word not in _EXTRA:
        known = ", ".join(_EXTRA)
        cure = "write it as hinge, or ball" if word in ("xy", "piston", "prismatic") else "mend the file"
        raise FormatError(f"the type {word[:40]!r} is not one of {known}; {cure}", element=element)
    for key in given:
        if key not in _EXTRA_JOINT and not key.startswith("link"):
            warn(f"{element}: {key[:60]!r} is not known and has no effect")
    for end in (1, 2):
        if f"link{end}LocalRotation" in given:
            raise FormatError(f"link{end}LocalRotation is not supported", element=element)
    points = tuple(tuple(_numbers(given, f"link{end}LocalPos", 3, element, (0.0,) * 3)) for end in (1, 2))
    kind = _EXTRA[word]
    axis = tuple(_axis(given, element).tolist()) if kind == "hinge" else None
    return Extra(title, ends, kind, points, axis)


def _flat(value) -> list:
    """The values of a list, or of a list of rows."""
    rows = value if isinstance(value, (list, tuple)) else [value]
    return [each for row in rows for each in (row if isinstance(row, (list, tuple)) else [row])]


def _numbers(given, key, count, element, default=None) -> np.ndarray:
    value = given.get(key, default)
    if value is None:
        raise FormatError(f"{key} is missing", element=element)
    return np.array(finite_numbers(_flat(value), count, value, element, f"{key}: "))


def _axis(given, element) -> np.ndarray:
    word = given.get("jointAxis", (0.0, 0.0, 1.0))
    word = word[0] if isinstance(word, list) and len(word) == 1 else word
    if isinstance(word, str) and word.strip().lstrip("+-").lower() in _AXES:
        sign = -1.0 if word.strip().startswith("-") else 1.0
        return sign * np.array(_AXES[word.strip().lstrip("+-").lower()])
    axis = _numbers({"jointAxis": word}, "jointAxis", 3, element)
    if not axis.any():
        raise FormatError("the axis is the zero vector", element=element)
    return unit(axis)


def _place(given, element, radian) -> pin.SE3:
    xyz = _numbers(given, "translation", 3, element, (0.0,) * 3)
    turn = given.get("rotation", (0.0, 0.0, 1.0, 0.0))
    turns = turn if isinstance(turn, list) and turn and isinstance(turn[0], list) else [turn]
    rotation = np.eye(3)
    for each in turns:
        *axis, angle = _numbers({"rotation": each}, "rotation", 4, element)
        if any(axis):
            rotation = rotation @ pin.AngleAxis(float(angle) * radian, unit(axis)).toRotationMatrix()
    return pin.SE3(rotation, xyz)


def _inertia(given, key, element) -> pin.Inertia:
    made = pin.Inertia.Zero()
    made.mass = float(_numbers(given, "mass", 1, element, 0.0)[0])
    made.lever = _numbers(given, "centerOfMass", 3, element, (0.0,) * 3)
    flat = given.get(key, [0.0] * 9)
    if len(_flat(flat)) == 6:
        xx, xy, xz, yy, yz, zz = _numbers(given, key, 6, element)
        matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    else:
        matrix = _numbers(given, key, 9, element, [0.0] * 9).reshape(3, 3)
    made.inertia = (matrix + matrix.T) / 2.0
    return made


def _of_yaml(content, ignore) -> Contents:
    """The contents of a ``.body`` file."""
    given = _Plain().named(parsed_yaml(content, aliases=True))
    if not isinstance(given, dict) or not isinstance(given.get("links"), list):
        raise FormatError("a Choreonoid body has a list of links")
    radian = 1.0 if str(given.get("angleUnit", "degree")) == "radian" else np.pi / 180.0
    found = Contents()
    for number, each in enumerate(given["links"], start=1):
        if isinstance(each, dict) and (each.get("uri") or each.get("type") == "SubBody"):
            where = f"link {number}, {short_repr(each.get('uri') or '')}"
            raise FormatError("a body in another file is not supported; write its links here", element=where)
        if not isinstance(each, dict) or not each.get("name"):
            raise FormatError("it is not a mapping with a name", element=f"link {number}")
        found.links.append(_link(each, radian, found.ignored))
    extra = given.get("extraJoints") or []
    for number, each in enumerate(extra if isinstance(extra, list) else [extra], start=1):
        if not isinstance(each, dict):
            raise FormatError("it is not a mapping", element=f"extra joint {number}")
        if str(each.get("name", "")) not in ignore:
            found.extra.append(_extra(each, [one.name for one in found.extra]))
    return found


def _link(each, radian, ignored) -> Link:
    name, element = str(each["name"]), f"link {str(each['name'])[:60]!r}"
    place, inertia = _place(each, element, radian), _inertia(each, "inertia", element)
    inertia = inertia + _inside(each.get("elements"), pin.SE3.Identity(), element, radian, ignored, 0)
    for key in each:
        if key not in _LINK and key not in _HARMLESS:
            ignored.add(f"<{key}> of links")
    kind = str(each.get("jointType", "fixed" if each.get("parent") else "free")).lower()
    if each.get("actuationMode") == "jointSurfaceVelocity":
        kind = _TRACKS[0]
    factor = radian if kind in _TURNS else 1.0
    given = each.get("jointRange")
    given = [given] if given is not None and not isinstance(given, list) else given or []
    ends = [finite(end) for end in given]
    limits = tuple(end * factor for end in ends if end is not None) if None not in ends else ()
    limits = (-limits[0], limits[0]) if len(limits) == 1 else limits
    moving = kind in (*_TURNS, *_SLIDES)
    axis = _axis(each, element) if moving else np.array([0.0, 0.0, 1.0])
    parent = str(each.get("parent") or WORLD)
    motor = moving and each.get("jointId") is not None and finite(each["jointId"]) not in (None, -1.0)
    start = _number(each, "jointDisplacement", element, _number(each, "jointAngle", element)) * factor
    armature = _number(each, "joint_axis_inertia", element, _rotor(each, element))
    return Link(name, parent, place, kind, axis, inertia, motor, armature, limits, start)


def _number(given, key, element, default=0.0) -> float:
    return float(_numbers(given, key, 1, element, default)[0])


def _rotor(given, element) -> float:
    """The inertia of a rotor as its joint feels it."""
    return _number(given, "rotorInertia", element) * _number(given, "gearRatio", element, 1.0) ** 2


def _inside(elements, place, element, radian, ignored, depth) -> pin.Inertia:
    """The inertia of the RigidBody nodes in a link."""
    total = pin.Inertia.Zero()
    if depth > DEEPEST:
        raise FormatError(f"elements are nested more than {DEEPEST} deep", element=element)
    if isinstance(elements, dict):
        elements = [{"type": key} | (value if isinstance(value, dict) else {}) for key, value in elements.items()]
    if elements and not isinstance(elements, list):
        raise FormatError(f"elements: {short_repr(elements)} is not a list of nodes", element=element)
    for each in elements or ():
        if not isinstance(each, dict):
            raise FormatError(f"{short_repr(each)} is not an element", element=element)
        kind = str(each.get("type", ""))
        if kind == "RigidBody":
            for key in each:
                if key not in _RIGID:
                    ignored.add(f"<{key[:60]}> of a RigidBody")
            own = place * _place(each, element, radian)
            total = total + own.act(_inertia(each, "inertia", element))
        elif kind in _SHAPES or kind.startswith("RigidBody"):
            pass
        elif kind not in _DEVICES:
            ignored.add(f"<{kind or 'element'}> of links")
        if kind in ("Transform", "Group", "RigidBody", *_DEVICES):
            own = place * _place(each, element, radian)
            total = total + _inside(each.get("elements"), own, element, radian, ignored, depth + 1)
    return total


class _Plain:
    """The values of a YAML file with the names of the first format for those of the second."""

    def __init__(self):
        self._count, self._old = 0, {new: old for old, new in _NAMES.items()}

    def named(self, value, depth=0):
        self._count += 1
        if depth > DEEPEST or self._count > MOST:
            raise FormatError(f"the file is nested more than {DEEPEST} deep, or has more than {MOST:,} values")
        if isinstance(value, list):
            return [self.named(each, depth + 1) for each in value]
        if isinstance(value, dict):
            return {self._old.get(key, str(key)): self.named(each, depth + 1) for key, each in value.items()}
        return value


def _of_vrml(content, path) -> Contents:
    """The contents of an OpenHRP file."""
    nodes, _, _ = parse(content.decode("utf-8", errors="replace"), path)
    found, body = Contents(), next((node for node in nodes if node.type == "Humanoid"), None)
    if body is None:
        raise FormatError("there is no Humanoid node, whose humanoidBody has the joints of OpenHRP")
    if body.nodes("linkConnections"):
        raise FormatError("linkConnections are not supported; write them as ExtraJoint", element="Humanoid")
    _count_fields(body, _HUMANOID, found.ignored)
    for joint in body.nodes("humanoidBody"):
        _visit(joint, WORLD, found, 0)
    for node in (each for each in nodes if each.type == "ExtraJoint"):
        given = {key: value for key, value in node.items()} | {"name": node.label}
        given |= {key: node.word(key) for key in ("link1Name", "link2Name", "jointType")}
        _count_fields(node, _EXTRA_JOINT, found.ignored)
        found.extra.append(_extra(given, [one.name for one in found.extra]))
    return found


def _count_fields(node, known, ignored):
    for key in node:
        if key not in known:
            ignored.add(f"<{key[:60]}> of {node.type}")


def _visit(node: Vrml, parent, found, depth):
    if depth > DEEPEST:
        raise FormatError(f"joints are nested more than {DEEPEST} deep")
    if node.type != "Joint":
        return
    name = node.label or node.word("name")
    element = f"link {name[:60]!r}"
    if not name:
        raise FormatError("a Joint has no name (DEF)")
    inertia = pin.Inertia.Zero()
    _count_fields(node, _JOINT, found.ignored)
    inner = list(_within(node, pin.SE3.Identity(), 0))
    for segment, place in inner:
        if segment.type == "Segment":
            _count_fields(segment, _SEGMENT, found.ignored)
            inertia = inertia + place.act(_inertia(segment, "momentsOfInertia", element))
    kind, limits = node.word("jointType").lower(), []
    for key in ("llimit", "ulimit"):
        given = node.get(key)
        given = given[0] if isinstance(given, list) and given else given
        limits += [] if finite(given) is None else [float(given)]
    armature = _number(node, "equivalentInertia", element) or _rotor(node, element)
    moving = kind in (*_TURNS, *_SLIDES)
    motor = moving and int(node.number("jointId", -1.0)) >= 0
    axis = _axis(node, element) if moving else np.array([0.0, 0.0, 1.0])
    limits = tuple(limits) if len(limits) == 2 else ()
    place = _place(node, element, 1.0)
    found.links.append(Link(name, parent, place, kind, axis, inertia, motor, armature, limits))
    for child, place in inner:
        if child.type == "Joint" and not place.isIdentity():
            raise FormatError("it is in a Transform; give its own translation and rotation", element=element)
        _visit(child, name, found, depth + 1)


def _within(node: Vrml, place, depth) -> Iterator[tuple[Vrml, pin.SE3]]:
    """The nodes in a Joint and their poses on it; they may be in Groups and Transforms."""
    if depth > DEEPEST:
        raise FormatError(f"nodes are nested more than {DEEPEST} deep")
    for child in node.nodes("children"):
        if child.type in ("Group", "Transform"):
            yield from _within(child, place * _place(child, child.type, 1.0), depth + 1)
        else:
            yield child, place
