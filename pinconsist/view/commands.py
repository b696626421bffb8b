"""meshcat's commands, as plain numbers and names."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from .shapes import Shape, buffer


@dataclass(frozen=True, eq=False)
class Node:
    """A thing of the scene that moves: where it is at every frame and, if that changes, how large."""

    path: str
    poses: np.ndarray  # (m, 7), position and quaternion x y z w
    scales: np.ndarray | None = None  # (m, 3), along its own axes


def drawn(path: str, shape: Shape) -> dict:
    """Draw a shape."""
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


def line(path: str, kind: str, points: np.ndarray, color: int) -> dict:
    """Draw a line through points, shape (k, 3), or between each two of them."""
    material = {"uuid": f"{path} material", "type": "LineBasicMaterial", "color": color}
    return _three(path, {"uuid": path, "type": kind}, buffer(points), material)


def _three(path, thing, geometry, material) -> dict:
    geometry = {**geometry, "uuid": f"{path} geometry"}
    thing = {**thing, "geometry": geometry["uuid"], "material": material["uuid"]}
    kind = {"version": 4.5, "type": "Object"}
    whole = {"metadata": kind, "geometries": [geometry], "materials": [material], "object": thing}
    return {"type": "set_object", "path": path, "object": whole}


def put(path: str, name: str, value) -> dict:
    """Set a property of the thing at a path."""
    return {"type": "set_property", "path": path, "property": name, "value": value}


def placed(path: str, offset: np.ndarray) -> dict:
    """Shift all that is drawn below a path."""
    return _transform(path, pin.SE3(np.eye(3), offset).homogeneous)


def at_start(node: Node) -> dict:
    """Put a node where it is at the first frame."""
    matrix = pin.XYZQUATToSE3(node.poses[0]).homogeneous
    return _transform(node.path, matrix if node.scales is None else matrix @ np.diag([*node.scales[0], 1.0]))


def _transform(path, matrix) -> dict:
    return {"type": "set_transform", "path": path, "matrix": matrix.T.ravel().tolist()}


def animation(nodes: list[Node], clock: np.ndarray, repetitions: int) -> dict:
    """Move the nodes; `clock` holds the frames' times, s, shape (m,)."""
    reach = max(np.abs(node.poses[:, :3]).max() for node in nodes)
    digits = 7 - int(np.floor(np.log10(reach or 1.0)))
    times, animations = clock.round(6).tolist(), []
    for node in nodes:
        parts = [
            (".position", "vector3", node.poses[:, :3].round(digits)),
            (".quaternion", "quaternion", node.poses[:, 3:].round(7)),
            *([(".scale", "vector3", node.scales.round(7))] if node.scales is not None else []),
        ]
        tracks = [{"name": name, "type": kind, "times": times, "values": x.ravel().tolist()} for name, kind, x in parts]
        animations.append({"path": node.path, "clip": {"name": "default", "fps": 1, "tracks": tracks}})
    options = {"play": True, "repetitions": repetitions}
    return {"type": "set_animation", "path": "", "animations": animations, "options": options}
