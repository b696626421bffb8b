"""The geoms of an MJCF file as shapes for replays, in the URDF words that :class:`Geometry` holds."""

from __future__ import annotations

import logging
import os
from pathlib import Path, PurePosixPath
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np
import pinocchio as pin

from ...errors import FormatError
from ...mechanism.mechanism import Geometry
from ..reading import text
from .bodies import Body
from .document import sections
from .names import FrameNames
from .settings import Compiler, Defaults
from .values import rotation, vector

VISIBLE = 2
"""The last group of geoms that is shown, as in MuJoCo's viewers."""
_GREY = (0.5, 0.5, 0.5, 1.0)
_log = logging.getLogger(__name__)


def geometry(
    root: Element, bodies: list[Body], names: FrameNames, compiler: Compiler, defaults: Defaults, folders
) -> Geometry:
    """The visible shapes of all bodies.

    Planes, height fields and ellipsoids are left out; so are meshes whose file lies outside of the folder of the scene.

    Parameters
    ----------
    folders : sequence of path-like
        Where mesh files are looked for; the last is the folder of the scene.
    """
    assets = _Assets(root, compiler, defaults)
    robot = Element("robot", name="scene")
    for body, link in zip(bodies, names.links, strict=True):
        node = SubElement(robot, "link", name=link)
        for geom in body.geoms:
            if geom.group <= VISIBLE:
                _add(node, geom, assets)
        if body is not bodies[0]:  # all on the world: where they stand is up to the frames of the model
            joint = SubElement(robot, "joint", name=f"{link} mount", type="fixed")
            SubElement(joint, "parent", link=names.links[0])
            SubElement(joint, "child", link=link)
    return Geometry(tostring(robot, encoding="unicode"), tuple(str(Path(folder).resolve()) for folder in folders))


class _Assets:
    """Meshes and colours by their names."""

    def __init__(self, root, compiler, defaults):
        self._compiler = compiler
        self._colours, self._meshes = {}, {}
        for node in sections(root, "asset"):
            given = defaults.of(node, f"asset: {node.tag}")
            if node.tag == "material" and "rgba" in given:
                self._colours[node.get("name", "")] = given
            elif node.tag == "mesh":
                self._meshes[node.get("name") or PurePosixPath(node.get("file", "")).stem] = given

    def colour(self, geom):
        """Of a geom itself, or of its material."""
        own, material = geom.attributes, self._colours.get(geom.attributes.get("material"), {})
        return vector(own if "rgba" in own else material, "rgba", geom.element, 4, _GREY)

    def mesh(self, geom):
        """File, scale and place of the mesh of a geom; None with a warning where there is no file to show."""
        name = geom.attributes.get("mesh", "")
        if name not in self._meshes:
            raise FormatError(f"there is no mesh {name!r}", element=geom.element)
        given, element = self._meshes[name], f"mesh {name!r}"
        scale = vector(given, "scale", element, 3, (1.0, 1.0, 1.0))
        turn = rotation(vector(given, "refquat", element, 4, (1.0, 0.0, 0.0, 0.0)), element)
        place = pin.SE3(turn, vector(given, "refpos", element, 3, (0.0, 0.0, 0.0))).inverse()
        file = given.get("file", "")
        if self._compiler.strippath:
            file = PurePosixPath(file.replace("\\", "/")).name
        path = os.path.normpath(os.path.join(self._compiler.meshdir, file))
        if not file or os.path.isabs(path) or path.startswith(".."):
            _log.warning("%s: not shown, %s", element, "its file lies elsewhere" if file else "it has no file")
            return None
        return path, scale, place


def _add(link, geom, assets):
    """A visual, or three of them for a capsule."""
    if geom.kind == "mesh":
        found = assets.mesh(geom)
        if found is not None:
            path, scale, place = found
            _visual(link, geom.place * place, "mesh", {"filename": path, "scale": text(*scale)}, assets.colour(geom))
        return
    if "mesh" in geom.attributes or geom.kind not in ("sphere", "box", "cylinder", "capsule"):
        return
    colour, size = assets.colour(geom), geom.size
    if geom.kind == "sphere":
        _visual(link, geom.place, "sphere", {"radius": text(size[0])}, colour)
    elif geom.kind == "box":
        _visual(link, geom.place, "box", {"size": text(*(2 * half for half in size))}, colour)
    else:
        radius, half = size
        _visual(link, geom.place, "cylinder", {"radius": text(radius), "length": text(2 * half)}, colour)
        for end in (-half, half) if geom.kind == "capsule" else ():
            tip = pin.SE3(np.eye(3), np.array([0.0, 0.0, end]))
            _visual(link, geom.place * tip, "sphere", {"radius": text(radius)}, colour)


def _visual(link, place, kind, sizes, colour):
    visual = SubElement(link, "visual")
    SubElement(visual, "origin", xyz=text(*place.translation), rpy=text(*pin.rpy.matrixToRpy(place.rotation)))
    SubElement(SubElement(visual, "geometry"), kind, sizes)
    words = text(*colour)
    SubElement(SubElement(visual, "material", name=words), "color", rgba=words)
