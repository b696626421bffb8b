"""The shapes that a robot file itself describes. Pinocchio reads and places them, coal loads their meshes."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pinocchio as pin
from defusedxml import ElementTree

from ..mechanism.geometry import Geometry
from ..mechanism.mechanism import Mechanism
from .shapes import Shape, ball, buffer, cylinder

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
        log.warning("%s: the robot file's shapes do not fit the model (%s); simple ones instead", mech.name, error)
        return []
    if missing:
        example = missing[0]
        reason = "not found (outside of the scene's folder only those of package_dirs= are looked for) or unreadable"
        log.warning("%s: %d mesh(es) %s, e.g. %s", mech.name, len(missing), reason, example)
    return [shape for each in found.geometryObjects for shape in _shapes(each)]


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
            path = _find(name, geometry.package_dirs)
            scale = np.array([float(x) for x in mesh.get("scale", "1 1 1").split()])
            if path is not None and _loads(loader, path, scale):
                mesh.set("filename", str(path))
            else:
                missing.append(name)
                link.remove(visual)
    return ElementTree.tostring(root, encoding="unicode"), missing


def _find(name: str, folders) -> Path | None:
    """The mesh of this name inside of one of the folders; a scene's file does not reach what lies elsewhere."""
    scheme, _, rest = name.rpartition("://")
    if scheme not in ("", "file", "package") or "\0" in rest:
        return None
    for folder in (Path(folder).resolve() for folder in folders):
        tries = [folder / rest, folder / rest.lstrip("/")]  # the first is `rest` itself where that is absolute
        if scheme == "package" and rest.startswith(folder.name + "/"):  # the folder is the package itself
            tries.append(folder.parent / rest)
        for path in (each.resolve() for each in tries):
            if path.is_relative_to(folder) and path.is_file():
                return path
    return None


def _loads(loader, path: Path, scale: np.ndarray) -> bool:
    try:
        loader.load(str(path), scale)
    except (ValueError, RuntimeError):
        return False
    return True


def _shapes(item: pin.GeometryObject) -> list[Shape]:
    """One geometry of Pinocchio as a shape; none for kinds that a URDF does not bring."""
    import coal

    form, node, place = item.geometry, item.parentJoint, item.placement
    red, green, blue, opacity = item.meshColor
    color = sum(round(255 * float(np.clip(part, 0, 1))) << at for part, at in ((red, 16), (green, 8), (blue, 0)))
    look = {"color": color, "opacity": float(opacity)}
    if isinstance(form, coal.Sphere):
        return [ball(node, place.translation, form.radius, **look)]
    if isinstance(form, coal.Box):
        sides = 2 * np.asarray(form.halfSide)
        box = {"type": "BoxGeometry", "width": sides[0], "height": sides[1], "depth": sides[2]}
        return [Shape(node, box, place, _corners(sides / 2), **look)]
    if isinstance(form, coal.Cylinder):
        ends = [place.act(np.array([0.0, 0.0, z])) for z in (-form.halfLength, form.halfLength)]
        return [cylinder(node, *ends, form.radius, **look)]
    if isinstance(form, coal.BVHModelBase) and form.num_tris:
        corners = np.asarray(form.vertices())
        triangles = (form.tri_indices(k) for k in range(form.num_tris))
        faces = np.array([(each[0], each[1], each[2]) for each in triangles])  # a coal.Triangle does not iterate
        box = np.array([corners.min(0), corners.max(0)])
        middle = pin.SE3(np.eye(3), box.mean(0))
        bounds = np.array([middle.act(corner) for corner in _corners(np.ptp(box, axis=0) / 2)])
        return [Shape(node, buffer(corners, faces), place, bounds, **look)]
    return []


def _corners(half: np.ndarray) -> np.ndarray:
    return half * np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T
