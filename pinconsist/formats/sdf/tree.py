"""SDF elements → bodies, joints and frames with their places in the world, before any tree is made of them.

FormatErrors raised here do not know the file yet.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable
from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from ...errors import FormatError
from .joints import Joint, read_joint
from .poses import WORLD, Frames, join
from .words import flag, pose, tell_unknown, vector

OLDEST = (1, 4)
FRAMES = (1, 7)  # the version from which names are unique and axes expressed in named frames
DEEPEST = 30
GRAVITY = (0.0, 0.0, -9.8)
"""What a world without <gravity> has in SDF, m/s²."""

_MODEL = ("link", "joint", "frame", "model", "include", "pose", "static", "self_collide", "allow_auto_disable")
_MODEL += ("plugin", "gripper", "enable_wind")
_WORLD = ("model", "joint", "frame", "include", "gravity", "physics", "scene", "light", "plugin", "gui", "atmosphere")
_WORLD += ("magnetic_field", "wind", "spherical_coordinates", "audio", "road", "actor", "state", "population")
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Body:
    """A link: its name, its element, its place in the world, and whether it cannot move."""

    name: str
    node: Element
    pose: pin.SE3
    static: bool


@dataclass(frozen=True)
class Scene:
    """What a file holds.

    Attributes
    ----------
    bodies : dict[str, Body]
        Links by name.
    joints : tuple of Joint
        Those between bodies of which at least one can move.
    frames : dict[str, (str, SE3)]
        `<frame>` elements: name → the body (or ``"world"``) that it moves with, and its place in the world.
    roots : tuple of str
        Bodies that the file names as canonical links.
    gravity : ndarray or None
        m/s²; None where there is no world.
    place : callable
        ``place(body, name, element) -> SE3``: the world pose of the frame that the model of a body calls `name`.
    """

    bodies: dict[str, Body]
    joints: tuple[Joint, ...]
    frames: dict[str, tuple[str, pin.SE3]]
    roots: tuple[str, ...]
    gravity: np.ndarray | None
    place: Callable[[str, str, str], pin.SE3]


def read_tree(raw: Element) -> Scene:
    """The scene of a parsed file; FormatError for the first thing that is wrong, with its element."""
    if raw.tag != "sdf":
        raise FormatError(f"the root element of an SDF file is <sdf>, this is <{raw.tag}>")
    version = _version(raw)
    worlds = raw.findall("world")
    if len(worlds) > 1:
        raise FormatError(f"one world is needed, this file has {len(worlds)}; keep one of them")
    top = worlds[0] if worlds else raw
    _refuse_includes(top, "world" if worlds else "sdf")
    if worlds:
        tell_unknown(top, _WORLD, "world")
        if top.find("state") is not None:
            _log.warning("world: <state> has no effect; the models stand where their own poses place them")
    models, shown_from = top.findall("model"), 0
    if len(models) == 1 and top.find("joint") is None and top.find("frame") is None:
        shown_from = len(join(models[0].get("name", ""), ""))
    reader = _Reader(version, shown_from)
    for model in models:
        reader.model(model, "", False, 0)
    reader.own_frames(top, "", False)
    gravity = None
    if worlds:
        holder = top if version > (1, 5) else top.find("physics")
        gravity = np.array(vector(holder, "gravity", "world", GRAVITY))
    return reader.scene(gravity)


def _version(raw):
    text = raw.get("version", "")
    if not re.fullmatch(r"\d{1,4}\.\d{1,4}", text):
        raise FormatError(f"<sdf> needs a version such as 1.7, not {text[:20]!r}")
    version = tuple(map(int, text.split(".")))
    if version < OLDEST:
        raise FormatError(f"version {text} is too old, 1.4 is the first that can be read; `gz sdf -p` converts files")
    return version


def _refuse_includes(node, element):
    include = node.find("include")
    if include is not None:
        uri = (include.findtext("uri") or "").strip()
        raise FormatError(
            f"<include> of {uri[:80]!r}: other files are not read along. `gz sdf -p file` writes one file that holds "
            "everything",
            element=element,
        )


class _Reader:
    """Collects the names of a file first, and looks up what they refer to afterwards.

    Bodies, joints and messages go without the first `shown_from` letters of full names.
    """

    def __init__(self, version, shown_from):
        self.version, self.frames, self._shown_from = version, Frames(self._shown), shown_from
        self._links: dict[str, tuple[str, Element, bool]] = {}
        self._joints: list[tuple[str, str, Element, bool]] = []
        self._extra: list[str] = []  # <frame> elements
        self._roots: list[str] = []

    def model(self, node, scope, static, depth):
        """Take in a model and the models in it."""
        name = _name(node, "model")
        full = join(scope, name)
        element = f"model {self._shown(full)!r}"
        if depth > DEEPEST:
            raise FormatError(f"models are nested more than {DEEPEST} deep", element=element)
        _refuse_includes(node, element)
        tell_unknown(node, _MODEL, element)
        static = static or flag(node, "static", element)
        inner = [each.get("name", "") for tag in ("link", "model") for each in node.findall(tag)]
        canonical = node.get("canonical_link", "")
        if not (inner or static):
            raise FormatError("there is no link", element=element)
        place, base = pose(node, element)
        self.frames.add(
            full,
            element,
            place,
            base,
            scope,
            attached=WORLD if static else canonical or inner[0],
            inside=full,
            placement=node.get("placement_frame", ""),
        )
        if canonical and not static:
            self._roots.append(full)
        for link in node.findall("link"):
            self._link(link, full, static)
        for each in node.findall("model"):
            self.model(each, full, static, depth + 1)
        self.own_frames(node, full, static)

    def _link(self, node, scope, static):
        name = _name(node, "link")
        full = join(scope, name)
        element = f"link {self._shown(full)!r}"
        place, base = pose(node, element)
        self.frames.add(full, element, place, base, scope, attached=None)
        self._links[full] = scope, node, static

    def own_frames(self, node, scope, static):
        """Take in the joints and frames of a model, or of the world."""
        for joint in node.findall("joint"):
            name = _name(joint, "joint")
            element = f"joint {self._shown(join(scope, name))!r}"
            place, base = pose(joint, element)
            child = (joint.findtext("child") or "").strip()
            full = join(scope, name)
            if self.version < FRAMES and full in self._links:  # allowed in those days
                full += "_joint"
            self.frames.add(full, element, place, base or child, scope, attached=child)
            self._joints.append((full, scope, joint, static))
        for frame in node.findall("frame"):
            full = join(scope, _name(frame, "frame"))
            element = f"frame {self._shown(full)!r}"
            place, base = pose(frame, element)
            attached = frame.get("attached_to", "")
            self.frames.add(full, element, place, base or attached, scope, attached=attached)
            self._extra.append(full)

    def scene(self, gravity):
        """Everything looked up."""
        if not self._links:
            raise FormatError("there is no link")
        frames, shown = self.frames, self._shown
        bodies = {
            shown(full): Body(shown(full), node, frames.pose(full), static)
            for full, (_, node, static) in self._links.items()
        }
        joints = tuple(
            read_joint(full, node, scope, frames, shown, self.version)
            for full, scope, node, static in self._joints
            if not static
        )
        scopes = {shown(full): scope for full, (scope, _, _) in self._links.items()}

        def place(body, relative_to, element):
            return frames.pose(frames.resolve(scopes[body], relative_to, element))

        return Scene(
            bodies,
            joints,
            {shown(full): (shown(frames.body(full)), frames.pose(full)) for full in self._extra},
            tuple(shown(frames.body(full)) for full in self._roots),
            gravity,
            place,
        )

    def _shown(self, full):
        """The name in the mechanism: that of the only model of a file is left away."""
        return full if full == WORLD else full[self._shown_from :] or full


def _name(node, tag):
    name = node.get("name", "")
    element = f"{tag} {name[:80]!r}"
    if not name.strip():
        raise FormatError(f"a {tag} has no name")
    if name in (WORLD, "universe") or (name.startswith("__") and name.endswith("__")):
        raise FormatError("the name is reserved; give it another", element=element)
    return name
