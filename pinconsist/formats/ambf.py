"""Bodies of AMBF, the Asynchronous Multi-Body Framework (``.yaml``): ``bodies`` and ``joints`` of any graph.

A body stands at ``location``, its mass at ``inertial offset`` in it; without mass it does not move. A joint has a
``pivot`` and an ``axis`` in each of its two bodies. At zero both coincide, and the child is turned about the axis by
``offset`` from the smallest rotation that makes the axes parallel. Assembly starts at the locations. Joints that are
``detached`` or ``redundant`` close loops, and so do those that the tree has no place for.

``revolute`` (``hinge``, ``continuous``), ``prismatic`` (``slider``), ``fixed``, ``p2p`` and ``cone twist`` (balls), and
springs (``linear spring``, ``torsion spring``) are read; ``stiffness``, ``damping`` and ``equilibrium point`` act.
The motors are the joints that are not ``passive``, by force; controllers are outside of the file. An inertia that is
missing is that of a box around the mesh, as Bullet has it for convex hulls, or around the collision shape.

Source: the loader of AMBF 1.0 and Bullet's constraints.
"""

import math
from pathlib import Path
from xml.etree.ElementTree import tostring

import numpy as np
import pinocchio as pin

from ..errors import FormatError, warn
from ..mechanism.file_laws import COLLISIONS, STATIC, WATCHED
from ..mechanism.forces import JointSpring, Wrench
from ..mechanism.loops import unit
from . import solids
from .extensions import pose, unique
from .graph import WORLD, Axis, Body, Joint, JointGraph, Scene, build
from .ignored import Ignored
from .loopfile import parsed_yaml
from .plausible import moving_inertias, warn_of_inertias
from .reading import LARGEST, RobotFile, finite, near, read_bytes, short_repr, text
from .urdf import add_visual, fixed_links

_KINDS = {
    **dict.fromkeys(("revolute", "hinge", "continuous", "torsion spring", "torsional spring"), "revolute"),
    **dict.fromkeys(("prismatic", "slider", "spring", "linear spring"), "prismatic"),
    **dict.fromkeys(("p2p", "cone twist", "spherical", "ball"), "ball"),
    "angular spring": "revolute",
    "fixed": "fixed",
}
_UNSUPPORTED = ("soft bodies", "vehicles")
_LISTS = ("bodies", "joints", "actuators", *_UNSUPPORTED)
_LOOKED_AT = ("sensors", "cameras", "lights", "volumes", "ghost objects")
_FILE = _LISTS + _LOOKED_AT + ("high resolution path", "low resolution path", "gravity", "namespace", "name", "version")
_FILE += ("ignore inter-collision", "max impulse", "joint erp", "joint cfm", "shaders", "plugins", "collision margin")
_SHARED = ("name", "namespace", "parent", "passive", "plugins", "controller", "controller output type", "damping")
_SHARED += ("publish frequency", "friction", "restitution")
_BODY = (*_SHARED, "mesh", "mass", "inertia", "inertial offset", "scale", "location", "gravity", "static", "kinematic")
_BODY += ("shape", "geometry", "compound shape", "collision shape", "collision geometry", "compound collision shape")
_BODY += ("collision mesh", "collision mesh type", "collision margin", "collision offset", "collision groups")
_BODY += ("color", "color rgba", "color components", "visible", "visible size", "visible color", "shaders")
_BODY += ("publish children names", "publish joint names", "publish joint positions")
_BODY += ("high resolution path", "low resolution path", "mesh remove duplicates")
_JOINT = (*_SHARED, "type", "child", "origin", "axis", "offset", "joint offset", "child offset", "stiffness")
_JOINT += ("parent pivot", "child pivot", "parent axis", "child axis", "joint limits", "equilibrium point")
_JOINT += ("enable motor", "enable feedback", "max motor impulse", "joint erp", "joint cfm", "ignore inter-collision")
_JOINT += ("redundant", "detached")
_PARALLEL = 1e-3  # rad: angle between two axes below which AMBF takes them as parallel, or from π as opposite
_STARTING = 1e-12
_ZERO = (0.0, 0.0, 0.0)


def read(path: Path, name: str, folders, *, ignore=()) -> RobotFile:
    """Read a body of AMBF; see the documentation of the module."""
    given = parsed_yaml(read_bytes(path), aliases=True)
    scene = _Ambf(given, folders, set(ignore))
    graph = JointGraph(scene, scene.joints)
    model, guess = build(scene, graph, scene.inertias, name, graph.roots)
    warn_of_inertias(path, moving_inertias("body", scene.inertias, model))
    motions = [motion for joint in graph.joints for motion in zip(joint.parts, joint.axes, strict=False)]
    springs = tuple(JointSpring(part, axis.stiffness, axis.reference) for part, axis in motions if axis.stiffness)
    actuated = tuple(each for each in scene.motors if model.existJointName(each))
    forces, ignored = (*springs, *scene.weights(model)), scene.ignored.lines()
    return RobotFile(model, scene.shapes(), tuple(graph.loops()), (), forces, guess, actuated, ignored)


class _Ambf(Scene):
    """The bodies and joints of a file."""

    def __init__(self, given, folders, ignore):
        super().__init__({})
        self.ignored, self._folders, self._ignore = Ignored(), [Path(folder).resolve() for folder in folders], ignore
        self.inertias: dict[str, pin.Inertia] = {}
        self.joints: list[Joint] = []
        self.motors: list[str] = []
        self.pulled: dict[str, np.ndarray] = {}  # body → its own gravity
        self._places: dict[str, tuple[str, float]] = {}  # key of a body → its name, its scale
        self._shapes: list[tuple] = []
        if not isinstance(given, dict) or not isinstance(given.get("bodies"), list):
            raise FormatError("a file of AMBF has a list of bodies")
        self._given = given
        for key in _UNSUPPORTED:
            listed = self._names(key)
            if listed:
                reason = f"{key} are not supported, and without them the mechanism may be different"
                raise FormatError(f"{reason}. ignore=[{key!r}] loads the file without them", element=listed[0])
        self.gravity = None if given.get("gravity") is None else np.array(_three(given, "gravity", "gravity"))
        self._meshes = [str(given.get(key, "")) for key in ("low resolution path", "high resolution path")]
        for key in self._names("bodies"):
            self._body(key)
        for key in self._names("joints"):
            self._joint(key)
        self.ignored.add("actuator", len(self._names("actuators")))
        listed = {*_FILE, *(each for one in (*_LISTS, *_LOOKED_AT) for each in self._listed(one))}
        for key in given:
            if key not in listed:
                self.ignored.add(f"<{str(key)[:60]}>")

    def _listed(self, key) -> list[str]:
        listed = self._given.get(key)
        return list(map(str, listed)) if isinstance(listed, list) else []

    def _names(self, key) -> list[str]:
        """The entries of a list of the file, without those that are left out."""
        if key in self._ignore:
            return []
        return [each for each in self._listed(key) if not {each, each.partition(" ")[2]} & self._ignore]

    def _entry(self, key, known) -> dict:
        entry = self._given.get(key)
        if not isinstance(entry, dict):
            raise FormatError(f"it is listed, but there is no mapping {key[:60]!r}", element=key[:60])
        for each in entry:
            if each not in known:
                self.ignored.add(f"<{str(each)[:60]}> of {key.partition(' ')[0]}")
        return entry

    def _body(self, key):
        entry = self._entry(key, _BODY)
        name = unique(str(entry.get("name") or key.partition(" ")[2]), (*self.bodies, WORLD))
        element = f"body {name[:60]!r}"
        place, mass = _place(entry.get("location"), f"{element}: location"), _number(entry, "mass", element, 0.0)
        if mass < 0.0:
            raise FormatError(f"the mass is negative: {mass:g} kg", element=element)
        scale = finite(entry.get("scale", 1.0))
        scale = 1.0 if scale is None else scale
        self._places[key] = name, scale
        static = not mass or entry.get("static") is True or entry.get("kinematic") is True
        self.bodies[name] = Body(place, static)
        self.inertias[name] = self._inertia(entry, name, mass, scale, element)
        if entry.get("gravity") is not None:
            self.pulled[name] = np.array(_three(entry, "gravity", element))
        shape = any(entry.get(each) for each in ("mesh", "collision shape", "geometry", "compound collision shape"))
        self.ignored.add(STATIC if static else COLLISIONS, shape)
        damping = entry.get("damping")
        drag = damping.values() if isinstance(damping, dict) else ()
        self.ignored.add("body damping", not static and any(finite(each) for each in drag))

    def _inertia(self, entry, name, mass, scale, element) -> pin.Inertia:
        """The inertia of a body in its frame."""
        place = _place(entry.get("inertial offset"), f"{element}: inertial offset")
        given = entry.get("inertia")
        made = pin.Inertia.Zero()
        made.mass = mass
        if isinstance(given, dict):
            made.inertia = np.diag([_number(given, key, f"{element}: inertia") for key in ("ix", "iy", "iz")])
            return place.act(made)
        size = self._size(entry, name, scale)
        if size is not None and mass:
            middle, edges = size
            made.inertia = np.array(solids.scaled(solids.box(*edges), mass / np.prod(edges)).inertia)
            if not isinstance(entry.get("inertial offset"), dict):
                place = pin.SE3(np.eye(3), middle)
        elif mass:
            warn(f"{element}: it has neither an inertia nor a shape that can be read, and is a point of {mass:g} kg")
        return place.act(made)

    def _size(self, entry, name, scale) -> tuple[np.ndarray, np.ndarray] | None:
        """Centre and edges of the box around the shape of a body."""
        box = _box_of_shape(entry)
        if box is not None:
            self._shapes.append((name, box))
            return np.zeros(3), scale * np.array(box)
        file = str(entry.get("mesh") or "")
        found = self._mesh(file) if file else None
        if found is None:
            return None
        points = scale * _points(found)
        low, high = points.min(axis=0), points.max(axis=0)
        return ((low + high) / 2.0, high - low) if (high > low).all() else None

    def _mesh(self, file) -> Path | None:
        """A mesh of the file, if it is in one of the folders."""
        for folder in self._folders:
            for inner in (*self._meshes, ""):
                path = (folder / inner / file).resolve()
                if path.is_file() and any(path.is_relative_to(root) for root in self._folders):
                    return path
        return None

    def _joint(self, key):
        entry = self._entry(key, _JOINT)
        title = str(entry.get("name") or key.partition(" ")[2])
        name = unique(title, (*self.bodies, *(joint.name for joint in self.joints)))
        element = f"joint {title[:60]!r}"
        word = str(entry.get("type", "")).strip().lower()
        if word not in _KINDS:
            reason = f"the type {word[:40]!r} is not one of {', '.join(_KINDS)}"
            raise FormatError(f"{reason}; ignore=[{title[:60]!r}] loads the file without it", element=element)
        (parent, scale1), (child, scale2) = (self._end(entry, end, element) for end in ("parent", "child"))
        if parent == child:
            raise FormatError(f"parent and child are the same body {parent[:60]!r}", element=element)
        pivots = [np.array(_three(entry, f"{end} pivot", element, _ZERO)) for end in ("parent", "child")]
        pivots = [scale1 * pivots[0], scale2 * pivots[1]]
        kind = _KINDS[word]
        turn = self._turn(entry, element) if kind != "ball" else np.eye(3)
        on_parent, on_child = pin.SE3(np.eye(3), pivots[0]), pin.SE3(turn.T, pivots[1])
        ends = self.bodies[parent].pose * on_parent, self.bodies[child].pose * on_child
        axes = self._axes(entry, kind, ends[0].actInv(ends[1]), "spring" in word, element)
        cut = entry.get("redundant") is True or entry.get("detached") is True
        self.joints.append(Joint(name, kind, parent, child, on_parent, on_child, axes, must_cut=cut))
        if kind in ("revolute", "prismatic") and "spring" not in word and entry.get("passive") is not True and not cut:
            self.motors.append(name)

    def _end(self, entry, end, element) -> tuple[str, float]:
        wanted = str(entry.get(end, ""))
        named = {name: (name, scale) for name, scale in self._places.values()}
        found = self._places.get(wanted) or named.get(wanted) or named.get(wanted.rpartition("/")[2])
        if found is None:
            raise FormatError(f"there is no {end} {wanted[:60]!r}{near(wanted, self._places)}", element=element)
        return found

    def _turn(self, entry, element) -> np.ndarray:
        """The rotation of the child in the parent at zero."""
        one, two = (unit(np.array(_three(entry, f"{end} axis", element))) for end in ("parent", "child"))
        angle = _number(entry, "offset" if "offset" in entry else "child offset", element, 0.0)
        return pin.AngleAxis(angle, one).toRotationMatrix() @ _between(two, one)

    def _axes(self, entry, kind, start, springs, element) -> tuple[Axis, ...]:
        """The axes of a joint whose frames are `start` from each other where the bodies stand."""
        if kind == "fixed":
            return ()
        damping = _number(entry, "damping", element, 0.0) if not isinstance(entry.get("damping"), dict) else 0.0
        if damping < 0.0:
            raise FormatError(f"damping: {damping:g} is negative", element=element)
        if kind == "ball":
            turned = pin.Quaternion(start.rotation).coeffs()
            self.ignored.add(WATCHED, bool(entry.get("joint limits")))
            return (Axis(np.zeros(3), initial=tuple(turned.tolist())),)
        axis = unit(np.array(_three(entry, "parent axis", element)))
        if kind == "revolute":
            at = float(axis @ pin.log3(start.rotation))
        else:
            at = float(axis @ start.translation)
        limits = entry.get("joint limits")
        low, high = -math.inf, math.inf
        if isinstance(limits, dict) and "low" in limits and "high" in limits:
            low, high = (_number(limits, end, f"{element}: joint limits") for end in ("low", "high"))
            low, high = (low, high) if low <= high else (-math.inf, math.inf)
            self.ignored.add(WATCHED, low <= high)
        numbers = {"damping": damping, "lower": low, "upper": high, "initial": at if abs(at) > _STARTING else 0.0}
        if springs:
            middle = 0.5 * (low + high) if math.isfinite(high - low) else 0.0
            numbers["stiffness"] = _number(entry, "stiffness", element, 0.0)
            numbers["reference"] = _number(entry, "equilibrium point", element, middle)
        return (Axis(axis, **numbers),)

    def weights(self, model) -> tuple[Wrench, ...]:
        """For each body with a gravity of its own, the force that makes the difference."""
        found = []
        for name, gravity in self.pulled.items():
            inertia, force = self.inertias[name], self.inertias[name].mass * (gravity - model.gravity.linear)
            if force.any() and model.frames[model.getFrameId(name)].parentJoint:
                found.append(Wrench(name, tuple(force.tolist()), xyz=tuple(inertia.lever.tolist())))
        return tuple(found)

    def shapes(self) -> str:
        """The shapes of the bodies as URDF; meshes are not shown."""
        robot, links = fixed_links(self.bodies or [WORLD])
        for body, box in self._shapes:
            add_visual(links[body], pin.SE3.Identity(), "box", {"size": text(*box)})
        return tostring(robot, encoding="unicode")


def _box_of_shape(entry) -> tuple[float, ...] | None:
    """The edges of the box around a ``collision shape``."""
    shape = str(entry.get("collision shape") or entry.get("shape") or "").lower()
    sizes = entry.get("collision geometry") or entry.get("geometry")
    if not shape or not isinstance(sizes, dict):
        return None
    length = {key: finite(value) or 0.0 for key, value in sizes.items()}
    edges = [2.0 * length.get("radius", 0.0)] * 3
    if shape == "box":
        edges = [length.get(key, 0.0) for key in "xyz"]
    elif shape in ("cylinder", "capsule", "cone"):
        along = max("xyz".find(str(sizes.get("axis", "z")).lower()), 0)
        edges[along] = length.get("height", 0.0) + edges[along] * (shape == "capsule")
    elif shape != "sphere":
        return None
    return tuple(edges) if min(edges) > 0.0 else None


def _points(path: Path) -> np.ndarray:
    """The points of a mesh file, (n, 3)."""
    import coal

    try:
        return np.array(coal.MeshLoader().load(str(path), np.ones(3)).vertices())
    except Exception as error:  # Boost.Python may raise any kind
        raise FormatError(f"the mesh {path.name} cannot be read: {error}") from None


def _between(start, end) -> np.ndarray:
    """The smallest rotation that takes one direction to another, and the one that AMBF chooses if they are opposite."""
    angle = math.acos(min(max(float(start @ end), -1.0), 1.0))
    if angle < _PARALLEL:
        return np.eye(3)
    about = np.cross(start, end)
    if angle > math.pi - _PARALLEL:
        x, y = np.eye(3)[:2]
        about = np.cross(start, x) if np.linalg.norm(np.cross(start, x)) > _PARALLEL else np.cross(end, y)
    return pin.AngleAxis(angle, unit(about)).toRotationMatrix()


def _place(given, element) -> pin.SE3:
    if not isinstance(given, dict):
        return pin.SE3.Identity()
    xyz = _three(given, "position", element, _ZERO)
    turn = given.get("orientation")
    angles = [_number(turn, key, f"{element}: orientation") for key in "rpy"] if isinstance(turn, dict) else _ZERO
    return pose(xyz, angles)


def _three(given, key, element, default=None) -> tuple[float, ...]:
    found = given.get(key)
    if found is None and default is not None:
        return default
    read = [finite(found.get(each)) for each in "xyz"] if isinstance(found, dict) else []
    values = tuple(each for each in read if each is not None)
    if len(values) != 3:
        raise FormatError(f"{key}: {short_repr(found)} is not {{x: …, y: …, z: …}}", element=element)
    if key.endswith("axis") and not any(values):
        raise FormatError(f"{key}: it is the zero vector", element=element)
    return values


def _number(given, key, element, default=None) -> float:
    value = given.get(key, default)
    number = finite(value)
    if number is None:
        raise FormatError(f"{key}: {short_repr(value)} is not a finite number up to {LARGEST:g}", element=element)
    return number
