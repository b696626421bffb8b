"""A replay as meshcat's commands: one or several runs side by side, with their traces and forces, and a legend."""

from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from itertools import cycle, pairwise

import numpy as np
import pinocchio as pin

from ..errors import InputError
from ..mechanism.checks import flag, near
from ..mechanism.checks import names as checked_names
from ..mechanism.loops import LOOP_KINDS
from ..mechanism.names import body_names
from ..mechanism.reactions import listed, not_determined, undetermined
from . import arrows, contacts
from .arrows import COLORS, FORCE, JOINT, MOMENT, RIGHT, UNITS, WRONG, Action
from .commands import Node, animated, draw, floor, line, outline, stage, transform, view_axes, y_up
from .curves import packed, panel, verdicts
from .motion import Run, body_poses, in_world, on_joint, playing_times, point_in_world, runs_of
from .shapes import LINK_COLORS, LOOP, Shape, ball, bars, covering, simple_shapes, skeleton, springs

TRACES = (0x00838F, 0xBF360C, 0x33691E, 0x4527A0, 0x8D6E63)
SEATS = {"shell": "in its shell", "rail": "on its rail", "plate": "on its plate", "bar": "at its bar's end"}
ACTS = {(FORCE, False): "force", (FORCE, True): "drive force", (MOMENT, False): "moment", (MOMENT, True): "torque"}
ACTS |= {(JOINT, True): "force"}  # kind, and whether it acts in a joint instead of on a body
NAMED = 3  # largest number of bodies in a line of the legend
GHOST, CLEAR = 0xD55E00, 0.45  # colour and opacity of a run over another one
POINT = 1e-12  # m; anything smaller counts as a point
BEND = 1e-3  # distance from straight lines between frames, relative to the size of the picture: about a pixel
ENCLOSED = 40  # frames in which the points that the camera shows are looked for
GAP = 0.3  # between neighbours, relative to the size of the picture


class DrawnRun:
    """The drawing of one run, in the axes of its own world."""

    def __init__(
        self, whole: Run, elapsed: np.ndarray, path: str, visuals: list[Shape], ghost: bool = False, speed: float = 1.0
    ):
        self.whole, self.path, self.visuals = whole, path, visuals  # shapes of the robot file
        self.speed = speed  # s of motion a second
        self.lights: list[dict] = []  # contacts, with their states over the frames
        self.ghost = ghost  # drawn over another run, in one colour that lets it be seen
        self.run = whole.at(elapsed)  # at the frames' times
        self.bodies = body_poses(self.run.mech.model, self.run.q)  # (m, njoints, 7)
        self.skeleton = skeleton(self.run.mech, self.bodies)  # (m, k, 3), joints, link ends and anchors
        size = float(np.linalg.norm(np.ptp(self.skeleton.reshape(-1, 3), axis=0)))
        self.size = size if size > POINT else 0.0
        self.actions: list[Action] = []
        self.nodes: list[Node] = []
        self.commands: list[dict] = []
        self.cuts: list[dict] = []

    def bend(self) -> float:
        """How far points are from straight lines between the frames, m, at most."""
        turns = self.skeleton[2:] - 2.0 * self.skeleton[1:-1] + self.skeleton[:-2]
        return float(np.linalg.norm(turns, axis=2).max(initial=0.0)) / 8.0

    def draw(self, number: int, size: float, traces, scales, hidden):
        """Fill in nodes and commands; and points, shape (k, 3), that enclose the mechanism, and all with arrows.

        Arrows of the kinds `hidden` are not seen at first, and not enclosed.
        """
        some = np.unique(np.linspace(0, len(self.bodies) - 1, ENCLOSED).astype(int))
        marks = self._draw_traces(traces, size)
        coils = self._draw_springs(size)
        coils += self._draw_contacts(number, size)
        parts = self._draw_parts(number, size, marks, some)
        extent = [self.skeleton[some], *parts, *(ends[some] for ends in coils)]
        reached = []
        for action in (each for each in self.actions if scales[each.kind]):
            around = self._draw_arrow(action, scales[action.kind], number)
            if action.kind not in hidden:
                reached.append(around[some].reshape(-1, 3))
        self.body = np.concatenate([points.reshape(-1, 3) for points in extent])
        self.extent = np.concatenate([self.body, *reached])

    def _draw_traces(self, traces, size: float) -> list[Shape]:
        """Draw the paths of frames; a ball on each."""
        model, marks = self.run.mech.model, []
        for name, color in zip(traces, cycle(TRACES), strict=False):
            joint, place = on_joint(model, name)
            points = point_in_world(self._at_all_rows, joint, place.translation)
            self.commands.append(line(f"{self.path}/traces/{_part(name)}", "Line", points, color, "trace"))
            marks.append(ball(joint, place.translation, 0.009 * size, color=color, on_top=1))
        return marks

    def _draw_springs(self, size: float) -> list[np.ndarray]:
        """Draw springs between two points; their ends, shape (m, 2, 3) each."""
        found = springs(self.run.mech, self.bodies, size)
        for k, (name, places, stretch, coil, _) in enumerate(found, start=1):
            path = f"{self.path}/springs/{k}"
            self.nodes.append(Node(path, places, stretch))
            self.commands.append(draw(f"{path}/coil", coil, part="body", name=name))
        return [ends for *_, ends in found]

    def _draw_contacts(self, number: int, size: float) -> list[np.ndarray]:
        """Draw planes and what touches; points around them, shape (n, k, 3) each."""
        if not self.run.mech.contacts or self.run.source.contacts is None:
            return []
        found, planes = contacts.touching(self.run, self.bodies, size, self.speed)
        names = self.run.mech.joints
        parts = [f"{self.path}/ground", *(f"{self.path}/bodies/{_part(name)}" for name in names)]
        around = []
        for k, plane in enumerate(planes):
            self.commands.append(
                draw(f"{parts[plane.node]}/plane {k}", plane, part="ground", name="ground", run=number)
            )
            around.append(in_world(self.bodies[:, plane.node], plane.points))
        for each in found if not self.ghost else ():
            path = f"{parts[each.shape.node]}/contact {_part(each.name)}"
            if each.poses is not None:
                path = f"{self.path}/contacts/{_part(each.name)}"
                self.nodes.append(Node(path, each.poses, each.scales))
            about = {"part": "contact", "name": each.name, "run": number}
            self.commands.append(draw(f"{path}/mark", contacts.lit(each.shape, each.states), **about))
            self.lights.append({"path": f"{path}/mark", "states": packed(each.states)})
            if each.poses is None:
                around.append(in_world(self.bodies[:, each.shape.node], each.shape.points))
        return around

    def _draw_parts(self, number: int, size: float, marks: list[Shape], some: np.ndarray) -> list[np.ndarray]:
        """Draw bodies with the `marks` on them, loops and the ground; points around them in the frames `some`."""
        mech, bodies = self.run.mech, self.bodies
        rods = bars(mech, bodies)
        poses = np.concatenate([bodies, *(rod[:, None] for rod in rods.values())], axis=1)
        names = [*body_names(mech.model), *rods]
        paths = [f"{self.path}/ground", *(f"{self.path}/bodies/{_part(name)}" for name in mech.joints)]
        paths += [f"{self.path}/loops/{_part(name)}" for name in rods]
        self.nodes += [Node(path, poses[:, k]) for k, path in enumerate(paths) if k]
        shapes = self.visuals + simple_shapes(mech, bodies, size, covering(self.visuals))
        labelled = self._labelled()
        if self.ghost:
            labelled, marks = set(), []
            shapes = [replace(each, color=GHOST, opacity=CLEAR) for each in shapes if each.node]
        for k, shape in enumerate(shapes + marks):
            part = "loop" if shape.on_top and shape.loop else "body" if shape.node else "ground"
            about = {"part": part, "name": shape.loop or names[shape.node], "run": number}
            about |= {} if part != "body" or shape.node in labelled else {"bare": True}
            self.commands.append(draw(f"{paths[shape.node]}/{k}", shape, **about))
        return [in_world(poses[some, shape.node], shape.points) for shape in shapes + marks]

    def _labelled(self) -> set[int]:
        """Nodes whose names are written beside them: not links without mass and shape, which only join two joints."""
        model = self.run.mech.model
        massive = {joint for joint, inertia in enumerate(model.inertias) if inertia.mass > 0.0}
        shaped = {shape.node for shape in self.visuals}
        return massive | shaped

    def _draw_arrow(self, action: Action, scale, number: int) -> np.ndarray:
        part = JOINT if action.kind == JOINT else FORCE
        path = f"{self.path}/{part}s/{_part(action.name)}"
        parts, around = arrows.arrow(path, action, scale)
        self.nodes += [node for node, _ in parts]
        about = {"part": part, "name": action.of, "run": number}  # the page finds its curve by these
        self.commands += [draw(f"{node.path}/{k}", each, **about) for node, its in parts for k, each in enumerate(its)]
        if scale.cuts and action.norms.max() > scale.most:
            cut = {"path": parts[-1][0].path, "values": packed(action.norms), "most": scale.most}
            self.cuts.append(cut | {"unit": UNITS[action.kind], "part": part})
        return around

    @cached_property
    def _at_all_rows(self) -> np.ndarray:
        """Poses of the bodies at all frames and all rows of the solution."""
        elapsed = np.union1d(self.run.elapsed, self.whole.elapsed)
        return body_poses(self.whole.mech.model, self.whole.at(elapsed).q)


def picture(
    mech,
    sol,
    *,
    fps,
    speed=1.0,
    traces=(),
    forces=False,
    loop=True,
    beside=True,
    first=None,
    times=None,
    smooth=False,
    over=False,
) -> dict:
    """The replay as a page needs it, places in axes with y up; parameters as in :func:`pinconsist.export_html`.

    ``clock`` is the time at the start, the seconds of motion per second of playing, and the duration of playing;
    `beside` adds the curves and verdicts beside the motion. `first`, of :func:`pinconsist.paper.compare`, has the
    error of the first run at its first step, where the page stops, and the true run. `times` are those of the frames,
    s of playing, instead of even ones. `smooth` makes as many frames as straight lines between them need.
    """
    forces, loop, beside = flag(forces, "forces"), flag(loop, "loop"), flag(beside, "panel")
    over = flag(over, "over")
    runs = runs_of(mech, sol, forces=forces)
    if first is not None:
        runs = [replace(run, true=replace(run, q=first.q, lam=first.lam)) for run in runs]
    traces = _frames(traces, runs)
    of_runs = verdicts(runs) if beside and not first else []  # before the curves, which say what is not unique
    drawn, clock, size = _drawn(runs, speed, fps, times, smooth, over)
    not_drawn = NotDrawn.of(drawn) if forces or beside else NotDrawn()
    acting, scales, hidden = [], dict.fromkeys(UNITS), set()
    if forces:
        acting, scales, hidden = _act(drawn, size, not_drawn, beside)
    for number, each in enumerate(drawn):
        each.draw(number, size, traces, scales, hidden)
    axes, planar = view_axes([each.skeleton for each in drawn])
    start, end = runs[0].t[[0, -1]]
    return _scene(drawn, axes, planar, size, clock, over) | {
        "clock": [start, speed * (-1.0 if end < start else 1.0), float(clock[-1]), len(clock)],
        "loop": loop,
        "legend": (_over(runs) if over else []) + _legend(runs, traces, forces, scales, acting, not_drawn),
        "cuts": [cut for each in drawn for cut in each.cuts],
        "lights": [light for each in drawn for light in each.lights],
        "lit": [contacts.LIGHTS[state] for state in contacts.STATES],
        "panel": panel(runs, size, not_drawn.all, planar) if beside else None,
        "verdicts": of_runs,
        "first": None if first is None else _stop(first, speed),
    }


def _drawn(
    runs: list[Run], speed: float, fps: float, times, smooth: bool, over: bool
) -> tuple[list[DrawnRun], np.ndarray, float]:
    """The runs at the times of the frames, these times, s of playing, and the size of the picture, m.

    Parameters are as in :func:`picture`.
    """
    from .visuals import visuals  # and with it coal, only when something is shown

    of_file = cache(visuals)
    paths = [f"/{k + 1} {_part(run.title)}" if len(runs) > 1 else "" for k, run in enumerate(runs)]

    def drawn_at(clock):
        ghosts = [over and k > 0 for k in range(len(runs))]
        each = zip(runs, paths, ghosts, strict=True)
        return [DrawnRun(run, clock * speed, path, of_file(run.mech), ghost, speed) for run, path, ghost in each]

    clock = playing_times(runs, speed, fps) if times is None else times
    drawn = drawn_at(clock)
    size = max(each.size for each in drawn) or 1.0
    more = max(each.bend() for each in drawn) / (BEND * size)
    if smooth and more > 1.0:
        clock = playing_times(runs, speed, np.ceil(np.sqrt(more)) * fps)
        drawn = drawn_at(clock)
    return drawn, clock, size


@dataclass(frozen=True)
class NotDrawn:
    """Loops whose forces are not determined, with the dependence of their rows, and joints that share their loads."""

    loops: dict[str, float] = field(default_factory=dict)
    joints: tuple[str, ...] = ()

    @classmethod
    def of(cls, drawn: list[DrawnRun]) -> "NotDrawn":
        loops: dict[str, float] = {}
        joints: dict[str, None] = {}
        for each in drawn:
            found = undetermined(each.run.mech, each.run.t, each.run.q)
            loops |= found
            joints |= dict.fromkeys(arrows.sharing(each.whole, found))
        return cls(loops, tuple(joints))

    @property
    def all(self) -> set[str]:
        """The names by which actions and curves are of them."""
        return {*self.loops, *map(arrows.of_joint, self.joints)}

    def __str__(self):
        text = not_determined(self.loops)
        return f"{text}; nor are those of {listed(self.joints)}, which share their loads" if self.joints else text


def _act(drawn: list[DrawnRun], size: float, not_drawn: NotDrawn, beside: bool) -> tuple[list[Action], dict, set[str]]:
    """Give the runs their arrows. All of them, the scale of each kind, and the kinds that are not seen at first.

    Those of joints of the tree are left out where runs are compared, and in films beside others.
    """
    compared = any(each.run.true is not None for each in drawn)
    for each in drawn:
        each.actions = arrows.actions(each.run, each.bodies, size, not_drawn.all)
        each.actions += contacts.contact_actions(each.run, each.bodies)
        if each.run.true is not None:
            color = WRONG if each is drawn[0] else None
            each.actions = [replace(action, color=color) for action in each.actions]
            each.actions = arrows.true_actions(each.run, each.bodies, size, not_drawn.all) + each.actions
    seen = [action for each in drawn for action in each.actions]
    if not compared and (beside or not seen):
        for each in drawn:
            each.actions = each.actions + arrows.joint_actions(each.run, each.bodies, not_drawn.all)
    acting = [action for each in drawn for action in each.actions]
    longest = arrows.longest_arrows([each.run.mech for each in drawn], seen or acting, size)
    scales = {kind: arrows.scale_of(kind, acting, longest[kind]) for kind in UNITS}
    return acting, scales, {JOINT} if seen else set()


def _scene(drawn: list[DrawnRun], axes: np.ndarray, planar: bool, size: float, clock: np.ndarray, over: bool) -> dict:
    """The commands that draw and move the runs beside or `over` each other, the view of them, and their titles."""
    offsets = [np.zeros(3)] * len(drawn) if over else _offsets([each.extent for each in drawn], axes[0], size)
    placed = list(zip(drawn, offsets, strict=True))
    commands = [command for each in drawn for command in each.commands]
    commands += [transform(each.path, pin.SE3(np.eye(3), offset).homogeneous) for each, offset in placed if each.path]
    commands += stage(axes, size)
    if not planar:
        commands.append(floor(np.concatenate([each.body + offset for each, offset in placed]), size))
    commands += animated([node for each in drawn for node in each.nodes], clock)
    named = [] if over else [pair for pair in placed if pair[0].run.title]
    titles = [(each.run.title, _below(each.body, axes, size) + offset) for each, offset in named]
    seen = [*(each.extent + offset for each, offset in placed), *(place[None] for _, place in titles)]
    view = {"axes": [y_up(axis) for axis in axes], "planar": planar, "size": size}
    return {
        "commands": commands,
        "view": view | {"points": outline(np.concatenate(seen), axes)},
        "titles": [{"text": text, "at": y_up(place)} for text, place in titles],
    }


def _stop(first, speed: float) -> dict:
    """What the page of a comparison says where it stops, at the end of the first step; `first` as in `picture`."""
    return {
        "wrong": f"{first.wrong}: {first.sizes}",
        "ok": first.ok,
        "verdict": first.verdict,
        "stop": first.order * first.h / speed,
        "of": first.loop,
        "colors": [WRONG, COLORS[FORCE]],
    }


def _frames(traces, runs) -> list[str]:
    if isinstance(traces, str):
        raise InputError(f"traces needs a sequence of frame names, like traces=[{traces!r}]")
    traces = list(dict.fromkeys(checked_names(traces, "traces")))
    for mech in (run.mech for run in runs):
        names = [frame.name for frame in mech.model.frames]
        if unknown := [name for name in traces if name not in names]:
            raise InputError(f"{mech.name}: no frame {unknown[0]!r} to trace{near(unknown[0], names)}")
    return traces


def _part(name: str) -> str:
    return name.replace("/", "∕") or "unnamed"  # a slash would split the path


def _offsets(extents, right: np.ndarray, size: float) -> list[np.ndarray]:
    """Offsets that place the runs in a row to the viewer's right, the first one without an offset."""
    ends = [((points @ right).min(), (points @ right).max()) for points in extents]
    shifts = [0.0]
    for (_, before), (start, _) in pairwise(ends):
        shifts.append(shifts[-1] + before + GAP * size - start)
    return [shift * right for shift in shifts]


def _below(points: np.ndarray, axes: np.ndarray, size: float) -> np.ndarray:
    """The point under the middle of others, as the viewer sees it."""
    low, high = np.min(points @ axes.T, axis=0), np.max(points @ axes.T, axis=0)
    return np.array([(low[0] + high[0]) / 2, low[1] - 0.06 * size, (low[2] + high[2]) / 2]) @ axes


def _legend(runs, traces, forces: bool, scales, acting, not_drawn: NotDrawn) -> list[dict]:
    out = [{"color": color, "text": f"path of {name}"} for name, color in zip(traces, cycle(TRACES), strict=False)]
    drawn = {LOOP_KINDS[loop.kind].drawn for run in runs for loop in run.mech.anchored_loops}
    if drawn:
        seats = [seat for form, seat in SEATS.items() if form in drawn]
        out.append({"color": LOOP, "text": f"loop: closed where its core sits {', '.join(seats)}"})
    out += [_bar(kind, scale, acting) for kind, scale in scales.items() if scale]
    out += contacts.legend(runs)
    if any(run.true is not None for run in runs):
        out += [{"color": WRONG, "text": "from exact values"}, {"color": RIGHT, "text": "true, under the others"}]
    if not_drawn.loops:
        out.append({"color": COLORS[FORCE], "text": f"not drawn: {not_drawn}"})
    elif forces and not any(scales.values()):
        out.append({"color": COLORS[FORCE], "text": "no forces to draw"})
    return out


def _over(runs) -> list[dict]:
    """Which of the runs over each other is which."""
    return [
        {"color": GHOST if k else LINK_COLORS[0], "text": f"{run.title}{'' if k else ', in the colours of its bodies'}"}
        for k, run in enumerate(runs)
    ]


def _bar(kind: str, scale, acting: list[Action]) -> dict:
    """An entry of the legend with a bar as long as the arrow of a round amount."""
    amount = arrows.round_amount(0.3 * scale.most)
    bar = {"metres": amount * scale.metres, "text": arrows.stated(amount, UNITS[kind])}
    text = _acting(kind, acting)
    if scale.cuts:
        text += f"; cut at {arrows.stated(scale.most, UNITS[kind], '.3g')}, with their size beside them"
    return {"color": COLORS[kind], "bar": bar, "text": text}


def _acting(kind: str, acting: list[Action]) -> str:
    """``force on the rocker_bar; torque in joint crank``: what arrows of a kind are, and where they act."""
    places: dict[tuple[str, bool], dict[str, None]] = {}
    for action in (each for each in acting if each.kind == kind):
        inside = bool(action.joint)
        places.setdefault((ACTS[kind, inside], inside), {})[action.joint if inside else action.bodies[0]] = None
    out = []
    for (what, inside), names in places.items():
        where = ("in joint" if len(names) == 1 else "in joints") if inside else "on the"
        out.append(f"{what} {where} {_few(list(names))}")
    return "; ".join(out)


def _few(names: list[str]) -> str:
    """``a, b and 3 more``"""
    *start, end = names if len(names) <= NAMED else [*names[: NAMED - 1], f"{len(names) - NAMED + 1} more"]
    return f"{', '.join(start)} and {end}" if start else end
