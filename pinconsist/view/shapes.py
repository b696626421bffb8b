"""Simple shapes made from joints and loops, for scenes that bring none: what is drawn is what the model knows."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin

from ..mechanism.constraints.loop import Loop
from ..mechanism.mechanism import Mechanism
from .motion import anchors, bar_poses, in_world, turn_from_y

LINK_COLORS = (0x0072B2, 0xE69F00, 0x009E73, 0x56B4E9, 0xCC79A7, 0xB8A800)  # Okabe and Ito's, without red
JOINT, GROUND, RAIL, CLOSED = 0x333333, 0x555555, 0xA0A4AA, 0xD50000
SHELL, BALL = 2.2, 1.45  # radii of an anchor 1 and of a joint, in radii of a link


@dataclass(frozen=True)
class Shape:
    """One shape on one node: the ground 0, a joint, or, from ``njoints`` on, a bar that stands for a distance loop."""

    node: int
    geometry: dict  # as three.js reads it
    placement: pin.SE3 = field(default_factory=pin.SE3.Identity)
    bounds: np.ndarray = field(default_factory=lambda: np.zeros((1, 3)))  # enclose it, in the axes of `placement`
    color: int = RAIL
    opacity: float = 1.0
    on_top: bool = False  # drawn over everything, so that no mesh hides it

    @property
    def points(self) -> np.ndarray:
        """Points that enclose the shape, in the axes of its node, shape (k, 3)."""
        return self.bounds @ self.placement.rotation.T + self.placement.translation


def ball(node: int, centre, radius: float, **look) -> Shape:
    """A sphere on a node."""
    form = {"type": "SphereGeometry", "radius": radius, "widthSegments": 24, "heightSegments": 16}
    bounds = radius * np.vstack((np.eye(3), -np.eye(3)))
    return Shape(node, form, pin.SE3(np.eye(3), np.array(centre)), bounds, **look)


def cylinder(node: int, start, end, radius: float, **look) -> Shape:
    """A cylinder between two points of a node."""
    along = np.asarray(end) - np.asarray(start)
    length = float(np.linalg.norm(along))
    form = {"type": "CylinderGeometry", "radiusTop": radius, "radiusBottom": radius, "height": length}
    middle = pin.SE3(turn_from_y(along).matrix(), (np.asarray(start) + np.asarray(end)) / 2)
    half = np.array([radius, length / 2, radius])
    bounds = half * np.array([[1, 1, 1], [-1, 1, -1], [1, -1, 1], [-1, -1, -1]])
    return Shape(node, {**form, "radialSegments": 24}, middle, bounds, **look)


def block(node: int, centre, along, length: float, width: float, **look) -> Shape:
    """A box of square section on a node, its length in a direction."""
    form = {"type": "BoxGeometry", "width": width, "height": length, "depth": width}
    corner = np.array([[width, length, width], [-width, -length, -width]]) / 2
    place = pin.SE3(turn_from_y(np.asarray(along, float)).matrix(), np.array(centre, float))
    return Shape(node, form, place, corner, **look)


def ring(node: int, arc: float, tube: float, **look) -> Shape:
    """A part of a ring of radius 1 about a node's z axis, from its x axis on; `arc` in rad."""
    form = {"type": "TorusGeometry", "radius": 1.0, "tube": tube, "arc": arc, "radialSegments": 10}
    reach = (1 + tube) * np.array([[1, 1, 0], [-1, 1, 0], [1, -1, 0], [-1, -1, 0]])
    return Shape(node, {**form, "tubularSegments": 48}, bounds=reach, **look)


def buffer(points: np.ndarray, index: np.ndarray | None = None) -> dict:
    """Points, shape (k, 3), and optionally triangles, shape (m, 3), as three.js reads them."""
    data = {"attributes": {"position": _array(points, "Float32Array", 3)}}
    if index is not None:
        data["index"] = _array(index, "Uint32Array", 1)
    return {"type": "BufferGeometry", "data": data}


def _array(values, kind, size):
    flat = np.asarray(values).ravel()
    if kind.startswith("Float"):  # seven digits are all that arrives
        flat = [float(f"{value:.7g}") for value in flat]
    return {"itemSize": size, "type": kind, "array": list(map(int, flat)) if kind.startswith("Uint") else flat}


def link_ends(mech: Mechanism) -> dict[int, list[np.ndarray]]:
    """For each joint the points of its body to which a link is drawn from the joint's origin.

    Origins of the joints it carries, anchors of loops, and for a bare leaf the end of a rod with its inertia.
    """
    model = mech.model
    ends = {joint: [] for joint in range(1, model.njoints)}
    for joint in ends:
        if model.parents[joint]:
            ends[model.parents[joint]].append(model.jointPlacements[joint].translation.copy())
    for loop in mech.anchored_loops:
        for joint, place in anchors(model, loop):
            if joint:
                ends[joint].append(place.translation.copy())
    for joint, inertia in zip(ends, list(model.inertias)[1:], strict=True):
        if not ends[joint] and inertia.mass > 0:
            ends[joint].append(_rod_end(inertia))
    return ends


def _rod_end(inertia: pin.Inertia) -> np.ndarray:
    """Centre of mass, and beyond it by half a uniform rod of this inertia, at most twice as far."""
    reach = np.linalg.norm(inertia.lever)
    half = np.sqrt(3 * np.linalg.eigvalsh(inertia.inertia)[-1] / inertia.mass)
    return inertia.lever * (1 + min(half / reach, 1.0)) if reach > 0 else inertia.lever.copy()


def skeleton(mech: Mechanism, poses: np.ndarray) -> np.ndarray:
    """World positions over the motion of joints, link ends and anchors, shape (n, k, 3)."""
    ends = link_ends(mech)
    parts = [in_world(poses[:, joint], [np.zeros(3), *ends[joint]]) for joint in ends]
    for loop in mech.anchored_loops:
        parts += [in_world(poses[:, joint], [place.translation]) for joint, place in anchors(mech.model, loop)]
    return np.concatenate(parts, axis=1) if parts else np.zeros((len(poses), 1, 3))


def bars(mech: Mechanism, poses: np.ndarray) -> list[np.ndarray]:
    """Poses, shape (n, 7) each, of the bars that stand for the distance loops."""
    out = []
    for loop in mech.anchored_loops:
        if loop.kind == "distance":
            start, end = (in_world(poses[:, j], [place.translation])[:, 0] for j, place in anchors(mech.model, loop))
            out.append(bar_poses(start, end))
    return out


def simple_shapes(mech: Mechanism, poses: np.ndarray, size: float, covered=frozenset()) -> list[Shape]:
    """Links, joints, ground and rails of every body that is not in `covered`; anchors of all loops.

    Parameters
    ----------
    mech : Mechanism
        The scene.
    poses : ndarray, shape (n, njoints, 7)
        Its motion; rails of sliding joints are as long as the way that they go.
    size : float
        Size of the scene, m, from which thicknesses are taken.
    covered : set of int
        Joints whose bodies have shapes of their own; 0 is the ground.

    Returns
    -------
    list of Shape
    """
    radius = 0.011 * size
    out, fixed = [], []
    for joint, ends in link_ends(mech).items():
        parent, rail = mech.model.parents[joint], _rail(mech, joint, poses, size)
        slides = slide_axis(mech, joint)
        if parent == 0 and 0 not in covered and rail is not None and slides is None:
            fixed.append(rail.mean(0))
        if joint in covered:
            continue
        out += _body(joint, ends, slides, radius)
        if rail is not None and np.linalg.norm(rail[1] - rail[0]) > radius / 2:
            out.append(cylinder(parent, *rail, 0.45 * radius, color=RAIL))
    fixed += [place.translation for loop in mech.anchored_loops for j, place in anchors(mech.model, loop) if j == 0]
    if 0 not in covered:
        out += _ground(fixed, radius)
    return out + _closures(mech, poses, radius)


def slide_axis(mech: Mechanism, joint: int) -> np.ndarray | None:
    """The direction, shape (3,), in which a joint slides on its parent's body; None for others."""
    if mech.model.nvs[joint] != 1:
        return None
    slides, turns = np.reshape(mech.model.createData().joints[joint].S, (2, 3))
    return None if turns.any() else slides


def _body(joint: int, ends, slides: np.ndarray | None, radius: float) -> list[Shape]:
    """Links from the joint's origin, which is a ball, or, of a sliding body, a block of its color."""
    color = LINK_COLORS[(joint - 1) % len(LINK_COLORS)]
    if slides is None:
        out = [ball(joint, np.zeros(3), BALL * radius, color=JOINT)]
    else:
        out = [block(joint, np.zeros(3), slides, 7 * radius, 4 * radius, color=color)]
    for end in ends:
        if np.linalg.norm(end) > radius / 10:
            out += [cylinder(joint, np.zeros(3), end, radius, color=color), ball(joint, end, radius, color=color)]
    return out


def _rail(mech: Mechanism, joint: int, poses: np.ndarray, size: float) -> np.ndarray | None:
    """The straight way, shape (2, 3), of a joint's origin on its parent's body; one point twice if it rests."""
    home = mech.model.jointPlacements[joint].translation.copy()
    parent, child = poses[:, mech.model.parents[joint]], poses[:, joint]
    turn_back = np.column_stack((np.zeros((len(poses), 3)), -parent[:, 3:6], parent[:, 6]))
    way = np.vstack((np.zeros(3), in_world(turn_back, (child - parent)[:, None, :3])[:, 0] - home))
    if np.linalg.norm(way, axis=1).max() < 1e-9 * size:
        return np.array([home, home])
    direction = np.linalg.svd(way, full_matrices=False)[2][0]
    along = way @ direction
    astray = np.linalg.norm(way - np.outer(along, direction), axis=1).max()
    if mech.model.nvs[joint] > 1 or astray > 1e-6 * np.ptp(along):
        return None
    return home + np.outer([along.min(), along.max()], direction)


def _ground(points, radius: float) -> list[Shape]:
    """A block at every fixed point, and thin bars between them: the frame that stands still."""
    places = np.unique(np.round(points, 12), axis=0) if len(points) else np.zeros((0, 3))
    side = 3.2 * radius
    blocks = [block(0, place, (0, 1, 0), side, side, color=GROUND, opacity=0.5) for place in places]
    if len(places) < 2:
        return blocks
    middle = places.mean(0)
    pairs = [tuple(places)] if len(places) == 2 else [(middle, place) for place in places]
    return blocks + [cylinder(0, *pair, 0.45 * radius, color=RAIL) for pair in pairs]


def _closures(mech: Mechanism, poses: np.ndarray, radius: float) -> list[Shape]:
    """Anchor 1 as a clear shell, anchor 2 as a red core: closed is a core inside its shell, on its rail or plate."""
    out, bar = [], mech.model.njoints
    for loop in mech.anchored_loops:
        (joint1, place1), (joint2, place2) = anchors(mech.model, loop)
        shell = ball(joint1, place1.translation, SHELL * radius, color=CLOSED, opacity=0.35)
        core = ball(joint2, place2.translation, 0.55 * SHELL * radius, color=CLOSED)
        guide = _guide(loop, poses, (joint1, place1), (joint2, place2), radius)
        out += [replace(shape, on_top=True) for shape in (shell, core, *guide)]
        if loop.kind == "distance":
            half = np.array([0.0, loop.length / 2, 0.0])
            out.append(cylinder(bar, -half, half, 0.6 * radius, color=JOINT))
            bar += 1
    return out


def _guide(loop: Loop, poses: np.ndarray, first, second, radius: float) -> list[Shape]:
    """Along what anchor 2 may move on body 1: the rail of a slider or cylinder, the plate of a plane."""
    if loop.kind not in ("slider", "cylinder", "plane"):
        return []
    (joint1, place1), (joint2, place2) = first, second
    axis = place1.rotation @ (np.array(loop.axis) / np.linalg.norm(loop.axis))
    start, end = (in_world(poses[:, joint1], [place1.translation + shift])[:, 0] for shift in (np.zeros(3), axis))
    away = in_world(poses[:, joint2], [place2.translation])[:, 0] - start
    along = np.einsum("ij,ij->i", away, end - start)
    if loop.kind == "plane":
        reach = np.linalg.norm(away - along[:, None] * (end - start), axis=1).max() + SHELL * radius
        ends = [place1.translation + shift * radius * axis for shift in (-0.1, 0.1)]
        return [cylinder(joint1, *ends, reach, color=CLOSED, opacity=0.2)]
    low, high = min(along.min(), 0.0) - SHELL * radius, max(along.max(), 0.0) + SHELL * radius
    ends = [place1.translation + way * axis for way in (low, high)]
    return [cylinder(joint1, *ends, 0.3 * radius, color=CLOSED)]
