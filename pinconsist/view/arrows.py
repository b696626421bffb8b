"""Forces as straight arrows, moments as arrows that turn about their axis: choice, lengths and shapes."""

from dataclasses import dataclass, replace

import numpy as np

from ..mechanism.energy import torques_of
from ..mechanism.forces import Wrench
from ..mechanism.joint_constraints import Drive
from ..mechanism.loops import Loop
from ..mechanism.names import body_names
from ..mechanism.reactions import reactions
from ..mechanism.wrenches import Transmission
from .commands import Node
from .filled import only
from .motion import Run, accelerations_of, anchors, in_world, joint_axis, motors, point_in_world, rotation_to
from .shapes import OCTAHEDRON, SMALLEST, Shape, cylinder, link_ends, ring

FORCE, MOMENT, JOINT = "force", "moment", "joint force"
COLORS = {FORCE: 0x8E44AD, MOMENT: 0x2E7D32, JOINT: 0x1A237E}
WRONG, RIGHT = 0xD50000, 0x5F6B73  # colours of wrong forces, and of the true ones next to them
TRUE, WIDE = "true: ", 2.2  # of a true force: prefix of its name; width of its arrow, relative to the one above it
UNITS = {FORCE: "N", MOMENT: "N·m", JOINT: "N"}
PREFIXES = ((1e7, 1e6, "M"), (1e4, 1e3, "k"))  # amounts of at least the first have this prefix, as on the page
ARROW_LENGTHS = {
    FORCE: 0.5,
    MOMENT: 0.16,
    JOINT: 0.35,
}  # longest arrow, relative to the picture; shorter if parts are small
PARTS = 0.4, 2.0  # smallest factor of ARROW_LENGTHS; this factor relative to the size of the parts
RADIUS, HEAD = 0.011, 0.1  # radius of a shaft and length of a head, relative to the longest arrow
THINNEST = 0.55  # relative width of short arrows, so that they are visible in front of their loop
ARC = 1.5 * np.pi  # angle of a ring, rad
TUBE, TIP = 0.04, 0.35  # thickness of a ring and length of its head, relative to its radius
MOMENT_ROUNDING = 1e-9  # smaller moments, relative to the largest, are rounding, such as tilts of a planar hinge
SHARING_ROWS = 5  # rows at which it is found which joints share a load
MOSTLY = 95  # percentage of the time
SPIKE = 3.0  # an outlier exceeds the percentile MOSTLY by this factor


@dataclass(frozen=True, eq=False)
class Action:
    """A force, N, or a moment, N·m, over the frames."""

    name: str
    of: str  # the loop, the drive, the label of a force, "motor", or a joint, see `of_joint`
    kind: str  # FORCE, MOMENT or JOINT
    points: np.ndarray  # (m, 3), m, points at which it acts
    vectors: np.ndarray  # (m, 3), world axes
    bodies: tuple[str, ...] = ()  # the two bodies between which it acts, first the one on which it is drawn
    joint: str = ""  # in which it acts, if it is not applied to a body
    on_joint: np.ndarray | None = None  # (m,), signed; only for a drive or motor
    color: int | None = None

    @property
    def norms(self) -> np.ndarray:
        return np.linalg.norm(self.vectors, axis=1)


def of_joint(name: str) -> str:
    """The label of the force in a joint of the tree, distinct from that of a loop of the same name."""
    return f"joint {name}"


def actions(run: Run, poses: np.ndarray, size: float, without=frozenset()) -> list[Action]:
    """Forces and moments of the loops and of applied wrenches, torques of drives and motors.

    A loop acts on its body 2, or on its body 1 if the other is the ground. Drives and motors act on their joints; only
    joints with one degree of freedom are drawn. Couplings are not drawn: they act on two joints at once. The loops
    `without` determined forces, and moments that are rounding for a picture of this `size`, m, are left out.
    """
    out: list[Action] = []
    loops = {loop.name: loop for loop in run.mech.loops if loop.name not in without}
    for found in reactions(run.mech, loops, run.t, run.q, run.lam, workspace=run.workspace()):
        loop = loops[found.loop]
        if isinstance(loop, Loop):
            out += _of_loop(run, poses, loop, found)
        elif isinstance(loop, Drive):
            out += _on_joints(run, poses, loop.name, found.joint_forces)
    for wrench in (each for each in run.mech.forces if isinstance(each, Wrench)):
        out += _applied(run, wrench)
    if driving := motors(run.mech):
        bound = [force.bind(run.mech.model) for force in driving]
        workspace = run.workspace()
        torques = sum(torques_of(force, run.t, run.q, run.v, workspace) for force in bound)
        out += _on_joints(run, poses, "motor", torques)
    largest = max((each.norms.max() / (size if each.kind == MOMENT else 1.0) for each in out), default=0.0)
    return [each for each in out if each.kind == FORCE or each.norms.max() > MOMENT_ROUNDING * largest * size]


def _of_loop(run: Run, poses: np.ndarray, loop: Loop, found) -> list[Action]:
    """The force and, if there is one, the moment of a loop; see :func:`actions`."""
    (other, _), (joint, place) = anchors(run.mech.model, loop)
    points = point_in_world(poses, joint, place.translation)
    sign = 1.0 if joint else -1.0
    names = body_names(run.mech.model)
    bodies = tuple(names[each] for each in (joint, other) if each)
    out = [Action(loop.name, loop.name, FORCE, points, sign * found.force, bodies)]
    if found.moment.any():
        out.append(Action(f"{loop.name} moment", loop.name, MOMENT, points, sign * found.moment, bodies))
    return out


def _applied(run: Run, wrench: Wrench) -> list[Action]:
    """The force and the moment of a wrench; without those that are zero."""
    law, still = wrench.bind(run.mech.model), np.zeros(run.mech.nv)
    loads = [law.loads(t, q, still)[0] for t, q in zip(run.t, run.q, strict=True)]
    points, force, moment = (np.array(part) for part in zip(*(load[1:] for load in loads), strict=True))
    name = wrench.label
    bodies = (body_names(run.mech.model)[loads[0][0]],)
    parts = (name, FORCE, force), (f"{name} moment", MOMENT, moment)
    return [Action(title, name, kind, points, part, bodies) for title, kind, part in parts if part.any()]


def joint_wrenches(run: Run, without=frozenset()) -> dict[str, np.ndarray]:
    """What the joints of the tree transmit to their children, (n, 6) each; empty if it is not known."""
    acceleration = accelerations_of(run)
    if acceleration is None:
        return {}
    found = Transmission(run.mech, run.t, run.q, run.v, acceleration, run.lam, run.workspace()).wrenches()
    return {name: wrench for name, wrench in found.items() if of_joint(name) not in without}


def joint_actions(run: Run, poses: np.ndarray, without=frozenset()) -> list[Action]:
    """What the joints of the tree transmit to their children, if it is known, but for those `without` one."""
    names, out = body_names(run.mech.model), []
    for name, wrench in joint_wrenches(run, without).items():
        joint = run.mech.joint_index(name)
        about = {"bodies": (names[joint],), "joint": name}
        out.append(Action(f"{JOINT} {name}", of_joint(name), JOINT, poses[:, joint, :3], wrench[:, :3], **about))
    return out


def sharing(run: Run, loops) -> list[str]:
    """Joints of the tree that share their loads with one of the `loops`."""
    if not loops or accelerations_of(run) is None:
        return []
    few = only(run.source, np.unique(np.linspace(0, len(run.source.t) - 1, SHARING_ROWS).astype(int)))
    shared = {name: few.joint_force(name, run.mech).shared_with for name in run.mech.joints}
    return [name for name, others in shared.items() if any(other in loops for other in others)]


def true_actions(run: Run, poses: np.ndarray, size: float, without=frozenset()) -> list[Action]:
    """The true forces of the loops, in grey."""
    found = actions(run.true, poses, size, without) if run.true else []
    its = [each for each in found if each.of != "motor"]
    return [replace(each, name=TRUE + each.name, color=RIGHT) for each in its]


def _on_joints(run: Run, poses: np.ndarray, name: str, torques: np.ndarray) -> list[Action]:
    """Torques, shape (m, nv), on joints that turn, forces on those that slide; of one degree of freedom each."""
    names, out = body_names(run.mech.model), []
    for joint, joint_name in enumerate(run.mech.joints, start=1):
        torque = torques[:, run.mech.model.idx_vs[joint]]
        axis, turns = joint_axis(run.mech.model, joint)
        if axis is not None and torque.any():
            points = poses[:, joint, :3]
            vectors = torque[:, None] * (in_world(poses[:, joint], [axis])[:, 0] - points)
            kind = MOMENT if turns else FORCE
            about = {"bodies": (names[joint],), "joint": joint_name, "on_joint": torque}
            out.append(Action(f"{name} {joint_name}", name, kind, points, vectors, **about))
    return out


@dataclass(frozen=True)
class Scale:
    """The scale of arrows: ``metres`` for each N or N·m; those above ``most`` N or N·m are cut to ``longest`` m."""

    metres: float
    most: float
    longest: float
    cuts: bool


def longest_arrows(mechs, actions: list[Action], size: float) -> dict[str, float]:
    """Length of the longest arrow of each kind, m, in proportion to the parts on which the arrows act."""
    lengths = []
    for mech in mechs:
        ends = zip(body_names(mech.model)[1:], link_ends(mech).values(), strict=True)
        of_parts = {name: max(map(np.linalg.norm, its), default=0.0) for name, its in ends}
        found = [of_parts.get(each.bodies[0], 0.0) for each in actions if each.bodies]
        lengths += [length for length in found if length > 0]  # a point has no size
    least, times = PARTS
    share = float(np.clip(times * np.median(lengths or [size]) / size, least, 1.0))
    return {kind: share * size * length for kind, length in ARROW_LENGTHS.items()}


def scale_of(kind: str, actions: list[Action], longest: float) -> Scale | None:
    """One scale for all forces, or moments, of a picture; None if there are none.

    The largest has the longest arrow, unless it is an outlier, such as a peak near a dead centre: that is cut.
    """
    norms = [action.norms for action in actions if action.kind == kind]
    largest = max((each.max() for each in norms), default=0.0)
    if not largest > 1e-12:
        return None
    usual = max(np.percentile(each, MOSTLY) for each in norms)
    cuts = largest > SPIKE * usual > 0.0
    most = float(usual if cuts else largest)
    return Scale(longest / most, most, longest, cuts)


def stated(amount: float, unit: str, digits: str = "g") -> str:
    """An amount with its unit; large ones in k or M."""
    factor, prefix = next(((factor, prefix) for least, factor, prefix in PREFIXES if amount >= least), (1.0, ""))
    return f"{amount / factor:{digits}} {prefix}{unit}"


def round_amount(amount: float) -> float:
    """The largest number 1, 2 or 5 times a power of ten that does not exceed `amount`."""
    power = 10.0 ** np.floor(np.log10(amount))
    return float(max(step for step in (1, 2, 5) if step * power <= amount * (1 + 1e-12)) * power)


Parts = list[tuple[Node, list[Shape]]]


def arrow(path: str, action: Action, scale: Scale) -> tuple[Parts, np.ndarray]:
    """The moving parts of an action's arrow with their shapes; and points around it, shape (m, k, 3).

    A moment is three quarters of a ring about its axis with a head at its end, right-handed; its radius is the scale.
    """
    norms = action.norms
    reach = np.minimum(norms * scale.metres, scale.longest)
    along = action.vectors / np.where(norms > 0, norms, 1.0)[:, None]
    along[norms == 0] = (0.0, 1.0, 0.0)
    opacity = 0.55 if action.color == RIGHT else 0.85
    look = {"color": action.color or COLORS[action.kind], "on_top": 2, "opacity": opacity}
    if action.kind == MOMENT:
        return _turning(path, action.points, along, reach, look)
    return _straight(path, action.points, along, reach, scale.longest, look)


def _straight(path, points, along, reach, longest: float, look) -> tuple[Parts, np.ndarray]:
    """A shaft and a head along unit vectors, shape (m, 3), from points on; lengths `reach`, shape (m,), m."""
    wide = WIDE if look["color"] == RIGHT else 1.0
    radius = wide * RADIUS * longest
    head = HEAD * longest
    short = np.minimum(1.0, reach / (2 * head))  # the head is at most half of the arrow
    thin = np.minimum(short.clip(THINNEST), 5 * short)
    length = reach - head * short
    turns = np.array([rotation_to(each).coeffs() for each in along])
    shaft = Node(f"{path}/shaft", np.hstack((points, turns)), np.column_stack((thin, length, thin)).clip(SMALLEST))
    necks = np.hstack((points + along * length[:, None], turns))
    pointed = Node(f"{path}/head", necks, np.column_stack((thin, short, thin)).clip(SMALLEST))
    tip = cylinder(0, np.zeros(3), (0.0, head, 0.0), 2.8 * radius, tip=0.0, **look)
    parts = [(shaft, [cylinder(0, np.zeros(3), (0.0, 1.0, 0.0), radius, **look)]), (pointed, [tip])]
    return parts, (points + along * reach[:, None])[:, None]


def _turning(path, points, along, reach, look) -> tuple[Parts, np.ndarray]:
    """A ring with a head about unit vectors, shape (m, 3), at points; radii `reach`, shape (m,), m."""
    turns = np.array([rotation_to(each, (0, 0, 1)).coeffs() for each in along])
    end = np.array([np.cos(ARC), np.sin(ARC), 0.0])
    cone = cylinder(0, end, end + TIP * np.array([-end[1], end[0], 0.0]), 2.8 * TUBE, tip=0.0, **look)
    node = Node(f"{path}/turn", np.hstack((points, turns)), np.repeat(reach[:, None], 3, axis=1).clip(SMALLEST))
    return [(node, [ring(0, ARC, TUBE, **look), cone])], points[:, None] + reach[:, None, None] * OCTAHEDRON
