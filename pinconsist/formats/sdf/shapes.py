"""Links of SDF in the words of URDF: one set of checks and one way to show shapes for both formats."""

import logging
import os
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pinocchio as pin

from ..reading import Node, shown, text
from ..urdf import INERTIA, SHAPES, add_visual, fixed_links, symmetric
from .document import Body, Document

_DEFAULT_INERTIA = dict(zip(INERTIA, (1.0, 0.0, 0.0, 1.0, 0.0, 1.0), strict=True))  # kg·m²
_LINK = ("pose", "inertial", "collision", "visual", "sensor", "projector", "audio_sink", "audio_source", "battery")
_LINK += ("light", "particle_emitter", "gravity", "enable_wind", "self_collide", "kinematic", "must_be_base_link")
_LINK += ("velocity_decay",)
_log = logging.getLogger(__name__)


def in_urdf(document: Document, folders: list[Path]) -> Element:
    """A raw `<robot>` with the links of a file, their inertias and shapes, all fixed to the first one."""
    robot, links = fixed_links(document.bodies)
    for name, body in document.bodies.items():
        body.node.warn_unknown(_LINK)
        _inertial(SubElement(links[name], "inertial"), body.node.child("inertial"))
        for visual in body.node.children("visual"):
            visual.name += f" {visual.get('name')!r}"
            _visual(links[name], visual, body, document, folders)
    return robot


def inertias(document: Document, robot: Element) -> dict[str, pin.Inertia]:
    """Link → its inertia in its own frame, from a checked `<robot>`."""
    found = {}
    for name, link in Node(robot).named("link").items():
        inertial = link.child("inertial")
        own = symmetric([inertial.child("inertia").number(key) for key in INERTIA])
        place, _ = document.bodies[name].node.child("inertial").pose()
        found[name] = place.act(pin.Inertia(inertial.child("mass").number("value"), np.zeros(3), own))
    return found


def weightless(document: Document) -> bool:
    """Whether gravity acts on no link; FormatError if it acts on some of the moving ones only."""
    pulled, free = [], []
    for body in document.bodies.values():
        if body.node.flag("kinematic"):
            raise body.node.error("kinematic links, moved by a program, cannot be read")
        if any(body.node.child("velocity_decay").value(tag) for tag in ("linear", "angular")):
            _log.warning("%s: velocity_decay has no effect", body.node.name)
        if not body.static:
            (pulled if body.node.flag("gravity", True) else free).append(body)
    if pulled and free:
        raise free[0].node.error(
            f"gravity does not act on it, but on {pulled[0].name!r}; it can be switched off for all links only"
        )
    return bool(free)


def _inertial(out, node):
    if node.truth(node.get("auto", "false")):
        raise node.error("inertias from shapes (auto) cannot be read; write them out")
    if node.child("fluid_added_mass"):
        raise node.error("fluid_added_mass cannot be read")
    SubElement(out, "mass", value=text(node.value("mass", 1.0)))
    inertia = node.child("inertia")
    SubElement(out, "inertia", {key: text(inertia.value(key, each)) for key, each in _DEFAULT_INERTIA.items()})


def _visual(link, node, body: Body, document, folders):
    solid = node.solid()
    kind = solid.xml.tag if solid else "nothing"
    sizes = {key: text(*solid.values(key, (1.0,) * count)) for key, count in SHAPES.get(kind, {}).items()}
    if kind == "mesh":
        uri = solid.word("uri")
        if uri.startswith(("http://", "https://")):
            _log.warning("%s: uri: left out, nothing is fetched from the network: %s", solid.name, shown(uri))
            return
        sizes["filename"] = _mesh(uri, folders, solid.child("uri"))
    place, relative_to = node.pose()
    if relative_to:
        base = document.lookup.resolve(body.scope, relative_to, f"{node.name}: pose")
        place = body.pose.actInv(document.lookup.pose(base) * place)
    material = node.child("material")
    colour = (material.child("diffuse").text() or material.child("ambient").text()).split()
    add_visual(link, place, kind, sizes, " ".join([*colour, "1"] if len(colour) == 3 else colour))


def _mesh(uri, folders, node):
    """A mesh's name in URDF's words; FormatError if it leads out of the folders."""
    scheme, _, rest = uri.rpartition("://")
    if scheme in ("model", "package"):
        inside = not os.path.normpath(rest).startswith((os.pardir, os.sep))
    elif scheme in ("", "file"):
        targets = [Path(os.path.normpath(folder / rest)) for folder in folders]
        inside = any(target.is_relative_to(folder) for target in targets for folder in folders)
    else:
        raise node.error(f"the scheme of {shown(uri)} is none of model, package, file")
    if "\0" in uri or not inside:
        reason = "leads out of the folder of the scene; name the folders of its meshes by package_dirs="
        raise node.error(f"{shown(uri)} {reason}")
    return f"package://{rest}" if scheme == "model" else uri
