"""A replay as meshcat's commands: one or several runs side by side, with their traces and forces, and a legend."""

from __future__ import annotations

from functools import cache
from itertools import cycle, pairwise

import numpy as np
import pinocchio as pin

from ..errors import InputError
from ..mechanism.checks import near
from ..mechanism.reactions import not_determined, undetermined
from .arrows import COLORS, FORCE, MOMENT, Action, actions, arrow, scale_of
from .commands import ASPECT, Node, animated, camera, draw, floor, line, transform, view_axes, y_up
from .motion import Run, body_poses, in_world, on_joint, playing_times, point_in_world, runs_of
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


class DrawnRun:
    """What is drawn of one run, in the axes of its own world."""

    def __init__(self, run: Run, path: str, visuals: list[Shape]):
        self.run, self.path, self.visuals = run, path, visuals  # at the frames' times; shapes of the robot file
        self.bodies = body_poses(run.mech.model, run.q)  # (m, njoints, 7)
        self.skeleton = skeleton(run.mech, self.bodies)  # (m, k, 3), joints, link ends and anchors
        size = float(np.linalg.norm(np.ptp(self.skeleton.reshape(-1, 3), axis=0)))
        self.size = size if size > POINT else 0.0
        self.actions: list[Action] = []
        self.nodes: list[Node] = []
        self.commands: list[dict] = []

    def draw(self, size: float, traces, scales):
        """Fill in nodes and commands; and points, shape (k, 3), that enclose the mechanism, and all with arrows."""
        mech, bodies, path = self.run.mech, self.bodies, self.path
        rods = bars(mech, bodies)
        poses = np.concatenate([bodies, *(rod[:, None] for rod in rods.values())], axis=1)
        paths = [f"{path}/ground", *(f"{path}/bodies/{_part(name)}" for name in mech.joints)]
        paths += [f"{path}/loops/{_part(name)}" for name in rods]
        shapes = self.visuals + simple_shapes(mech, bodies, size, {shape.node for shape in self.visuals})
        some = np.unique(np.linspace(0, len(bodies) - 1, 100).astype(int))
        extent = [self.skeleton[some], *(in_world(poses[some, shape.node], shape.points) for shape in shapes)]
        self.nodes += [Node(path, poses[:, k]) for k, path in enumerate(paths) if k]
        for name, color in zip(traces, cycle(TRACES), strict=False):
            joint, place = on_joint(mech.model, name)
            points = point_in_world(bodies, joint, place.translation)
            shapes.append(ball(joint, place.translation, 0.009 * size, color=color, on_top=True))
            self.commands.append(line(f"{path}/traces/{_part(name)}", "Line", points, color))
            extent.append(points[some])
        for number, (places, stretch, coil, ends) in enumerate(springs(mech, bodies, size), start=1):
            self.nodes.append(Node(f"{path}/springs/{number}", places, stretch))
            self.commands.append(draw(f"{path}/springs/{number}/coil", coil))
            extent.append(ends[some])
        self.commands += [draw(f"{paths[shape.node]}/{k}", shape) for k, shape in enumerate(shapes)]
        arrows = []
        for action in (each for each in self.actions if scales[each.kind]):
            parts, around = arrow(f"{path}/forces/{_part(action.name)}", action, scales[action.kind], size)
            self.nodes += [node for node, _ in parts]
            self.commands += [draw(f"{node.path}/{k}", each) for node, its in parts for k, each in enumerate(its)]
            arrows.append(around[some].reshape(-1, 3))
        self.body = np.concatenate([points.reshape(-1, 3) for points in extent])
        self.extent = np.concatenate([self.body, *arrows])


def picture(mech, sol, *, speed: float, fps: float, traces, forces: bool, repetitions: int) -> dict:
    """The replay as a page needs it, places in axes with y up; parameters as in :func:`pinconsist.export_html`.

    ``clock`` is the time at the start, the seconds of motion per second of playing, and the duration of playing.
    """
    from .visuals import visuals  # and with it coal, only when something is shown

    runs = runs_of(mech, sol, forces=forces)
    traces = _frames(traces, runs)
    clock = playing_times(runs, speed, fps)
    of_file = cache(visuals)
    paths = [f"/{k + 1} {_part(run.title)}" if len(runs) > 1 else "" for k, run in enumerate(runs)]
    drawn = [DrawnRun(each.at(clock * speed), path, of_file(each.mech)) for each, path in zip(runs, paths, strict=True)]
    size = max(each.size for each in drawn) or 1.0
    not_drawn: dict[str, float] = {}
    for each in drawn if forces else ():
        found = undetermined(each.run.mech, each.run.t, each.run.q)
        each.actions = actions(each.run, each.bodies, size, found)
        not_drawn |= found
    acting = [action for each in drawn for action in each.actions]
    scales = {kind: scale_of(kind, acting, size) for kind in (FORCE, MOMENT)}
    for each in drawn:
        each.draw(size, traces, scales)

    axes, planar = view_axes([each.skeleton for each in drawn])
    placed = list(zip(drawn, _offsets([each.extent for each in drawn], axes[0], size), strict=True))
    lens, target = camera(np.concatenate([each.extent + offset for each, offset in placed]), axes, size)
    commands = [command for each in drawn for command in each.commands]
    commands += [transform(each.path, pin.SE3(np.eye(3), offset).homogeneous) for each, offset in placed if each.path]
    commands += lens
    if not planar:
        commands.append(floor(np.concatenate([each.body + offset for each, offset in placed]), size))
    commands += animated([node for each in drawn for node in each.nodes], clock, repetitions)
    titles = [(each.run.title, _below(each.body, axes, size) + offset) for each, offset in placed if each.run.title]
    first, last = runs[0].t[[0, -1]]
    return {
        "commands": commands,
        "target": target,
        "aspect": ASPECT,  # for which the camera was placed
        "clock": [first, speed * (-1.0 if last < first else 1.0), float(clock[-1])],
        "titles": [{"text": text, "at": y_up(place)} for text, place in titles],
        "legend": _legend(runs, traces, forces, scales, acting, not_drawn),
    }


def _frames(traces, runs) -> list[str]:
    if isinstance(traces, str):
        raise InputError(f"traces needs a sequence of frame names, like traces=[{traces!r}]")
    traces = list(dict.fromkeys(traces))
    for mech in (run.mech for run in runs):
        names = [frame.name for frame in mech.model.frames]
        if unknown := [name for name in traces if name not in names]:
            raise InputError(f"{mech.name}: no frame {unknown[0]!r} to trace{near(unknown[0], names)}")
    return traces


def _part(name: str) -> str:
    return name.replace("/", "∕") or "unnamed"  # a slash would split the path


def _offsets(extents, right: np.ndarray, size: float) -> list[np.ndarray]:
    """Where the runs stand: in a row to the viewer's right, the first where its world is."""
    ends = [((points @ right).min(), (points @ right).max()) for points in extents]
    shifts = [0.0]
    for (_, before), (start, _) in pairwise(ends):
        shifts.append(shifts[-1] + before + GAP * size - start)
    return [shift * right for shift in shifts]


def _below(points: np.ndarray, axes: np.ndarray, size: float) -> np.ndarray:
    """The point under the middle of others, as the viewer sees it."""
    low, high = np.min(points @ axes.T, axis=0), np.max(points @ axes.T, axis=0)
    return np.array([(low[0] + high[0]) / 2, low[1] - 0.06 * size, (low[2] + high[2]) / 2]) @ axes


def _legend(runs, traces, forces: bool, scales, acting, not_drawn) -> list[dict]:
    out = [(color, f"path of {name}") for name, color in zip(traces, cycle(TRACES), strict=False)]
    if kinds := {loop.kind for run in runs for loop in run.mech.anchored_loops}:
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
    errors = np.linalg.norm(wrong - right, axis=1)
    error = errors.max() / (np.linalg.norm(right[errors.argmax()]) or np.inf)
    if error < VISIBLE:
        return ""
    here, there = ("left", "right") if exact == 0 else ("right", "left")
    amount = f"{100 * error:.0f} %" if error < 2 else f"{error:.0f} times its size"
    return f"{here}: the first force is wrong by {amount}, however small the step; {there}: numerically consistent"
