"""Which joints of a net close loops, and how.

The tree is the one of largest weight. It pays to cut joints that leave few rows, so a ball rather than a hinge; and a
joint in which something acts (damping, friction, a spring, a coupling) belongs in the tree, where it has a coordinate.
Where such a joint must be cut all the same, as where every hinge of a loop is damped, nothing is lost: the joint stays,
carries a massless copy of its child link, and this is held to the link by six rows. Of loops of like joints the tree
takes the shortest chains. ``<must_be_loop_joint>`` asks for a cut.

======================= =========================================================
joint cut               loop
======================= =========================================================
ball                    point
revolute, continuous    hinge
prismatic               slider
universal, revolute2    universal if its axes are perpendicular, else by the copy
fixed                   frame
screw                   by the copy
======================= =========================================================
"""

from __future__ import annotations

import pinocchio as pin

from ...mechanism.constraints.loop import GROUND, Loop
from .couplings import coupled_joints
from .joints import Joint
from .poses import WORLD
from .spanning import Branch, spanning_tree
from .tree import Scene

_ROWS = {"ball": 3, "universal": 4, "revolute": 5, "prismatic": 5, "screw": 5, "fixed": 6}
_ACTS, _ASKED = 10, 100
_PERPENDICULAR = 1e-6


class Net:
    """The joints of a scene as a tree and loops.

    Attributes
    ----------
    joints : list of Joint
        Those that tie bodies together, of which at least one can move.
    held : tuple of str
        Bodies that do not move, the world first.
    branches : list of Branch
        The tree.
    roots : list of str
        Bodies that no joint ties to one that is held.
    copied, cut : list of Joint
        What closes loops: by a copy of the child, and by rows of the joint's own kind.
    """

    def __init__(self, scene: Scene):
        self.held = (WORLD, *(name for name, body in scene.bodies.items() if body.static))
        fixed = set(self.held)
        self.joints = [j for j in scene.joints if j.kind != "gearbox" and not {j.parent, j.child} <= fixed]
        whole = {joint.name for joint in self.joints if _whole(joint)} | coupled_joints(scene.joints)
        weights = [_ROWS[j.kind] + _ACTS * (j.name in whole) - _ASKED * j.must_cut for j in self.joints]
        children = {joint.child for joint in self.joints}
        candidates = (*scene.roots, *(body for body in scene.bodies if body not in children), *scene.bodies)
        ends = [(joint.parent, joint.child) for joint in self.joints]
        self.branches, self.roots, loose = spanning_tree(ends, weights, self.held, candidates)
        self.copied = [self.joints[i] for i in loose if self.joints[i].name in whole]
        self.cut = [self.joints[i] for i in loose if self.joints[i].name not in whole]

    def leaving(self) -> dict[str, list[Branch]]:
        """The branches by the body where they start, in the order of the file."""
        by_start: dict[str, list[Branch]] = {}
        for branch in sorted(self.branches, key=lambda branch: branch.joint):
            by_start.setdefault(branch.start, []).append(branch)
        return by_start


def _whole(joint: Joint) -> bool:
    """Whether a joint needs its coordinates also where it closes a loop."""
    if joint.kind == "universal":
        first, second = (axis.direction for axis in joint.axes)
        if abs(first @ second) > _PERPENDICULAR:
            return True
    return joint.kind == "screw" or any(axis.acts for axis in joint.axes)


def copy_name(joint: Joint) -> str:
    """Name of the frame of a joint's copy of its child."""
    return f"{joint.name}_end"


def closures(net: Net, scene: Scene) -> list[Loop]:
    """The loops of a net. Anchors are the joint's frame on both bodies, so that all loops are closed at q = 0."""
    loops = [_loop(joint, scene, "frame", copy_name(joint), joint.child) for joint in net.copied]
    for joint in net.cut:
        kind = {"ball": "point", "revolute": "hinge", "prismatic": "slider", "fixed": "frame"}.get(
            joint.kind, joint.kind
        )
        loops.append(_loop(joint, scene, kind, joint.parent, joint.parent))
    return loops


def _loop(joint, scene, kind, frame1, body1):
    anchors = {}
    for number, body in ((1, body1), (2, joint.child)):
        anchor = joint.pose if body == WORLD else scene.bodies[body].pose.actInv(joint.pose)
        anchors[f"xyz{number}"] = tuple(anchor.translation)
        anchors[f"rpy{number}"] = tuple(pin.rpy.matrixToRpy(anchor.rotation))
    axes = {}
    if kind in ("hinge", "slider", "universal"):
        axes = {key: tuple(axis.direction) for key, axis in zip(("axis", "axis2"), joint.axes, strict=False)}
    return Loop(joint.name, kind, GROUND if frame1 == WORLD else frame1, joint.child, **anchors, **axes)
