"""meshcat's commands, as plain numbers and names: shapes and lines, their motion, light and floor; the viewpoint."""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from .shapes import Shape, buffer

DIRECTIONS = np.indices((5, 5, 5)).reshape(3, -1) - 2.0
FLOOR = 0xC4CAD2


@dataclass(frozen=True, eq=False)
class Node:
    """A part of the picture that moves: its pose at every frame and, if that changes, its size."""

    path: str
    poses: np.ndarray  # (m, 7), position and quaternion x y z w
    scales: np.ndarray | None = None  # (m, 3), along its own axes


def draw(path: str, shape: Shape, **about) -> dict:
    """Draw a shape; `about` is stored with it for the page: the part that it belongs to, and its name."""
    mesh = "data" in shape.geometry  # it may be open, and its faces share corners
    look = {"type": "MeshPhongMaterial", "flatShading": True, "shininess": 20, "side": 2}
    material = {"uuid": f"{path} material", "color": shape.color} | (look if mesh else {"type": "MeshLambertMaterial"})
    material |= {"opacity": shape.opacity, "transparent": shape.opacity < 1, "depthTest": not shape.on_top}
    matrix = shape.placement.homogeneous.T.ravel().tolist()
    thing = {"uuid": path, "type": "Mesh", "matrix": matrix, "renderOrder": shape.on_top, "userData": about}
    return _set_object(path, thing, shape.geometry, material)


def line(path: str, kind: str, points: np.ndarray, color: int, part: str) -> dict:
    """Draw a line through points, shape (k, 3), or separate lines between pairs of them."""
    material = {"uuid": f"{path} material", "type": "LineBasicMaterial", "color": color}
    return _set_object(path, {"uuid": path, "type": kind, "userData": {"part": part}}, buffer(points), material)


def _set_object(path, thing, geometry, material) -> dict:
    geometry = {**geometry, "uuid": f"{path} geometry"}
    thing = {**thing, "geometry": geometry["uuid"], "material": material["uuid"]}
    kind = {"version": 4.5, "type": "Object"}
    whole = {"metadata": kind, "geometries": [geometry], "materials": [material], "object": thing}
    return {"type": "set_object", "path": path, "object": whole}


def put(path: str, name: str, value) -> dict:
    return {"type": "set_property", "path": path, "property": name, "value": value}


def transform(path: str, matrix: np.ndarray) -> dict:
    """Set the pose of everything drawn below a path to a matrix of shape (4, 4)."""
    return {"type": "set_transform", "path": path, "matrix": matrix.T.ravel().tolist()}


def animated(nodes: list[Node], clock: np.ndarray) -> list[dict]:
    """Show the nodes as in the first frame, then move them; `clock` has the times of the frames, s, shape (m,)."""
    reach = max((np.abs(node.poses[:, :3]).max() for node in nodes), default=0.0)
    digits = 7 - int(np.floor(np.log10(reach or 1.0)))
    times, commands, animations = clock.round(6).tolist(), [], []
    for node in nodes:
        parts = [
            (".position", "vector3", node.poses[:, :3].round(digits)),
            (".quaternion", "quaternion", node.poses[:, 3:].round(7)),
        ]
        start = pin.XYZQUATToSE3(node.poses[0]).homogeneous
        if node.scales is not None:
            parts.append((".scale", "vector3", node.scales.round(7)))
            start = start @ np.diag([*node.scales[0], 1.0])
        tracks = [{"name": name, "type": kind, "times": times, "values": x.ravel().tolist()} for name, kind, x in parts]
        animations.append({"path": node.path, "clip": {"name": "default", "fps": 1, "tracks": tracks}})
        commands.append(transform(node.path, start))
    if len(clock) > 1:
        commands.append({"type": "set_animation", "path": "", "animations": animations, "options": {"play": False}})
    return commands


def y_up(point) -> list[float]:
    """A point in the world axes of three.js, to which meshcat rotates the picture."""
    x, y, z = map(float, point)
    return [x, z, -y]


def plane_normal(points: np.ndarray) -> np.ndarray | None:
    """Normal, towards the viewer, of the plane along which all points, shape (n, k, 3), move; None if there is none.

    The points may lie in different parallel planes. A mechanism at rest, or that moves along a line, is planar if all
    its points lie in one plane.
    """
    steps = (points - points.mean(axis=0)).reshape(-1, 3)
    places = (points - points.mean(axis=(0, 1))).reshape(-1, 3)
    scale = np.linalg.norm(places, axis=1).max()
    for spread, least in ((steps, 1e-9 * scale), (places, 0.0)):
        _, widths, directions = np.linalg.svd(spread, full_matrices=False)
        if len(widths) == 3 and widths[0] > least and widths[1] > 1e-3 * widths[0]:
            if widths[2] > 1e-4 * widths[1]:
                return None
            normal = directions[2]
            return normal * np.sign(normal @ [1.0, -2.0, 4.0])  # so that x, else y, points right and z, else y, up
    return None


def view_axes(skeletons) -> tuple[np.ndarray, bool]:
    """The viewer's right, up and towards-the-viewer directions as rows; and whether all move in parallel planes."""
    normal, *others = map(plane_normal, skeletons)
    planar = normal is not None and all(each is not None and abs(each @ normal) > 1 - 1e-6 for each in others)
    back = normal if planar else np.array([1.3, -0.68, 0.75])  # not parallel to an arm of a robot with three arms
    back = back / np.linalg.norm(back)
    right = np.array([-back[1], back[0], 0.0]) if np.hypot(*back[:2]) > 1e-6 else np.array([1.0, 0.0, 0.0])
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(back, right), back]), planar


def stage(axes: np.ndarray, size: float) -> list[dict]:
    """Light for a viewer's axes, and no background."""
    right, up, back = axes
    fill = "/Lights/FillLight/<object>"
    return [
        put("/Lights/PointLightNegativeX", "visible", False),  # these two have fixed positions and reach 10 m
        put("/Lights/PointLightPositiveX", "visible", False),
        put("/Background", "visible", False),  # that of the page is free; this one is slow in software
        put("/Axes", "scale", [0.2 * size] * 3),
        put("/Grid", "visible", False),  # its size is fixed, and in planar pictures it is seen edge-on
        put(fill, "position", (back + 0.6 * up - 0.5 * right).tolist()),
        put(fill, "intensity", 0.6),
    ]


def outline(points: np.ndarray, axes: np.ndarray) -> list[list[float]]:
    """The points, of shape (k, 3), that are outermost in any direction; the page fits its camera to them."""
    farthest = np.unique(np.argmax(points @ axes.T @ DIRECTIONS, axis=0))
    return [y_up(point) for point in points[farthest]]


def floor(points: np.ndarray, size: float) -> dict:
    """A grid below all points, shape (k, 3)."""
    low, high = points.min(0), points.max(0)
    cell = 10.0 ** np.round(np.log10(size / 5))
    x0, y0 = np.floor(low[:2] / cell) - 2
    x1, y1 = np.ceil(high[:2] / cell) + 2
    along_y = [[(x * cell, y0 * cell), (x * cell, y1 * cell)] for x in np.arange(x0, x1 + 1)]
    along_x = [[(x0 * cell, y * cell), (x1 * cell, y * cell)] for y in np.arange(y0, y1 + 1)]
    ends = np.array(along_y + along_x).reshape(-1, 2)
    return line("/floor", "LineSegments", np.column_stack((ends, np.full(len(ends), low[2]))), FLOOR, "ground")
