"""Collision shapes of files on planes: spheres, capsules and boxes become contacts; the rest is counted."""

from __future__ import annotations

import re
from collections import Counter
from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from ..mechanism.contacts import Contact
from ..mechanism.file_laws import COLLIDING, COLLISIONS, FLOOR, STATIC

USUAL = 1.0  # friction without any in the file, as in SDF and MuJoCo
COUNTED = re.compile(rf"^\d+ ({COLLISIONS}|{STATIC}|{COLLIDING}|{FLOOR})s?$")
SUPPORTED = ("sphere", "capsule", "box")


class Solid(NamedTuple):
    """A collision shape of a link: its pose there, what it is, its sizes (radius; radius, half length; half sides)."""

    frame: str
    place: pin.SE3
    kind: str
    sizes: tuple[float, ...]
    friction: float | None = None


class Plane(NamedTuple):
    """A plane of the world: its normal and its offset along it."""

    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)
    offset: float = 0.0
    friction: float | None = None


def solids_of_urdf(robot: Element) -> tuple[Solid, ...]:
    """The collision shapes of a ``<robot>`` that was checked."""
    found = []
    for link in robot.findall("link"):
        for each in link.findall("collision"):
            origin, solid = each.find("origin"), each.find("geometry")[0]
            given = {} if origin is None else origin.attrib
            xyz, rpy = ([float(x) for x in given.get(key, "0 0 0").split()] for key in ("xyz", "rpy"))
            place = pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array(xyz))
            sizes: tuple[float, ...] = ()
            if solid.tag == "sphere":
                sizes = (float(solid.get("radius")),)
            elif solid.tag == "box":
                sizes = tuple(0.5 * float(x) for x in solid.get("size").split())
            found.append(Solid(link.get("name"), place, solid.tag, sizes))
    return tuple(found)


def ground_contacts(model, solids, planes, friction=None, rule=max) -> tuple[tuple[Contact, ...], Counter]:
    """The contacts of solids on bodies that move with planes, and the count of the solids that cannot act, by kind.

    `friction` replaces that of the file; else that of a solid and of a plane are combined by `rule`. Points are the
    corners of boxes. A sphere with friction pivots about its centre, and does not roll.
    """
    contacts, left, numbers = [], Counter(), Counter()
    for solid in solids:
        joint = model.frames[model.getFrameId(solid.frame)].parentJoint if model.existFrame(solid.frame) else 0
        if joint == 0:
            left[STATIC] += 1
            continue
        if solid.kind not in SUPPORTED:
            left[f"{COLLISIONS} of kind {solid.kind}"] += 1
            continue
        for plane in planes or (Plane(),):
            own = friction
            if own is None:
                known = [each for each in (solid.friction, plane.friction) if each is not None]
                own = rule(known) if known else USUAL
            for place, radius in _points(solid):
                label = f"{solid.frame} {solid.kind}"
                numbers[label] += 1
                name = f"{label} {numbers[label]}"
                on = {"normal": plane.normal, "offset": plane.offset + radius, "friction": own}
                xyz = tuple((solid.place * place).tolist())
                contacts.append(Contact(name, solid.frame, xyz, **on))
    return tuple(contacts), left


def _points(solid):
    """(point in the axes of the solid, radius around it): of a box its corners, of a capsule both ends."""
    if solid.kind == "sphere":
        yield np.zeros(3), solid.sizes[0]
    elif solid.kind == "capsule":
        for end in (-1.0, 1.0):
            yield np.array([0.0, 0.0, end * solid.sizes[1]]), solid.sizes[0]
    else:
        for signs in np.indices((2, 2, 2)).reshape(3, -1).T * 2.0 - 1.0:
            yield signs * solid.sizes, 0.0


def still_ignored(ignored, left: Counter) -> tuple[str, ...]:
    """The lines about what has no effect, with what is `left` of collision shapes."""
    lines = [line for line in ignored if not COUNTED.match(line)]
    for what, count in left.items():
        lines.append(f"{count} {what.replace(COLLISIONS, COLLISIONS + 's' * (count > 1))}")
    return tuple(lines)
