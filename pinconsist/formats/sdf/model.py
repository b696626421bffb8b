"""A net of joints → pin.Model, depth-first."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pinocchio as pin

from ...errors import FormatError
from ..reading import shown
from .closing import Net, copy_name
from .joints import Joint
from .poses import WORLD
from .tree import Scene

ROOT_JOINT = "root_joint"


def build(scene: Scene, net: Net, inertias: Mapping[str, pin.Inertia], name: str, free_flyer: bool):
    """The tree of a net, and the places of its floating roots.

    Parameters
    ----------
    scene, net
        What the file holds, and how it is cut open.
    inertias : mapping
        Link → inertia in its own frame.
    name : str
        Of the model.
    free_flyer : bool
        Let the roots that no joint ties to the world float, instead of fixing them where they stand.

    Returns
    -------
    model : pin.Model
    guess : dict
        Root joint → its configuration, where there is one.

    Raises
    ------
    FormatError
        Names that clash, numbers that overflow, nothing that moves or, with `free_flyer`, nothing that floats.
    """
    if free_flyer and not net.roots:
        raise FormatError("nothing can float: all links are tied to the world; leave free_flyer away")
    tree = _Tree(scene, net, inertias, name)
    for body in net.held:
        tree.plant(body)
    guess = {}
    for body in net.roots:
        guess |= tree.float(body, ROOT_JOINT if len(net.roots) == 1 else f"{body}_{ROOT_JOINT}") if free_flyer else {}
        tree.plant(body)
    tree.finish()
    if not tree.model.nv:
        raise FormatError("nothing can move: there is no joint that is not fixed (a free-flyer would move it)")
    return tree.model, guess


class _Tree:
    """A model that grows."""

    def __init__(self, scene, net, inertias, name):
        self.model = pin.Model()
        self.model.name = name
        if scene.gravity is not None:
            self.model.gravity.linear = scene.gravity
        self._scene, self._net, self._inertias = scene, net, inertias
        self._leaving, self._copies = net.leaving(), {}
        for joint in net.copied:
            self._copies.setdefault(joint.parent, []).append(joint)
        self._poses = [pin.SE3.Identity()]  # of the model's joints in the world, at q = 0
        self._carrier = {WORLD: 0}  # body → the joint that carries it
        self._motions = []  # joints of the model, and what acts along them

    def float(self, body, name):
        """Let a root float by a joint whose configuration is the pose of the body."""
        self._carrier[body] = self._add(
            0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), self._scene.bodies[body].pose, name
        )
        return {name: pin.SE3ToXYZQUAT(self._scene.bodies[body].pose)}

    def plant(self, root):
        """Add a body and all that hangs on it, each branch completely before the next one."""
        self._carrier.setdefault(root, 0)
        if root != WORLD:
            self._body(root)
        waiting = self._next(root)
        while waiting:
            joint, start, end = waiting.pop()
            carrier = self._hang(joint, self._carrier[start], forward=end != joint.parent)
            if end is None:
                self._frame(copy_name(joint), carrier, self._scene.bodies[joint.child].pose, pin.FrameType.OP_FRAME)
                continue
            self._carrier[end] = carrier
            self._body(end)
            waiting += self._next(end)

    def _next(self, body):
        """(joint, start, end) of what leaves a body, the first last; no end: a copy of the joint's child."""
        branches = [(self._net.joints[each.joint], body, each.end) for each in self._leaving.get(body, ())]
        return [*branches, *((joint, body, None) for joint in self._copies.get(body, ()))][::-1]

    def _hang(self, joint: Joint, carrier, forward):
        """Add a joint of the file; the index of the model's joint that then carries its other body."""
        if joint.kind == "fixed":
            self._frame(joint.name, carrier, joint.pose, pin.FrameType.FIXED_JOINT)
            return carrier
        place = self._poses[carrier].actInv(joint.pose)
        # backwards, the parent moves against the child: the same coordinates along the opposite axes
        parts = list(zip(joint.parts, joint.axes, strict=True))
        for name, axis in parts if forward else parts[::-1]:
            carrier = self._add(
                carrier, _model(joint, axis.direction if forward else -axis.direction), place, joint.pose, name
            )
            self._motions.append((carrier, axis))
            place = pin.SE3.Identity()
        return carrier

    def _add(self, parent, joint, place, pose, name):
        element = f"joint {shown(name)}"
        if self.model.existJointName(name):
            raise FormatError("another joint has this name", element=element)
        index = self.model.addJoint(parent, joint, place, name)
        self.model.addJointFrame(index)
        self._poses.append(pose)
        return index

    def _body(self, name):
        carrier, pose = self._carrier[name], self._scene.bodies[name].pose
        if carrier:
            self.model.appendBodyToJoint(carrier, self._inertias[name], self._poses[carrier].actInv(pose))
        self._frame(name, carrier, pose, pin.FrameType.BODY)

    def _frame(self, name, carrier, pose, kind):
        place = self._poses[carrier].actInv(pose)
        parent = self.model.getFrameId(self.model.names[carrier], pin.FrameType.JOINT) if carrier else 0
        self.model.addFrame(pin.Frame(name, carrier, parent, place, kind), False)

    def finish(self):
        """Add the frames of the file, and what limits and brakes the joints."""
        for name, (body, pose) in self._scene.frames.items():
            self._frame(name, self._carrier[body], pose, pin.FrameType.OP_FRAME)
        for joint in self._net.cut:
            self._frame(joint.name, self._carrier[joint.child], joint.pose, pin.FrameType.OP_FRAME)
        model = self.model
        for index, axis in self._motions:
            v = slice(model.idx_vs[index], model.idx_vs[index] + model.nvs[index])
            model.damping[v] = axis.damping
            model.upperDryFrictionLimit[v], model.lowerDryFrictionLimit[v] = axis.friction, -axis.friction
            model.upperEffortLimit[v], model.lowerEffortLimit[v] = axis.effort, -axis.effort
            model.upperVelocityLimit[v], model.lowerVelocityLimit[v] = axis.velocity, -axis.velocity
            if model.nqs[index] == 1:
                q = model.idx_qs[index]
                model.lowerPositionLimit[q], model.upperPositionLimit[q] = axis.lower, axis.upper


def _model(joint: Joint, direction):
    if joint.kind == "ball":
        return pin.JointModelSpherical()
    if joint.kind == "prismatic":
        return pin.JointModelPrismaticUnaligned(direction)
    if joint.kind == "screw":
        return pin.JointModelHelicalUnaligned(direction, joint.pitch / (2 * np.pi))
    return pin.JointModelRevoluteUnaligned(direction)
