"""The net of joints of an SDF file, cut open into a tree and loops; its couplings; and the tree as a pin.Model.

The tree is the one of largest weight. It pays to cut joints that leave few rows, so a ball rather than a hinge; and a
joint in which something acts (damping, friction, a spring, a coupling) belongs in the tree, where it has a coordinate.
If such a joint must be cut all the same, it stays, carries a massless copy of its child link, and this is held to the
link by six rows. Of loops of like joints the tree takes the shortest chains. ``<must_be_loop_joint>`` asks for a cut.

A ball that is cut becomes a point, a revolute or continuous joint a hinge, a prismatic joint a slider, a fixed joint a
frame, a universal joint a universal if its axes are perpendicular. Other universal joints and screws are copied.
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
from ..reading import require_known, shown
from ..urdf import ROOT_JOINT
from .document import WORLD, Document
from .joints import Joint

_KINDS = {"ball": "point", "revolute": "hinge", "prismatic": "slider", "fixed": "frame", "universal": "universal"}
_ROWS = {"ball": 3, "universal": 4, "revolute": 5, "prismatic": 5, "screw": 5, "fixed": 6}
_ACTS, _ASKED = 10, 100
_PERPENDICULAR = 1e-6
_ALONG = 1e-3  # sine of the angle up to which an axis of a gearbox counts as that of the joint


def spanning_tree(
    ends: Sequence[tuple[str, str]], weights: Sequence[float], held: Iterable[str], candidates: Iterable[str]
) -> tuple[list[tuple[int, str, str]], list[str]]:
    """The tree of largest weight (Prim's algorithm): its branches, and its roots beside those that are `held`.

    A branch is the index of a joint, the body where it starts, which is nearer to a root, and the body where it ends.
    Ties go to joints that lead from parent to child, then to short chains, then to the order given. `ends` are parent
    and child body of each joint. Of the `candidates`, all bodies, the first that no joint ties to a root becomes one.
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


class Net:
    """The joints of a file as a tree and loops.

    `joints` tie bodies together, of which at least one can move. `held` are bodies that do not move, the world first,
    and `roots` those that no joint ties to one of them. `branches` are the tree, in the order of the file. The other
    joints close loops: those `copied` by a copy of the child, those `cut` by rows of their own kind.
    """

    def __init__(self, document: Document, joints: Sequence[Joint]):
        bodies = document.bodies
        self.held = (WORLD, *(name for name, body in bodies.items() if body.static))
        self.joints = [j for j in joints if j.kind != "gearbox" and not {j.parent, j.child} <= {*self.held}]
        whole = {joint.name for joint in self.joints if _whole(joint)} | _coupled(joints)
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
        """What closes the net. Anchors are the joint's frame on both bodies, so that all loops are closed at q = 0."""
        loops = [_loop(joint, document, "frame", copy_name(joint), joint.child) for joint in self.copied]
        return loops + [_loop(joint, document, _KINDS[joint.kind], joint.parent, joint.parent) for joint in self.cut]


def copy_name(joint: Joint) -> str:
    """Name of the frame of a joint's copy of its child."""
    return f"{joint.name}_end"


def _whole(joint):
    """Whether a joint needs its coordinates also where it closes a loop."""
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
    """The gearboxes and followers of a file as couplings of two joints; FormatError for those that do not exist.

    A gearbox holds θ₂ = -ratio θ₁, with θ₁ the angle from its reference body to its parent about its first axis, and
    θ₂ that to its child about the second.
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
            reason = f"one revolute joint between its reference body {gearbox.reference!r} and {body!r} is needed"
            raise FormatError(f"{reason}, there are {len(between)}", element=f"joint {gearbox.name!r}")
        found += between
    return found


def _sign(gearbox, number, joint, body) -> float:
    """+1 if the angle of a joint is that of the gearbox, -1 if it is the opposite."""
    axis = gearbox.pose.rotation @ gearbox.axes[number].direction
    own = joint.pose.rotation @ joint.axes[0].direction
    if np.linalg.norm(np.cross(axis, own)) > _ALONG:
        reason = f"its {('axis', 'axis2')[number]} is not along that of joint {joint.name!r}"
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


def build(document: Document, net: Net, inertias: Mapping[str, pin.Inertia], name: str, free_flyer: bool):
    """The model of a net, and the configurations of its floating roots by the names of their joints.

    With `free_flyer` the roots that no joint ties to the world float; else they are fixed where they are. `inertias`
    are those of links in their own frames. FormatError for names that clash, or if nothing moves or floats.
    """
    if free_flyer and not net.roots:
        raise FormatError("nothing can float: all links are tied to the world; omit free_flyer")
    tree, guess = _Tree(document, net, inertias, name), {}
    for body in net.held:
        tree.plant(body)
    for body in net.roots:
        if free_flyer:
            root, pose = ROOT_JOINT if len(net.roots) == 1 else f"{body}_{ROOT_JOINT}", document.bodies[body].pose
            tree.carrier[body] = tree.add(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), pose, root)
            guess[root] = pin.SE3ToXYZQUAT(pose)
        tree.plant(body)
    frames = [(name, *each) for name, each in document.frames.items()]
    for frame, body, pose in frames + [(joint.name, joint.child, joint.pose) for joint in net.cut]:
        tree.add_frame(frame, tree.carrier[body], pose, pin.FrameType.OP_FRAME)
    if not tree.model.nv:
        raise FormatError("nothing can move: all joints are fixed (free_flyer would let it move)")
    return tree.model, guess


class _Tree:
    """A model that grows."""

    def __init__(self, document, net, inertias, name):
        self.model = pin.Model()
        self.model.name = name
        if document.gravity is not None:
            self.model.gravity.linear = document.gravity
        self._document, self._inertias = document, inertias
        self._leaving = defaultdict(list)  # body → (joint, other body) of what leaves it; None: a copy of the child
        for number, start, end in net.branches:
            self._leaving[start].append((net.joints[number], end))
        for joint in net.copied:
            self._leaving[joint.parent].append((joint, None))
        self._poses = [pin.SE3.Identity()]  # of the model's joints in the world, at q = 0
        self.carrier = {WORLD: 0}  # body → the joint that carries it

    def plant(self, root):
        """Add a body and its descendants, each branch completely before the next one."""
        waiting = self._arrive(root, self.carrier.setdefault(root, 0))
        while waiting:
            carrier, joint, end = waiting.pop()
            carrier = self._hang(joint, carrier, forward=end != joint.parent)
            if end is None:
                pose = self._document.bodies[joint.child].pose
                self.add_frame(copy_name(joint), carrier, pose, pin.FrameType.OP_FRAME)
            else:
                waiting += self._arrive(end, carrier)

    def _arrive(self, name, carrier):
        """Add a body; return what leaves it, the first last."""
        self.carrier[name] = carrier
        if name != WORLD:
            pose = self._document.bodies[name].pose
            if carrier:
                self.model.appendBodyToJoint(carrier, self._inertias[name], self._poses[carrier].actInv(pose))
            self.add_frame(name, carrier, pose, pin.FrameType.BODY)
        return [(carrier, *each) for each in reversed(self._leaving[name])]

    def add(self, parent, joint, place, pose, name):
        """Add a joint by its place on its parent and its pose in the world; its index."""
        if self.model.existJointName(name):
            raise FormatError("another joint has this name", element=f"joint {shown(name)}")
        index = self.model.addJoint(parent, joint, place, name)
        self.model.addJointFrame(index)
        self._poses.append(pose)
        return index

    def _hang(self, joint: Joint, carrier, forward):
        """Add a joint of the file; the index of the model's joint that then carries its other body."""
        if joint.kind == "fixed":
            self.add_frame(joint.name, carrier, joint.pose, pin.FrameType.FIXED_JOINT)
            return carrier
        place = self._poses[carrier].actInv(joint.pose)
        # backwards, the parent moves against the child: the same coordinates along the opposite axes
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
    """Write what limits and brakes a joint."""
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
