"""A replay as meshcat's commands: shapes, camera, light and animation, as plain numbers and names."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ..errors import InputError
from ..mechanism.mechanism import Mechanism
from .motion import body_poses, in_world, resample
from .shapes import Shape, bars, buffer, simple_shapes, skeleton

FIELD_OF_VIEW = 40.0  # degrees, vertical
ASPECT = 1.3  # width to height of the narrowest pane that the camera is fitted to; the page steps back in others
TRACE, FLOOR = 0xD50000, 0xC4CAD2


def scene(mech: Mechanism, sol, *, speed: float, fps: float, traces, repetitions: int) -> dict:
    """The replay: meshcat's ``commands`` in their order, and the ``target`` of the camera in axes with y up."""
    from .visuals import visuals  # and with it coal, only when something is shown

    unknown = [name for name in traces if not mech.model.existFrame(name)]
    if unknown:
        raise InputError(f"{mech.name}: no frame {unknown[0]!r} to trace")
    clock, q = resample(mech, sol, speed, fps)
    bodies = body_poses(mech.model, q)
    skin, bones = visuals(mech), skeleton(mech, bodies)
    size = float(np.linalg.norm(np.ptp(bones.reshape(-1, 3), axis=0))) or 1.0
    shapes = skin + simple_shapes(mech, bodies, size, {shape.node for shape in skin})
    poses = np.concatenate([bodies, *(bar[:, None] for bar in bars(mech, bodies))], axis=1)
    lines = {name: _path(mech, name, bodies) for name in traces}

    some = np.unique(np.linspace(0, len(q) - 1, 100).astype(int))
    cloud = [in_world(poses[some, shape.node], shape.points) for shape in shapes]
    cloud = np.concatenate([points.reshape(-1, 3) for points in (bones[some], *cloud)])
    normal = plane_normal(bones)
    camera, target = _camera(cloud, normal, size)
    nodes = node_paths(mech)
    out = [_object(f"{nodes[shape.node]}/{k}", shape) for k, shape in enumerate(shapes)]
    out += [_line(f"/traces/{_part(name)}", "Line", points, TRACE) for name, points in lines.items()]
    out += [*_surroundings(size), *camera, *([_floor(cloud, size)] if normal is None else [])]
    out += [_placed(path, pose) for path, pose in zip(nodes[1:], poses[0, 1:], strict=True)]
    if len(clock) > 1:
        out.append(_animation(nodes, clock, poses, repetitions))
    return {"commands": out, "target": target}


def node_paths(mech: Mechanism) -> list[str]:
    """Path in the viewer of the ground, of each joint's body and of each bar of a distance loop."""
    joints = [f"/bodies/{_part(name)}" for name in mech.joints]
    bars = [f"/loops/{_part(loop.name)}" for loop in mech.anchored_loops if loop.kind == "distance"]
    return ["/ground", *joints, *bars]


def _part(name: str) -> str:
    return name.replace("/", "∕") or "unnamed"  # a slash would split the path


def _path(mech, name, bodies) -> np.ndarray:
    frame = mech.model.frames[mech.model.getFrameId(name)]
    return in_world(bodies[:, frame.parentJoint], [frame.placement.translation])[:, 0]


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


def _camera(cloud: np.ndarray, normal, size: float) -> tuple[list[dict], list[float]]:
    """Camera and light that show a cloud of points, shape (k, 3), as a whole; and where the camera looks."""
    back = np.array([0.9, -1.2, 0.7]) if normal is None else normal
    back = back / np.linalg.norm(back)
    right = np.array([-back[1], back[0], 0.0]) if np.hypot(*back[:2]) > 1e-6 else np.array([1.0, 0.0, 0.0])
    right /= np.linalg.norm(right)
    axes = np.array([right, np.cross(back, right), back])
    seen = cloud @ axes.T
    middle, half = (seen.max(0) + seen.min(0)) / 2, np.ptp(seen, axis=0) / 2
    margin = 1.2
    distance = half[2] + margin * max(half[1], half[0] / ASPECT, 0.05 * size) / np.tan(np.radians(FIELD_OF_VIEW) / 2)
    target = middle @ axes
    lens, fill = "/Cameras/default/rotated/<object>", "/Lights/FillLight/<object>"
    out = [
        _set(lens, "fov", FIELD_OF_VIEW),
        _set(lens, "near", distance / 1000),
        _set(lens, "far", distance * 100),
        _set(lens, "position", _y_up(target + distance * back)),
        _set(fill, "position", (back + 0.6 * axes[1] - 0.5 * right).tolist()),
        _set(fill, "intensity", 0.6),
    ]
    return out, _y_up(target)


def _y_up(point) -> list[float]:
    x, y, z = map(float, point)
    return [x, z, -y]


def _surroundings(size: float) -> list[dict]:
    return [
        _set("/Lights/PointLightNegativeX", "visible", False),  # these two stand at fixed places and reach 10 m
        _set("/Lights/PointLightPositiveX", "visible", False),
        _set("/Background", "top_color", [0.98, 0.985, 0.99]),
        _set("/Background", "bottom_color", [0.86, 0.885, 0.91]),
        _set("/Axes", "scale", [0.2 * size] * 3),
        _set("/Grid", "visible", False),  # of fixed size, and seen edge-on in planar scenes
    ]


def _floor(cloud: np.ndarray, size: float) -> dict:
    low, high = cloud.min(0), cloud.max(0)
    cell = 10.0 ** np.round(np.log10(size / 5))
    x0, y0 = np.floor(low[:2] / cell) - 2
    x1, y1 = np.ceil(high[:2] / cell) + 2
    along_y = [[(x * cell, y0 * cell), (x * cell, y1 * cell)] for x in np.arange(x0, x1 + 1)]
    along_x = [[(x0 * cell, y * cell), (x1 * cell, y * cell)] for y in np.arange(y0, y1 + 1)]
    ends = np.array(along_y + along_x).reshape(-1, 2)
    return _line("/floor", "LineSegments", np.column_stack((ends, np.full(len(ends), low[2]))), FLOOR)


def _object(path: str, shape: Shape) -> dict:
    material = {
        "uuid": f"{path} material",
        "type": "MeshPhongMaterial",
        "color": shape.color,
        "shininess": 20,
        "flatShading": "data" in shape.geometry,  # a mesh shares corners between faces that meet at an edge
        "side": 2,
        "opacity": shape.opacity,
        "transparent": shape.opacity < 1,
        "depthTest": not shape.on_top,
    }
    matrix = shape.placement.homogeneous.T.ravel().tolist()
    thing = {"uuid": path, "type": "Mesh", "matrix": matrix, "renderOrder": int(shape.on_top)}
    return _three(path, thing, shape.geometry, material)


def _line(path: str, kind: str, points: np.ndarray, color: int) -> dict:
    material = {"uuid": f"{path} material", "type": "LineBasicMaterial", "color": color}
    return _three(path, {"uuid": path, "type": kind}, buffer(points), material)


def _three(path, thing, geometry, material) -> dict:
    geometry = {**geometry, "uuid": f"{path} geometry"}
    thing = {**thing, "geometry": geometry["uuid"], "material": material["uuid"]}
    kind = {"version": 4.5, "type": "Object"}
    whole = {"metadata": kind, "geometries": [geometry], "materials": [material], "object": thing}
    return {"type": "set_object", "path": path, "object": whole}


def _set(path: str, name: str, value) -> dict:
    return {"type": "set_property", "path": path, "property": name, "value": value}


def _placed(path: str, pose) -> dict:
    matrix = pin.XYZQUATToSE3(np.array(pose)).homogeneous.T.ravel().tolist()
    return {"type": "set_transform", "path": path, "matrix": matrix}


def _animation(nodes, clock, poses, repetitions) -> dict:
    digits = 7 - int(np.floor(np.log10(np.abs(poses[..., :3]).max() or 1.0)))
    times, places, turns = clock.round(6).tolist(), poses[..., :3].round(digits), poses[..., 3:].round(7)
    animations = []
    for node, path in enumerate(nodes):
        if node == 0:
            continue
        tracks = [
            {"name": ".position", "type": "vector3", "times": times, "values": places[:, node].ravel().tolist()},
            {"name": ".quaternion", "type": "quaternion", "times": times, "values": turns[:, node].ravel().tolist()},
        ]
        animations.append({"path": path, "clip": {"name": "default", "fps": 1, "tracks": tracks}})
    options = {"play": True, "repetitions": repetitions}
    return {"type": "set_animation", "path": "", "animations": animations, "options": options}
