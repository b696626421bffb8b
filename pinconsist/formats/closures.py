"""Loops of which a file gives one anchor: the other one lies where the first is in the configuration of the file."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import pinocchio as pin

from ..mechanism.checks import frame_of, places, workspace
from ..mechanism.loops import GROUND, LOOP_KINDS, Loop, anchor

FILE_NAMES = {name: kind.name for kind in LOOP_KINDS.values() for name in kind.file_names}
"""Names of joints and constraints in files → kinds of loops."""
WITH_AXIS = tuple(kind.name for kind in LOOP_KINDS.values() if kind.has_axis)
AXIS_ONLY = tuple(kind.name for kind in LOOP_KINDS.values() if kind.fields in ((), ("axis",)))
"""Kinds that two anchors and, for some, an axis define."""


def kind_of(word: str) -> str | None:
    """The kind of loop that a file calls ``Revolute``, ``spherical_joint`` or ``6D``; None for another word."""
    plain = word.strip().lower().replace("-", "_").replace(" ", "_")
    short = plain.removesuffix("_joint").removesuffix("_constraint").removesuffix("joint")
    return FILE_NAMES.get(plain) or FILE_NAMES.get(short)


@dataclass(frozen=True)
class Closure:
    """A loop with one anchor, at `place` in frame `at` (1 or 2; 0: in the world); the other coincides with it.

    ``axis`` and ``axis2`` have components in the axes of the anchor. With ``xyz2`` the other anchor is at this position
    in its frame, and only its axes are those of the first.
    """

    name: str
    kind: str
    frame1: str
    frame2: str
    place: pin.SE3
    at: int = 1
    axis: tuple[float, ...] | None = None
    axis2: tuple[float, ...] | None = None
    xyz2: tuple[float, ...] | None = None


def closed(model: pin.Model, loops: Iterable, start: Mapping | None = None) -> tuple:
    """The loops, with both anchors; other loops than a :class:`Closure` are unchanged.

    The anchors of a Closure coincide in the configuration of the file: all joints are at zero, but for those whose
    position `start` gives by their names.
    """
    loops = tuple(loops)
    if not any(isinstance(loop, Closure) for loop in loops):
        return loops
    data = workspace(model)
    q = pin.neutral(model)
    for joint, position in (start or {}).items():
        if model.existJointName(joint):
            q[places(model, model.getJointId(joint))[0]] = position
    pin.framesForwardKinematics(model, data, q)
    poses = {frame.name: data.oMf[i] for i, frame in enumerate(model.frames)} | {GROUND: pin.SE3.Identity()}
    for loop in (each for each in loops if isinstance(each, Closure)):
        for frame in (loop.frame1, loop.frame2):
            frame_of(model, frame, f"loop {loop.name!r}")
    return tuple(_closed(loop, poses) if isinstance(loop, Closure) else loop for loop in loops)


def _closed(closure, poses) -> Loop:
    frames = closure.frame1, closure.frame2
    there = closure.place if closure.at == 0 else poses[frames[closure.at - 1]] * closure.place
    fields = {}
    for end, frame in enumerate(frames, start=1):
        fields |= anchor(end, closure.place if end == closure.at else poses[frame].actInv(there))
    if closure.xyz2 is not None:
        fields["xyz2"] = closure.xyz2
    return Loop(closure.name, closure.kind, *frames, **fields, axis=closure.axis, axis2=closure.axis2)
