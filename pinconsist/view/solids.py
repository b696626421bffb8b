"""The shapes of a picture as polygons seen from its viewpoint: what films and drawings are painted from."""

from dataclasses import dataclass
from itertools import accumulate
from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

ROUND = 18  # sides of round shapes
LONG, CAP = 12, 3  # parts of a cylinder's length and of its ends, so that crossing cylinders hide each other correctly
LIGHT = np.array([-0.35, 0.55, 0.76])  # to the right, up, towards the viewer
DARK = 0.45  # brightness of an unlit face


@dataclass(eq=False)
class Solid:
    """A shape in the axes of its node: corners, shape (k, 3), and faces of four of them, shape (f, 4)."""

    path: str
    corners: np.ndarray
    faces: np.ndarray
    convex: bool
    color: np.ndarray  # (3,), 0 to 255
    opacity: float
    on_top: int
    name: str
    radius: float = 0.0  # of a ball


class Patch(NamedTuple):
    """A polygon of the picture, in the order of painting."""

    points: np.ndarray  # (n, 2), pixels
    color: np.ndarray
    opacity: float
    solid: Solid


class Stage:
    """The solids and lines of a :func:`~pinconsist.view.picture.picture`, at every frame, seen without perspective.

    ``planar`` says that everything moves in parallel planes; ``extent``, m, encloses the motion.
    """

    def __init__(self, page: dict):
        self.axes = np.array([_z_up(axis) for axis in page["view"]["axes"]])
        self.planar, seen = page["view"]["planar"], np.array([_z_up(point) for point in page["view"]["points"]])
        flat = seen @ self.axes[:2].T
        low, high = flat.min(axis=0), flat.max(axis=0)
        self.extent, self._middle = np.maximum(high - low, 1e-9), (low + high) / 2
        self.solids: list[Solid] = []
        self.lines: list[tuple[np.ndarray, np.ndarray, bool]] = []  # points, colour, whether joined
        fixed, moving = {}, {}
        for command in page["commands"]:
            if command["type"] == "set_transform":
                fixed[command["path"]] = np.reshape(command["matrix"], (1, 4, 4)).transpose(0, 2, 1)
            elif command["type"] == "set_animation":
                moving = {each["path"]: _matrices(each["clip"]["tracks"]) for each in command["animations"]}
            elif command["type"] == "set_object":
                self._add(command["path"], command["object"])
        self._poses = [_pose(each.path, fixed | moving) for each in self.solids]

    def _add(self, path, thing):
        (geometry,), (material,), about = thing["geometries"], thing["materials"], thing["object"]
        color = np.array([material["color"] >> shift & 255 for shift in (16, 8, 0)], float)
        if about["type"] != "Mesh":
            points = np.reshape(geometry["data"]["attributes"]["position"]["array"], (-1, 3))
            self.lines.append((points @ self.axes[:2].T, color, 2 - (about["type"] == "LineSegments")))
            return
        corners, faces = _mesh(geometry)
        matrix = np.reshape(about["matrix"], (4, 4)).T
        corners = corners @ matrix[:3, :3].T + matrix[:3, 3]
        convex = geometry["type"] not in ("TorusGeometry", "BufferGeometry")
        opacity, on_top, name = material["opacity"], about["renderOrder"], about["userData"]["name"]
        radius = geometry["radius"] if geometry["type"] == "SphereGeometry" else 0.0
        self.solids.append(Solid(path, corners, faces, convex, color, opacity, on_top, name, radius))

    def pixels(self, points: np.ndarray, scale: float, centre) -> np.ndarray:
        """Points, m, shape (..., 2), in an image with `scale` pixels per metre and the motion at its `centre`."""
        return np.asarray(centre) + scale * (points - self._middle) * (1, -1)

    def patches(self, frame: int, scale: float, centre, *, outlines: bool = False) -> list[Patch]:
        """The polygons of a frame, back to front; convex solids as outlines if transparent, or all with `outlines`."""
        found, depths = [], []
        for solid, poses in zip(self.solids, self._poses, strict=True):
            pose = poses[min(frame, len(poses) - 1)]
            seen = (solid.corners @ pose[:3, :3].T + pose[:3, 3]) @ self.axes.T
            flat = self.pixels(seen[:, :2], scale, centre)
            if solid.convex and (outlines or solid.opacity < 1):
                found.append(Patch(_hull(flat), solid.color, solid.opacity, solid))
                depths.append([seen[:, 2].mean()])
                continue
            kept, light = _lit(seen[solid.faces], seen.mean(axis=0) if solid.convex else None)
            colors = solid.color * light[:, None]
            opacity = solid.opacity if solid.convex else 1.0
            found += [Patch(*each, opacity, solid) for each in zip(flat[solid.faces[kept]], colors, strict=True)]
            depths.append(seen[solid.faces[kept], 2].mean(axis=1))
        levels = np.repeat([solid.on_top for solid in self.solids], [len(each) for each in depths])
        return [found[k] for k in np.lexsort((np.concatenate([*depths, []]), levels))]


def _lit(quads, inside=None):
    """Which faces, (f, 4, 3), are visible, if a point `inside` of a convex solid is known; and how bright these are."""
    normals = np.cross(quads[:, 2] - quads[:, 0], quads[:, 3] - quads[:, 1])
    sizes = np.linalg.norm(normals, axis=1)
    kept = sizes > 0.0
    if inside is not None:
        outward = np.einsum("ij,ij->i", normals, quads.mean(axis=1) - inside)
        kept &= normals[:, 2] * np.sign(outward) > 0.0
    towards = normals[kept] / (sizes[kept] * np.where(normals[kept, 2] < 0.0, -1.0, 1.0))[:, None]
    return kept, DARK + (1 - DARK) * (towards @ LIGHT).clip(0.0, 1.0)


def _z_up(point):
    """The inverse of :func:`~pinconsist.view.commands.y_up`."""
    return [point[0], -point[2], point[1]]


def _pose(path, placed) -> np.ndarray:
    """Poses, (m, 4, 4), of a path; its parents, such as ``/a`` of ``/a/b``, may have poses, too."""
    found = np.eye(4)[None]
    for start in accumulate(path.strip("/").split("/"), "{}/{}".format):
        if (matrix := placed.get(f"/{start}")) is not None:
            found = found @ matrix
    return found


def _matrices(tracks) -> np.ndarray:
    """Poses, (m, 4, 4), of tracks of numbers."""
    values = {track["name"]: np.reshape(track["values"], (len(track["times"]), -1)) for track in tracks}
    found = np.tile(np.eye(4), (len(values[".position"]), 1, 1))
    found[:, :3, :3], found[:, :3, 3] = Rotation.from_quat(values[".quaternion"]).as_matrix(), values[".position"]
    if ".scale" in values:
        found[:, :3, :3] *= values[".scale"][:, None]
    return found


def _mesh(geometry) -> tuple[np.ndarray, np.ndarray]:
    """Corners and faces of one of the geometries of shapes.py."""
    kind = geometry["type"]
    if kind == "BufferGeometry":
        points = np.reshape(geometry["data"]["attributes"]["position"]["array"], (-1, 3))
        triangles = np.reshape(geometry["data"]["index"]["array"], (-1, 3))
        return points, triangles[:, [0, 1, 2, 2]]
    if kind == "BoxGeometry":
        half = np.array([geometry["width"], geometry["height"], geometry["depth"]]) / 2
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        faces = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
        return half * signs, np.array(faces)
    if kind == "TorusGeometry":
        around = np.linspace(0.0, geometry["arc"], 4 * ROUND)
        turn = np.linspace(0.0, 2 * np.pi, 8, endpoint=False)
        reach = geometry["radius"] + geometry["tube"] * np.cos(turn)
        ends = [reach * np.cos(around)[:, None], reach * np.sin(around)[:, None]]
        return _sheet(np.stack([*ends, np.tile(geometry["tube"] * np.sin(turn), (len(around), 1))], axis=-1))
    if kind == "SphereGeometry":
        angle = np.linspace(0.0, np.pi, ROUND // 2 + 1)
        profile = geometry["radius"] * np.column_stack((np.sin(angle), -np.cos(angle)))
    else:
        bottom, top, half = geometry["radiusBottom"], geometry["radiusTop"], geometry["height"] / 2
        share, end = np.linspace(0.0, 1.0, LONG + 1)[:, None], np.linspace(0.0, 1.0, CAP + 1)[:-1, None]
        low, high = np.array([bottom, -half]), np.array([top, half])
        profile = np.vstack(
            (low * [1, 0] * end + [0, -half], low + share * (high - low), high * [1, 0] * end[::-1] + [0, half])
        )
    turn = np.linspace(0.0, 2 * np.pi, ROUND, endpoint=False)
    circle = np.column_stack((np.cos(turn), np.ones(ROUND), np.sin(turn)))
    return _sheet(profile[:, None, [0, 1, 0]] * circle)


def _sheet(rings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners and faces between neighbouring rings of points, shape (m, n, 3)."""
    here = np.arange(rings.shape[0] * rings.shape[1]).reshape(rings.shape[:2])
    beside = np.roll(here, -1, axis=1)
    faces = np.stack((here[:-1], beside[:-1], beside[1:], here[1:]), axis=-1)
    return rings.reshape(-1, 3), faces.reshape(-1, 4)


def _hull(points: np.ndarray) -> np.ndarray:
    """The convex outline of points in a plane, shape (k, 2)."""
    try:
        return points[ConvexHull(points).vertices]
    except QhullError:  # they are seen as a line, or as a point
        return points
