"""The shapes that a robot file itself describes. Pinocchio reads and places them, coal loads their meshes."""

import logging
from pathlib import Path

import numpy as np
import pinocchio as pin
from defusedxml import ElementTree

from ..mechanism.mechanism import Geometry, Mechanism
from .shapes import Shape, ball, buffer, cylinder

CORNERS = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T
WHITE, OFF_WHITE = 0.85, 0xA8B2BC  # a lighter colour, as that without material, hardly differs from the page
log = logging.getLogger(__name__)


def visuals(mech: Mechanism) -> list[Shape]:
    """Shapes from the mechanism's robot file; those that cannot be loaded are left out with one warning."""
    if mech.geometry is None:
        return []
    import coal

    loader = coal.CachedMeshLoader()
    text, missing = _loadable(mech.geometry, loader)
    try:
        found = pin.buildGeomFromUrdfString(mech.model, text, pin.GeometryType.VISUAL, None, [], loader)
    except ValueError as error:
        log.warning("%s: the robot file's shapes do not fit the model (%s); simple shapes instead", mech.name, error)
        return []
    if missing:
        reason = "not found (outside the scene's folder, only package_dirs= are searched) or unreadable"
        log.warning("%s: %d mesh(es) %s, e.g. %s", mech.name, len(missing), reason, missing[0])
    return [shape for each in found.geometryObjects if (shape := _shape(each)) is not None]


def _loadable(geometry: Geometry, loader) -> tuple[str, list[str]]:
    """The robot text without visuals that cannot be loaded, mesh paths made absolute; and the meshes left out."""
    root = ElementTree.fromstring(geometry.urdf)
    missing = []
    for link in root.iter("link"):
        for visual in link.findall("visual"):
            mesh = visual.find("geometry/mesh")
            if mesh is None:
                continue
            name = mesh.get("filename", "")
            try:
                path = _find(name, geometry.package_dirs)
                loader.load(str(path), np.array([float(x) for x in mesh.get("scale", "1 1 1").split()]))
                mesh.set("filename", str(path))
            except (ValueError, RuntimeError):
                missing.append(name)
                link.remove(visual)
    return ElementTree.tostring(root, encoding="unicode"), missing


def _find(name: str, folders) -> Path:
    """The mesh of this name in one of the folders, never elsewhere; ValueError if there is none."""
    scheme, _, rest = name.rpartition("://")
    if scheme in ("", "file", "package") and "\0" not in rest:
        for folder in (Path(folder).resolve() for folder in folders):
            tries = [folder / rest, folder / rest.lstrip("/")]  # the first is `rest` itself if that is absolute
            if scheme == "package" and rest.startswith(folder.name + "/"):  # the folder is the package itself
                tries.append(folder.parent / rest)
            for path in (each.resolve() for each in tries):
                if path.is_relative_to(folder) and path.is_file():
                    return path
    raise ValueError(name)


def _shape(item: pin.GeometryObject) -> Shape | None:
    """One of Pinocchio's geometries as a shape; None for kinds that a URDF does not have."""
    import coal

    form, node, place = item.geometry, item.parentJoint, item.placement
    color = int.from_bytes(bytes(round(255 * float(part)) for part in np.clip(item.meshColor[:3], 0, 1)), "big")
    if min(item.meshColor[:3]) > WHITE:
        color = OFF_WHITE  # the page is white, too
    look = {"color": color, "opacity": float(item.meshColor[3])}
    if isinstance(form, coal.Sphere):
        return ball(node, place.translation, form.radius, **look)
    if isinstance(form, coal.Box):
        sides = 2 * np.asarray(form.halfSide)
        box = {"type": "BoxGeometry", "width": sides[0], "height": sides[1], "depth": sides[2]}
        return Shape(node, box, place, sides / 2 * CORNERS, **look)
    if isinstance(form, coal.Cylinder):
        ends = [place.act(np.array([0.0, 0.0, z])) for z in (-form.halfLength, form.halfLength)]
        return cylinder(node, *ends, form.radius, **look)
    if isinstance(form, coal.BVHModelBase) and form.num_tris:
        points = np.asarray(form.vertices())
        triangles = (form.tri_indices(k) for k in range(form.num_tris))
        faces = np.array([(each[0], each[1], each[2]) for each in triangles])  # a coal.Triangle does not iterate
        low, high = points.min(0), points.max(0)
        return Shape(node, buffer(points, faces), place, (low + high) / 2 + (high - low) / 2 * CORNERS, **look)
    return None
