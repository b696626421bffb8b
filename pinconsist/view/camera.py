"""From where a scene is seen: camera, light, background and floor."""

from __future__ import annotations

import numpy as np

from .commands import line, put

FIELD_OF_VIEW = 40.0  # degrees, vertical
ASPECT = 1.3  # width to height of the narrowest pane that the camera is fitted to; the page steps back in others
FLOOR = 0xC4CAD2


def plane_normal(bones: np.ndarray) -> np.ndarray | None:
    """Normal, towards the viewer, of the plane along which all points, shape (n, k, 3), move; None if there is none.

    The points may lie in different parallel planes. A scene at rest, or that moves along a line, is planar if all
    its points lie in one plane.
    """
    steps = (bones - bones.mean(axis=0)).reshape(-1, 3)
    places = (bones - bones.mean(axis=(0, 1))).reshape(-1, 3)
    scale = np.linalg.norm(places, axis=1).max()
    for spread, least in ((steps, 1e-9 * scale), (places, 0.0)):
        _, widths, directions = np.linalg.svd(spread, full_matrices=False)
        if len(widths) == 3 and widths[0] > least and widths[1] > 1e-3 * widths[0]:
            if widths[2] > 1e-4 * widths[1]:
                return None
            normal = directions[2]
            return normal * np.sign(normal @ [1.0, -2.0, 4.0])  # so that x, else y, points right and z, else y, up
    return None


def view_axes(normal: np.ndarray | None) -> np.ndarray:
    """The viewer's right, up and towards-the-viewer directions as rows, for motion in a plane or, None, in space."""
    back = np.array([1.3, -0.68, 0.75]) if normal is None else normal  # beside the arms of threefold robots
    back = back / np.linalg.norm(back)
    right = np.array([-back[1], back[0], 0.0]) if np.hypot(*back[:2]) > 1e-6 else np.array([1.0, 0.0, 0.0])
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(back, right), back])


def camera(cloud: np.ndarray, axes: np.ndarray, size: float) -> tuple[list[dict], list[float]]:
    """Camera and light that show a cloud of points, shape (k, 3), as a whole; and where the camera looks."""
    right, up, back = axes
    seen = cloud @ axes.T
    middle, half = (seen.max(0) + seen.min(0)) / 2, np.ptp(seen, axis=0) / 2
    margin = 1.2
    distance = half[2] + margin * max(half[1], half[0] / ASPECT, 0.05 * size) / np.tan(np.radians(FIELD_OF_VIEW) / 2)
    target = middle @ axes
    lens, fill = "/Cameras/default/rotated/<object>", "/Lights/FillLight/<object>"
    out = [
        put(lens, "fov", FIELD_OF_VIEW),
        put(lens, "near", distance / 1000),
        put(lens, "far", distance * 100),
        put(lens, "position", y_up(target + distance * back)),
        put(fill, "position", (back + 0.6 * up - 0.5 * right).tolist()),
        put(fill, "intensity", 0.6),
    ]
    return out, y_up(target)


def y_up(point) -> list[float]:
    """A point of the scene in the axes of three.js's own world, into which meshcat turns the scene."""
    x, y, z = map(float, point)
    return [x, z, -y]


def surroundings(size: float) -> list[dict]:
    return [
        put("/Lights/PointLightNegativeX", "visible", False),  # these two stand at fixed places and reach 10 m
        put("/Lights/PointLightPositiveX", "visible", False),
        put("/Background", "top_color", [0.98, 0.985, 0.99]),
        put("/Background", "bottom_color", [0.86, 0.885, 0.91]),
        put("/Axes", "scale", [0.2 * size] * 3),
        put("/Grid", "visible", False),  # of fixed size, and seen edge-on in planar scenes
    ]


def floor(cloud: np.ndarray, size: float) -> dict:
    low, high = cloud.min(0), cloud.max(0)
    cell = 10.0 ** np.round(np.log10(size / 5))
    x0, y0 = np.floor(low[:2] / cell) - 2
    x1, y1 = np.ceil(high[:2] / cell) + 2
    along_y = [[(x * cell, y0 * cell), (x * cell, y1 * cell)] for x in np.arange(x0, x1 + 1)]
    along_x = [[(x0 * cell, y * cell), (x1 * cell, y * cell)] for y in np.arange(y0, y1 + 1)]
    ends = np.array(along_y + along_x).reshape(-1, 2)
    return line("/floor", "LineSegments", np.column_stack((ends, np.full(len(ends), low[2]))), FLOOR)
