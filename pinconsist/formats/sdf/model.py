"""A net of joints → pin.Model, depth-first."""

from collections import defaultdict
from collections.abc import Mapping

import numpy as np
import pinocchio as pin

from ...errors import FormatError
from ...mechanism.checks import places
from ..reading import shown
from ..urdf import ROOT_JOINT
from .document import Document
from .frames import WORLD
from .joints import Joint
from .net import Net, copy_name


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
