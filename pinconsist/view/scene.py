"""A replay as meshcat's commands: one or several runs side by side, with their traces and forces, and a legend."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..errors import InputError
from ..mechanism.names import near
from ..mechanism.reactions import not_determined, undetermined
from .actions import FORCE, MOMENT, Action, actions
from .arrows import COLORS, arrow, scale_of
from .camera import camera, floor, plane_normal, surroundings, view_axes, y_up
from .commands import Node, animation, at_start, drawn, line, placed
from .motion import Run, body_poses, in_world, playing_times
from .shapes import CLOSED, Shape, ball, bars, simple_shapes, skeleton
from .side_by_side import contrast, runs_of
from .springs import springs

TRACES = (0x00838F, 0xBF360C, 0x33691E, 0x4527A0, 0x8D6E63)
SEATS = {kind: "in its shell" for kind in ("point", "frame", "hinge", "universal")}
SEATS |= {"slider": "on its rail", "cylinder": "on its rail", "plane": "on its plate", "distance": "at its bar's end"}
ACTS = {  # kind, and whether on a joint
    (FORCE, False): "force of a loop on its second, or only, moving body",
    (FORCE, True): "force of a drive or motor on its joint",
    (MOMENT, False): "moment of a loop on that body",
    (MOMENT, True): "torque of a drive or motor on its joint",
}
POINT = 1e-12  # m; what is smaller is a point and rounding
GAP = 0.3  # between neighbours, in sizes of the scene


@dataclass(eq=False)
class Copy:
    """What is drawn of one run, in the axes of its own world."""

    run: Run  # at the frames' times
    path: str
    bodies: np.ndarray  # (m, njoints, 7), world poses of the joints
    bones: np.ndarray  # (m, k, 3), points of the skeleton
    skin: list[Shape]  # what the robot file brings
    acting: list[Action] = field(default_factory=list)
    nodes: list[Node] = field(default_factory=list)
    things: list[dict] = field(default_factory=list)
    body: np.ndarray | None = None  # (k, 3), encloses the mechanism
    cloud: np.ndarray | None = None  # (k, 3), encloses all that is drawn, arrows too

    @property
    def size(self) -> float:
        size = float(np.linalg.norm(np.ptp(self.bones.reshape(-1, 3), axis=0)))
        return size if size > POINT else 0.0


def scene(mech, sol, *, speed: float, fps: float, traces, forces: bool, repetitions: int) -> dict:
    """The replay as a page needs it; parameters as in :func:`pinconsist.export_html`.

    Returns
    -------
    dict
        ``commands`` in their order, ``target`` of the camera, ``clock`` (time at the start, seconds
        of motion per second of playing, duration of playing), ``titles`` with the places at which they stand, and
        ``legend``: color and text each. Places are in axes with y up.
    """
    from .visuals import visuals  # and with it coal, only when something is shown

    runs, traces = runs_of(mech, sol, forces=forces), _names(traces)
    for run in runs:
        require_frames(run.mech, traces)
    clock = playing_times(runs, speed, fps)
    skins = {id(run.mech): run.mech for run in runs}
    skins = {key: visuals(each) for key, each in skins.items()}
    copies = []
    for number, run in enumerate(runs):
        now = run.at(clock * speed)
        bodies = body_poses(run.mech.model, now.q)
        path = f"/{number + 1} {_part(run.title)}" if len(runs) > 1 else ""
        copies.append(Copy(now, path, bodies, skeleton(run.mech, bodies), skins[id(run.mech)]))
    size = max(copy.size for copy in copies) or 1.0
    doubtful: dict[str, float] = {}
    for copy in copies if forces else ():
        found = undetermined(copy.run.mech, copy.run.t, copy.run.q)
        copy.acting = actions(copy.run, copy.bodies, size, found)
        doubtful |= found
    acting = [action for copy in copies for action in copy.acting]
    scales = {kind: scale_of(kind, acting, size) for kind in (FORCE, MOMENT)}
    for copy in copies:
        _draw(copy, size, traces, scales)

    normal = _common_normal([plane_normal(copy.bones) for copy in copies])
    axes = view_axes(normal)
    offsets = _offsets([copy.cloud for copy in copies], axes[0], size)
    cloud, ground = (
        np.concatenate([each + offset for each, offset in zip(clouds, offsets, strict=True)])
        for clouds in ([copy.cloud for copy in copies], [copy.body for copy in copies])
    )
    look, target = camera(cloud, axes, size)
    out = [thing for copy in copies for thing in copy.things]
    out += [placed(copy.path, offset) for copy, offset in zip(copies, offsets, strict=True) if copy.path]
    out += [*surroundings(size), *look, *([floor(ground, size)] if normal is None else [])]
    nodes = [node for copy in copies for node in copy.nodes]
    out += map(at_start, nodes)
    if len(clock) > 1:
        out.append(animation(nodes, clock, repetitions))
    first, last = runs[0].t[[0, -1]]
    legend = _legend(runs, traces, forces, scales, acting, doubtful)
    if forces and (note := contrast(sol)):
        legend.append({"color": COLORS[FORCE], "text": note})
    titles = [
        {"text": copy.run.title, "at": y_up(_below(copy.body, axes, size) + offset)}
        for copy, offset in zip(copies, offsets, strict=True)
        if copy.run.title
    ]
    return {
        "commands": out,
        "target": target,
        "clock": [first, speed * (-1.0 if last < first else 1.0), float(clock[-1])],
        "titles": titles,
        "legend": legend,
    }


def _names(traces) -> tuple[str, ...]:
    if isinstance(traces, str):
        raise InputError(f"traces needs a sequence of frame names, like traces=[{traces!r}]")
    return tuple(dict.fromkeys(traces))


def require_frames(mech, traces):
    """Raise InputError for a name that is no frame of the mechanism."""
    names = [frame.name for frame in mech.model.frames]
    for name in traces:
        if name not in names:
            raise InputError(f"{mech.name}: no frame {name!r} to trace{near(name, names)}")


def _part(name: str) -> str:
    return name.replace("/", "∕") or "unnamed"  # a slash would split the path


def _draw(copy: Copy, size: float, traces, scales):
    """Fill in nodes, things and cloud of a copy."""
    mech, bodies = copy.run.mech, copy.bodies
    poses = np.concatenate([bodies, *(bar[:, None] for bar in bars(mech, bodies))], axis=1)
    rods = [loop.name for loop in mech.anchored_loops if loop.kind == "distance"]
    paths = [f"{copy.path}/ground", *(f"{copy.path}/bodies/{_part(name)}" for name in mech.joints)]
    paths += [f"{copy.path}/loops/{_part(name)}" for name in rods]
    shapes = copy.skin + simple_shapes(mech, bodies, size, {shape.node for shape in copy.skin})
    some = np.unique(np.linspace(0, len(bodies) - 1, 100).astype(int))
    cloud = [copy.bones[some], *(in_world(poses[some, shape.node], shape.points) for shape in shapes)]
    copy.nodes = [Node(path, poses[:, k]) for k, path in enumerate(paths) if k]
    for number, name in enumerate(traces):
        frame, color = mech.model.frames[mech.model.getFrameId(name)], TRACES[number % len(TRACES)]
        points = in_world(bodies[:, frame.parentJoint], [frame.placement.translation])[:, 0]
        shapes.append(ball(frame.parentJoint, frame.placement.translation, 0.009 * size, color=color, on_top=True))
        copy.things.append(line(f"{copy.path}/traces/{_part(name)}", "Line", points, color))
        cloud.append(points[some])
    for node, coil, ends in springs(mech, bodies, size, copy.path):
        copy.nodes.append(node)
        copy.things.append(drawn(f"{node.path}/coil", coil))
        cloud.append(ends[some])
    copy.body = np.concatenate([points.reshape(-1, 3) for points in cloud])
    cloud = [copy.body]
    copy.things += [drawn(f"{paths[shape.node]}/{k}", shape) for k, shape in enumerate(shapes)]
    for action in (each for each in copy.acting if scales[each.kind]):
        parts, around = arrow(f"{copy.path}/forces/{_part(action.name)}", action, scales[action.kind], size)
        for node, its_shapes in parts:
            copy.nodes.append(node)
            copy.things += [drawn(f"{node.path}/{k}", shape) for k, shape in enumerate(its_shapes)]
        cloud.append(around[some].reshape(-1, 3))
    copy.cloud = np.concatenate(cloud)


def _common_normal(normals) -> np.ndarray | None:
    """The normal of all; None where one moves in space or they differ."""
    first = normals[0]
    same = all(each is not None and first is not None and abs(each @ first) > 1 - 1e-6 for each in normals)
    return first if same else None


def _offsets(clouds, right: np.ndarray, size: float) -> list[np.ndarray]:
    """Where the copies stand: in a row to the viewer's right, the first where its world is."""
    offsets, edge = [], None
    for cloud in clouds:
        along = cloud @ right
        shift = 0.0 if edge is None else edge + GAP * size - along.min()
        edge = along.max() + shift
        offsets.append(shift * right)
    return offsets


def _below(cloud: np.ndarray, axes: np.ndarray, size: float) -> np.ndarray:
    """The point under the middle of a cloud, as the viewer sees it."""
    seen = cloud @ axes.T
    middle = (seen.max(0) + seen.min(0)) / 2
    return np.array([middle[0], seen[:, 1].min() - 0.06 * size, middle[2]]) @ axes


def _legend(runs, traces, forces: bool, scales, acting, doubtful) -> list[dict]:
    out = [{"color": TRACES[k % len(TRACES)], "text": f"path of {name}"} for k, name in enumerate(traces)]
    kinds = {loop.kind for run in runs for loop in run.mech.anchored_loops}
    if kinds:
        seats = dict.fromkeys(seat for kind, seat in SEATS.items() if kind in kinds)
        out.append({"color": CLOSED, "text": f"loop: closed where its core sits {', '.join(seats)}"})
    for kind, scale in scales.items():
        if scale:
            told = sorted({each.on_joint for each in acting if each.kind == kind})
            text = ", or ".join(ACTS[kind, on_joint] for on_joint in told)
            out.append({"color": COLORS[kind], "text": f"{text}: {scale.text}"})
    if doubtful:
        out.append({"color": COLORS[FORCE], "text": f"not drawn: {not_determined(doubtful)}"})
    elif forces and not any(scales.values()):
        out.append({"color": COLORS[FORCE], "text": "no loop pulls here"})
    return out
