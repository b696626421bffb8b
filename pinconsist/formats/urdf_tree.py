"""URDF text → a checked URDF tree in plain words, before Pinocchio sees it.

Only what a simulation or a replay needs is carried over (links, joints, shapes), with every number rewritten, so that
no parser behind us meets anything that was not checked here. FormatErrors raised here do not know the file yet.
"""

from __future__ import annotations

import logging
import math
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from ..errors import FormatError
from .reading import near
from .xml_reading import child, named, numbers, text

JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
UNLIMITED = 1e300
"""Effort and velocity limit of joints whose file gives none."""

_INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_SHAPES = {"box": {"size": 3}, "cylinder": {"radius": 1, "length": 1}, "sphere": {"radius": 1}}
_log = logging.getLogger(__name__)


def checked(raw: Element, name: str) -> tuple[Element, list[tuple[str, str]]]:
    """A clean `<robot>` from a parsed file, and the (joint, "lower" or "upper") limits that it does not have.

    Parameters
    ----------
    raw : Element
        The root element as parsed.
    name : str
        The name the robot gets.

    Raises
    ------
    FormatError
        The first thing that is wrong, with its element.
    """
    namespace = raw.tag[: raw.tag.find("}") + 1]  # a default namespace is legal and means nothing
    for node in raw.iter():
        node.tag = node.tag.removeprefix(namespace)
    if raw.tag != "robot":
        raise FormatError(f"the root element of a URDF is <robot>, this is <{raw.tag}>")
    robot = Element("robot", name=name)
    colours = _colours(raw)
    links = _named(raw, "link")
    if not links:
        raise FormatError("there is no link")
    for link, node in links.items():
        _link(robot, link, node, colours)
    unlimited = []
    for joint, node in _named(raw, "joint").items():
        unlimited += [(joint, side) for side in _joint(robot, joint, node, links)]
    _check_tree(links, robot.findall("joint"))
    return robot, unlimited


def _named(raw, tag):
    found = named(raw, tag)
    if "universe" in found:
        raise FormatError("'universe' is the name of the ground here; give it another", element=f"{tag} 'universe'")
    return found


def _link(robot, name, node, colours):
    element = f"link {name!r}"
    link = SubElement(robot, "link", name=name)
    inertial = node.find("inertial")
    if inertial is not None:
        _inertial(SubElement(link, "inertial"), inertial, f"{element}: inertial")
    for tag in ("visual", "collision"):
        for shape in node.findall(tag):
            _shape(link, tag, shape, f"{element}: {tag}", colours)


def _inertial(out, node, element):
    _origin(out, node, element)
    mass = numbers(child(node, "mass", element), "value", f"{element}: mass")[0]
    if mass < 0:
        raise FormatError(f"the mass is negative: {mass:g} kg", element=element)
    SubElement(out, "mass", value=text(mass))
    inertia = child(node, "inertia", element)
    values = [numbers(inertia, key, f"{element}: inertia")[0] for key in _INERTIA]
    xx, xy, xz, yy, yz, zz = values
    scale = max(map(abs, values)) or 1.0
    smallest = np.linalg.eigvalsh(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) / scale)[0]
    if smallest < -1e-9:  # files round
        raise FormatError(f"a principal inertia is negative: {smallest * scale:.3g} kg m²", element=element)
    SubElement(out, "inertia", {key: text(value) for key, value in zip(_INERTIA, values, strict=True)})


def _shape(link, tag, node, element, colours):
    geometry = node.find("geometry")
    solid = None if geometry is None or not len(geometry) else geometry[0]
    if solid is None or (solid.tag not in _SHAPES and solid.tag != "mesh"):
        _log.warning("%s: left out, its geometry is none of %s, mesh", element, ", ".join(_SHAPES))
        return
    element = f"{element}: {solid.tag}"
    if solid.tag == "mesh":
        sizes = {"scale": numbers(solid, "scale", element, 3, (1.0, 1.0, 1.0))}
        extra = {"filename": solid.get("filename", "")}
        if not extra["filename"]:
            raise FormatError("attribute 'filename' is missing", element=element)
    else:
        sizes = {key: numbers(solid, key, element, count) for key, count in _SHAPES[solid.tag].items()}
        extra = {}
        if min(min(size) for size in sizes.values()) < 0:
            raise FormatError("a size is negative", element=element)
    out = SubElement(link, tag)
    _origin(out, node, element)
    solid_attributes = {key: text(*size) for key, size in sizes.items()} | extra
    SubElement(SubElement(out, "geometry"), solid.tag, solid_attributes)
    material = node.find("material") if tag == "visual" else None
    if material is not None:
        colour = _colour(material, element) or colours.get(material.get("name", ""))
        if colour:  # named by its value: parsers give all materials of one name the colour of the first
            SubElement(SubElement(out, "material", name=colour), "color", rgba=colour)


def _colours(raw):
    named = {}
    for node in raw.findall("material"):
        name = node.get("name", "")
        named[name] = _colour(node, f"material {name!r}")
    return named


def _colour(node, element):
    colour = node.find("color")
    return None if colour is None else text(*numbers(colour, "rgba", f"{element}: color", 4))


def _joint(robot, name, node, links):
    element = f"joint {name!r}"
    kind = node.get("type", "")
    if kind not in JOINT_TYPES:
        raise FormatError(f"type {kind!r} is not one of {', '.join(JOINT_TYPES)}", element=element)
    ends = []
    for end in ("parent", "child"):
        link = child(node, end, element).get("link", "")
        if link not in links:
            raise FormatError(f"its {end} link {link!r} does not exist{near(link, links)}", element=element)
        ends.append(link)
    if ends[0] == ends[1]:
        raise FormatError(f"parent and child are the same link {ends[0]!r}", element=element)
    joint = SubElement(robot, "joint", name=name, type="revolute" if kind == "continuous" else kind)
    _origin(joint, node, element)
    SubElement(joint, "parent", link=ends[0])
    SubElement(joint, "child", link=ends[1])
    if kind in ("fixed", "floating"):
        return ()
    _axis(joint, node, kind, element)
    dynamics = node.find("dynamics")
    if dynamics is not None:
        given = {key: numbers(dynamics, key, f"{element}: dynamics", 1, (0.0,)) for key in ("damping", "friction")}
        SubElement(joint, "dynamics", {key: text(*value) for key, value in given.items()})
    return () if kind == "planar" else _limit(joint, node, kind, element)


def _axis(joint, node, kind, element):
    axis = node.find("axis")
    x, y, z = (1.0, 0.0, 0.0) if axis is None else numbers(axis, "xyz", f"{element}: axis", 3, (1.0, 0.0, 0.0))
    length = math.hypot(x, y, z)
    if length == 0:
        raise FormatError("the axis is the zero vector", element=element)
    axis = (x / length, y / length, z / length)
    if kind == "planar" and axis != (0.0, 0.0, 1.0):  # Pinocchio ignores the axis of a planar joint
        raise FormatError('planar joints can be read only with <axis xyz="0 0 1"/>, motion in x-y', element=element)
    SubElement(joint, "axis", xyz=text(*axis))


def _limit(joint, node, kind, element):
    """Write the limits that Pinocchio demands; return the sides on which the file has none."""
    limit = node.find("limit")
    limit = Element("limit") if limit is None else limit
    element = f"{element}: limit"
    given = {
        key: numbers(limit, key, element, 1, (default,), math.inf)
        for key, default in (("lower", 0.0), ("upper", 0.0), ("effort", UNLIMITED), ("velocity", UNLIMITED))
    }
    SubElement(joint, "limit", {key: text(*value) for key, value in given.items()})
    return [key for key in ("lower", "upper") if kind == "continuous" or key not in limit.attrib]


def _check_tree(links, joints):
    parent_of = {}
    for joint in joints:
        parent, link = joint.find("parent").get("link"), joint.find("child").get("link")
        if link in parent_of:
            raise FormatError(
                f"it is the child of two joints, {parent_of[link][1]!r} and {joint.get('name')!r}. URDF holds a tree: "
                "keep one of them and close the loop by a <loop_joint> or in a loop file",
                element=f"link {link!r}",
            )
        parent_of[link] = parent, joint.get("name")
    roots = [link for link in links if link not in parent_of]
    if len(roots) > 1:
        raise FormatError(f"the links {roots[0]!r} and {roots[1]!r} are both without a parent; join them by a joint")
    reached = set(roots)
    for link in links:  # up to a link known to hang on the root; meeting the own path again is a cycle
        path = {}
        while link not in reached:
            if link in path:
                raise FormatError("its parents lead back to itself: the links form a cycle", element=f"link {link!r}")
            path[link] = None
            link = parent_of[link][0]
        reached.update(path)


def _origin(out, node, element):
    origin = node.find("origin")
    if origin is not None:
        zero = (0.0, 0.0, 0.0)
        given = {key: numbers(origin, key, f"{element}: origin", 3, zero) for key in ("xyz", "rpy")}
        SubElement(out, "origin", {key: text(*value) for key, value in given.items()})
