"""Random closed chains."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

import pinconsist as pc

from ..linkages import add_frame
from .equations import Curve, Drag, OnLine
from .reference import Equations

JOINTS = {
    "revolute": lambda rng: pin.JointModelRevoluteUnaligned(_direction(rng)),
    "prismatic": lambda rng: pin.JointModelPrismaticUnaligned(_direction(rng)),
    "continuous": lambda rng: rng.choice([pin.JointModelRUBX, pin.JointModelRUBY, pin.JointModelRUBZ])(),
    "helical": lambda rng: pin.JointModelHelicalUnaligned(_direction(rng), rng.uniform(-0.3, 0.3)),
    "universal": lambda rng: pin.JointModelUniversal(*_frame(rng)[:2]),
    "spherical": lambda rng: pin.JointModelSpherical(),
    "planar": lambda rng: pin.JointModelPlanar(),
    "translation": lambda rng: pin.JointModelTranslation(),
    "free": lambda rng: pin.JointModelFreeFlyer(),
}
SHARES = (0.34, 0.12, 0.1, 0.08, 0.08, 0.1, 0.08, 0.03, 0.07)
IN_PLANE = {
    "revolute": lambda rng: pin.JointModelRZ(),
    "continuous": lambda rng: pin.JointModelRUBZ(),
    "prismatic": lambda rng: pin.JointModelPX(),
    "planar": lambda rng: pin.JointModelPlanar(),
}
SHARES_IN_PLANE = (0.65, 0.1, 0.15, 0.1)
KINDS = ("point", "hinge", "distance", "universal", "cylinder", "slider", "plane", "frame", "line")
KINDS_IN_PLANE = ("point", "hinge", "distance", "cylinder", "line")


class Chance:
    """One scene: a random tree, what closes it at a configuration, and what acts on it."""

    def __init__(self, seed):
        self.seed, self.rng = seed, np.random.default_rng(seed)
        self.planar = self.rng.random() < 0.25
        self.model = self._tree()
        self.q = pin.integrate(self.model, pin.neutral(self.model), self.rng.uniform(-1.5, 1.5, self.model.nv))
        self.v = self.rng.normal(0.0, 10.0 ** self.rng.uniform(-0.3, 0.7), self.model.nv)
        self.data = self.model.createData()
        pin.framesForwardKinematics(self.model, self.data, self.q)

    def _tree(self):
        rng, model, last = self.rng, pin.Model(), 0
        joints, shares = (IN_PLANE, SHARES_IN_PLANE) if self.planar else (JOINTS, SHARES)
        for i in range(rng.integers(2, 9)):
            branches = [0, *list(model.supports[last])[1:]] if last else [0]
            parent = (
                last if rng.random() < 0.8 else int(rng.choice(branches))
            )  # depth-first: only along the last branch
            kind = rng.choice(list(joints), p=shares)
            last = model.addJoint(parent, joints[kind](rng), self._placement(), f"{kind}{i}")
            model.appendBodyToJoint(last, _body(rng), pin.SE3.Identity())
            add_frame(model, last, f"body{i}")
        if rng.random() < 0.2:
            model.armature = 10.0 ** rng.uniform(-3.0, -1.0, model.nv)
        if rng.random() < 0.2:
            model.gravity.linear = rng.choice([0.0, 9.81]) * _direction(rng)
        return model

    def mechanism(self):
        """The mechanism; it stays free to move."""
        rng, model = self.rng, self.model
        records = [self._loop(f"loop{i}") for i in range(rng.integers(1, 4))]
        records += [record for record in (self._coupling(), self._drive()) if record]
        for record in records[::-1]:  # what moves by itself must not contradict what holds
            others = [other for other in records if other is not record]
            if _moves(record) and self._rank(records) < self._rank(others) + len(record.rows):
                records = others
        while records and self._rank(records) >= model.nv:
            records.pop(rng.integers(len(records)))
        if not records:
            records = [self._closure("loop0", "distance", *self._frames(True))]
        forces = [make(self) for make, share in FORCES.items() if rng.random() < share]
        return pc.Mechanism(model, records, filter(None, forces), name=f"chain {self.seed}")

    def _rank(self, records):
        if not records:
            return 0
        equations = Equations(pc.Mechanism(self.model, records))
        return len(equations.independent(equations.rows(0.0, self.q, self.v)[1]))

    def _frames(self, last):
        """Two frames of different bodies; the first of them the last body's, or any."""
        count = self.model.njoints - 1
        first = count - 1 if last else self.rng.integers(count)
        others = [f"body{i}" for i in range(count) if i != first]
        return f"body{first}", "universe" if self.rng.random() < 0.5 else str(self.rng.choice(others))

    def _loop(self, name):
        frames = self._frames(name == "loop0")
        kind = str(self.rng.choice(KINDS_IN_PLANE if self.planar else KINDS))
        return self._line(name, frames[0]) if kind == "line" else self._closure(name, kind, *frames)

    def _closure(self, name, kind, frame1, frame2):
        """A loop that is closed, with its anchors apart by a random amount of what the kind leaves free."""
        rng, planar = self.rng, self.planar
        e = np.array([0.0, 0.0, 1.0]) if planar else _direction(rng)
        across = np.linalg.svd(e[None, :])[2][1:]
        along, turned = rng.uniform(-0.4, 0.4) * e, pin.exp3(rng.uniform(-2.0, 2.0) * e)
        anyhow = pin.exp3(rng.normal(size=3))
        free = {
            "point": (np.zeros(3), anyhow),
            "frame": (np.zeros(3), np.eye(3)),
            "hinge": (np.zeros(3), turned),
            "distance": (2.0 * self._offset(), anyhow),
            "slider": (along, np.eye(3)),
            "cylinder": (along, turned),
            "plane": (rng.uniform(-0.4, 0.4, 2) @ across, turned),
            "universal": (np.zeros(3), anyhow),
        }[kind]
        anchor1 = self._placement()
        pose1, pose2 = (self.data.oMf[self.model.getFrameId(frame)] for frame in (frame1, frame2))
        anchor2 = pose2.actInv(pose1 * anchor1 * pin.SE3(free[1], free[0]))
        own = {}
        if kind == "distance":
            own["length"] = float(np.linalg.norm(free[0]))
        if kind in ("hinge", "slider", "cylinder", "plane", "universal"):
            own["axis"] = e
        if kind == "universal":
            own["axis2"] = anyhow.T @ across[0]
        angles1, angles2 = (pin.rpy.matrixToRpy(anchor.rotation) for anchor in (anchor1, anchor2))
        return pc.Loop(name, kind, frame1, frame2, anchor1.translation, angles1, anchor2.translation, angles2, **own)

    def _line(self, name, frame):
        rng, xyz = self.rng, self._offset()
        origin = self.data.oMf[self.model.getFrameId(frame)].act(xyz)
        across = np.array([[0.6, 0.8, 0.0]]) if self.planar else _frame(rng)[:2]
        moving = bool(rng.random() < 0.5)
        sway = moving * 0.3 * self._offset()
        line = OnLine(self.model, frame, xyz, origin, across, sway, rng.uniform(1.0, 5.0))
        return pc.Constraint(name, line, len(across), moving=moving)

    def _one(self, *, counts=False, but=None):
        """The name of a joint of one freedom, which counts its turns where asked; None where there is none."""
        model = self.model
        single = [i for i in range(1, model.njoints) if model.nvs[i] == 1 and not (counts and model.nqs[i] == 2)]
        names = [model.names[i] for i in single if model.names[i] != but]
        return str(self.rng.choice(names)) if names else None

    def _value(self, joint):
        i = self.model.getJointId(joint)
        q = self.q[self.model.idx_qs[i] :][: self.model.nqs[i]]
        return float(q[0] if len(q) == 1 else np.arctan2(q[1], q[0]))

    def _motion(self, value):
        """A Motion that is at a value at t = 0."""
        rng = self.rng
        speed = rng.uniform(-2.0, 2.0) if rng.random() < 0.3 else 0.0
        size, phase = rng.uniform(0.05, 0.4), rng.uniform(0.0, 6.0)
        return pc.Motion(value - size * np.sin(phase), speed, size, rng.uniform(0.2, 2.0), phase)

    def _drive(self):
        if self.rng.random() > 0.3 or not (joint := self._one()):
            return None
        motion = self._motion(self._value(joint))
        return pc.Drive("motor", joint, Curve(motion) if self.rng.random() < 0.3 else motion)

    def _coupling(self):
        rng = self.rng
        if rng.random() > 0.25 or not (other := self._one(counts=True)) or not (joint := self._one(but=other)):
            return None
        ratio, higher = rng.uniform(-2.0, 2.0), [rng.normal(0.0, 0.2)] if rng.random() < 0.3 else []
        x = self._value(other)
        return pc.Coupling("gear", joint, other, ratio, self._value(joint) - ratio * x - sum(higher) * x**2, higher)

    def _some(self, low, high):
        """Joint → a number between powers of ten, for some of the joints."""
        rng, names = self.rng, list(self.model.names)[1:]
        chosen = rng.choice(names, rng.integers(1, len(names) + 1), replace=False)
        return {str(name): 10.0 ** rng.uniform(low, high) for name in chosen}

    def _spring(self):
        rng, joint = self.rng, self._one()
        return joint and pc.JointSpring(joint, 10.0 ** rng.uniform(0.0, 3.0), self._value(joint) + rng.normal())

    def _servo(self):
        rng, joint = self.rng, self._one()
        gains = 10.0 ** rng.uniform(0.0, 3.0), 10.0 ** rng.uniform(-1.0, 1.5)
        return joint and pc.Servo(joint, self._motion(self._value(joint)), *gains)

    def _torque(self):
        return (joint := self._one()) and pc.JointTorque({joint: self._motion(self.rng.normal(0.0, 10.0))})

    def _between(self):
        """A spring and damper between two bodies, or a body and the ground; one in ten is stiff."""
        rng, frames = self.rng, self._frames(False)
        stiff = rng.random() < 0.1
        stiffness, damping = 10.0 ** (rng.uniform((5.0, 3.0), (7.0, 4.0)) if stiff else rng.uniform((0, -1), (4, 2)))
        return pc.SpringDamper(*frames, stiffness, rng.uniform(0.1, 1.0), damping, self._offset(), self._offset())

    def _wrench(self):
        rng = self.rng
        loads = rng.normal(0.0, (10.0, 3.0), (3, 2)).T * ((1.0, 1.0, not self.planar), (not self.planar,) * 2 + (1.0,))
        return pc.Wrench(self._frames(False)[0], *loads, str(rng.choice(["world", "local"])), self._offset())

    def _offset(self):
        return self.rng.uniform(-0.7, 0.7, 3) * (1.0, 1.0, not self.planar)

    def _placement(self):
        turn = np.eye(3) if self.planar else pin.exp3(self.rng.normal(size=3))
        return pin.SE3(turn, self._offset())


FORCES = {
    lambda scene: pc.JointDamping(scene._some(-2.0, 1.0)): 0.3,
    lambda scene: pc.JointFriction(scene._some(-1.0, 1.0), 10.0 ** scene.rng.uniform(-2.0, 0.0)): 0.2,
    lambda scene: pc.Torque(Drag(10.0 ** scene.rng.uniform(-2.0, 0.0))): 0.1,
    Chance._spring: 0.3,
    Chance._servo: 0.15,
    Chance._torque: 0.2,
    Chance._between: 0.35,
    Chance._wrench: 0.15,
}
"""Force → share of the scenes that have one."""


def random_chain(seed):
    """(mechanism, q, v) of a seed: a closed configuration, and a velocity that need not be on the loops.

    One in four moves in a plane, with the redundant rows that a closure in space has there.
    """
    scene = Chance(seed)
    return scene.mechanism(), scene.q, scene.v


def _moves(record):
    return isinstance(record, pc.Drive) or (isinstance(record, pc.Constraint) and record.moving)


def _direction(rng):
    direction = rng.normal(size=3)
    return direction / np.linalg.norm(direction)


def _frame(rng):
    """Three directions normal to each other, as rows."""
    return pin.exp3(rng.normal(size=3))


def _body(rng):
    """0.3 to 3 kg within some 0.3 m."""
    mass, axes = 10.0 ** rng.uniform(-0.5, 0.5), rng.normal(0.0, 0.15, (3, 3))
    second = mass * (axes @ axes.T + 1e-3 * np.eye(3))
    return pin.Inertia(mass, rng.uniform(-0.2, 0.2, 3), np.trace(second) * np.eye(3) - second)
