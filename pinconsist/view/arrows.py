"""Forces as straight arrows, moments as arrows that turn about their axis: which there are, how long, how drawn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..mechanism.loops import Loop
from ..mechanism.reactions import reaction
from .commands import Node
from .motion import Run, anchors, in_world, joint_axis, motors, point_in_world, rotation_to
from .shapes import OCTAHEDRON, SMALLEST, Shape, cylinder, ring

FORCE, MOMENT = "force", "moment"
COLORS = {FORCE: 0x6A1B9A, MOMENT: 0x1B5E20}
UNITS = {FORCE: "N", MOMENT: "N·m"}
COMMON = {FORCE: 0.25, MOMENT: 0.08}  # sizes of the picture: length or radius of a common arrow
LONGEST = {FORCE: 0.5, MOMENT: 0.16}  # of the longest one
RADIUS, HEAD = 0.006, 0.05  # of a shaft; length of a head; in sizes of the picture
ARC = 1.5 * np.pi  # of a ring, rad
TUBE, TIP = 0.05, 0.4  # thickness of a ring and length of its head, in its radii
ROUNDING = 1e-9  # of the largest: below it a moment is rounding, such as a hinge's tilts in a planar loop


@dataclass(frozen=True, eq=False)
class Action:
    """A force, N, or a moment, N·m, over the frames."""

    name: str
    kind: str  # FORCE or MOMENT
    points: np.ndarray  # (m, 3), m, where it acts
    vectors: np.ndarray  # (m, 3), world axes
    on_joint: bool = False  # of a drive or motor; else of a loop

    @property
    def norms(self) -> np.ndarray:
        """Euclidean norms at every frame, shape (m,)."""
        return np.linalg.norm(self.vectors, axis=1)


def actions(run: Run, poses: np.ndarray, size: float, without=frozenset()) -> list[Action]:
    """Forces and moments of the loops, torques of drives and motors.

    A loop acts on its body 2, or on its body 1 where the other is the ground; drives and motors act on their joints,
    of which those with one degree of freedom are drawn. Couplings are not drawn: they act on two joints at once. Left
    out are the loops `without` determined forces, and moments that are rounding for a picture of this `size`, m.
    """
    out = []
    for loop in (each for each in run.mech.loops if each.name not in without):
        found = reaction(run.mech, loop.name, run.t, run.q, run.lam)
        if isinstance(loop, Loop):
            joint, place = anchors(run.mech.model, loop)[1]
            points, sign = point_in_world(poses, joint, place.translation), 1.0 if joint else -1.0
            out.append(Action(loop.name, FORCE, points, sign * found.force))
            if found.moment.any():
                out.append(Action(f"{loop.name} moment", MOMENT, points, sign * found.moment))
        elif loop.kind == "drive":
            out += _on_joints(run, poses, loop.name, found.joint_forces)
    if driving := motors(run.mech):
        bound = [force.bind(run.mech.model) for force in driving]
        states = zip(run.t, run.q, run.v, strict=True)
        torques = np.array([sum(each.torque(*state) for each in bound) for state in states])
        out += _on_joints(run, poses, "motor", torques)
    largest = max((each.norms.max() / (size if each.kind == MOMENT else 1.0) for each in out), default=0.0)
    return [each for each in out if each.kind == FORCE or each.norms.max() > ROUNDING * largest * size]


def _on_joints(run: Run, poses: np.ndarray, name: str, torques: np.ndarray) -> list[Action]:
    """Torques, shape (m, nv), on joints that turn, forces on those that slide; of one degree of freedom each."""
    out = []
    for joint, joint_name in enumerate(run.mech.joints, start=1):
        torque, (axis, turns) = torques[:, run.mech.model.idx_vs[joint]], joint_axis(run.mech.model, joint)
        if axis is not None and torque.any():
            points = poses[:, joint, :3]
            vectors = torque[:, None] * (in_world(poses[:, joint], [axis])[:, 0] - points)
            out.append(Action(f"{name} {joint_name}", MOMENT if turns else FORCE, points, vectors, on_joint=True))
    return out


@dataclass(frozen=True)
class Scale:
    """How large arrows are: ``metres`` for each N or N·m, none more than ``most``; ``text`` says so to a person."""

    metres: float
    most: float
    text: str


def scale_of(kind: str, actions: list[Action], size: float) -> Scale | None:
    """One scale for all forces, or moments, of a picture; None where there are none.

    It is made for common ones: the median, on a logarithmic scale, of what each exceeds a quarter of the time. Larger
    ones are cut, such as those of wrong multipliers at the start, near dead centres, or of inconsistent loops.
    """
    norms = [action.norms for action in actions if action.kind == kind]
    largest = max((each.max() for each in norms), default=0.0)
    if not largest > 1e-12:
        return None
    visible = [each[each > 1e-6 * largest] for each in norms]
    common = np.exp(np.median([np.log(np.percentile(each, 75)) for each in visible if each.size]))
    unit, most, exact = UNITS[kind], LONGEST[kind] * size, common / (COMMON[kind] * size)
    power = 10.0 ** np.floor(np.log10(exact))
    per_metre = float(min((1, 2, 5, 10), key=lambda step: abs(np.log(exact / (step * power)))) * power)
    length = 10.0 ** np.floor(np.log10(COMMON[kind] * size))
    what = "m of arrow" if kind == FORCE else "m of radius"
    cut = f", larger ones cut at {most * per_metre:.3g} {unit}" if largest > most * per_metre else ""
    return Scale(1 / per_metre, most, f"{length:g} {what} is {length * per_metre:.3g} {unit}{cut}")


def arrow(path: str, action: Action, scale: Scale, size: float) -> tuple[list[tuple[Node, list[Shape]]], np.ndarray]:
    """The moving parts of an action's arrow with their shapes; and points around it, shape (m, k, 3).

    A moment is three quarters of a ring about its axis with a head at its end, right-handed; its radius is the scale.
    """
    norms, points, look = action.norms, action.points, {"color": COLORS[action.kind], "on_top": True}
    reach = np.minimum(norms * scale.metres, scale.most)
    along = action.vectors / np.where(norms > 0, norms, 1.0)[:, None]
    along[norms == 0] = (0.0, 1.0, 0.0)
    axis = (0, 1, 0) if action.kind == FORCE else (0, 0, 1)
    turns = np.array([rotation_to(each, axis).coeffs() for each in along])
    if action.kind == FORCE:
        radius, head = RADIUS * size, HEAD * size
        thin = np.minimum(1.0, reach / (2 * head))  # a short arrow is thinner: its head is half of it at most
        length = reach - head * thin
        shaft = Node(f"{path}/shaft", np.hstack((points, turns)), np.column_stack((thin, length, thin)).clip(SMALLEST))
        necks = np.hstack((points + along * length[:, None], turns))
        pointed = Node(f"{path}/head", necks, np.repeat(thin[:, None], 3, axis=1).clip(SMALLEST))
        tip = cylinder(0, np.zeros(3), (0.0, head, 0.0), 2.4 * radius, tip=0.0, **look)
        parts = [(shaft, [cylinder(0, np.zeros(3), (0.0, 1.0, 0.0), radius, **look)]), (pointed, [tip])]
        return parts, (points + along * reach[:, None])[:, None]
    end = np.array([np.cos(ARC), np.sin(ARC), 0.0])
    cone = cylinder(0, end, end + TIP * np.array([-end[1], end[0], 0.0]), 2.6 * TUBE, tip=0.0, **look)
    node = Node(f"{path}/turn", np.hstack((points, turns)), np.repeat(reach[:, None], 3, axis=1).clip(SMALLEST))
    return [(node, [ring(0, ARC, TUBE, **look), cone])], points[:, None] + reach[:, None, None] * OCTAHEDRON
