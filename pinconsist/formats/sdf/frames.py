"""Frames of an SDF file: whose pose is relative to which, and which body they move with.

Full names join the models and the name, ``model::link``; the world is ``"world"``. Sources: the tutorials "Pose frame
semantics" and "Model composition" of sdformat.org.
"""

from typing import NamedTuple

import pinocchio as pin

from ...errors import FormatError
from ..reading import require_known

WORLD = "world"


class Frame(NamedTuple):
    """A frame as the file writes it."""

    element: str  # the name that messages use
    pose: pin.SE3  # in its base; with `placement`, that of the frame inside a model by which the model is placed
    base: str  # looked up in `scope`; empty: the model or the world of that scope
    scope: str  # the full name of the model, or empty
    attached: str | None = ""  # what it moves with, looked up in `inside`, or else in `scope`; None: a link
    inside: str | None = None
    placement: str = ""


def join(scope: str, name: str) -> str:
    """The full name of what is called `name` in a scope."""
    return f"{scope}::{name}" if scope else name


class Frames:
    """All frames of a file by their full names. Poses are looked up after all are added, in any order.

    Names in the mechanism and in messages lack the first `cut` letters of full names.
    """

    def __init__(self, cut: int):
        self._cut = cut
        self._frames: dict[str, Frame] = {}
        self._poses = {WORLD: pin.SE3.Identity()}

    def short(self, full: str) -> str:
        """The name in the mechanism: without that of the only model of a file."""
        return full if full == WORLD else full[self._cut :] or full

    def add(self, name: str, frame: Frame) -> None:
        """Add a frame; FormatError if the name is taken."""
        if name in self._frames:
            raise FormatError(f"{self._frames[name].element} has the same name", element=frame.element)
        self._frames[name] = frame

    def resolve(self, scope: str, name: str, element: str) -> str:
        """The full name of what a scope calls `name`; empty means the model or the world itself."""
        if name in ("", "__model__"):
            return scope or WORLD
        full = WORLD if name == WORLD else join(scope, name)
        if full != WORLD and full not in self._frames:
            start = join(scope, "")
            names = [each.removeprefix(start) for each in self._frames if each.startswith(start)]
            require_known(name, names, f"there is no link, joint, frame or model {name!r} here", element)
        return full

    def pose(self, name: str) -> pin.SE3:
        """The pose of a frame in the world."""
        path, each = {}, name
        while each not in self._poses:
            each = self._step(path, each)
        for each, base in reversed(path.items()):
            self._poses[each] = self._poses[base] * self._local(each)
        return self._poses[name]

    def body(self, name: str) -> str:
        """The full name of the link that a frame moves with, or the world."""
        path = {}
        while name != WORLD and self._frames[name].attached is not None:
            name = self._step(path, name, to_body=True)
        return name

    def _step(self, path, name, to_body=False):
        """Add a frame to a path; returns its base, or what it is attached to."""
        frame = self._frames[name]
        if name in path:
            names = [*map(self.short, path), self.short(name)]
            listed = " → ".join(names[names.index(names[-1]) :][:8])
            raise FormatError(f"a cycle of frames: {listed}", element=frame.element)
        scope, to = frame.scope, frame.base
        if to_body:
            scope, to = scope if frame.inside is None else frame.inside, frame.attached
        path[name] = self.resolve(scope, to, frame.element)
        return path[name]

    def _local(self, name):
        frame = self._frames[name]
        if frame.placement:  # it is that of the frame inside a model by which the model is placed
            place = self.resolve(name, frame.placement, f"{frame.element}: placement_frame")
            pose, path = pin.SE3.Identity(), {}
            while place != name:
                if place == WORLD:
                    raise FormatError("its placement_frame is relative to the world", element=frame.element)
                here, place = place, self._step(path, place)
                pose = self._local(here) * pose
            frame = self._frames[name] = frame._replace(pose=frame.pose * pose.inverse(), placement="")
        return frame.pose
