"""A replay as meshcat's commands: one or several runs side by side, with their traces and forces, and a legend."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from ..errors import InputError
from ..mechanism.names import near
from ..mechanism.reactions import not_determined, undetermined
from .arrows import COLORS, FORCE, MOMENT, Action, actions, arrow, scale_of
from .commands import ASPECT, Node, animated, camera, draw, floor, line, transform, view_axes, y_up
from .motion import Run, body_poses, in_world, playing_times, point_in_world, runs_of
from .shapes import CLOSED, Shape, ball, bars, simple_shapes, skeleton, springs

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
GAP = 0.3  # between neighbours, in sizes of the picture
FIRST_ROWS = 8  # among which the first of a multistep method are
VISIBLE = 0.02  # of a force: a smaller error is not mentioned


@dataclass(eq=False)
class DrawnRun:
    """What is drawn of one run, in the axes of its own world."""

    run: Run  # at the frames' times
    path: str
    bodies: np.ndarray  # (m, njoints, 7), world poses of the joints
    skeleton: np.ndarray  # (m, k, 3), joints, link ends and anchors
    visuals: list[Shape]  # of the robot file
    actions: list[Action] = field(default_factory=list)
    nodes: list[Node] = field(default_factory=list)
    commands: list[dict] = field(default_factory=list)
    body: np.ndarray | None = None  # (k, 3), points that enclose the mechanism
    extent: np.ndarray | None = None  # (k, 3), points that enclose all that is drawn, arrows too

    @property
    def size(self) -> float:
        size = float(np.linalg.norm(np.ptp(self.skeleton.reshape(-1, 3), axis=0)))
        return size if size > POINT else 0.0


def picture(mech, sol, *, speed: float, fps: float, traces, forces: bool, repetitions: int) -> dict:
    """The replay as a page needs it; parameters as in :func:`pinconsist.export_html`.

    Returns
    -------
    dict
        ``commands`` in their order, ``target`` of the camera, ``aspect`` for which it was placed, ``clock`` (time at
        the start, seconds of motion per second of playing, duration of playing), ``titles`` with their places, and
        ``legend``: color and text each. Places are in axes with y up.
    """
    from .visuals import visuals  # and with it coal, only when something is shown

    runs, traces = runs_of(mech, sol, forces=forces), _traces(traces)
    for run in runs:
        _require_frames(run.mech, traces)
    clock = playing_times(runs, speed, fps)
    of_files = {id(each): visuals(each) for each in {id(run.mech): run.mech for run in runs}.values()}
    drawn = []
    for number, run in enumerate(runs):
        now = run.at(clock * speed)
        bodies = body_poses(run.mech.model, now.q)
        path = f"/{number + 1} {_part(run.title)}" if len(runs) > 1 else ""
        drawn.append(DrawnRun(now, path, bodies, skeleton(run.mech, bodies), of_files[id(run.mech)]))
    size = max(each.size for each in drawn) or 1.0
    not_drawn: dict[str, float] = {}
    for each in drawn if forces else ():
        found = undetermined(each.run.mech, each.run.t, each.run.q)
        each.actions = actions(each.run, each.bodies, size, found)
        not_drawn |= found
    acting = [action for each in drawn for action in each.actions]
    scales = {kind: scale_of(kind, acting, size) for kind in (FORCE, MOMENT)}
    for each in drawn:
        _draw(each, size, traces, scales)

    axes, planar = view_axes([each.skeleton for each in drawn])
    offsets = _offsets([each.extent for each in drawn], axes[0], size)
    placed = list(zip(drawn, offsets, strict=True))
    lens, target = camera(np.concatenate([each.extent + offset for each, offset in placed]), axes, size)
    commands = [command for each in drawn for command in each.commands]
    commands += [transform(each.path, pin.SE3(np.eye(3), offset).homogeneous) for each, offset in placed if each.path]
    commands += lens
    if not planar:
        commands.append(floor(np.concatenate([each.body + offset for each, offset in placed]), size))
    commands += animated([node for each in drawn for node in each.nodes], clock, repetitions)
    first, last = runs[0].t[[0, -1]]
    return {
        "commands": commands,
        "target": target,
        "aspect": ASPECT,
        "clock": [first, speed * (-1.0 if last < first else 1.0), float(clock[-1])],
        "titles": [
            {"text": each.run.title, "at": y_up(_below(each.body, axes, size) + offset)}
            for each, offset in placed
            if each.run.title
        ],
        "legend": _legend(runs, traces, forces, scales, acting, not_drawn),
    }


def _traces(traces) -> tuple[str, ...]:
    if isinstance(traces, str):
        raise InputError(f"traces needs a sequence of frame names, like traces=[{traces!r}]")
    return tuple(dict.fromkeys(traces))


def _require_frames(mech, traces):
    names = [frame.name for frame in mech.model.frames]
    for name in traces:
        if name not in names:
            raise InputError(f"{mech.name}: no frame {name!r} to trace{near(name, names)}")


def _part(name: str) -> str:
    return name.replace("/", "∕") or "unnamed"  # a slash would split the path


def _draw(drawn: DrawnRun, size: float, traces, scales):
    """Fill in nodes, commands, body and extent of a run."""
    mech, bodies, path = drawn.run.mech, drawn.bodies, drawn.path
    rods = bars(mech, bodies)
    poses = np.concatenate([bodies, *(rod[:, None] for rod in rods.values())], axis=1)
    paths = [f"{path}/ground", *(f"{path}/bodies/{_part(name)}" for name in mech.joints)]
    paths += [f"{path}/loops/{_part(name)}" for name in rods]
    shapes = drawn.visuals + simple_shapes(mech, bodies, size, {shape.node for shape in drawn.visuals})
    some = np.unique(np.linspace(0, len(bodies) - 1, 100).astype(int))
    extent = [drawn.skeleton[some], *(in_world(poses[some, shape.node], shape.points) for shape in shapes)]
    drawn.nodes = [Node(path, poses[:, k]) for k, path in enumerate(paths) if k]
    for number, name in enumerate(traces):
        frame, color = mech.model.frames[mech.model.getFrameId(name)], TRACES[number % len(TRACES)]
        points = point_in_world(bodies, frame.parentJoint, frame.placement.translation)
        shapes.append(ball(frame.parentJoint, frame.placement.translation, 0.009 * size, color=color, on_top=True))
        drawn.commands.append(line(f"{path}/traces/{_part(name)}", "Line", points, color))
        extent.append(points[some])
    for number, (places, scale, coil, ends) in enumerate(springs(mech, bodies, size), start=1):
        drawn.nodes.append(Node(f"{path}/springs/{number}", places, scale))
        drawn.commands.append(draw(f"{path}/springs/{number}/coil", coil))
        extent.append(ends[some])
    drawn.body = np.concatenate([points.reshape(-1, 3) for points in extent])
    extent = [drawn.body]
    drawn.commands += [draw(f"{paths[shape.node]}/{k}", shape) for k, shape in enumerate(shapes)]
    for action in (each for each in drawn.actions if scales[each.kind]):
        parts, around = arrow(f"{path}/forces/{_part(action.name)}", action, scales[action.kind], size)
        for node, its_shapes in parts:
            drawn.nodes.append(node)
            drawn.commands += [draw(f"{node.path}/{k}", shape) for k, shape in enumerate(its_shapes)]
        extent.append(around[some].reshape(-1, 3))
    drawn.extent = np.concatenate(extent)


def _offsets(extents, right: np.ndarray, size: float) -> list[np.ndarray]:
    """Where the runs stand: in a row to the viewer's right, the first where its world is."""
    offsets, edge = [], None
    for points in extents:
        along = points @ right
        shift = 0.0 if edge is None else edge + GAP * size - along.min()
        edge = along.max() + shift
        offsets.append(shift * right)
    return offsets


def _below(points: np.ndarray, axes: np.ndarray, size: float) -> np.ndarray:
    """The point under the middle of others, as the viewer sees it."""
    seen = points @ axes.T
    middle = (seen.max(0) + seen.min(0)) / 2
    return np.array([middle[0], seen[:, 1].min() - 0.06 * size, middle[2]]) @ axes


def _legend(runs, traces, forces: bool, scales, acting, not_drawn) -> list[dict]:
    out = [(TRACES[k % len(TRACES)], f"path of {name}") for k, name in enumerate(traces)]
    kinds = {loop.kind for run in runs for loop in run.mech.anchored_loops}
    if kinds:
        seats = dict.fromkeys(seat for kind, seat in SEATS.items() if kind in kinds)
        out.append((CLOSED, f"loop: closed where its core sits {', '.join(seats)}"))
    for kind, scale in scales.items():
        if scale:
            seen = sorted({each.on_joint for each in acting if each.kind == kind})
            out.append((COLORS[kind], f"{', or '.join(ACTS[kind, on_joint] for on_joint in seen)}: {scale.text}"))
    if not_drawn:
        out.append((COLORS[FORCE], f"not drawn: {not_determined(not_drawn)}"))
    elif forces and not any(scales.values()):
        out.append((COLORS[FORCE], "no forces to draw"))
    if forces and (note := _first_force(runs)):
        out.append((COLORS[FORCE], note))
    return [{"color": color, "text": text} for color, text in out]


def _first_force(runs) -> str:
    """Of two runs of which one starts from exact values, how wrong its first force is; empty where it is right."""
    modes = [run.consistency for run in runs]
    if len(runs) != 2 or modes.count("exact") != 1:
        return ""
    exact = modes.index("exact")
    wrong, right = (runs[k].lam[1:FIRST_ROWS] for k in (exact, 1 - exact))
    if wrong.shape != right.shape or not right.size:
        return ""
    errors, norms = np.linalg.norm(wrong - right, axis=1), np.linalg.norm(right, axis=1)
    worst = errors.argmax()
    error = errors[worst] / norms[worst] if norms[worst] else 0.0
    if error < VISIBLE:
        return ""
    here, there = ("left", "right") if exact == 0 else ("right", "left")
    amount = f"{100 * error:.0f} %" if error < 2 else f"{error:.0f} times its size"
    return f"{here}: the first force is wrong by {amount}, however small the step; {there}: numerically consistent"
