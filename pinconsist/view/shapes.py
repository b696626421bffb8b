"""Shapes as three.js reads them, and simple ones made from joints, loops and springs of the model."""

from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin

from ..mechanism.forces import SpringDamper
from ..mechanism.loops import LOOP_KINDS, Loop
from ..mechanism.mechanism import Mechanism
from .motion import anchors, bar_poses, force_points, in_world, joint_axis, point_in_world, rotation_to

LINK_COLORS = (0x0072B2, 0xE69F00, 0x009E73, 0x56B4E9, 0xCC79A7, 0xB8A800)  # Okabe and Ito's, without red
JOINT, GROUND, RAIL, LOOP, SPRING = 0x333333, 0x555555, 0xA0A4AA, 0xD50000, 0x5D4037
LINK = 0.011  # radius of a link, relative to the size of the picture
ROD, BARREL = 0xC2C8CE, 0.7  # colour of the rod of a cylinder; length of its barrel, relative to the shortest cylinder
SHELL, CORE, BALL = 2.2, 0.9, 1.45  # radii of anchors 1 and 2 and of a joint, relative to that of a link
THIN = 0.3  # radius of a bar in shapes that are thinner than it, relative to that of a link: a pixel on a phone
TURNS, STRAIGHT = 9, 0.12  # number of turns of a coil; share of its length that is straight, at each end
COIL, WIRE = 0.018, 0.003  # radius of a coil and of its wire, relative to the size of the picture
SEGMENTS, SIDES = 16, 6  # segments of a turn, and sides of the cross-section of the wire
MEETING = 1e-3  # relative to the scene: bodies this close meet at a joint or a loop
SMALLEST = 1e-5  # smallest scale; three.js cannot invert a transformation with scale 0
OCTAHEDRON = np.vstack((np.eye(3), -np.eye(3)))


@dataclass(frozen=True)
class Shape:
    """One shape on one node: the ground 0, a joint, or, from ``njoints`` on, a bar that represents a distance loop."""

    node: int
    geometry: dict  # as three.js reads it
    placement: pin.SE3 = field(default_factory=pin.SE3.Identity)
    bounds: np.ndarray = field(default_factory=lambda: np.zeros((1, 3)))  # enclosing points, in the axes of `placement`
    color: int = RAIL
    opacity: float = 1.0
    on_top: int = 0  # drawn over everything with a lower number, so that no mesh hides it
    loop: str = ""  # the loop that it represents

    @property
    def points(self) -> np.ndarray:
        """Points that enclose the shape, in the axes of its node, shape (k, 3)."""
        return self.bounds @ self.placement.rotation.T + self.placement.translation


def ball(node: int, centre, radius: float, **look) -> Shape:
    """A sphere on a node."""
    form = {"type": "SphereGeometry", "radius": radius, "widthSegments": 16, "heightSegments": 10}
    return Shape(node, form, pin.SE3(np.eye(3), np.array(centre)), radius * OCTAHEDRON, **look)


def cylinder(node: int, start, end, radius: float, *, tip: float | None = None, **look) -> Shape:
    """A cylinder between two points of a node; a cone if the radius at its end, `tip`, is 0."""
    along = np.asarray(end) - np.asarray(start)
    length, top = float(np.linalg.norm(along)), radius if tip is None else tip
    form = {"type": "CylinderGeometry", "radiusTop": top, "radiusBottom": radius, "height": length}
    middle = pin.SE3(rotation_to(along).matrix(), (np.asarray(start) + np.asarray(end)) / 2)
    bounds = np.array([radius, length / 2, radius]) * [[1, 1, 1], [-1, 1, -1], [1, -1, 1], [-1, -1, -1]]
    return Shape(node, {**form, "radialSegments": 16 if radius < length else 32}, middle, bounds, **look)


def block(node: int, centre, along, length: float, width: float, **look) -> Shape:
    """A box of square section on a node, its length in a direction."""
    form = {"type": "BoxGeometry", "width": width, "height": length, "depth": width}
    half = np.array([width, length, width]) / 2
    return Shape(node, form, pin.SE3(rotation_to(along).matrix(), np.array(centre)), np.array([half, -half]), **look)


def ring(node: int, arc: float, tube: float, **look) -> Shape:
    """A part of a ring of radius 1 about a node's z axis, from its x axis on; `arc` in rad."""
    form = {"type": "TorusGeometry", "radius": 1.0, "tube": tube, "arc": arc, "radialSegments": 8}
    bounds = (1 + tube) * np.array([[1, 1, 0], [-1, 1, 0], [1, -1, 0], [-1, -1, 0]])
    return Shape(node, {**form, "tubularSegments": 36}, bounds=bounds, **look)


def buffer(points: np.ndarray, triangles: np.ndarray | None = None) -> dict:
    """Points, shape (k, 3), and optionally triangles, shape (m, 3), as three.js reads them."""
    numbers = [float(f"{value:.7g}") for value in points.ravel()]  # the page keeps only seven digits
    data: dict = {"attributes": {"position": {"itemSize": 3, "type": "Float32Array", "array": numbers}}}
    if triangles is not None:
        data["index"] = {"itemSize": 1, "type": "Uint32Array", "array": triangles.ravel().tolist()}
    return {"type": "BufferGeometry", "data": data}


def link_ends(mech: Mechanism, shaped=()) -> dict[int, list[np.ndarray]]:
    """For each joint the points of its body to which a link is drawn from the joint's origin.

    Origins of the joints it carries, anchors of loops, points of springs and wrenches, and for a bare leaf, which is
    not one of the joints `shaped` by a file, the end of a rod with its inertia.
    """
    model = mech.model
    ends = {joint: [] for joint in range(1, model.njoints)}
    places = [(model.parents[joint], model.jointPlacements[joint]) for joint in ends]
    points = [(joint, place.translation) for joint, place in places + anchors(model, *mech.anchored_loops)]
    for joint, point in points + force_points(mech):
        if joint:
            ends[joint].append(point.copy())
    for joint, inertia in zip(ends, list(model.inertias)[1:], strict=True):
        bare = not ends[joint] and joint not in shaped
        if bare and inertia.mass > 0:  # beyond the centre of mass by half a uniform rod with this inertia
            half = np.sqrt(3 * np.linalg.eigvalsh(inertia.inertia)[-1] / inertia.mass)
            reach = max(np.linalg.norm(inertia.lever), 1e-300)
            ends[joint].append(inertia.lever * (1 + min(half / reach, 1.0)))
    return ends


def link_colors(mech: Mechanism, poses: np.ndarray, ends: dict[int, list[np.ndarray]]) -> dict[int, int]:
    """A colour for each joint's body: the least used so far that no body has that shares a point with it."""
    points = {joint: in_world(poses[:1, joint], [np.zeros(3), *its])[0] for joint, its in ends.items()}
    size = np.ptp(np.concatenate([*points.values(), np.zeros((1, 3))]), axis=0).max()
    colors: dict[int, int] = {}
    for joint, own in points.items():
        apart = {other: np.linalg.norm(own[:, None] - points[other], axis=2).min() for other in colors}
        near = [colors[other] for other, distance in apart.items() if distance <= MEETING * size]
        given = list(colors.values())
        colors[joint] = min(LINK_COLORS, key=lambda color: (near.count(color), given.count(color)))
    return colors


def skeleton(mech: Mechanism, poses: np.ndarray) -> np.ndarray:
    """World positions over the motion of joints, link ends and anchors, shape (n, k, 3)."""
    points = [(joint, [np.zeros(3), *ends]) for joint, ends in link_ends(mech).items()]
    points += [(joint, [place.translation]) for joint, place in anchors(mech.model, *mech.anchored_loops)]
    return np.concatenate([in_world(poses[:, joint], each) for joint, each in points], axis=1)


def bars(mech: Mechanism, poses: np.ndarray) -> dict[str, np.ndarray]:
    """Poses, shape (n, 7) each, of the bars that represent distance loops, by their names."""
    rods = {
        loop.name: anchors(mech.model, loop) for loop in mech.anchored_loops if LOOP_KINDS[loop.kind].drawn == "bar"
    }
    return {
        name: bar_poses(*(point_in_world(poses, j, place.translation) for j, place in ends))
        for name, ends in rods.items()
    }


def covering(shapes: list[Shape]) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """For each node with shapes the lowest and highest coordinates of their points."""
    points: dict[int, list[np.ndarray]] = {}
    for shape in shapes:
        points.setdefault(shape.node, []).append(shape.points)
    return {node: (np.vstack(its).min(axis=0), np.vstack(its).max(axis=0)) for node, its in points.items()}


def simple_shapes(mech: Mechanism, poses: np.ndarray, size: float, covered=None) -> list[Shape]:
    """Links, joints, ground and rails of every body; anchors of all loops.

    Left out are the bodies of the joints `covered` by shapes of their own, see :func:`covering`, but for levers to
    points outside of them, and bars where they are too thin to be seen; 0 is the ground. Thicknesses are relative to
    the `size` of the picture, m. Rails are as long as the distance that a joint slides; between bodies they are the
    barrel and the rod of a cylinder.
    """
    covered = covered or {}
    radius = LINK * size
    thick = {joint for joint, (low, high) in covered.items() if not _thin(low, high, radius)}
    out, fixed, of_bodies = [], [], link_ends(mech, shaped=thick)
    colors = link_colors(mech, poses, of_bodies)
    for joint, ends in of_bodies.items():
        rail = _rail(mech, joint, poses, size)
        if mech.model.parents[joint] == 0 and rail is not None and _slide(mech, joint) is None:
            fixed.append(rail.mean(0))
        if joint in covered:
            out += _levers(joint, ends, covered[joint], radius, colors[joint])
        else:
            out += _body(mech, joint, poses, size, ends, rail, colors, covered)
    fixed += [place.translation for joint, place in anchors(mech.model, *mech.anchored_loops) if joint == 0]
    fixed += [point for joint, point in force_points(mech) if joint == 0]
    if 0 not in covered:
        out += _ground(fixed, radius)
    return out + _closures(mech, poses, radius)


def _slide(mech: Mechanism, joint: int) -> np.ndarray | None:
    """The axis of a joint that slides, shape (3,); None for others."""
    axis, turns = joint_axis(mech.model, joint)
    return None if turns else axis


def _levers(joint: int, ends, covered, radius: float, color: int) -> list[Shape]:
    """Bars from the shapes of a body to points outside of them; to all points if the shapes are too thin to be seen."""
    low, high = covered
    outside = [end for end in ends if (end < low - radius).any() or (end > high + radius).any()]
    out = [cylinder(joint, np.clip(end, low, high), end, 0.6 * radius, color=color) for end in outside]
    if _thin(low, high, radius):
        out += [cylinder(joint, np.zeros(3), end, THIN * radius, color=color) for end in _apart(ends, radius)]
    return out


def _thin(low: np.ndarray, high: np.ndarray, radius: float) -> bool:
    """Whether a body between these coordinates, shape (3,), is too thin to be seen."""
    return bool(np.sort(high - low)[1] < 2 * THIN * radius)


def _apart(ends, radius: float) -> list[np.ndarray]:
    """Those of the points of a body that are not at its joint."""
    return [end for end in ends if np.linalg.norm(end) > radius / 10]


def _body(mech: Mechanism, joint: int, poses, size: float, ends, rail, colors, covered) -> list[Shape]:
    """The joint, the links and the rail of a body without shapes of its own; parameters as in :func:`simple_shapes`."""
    radius, color = LINK * size, colors[joint]
    parent, axis = mech.model.parents[joint], _slide(mech, joint)
    strut = None if axis is None else _strut(mech, joint, poses, axis, ends, radius, size)
    out: list[Shape] = []
    if strut is not None:
        barrel, rod = strut
        out += [] if parent in covered else [cylinder(parent, *barrel, 1.9 * radius, color=colors[parent])]
        out += [cylinder(joint, *rod, 0.9 * radius, color=ROD), ball(joint, rod[1], BALL * radius, color=JOINT)]
        ends = [end for end in ends if np.linalg.norm(np.cross(end, axis)) > radius / 10]
    elif axis is not None:
        out.append(block(joint, np.zeros(3), axis, 7 * radius, 4 * radius, color=color))
    else:
        out.append(ball(joint, np.zeros(3), BALL * radius, color=JOINT))
    for end in _apart(ends, radius):
        out += [cylinder(joint, np.zeros(3), end, radius, color=color), ball(joint, end, radius, color=color)]
    if strut is None and rail is not None and np.linalg.norm(rail[1] - rail[0]) > radius / 2:
        out.append(cylinder(parent, *rail, 0.45 * radius, color=RAIL))
    return out


def _strut(mech: Mechanism, joint: int, poses: np.ndarray, axis, ends, radius: float, size: float):
    """Ends of the barrel on a joint's parent and of the rod on its body; None if it is not a cylinder.

    A cylinder is a joint that slides along a line through the origin of the parent's own joint, by less than the
    distance from there to the farther end of its body. The rod always ends in the barrel.
    """
    home = mech.model.jointPlacements[joint]
    if mech.model.parents[joint] == 0:
        return None
    along = home.rotation @ axis  # in the axes of the parent
    tips = np.array([0.0, *(end @ axis for end in ends if np.linalg.norm(np.cross(end, axis)) <= radius / 10)])
    way = (_path(mech, joint, poses) - home.translation) @ along
    low = way.min()
    high = way.max()
    base = -home.translation @ along
    if np.linalg.norm(home.translation + base * along) > MEETING * size:
        return None
    way = 1.0 if low + high + 2.0 * tips[np.argmax(np.abs(tips))] > 2.0 * base else -1.0
    tip = way * max(way * tips)
    nearest = min(way * (low + tip - base), way * (high + tip - base))
    stroke = high - low
    if not nearest > stroke + radius:
        return None
    length = max(BARREL * nearest, stroke + radius)
    start = home.translation + base * along
    inside = tip - way * (nearest + stroke - length + 0.5 * radius)
    return (start, start + way * length * along), (inside * axis, tip * axis)


def _path(mech: Mechanism, joint: int, poses: np.ndarray) -> np.ndarray:
    """The origin of a joint over the motion in the axes of its parent, shape (n, 3)."""
    parent, child = poses[:, mech.model.parents[joint]], poses[:, joint]
    turn_back = np.column_stack((np.zeros((len(poses), 3)), -parent[:, 3:6], parent[:, 6]))
    return in_world(turn_back, (child - parent)[:, None, :3])[:, 0]


def _rail(mech: Mechanism, joint: int, poses: np.ndarray, size: float) -> np.ndarray | None:
    """The straight path, shape (2, 3), of a joint's origin on its parent's body; one point twice if it rests."""
    home = mech.model.jointPlacements[joint].translation.copy()
    way = np.vstack((np.zeros(3), _path(mech, joint, poses) - home))
    if np.linalg.norm(way, axis=1).max() < 1e-9 * size:
        return np.array([home, home])
    direction = np.linalg.svd(way, full_matrices=False)[2][0]
    along = way @ direction
    astray = np.linalg.norm(way - np.outer(along, direction), axis=1).max()
    if mech.model.nvs[joint] > 1 or astray > 1e-6 * np.ptp(along):
        return None
    return home + np.outer([along.min(), along.max()], direction)


def _ground(points, radius: float) -> list[Shape]:
    """A block at every fixed point, and thin bars between them: the fixed frame."""
    places = np.unique(np.round(np.reshape(points, (-1, 3)), 12), axis=0)
    side = 3.2 * radius
    blocks = [block(0, place, (0, 1, 0), side, side, color=GROUND, opacity=0.5) for place in places]
    pairs = [places] if len(places) == 2 else [(places.mean(0), place) for place in places if len(places) > 2]
    return blocks + [cylinder(0, *pair, 0.45 * radius, color=RAIL) for pair in pairs]


def _closures(mech: Mechanism, poses: np.ndarray, radius: float) -> list[Shape]:
    """Anchor 1 as a clear shell, anchor 2 as a red core, which in a closed loop is inside its shell, rail or plate."""
    out, bar = [], mech.model.njoints
    for loop in mech.anchored_loops:
        (joint1, place1), (joint2, place2) = anchors(mech.model, loop)
        shell = ball(joint1, place1.translation, SHELL * radius, color=LOOP, opacity=0.35)
        core = ball(joint2, place2.translation, CORE * radius, color=LOOP)
        parts = (shell, core, *_guide(mech, loop, poses, radius))
        out += [replace(shape, on_top=1, loop=loop.name) for shape in parts]
        if LOOP_KINDS[loop.kind].drawn == "bar":
            half = np.array([0.0, loop.length / 2, 0.0])
            out.append(cylinder(bar, -half, half, 0.6 * radius, color=JOINT, loop=loop.name))
            bar += 1
    return out


def _guide(mech: Mechanism, loop: Loop, poses: np.ndarray, radius: float) -> list[Shape]:
    """The guide of anchor 2 on body 1: the rail of a slider or cylinder, or the plate of a plane."""
    if LOOP_KINDS[loop.kind].drawn not in ("rail", "plate"):
        return []
    (joint1, place1), (joint2, place2) = anchors(mech.model, loop)
    axis = place1.rotation @ (np.array(loop.axis) / np.linalg.norm(loop.axis))
    start, end = (point_in_world(poses, joint1, place1.translation + shift) for shift in (np.zeros(3), axis))
    away = point_in_world(poses, joint2, place2.translation) - start
    along = np.einsum("ij,ij->i", away, end - start)
    if LOOP_KINDS[loop.kind].drawn == "plate":
        reach = np.linalg.norm(away - along[:, None] * (end - start), axis=1).max() + SHELL * radius
        ends = [place1.translation + shift * radius * axis for shift in (-0.1, 0.1)]
        return [cylinder(joint1, *ends, reach, color=LOOP, opacity=0.2)]
    low, high = min(along.min(), 0.0) - SHELL * radius, max(along.max(), 0.0) + SHELL * radius
    ends = [place1.translation + way * axis for way in (low, high)]
    return [cylinder(joint1, *ends, 0.3 * radius, color=LOOP)]


def springs(mech: Mechanism, poses: np.ndarray, size: float) -> list[tuple]:
    """Springs between two points as coils that stretch with them.

    For each: its name, poses, shape (n, 7), and scales, shape (n, 3), its coil, and its two ends, shape (n, 2, 3).
    """
    out = []
    for spring in (each for each in mech.forces if isinstance(each, SpringDamper)):
        ends = [point_in_world(poses, *end) for end in spring.bind(mech.model).ends]
        lengths = np.linalg.norm(ends[1] - ends[0], axis=1)
        stretch = np.insert(np.ones((len(poses), 2)), 1, lengths.clip(SMALLEST), axis=1)
        coil = _coil(max(lengths.mean(), SMALLEST), size)
        out.append((spring.label, bar_poses(*ends), stretch, coil, np.stack(ends, axis=1)))
    return out


def _coil(length: float, size: float) -> Shape:
    """A coil of length 1 along y, about its middle; its wire is round if it is stretched to `length`."""
    share = np.concatenate(([0.0], np.linspace(STRAIGHT, 1 - STRAIGHT, TURNS * SEGMENTS + 1), [1.0]))
    coiled = ((share - STRAIGHT) / (1 - 2 * STRAIGHT)).clip(0, 1)
    angle = 2 * np.pi * TURNS * coiled
    outward = np.column_stack((np.cos(angle), np.zeros_like(angle), np.sin(angle)))
    reach = COIL * size * (2 * TURNS * np.minimum(coiled, 1 - coiled)).clip(0, 1)  # full radius after half a turn
    line = reach[:, None] * outward + np.outer(length * (share - 0.5), (0, 1, 0))
    across = np.cross(np.gradient(line, axis=0), outward)
    across /= np.linalg.norm(across, axis=1)[:, None]
    section = 2 * np.pi * np.arange(SIDES) / SIDES
    skin = np.cos(section)[:, None] * outward[:, None] + np.sin(section)[:, None] * across[:, None]
    points = (line[:, None] + WIRE * size * skin).reshape(-1, 3) / (1.0, length, 1.0)
    here = np.arange((len(line) - 1) * SIDES).reshape(-1, SIDES)
    beside = np.roll(here, -1, axis=1)
    corners = np.stack((here, beside, here + SIDES, beside, beside + SIDES, here + SIDES), axis=-1)
    return Shape(0, buffer(points, corners.reshape(-1, 3)), bounds=points, color=SPRING)
