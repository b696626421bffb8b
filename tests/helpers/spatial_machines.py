"""A Stewart platform and a parallel ankle, closed at zero, as trees of joints and balls that close loops.

Masses, inertias and the joints' numbers are exact in single precision, which USD has for them.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
ZERO = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Part:
    """A body on its joint; its frame is that of the joint."""

    name: str  # of the body; the joint is called ``<name>_joint``
    parent: str  # "" for the ground
    kind: str  # revolute, prismatic or floating
    place: pin.SE3  # in the parent
    axis: tuple[float, float, float] = X
    mass: float = 0.0625
    com: tuple[float, float, float] = ZERO
    moments: tuple[float, float, float] = (2.0**-10, 2.0**-10, 2.0**-10)
    damping: float = 0.0

    @property
    def joint(self):
        return f"{self.name}_joint"

    @property
    def inertia(self):
        return pin.Inertia(self.mass, np.array(self.com), np.diag(self.moments))


@dataclass(frozen=True)
class Ball:
    """A point of one body that coincides with a point of another."""

    name: str
    body1: str
    xyz1: tuple[float, float, float]
    body2: str
    xyz2: tuple[float, float, float]


@dataclass(frozen=True)
class Machine:
    name: str
    parts: tuple[Part, ...]
    balls: tuple[Ball, ...]
    poses: dict[str, pin.SE3] = field(default_factory=dict)

    def __post_init__(self):
        for part in self.parts:
            self.poses[part.name] = self.pose(part.parent) * part.place

    def pose(self, name):
        return self.poses[name] if name else pin.SE3.Identity()

    def children(self, name):
        return [part for part in self.parts if part.parent == name]

    @property
    def compared(self):
        """The joints whose coordinates all ways of writing have."""
        return [part.joint for part in self.parts if part.kind != "floating"]

    def model(self):
        """The tree as a pin.Model."""
        made, joints = pin.Model(), {"": 0}
        made.name = self.name
        for part in self.parts:
            axis = np.array(part.axis)
            kinds = {"floating": pin.JointModelFreeFlyer, "revolute": pin.JointModelRevoluteUnaligned,
                     "prismatic": pin.JointModelPrismaticUnaligned}  # fmt: skip
            kind = kinds[part.kind]() if part.kind == "floating" else kinds[part.kind](axis)
            joints[part.name] = made.addJoint(joints[part.parent], kind, part.place, part.joint)
            made.appendBodyToJoint(joints[part.name], part.inertia, pin.SE3.Identity())
            made.damping[made.nv - made.nvs[joints[part.name]] :] = part.damping
        return made, joints


def at(xyz, rotation=None):
    return pin.SE3(np.eye(3) if rotation is None else rotation, np.array(xyz, float))


def towards(direction, start=X):
    """The rotation of smallest angle that turns `start` to a direction."""
    return pin.Quaternion.FromTwoVectors(np.array(start), np.array(direction)).toRotationMatrix()


def stewart() -> Machine:
    """Six legs of a universal and a damped slide each, on a platform whose centre of mass is not in its middle."""
    high, parts, balls = 0.75, [], []
    angles = np.deg2rad([-12.0, 12.0, 108.0, 132.0, 228.0, 252.0])
    ends = np.deg2rad([-48.0, 48.0, 72.0, 168.0, 192.0, 288.0])
    for number, (low, end) in enumerate(zip(angles, ends, strict=True), start=1):
        foot = 0.5 * np.array([np.cos(low), np.sin(low), 0.0])
        head = np.array([0.3 * np.cos(end), 0.3 * np.sin(end), high])
        length = float(np.linalg.norm(head - foot))
        turn = towards((head - foot) / length)
        parts += [
            Part(f"cross{number}", "", "revolute", at(foot, turn), Y),
            Part(f"barrel{number}", f"cross{number}", "revolute", at(ZERO), Z, 1.0, (0.25, 0.0, 0.0),
                 (2.0**-12, 2.0**-6, 2.0**-6)),
            Part(f"rod{number}", f"barrel{number}", "prismatic", at((length, 0, 0)), X, 0.5, (-0.25, 0.0, 0.0),
                 (2.0**-13, 2.0**-7, 2.0**-7), damping=32.0),
        ]  # fmt: skip
        balls.append(Ball(f"ball{number}", f"rod{number}", ZERO, "platform", tuple((head - [0, 0, high]).tolist())))
    floating = Part("platform", "", "floating", at((0, 0, high)), X, 4.0, (0.0625, -0.03125, 0.03125),
                    (0.0625, 0.09375, 0.125))  # fmt: skip
    return Machine("stewart", (*parts, floating), tuple(balls))


def ankle() -> Machine:
    """A foot on a universal, tilted by two cranks of the shin through rods; the shin does not move."""
    parts = [
        Part("cross", "", "revolute", at((0.0, 0.0, -0.375)), Y),
        Part("foot", "cross", "revolute", at(ZERO), X, 1.0, (0.0625, 0.015625, -0.03125), (2.0**-9, 2.0**-8, 2.0**-8)),
    ]
    balls = []
    for side, sign, mass in (("left", 1.0, 0.25), ("right", -1.0, 0.375)):
        crank = np.array([-0.03125, sign * 0.046875, -0.125])
        tip = crank + np.array([-0.0625, 0.0, 0.0])
        heel = np.array([-0.078125, sign * 0.03125, -0.015625])
        rod = heel + np.array([0.0, 0.0, -0.375]) - tip
        length = float(np.linalg.norm(rod))
        parts += [
            Part(f"{side}_crank", "", "revolute", at(crank), Y, mass, (-0.03125, 0.0, 0.0),
                 (2.0**-12, 2.0**-11, 2.0**-11)),
            Part(f"{side}_pin", f"{side}_crank", "revolute", at((-0.0625, 0, 0), towards(rod / length, (0, 0, -1))),
                 Y, 0.015625, moments=(2.0**-14,) * 3),
            Part(f"{side}_rod", f"{side}_pin", "revolute", at(ZERO), X, 0.125, (0.0, 0.0, -0.125),
                 (2.0**-11, 2.0**-11, 2.0**-14)),
        ]  # fmt: skip
        balls.append(Ball(f"{side}_ball", f"{side}_rod", (0.0, 0.0, -length), "foot", tuple(heel.tolist())))
    return Machine("ankle", tuple(parts), tuple(balls))
