"""Model directives of Drake (``.dmd.yaml``): models of other files, frames and welds, as an SDF world.

``add_model`` includes an SDF or URDF file under a name; ``add_weld`` places the model of its child so that the child's
frame is at ``X_PC`` in the parent's, and holds it there; ``add_frame`` adds a frame; ``add_directives`` includes
another file, with a namespace. ``default_joint_positions`` are where the assembly starts, and
``default_free_body_pose`` is where a model stands. A frame is called ``model::frame``, or without the model if no other
has this name. What is not welded floats, as in Drake. Source: Drake's "Model Directives".
"""

import os
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np
import pinocchio as pin

from ..errors import FormatError
from . import sdf
from .ignored import Ignored
from .loopfile import parsed_yaml
from .reading import RobotFile, finite, finite_numbers, located, parsed, read_bytes, require_known, short_repr, text
from .sdf.includes import Includes

DEEPEST = 20
_GRAVITY = "0 0 -9.81"
_HARMLESS = ("add_collision_filter_group", "add_model_instance")
_KEYS = ("add_model", "add_weld", "add_frame", "add_directives", *_HARMLESS)


def read(path: Path, name: str, folders, *, ignore=()) -> RobotFile:
    """Read a file of directives; see the documentation of the module."""
    world = _World(path, folders, ignore)
    world.add(Path(os.path.abspath(path)), "", 0)
    content, folders = tostring(world.root), (*folders, *world.packages)
    robot = sdf.read(path, name, folders, ignore=ignore, content=content, floats=True)
    joints, start = list(robot.model.names)[1:], {}
    for joint, value in world.start.items():
        found = joint if joint in joints else joint.partition("::")[2]
        require_known(found, joints, f"there is no joint {joint[:80]!r}", "default_joint_positions")
        start[found] = value
    ignored = (*robot.ignored, *world.ignored.lines())
    return replace(robot, guess=robot.guess | start, ignored=tuple(dict.fromkeys(ignored)))


class _World:
    """The world of a file of directives."""

    def __init__(self, path, folders, ignore):
        self.root = Element("sdf", version="1.11")
        self.top = SubElement(self.root, "world", name="directives")
        SubElement(self.top, "gravity").text = _GRAVITY
        self.start: dict[str, float] = {}  # joint, with its model → where the assembly starts
        self.ignored = Ignored()
        self._includes = Includes(path, folders, self.ignored, ignore)
        self.packages = self._includes.packages
        self._models: dict[str, Element] = {}
        self._names: set[str] = set()  # of frames, with their models
        self._welded: set[str] = set()

    def add(self, file: Path, space: str, depth: int) -> None:
        """Add the directives of a file, with a namespace that ends with ``::``."""
        if depth > DEEPEST:
            raise FormatError(f"files of directives are nested more than {DEEPEST} deep", path=file)
        with located(file):
            given = parsed_yaml(read_bytes(file), tags=True)
        listed = given.get("directives") if isinstance(given, dict) else None
        if not isinstance(listed, list):
            raise FormatError("a file of directives has a list of directives", path=file)
        for number, each in enumerate(listed, start=1):
            element = f"directive {number}"
            if not isinstance(each, dict) or len(each) != 1 or not isinstance(next(iter(each.values())), dict):
                raise FormatError(f"it is not one of {', '.join(_KEYS)}", path=file, element=element)
            ((key, fields),) = each.items()
            require_known(key, _KEYS, f"{str(key)[:60]!r} is not known", element)
            element = f"{element}, {key} {str(fields.get('name', ''))[:60]}".rstrip()
            if key == "add_model":
                self._model(fields, space, file, element)
            elif key == "add_frame":
                self._frame(fields, space, element)
            elif key == "add_weld":
                self._weld(fields, space, element)
            elif key == "add_directives":
                inner = self._includes.find(_word(fields, "file", element), file)
                more = str(fields.get("model_namespace") or "")
                self.add(inner, f"{space}{more}::" if more else space, depth + 1)

    def _model(self, fields, space, file, element):
        name, uri = space + _word(fields, "name", element), _word(fields, "file", element)
        if name in self._models:
            raise FormatError("two models have this name", element=element)
        found = self._includes.find(uri, file)
        include = SubElement(self.top, "include")
        SubElement(include, "uri").text = str(found)
        SubElement(include, "name").text = name
        self._models[name] = include
        raw = parsed(read_bytes(found))
        parts = [each for tag in ("link", "frame", "joint", "model") for each in raw.iter(tag)]
        self._names |= {name, *(f"{name}::{each.get('name')}" for each in parts)}  # of frames without their model
        positions = fields.get("default_joint_positions") or {}
        for joint, value in positions.items() if isinstance(positions, dict) else ():
            number = finite(value[0] if isinstance(value, list) and len(value) == 1 else value)
            if number is None:
                raise FormatError(f"{joint}: {short_repr(value)} is not a position of a joint", element=element)
            self.start[f"{name}::{joint}"] = number
        poses = fields.get("default_free_body_pose") or {}
        for body, placed in poses.items() if isinstance(poses, dict) else ():
            base = str(placed.get("base_frame") or "world") if isinstance(placed, dict) else "world"
            self._place(name, str(body), self._full(base, space, element), _pose(placed, element))

    def _frame(self, fields, space, element):
        given, placed = _word(fields, "name", element), fields.get("X_PF")
        if not isinstance(placed, dict):
            raise FormatError("X_PF is missing: the base_frame, and the place in it", element=element)
        base = self._full(_word(placed, "base_frame", element), space, element)
        model = base.rpartition("::")[0]
        name = space + given if "::" in given or not model else f"{model}::{given}"
        frame = SubElement(self.top, "frame", name=name, attached_to=base)
        SubElement(frame, "pose").text = _pose(placed, element)
        self._names.add(name)

    def _weld(self, fields, space, element):
        parent, child = (self._full(_word(fields, end, element), space, element) for end in ("parent", "child"))
        model = next((each for each in sorted(self._models, key=len)[::-1] if f"{child}::".startswith(f"{each}::")), "")
        if not model:
            raise FormatError(f"the child {child[:80]!r} is not a frame of a model", element=element)
        if model in self._welded:
            raise FormatError(f"the model {model[:60]!r} is welded twice; close the loop in its file", element=element)
        self._welded.add(model)
        self._place(model, child[len(model) + 2 :], parent, _pose(fields.get("X_PC"), element))
        joint = SubElement(self.top, "joint", name=f"{parent} welded to {child}".replace("::", " "), type="fixed")
        SubElement(joint, "parent").text = parent
        SubElement(joint, "child").text = child

    def _place(self, model, frame, base, pose):
        """Place a model so that one of its frames has this pose in another."""
        include = self._models[model]
        for old in [each for each in include if each.tag in ("pose", "placement_frame")]:
            include.remove(old)
        SubElement(include, "pose", {} if base == "world" else {"relative_to": base}).text = pose
        if frame:
            SubElement(include, "placement_frame").text = frame

    def _full(self, name, space, element) -> str:
        """The name of a frame with its models."""
        name = name.removesuffix("::__model__")
        if name == "world":
            return name
        for each in (space + name, name):
            if each in self._names or any(each.startswith(f"{model}::") for model in self._models):
                return each
        alike = [each for each in self._names if each.endswith(f"::{name}")]
        if len(alike) > 1:
            reason = f"{name[:60]!r} is the name of several frames: {', '.join(sorted(alike)[:6])}"
            raise FormatError(reason, element=element)
        require_known(name, [name] if alike else self._names, f"there is no frame {name[:80]!r}", element)
        return alike[0]


def _word(fields, key, element) -> str:
    given = fields.get(key)
    if not isinstance(given, str) or not given.strip():
        raise FormatError(f"{key!r} is missing", element=element)
    return given.strip()


def _pose(given: Any, element) -> str:
    """A transform, as a pose of SDF; its default is the identity."""
    if given is None:
        return "0 0 0 0 0 0"
    if not isinstance(given, dict):
        raise FormatError(f"{short_repr(given)} is not a transform", element=element)
    xyz = _numbers(given.get("translation", [0, 0, 0]), 3, element)
    turn = given.get("rotation") or {}
    if not isinstance(turn, dict):
        raise FormatError(f"{short_repr(turn)} is not a rotation", element=element)
    rotation = np.eye(3)
    if "wxyz" in turn:
        w, x, y, z = _numbers(turn["wxyz"], 4, element)
        if not any((w, x, y, z)):
            raise FormatError("the quaternion is zero", element=element)
        rotation = pin.Quaternion(w, x, y, z).normalized().toRotationMatrix()
    elif "angle_deg" in turn:
        axis = np.array(_numbers(turn.get("axis"), 3, element))
        if not axis.any():
            raise FormatError("the axis is the zero vector", element=element)
        angle = np.radians(_numbers([turn["angle_deg"]], 1, element)[0])
        rotation = pin.AngleAxis(float(angle), axis / np.linalg.norm(axis)).toRotationMatrix()
    elif "deg" in turn:
        rotation = pin.rpy.rpyToMatrix(*np.radians(_numbers(turn["deg"], 3, element)))
    elif turn.get("") not in (None, "Identity"):
        raise FormatError(f"the rotation !{turn['']} is not one of Rpy, AngleAxis, Quaternion", element=element)
    return text(*xyz, *pin.rpy.matrixToRpy(rotation))


def _numbers(given, count, element) -> tuple[float, ...]:
    return finite_numbers(given if isinstance(given, list) else [], count, given, element)
