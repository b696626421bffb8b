"""What touches, on a page: planes, points, stops, ropes and struts, which light up where they act, and their forces."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from ..mechanism.contacts import DistanceElement, LimitElement, PinElement, PlaneElement
from ..mechanism.names import body_names
from .arrows import FORCE, MOMENT, Action
from .motion import Run, bar_poses, in_world, joint_axis, point_in_world
from .shapes import GROUND, LINK, SMALLEST, Shape, ball, cylinder, link_ends

STATES = ("open", "closed", "stick", "slip", "impact")
LIGHTS = {"open": 0xA0A4AA, "closed": 0x2E7D32, "stick": 0x2E7D32, "slip": 0xF57C00, "impact": 0xFFD600}
MEANINGS = {"open": "open", "closed": "closed, or stuck", "slip": "sliding", "impact": "impact"}
FLASH = 0.15  # s of playing for which an impact is seen
PLATE = 0.15  # thickness of a plane, relative to a link
MARGIN = 0.08  # what a plane extends beyond its points, relative to the picture
ALONG = 0.5  # of the body of a joint: where its stops are
MARK = 1.2  # radius of a point, relative to that of a link
ROPE = 0.35  # radius of a rope


@dataclass(frozen=True)
class Touching:
    """A contact on the page: its shape, its states over the frames, and for a rope or strut its poses and scales."""

    name: str
    shape: Shape
    states: np.ndarray  # (m,), of STATES
    poses: np.ndarray | None = None
    scales: np.ndarray | None = None


def states_of(run: Run, which: list[int]) -> np.ndarray:
    """What the elements `which` of one contact do at the times of a run, (m,), of STATES; impacts last for a moment."""
    history = run.source.contacts
    tables = np.array([history.index(t) for t in run.t])
    codes = np.array([max(STATES.index(table[i].kind) for i in which) for table in history.tables])
    return codes[tables]


def _flashing(run: Run, states, name, speed) -> np.ndarray:
    """The states with the impacts of a contact."""
    states = states.copy()
    for impact in run.source.impacts:
        if name in impact.impulses:
            since = run.t - impact.t
            states[(since >= 0.0) & (since < FLASH * speed)] = STATES.index("impact")
    return states


def touching(run: Run, poses: np.ndarray, size: float, speed: float) -> tuple[list[Touching], list[Shape]]:
    """The contacts of a run, `speed` s of motion a second, in a picture of this `size`, m; and the planes."""
    elements, found, radius = run.mech.contact_elements, [], LINK * size
    planes: dict[tuple, list] = {}
    for i, element in enumerate(elements):
        states = _flashing(run, states_of(run, [i]), element.name, speed)
        if isinstance(element, PlaneElement):
            centre = element.place2[:3, 3]
            mark = ball(element.joint2, centre, max(element.record.radius, MARK * radius), on_top=2)
            found.append(Touching(element.name, mark, states))
            place = pin.SE3(element.place1)
            normal = place.rotation[:, 2]
            height = float(place.translation @ normal) - element.record.radius
            planes.setdefault((element.joint1, *np.round([*normal, height], 9)), []).append(element)
        elif isinstance(element, DistanceElement):
            joint1, place1, joint2, place2 = element.ends
            ends = [point_in_world(poses, joint, place[:3, 3]) for joint, place in ((joint1, place1), (joint2, place2))]
            lengths = np.linalg.norm(ends[1] - ends[0], axis=1)
            scales = np.insert(np.ones((len(poses), 2)), 1, lengths.clip(SMALLEST), axis=1)
            rod = cylinder(0, (0.0, -0.5, 0.0), (0.0, 0.5, 0.0), ROPE * radius, on_top=2)
            found.append(Touching(element.name, rod, states, bar_poses(*ends), scales))
        elif isinstance(element, LimitElement):
            found.append(_stop(run, element, states, radius))
    return found, [_plane(poses, its, size) for its in planes.values()]


def _stop(run: Run, element: LimitElement, states, radius: float) -> Touching:
    """A stop, on the body that carries it, where the middle of the joint's body is when it reaches it."""
    model = run.mech.model
    joint = _joint_of(model, element)
    q = pin.neutral(model)
    at = model.idx_qs[joint]
    q[at : at + model.nqs[joint]] = (
        [element.limit] if model.nqs[joint] == 1 else [np.cos(element.limit), np.sin(element.limit)]
    )
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    ends = link_ends(run.mech)[joint]
    end = max(ends, key=np.linalg.norm, default=np.zeros(3))
    place = data.liMi[joint].act(ALONG * end)
    return Touching(element.name, ball(model.parents[joint], place, MARK * radius, on_top=2), states)


def _joint_of(model, element) -> int:
    """The joint of an element of one coordinate."""
    return next(joint for joint in range(1, model.njoints) if model.idx_vs[joint] == element.column)


def _plane(poses, elements: list[PlaneElement], size: float) -> Shape:
    """A plate under the points that may touch it, on the body that carries it."""
    first = elements[0]
    frame = pin.SE3(first.place1)
    at = poses[:, first.joint1]
    back = np.column_stack((np.zeros((len(at), 3)), -at[:, 3:6], at[:, 6]))
    points = []
    for element in elements:
        world = point_in_world(poses, element.joint2, element.place2[:3, 3]) - at[:, :3]
        points.append((in_world(back, world[:, None])[:, 0] - frame.translation) @ frame.rotation)
    points = np.concatenate(points)
    low, high = points.min(axis=0)[:2] - MARGIN * size, points.max(axis=0)[:2] + MARGIN * size
    thickness = PLATE * LINK * size
    middle = np.array([*(low + high) / 2.0, -first.record.radius - thickness])
    width, depth = high - low
    form = {"type": "BoxGeometry", "width": width, "height": depth, "depth": 2.0 * thickness}
    half = np.array([width, depth, 2.0 * thickness]) / 2.0
    corners = half * (np.indices((2, 2, 2)).reshape(3, -1).T * 2 - 1)
    place = frame * pin.SE3(np.eye(3), middle)
    return Shape(first.joint1, form, place, corners, color=GROUND, opacity=0.35)


def contact_actions(run: Run, poses: np.ndarray) -> list[Action]:
    """The forces of contacts, on the bodies that touch, and the torques or forces of stops and dry friction."""
    if run.lam is None or not run.mech.contacts:
        return []
    out, first, names = [], run.mech.nc, body_names(run.mech.model)
    for element in run.mech.contact_elements:
        lam = run.lam[:, first : first + element.size]
        first += element.size
        name = element.name
        if isinstance(element, PlaneElement):
            point = point_in_world(poses, element.joint2, element.place2[:3, 3])
            turn = np.array([pin.XYZQUATToSE3(pose).rotation for pose in poses[:, element.joint1]])
            force = element.force(lam, None, None, turn)
            point = point - element.record.radius * np.einsum("nij,j->ni", turn, element.place1[:3, 2])
            out.append(Action(name, name, FORCE, point, force, _bodies(names, element.joint2, element.joint1)))
        elif isinstance(element, DistanceElement):
            joint1, place1, joint2, place2 = element.ends
            x1 = point_in_world(poses, joint1, place1[:3, 3])
            x2 = point_in_world(poses, joint2, place2[:3, 3])
            bodies = _bodies(names, joint2, joint1)
            out.append(Action(name, name, FORCE, x2, element.force(lam, x1, x2, None), bodies))
        elif isinstance(element, PinElement):
            joint1, place1, joint2, _ = element.ends
            turn = np.array([pin.XYZQUATToSE3(pose).rotation for pose in poses[:, joint1]])
            point = point_in_world(poses, joint1, place1[:3, 3])
            out.append(Action(name, name, MOMENT, point, element.moment(lam, turn), _bodies(names, joint2, joint1)))
        else:
            out += _on_joint(run, poses, element, getattr(element, "sign", 1.0) * lam[:, 0])
    return [action for action in out if action.norms.any()]


def _bodies(names, *joints) -> tuple[str, ...]:
    """The bodies that move between which a force acts, or the ground."""
    return tuple(names[joint] for joint in joints if joint) or ("ground",)


def _on_joint(run: Run, poses, element, values) -> list[Action]:
    model = run.mech.model
    joint = _joint_of(model, element)
    axis, turns = joint_axis(model, joint)
    vectors = values[:, None] * np.array([pin.XYZQUATToSE3(pose).rotation @ axis for pose in poses[:, joint]])
    kind = MOMENT if turns else FORCE
    about = {"bodies": (body_names(model)[joint],), "joint": model.names[joint], "on_joint": values}
    return [Action(element.name, element.name, kind, poses[:, joint, :3], vectors, **about)]


def lit(shape: Shape, states: np.ndarray) -> Shape:
    """A shape in the colour of its first state."""
    return replace(shape, color=LIGHTS[STATES[states[0]]])


def legend(runs) -> list[dict]:
    """What the colours of contacts mean, of those that are seen."""
    kinds = {mode.mode for run in runs if run.mech.contacts for mode in run.source.modes}
    if not kinds:
        return []
    kinds |= {"impact"} if any(run.source.impacts for run in runs if run.mech.contacts) else set()
    if "stick" in kinds:
        kinds.add("closed")
    return [
        {"color": LIGHTS[kind], "text": f"contact: {meaning}"} for kind, meaning in MEANINGS.items() if kind in kinds
    ]
