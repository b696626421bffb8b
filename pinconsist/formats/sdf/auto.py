"""Inertias that SDF computes from shapes: ``<inertial auto="true">``, of the collision shapes with their densities."""

from pathlib import Path
from xml.etree.ElementTree import SubElement

import numpy as np
import pinocchio as pin

from ...errors import FormatError
from .. import solids
from ..reading import text
from ..urdf import INERTIA

WATER = 1000.0  # kg/m³, the density of SDF where none is given


def write_inertias(document, mesh_file) -> None:
    """Write the numbers of all automatic inertias into their elements; `mesh_file` finds the file of a mesh."""
    for body in document.bodies.values():
        node = body.node.child("inertial")
        if not node or not node.truth(node.get("auto", "false")):
            continue
        total = pin.Inertia.Zero()
        density = node.value("density", WATER)
        for collision in body.node.children("collision"):
            solid = _solid(collision, mesh_file)
            if solid is None:
                raise collision.error("its shape has no volume, and the inertia depends on it; give the link's inertia")
            place, relative_to = collision.pose()
            if relative_to:
                base = document.resolve(body.scope, relative_to, f"{collision.name}: pose")
                place = body.pose.actInv(document.pose(base) * place)
            total = total + place.act(solids.scaled(solid, collision.value("density", density)))
        if not total.mass > 0.0:
            raise node.error("it is computed from the collision shapes, and the link has none; give its values")
        mass = node.value("mass", 0.0) if node.child("mass") else 0.0
        total = solids.scaled(total, mass / total.mass) if mass else total
        for child in list(node.xml):
            node.xml.remove(child)
        node.xml.attrib.pop("auto")
        SubElement(node.xml, "pose").text = f"{text(*total.lever)} 0 0 0"
        SubElement(node.xml, "mass").text = text(total.mass)
        inertia = SubElement(node.xml, "inertia")
        for key, value in zip(INERTIA, total.inertia[np.triu_indices(3)], strict=True):
            SubElement(inertia, key).text = text(value)


def _solid(collision, mesh_file):
    shape = collision.solid()
    kind = shape.xml.tag if shape else ""
    if kind == "box":
        return solids.box(*shape.values("size", (1.0, 1.0, 1.0)))
    if kind == "sphere":
        return solids.ellipsoid(*(shape.value("radius", 1.0),) * 3)
    if kind == "ellipsoid":
        return solids.ellipsoid(*shape.values("radii", (1.0, 1.0, 1.0)))
    if kind in ("cylinder", "capsule", "cone"):
        make = {"cylinder": solids.cylinder, "capsule": solids.capsule, "cone": solids.cone}[kind]
        return make(shape.value("radius", 1.0), shape.value("length", 1.0))
    if kind == "mesh":
        scale = np.diag([*shape.values("scale", (1.0, 1.0, 1.0)), 1.0])
        return solids.moved(of_file(mesh_file(shape)), scale)
    return None


def of_file(path: Path) -> pin.Inertia:
    """The solid of a mesh file, of density 1, read by coal."""
    import coal

    try:
        mesh = coal.MeshLoader().load(str(path), np.ones(3))
    except Exception as error:  # Boost.Python may raise any kind
        raise FormatError(f"the mesh {path.name} cannot be read: {error}") from None
    triangles = [tuple(mesh.tri_indices(i)) for i in range(mesh.num_tris)]
    return solids.mesh(np.array(mesh.vertices()), np.array(triangles))
