"""Joints of SDF: types, axes, what acts in them, gears and followers. FormatErrors do not know the file yet."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from ...errors import FormatError
from .poses import WORLD, Frames, join
from .words import flag, limit, number, tell_unknown, vector, word

AXES = {
    "revolute": 1,
    "continuous": 1,
    "prismatic": 1,
    "screw": 1,
    "ball": 0,
    "fixed": 0,
    "universal": 2,
    "revolute2": 2,
    "gearbox": 2,
}
"""Joint types, and how many axes they have."""

PARALLEL = 1e-6
"""Sine of the angle between two axes below which they count as parallel."""

_PARTS = ("parent", "child", "pose", "axis", "axis2", "physics", "sensor", "gearbox_ratio", "gearbox_reference_body")
_PARTS += ("thread_pitch", "screw_thread_pitch")
_IN_AXIS = ("xyz", "dynamics", "limit", "mimic", "use_parent_model_frame", "initial_position")


@dataclass(frozen=True)
class Follower:
    """The `<mimic>` of an axis: position = multiplier (leader's position - reference) + offset."""

    joint: str
    axis: int
    multiplier: float
    offset: float
    reference: float


@dataclass(frozen=True, eq=False)
class Axis:
    """One axis of a joint, in the joint's frame, and what the file says of the motion along it (SI units)."""

    direction: np.ndarray
    damping: float = 0.0
    friction: float = 0.0
    stiffness: float = 0.0
    reference: float = 0.0
    lower: float = -math.inf
    upper: float = math.inf
    effort: float = math.inf
    velocity: float = math.inf
    initial: float = 0.0
    follows: Follower | None = None

    @property
    def acts(self) -> bool:
        """Whether there is a torque or a coupling."""
        return bool(self.damping or self.friction or self.stiffness or self.follows)


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint between two bodies, at the configuration of the file.

    Attributes
    ----------
    name, kind : str
        ``kind`` is one of `AXES`; ``revolute2`` has become ``universal``, ``continuous`` ``revolute``.
    parent, child : str
        Bodies, or ``"world"``.
    pose : SE3
        Of the joint's frame, in the world.
    axes : tuple of Axis
        As many as the kind has; that of a ball stands for all directions.
    pitch : float
        Of a screw: travel along the axis for each revolution, m, positive for a right-handed thread.
    ratio, reference : float, str
        Of a gearbox: θ₂ = -ratio θ₁, angles of child and parent against the body `reference`, about its two axes.
    must_cut : bool
        The file asks that this joint closes a loop.
    """

    name: str
    kind: str
    parent: str
    child: str
    pose: pin.SE3
    axes: tuple[Axis, ...]
    pitch: float = 0.0
    ratio: float = 1.0
    reference: str = ""
    must_cut: bool = False

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the joints that it becomes: one for each axis where it has two."""
        return (f"{self.name}_axis", f"{self.name}_axis2") if self.kind == "universal" else (self.name,)


def read_joint(full: str, node: Element, scope: str, frames: Frames, shown, version) -> Joint:
    """A joint element. `full` is the name of its frame; `shown` makes the names of a scene from full ones."""
    name = shown(full)
    element = f"joint {name!r}"
    tell_unknown(node, _PARTS, element)
    kind = node.get("type", "").lower()
    if kind not in AXES:
        raise FormatError(f"type {node.get('type', '')[:40]!r} is not one of {', '.join(AXES)}", element=element)
    parent, child = (_body(node, end, scope, frames, element) for end in ("parent", "child"))
    if child == WORLD:
        raise FormatError("the world cannot be a child; exchange parent and child", element=element)
    if parent == child:
        raise FormatError(f"parent and child are the same body {shown(parent)!r}", element=element)
    place = frames.pose(full)
    axes = tuple(
        _axis(node.find(tag), place, scope, frames, shown, version, f"{element}: {tag}")
        for tag in ("axis", "axis2")[: AXES[kind]]
    )
    if kind in ("universal", "revolute2"):
        if np.linalg.norm(np.cross(axes[0].direction, axes[1].direction)) < PARALLEL:
            raise FormatError("its two axes are parallel", element=element)
    elif kind == "continuous":
        axes = (replace(axes[0], lower=-math.inf, upper=math.inf),)
    elif kind == "ball":
        axes = _ball(node, f"{element}: axis")
    simbody = node.find("physics/simbody")
    return Joint(
        name,
        {"continuous": "revolute", "revolute2": "universal"}.get(kind, kind),
        shown(parent),
        shown(child),
        place,
        axes,
        pitch=_pitch(node, element) if kind == "screw" else 0.0,
        ratio=number(node, "gearbox_ratio", element, 1.0),
        reference=shown(_body(node, "gearbox_reference_body", scope, frames, element)) if kind == "gearbox" else "",
        must_cut=simbody is not None and flag(simbody, "must_be_loop_joint", element),
    )


def _body(node, tag, scope, frames, element):
    name = word(node, tag, element)
    return frames.body(frames.resolve(scope, name, f"{element}: {tag}"))


def _axis(node, place, scope, frames, shown, version, element):
    if node is None:
        raise FormatError("it is missing", element=element)
    tell_unknown(node, _IN_AXIS, element)
    direction = np.array(vector(node, "xyz", element, (0.0, 0.0, 1.0)))
    length = math.hypot(*direction)
    if length == 0:
        raise FormatError("the axis is the zero vector", element=element)
    direction = direction / np.abs(direction).max()  # no overflow of the norm
    direction /= np.linalg.norm(direction)
    frame = _expressed_in(node, version, element)
    if frame:
        there = frames.pose(frames.resolve(scope, frame, f"{element}: xyz"))
        direction = place.rotation.T @ there.rotation @ direction
    bounds, within = node.find("limit"), f"{element}: limit"
    lower, upper = limit(bounds, "lower", within, -math.inf), limit(bounds, "upper", within, math.inf)
    if lower > upper:
        raise FormatError(f"lower {lower:g} is above upper {upper:g}", element=within)
    effort, velocity = (limit(bounds, tag, within, math.inf) for tag in ("effort", "velocity"))
    return Axis(
        direction,
        **_dynamics(node.find("dynamics"), f"{element}: dynamics"),
        lower=lower,
        upper=upper,
        effort=effort if effort >= 0 else math.inf,  # not enforced
        velocity=velocity if velocity >= 0 else math.inf,
        initial=number(node, "initial_position", element),
        follows=_follower(node.find("mimic"), scope, shown, f"{element}: mimic"),
    )


def _expressed_in(node, version, element):
    """The frame of the components of an axis; empty: the joint's own."""
    if version <= (1, 4):
        return "__model__"
    xyz = node.find("xyz")
    frame = "" if xyz is None else xyz.get("expressed_in", "")
    if version < (1, 7) and not frame:  # the flag was given up for expressed_in
        return "__model__" if flag(node, "use_parent_model_frame", element) else ""
    return frame


def _dynamics(node, element):
    names = {"damping": "damping", "friction": "friction", "stiffness": "spring_stiffness"}
    given = {key: number(node, tag, element) for key, tag in names.items()}
    for key, value in given.items():
        if value < 0:
            raise FormatError(f"{value:g} is negative", element=f"{element}: {names[key]}")
    return given | {"reference": number(node, "spring_reference", element)}


def _ball(node, element):
    """The damping and friction that simulators let act about all axes of a ball; its direction means nothing."""
    axis = node.find("axis")
    given = _dynamics(None if axis is None else axis.find("dynamics"), f"{element}: dynamics")
    if given["stiffness"]:
        raise FormatError("a ball joint has no axis about which a spring could act", element=element)
    return (Axis(np.zeros(3), given["damping"], given["friction"]),)


def _follower(node, scope, shown, element):
    if node is None:
        return None
    axis = node.get("axis") or "axis"
    if axis not in ("axis", "axis2"):
        raise FormatError(f"axis={axis[:40]!r} is neither axis nor axis2", element=element)
    return Follower(
        shown(join(scope, node.get("joint", ""))),
        0 if axis == "axis" else 1,
        number(node, "multiplier", element, 1.0),
        number(node, "offset", element),
        number(node, "reference", element),
    )


def _pitch(node, element):
    """m per revolution, positive for a right-handed thread, as libsdformat takes it.

    ``thread_pitch`` is the older element: rad per m, positive for a left-handed thread.
    """
    if node.find("screw_thread_pitch") is not None or node.find("thread_pitch") is None:
        return number(node, "screw_thread_pitch", element, 1.0)
    old = number(node, "thread_pitch", element)
    if abs(old) < 1e-100:
        raise FormatError("zero means infinite travel", element=f"{element}: thread_pitch")
    return -2 * math.pi / old
