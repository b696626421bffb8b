"""Mechanism → MuJoCo: the MJCF text of the same bodies, joints, loops and forces, and the states of both programs.

A joint of Pinocchio has as many velocities in MuJoCo, in the same order, so that columns agree. Only what differs is
converted: quaternions, angles that are stored as (cos, sin), and the axes of velocities of free and planar joints.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
import pinocchio as pin

from ..errors import PinconsistError
from ..mechanism.checks import places
from ..mechanism.forces import (
    Actuator,
    JointDamping,
    JointSpring,
    JointTorque,
    Sampled,
    Servo,
    SpringDamper,
    bound_forces,
    model_forces,
)
from ..mechanism.joint_constraints import Coupling, Drive
from ..mechanism.loops import Loop, unit
from ..mechanism.mechanism import Mechanism

ARM = 0.1  # distance of the two points by which a hinge is held, relative to the size of the mechanism
NEGLIGIBLE_MASS = 1e-12  # mass of bodies without mass, relative to that of all bodies
POWERS = 5  # coefficients of a joint equality
SCALAR = ("R", "P", "Translation", "Universal", "SphericalZYX")  # each velocity is that of a hinge or a slide


class NotTranslatedError(PinconsistError):
    """A mechanism has something that another program has not."""


@dataclass(frozen=True)
class Joint:
    """A joint in both programs: the columns of q in each, those of v, and how it is stored."""

    name: str
    kind: str  # "scalar", "wrapped", "ball", "free" or "planar"
    q: slice
    v: slice
    there: slice
    parts: tuple[tuple[str, tuple], ...] = ()  # (hinge or slide, axis) of each velocity
    place: Any = None  # of a free joint, on the ground


def joints_of(model) -> list[Joint]:
    """The joints of a model as MuJoCo has them; NotTranslatedError for one that it has not."""
    data, found, start = model.createData(), [], 0
    pin.computeJointJacobians(model, data, pin.neutral(model))
    for i in range(1, model.njoints):
        name, which = model.names[i], model.joints[i].shortname().removeprefix("JointModel")
        q, v = places(model, i)
        kind = {"Spherical": "ball", "FreeFlyer": "free", "Planar": "planar"}.get(which)
        parts = ()
        if kind is None:
            if not which.startswith(SCALAR):
                raise NotTranslatedError(f"joint {name!r} is a {which} joint, which MuJoCo does not have")
            kind = "wrapped" if model.nqs[i] > model.nvs[i] else "scalar"
            columns = pin.getJointJacobian(model, data, i, pin.LOCAL).reshape(6, model.nv)[:, v]
            parts = tuple(_part(column) for column in columns.T)
        if kind == "planar":
            parts = (("slide", (1, 0, 0)), ("slide", (0, 1, 0)), ("hinge", (0, 0, 1)))
        if kind == "free" and model.parents[i]:
            raise NotTranslatedError(f"joint {name!r} is a free joint between bodies; MuJoCo has it on the ground only")
        size = {"ball": 4, "free": 7}.get(kind, model.nvs[i])
        found.append(Joint(name, kind, q, v, slice(start, start + size), parts, model.jointPlacements[i]))
        start += size
    return found


def _part(column):
    turning = np.linalg.norm(column[3:]) > 0.5
    axis = column[3:] if turning else column[:3]
    if turning and np.linalg.norm(column[:3]) > 1e-12:
        raise NotTranslatedError("a helical joint turns and slides at once, which MuJoCo's joints do not")
    return "hinge" if turning else "slide", tuple(axis.tolist())


def to_mujoco(joints, q, v):
    """qpos and qvel of a state."""
    qpos, qvel = [], np.array(v, float)
    for joint in joints:
        part = q[joint.q]
        if joint.kind == "scalar":
            qpos.append(part)
        elif joint.kind == "wrapped":
            qpos.append([np.arctan2(part[1], part[0])])
        elif joint.kind == "ball":
            qpos.append(np.roll(part, 1))
        elif joint.kind == "planar":
            qpos.append([part[0], part[1], np.arctan2(part[3], part[2])])
            qvel[joint.v][:2] = _flat(part[2:]) @ qvel[joint.v][:2]
        else:
            pose = joint.place * pin.XYZQUATToSE3(np.array(part))
            qpos.append([*pose.translation, *np.roll(pin.Quaternion(pose.rotation).coeffs(), 1)])
            qvel[joint.v][:3] = pose.rotation @ qvel[joint.v][:3]
    return np.concatenate(qpos), qvel


def from_mujoco(joints, nq, qpos, qvel):
    """q and v of one state."""
    q, v = np.empty(nq), np.array(qvel, float)
    for joint in joints:
        part = qpos[joint.there]
        if joint.kind == "scalar":
            q[joint.q] = part
        elif joint.kind == "wrapped":
            q[joint.q] = np.cos(part[0]), np.sin(part[0])
        elif joint.kind == "ball":
            q[joint.q] = np.roll(part, -1)
        elif joint.kind == "planar":
            q[joint.q] = part[0], part[1], np.cos(part[2]), np.sin(part[2])
            v[joint.v][:2] = _flat(q[joint.q][2:]).T @ v[joint.v][:2]
        else:
            pose = pin.SE3(pin.Quaternion(np.roll(part[3:], -1)).normalized().matrix(), part[:3])
            v[joint.v][:3] = pose.rotation.T @ v[joint.v][:3]
            q[joint.q] = pin.SE3ToXYZQUAT(joint.place.actInv(pose))
    return q, v


def torques_to_mujoco(joints, q, tau):
    """Joint forces as MuJoCo has them, at a configuration of Pinocchio."""
    out = np.array(tau, float)
    for joint, turn in _turned(joints, q):
        out[joint.v][: len(turn)] = turn @ out[joint.v][: len(turn)]
    return out


def torques_from_mujoco(joints, q, tau):
    """Joint forces as Pinocchio has them, at its configuration."""
    out = np.array(tau, float)
    for joint, turn in _turned(joints, q):
        out[joint.v][: len(turn)] = turn.T @ out[joint.v][: len(turn)]
    return out


def _turned(joints, q):
    """The joints whose velocities have other axes in MuJoCo, with the rotation to these."""
    for joint in joints:
        part = q[joint.q]
        if joint.kind == "planar":
            yield joint, _flat(part[2:])
        elif joint.kind == "free":
            yield joint, joint.place.rotation @ pin.Quaternion(np.array(part[3:])).matrix()


def _flat(turn):
    return np.array([[turn[0], -turn[1]], [turn[1], turn[0]]])


@dataclass
class Scene:
    """A mechanism in MuJoCo, without the settings of its solver.

    MuJoCo has no bodies without mass; they get the least ones. `commands` are (index of an actuator, its command as a
    function of time), `lengths` (name of an equality and its tendon, length), `steady` constant joint torques (nv,),
    and `others` the forces that MuJoCo does not have, bound to the model.
    """

    joints: list[Joint]
    tree: str
    equalities: str
    tendons: str
    actuators: str
    gravity: str
    least_mass: float
    least_inertia: float
    steady: np.ndarray
    commands: list = field(default_factory=list)
    lengths: list = field(default_factory=list)
    others: list = field(default_factory=list)

    def text(self, step, integrator, solref, solimp, extra="") -> str:
        """The MJCF text with the settings of the solver."""
        return (
            f'<mujoco><compiler angle="radian" balanceinertia="false" boundmass="{self.least_mass!r}" '
            f'boundinertia="{self.least_inertia!r}"/>'
            f'<option timestep="{step!r}" gravity="{self.gravity}" integrator="{integrator}" {extra}>'
            '<flag contact="disable"/></option>'
            f'<default><equality solref="{numbers(solref)}" solimp="{numbers(solimp)}"/></default>'
            f"<worldbody>{self.tree}</worldbody><tendon>{self.tendons}</tendon>"
            f"<equality>{self.equalities}</equality><actuator>{self.actuators}</actuator></mujoco>"
        )


def scene_of(mechanism: Mechanism, tilted) -> Scene:
    """The scene of a mechanism; NotTranslatedError for what MuJoCo does not have.

    `tilted` are the names of the hinges whose rows across the axis are needed: two points hold those, else one.
    """
    refuse_controllers(mechanism)
    model, writer = mechanism.model, _Writer(mechanism, tilted)
    for loop in mechanism.loops:
        writer.loop(loop)
    for force in (*model_forces(model), *mechanism.forces):
        writer.force(force)
    tree = writer.sites(0) + "".join(writer.body(i) for i in writer.children(0))
    parts = ("".join(each) for each in (writer.equalities, writer.tendons, writer.actuators))
    equalities, tendons, actuators = parts
    gravity = numbers(model.gravity.linear)
    others = list(bound_forces(writer.bare, writer.others).values())
    mass = NEGLIGIBLE_MASS * (sum(inertia.mass for inertia in list(model.inertias)[1:]) or 1.0)
    return Scene(
        writer.joints, tree, equalities, tendons, actuators, gravity, mass, mass * writer.size**2, writer.steady,
        writer.commands, writer.lengths, others,
    )  # fmt: skip


def refuse_controllers(mechanism) -> None:
    """NotTranslatedError if a force remembers what it did."""
    for force in mechanism.forces:
        if isinstance(force, Sampled):
            raise NotTranslatedError("a sampled controller may have a memory, which two simulators cannot share")


class _Writer:
    def __init__(self, mechanism, tilted):
        self.mechanism, self.model, self.tilted = mechanism, mechanism.model, tilted
        self.joints = joints_of(self.model)
        self._by_name = {joint.name: joint for joint in self.joints}
        self._sites: dict[int, list[str]] = {i: [] for i in range(self.model.njoints)}
        self._springs: dict[str, str] = {}
        self._damping = np.zeros(self.model.nv)
        self._friction = np.zeros(self.model.nv)
        self.steady = np.zeros(self.model.nv)
        self.equalities, self.tendons, self.actuators = [], [], []
        self.commands, self.lengths, self.others = [], [], []
        self.bare = self.model.copy()  # without forces of its own
        for own in ("damping", "lowerDryFrictionLimit", "upperDryFrictionLimit"):
            setattr(self.bare, own, np.zeros(self.model.nv))

    def children(self, parent):
        return [i for i in range(1, self.model.njoints) if self.model.parents[i] == parent]

    def sites(self, joint) -> str:
        return "".join(self._sites[joint])

    def site(self, joint, place: pin.SE3) -> str:
        name = f"anchor{sum(map(len, self._sites.values()))}"
        self._sites[joint].append(f'<site name="{name}" {pose_text(place)}/>')
        return name

    def ends(self, loop, shift=None) -> list[str]:
        """The sites of both anchors, or of points beside them."""
        moved = pin.SE3.Identity() if shift is None else pin.SE3(np.eye(3), np.asarray(shift))
        found = []
        for end in (1, 2):
            frame = self.model.frames[self.model.getFrameId(getattr(loop, f"frame{end}"))]
            found.append(self.site(frame.parentJoint, frame.placement * getattr(loop, f"placement{end}") * moved))
        return found

    def loop(self, loop):
        name = quoteattr(loop.name)
        if isinstance(loop, Drive):
            raise NotTranslatedError(f"drive {loop.name!r}: MuJoCo has no joints that follow a curve exactly")
        elif isinstance(loop, Coupling):
            law = (loop.offset, loop.ratio, *loop.higher)
            if len(law) > POWERS:
                raise NotTranslatedError(f"coupling {loop.name!r} has more powers than a joint equality of MuJoCo")
            law = numbers((*law, *[0.0] * (POWERS - len(law))))
            one, two = (self._sum(loop, k) for k in (0, 1))
            self.equalities.append(f'<tendon name={name} tendon1={one} tendon2={two} polycoef="{law}"/>')
        elif not isinstance(loop, Loop):
            raise NotTranslatedError(f"constraint {loop.name!r} is a user-defined function")
        else:
            self._anchored(loop, name)

    def _sum(self, coupling, end) -> str:
        """The name of a fixed tendon whose length is the sum of joints at one end of a coupling."""
        name = quoteattr(f"{coupling.name}, {('joint', 'other')[end]}")
        whose, shares = f"coupling {coupling.name!r}", dict(coupling.shares[end])
        parts = (f'<joint joint={self._plain(joint, whose)} coef="{share!r}"/>' for joint, share in shares.items())
        self.tendons.append(f"<fixed name={name}>{''.join(parts)}</fixed>")
        return name

    def _anchored(self, loop, name):
        if loop.kind == "distance":
            path = "".join(f'<site site="{end}"/>' for end in self.ends(loop))
            self.tendons.append(f"<spatial name={name}>{path}</spatial>")
            self.equalities.append(f"<tendon name={name} tendon1={name}/>")
            self.lengths.append((loop.name, loop.length))
        elif loop.kind == "frame":
            one, two = self.ends(loop)
            self.equalities.append(f'<weld name={name} site1="{one}" site2="{two}"/>')
        elif loop.kind in ("point", "hinge"):
            one, two = self.ends(loop)
            self.equalities.append(f'<connect name={name} site1="{one}" site2="{two}"/>')
            if loop.name in self.tilted:
                one, two = self.ends(loop, ARM * self.size * unit(loop.axis))
                second = quoteattr(f"{loop.name}, second point")
                self.equalities.append(f'<connect name={second} site1="{one}" site2="{two}"/>')
        else:
            raise NotTranslatedError(f"loop {loop.name!r} is of kind {loop.kind!r}, which MuJoCo's equalities are not")

    @cached_property
    def size(self) -> float:
        """The extent of the joints at the guess, m."""
        data = self.model.createData()
        pin.forwardKinematics(self.model, data, self.mechanism.guess)
        points = np.array([pose.translation for pose in data.oMi])
        return float(np.linalg.norm(np.ptp(points, axis=0))) or 1.0

    def _plain(self, joint, whose) -> str:
        if self._by_name[joint].kind != "scalar":
            raise NotTranslatedError(f"{whose}: joint {joint!r} stores (cos, sin) here; MuJoCo counts its turns")
        return quoteattr(joint)

    def force(self, force):
        counted = {joint.name for joint in self.joints if joint.kind == "scalar" and len(joint.parts) == 1}
        if isinstance(force, JointDamping) and (spread := self._alike(force)) is not None:
            self._damping += spread
        elif isinstance(force, JointSpring) and force.plain and force.joint in counted - self._springs.keys():
            self._springs[force.joint] = f'stiffness="{force.stiffness!r}" springref="{force.rest!r}"'
        elif isinstance(force, SpringDamper) and force.stiffness >= 0.0:
            self._tendon_spring(force)
        elif isinstance(force, Servo) and force.joint in counted:
            self._servo(force)
        elif isinstance(force, Actuator) and force.arms.keys() <= counted:
            self._actuator(force)
        elif type(force).__name__ == "JointFriction" and (spread := self._alike(force)) is not None:
            self._friction += spread
        elif self._of_counted(force, counted):
            for joint, torque in force.torques.items():
                self.actuators.append(f"<motor joint={quoteattr(joint)}/>")
                self.commands.append((len(self.actuators) - 1, as_command(torque)))
        elif constant(force) and not any(joint.kind in ("free", "planar") for joint in self.joints):
            self.steady += force.bind(self.bare).torque(0.0, self.mechanism.guess, np.zeros(self.model.nv))
        else:
            self.others.append(force)

    @staticmethod
    def _of_counted(force, counted) -> bool:
        """Whether a force is torques on joints of one degree of freedom, some of them functions of time."""
        if not isinstance(force, JointTorque) or constant(force) or not isinstance(force.torques, Mapping):
            return False
        return force.torques.keys() <= counted

    def _alike(self, force):
        """Coefficients (nv,), if each joint has one for all its velocities, as in MuJoCo."""
        bound = force.bind(self.bare)
        given = bound._coefficients
        alike = all(np.ptp(given[joint.v]) == 0.0 for joint in self.joints if not joint.parts)
        planar = any(joint.kind == "planar" and given[joint.v].any() for joint in self.joints)
        return given if alike and not planar else None

    def _tendon_spring(self, force):
        ends = [self.site(joint, pin.SE3(np.eye(3), point)) for joint, point in force.bind(self.bare).ends]
        path = "".join(f'<site site="{end}"/>' for end in ends)
        values = f'stiffness="{force.stiffness!r}" springlength="{force.length!r}" damping="{force.damping!r}"'
        self.tendons.append(f"<spatial {values}>{path}</spatial>")

    def _servo(self, force):
        k, d, joint = force.stiffness, force.damping, quoteattr(force.joint)
        self.actuators.append(
            f'<general joint={joint} gaintype="fixed" gainprm="1" biastype="affine" biasprm="0 {-k!r} {-d!r}"/>'
        )
        bound = force.bind(self.bare)
        self.commands.append((len(self.actuators) - 1, lambda t: float(np.dot((k, d), bound.wanted(t)))))

    def _actuator(self, force):
        arms = force.arms
        if isinstance(force.joint, str):
            on, gear = f"joint={quoteattr(force.joint)}", force.gear
        else:
            name = quoteattr(f"tendon of {force.name}")
            shares = "".join(f'<joint joint={quoteattr(joint)} coef="{arm!r}"/>' for joint, arm in arms.items())
            self.tendons.append(f"<fixed name={name}>{shares}</fixed>")
            on, gear = f"tendon={name}", 1.0
        limits = "".join(
            f' {what}limited="true" {what}range="{numbers(ends)}"'
            for what, ends in (("ctrl", force.control_range), ("force", force.force_range))
            if ends
        )
        self.actuators.append(
            f'<general {on} gear="{gear!r}" gaintype="affine" gainprm="{numbers(force.gain)}" biastype="affine" '
            f'biasprm="{numbers(force.bias)}"{limits}/>'
        )
        self.commands.append((len(self.actuators) - 1, as_command(force.control)))

    def body(self, i) -> str:
        model, joint = self.model, self.joints[i - 1]
        inertia = model.inertias[i]
        place = pin.SE3.Identity() if joint.kind == "free" else model.jointPlacements[i]
        mass = ""
        if inertia.mass:
            I = inertia.inertia
            full = numbers([I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]])
            mass = f'<inertial pos="{numbers(inertia.lever)}" mass="{inertia.mass!r}" fullinertia="{full}"/>'
        inner = "".join(self.body(child) for child in self.children(i))
        return f"<body {pose_text(place)}>{mass}{self._joint(joint)}{self.sites(i)}{inner}</body>"

    def _joint(self, joint) -> str:
        armature = self.model.armature[joint.v]
        if not joint.parts:
            if np.ptp(armature) or (joint.kind == "free" and armature.any()):
                raise NotTranslatedError(f"joint {joint.name!r} has rotor inertia along axes of its own")
            own = self._values(joint.v.start)
            kind = "ball" if joint.kind == "ball" else "free"
            return f'<joint name={quoteattr(joint.name)} type="{kind}" {own}/>'
        several = len(joint.parts) > 1
        if joint.kind == "planar" and armature.any():
            raise NotTranslatedError(f"joint {joint.name!r} has rotor inertia along axes of its own")
        written = []
        for k, (kind, axis) in enumerate(joint.parts):
            name = quoteattr(f"{joint.name}[{k}]" if several else joint.name)
            own = self._values(joint.v.start + k) + " " + self._springs.get(joint.name, "")
            written.append(f'<joint name={name} type="{kind}" axis="{numbers(axis)}" {own}/>')
        return "".join(written)

    def _values(self, column) -> str:
        values = {"damping": self._damping, "armature": self.model.armature, "frictionloss": self._friction}
        return " ".join(f'{key}="{float(each[column])!r}"' for key, each in values.items() if each[column])


def constant(force) -> bool:
    """Whether a force is a constant joint torque."""
    if not isinstance(force, JointTorque):
        return False
    torques = force.torques
    return not (isinstance(torques, Mapping) and any(callable(each) for each in torques.values()))


def as_command(value):
    """A number or a function of time as a function of time."""
    return (lambda t: float(value(t))) if callable(value) else lambda t: value


def numbers(values) -> str:
    return " ".join(repr(float(value)) for value in values)


def pose_text(place) -> str:
    x, y, z, w = pin.Quaternion(place.rotation).coeffs()
    return f'pos="{numbers(place.translation)}" quat="{numbers((w, x, y, z))}"'
