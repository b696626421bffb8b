"""Frames of an SDF file: whose pose is relative to which, and which body they move with.

Full names join the models and the name, ``model::link``; the world is ``"world"``. Sources: the tutorials "Pose frame
semantics" and "Model composition" of sdformat.org.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import pinocchio as pin

from ...errors import FormatError
from ..reading import near

WORLD = "world"


@dataclass(frozen=True)
class _Frame:
    pose: pin.SE3
    base: str  # as the file writes it, looked up in `scope`; empty: the model or the world of that scope
    scope: str
    attached: str | None  # likewise; None: a link
    inside: str  # the scope in which `attached` is looked up
    placement: str  # the frame inside a model whose pose `pose` is
    element: str


def join(scope: str, name: str) -> str:
    """The full name of what is called `name` in a scope."""
    return f"{scope}::{name}" if scope else name


class Frames:
    """All frames of a file. Poses are looked up after all are added, in any order.

    Parameters
    ----------
    shown : callable
        Makes the names of messages from full ones.
    """

    def __init__(self, shown: Callable[[str], str]):
        self._shown = shown
        self._frames: dict[str, _Frame] = {}
        self._poses = {WORLD: pin.SE3.Identity()}
        self._locals: dict[str, pin.SE3] = {}

    def add(self, name, element, pose, base, scope, *, attached: str | None = "", inside=None, placement="") -> None:
        """Add a frame by its full name; FormatError where the name is taken."""
        if name in self._frames:
            raise FormatError(f"{self._frames[name].element} has the same name", element=element)
        inside = scope if inside is None else inside
        self._frames[name] = _Frame(pose, base, scope, attached, inside, placement, element)

    def resolve(self, scope: str, name: str, element: str) -> str:
        """The full name of what a scope calls `name`; empty means the model or the world itself."""
        if name in ("", "__model__"):
            return scope or WORLD
        full = WORLD if name == WORLD else join(scope, name)
        if full != WORLD and full not in self._frames:
            start = len(join(scope, ""))
            names = [each[start:] for each in self._frames if each.startswith(join(scope, ""))]
            raise FormatError(
                f"there is no link, joint, frame or model {name!r} here{near(name, names)}", element=element
            )
        return full

    def pose(self, name: str) -> pin.SE3:
        """The pose in the world of a frame, by its full name."""
        path, each = {}, name
        while each not in self._poses:
            self._step(path, each)
            each = self._base(each)
        for each in reversed(path):
            self._poses[each] = self._poses[self._base(each)] * self._local(each)
        return self._poses[name]

    def body(self, name: str) -> str:
        """The full name of the link that a frame moves with, or the world."""
        path = {}
        while name != WORLD:
            frame = self._frames[name]
            if frame.attached is None:
                break
            self._step(path, name)
            name = self.resolve(frame.inside, frame.attached, frame.element)
        return name

    def _step(self, path, name):
        if name in path:
            names = [*map(self._shown, path), self._shown(name)]
            listed = " → ".join(names[names.index(names[-1]) :][:8])
            raise FormatError(f"a cycle of frames: {listed}", element=self._frames[name].element)
        path[name] = None

    def _base(self, name):
        frame = self._frames[name]
        return self.resolve(frame.scope, frame.base, frame.element)

    def _local(self, name):
        """The pose of a frame in its base."""
        frame = self._frames[name]
        if not frame.placement:
            return frame.pose
        if name not in self._locals:
            self._locals[name] = frame.pose * self._inside(name, frame).inverse()
        return self._locals[name]

    def _inside(self, model, frame):
        """The pose in a model of the frame by which it is placed."""
        place = self.resolve(model, frame.placement, f"{frame.element}: placement_frame")
        pose, path = pin.SE3.Identity(), {}
        while place != model:
            if place == WORLD:
                raise FormatError("its placement_frame is relative to the world", element=frame.element)
            self._step(path, place)
            pose = self._local(place) * pose
            place = self._base(place)
        return pose
