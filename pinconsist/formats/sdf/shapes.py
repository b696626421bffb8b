"""Links of SDF in the words of URDF: one set of checks and one way to show shapes for both formats."""

from __future__ import annotations

import logging
import os
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pinocchio as pin

from ...errors import FormatError
from ..reading import shown
from ..xml_reading import numbers, text
from .tree import Body, Scene
from .words import flag, number, pose, tell_unknown, truth, vector, word

INERTIA = {"ixx": 1.0, "ixy": 0.0, "ixz": 0.0, "iyy": 1.0, "iyz": 0.0, "izz": 1.0}
"""kg·m², where the file gives none."""

_LINK = ("pose", "inertial", "collision", "visual", "sensor", "projector", "audio_sink", "audio_source", "battery")
_LINK += ("light", "particle_emitter", "gravity", "enable_wind", "self_collide", "kinematic", "must_be_base_link")
_LINK += ("velocity_decay",)
_SIZES: dict[str, dict[str, tuple[float, ...]]] = {
    "box": {"size": (1.0, 1.0, 1.0)},
    "cylinder": {"radius": (1.0,), "length": (1.0,)},
    "sphere": {"radius": (1.0,)},
    "mesh": {"scale": (1.0, 1.0, 1.0)},
}
_log = logging.getLogger(__name__)


def in_urdf(scene: Scene, folders: tuple[Path, ...]) -> Element:
    """A raw `<robot>` with the links of a scene, their inertias and shapes, all fixed to the first one."""
    robot = Element("robot")
    for body in scene.bodies.values():
        link = SubElement(robot, "link", name=body.name)
        element = f"link {body.name!r}"
        tell_unknown(body.node, _LINK, element)
        _inertial(SubElement(link, "inertial"), body.node.find("inertial"), f"{element}: inertial")
        for visual in body.node.findall("visual"):
            _visual(link, visual, body, scene, folders, f"{element}: visual {visual.get('name', '')!r}")
    first, *others = scene.bodies
    for i, name in enumerate(others):
        joint = SubElement(robot, "joint", name=str(i), type="fixed")
        SubElement(joint, "parent", link=first)
        SubElement(joint, "child", link=name)
    return robot


def inertias(scene: Scene, robot: Element) -> dict[str, pin.Inertia]:
    """Link → its inertia, from a checked `<robot>`."""
    found = {}
    for link in robot.findall("link"):
        name = link.attrib["name"]
        mass, inertia = link.find("inertial/mass"), link.find("inertial/inertia")
        xx, xy, xz, yy, yz, zz = (numbers(inertia, key, "")[0] for key in INERTIA)
        place, _ = pose(scene.bodies[name].node.find("inertial"), f"link {name!r}: inertial")
        own = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        found[name] = place.act(pin.Inertia(numbers(mass, "value", "")[0], np.zeros(3), own))
    return found


def weightless(scene: Scene) -> bool:
    """Whether gravity acts on no link; FormatError where it acts on some of the moving ones only."""
    pulled, free = [], []
    for body in scene.bodies.values():
        element = f"link {body.name!r}"
        if flag(body.node, "kinematic", element):
            raise FormatError("kinematic links, moved by a program, cannot be read", element=element)
        if any(number(body.node.find("velocity_decay"), tag, element) for tag in ("linear", "angular")):
            _log.warning("%s: velocity_decay has no effect", element)
        if not body.static:
            (pulled if flag(body.node, "gravity", element, True) else free).append(body.name)
    if pulled and free:
        raise FormatError(
            f"gravity does not act on it, but on {pulled[0]!r}; it can be left away for all links only",
            element=f"link {free[0]!r}",
        )
    return bool(free)


def _inertial(out, node, element):
    if node is not None:
        if truth(node.get("auto", "false"), element):
            raise FormatError("inertias from shapes (auto) cannot be read; write them out", element=element)
        if node.find("fluid_added_mass") is not None:
            raise FormatError("fluid_added_mass cannot be read", element=element)
    SubElement(out, "mass", value=text(number(node, "mass", element, 1.0)))
    inertia = None if node is None else node.find("inertia")
    values = {key: text(number(inertia, key, f"{element}: inertia", default)) for key, default in INERTIA.items()}
    SubElement(out, "inertia", values)


def _visual(link, node, body: Body, scene, folders, element):
    geometry = node.find("geometry")
    solid = None if geometry is None or not len(geometry) else geometry[0]
    kind = "nothing" if solid is None else solid.tag
    sizes = {key: text(*vector(solid, key, element, default)) for key, default in _SIZES.get(kind, {}).items()}
    if kind == "mesh":
        uri = _mesh(word(solid, "uri", f"{element}: mesh"), folders, f"{element}: mesh: uri")
        if uri is None:
            return
        sizes["filename"] = uri
    out = SubElement(link, "visual")
    place, relative_to = pose(node, element)
    if relative_to:
        place = body.pose.actInv(scene.place(body.name, relative_to, f"{element}: pose") * place)
    rpy = pin.rpy.matrixToRpy(place.rotation)
    SubElement(out, "origin", xyz=text(*place.translation), rpy=text(*rpy))
    SubElement(SubElement(out, "geometry"), kind, sizes)
    material = node.find("material")
    if material is not None:
        colour = (material.findtext("diffuse") or material.findtext("ambient") or "").split()
        if colour:
            rgba = " ".join([*colour, "1"] if len(colour) == 3 else colour)
            SubElement(SubElement(out, "material"), "color", rgba=rgba)


def _mesh(uri, folders, element):
    """A mesh's name in URDF's words, or None for one that lies in the network; FormatError where it climbs out."""
    scheme, _, rest = uri.rpartition("://")
    if scheme in ("http", "https"):
        _log.warning("%s: left out, nothing is fetched from the network: %s", element, shown(uri))
        return None
    if scheme in ("model", "package"):
        inside = not os.path.normpath(rest).startswith((os.pardir, os.sep))
    elif scheme in ("", "file"):
        targets = [Path(os.path.normpath(folder / rest)) for folder in folders]
        inside = any(target.is_relative_to(folder) for target in targets for folder in folders)
    else:
        raise FormatError(f"the scheme of {shown(uri)} is none of model, package, file", element=element)
    if "\0" in uri or not inside:
        raise FormatError(
            f"{shown(uri)} leads out of the folder of the scene; name the folders of its meshes by package_dirs=",
            element=element,
        )
    return f"package://{rest}" if scheme == "model" else uri
