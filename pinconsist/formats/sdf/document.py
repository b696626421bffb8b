"""SDF elements → bodies, joints and frames with their poses in the world, before the tree is built.

A full name contains the names of the models, ``model::link``; the world is ``"world"``. Sources: the tutorials "Pose
frame semantics" and "Model composition" of sdformat.org.
"""

import math
import re
from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from ...errors import FormatError, warn
from ...mechanism.loops import unit
from ..extensions import unique
from ..plausible import warn_of_degrees
from ..reading import Node, floats, near, require_known, short_repr
from ..urdf import INERTIA
from .includes import FRAMES, VERSION, numbers_of

WORLD = "world"
OLDEST = (1, 2)  # 1.2 and 1.3 have the same poses, axes and inertias as 1.4
DEEPEST = 30
GRAVITY = (0.0, 0.0, -9.8)  # of a world without <gravity>, m/s²
INFINITE = 1e16  # limits from this size on are infinite, as in libsdformat

_REQUIRED = (*INERTIA, "xyz", "size", "radius", "length", "spring_stiffness", "spring_reference")
"""Elements that must not be empty."""
_MODEL = ("link", "joint", "frame", "model", "include", "pose", "static", "self_collide", "allow_auto_disable")
_MODEL += ("plugin", "gripper", "enable_wind")
_WORLD = ("model", "joint", "frame", "include", "gravity", "physics", "scene", "light", "plugin", "gui", "atmosphere")
_WORLD += ("magnetic_field", "wind", "spherical_coordinates", "audio", "road", "actor", "state", "population")


class SdfNode(Node):
    """An element of SDF; its numbers, flags and names are the texts of its child elements.

    An empty one stands for its default, as in libsdformat, except for numbers that an element must have.
    """

    def values(self, tag: str, default: tuple[float, ...]) -> tuple[float, ...]:
        found = self.child(tag)
        given = found.text() or (found and tag in _REQUIRED)
        return floats(found.text(), len(default), found.name) if given else default

    def value(self, tag: str, default: float = 0.0) -> float:
        return self.values(tag, (default,))[0]

    def limit(self, tag: str, default: float) -> float:
        """The number in a child, which may be infinite."""
        found = self.child(tag)
        try:
            value = float(found.text()) if found.text() else default
        except ValueError:
            value = math.nan
        if math.isnan(value):
            raise found.error(f"{short_repr(found.text())} is not a number")
        return math.copysign(math.inf, value) if abs(value) >= INFINITE else value

    def flag(self, tag: str, default: bool = False) -> bool:
        found = self.child(tag)
        return found.truth(found.text()) if found.text() else default

    def truth(self, text: str) -> bool:
        """A truth value of SDF: true, false, 1 or 0."""
        word = text.strip().lower()
        if word not in ("true", "1", "false", "0"):
            raise self.error(f"{short_repr(text.strip())} is neither true nor false")
        return word in ("true", "1")

    def word(self, tag: str) -> str:
        found = self.child(tag, required=True)
        if not found.text():
            raise self.error(f"<{tag}> is empty")
        return found.text()

    def pose(self) -> tuple[pin.SE3, str]:
        """The `<pose>`, and the name of the frame that it is relative to (empty: the default frame).

        x y z in m, then roll pitch yaw in rad, or degrees, or a quaternion x y z w, which is normalised.
        """
        found = self.child("pose")
        if not found:
            return pin.SE3.Identity(), ""
        style = found.get("rotation_format", "euler_rpy")
        if style not in ("euler_rpy", "quat_xyzw"):
            raise found.error(f"the rotation_format {short_repr(style)} is neither euler_rpy nor quat_xyzw")
        default = "0 0 0 0 0 0" if style == "euler_rpy" else "0 0 0 0 0 0 1"
        values = np.array(floats(found.text() or default, len(default.split()), found.name))
        turn = values[3:]
        if style == "euler_rpy":
            in_degrees = found.truth(found.get("degrees", "false"))
            rotation = pin.rpy.rpyToMatrix(np.radians(turn) if in_degrees else turn)
            if not in_degrees:
                warn_of_degrees("", [(found.name, turn.tolist())])
        elif turn.any():
            rotation = pin.Quaternion(unit(turn)).toRotationMatrix()
        else:
            raise found.error("the quaternion is zero")
        return pin.SE3(rotation, values[:3]), found.get("relative_to") or found.get("frame")  # the latter before 1.7

    def warn_unknown(self, known: tuple[str, ...]) -> None:
        """Warn of unknown children, which are probably misspelt; they have no effect."""
        for tag in dict.fromkeys(child.tag for child in (() if self.xml is None else self.xml)):
            if tag not in known and "}" not in tag:  # extensions are counted
                warn(f"{self.name}: the element <{tag}> is not known and has no effect{near(tag, known)}")


class Body(NamedTuple):
    """A link: its element, its pose in the world, the model that it belongs to, and whether it is fixed."""

    node: SdfNode
    pose: pin.SE3
    scope: str
    static: bool


class Frame(NamedTuple):
    """A frame as given in the file. It refers to others by (scope, name); a scope is a model's full name, or empty."""

    element: str  # the name that messages use
    pose: pin.SE3  # in `base`; for a model with a `placement` frame, the pose of that frame
    base: tuple[str, str]
    attached: tuple[str, str] | None  # the frame that it moves with; None: it is a link itself
    placement: str = ""


def join(scope: str, name: str) -> str:
    """The full name of the element called `name` in a scope."""
    return f"{scope}::{name}" if scope else name


class Document:
    """The contents of a parsed file, by their names in the mechanism; FormatError for the first error.

    All names of a file are collected first, and references are resolved afterwards. `frames` are the `<frame>`
    elements, each with the body that it moves with and its pose in the world; `roots` are the bodies that the file
    names as canonical links.
    """

    def __init__(self, raw: Element):
        self.version, top = _version(raw), SdfNode(raw, "sdf")
        self.joints: list[tuple[str, SdfNode, str]] = []  # full name, element, scope; not of static models
        self.plugins: list[tuple[SdfNode, str]] = []  # of models: element, scope
        self.gravity: np.ndarray | None = None  # m/s²; None if there is no world
        if worlds := raw.findall("world"):
            if len(worlds) > 1:
                raise FormatError(f"this file has {len(worlds)} worlds; keep one of them")
            top = SdfNode(worlds[0], "world")
            top.warn_unknown(_WORLD)
            if top.child("state"):
                warn("world: <state> has no effect; the models are placed by their own poses")
            holder = top if self.version > (1, 5) else top.child("physics")
            self.gravity = np.array(holder.values("gravity", GRAVITY))
        models, self._cut = top.children("model"), 0  # length of the prefix that the mechanism drops
        if len(models) == 1 and not top.child("joint") and not top.child("frame"):
            self._cut = len(join(models[0].get("name"), ""))
        self._all: dict[str, Frame] = {}  # by full name, like the following dictionaries
        self._poses = {WORLD: pin.SE3.Identity()}
        self._links, self._extra, self._canonical = {}, [], []
        self._versions: dict[str, tuple[int, ...]] = {}  # of included models, by full name
        self.models: dict[str, SdfNode] = {}  # by full name
        for model in models:
            self._model(model, "", False, 0)
        self._joints_and_frames(top, "", False)
        if not self._links:
            raise FormatError("there is no link")
        self.bodies = {
            self.short(full): Body(node, self.pose(full), scope, static)
            for full, (node, scope, static) in self._links.items()
        }
        self.frames = {self.short(full): (self.body(full), self.pose(full)) for full in self._extra}
        self.roots = [self.body(full) for full in self._canonical]

    def _model(self, node, scope, static, depth):
        full = self._name(node, "model", scope)
        if depth > DEEPEST:
            raise node.error(f"models are nested more than {DEEPEST} deep")
        self.models[full] = node
        if node.get(VERSION):
            self._versions[full] = numbers_of(node.get(VERSION))
        node.warn_unknown(_MODEL)
        static = static or node.flag("static")
        inner = [each.get("name") for tag in ("link", "model") for each in node.children(tag)]
        if self.version_of(full) < FRAMES:
            inner = [each for each in inner if each != WORLD]
        canonical = node.get("canonical_link")
        if not (inner or static):
            raise node.error("there is no link")
        attached = WORLD if static else canonical or inner[0]
        self._add(full, node, scope, (full, attached), placement=node.get("placement_frame"))
        if canonical and not static:
            self._canonical.append(full)
        for link in node.children("link"):
            if link.get("name") == WORLD and self.version_of(full) < FRAMES:
                continue  # joints to the world are to the ground, and nothing else holds this link
            name = self._name(link, "link", full)
            self._add(name, link, full, None)
            self._links[name] = link, full, static or link.flag("kinematic")
        for each in node.children("model"):
            self._model(each, full, static, depth + 1)
        self._joints_and_frames(node, full, static)
        self.plugins += [(plugin, full) for plugin in node.children("plugin") if not static]

    def _joints_and_frames(self, node, scope, static):
        for joint in node.children("joint"):
            full = self._name(joint, "joint", scope)
            child = joint.child("child").text()
            if self.version_of(scope) < FRAMES and full in self._links:  # allowed before 1.7
                full += "_joint"
            self._add(full, joint, scope, (scope, child), child)
            if not static:
                self.joints.append((full, joint, scope))
        for frame in node.children("frame"):
            full = self._name(frame, "frame", scope)
            attached = frame.get("attached_to")
            self._add(full, frame, scope, (scope, attached), attached)
            self._extra.append(full)

    def _name(self, node, tag, scope):
        """The full name of an element; also sets the name that messages use for it."""
        name = node.get("name")
        if not name.strip():
            raise FormatError(f"a {tag} has no name")
        if tag == "model" and self.version_of(scope) < FRAMES and join(scope, name) in self._all:
            name = unique(name, (each.removeprefix(join(scope, "")) for each in list(self._all)))  # allowed before 1.7
        if tag == "joint" and name == WORLD and self.version_of(scope) < FRAMES:  # allowed before 1.7
            name = f"{WORLD}_joint"
        if name in (WORLD, "universe") or (name.startswith("__") and name.endswith("__")):
            raise FormatError("the name is reserved; give it another", element=f"{tag} {name[:80]!r}")
        node.name = f"{tag} {self.short_in(scope, name)!r}"
        return join(scope, name)

    def _add(self, full, node, scope, attached, base="", placement=""):
        pose, given = node.pose()
        if full in self._all:
            raise node.error(f"{self._all[full].element} has the same name")
        self._all[full] = Frame(node.name, pose, (scope, given or base), attached, placement)

    def version_of(self, scope: str) -> tuple[int, ...]:
        """The version of the file from which the model with this full name comes."""
        while scope:
            if scope in self._versions:
                return self._versions[scope]
            scope = scope.rpartition("::")[0]
        return self.version

    def short(self, full: str) -> str:
        """The name in the mechanism and in messages: the full name, without the model's if the file has only one."""
        return full if full == WORLD else full[self._cut :] or full

    def short_in(self, scope: str, name: str) -> str:
        """The name in the mechanism of the element called `name` in a scope."""
        return self.short(join(scope, name))

    def resolve(self, scope: str, name: str, element: str) -> str:
        """The full name of the element called `name` in a scope; empty means the model or the world itself."""
        if name in ("", "__model__"):
            return scope or WORLD
        full = WORLD if name == WORLD else join(scope, name)
        if full != WORLD and full not in self._all:
            start = join(scope, "")
            names = [each.removeprefix(start) for each in self._all if each.startswith(start)]
            require_known(name, names, f"there is no link, joint, frame or model {name!r} here", element)
        return full

    def pose(self, full: str) -> pin.SE3:
        """The pose in the world of the frame with this full name."""
        path, each = {}, full
        while each not in self._poses:
            each = self._step(path, each)
        for each, base in reversed(path.items()):
            self._poses[each] = self._poses[base] * self._local(each)
        return self._poses[full]

    def body(self, full: str) -> str:
        """The short name of the link that the frame with this full name moves with, or the world."""
        path = {}
        while full != WORLD and self._all[full].attached is not None:
            full = self._step(path, full, to_body=True)
        return self.short(full)

    def _step(self, path, full, to_body=False):
        """Add a frame to a path; returns its base, or what it is attached to."""
        frame = self._all[full]
        if full in path:
            names = [*map(self.short, path), self.short(full)]
            listed = " → ".join(names[names.index(names[-1]) :][:8])
            raise FormatError(f"the frames form a cycle: {listed}", element=frame.element)
        path[full] = self.resolve(*(frame.attached if to_body else frame.base), frame.element)
        return path[full]

    def _local(self, full):
        """The pose of a frame in its base."""
        frame = self._all[full]
        if frame.placement:
            place = self.resolve(full, frame.placement, f"{frame.element}: placement_frame")
            pose, path = pin.SE3.Identity(), {}
            while place != full:
                if place == WORLD:
                    raise FormatError("its placement_frame is relative to the world", element=frame.element)
                here, place = place, self._step(path, place)
                pose = self._local(here) * pose
            frame = self._all[full] = frame._replace(pose=frame.pose * pose.inverse(), placement="")
        return frame.pose


def _version(raw) -> tuple[int, ...]:
    if raw.tag != "sdf":
        raise FormatError(f"the root element of an SDF file is <sdf>, this is <{raw.tag}>")
    text = raw.get("version", "")
    if not re.fullmatch(r"\d{1,4}\.\d{1,4}", text):
        raise FormatError(f"<sdf> needs a version such as 1.7, not {text[:20]!r}")
    if (version := tuple(map(int, text.split(".")))) < OLDEST:
        raise FormatError(f"version {text} is too old: the oldest supported version is 1.2; `gz sdf -p` converts files")
    return version
