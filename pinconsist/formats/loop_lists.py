"""Lists of loops that exporters write beside a URDF, in the words of their own: what they say as records.

``loop_closures.yaml``, with the points in the axes of their links, and the axis in those of the parent::

    ball_loops: [{name: rod, parent: a, child: b, parent_xyz: [0, 0, 1], child_xyz: [0, 0, 0]}]
    pin_loops: [{name: pin, parent: a, child: b, parent_xyz: [0, 0, 1], child_xyz: [0, 0, 0], axis: [0, 1, 0]}]
    ball_upgrades: [hip]         # joints of the URDF that are balls
    ball_limit_deg: 30           # a cone, which is not enforced
    actuated_joints: [knee]

or, with the point and the axis of a hinge in the axes of the root link, in the configuration of the URDF::

    closures: [{link_a: a, link_b: b, point: [0, 0, 1], axis: [0, 1, 0]}]
    independent: [knee]          # the joints with motors
    dependent: [hip]

``robot_data.yaml``, with the joint's frame in the axes of the parent, and its axis in those of the joint::

    closing_joints: [{name: slide, type: prismatic, parent: a, child: b, origin_xyz_m: [0, 0, 1],
                      origin_rpy_rad: [0, 0, 0], axis: [1, 0, 0], limits: {lower: 0, upper: 0.1}}]

A loop with one anchor closes where the bodies are in the configuration of the URDF, see :class:`.closures.Closure`.
"""

import numpy as np

from ..errors import FormatError
from ..mechanism.loops import Loop, unit
from .closures import AXIS_ONLY, WITH_AXIS, Closure, kind_of
from .extensions import WORLDS, pose, unique
from .reading import finite, short_repr
from .records import items, mapping, name, numbers

KEYS = ("ball_loops", "pin_loops", "closures", "closing_joints")
"""The keys of lists of loops, each of which identifies such a file."""
LOOP_CLOSURES = ("ball_loops", "pin_loops", "ball_upgrades", "ball_limit_deg", "actuated_joints", "closures")
LOOP_CLOSURES += ("independent", "dependent")
GROUND = "universe"
ZERO = (0.0, 0.0, 0.0)
_POINTS = {1: ("parent_xyz", "parent_point", "parent_pos"), 2: ("child_xyz", "child_point", "child_pos")}
_PARENT, _CHILD = ("parent", "link_a", "parent_link", "link1"), ("child", "link_b", "child_link", "link2")


def read(record: dict):
    """(loops, actuated joints, joint types, what is counted) of a file that has one of `KEYS`."""
    loops, counted = [], []
    for key, kind in (("ball_loops", "point"), ("pin_loops", "hinge")):
        for number, entry in enumerate(items(record, key), start=1):
            element = f"{key} {number}"
            loops.append(_with_points(entry, kind, element, loops))
            if entry.get("ball_limit_deg") is not None:
                counted.append("1 limit of a ball loop")
    for number, entry in enumerate(items(record, "closures"), start=1):
        loops.append(_in_root(entry, f"closures {number}", loops))
    for number, entry in enumerate(items(record, "closing_joints"), start=1):
        loops.append(_with_origin(entry, f"closing_joints {number}", loops))
        if entry.get("limits") or entry.get("limit"):
            counted.append("1 limit of a closing joint")
    if record.get("ball_limit_deg") is not None:
        counted.append("1 ball_limit_deg (a cone, not enforced)")
    types = {joint: "SPHERICAL" for joint in _joints(record, "ball_upgrades")}
    actuated = tuple(dict.fromkeys((*_joints(record, "actuated_joints"), *_joints(record, "independent"))))
    return tuple(loops), actuated, types, tuple(counted)


def _joints(record, key):
    """The joints of a list of names, of records with a name, or of a mapping."""
    given = record.get(key)
    if isinstance(given, dict):
        given = list(given)
    found = []
    for entry in items({key: given}, key):
        if isinstance(entry, dict):
            entry = next((entry[word] for word in ("joint", "name") if entry.get(word)), None)
        found.append(name(entry, key))
    return tuple(dict.fromkeys(found))


def _frames(entry, element):
    mapping(entry, element, "name, parent, child")
    found = []
    for words in (_PARENT, _CHILD):
        given = next((entry[word] for word in words if entry.get(word) is not None), None)
        if given is None:
            raise FormatError(f"{words[0]!r} is missing", element=element)
        link = name(given, f"{element}: {words[0]}")
        found.append(GROUND if link in WORLDS else link)
    if found[0] == found[1]:
        raise FormatError(f"both ends are on the link {found[0]!r}", element=element)
    return found


def _title(entry, frames, loops):
    given = entry.get("name")
    return unique(name(given, "name") if given else "-".join(frames), [loop.name for loop in loops])


def _vector(entry, words, element, default=None):
    for word in words:
        if entry.get(word) is not None:
            return _three(entry[word], f"{element}: {word}")
    if default is None:
        raise FormatError(f"{words[0]!r} is missing", element=element)
    return default


def _three(value, element):
    """Three numbers, or an axis as a word: ``x``, ``-y``, ``+z``, or ``[0, ±1, 0]``."""
    if isinstance(value, str):
        sign, letter = (-1.0 if value.strip().startswith("-") else 1.0), value.strip().lstrip("+-±").lower()
        if letter in ("x", "y", "z"):
            return tuple(sign * (letter == each) for each in "xyz")
        value = value.replace(",", " ").split()
    if isinstance(value, list) and len(value) == 3:
        read = [finite(each.lstrip("±") if isinstance(each, str) else each) for each in value]
        if None not in read:
            return tuple(read)
    return numbers(value, element, count=3)


def _axis(entry, element):
    axis = np.array(_vector(entry, ("axis", "axis_xyz", "axis_parent"), element))
    if not axis.any():
        raise FormatError("the axis is the zero vector", element=element)
    return tuple(unit(axis).tolist())


def _with_points(entry, kind, element, loops):
    frames = _frames(entry, element)
    points = [_vector(entry, _POINTS[end], element) for end in (1, 2)]
    title = _title(entry, frames, loops)
    if kind == "point":
        return Loop(title, kind, *frames, xyz1=points[0], xyz2=points[1])
    return Closure(title, kind, *frames, pose(points[0], ZERO), axis=_axis(entry, element), xyz2=points[1])


def _in_root(entry, element, loops):
    frames = _frames(entry, element)
    point = _vector(entry, ("point", "point_xyz", "position", "xyz"), element)
    place, at = pose(point, ZERO), 0
    if not entry.get("axis"):
        return Closure(_title(entry, frames, loops), "point", *frames, place, at)
    kind = kind_of(str(entry.get("type") or "hinge")) or "hinge"
    axis = _axis(entry, element) if kind in WITH_AXIS else None
    return Closure(_title(entry, frames, loops), kind, *frames, place, at, axis)


def _with_origin(entry, element, loops):
    frames = _frames(entry, element)
    given = str(entry.get("type") or entry.get("joint_type") or "revolute")
    kind = kind_of(given)
    if kind not in AXIS_ONLY:
        reason = f"the type {short_repr(given)} is not one of revolute, continuous, prismatic, fixed"
        raise FormatError(reason, element=element)
    xyz = _vector(entry, ("origin_xyz_m", "origin_xyz", "xyz"), element, ZERO)
    rpy = _vector(entry, ("origin_rpy_rad", "origin_rpy", "rpy"), element, ZERO)
    axis = _axis(entry, element) if kind in WITH_AXIS else None
    return Closure(_title(entry, frames, loops), kind, *frames, pose(xyz, rpy), 1, axis)
