"""A graph of bodies and joints, cut into a tree and loops; its couplings; and the tree as a pin.Model.

The readers of SDF, USD and Webots files make such graphs. The tree is a spanning tree of maximum weight. A joint with
few constraint rows is cheap to cut, so a ball is cut rather than a hinge; a joint with a force in it (damping,
friction, a spring, a coupling) belongs in the tree, where it has a coordinate. If such a joint must close a loop
nevertheless, it is added to the tree with a massless copy of its child link, and six rows hold the copy to the link.
Between joints of equal weight, the tree prefers the shortest chains. A file may request a cut.

A ball that is cut becomes a point, a revolute or continuous joint a hinge, a prismatic joint a slider, a fixed joint a
frame, a universal joint with perpendicular axes a universal, a slide and a hinge about it a cylinder, two slides and a
hinge normal to them a plane. Other joints are copied.
"""

import heapq
import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from ..errors import FormatError, warn
from ..mechanism.checks import places
from ..mechanism.joint_constraints import Coupling
from ..mechanism.loops import GROUND, Loop, anchor
from .reading import require_known, short_repr
from .urdf import ROOT_JOINT

WORLD = "world"
_KINDS = {"ball": "point", "revolute": "hinge", "prismatic": "slider", "fixed": "frame", "universal": "universal"}
_ROWS = {"ball": 3, "universal": 4, "revolute": 5, "prismatic": 5, "screw": 5, "fixed": 6}
_ACTS, _ASKED = 10, 100
_PERPENDICULAR = 1e-6
_ALONG = 1e-3  # sine of the largest angle between the axis of a gearbox and that of its joint


class Follower(NamedTuple):
    """What an axis follows: its position = ratio · position of the leader's axis + offset."""

    joint: str
    axis: int
    ratio: float
    offset: float


@dataclass(frozen=True, eq=False)
class Axis:
    """One axis of a joint, in the joint's frame, and the parameters of the motion along it (SI units)."""

    direction: np.ndarray
    damping: float = 0.0
    friction: float = 0.0
    stiffness: float = 0.0
    reference: float = 0.0
    lower: float = -math.inf
    upper: float = math.inf
    effort: float = math.inf
    velocity: float = math.inf
    initial: float | tuple[float, ...] = 0.0  # the quaternion x, y, z, w of a ball
    follows: Follower | None = None
    kind: str = ""  # of a compound: revolute, prismatic or ball
    label: str = ""  # of a compound: the end of the name of its joint
    armature: float = 0.0


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint between two bodies. At zero its frames on both coincide."""

    name: str
    kind: str  # revolute, prismatic, screw, ball, fixed, universal, gearbox; or compound: its axes, one after the other
    parent: str  # a body, or ``"world"``
    child: str
    on_parent: pin.SE3  # its frame on the parent
    on_child: pin.SE3
    axes: tuple[Axis, ...]  # as many as the kind has; the axis of a ball stands for all directions
    pitch: float = 0.0  # of a screw: m per revolution, positive for a right-handed thread
    ratio: float = 1.0  # of a gearbox: θ₂ = -ratio θ₁, the angles of child and parent relative to the body `reference`
    reference: str = ""
    must_cut: bool = False  # the file requests that this joint close a loop
    armature: float = 0.0  # of Drake's ``gear_ratio`` and ``rotor_inertia``, kg·m² or kg

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the joints that it becomes: one for each axis if it has several."""
        if self.kind == "universal":
            return f"{self.name}_axis", f"{self.name}_axis2"
        if self.kind == "compound" and len(self.axes) > 1:
            return tuple(f"{self.name}_{axis.label}" for axis in self.axes)
        return (self.name,)


class Body(NamedTuple):
    """A body: its pose in the world in the configuration of the file, and whether it never moves."""

    pose: pin.SE3
    static: bool = False


@dataclass
class Scene:
    """The bodies of a file by their names."""

    bodies: dict[str, Body]
    frames: dict[str, tuple[str, pin.SE3]] = field(default_factory=dict)  # name → body, pose in the world
    roots: Sequence[str] = ()  # the bodies that the file names as roots
    gravity: np.ndarray | None = None  # m/s²; None: the default


def spanning_tree(
    ends: Sequence[tuple[str, str]], weights: Sequence[float], held: Iterable[str], candidates: Iterable[str]
) -> tuple[list[tuple[int, str, str]], list[str]]:
    """The spanning tree of maximum weight (Prim's algorithm): its branches, and its roots other than `held`.

    A branch is the index of a joint, the body where it starts, which is nearer to a root, and the body where it ends.
    Ties go to joints that lead from parent to child, then to short chains, then to the order given. `ends` are the
    parent and the child body of each joint. `candidates` are all bodies; each one that no joint connects to an earlier
    root becomes a root.
    """
    at: dict[str, list[int]] = {}
    for joint, pair in enumerate(ends):
        for body in pair:
            at.setdefault(body, []).append(joint)
    reached, heap, branches, roots = set(), [], [], []

    def reach(body, depth):
        reached.add(body)
        for joint in at.get(body, ()):
            parent, child = ends[joint]
            other = parent if body == child else child
            if other not in reached:
                heapq.heappush(heap, (-weights[joint], body == child, depth + 1, joint, body, other))

    for body in held:
        reach(body, 0)
    for body in (None, *candidates):
        if body is not None and body not in reached:
            roots.append(body)
            reach(body, 0)
        while heap:
            _, _, depth, joint, start, end = heapq.heappop(heap)
            if end not in reached:
                branches.append((joint, start, end))
                reach(end, depth)
    return branches, roots


class JointGraph:
    """The joints of a file as a tree and loops.

    `joints` are the joints of which at least one body can move. `held` are the bodies that do not move, the world
    first, and `roots` the starting bodies of trees that no joint connects to them. `branches` are the tree, in the
    order of the file. The other joints close loops: `copied` joints by a copy of the child, `cut` joints by rows of
    their own kind.
    """

    def __init__(self, document, joints: Sequence[Joint]):
        bodies = document.bodies
        self.held = (WORLD, *(name for name, body in bodies.items() if body.static))
        self.joints = [j for j in joints if j.kind != "gearbox" and not {j.parent, j.child} <= {*self.held}]
        whole = {joint.name for joint in self.joints if _needs_coordinates(joint)} | _coupled(joints)
        weights = [_rows(j) + _ACTS * (j.name in whole) - _ASKED * j.must_cut for j in self.joints]
        children = {joint.child for joint in self.joints}
        candidates = (*document.roots, *(body for body in bodies if body not in children), *bodies)
        ends = [(joint.parent, joint.child) for joint in self.joints]
        branches, self.roots = spanning_tree(ends, weights, self.held, candidates)
        self.branches = sorted(branches)
        used = {number for number, _, _ in branches}
        loose = [joint for number, joint in enumerate(self.joints) if number not in used]
        loose = self._moving(loose, [self.joints[number] for number in used])
        self.copied = [joint for joint in loose if joint.name in whole]
        self.cut = [joint for joint in loose if joint.name not in whole]

    def _moving(self, loose, branches) -> list[Joint]:
        """The joints that close loops, without those between bodies that are fixed to each other."""
        carrier = dict.fromkeys(self.held, WORLD)

        def of(body):
            while carrier.get(body, body) != body:
                body = carrier[body]
            return body

        for joint in branches:
            if joint.kind == "fixed" or not joint.axes:
                carrier[of(joint.child)] = of(joint.parent)
        for joint in loose:
            if of(joint.parent) == of(joint.child):
                warn(f"joint {joint.name!r} has no effect: {joint.parent!r} and {joint.child!r} do not move relatively")
        return [joint for joint in loose if of(joint.parent) != of(joint.child)]

    def loops(self) -> list[Loop]:
        """The loops. Their anchors are the joint's frames on both bodies."""
        loops = []
        for joint in self.copied:
            ends = anchor(1, pin.SE3.Identity()) | anchor(2, pin.SE3.Identity())
            loops.append(Loop(joint.name, "frame", copy_name(joint), joint.child, **ends))
        return loops + [_cut(joint) for joint in self.cut]


def copy_name(joint: Joint) -> str:
    """Name of the frame on a joint's copy of its child."""
    return f"{joint.name}_end"


def _rows(joint) -> int:
    if joint.kind == "compound":
        return 6 - sum(3 if axis.kind == "ball" else 1 for axis in joint.axes)
    return _ROWS[joint.kind]


def _needs_coordinates(joint):
    """Whether a joint needs its coordinates even if it closes a loop."""
    if joint.kind == "screw" or any(a.damping or a.friction or a.stiffness or a.follows for a in joint.axes):
        return True
    return _closure(joint) is None


def _closure(joint) -> dict | None:
    """The kind and the axes of the loop that a joint closes; None if no loop leaves its motion free."""
    directions = [tuple(axis.direction.tolist()) for axis in joint.axes]
    kinds = [axis.kind for axis in joint.axes]
    slides, turns = ([d for d, kind in zip(directions, kinds, strict=True) if kind == word] for word in _MOTIONS)
    if joint.kind != "compound":
        kind = _KINDS.get(joint.kind)
        if kind in ("hinge", "slider"):
            return {"kind": kind, "axis": directions[0]}
        if kind != "universal":
            return {"kind": kind}
        turns = directions
    elif "ball" in kinds or len(turns) == 3:
        return {"kind": "point"} if not slides else None
    elif not slides and len(turns) < 2:
        return {"kind": "hinge", "axis": turns[0]} if turns else {"kind": "frame"}
    elif len(slides) == 1 and not turns:
        return {"kind": "slider", "axis": slides[0]}
    elif len(slides) == 1 and len(turns) == 1:
        return {"kind": "cylinder", "axis": turns[0]} if _sine(slides[0], turns[0]) < _PERPENDICULAR else None
    elif len(slides) == 2 and len(turns) == 1:
        normal = max(abs(np.dot(slide, turns[0])) for slide in slides) < _PERPENDICULAR
        return {"kind": "plane", "axis": turns[0]} if normal else None
    elif slides:
        return None
    if abs(np.dot(turns[0], turns[1])) > _PERPENDICULAR:
        return None
    return {"kind": "universal", "axis": turns[0], "axis2": turns[1]}


_MOTIONS = "prismatic", "revolute"


def _sine(one, two) -> float:
    return float(np.linalg.norm(np.cross(one, two)))


def _cut(joint):
    ends = anchor(1, joint.on_parent) | anchor(2, joint.on_child)
    frame1 = GROUND if joint.parent == WORLD else joint.parent
    frame2 = GROUND if joint.child == WORLD else joint.child
    return Loop(joint.name, frame1=frame1, frame2=frame2, **_closure(joint), **ends)


def couplings(joints: Sequence[Joint]) -> list[Coupling]:
    """The gearboxes and mimic joints of a file as couplings of two joints; FormatError if one of these is missing.

    A gearbox enforces θ₂ = -ratio θ₁, where θ₁ is the angle from its reference body to its parent about its first
    axis, and θ₂ the angle from the reference body to its child about the second.
    """
    made, by_name = [], {joint.name: joint for joint in joints}
    for joint in joints:
        if joint.kind == "gearbox":
            first, second = _geared(joints, joint)
            signs = _sign(joint, 0, first, joint.parent) * _sign(joint, 1, second, joint.child)
            made.append(Coupling(joint.name, second.name, first.name, ratio=-joint.ratio * signs))
        else:
            axes = zip(joint.parts, joint.axes, strict=False)
            made += [_follow(by_name, joint, part, axis.follows) for part, axis in axes if axis.follows]
    return made


def _coupled(joints):
    names = {axis.follows.joint for joint in joints for axis in joint.axes if axis.follows}
    return names.union(*({j.name for j in _geared(joints, box)} for box in joints if box.kind == "gearbox"))


def _geared(joints, gearbox):
    """The hinges between a gearbox's reference body and its parent and child."""
    found = []
    for body in (gearbox.parent, gearbox.child):
        ends = {gearbox.reference, body}
        between = [joint for joint in joints if joint.kind == "revolute" and {joint.parent, joint.child} == ends]
        if len(between) != 1:
            reason = f"it needs one revolute joint between its reference body {gearbox.reference!r} and {body!r}"
            raise FormatError(f"{reason}, but there are {len(between)}", element=f"joint {gearbox.name!r}")
        found += between
    return found


def _sign(gearbox, number, joint, body) -> float:
    """+1 if the angle of a joint is that of the gearbox, -1 if it is the opposite."""
    end = "child" if body == gearbox.child else "parent"
    axis = getattr(gearbox, f"on_{end}").rotation @ gearbox.axes[number].direction
    on = joint.on_child if joint.child == body else joint.on_parent
    own = on.rotation @ joint.axes[0].direction
    if np.linalg.norm(np.cross(axis, own)) > _ALONG:
        reason = f"its {('axis', 'axis2')[number]} is not parallel to that of joint {joint.name!r}"
        raise FormatError(reason, element=f"joint {gearbox.name!r}")
    return np.sign(axis @ own) * (1.0 if joint.child == body else -1.0)


def _follow(by_name, joint, part, follower):
    element = f"joint {joint.name!r}: mimic"
    require_known(follower.joint, by_name, f"there is no joint {follower.joint!r}", element)
    leader = by_name[follower.joint]
    if leader.kind in ("gearbox", "ball") or follower.axis >= len(leader.axes):
        raise FormatError(f"joint {leader.name!r} has no such axis", element=element)
    other = leader.parts[follower.axis]
    if other == part:
        raise FormatError("a joint cannot follow itself", element=element)
    return Coupling(f"{part} mimic", part, other, ratio=follower.ratio, offset=follower.offset)


def build(scene, graph: JointGraph, inertias: Mapping[str, pin.Inertia], name: str, floating: Iterable[str]):
    """The model of a graph, and the initial positions of its joints and floating roots by the names of their joints.

    The roots in `floating` float; the others are fixed at their poses. `inertias` are those of the links, in their own
    frames. FormatError if names clash, or if nothing moves or floats.
    """
    tree, guess = _Tree(scene, graph, inertias, name), {}
    for body in graph.held:
        tree.add_subtree(body, tree.place(body))
    for body in graph.roots:
        if body in floating:
            root, pose = ROOT_JOINT if len(floating) == 1 else f"{body}_{ROOT_JOINT}", scene.bodies[body].pose
            carrier = tree.add(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), root)
            guess[root] = pin.SE3ToXYZQUAT(pose)
            tree.add_subtree(body, (carrier, pin.SE3.Identity()))
        else:
            tree.add_subtree(body, tree.place(body))
    for frame, (body, pose) in scene.frames.items():
        own = pose if body == WORLD else scene.bodies[body].pose.actInv(pose)
        tree.add_frame(frame, body, own, pin.FrameType.OP_FRAME)
    for joint in graph.cut:
        tree.add_frame(joint.name, joint.child, joint.on_child, pin.FrameType.OP_FRAME)
    if not tree.model.nv:
        raise FormatError("nothing can move: all joints are fixed")
    return tree.model, guess | tree.guess


class _Tree:
    def __init__(self, scene, graph, inertias, name):
        self.model = pin.Model()
        self.model.name = name
        if scene.gravity is not None:
            self.model.gravity.linear = scene.gravity
        self._scene, self._inertias = scene, inertias
        self._branches = defaultdict(list)  # body → (joint, outer body) of its branches; None: a copy of the child
        for number, start, end in graph.branches:
            self._branches[start].append((graph.joints[number], end))
        for joint in graph.copied:
            self._branches[joint.parent].append((joint, None))
        self._at = {WORLD: (0, pin.SE3.Identity())}  # body → the joint that carries it, and its place on it
        self.guess: dict[str, float] = {}

    def place(self, body):
        """Where a body that does not move is on the ground."""
        return 0, pin.SE3.Identity() if body == WORLD else self._scene.bodies[body].pose

    def add_subtree(self, root, at):
        """Add a body and its descendants, depth first."""
        waiting = self._add_body(root, at)
        while waiting:
            joint, end = waiting.pop()
            forward = end != joint.parent
            at = self._add_joint(joint, forward)
            if end is None:
                self._at[copy_name(joint)] = at
                self.add_frame(copy_name(joint), copy_name(joint), pin.SE3.Identity(), pin.FrameType.OP_FRAME)
            else:
                waiting += self._add_body(end, at)

    def _add_body(self, name, at):
        """Add a body; return its branches, the first one last."""
        self._at[name] = at
        carrier, place = at
        if name != WORLD:
            if carrier:
                self.model.appendBodyToJoint(carrier, self._inertias[name], place)
            self.add_frame(name, name, pin.SE3.Identity(), pin.FrameType.BODY)
        return list(reversed(self._branches[name]))

    def add(self, parent, joint, place, name):
        """Add a joint with its placement on the parent; return its index."""
        if self.model.existJointName(name):
            raise FormatError("another joint has this name", element=f"joint {short_repr(name)}")
        index = self.model.addJoint(parent, joint, place, name)
        self.model.addJointFrame(index)
        return index

    def _add_joint(self, joint: Joint, forward):
        """Add a joint of the file; return the joint of the model that carries its other body, and that body's place."""
        start, first, last = (joint.parent, joint.on_parent, joint.on_child) if forward else (
            joint.child, joint.on_child, joint.on_parent
        )  # fmt: skip
        carrier, place = self._at[start]
        if joint.kind == "fixed" or not joint.axes:
            self.add_frame(joint.name, start, first, pin.FrameType.FIXED_JOINT)
            return carrier, place * first * last.inverse()
        place = place * first
        # backwards, the parent moves relative to the child: the same coordinates along the opposite axes
        parts = list(zip(joint.parts, joint.axes, strict=True))
        for name, axis in parts if forward else parts[::-1]:
            motion = _joint_model(joint, axis, axis.direction if forward else -axis.direction)
            carrier = self.add(carrier, motion, place, name)
            _set_values(self.model, carrier, axis)
            if axis.initial:
                self.guess[name] = axis.initial
            place = pin.SE3.Identity()
        return carrier, last.inverse()

    def add_frame(self, name, body, own, kind):
        """Add a frame at the place `own` on a body."""
        carrier, place = self._at[body]
        parent = self.model.getFrameId(self.model.names[carrier], pin.FrameType.JOINT) if carrier else 0
        self.model.addFrame(pin.Frame(name, carrier, parent, place * own, kind), False)


def _set_values(model, joint, axis):
    q, v = places(model, joint)
    model.damping[v] = axis.damping
    model.armature[v] = axis.armature
    model.upperDryFrictionLimit[v], model.lowerDryFrictionLimit[v] = axis.friction, -axis.friction
    model.upperEffortLimit[v], model.lowerEffortLimit[v] = axis.effort, -axis.effort
    model.upperVelocityLimit[v], model.lowerVelocityLimit[v] = axis.velocity, -axis.velocity
    if model.nqs[joint] == 1:
        model.lowerPositionLimit[q], model.upperPositionLimit[q] = axis.lower, axis.upper


def _joint_model(joint: Joint, axis: Axis, direction):
    kind = axis.kind if joint.kind == "compound" else joint.kind
    if kind == "ball":
        return pin.JointModelSpherical()
    if kind == "prismatic":
        return pin.JointModelPrismaticUnaligned(direction)
    if kind == "screw":
        return pin.JointModelHelicalUnaligned(direction, joint.pitch / (2 * np.pi))
    return pin.JointModelRevoluteUnaligned(direction)
