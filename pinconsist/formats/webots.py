"""Webots worlds (``.wbt``) and PROTO files: Solids, and the joints between them.

A Solid with Physics is a body; what has none, and hangs on no joint, is fixed to what carries it: a Robot with Physics
floats, one without does not move. HingeJoint, Hinge2Joint, SliderJoint and BallJoint have their ``anchor`` and
``axis`` in the axes of their parent. The Solid of the end point is placed in the parent where it is at ``position``,
and the numbers of the joint are those of Webots: zero is where ``position`` is zero, and assembly starts at
``position``. An end point ``SolidReference`` closes a loop: with a Solid by its name, or with
``<static environment>``.

``springConstant``, ``dampingConstant`` and ``staticFriction`` of joints act, gravity is that of WorldInfo, along -z
(-y in files of versions before R2022a with the coordinate system NUE). Masses come from Physics: ``mass`` or
``density``, ``centerOfMass`` and ``inertiaMatrix``; what is missing is that of ``boundingObject``. Motors become
actuators.
PROTO nodes are written out from files beside the world (:mod:`.webots_proto`). What is not there, and has no body in
its fields, is counted; else it is refused. A ``.proto`` file is read with the parameters that it has.
"""

import math
import os
import re
from pathlib import Path
from xml.etree.ElementTree import tostring

import numpy as np
import pinocchio as pin

from ..errors import FormatError, warn
from ..mechanism.checks import near
from ..mechanism.file_laws import COLLISIONS, STATIC, WATCHED
from ..mechanism.forces import Actuator, JointSpring
from ..mechanism.loops import unit
from . import solids
from .extensions import unique
from .graph import WORLD, Axis, Body, Joint, JointGraph, Scene, build
from .ignored import Ignored
from .plausible import moving_inertias, warn_of_inertias
from .reading import RobotFile, finite, finite_numbers, read_bytes, short_repr, text
from .urdf import add_visual, fixed_links
from .webots_proto import CONVERT, Is, Proto, Protos, Scope, name_of

WATER = 1000.0  # kg/m³, the default density of Physics
DEEPEST = 200
MOST_TOKENS = 2_000_000
_TOKEN = re.compile(r'"((?:[^"\\]|\\.)*)"|#[^\n]*|([\[\]{}])|([^\s,\[\]{}"#]+)|[\s,]+')
_JOINTS = ("HingeJoint", "Hinge2Joint", "SliderJoint", "BallJoint")
_GROUPS = ("Group", "Transform", "Pose", "Solid", "Robot", "Supervisor", "DifferentialWheels", "Charger")
_SOLIDS = ("Solid", "Robot", "Supervisor", "Charger", "Accelerometer", "Altimeter", "Camera", "Compass", "Connector")
_SOLIDS += ("Display", "DistanceSensor", "Emitter", "GPS", "Gyro", "InertialUnit", "LED", "Lidar", "LightSensor", "Pen")
_SOLIDS += ("Radar", "RangeFinder", "Receiver", "Speaker", "TouchSensor", "VacuumGripper")
_HARMLESS = ("WorldInfo", "Viewpoint", "Background", "DirectionalLight", "PointLight", "SpotLight", "Fog", "Shape")
_HARMLESS += ("TexturedBackground", "TexturedBackgroundLight", "CadShape", "Skin", "ContactProperties")
_HARMLESS_ENDINGS = ("Light", "Background", "Appearance")
_UNSUPPORTED = ("Track", "Propeller", "Fluid", "ImmersionProperties")
_SHAPES = ("Box", "Sphere", "Cylinder", "Capsule", "Cone", "IndexedFaceSet", "Mesh", "Plane", "ElevationGrid")
_KNOWN = {*_JOINTS, *_GROUPS, *_SOLIDS, *_HARMLESS, *_UNSUPPORTED, *_SHAPES, "SolidReference", "Physics", "Slot"}
_KNOWN |= {"HingeJointParameters", "JointParameters", "BallJointParameters", "RotationalMotor", "LinearMotor", "Brake"}
_KNOWN |= {
    "PositionSensor",
    "Appearance",
    "PBRAppearance",
    "Material",
    "ImageTexture",
    "Coordinate",
    "Damping",
    "Color",
}
_PARAMETERS = """position axis anchor minStop maxStop springConstant dampingConstant staticFriction stopERP stopCFM
suspensionSpringConstant suspensionDampingConstant suspensionAxis""".split()
_OF_JOINTS = [f"{word}{number}" for word in ("device", "jointParameters", "position") for number in ("", "2", "3")]
_FIELDS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(_JOINTS, (*_OF_JOINTS, "endPoint")),
    **dict.fromkeys(("HingeJointParameters", "JointParameters", "BallJointParameters"), tuple(_PARAMETERS)),
    "Physics": ("density", "mass", "centerOfMass", "inertiaMatrix", "damping"),
    "SolidReference": ("solidName",),
    "Solid": tuple("""translation rotation scale name model description contactMaterial immersionProperties
        boundingObject physics locked radarCrossSection recognitionColors translationStep rotationStep children
        linearVelocity angularVelocity scaleStep""".split()),
    "WorldInfo": tuple("""info title window gravity CFM ERP physics basicTimeStep FPS optimalThreadCount
        physicsDisableTime physicsDisableLinearThreshold physicsDisableAngularThreshold defaultDamping inkEvaporation
        coordinateSystem gpsCoordinateSystem gpsReference lineScale dragForceScale dragTorqueScale randomSeed
        contactProperties northDirection""".split()),
    "RotationalMotor": tuple("""name acceleration consumptionFactor controlPID minPosition maxPosition maxVelocity
        maxTorque multiplier sound muscles""".split()),
    "LinearMotor": tuple("""name acceleration consumptionFactor controlPID minPosition maxPosition maxVelocity maxForce
        multiplier sound muscles""".split()),
}  # fmt: skip
_FIELDS["Robot"] = _FIELDS["Supervisor"] = (
    *_FIELDS["Solid"],
    *"""controller controllerArgs customData supervisor
synchronization battery cpuConsumption selfCollision window remoteControl showWindow data kinematic""".split(),
)
"""Node → the fields that it has in Webots."""
_STARTING = 1e-12
_PARALLEL = 1e-6


class Vrml(dict):
    """A node: its fields by name; ``type`` and ``label`` (of DEF) are attributes."""

    def __init__(self, kind, label=""):
        super().__init__()
        self.type, self.label = kind, label

    def nodes(self, field) -> list:
        """The nodes in a field."""
        given = self.get(field)
        return [each for each in (given if isinstance(given, list) else [given]) if isinstance(each, Vrml)]

    def node(self, field):
        return next(iter(self.nodes(field)), None)

    def numbers(self, field, default) -> np.ndarray:
        given = self.get(field, None)
        if given is None:
            return np.array(default, float)
        values = given if isinstance(given, list) else [given]
        return np.array(finite_numbers(values, len(default), given, f"{self.type}: {field}"))

    def number(self, field, default=0.0) -> float:
        return float(self.numbers(field, (default,))[0])

    def word(self, field, default="") -> str:
        given = self.get(field, default)
        given = given[0] if isinstance(given, list) and len(given) == 1 else given
        return str(given) if isinstance(given, (str, Text)) else default


class Text(str):
    """A quoted string."""


def read(path: Path, name: str, folders, *, ignore=()) -> RobotFile:
    """Read a Webots world; see the documentation of the module."""
    protos = Protos(path, folders, parse, _KNOWN)
    if path.suffix.lower() == ".proto":
        scope = protos.read(Path(os.path.abspath(path)))
        nodes, version = [Vrml(each) for each in list(scope.own)[-1:]], scope.version
    else:
        nodes, version, scope = parse(read_bytes(path).decode("utf-8", errors="replace"), Path(os.path.abspath(path)))
    world = _World(protos.written_out(nodes, scope), version, set(ignore))
    if not world.joints and not any(not body.static for body in world.bodies.values()):
        raise FormatError("there is no Solid with Physics, and no joint" + _left_as_they_are(protos))
    scene = Scene(world.bodies, gravity=world.gravity)
    graph = JointGraph(scene, world.joints)
    model, guess = build(scene, graph, world.inertias, name, graph.roots)
    warn_of_inertias(path, moving_inertias("Solid", world.inertias, model))
    motions = [motion for joint in graph.joints for motion in zip(joint.parts, joint.axes, strict=False)]
    forces = [JointSpring(part, axis.stiffness, axis.reference) for part, axis in motions if axis.stiffness]
    actuators = [each for each in world.actuators if model.existJointName(each.joint)]
    for motor in world.actuators:
        if motor not in actuators:
            warn(f"motor {motor.name!r}: it exerts no force here, as its joint closes a loop")
    actuated = tuple(dict.fromkeys(motor.joint for motor in actuators))
    loops, ignored = tuple(graph.loops()), world.counted.lines()
    return RobotFile(model, world.shapes(), loops, (), (*forces, *actuators), guess, actuated, ignored)


def _left_as_they_are(protos) -> str:
    """What may be meant by a world of PROTO nodes that are not written out."""
    if protos.programs:
        return f"; {', '.join(sorted(protos.programs)[:6])}: a PROTO that is a program is not run. {CONVERT}"
    names = [name for name in protos.missing if not name.endswith(_HARMLESS_ENDINGS)]
    if not names:
        return ""
    return (
        f"; the PROTO files of {', '.join(names[:6])} are not beside it: put them there, or name their folder, "
        f"package_dirs=['…/protos']. {CONVERT}"
    )


def parse(content: str, file: Path) -> tuple[list[Vrml], tuple[int, str], Scope]:
    """The nodes of a VRML text of Webots, its version, (year, letter), and its PROTOs."""
    match = re.match(r"\s*#VRML(?:_SIM)?\s+[RV]?(\d+)(\w*)", content)
    if not match:
        raise FormatError("the first line of a Webots world is '#VRML_SIM R2023b utf8'")
    tokens, place = [], 0
    while place < len(content):
        found = _TOKEN.match(content, place)
        if found is None:
            raise FormatError(f"line {content.count(chr(10), 0, place) + 1}: {short_repr(content[place : place + 20])}")
        if found[1] is not None:
            tokens.append(Text(found[1].replace('\\"', '"')))
        elif found[2] or found[3]:
            tokens.append(found[2] or found[3])
        if len(tokens) > MOST_TOKENS:
            raise FormatError(f"more than {MOST_TOKENS:,} words")
        place = found.end()
    reader, version = _Reader(tokens), (int(match[1]), match[2][:1])
    nodes, scope = [], Scope(file, version=version)
    while not reader.at_end():
        word = reader.next()
        if word == "EXTERNPROTO":
            given = str(reader.next())
            scope.paths[name_of(given)] = given
        elif word == "PROTO":
            proto = reader.proto()
            proto.scope = scope
            scope.own[proto.name] = proto
        elif word == "ROUTE":
            reader.skip(3)
        elif word != "IMPORTABLE":
            nodes.append(reader.node(word, 0))
    return nodes, version, scope


class _Reader:
    """A recursive reader of tokens."""

    def __init__(self, tokens):
        self._tokens, self._place, self._labels = tokens, 0, {}

    def at_end(self):
        return self._place >= len(self._tokens)

    def next(self):
        if self.at_end():
            raise FormatError("the file ends within a node")
        self._place += 1
        return self._tokens[self._place - 1]

    def skip(self, count):
        for _ in range(count):
            self.next()

    def peek(self):
        return self._tokens[self._place] if not self.at_end() else ""

    def node(self, word, depth):
        if depth > DEEPEST:
            raise FormatError(f"nodes are nested more than {DEEPEST} deep")
        label = ""
        if word == "USE":
            label = self.next()
            if label not in self._labels:
                raise FormatError(f"USE {str(label)[:40]}: there is no such DEF{near(label, self._labels)}")
            return self._labels[label]
        if word == "DEF":
            label, word = self.next(), self.next()
        if isinstance(word, Text) or not re.fullmatch(r"[A-Za-z_][\w.+-]*", word) or self.next() != "{":
            raise FormatError(f"a node is needed, not {short_repr(str(word))}")
        node = Vrml(str(word), str(label))
        if label:
            self._labels[label] = node
        while (field := self.next()) != "}":
            if field == "ROUTE":
                self.skip(3)
                continue
            if field == "hidden":  # hidden fields save the state of a simulation
                field = "hidden " + self.next()
            node[str(field)] = self._value(depth)
        return node

    def proto(self) -> Proto:
        """A PROTO, behind this word: its name, its parameters in brackets, its nodes in braces."""
        name, parameters, nodes = str(self.next()), {}, []
        if self.next() != "[":
            raise FormatError(f"PROTO {name[:40]}: '[' is missing")
        while (word := self.next()) != "]":
            self.next()  # its type
            if self.peek() == "{":
                self._skip_braces()
            parameter = str(self.next())
            if not word.startswith("event"):
                parameters[parameter] = self._value(0)
        if self.next() != "{":
            raise FormatError(f"PROTO {name[:40]}: '{{' is missing")
        while (word := self.next()) != "}":
            if word == "ROUTE":
                self.skip(3)
            else:
                nodes.append(self.node(word, 0))
        return Proto(name, parameters, nodes[0] if nodes else Vrml("Group"))

    def _skip_braces(self):
        """The values that a parameter may have."""
        depth = 0
        while True:
            depth += {"{": 1, "}": -1}.get(self.next(), 0)
            if not depth:
                return

    def _value(self, depth):
        if self.peek() == "[":
            self.next()
            values = []
            while self.peek() != "]":
                if self.peek() == "ROUTE":
                    self.skip(4)
                else:
                    values.append(self._single(depth))
            self.next()
            return values
        first = self._single(depth)
        if not _is_number(first):
            return first
        values = [first]
        while _is_number(self.peek()):
            values.append(self.next())
        return values

    def _single(self, depth):
        word = self.next()
        if isinstance(word, Text) or _is_number(word) or word in ("TRUE", "FALSE", "NULL"):
            return word
        if word in ("{", "}", "[", "]"):
            raise FormatError(f"a value is needed, not {word!r}")
        if word == "IS":
            return Is(self.next())
        if word in ("DEF", "USE") or self.peek() == "{":
            return self.node(word, depth + 1)
        return word


def _is_number(word) -> bool:
    return isinstance(word, str) and not isinstance(word, (Text, Is)) and finite(word, math.inf) is not None


class _World:
    """The bodies and joints of a world."""

    def __init__(self, nodes, version, ignore):
        self.bodies: dict[str, Body] = {}
        self.inertias: dict[str, pin.Inertia] = {}
        self.joints: list[Joint] = []
        self.actuators: list[Actuator] = []
        self.counted, self._ignore, self._references, self._visuals = Ignored(), ignore, [], []
        self._titles: list[str] = []  # of joints
        self._solids: dict[str, str] = {}  # name of a Solid → its body
        self._poses: dict[str, pin.SE3] = {}  # name of a Solid → its pose
        info = next((node for node in nodes if node.type == "WorldInfo"), Vrml("WorldInfo"))
        size = info.get("gravity")
        system = info.word("coordinateSystem", "ENU" if version >= (2022, "a") else "NUE")
        if isinstance(size, list) and len(size) == 3:  # before R2020b
            self.gravity = info.numbers("gravity", (0.0, -9.81, 0.0))
        else:
            down = -np.eye(3)[1 if system == "NUE" else 2]
            self.gravity = info.number("gravity", 9.81) * down
        for node in nodes:
            _count_fields(node, self.counted, 0)
            self._visit(node, WORLD, pin.SE3.Identity(), 0)
        for make in self._references:
            self.joints.append(make())
        for joint in self.joints:
            if any(math.isfinite(each) for axis in joint.axes for each in (axis.lower, axis.upper)):
                self.counted.add(WATCHED)

    def _visit(self, node, carrier, pose, depth):
        """Add the bodies and joints of a node that `carrier` carries, whose parent has this pose."""
        if node.type in _JOINTS:
            self._joint(node, carrier, pose, depth)
        elif node.type in _UNSUPPORTED:
            self._refuse(node)
        elif node.type in _GROUPS or node.type in _SOLIDS:
            self._group(node, carrier, pose, depth)
        elif node.type == "Slot":
            for each in node.nodes("endPoint"):
                self._visit(each, carrier, pose, depth + 1)
        elif node.type not in _HARMLESS and not node.type.endswith(_HARMLESS_ENDINGS):
            if _has_bodies(node):
                self._refuse(node)
            self.counted.add(f"PROTO {node.type}" if node.type[0].isupper() else node.type)

    def _refuse(self, node):
        if {node.type, node.word("name")} & self._ignore:
            self.counted.add(f"{node.type} (left out)")
            return
        proto = "" if node.type in _KNOWN else f", and its PROTO is a program, or not beside the world. {CONVERT}"
        raise FormatError(
            f"the node {node.type} is not supported, and without it the mechanism may be different{proto}. "
            f"ignore=[{node.type!r}] loads the world without it", element=node.word("name") or node.type
        )  # fmt: skip

    def _group(self, node, carrier, pose, depth):
        if depth > DEEPEST:
            raise FormatError(f"nodes are nested more than {DEEPEST} deep")
        pose = pose * _pose(node)
        if node.type in _SOLIDS:
            if carrier == WORLD and node.node("physics") is not None:
                carrier = self._body(node, pose)
            elif carrier != WORLD:
                self._add_inertia(carrier, node, pose)
            self._solids.setdefault(_name(node), carrier)
            self._poses.setdefault(_name(node), pose)
        self._children(node, carrier, pose, depth)

    def _children(self, node, carrier, pose, depth):
        for child in node.nodes("children"):
            if child.type == "Shape" and carrier != WORLD:
                self._visuals.append((carrier, self.bodies[carrier].pose.actInv(pose), child))
            self._visit(child, carrier, pose, depth + 1)
        if node.node("boundingObject") is not None:
            self.counted.add(COLLISIONS if carrier != WORLD else STATIC)

    def _body(self, node, pose) -> str:
        name = unique(_name(node), self.bodies)
        self.bodies[name] = Body(pose)
        self.inertias[name] = pin.Inertia.Zero()
        self._add_inertia(name, node, pose)
        return name

    def _add_inertia(self, body, node, pose):
        """Add the Physics of a Solid to the body that carries it."""
        physics = node.node("physics")
        if physics is None:
            return
        own = _inertia(physics, node)
        self.inertias[body] = self.inertias[body] + self.bodies[body].pose.actInv(pose).act(own)
        if physics.node("damping") is not None:
            self.counted.add("damping of a Solid")

    def _joint(self, node, carrier, pose, depth):
        end = node.node("endPoint")
        if end is None:
            return
        name = self._joint_name(node)
        kind, axes, frame, at = _motion(node)
        motors = self._motors(node, name, kind)
        if end.type == "SolidReference":
            wanted = end.word("solidName")
            self._references.append(lambda: self._closing(node, name, kind, axes, carrier, pose * frame, wanted))
            return
        if end.type in _JOINTS or end.type not in _SOLIDS:
            self._refuse(end)
            return
        there = pose * _pose(end)
        child = self._body(end, there)
        self._solids.setdefault(_name(end), child)
        self._poses.setdefault(_name(end), there)
        ends = self._on(carrier, pose * frame), self._on(child, pose * frame * at)
        self.joints.append(Joint(name, kind, carrier, child, *ends, axes))
        self.actuators += motors
        self._children(end, child, there, depth)

    def _joint_name(self, node):
        devices = [*node.nodes("device"), *node.nodes("device2"), *node.nodes("device3")]
        named = next((each.word("name") for each in devices if "Motor" in each.type and each.word("name")), "")
        named = named or next((each.word("name") for each in devices if each.word("name")), "")
        end = node.node("endPoint")
        named = named or node.label or f"{end.word('name') or end.word('solidName') or 'end'} joint"
        self._titles.append(unique(named, (*self._titles, *self.bodies)))
        return self._titles[-1]

    def _closing(self, node, name, kind, axes, carrier, frame, wanted):
        if wanted == "<static environment>":
            child = WORLD
        elif wanted in self._solids:
            child = self._solids[wanted]
        else:
            reason = f"there is no Solid {wanted[:60]!r}{near(wanted, self._solids)}"
            raise FormatError(reason, element=f"SolidReference of {node.type}")
        if child == carrier:
            raise FormatError(f"it connects {child!r} to itself", element=f"SolidReference {wanted[:60]!r}")
        return Joint(name, kind, carrier, child, self._on(carrier, frame), self._on(child, frame), axes, must_cut=True)

    def _on(self, body, frame) -> pin.SE3:
        return frame if body == WORLD else self.bodies[body].pose.actInv(frame)

    def _motors(self, node, name, kind):
        found = []
        for field, part in (("device", 0), ("device2", 1), ("device3", 2)):
            for motor in (each for each in node.nodes(field) if each.type in ("RotationalMotor", "LinearMotor")):
                label = motor.word("name") or name
                parts = (f"{name}_axis", f"{name}_axis2") if kind == "universal" else (name,)
                if part >= len(parts) or kind == "ball":
                    warn(f"motor {label!r}: it exerts no force here, as its joint has several degrees of freedom")
                    continue
                limit = motor.number("maxTorque" if motor.type == "RotationalMotor" else "maxForce", 10.0)
                found.append(Actuator(label, parts[part], force_range=(-limit, limit) if limit > 0.0 else ()))
        return found

    def shapes(self) -> str:
        """The boxes, spheres and cylinders of the bodies as URDF."""
        robot, links = fixed_links(self.bodies)
        for body, place, shape in self._visuals:
            geometry = shape.node("geometry")
            if geometry is None:
                continue
            if geometry.type == "Box":
                add_visual(links[body], place, "box", {"size": text(*geometry.numbers("size", (0.1, 0.1, 0.1)))})
            elif geometry.type == "Sphere":
                add_visual(links[body], place, "sphere", {"radius": text(geometry.number("radius", 0.1))})
            elif geometry.type in ("Cylinder", "Capsule"):
                sizes = {"radius": text(geometry.number("radius", 0.1)), "length": text(geometry.number("height", 0.2))}
                add_visual(links[body], place, "cylinder", sizes)
        return tostring(robot, encoding="unicode")


def _count_fields(node, counted, depth):
    """Count the fields that a node does not have in Webots, and suspensions, which do not act."""
    if depth > DEEPEST:
        return
    known = _FIELDS.get(node.type)
    for field, value in node.items():
        if known is not None and field not in known and not field.startswith("hidden "):
            counted.add(f"<{field[:60]}> of {node.type}")
        numbers = [finite(each) for each in (value if isinstance(value, list) else [value])]
        if field.startswith("suspension") and field != "suspensionAxis" and numbers != [0.0]:
            counted.add("suspension of a joint")
        for each in node.nodes(field):
            _count_fields(each, counted, depth + 1)


def _has_bodies(node, depth=0) -> bool:
    """Whether a node of an unknown type has joints or Physics in its fields."""
    if depth > DEEPEST:
        return True
    for field in node:
        for each in node.nodes(field):
            if each.type in (*_JOINTS, "Physics", "Solid", "SolidReference") or _has_bodies(each, depth + 1):
                return True
    return False


def _name(node) -> str:
    return node.word("name") or node.label or node.type.lower()


def _pose(node) -> pin.SE3:
    if np.any(node.numbers("scale", (1.0, 1.0, 1.0)) != 1.0) and node.type in _SOLIDS:
        raise FormatError("a Solid with a scale is not supported", element=_name(node))
    return pin.SE3(_rotation(node), node.numbers("translation", (0.0, 0.0, 0.0)))


def _rotation(node) -> np.ndarray:
    *axis, angle = node.numbers("rotation", (0.0, 0.0, 1.0, 0.0))
    if not np.any(axis):
        return np.eye(3)
    return pin.AngleAxis(float(angle), unit(axis)).toRotationMatrix()


def _motion(node):
    """(kind, axes, frame in the parent, frame of the end point in this one at the start)."""
    first = node.node("jointParameters") or Vrml("JointParameters")
    second = node.node("jointParameters2") or Vrml("JointParameters")
    anchor = first.numbers("anchor", (0.0, 0.0, 0.0)) if node.type != "SliderJoint" else np.zeros(3)
    frame = pin.SE3(np.eye(3), anchor)
    if node.type == "BallJoint":
        damping = first.number("dampingConstant")
        return "ball", (Axis(np.zeros(3), damping=damping),), frame, pin.SE3.Identity()
    axis = _axis(first, (0.0, 0.0, 1.0) if node.type == "SliderJoint" else (1.0, 0.0, 0.0))
    if node.type == "SliderJoint":
        return "prismatic", (axis,), frame, pin.SE3(np.eye(3), axis.initial * axis.direction)
    if node.type == "HingeJoint":
        return "revolute", (axis,), frame, _turn(axis)
    other = _axis(second, (0.0, 0.0, 1.0))
    if np.linalg.norm(np.cross(axis.direction, other.direction)) < _PARALLEL:
        raise FormatError("its two axes are parallel", element="Hinge2Joint")
    return "universal", (axis, other), frame, _turn(axis) * _turn(other)


def _turn(axis) -> pin.SE3:
    return pin.SE3(pin.AngleAxis(axis.initial, axis.direction).toRotationMatrix(), np.zeros(3))


def _axis(parameters, default) -> Axis:
    direction = parameters.numbers("axis", default)
    if not direction.any():
        raise FormatError("the axis is the zero vector", element=parameters.type)
    low, high = parameters.number("minStop"), parameters.number("maxStop")
    limits = {"lower": low, "upper": high} if low < high else {}
    values = {"damping": "dampingConstant", "friction": "staticFriction", "stiffness": "springConstant"}
    numbers = {key: max(parameters.number(field), 0.0) for key, field in values.items()}
    position = parameters.number("position")
    return Axis(unit(direction), initial=position if abs(position) > _STARTING else 0.0, **numbers, **limits)


def _inertia(physics, solid) -> pin.Inertia:
    """The inertia of a Solid in its frame: what Physics says, the rest from its bounding object."""
    mass, density = physics.number("mass", -1.0), physics.number("density", WATER)
    given = physics.get("inertiaMatrix")
    matrix = physics.numbers("inertiaMatrix", (0.0,) * 6) if isinstance(given, list) and len(given) == 6 else None
    centre = physics.get("centerOfMass")
    lever = physics.numbers("centerOfMass", (0.0, 0.0, 0.0)) if isinstance(centre, list) and len(centre) == 3 else None
    found = pin.Inertia.Zero()
    if matrix is None or mass < 0.0 or lever is None:
        found = _bounds(solid.node("boundingObject"), np.eye(4), 0)
    if mass < 0.0:
        if not found.mass:
            raise FormatError("its mass depends on a boundingObject that it has not", element=f"Solid {_name(solid)!r}")
        mass = density * found.mass
    if found.mass:
        found = solids.scaled(found, mass / found.mass)
    inertia = np.array(found.inertia)
    if matrix is not None:
        xx, yy, zz, xy, xz, yz = matrix
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    elif not found.mass:
        warn(f"Solid {_name(solid)!r}: it has neither an inertiaMatrix nor a boundingObject; it is taken as a point")
    made = pin.Inertia.Zero()
    made.mass, made.inertia = mass, inertia
    made.lever = lever if lever is not None else np.array(found.lever)
    return made


def _bounds(node, matrix, depth) -> pin.Inertia:
    """The solid of density 1 of a bounding object."""
    total = pin.Inertia.Zero()
    if node is None or depth > DEEPEST:
        return total
    if node.type in ("Group", "Transform", "Pose"):
        own = np.eye(4)
        own[:3, :3] = _rotation(node) * node.numbers("scale", (1.0, 1.0, 1.0))
        own[:3, 3] = node.numbers("translation", (0.0, 0.0, 0.0))
        for child in node.nodes("children"):
            total = total + _bounds(child, matrix @ own, depth + 1)
        return total
    if node.type == "Shape":
        return _bounds(node.node("geometry"), matrix, depth + 1)
    if node.type not in _SHAPES:
        return total
    solid = _solid(node)
    return solids.moved(solid, matrix) if solid is not None else total


def _solid(node):
    radius, height = node.number("radius", 0.1), node.number("height", 0.2)
    if node.type == "Box":
        return solids.box(*node.numbers("size", (0.1, 0.1, 0.1)))
    if node.type == "Sphere":
        return solids.ellipsoid(radius, radius, radius)
    if node.type in ("Cylinder", "Capsule"):
        return (solids.cylinder if node.type == "Cylinder" else solids.capsule)(radius, height)
    if node.type == "Cone":
        return solids.cone(node.number("bottomRadius", 0.1), height)
    if node.type == "IndexedFaceSet" and node.node("coord") is not None:
        return _faces(node)
    return None


def _faces(node):
    points = [finite(each) for each in node.node("coord").get("point", [])]
    indices, triangles, face = [int(float(each)) for each in node.get("coordIndex", [])], [], []
    for index in [*indices, -1]:
        if index >= 0:
            face.append(index)
            continue
        triangles += [(face[0], face[i], face[i + 1]) for i in range(1, len(face) - 1)]
        face = []
    if None in points or len(points) % 3 or not triangles or max(map(max, triangles)) >= len(points) // 3:
        return None
    return solids.mesh(np.array(points).reshape(-1, 3), np.array(triangles))
