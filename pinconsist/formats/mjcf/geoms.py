"""Shapes of MJCF: the geoms of a body, and where geoms and sites stand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ...errors import FormatError
from .settings import Compiler
from .values import direction, keyword, number, pose, turned_z, vector

SIZES = {"sphere": 1, "capsule": 2, "ellipsoid": 3, "cylinder": 2, "box": 3}
"""Half sizes of each shape; a capsule's and a cylinder's are the radius and half the length along z."""
_KINDS = (*SIZES, "plane", "hfield", "mesh", "sdf")
_CONNECTORS = ("capsule", "cylinder", "ellipsoid", "box")  # may be given by their ends


@dataclass(frozen=True)
class Geom:
    """A geom of a body: its shape, its half sizes, m, and its place in the axes of the body."""

    element: str
    kind: str
    size: tuple[float, ...]
    place: pin.SE3
    group: int
    attributes: dict[str, str]


def geom(given: dict[str, str], frame: pin.SE3, compiler: Compiler, element: str) -> Geom:
    """A geom from all its attributes, in a frame of its body."""
    kind = keyword(given, "type", element, _KINDS)
    size = vector(given, "size", element, (1, 3), (0.0,))
    place, half_length = placed(given, kind, compiler, element)
    if half_length is not None:
        size = (size[0], half_length) if SIZES[kind] == 2 else (size[0], size[0], half_length)
    size = tuple(float(each) for each in size[: SIZES.get(kind, 0)])
    if "mesh" not in given and (len(size) < SIZES.get(kind, 0) or min(size, default=1.0) <= 0):
        raise FormatError(f"a {kind} needs {SIZES[kind]} positive number(s) as its size", element=element)
    return Geom(element, kind, size, frame * place, round(number(given, "group", element)), given)


def site(given: dict[str, str], frame: pin.SE3, compiler: Compiler, element: str) -> pin.SE3:
    """The place of a site in its body."""
    return frame * placed(given, keyword(given, "type", element, _KINDS), compiler, element)[0]


def placed(given, kind, compiler, element) -> tuple[pin.SE3, float | None]:
    """Where a shape stands in its frame; and its half length where its ends give both."""
    if "fromto" not in given:
        return pose(given, compiler, element), None
    if kind not in _CONNECTORS or np.any(vector(given, "pos", element, 3, (0.0, 0.0, 0.0))):
        raise FormatError(f"fromto goes with {', '.join(_CONNECTORS)}, and without pos", element=element)
    ends = vector(given, "fromto", element, 6)
    way = ends[:3] - ends[3:]
    turn = turned_z(direction(way, "way between the ends", element))
    return pin.SE3(turn, (ends[:3] + ends[3:]) / 2), float(np.linalg.norm(way)) / 2
