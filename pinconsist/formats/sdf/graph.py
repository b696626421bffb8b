"""The graph of joints of an SDF file, cut into a tree and loops; its couplings; and the tree as a pin.Model.

The tree is a spanning tree of maximum weight. A joint with few constraint rows is cheap to cut, so a ball is cut rather
than a hinge; a joint with a force in it (damping, friction, a spring, a coupling) belongs in the tree, where it has a
coordinate. If such a joint must close a loop nevertheless, it is added to the tree with a massless copy of its child
link, and six rows hold the copy to the link. Between joints of equal weight, the tree prefers the shortest chains.
``<must_be_loop_joint>`` requests a cut.

A ball that is cut becomes a point, a revolute or continuous joint a hinge, a prismatic joint a slider, a fixed joint a
frame, and a universal joint with perpendicular axes a universal. Other universal joints and screws are copied.
"""

import heapq
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import pinocchio as pin

from ...errors import FormatError
from ...mechanism.checks import places
from ...mechanism.joint_constraints import Coupling
from ...mechanism.loops import GROUND, Loop, anchor
from ..reading import require_known, short_repr
from ..urdf import ROOT_JOINT
from .document import WORLD, Document
from .joints import Joint

_KINDS = {"ball": "point", "revolute": "hinge", "prismatic": "slider", "fixed": "frame", "universal": "universal"}
_ROWS = {"ball": 3, "universal": 4, "revolute": 5, "prismatic": 5, "screw": 5, "fixed": 6}
_ACTS, _ASKED = 10, 100
_PERPENDICULAR = 1e-6
_ALONG = 1e-3  # sine of the largest angle between the axis of a gearbox and that of its joint


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

    def __init__(self, document: Document, joints: Sequence[Joint]):
        bodies = document.bodies
        self.held = (WORLD, *(name for name, body in bodies.items() if body.static))
        self.joints = [j for j in joints if j.kind != "gearbox" and not {j.parent, j.child} <= {*self.held}]
        whole = {joint.name for joint in self.joints if _needs_coordinates(joint)} | _coupled(joints)
        weights = [_ROWS[j.kind] + _ACTS * (j.name in whole) - _ASKED * j.must_cut for j in self.joints]
        children = {joint.child for joint in self.joints}
        candidates = (*document.roots, *(body for body in bodies if body not in children), *bodies)
        ends = [(joint.parent, joint.child) for joint in self.joints]
        branches, self.roots = spanning_tree(ends, weights, self.held, candidates)
        self.branches = sorted(branches)
        used = {number for number, _, _ in branches}
        loose = [joint for number, joint in enumerate(self.joints) if number not in used]
        self.copied = [joint for joint in loose if joint.name in whole]
        self.cut = [joint for joint in loose if joint.name not in whole]

    def loops(self, document: Document) -> list[Loop]:
        """The loops. Their anchors are the joint's frame on both bodies, so that all loops are closed at q = 0."""
        loops = [_loop(joint, document, "frame", copy_name(joint), joint.child) for joint in self.copied]
        return loops + [_loop(joint, document, _KINDS[joint.kind], joint.parent, joint.parent) for joint in self.cut]


def copy_name(joint: Joint) -> str:
    """Name of the frame on a joint's copy of its child."""
    return f"{joint.name}_end"


def _needs_coordinates(joint):
    """Whether a joint needs its coordinates even if it closes a loop."""
    if joint.kind == "universal" and abs(joint.axes[0].direction @ joint.axes[1].direction) > _PERPENDICULAR:
        return True
    return joint.kind == "screw" or any(a.damping or a.friction or a.stiffness or a.follows for a in joint.axes)


def _loop(joint, document, kind, frame1, body1):
    fields = {}
    for number, body in ((1, body1), (2, joint.child)):
        fields |= anchor(number, joint.pose if body == WORLD else document.bodies[body].pose.actInv(joint.pose))
    if kind in ("hinge", "slider", "universal"):
        fields |= {key: tuple(axis.direction) for key, axis in zip(("axis", "axis2"), joint.axes, strict=False)}
    return Loop(joint.name, kind, GROUND if frame1 == WORLD else frame1, joint.child, **fields)


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
    axis = gearbox.pose.rotation @ gearbox.axes[number].direction
    own = joint.pose.rotation @ joint.axes[0].direction
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


def build(document: Document, graph: JointGraph, inertias: Mapping[str, pin.Inertia], name: str, free_flyer: bool):
    """The model of a graph, and the configurations of its floating roots by the names of their joints.

    With `free_flyer` the roots float; otherwise they are fixed at their poses. `inertias` are those of the links, in
    their own frames. FormatError if names clash, or if nothing moves or floats.
    """
    if free_flyer and not graph.roots:
        raise FormatError("nothing can float: all links are connected to the world; omit free_flyer")
    tree, guess = _Tree(document, graph, inertias, name), {}
    for body in graph.held:
        tree.add_subtree(body)
    for body in graph.roots:
        if free_flyer:
            root, pose = ROOT_JOINT if len(graph.roots) == 1 else f"{body}_{ROOT_JOINT}", document.bodies[body].pose
            tree.carrier[body] = tree.add(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), pose, root)
            guess[root] = pin.SE3ToXYZQUAT(pose)
        tree.add_subtree(body)
    frames = [(name, *each) for name, each in document.frames.items()]
    for frame, body, pose in frames + [(joint.name, joint.child, joint.pose) for joint in graph.cut]:
        tree.add_frame(frame, tree.carrier[body], pose, pin.FrameType.OP_FRAME)
    if not tree.model.nv:
        raise FormatError("nothing can move: all joints are fixed (free_flyer would let it move)")
    return tree.model, guess


class _Tree:
    def __init__(self, document, graph, inertias, name):
        self.model = pin.Model()
        self.model.name = name
        if document.gravity is not None:
            self.model.gravity.linear = document.gravity
        self._document, self._inertias = document, inertias
        self._branches = defaultdict(list)  # body → (joint, outer body) of its branches; None: a copy of the child
        for number, start, end in graph.branches:
            self._branches[start].append((graph.joints[number], end))
        for joint in graph.copied:
            self._branches[joint.parent].append((joint, None))
        self._poses = [pin.SE3.Identity()]  # of the model's joints in the world, at q = 0
        self.carrier = {WORLD: 0}  # body → the joint that carries it

    def add_subtree(self, root):
        """Add a body and its descendants, depth first."""
        waiting = self._add_body(root, self.carrier.setdefault(root, 0))
        while waiting:
            carrier, joint, end = waiting.pop()
            carrier = self._add_joint(joint, carrier, forward=end != joint.parent)
            if end is None:
                pose = self._document.bodies[joint.child].pose
                self.add_frame(copy_name(joint), carrier, pose, pin.FrameType.OP_FRAME)
            else:
                waiting += self._add_body(end, carrier)

    def _add_body(self, name, carrier):
        """Add a body; return its branches, the first one last."""
        self.carrier[name] = carrier
        if name != WORLD:
            pose = self._document.bodies[name].pose
            if carrier:
                self.model.appendBodyToJoint(carrier, self._inertias[name], self._poses[carrier].actInv(pose))
            self.add_frame(name, carrier, pose, pin.FrameType.BODY)
        return [(carrier, *each) for each in reversed(self._branches[name])]

    def add(self, parent, joint, place, pose, name):
        """Add a joint with its placement on the parent and its pose in the world; return its index."""
        if self.model.existJointName(name):
            raise FormatError("another joint has this name", element=f"joint {short_repr(name)}")
        index = self.model.addJoint(parent, joint, place, name)
        self.model.addJointFrame(index)
        self._poses.append(pose)
        return index

    def _add_joint(self, joint: Joint, carrier, forward):
        """Add a joint of the file; return the index of the model's joint that carries its other body."""
        if joint.kind == "fixed":
            self.add_frame(joint.name, carrier, joint.pose, pin.FrameType.FIXED_JOINT)
            return carrier
        place = self._poses[carrier].actInv(joint.pose)
        # backwards, the parent moves relative to the child: the same coordinates along the opposite axes
        parts = list(zip(joint.parts, joint.axes, strict=True))
        for name, axis in parts if forward else parts[::-1]:
            motion = _joint_model(joint, axis.direction if forward else -axis.direction)
            carrier = self.add(carrier, motion, place, joint.pose, name)
            _set_values(self.model, carrier, axis)
            place = pin.SE3.Identity()
        return carrier

    def add_frame(self, name, carrier, pose, kind):
        place = self._poses[carrier].actInv(pose)
        parent = self.model.getFrameId(self.model.names[carrier], pin.FrameType.JOINT) if carrier else 0
        self.model.addFrame(pin.Frame(name, carrier, parent, place, kind), False)


def _set_values(model, joint, axis):
    q, v = places(model, joint)
    model.damping[v] = axis.damping
    model.upperDryFrictionLimit[v], model.lowerDryFrictionLimit[v] = axis.friction, -axis.friction
    model.upperEffortLimit[v], model.lowerEffortLimit[v] = axis.effort, -axis.effort
    model.upperVelocityLimit[v], model.lowerVelocityLimit[v] = axis.velocity, -axis.velocity
    if model.nqs[joint] == 1:
        model.lowerPositionLimit[q], model.upperPositionLimit[q] = axis.lower, axis.upper


def _joint_model(joint: Joint, direction):
    if joint.kind == "ball":
        return pin.JointModelSpherical()
    if joint.kind == "prismatic":
        return pin.JointModelPrismaticUnaligned(direction)
    if joint.kind == "screw":
        return pin.JointModelHelicalUnaligned(direction, joint.pitch / (2 * np.pi))
    return pin.JointModelRevoluteUnaligned(direction)
