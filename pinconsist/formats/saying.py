"""What the writers of SDF, MJCF and USD share: a mechanism in the words that files have, or what they cannot say."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from ..errors import InputError
from ..mechanism.assembly import assemble
from ..mechanism.checks import places
from ..mechanism.forces import (
    Actuator,
    JointDamping,
    JointFriction,
    JointSpring,
    JointTorque,
    Servo,
    model_forces,
)
from ..mechanism.joint_constraints import Coupling, Drive
from ..mechanism.lie import integrate
from ..mechanism.loops import Loop
from ..mechanism.mechanism import Mechanism
from ..mechanism.rows import LoopRows
from ..mechanism.system import MechanismSystem
from .urdf import UNLIMITED

ROOT_JOINT = "root_joint"  # the name of a floating base in files that do not name it
LEAST = 1e-12  # of the mass of a machine: that of a body without mass, in files that must have one
_KINDS = (("RevoluteUnbounded", "unbounded"), ("RUB", "unbounded"), ("R", "revolute"), ("P", "prismatic"))


class Unsaid(InputError):
    """A mechanism has something that a file of some kind cannot say."""


@dataclass
class Motion1:
    """A joint of a model in words: its kind, the axis of one degree of freedom, and the numbers of the motion."""

    name: str
    kind: str  # revolute, prismatic, helical, ball, free, planar, translation or unbounded
    index: int
    axis: np.ndarray | None
    pitch: float = 0.0  # m per radian
    damping: float = 0.0
    friction: float = 0.0
    armature: float = 0.0
    stiffness: float = 0.0
    rest: float | tuple = 0.0
    lower: float = -np.inf
    upper: float = np.inf
    effort: float = np.inf


@dataclass
class Said:
    """The parts of a mechanism, in the order in which files have them."""

    mechanism: Mechanism
    q: np.ndarray  # a closed configuration
    poses: list  # of the joints, in the world there
    links: list[str]  # names of the bodies of the joints; the first is the ground
    joints: list[Motion1]
    loops: list[Loop] = field(default_factory=list)
    couplings: list[Coupling] = field(default_factory=list)
    forces: list = field(default_factory=list)  # all but dampers, friction and springs of single joints

    def anchor(self, loop, end):
        """(joint, place on it) of an anchor of a loop."""
        frame = self.mechanism.model.frames[self.mechanism.model.getFrameId(getattr(loop, f"frame{end}"))]
        return frame.parentJoint, frame.placement * getattr(loop, f"placement{end}")


def said(mechanism: Mechanism, what: str, links: list[str]) -> Said:
    """The parts of a mechanism for a file of the kind `what`; Unsaid for drives, user's functions and odd joints."""
    model = mechanism.model
    q = assemble(mechanism).q if mechanism.loops else np.array(mechanism.guess)
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    joints = [_motion(model, i) for i in range(1, model.njoints)]
    found = Said(mechanism, q, [pose.copy() for pose in data.oMi], links, joints)
    for loop in mechanism.loops:
        if isinstance(loop, Loop):
            found.loops.append(loop)
        elif isinstance(loop, Coupling):
            found.couplings.append(loop)
        else:
            kind = "drive" if isinstance(loop, Drive) else "constraint"
            raise Unsaid(f"{what} has no {kind} such as {loop.name!r}; leave it out: mech.with_loops(…)")
    by_name = {joint.name: joint for joint in joints}
    for force in (*model_forces(model), *mechanism.forces):
        if isinstance(force, (JointDamping, JointFriction)):
            _spread(model, joints, force, what)
        elif not _is_own_spring(by_name, force):
            found.forces.extend(_actuators(by_name, force))
    return found


def _motion(model, i) -> Motion1:
    which = model.joints[i].shortname().removeprefix("JointModel")
    named = {"Spherical": "ball", "FreeFlyer": "free", "Planar": "planar", "Translation": "translation"}
    kind = named.get(which) or ("helical" if which.startswith("H") else "")
    kind = kind or next((word for start, word in _KINDS if which.startswith(start)), which)
    q, v = places(model, i)
    found = Motion1(model.names[i], kind, i, None, armature=float(model.armature[v][0]))
    if np.ptp(model.armature[v]):
        raise Unsaid(f"joint {found.name!r} has different rotor inertias about its axes")
    if model.nvs[i] == 1:
        data = model.createData()
        pin.computeJointJacobians(model, data, pin.neutral(model))
        twist = np.reshape(pin.getJointJacobian(model, data, i, pin.LOCAL), (6, -1))[:, v].ravel()
        found.axis = twist[:3] if kind == "prismatic" else twist[3:]
        found.pitch = float(twist[:3] @ twist[3:]) if kind == "helical" else 0.0
        found.effort = float(model.upperEffortLimit[v][0])
        if model.nqs[i] == 1:
            ends = (float(side[q][0]) for side in (model.lowerPositionLimit, model.upperPositionLimit))
            found.lower, found.upper = (end if abs(end) < UNLIMITED else np.copysign(np.inf, end) for end in ends)
    return found


def _spread(model, joints, force, what):
    given = force.bind(model)._coefficients
    for joint in joints:
        own = given[places(model, joint.index)[1]]
        if np.ptp(own):
            raise Unsaid(f"{what} has one damping or friction for joint {joint.name!r}, not one for each axis")
        if isinstance(force, JointDamping):
            joint.damping += float(own[0])
        else:
            joint.friction += float(own[0])


def _is_own_spring(by_name, force) -> bool:
    """Add the spring of a joint to its numbers; False if it has one already, or one that is slack."""
    if not isinstance(force, JointSpring) or not isinstance(force.joint, str):
        return False
    joint = by_name[force.joint]
    if joint.stiffness or (isinstance(force.rest, tuple) and joint.axis is not None):
        return False
    joint.stiffness, joint.rest = force.stiffness, force.rest
    joint.damping += force.damping
    return True


def _actuators(by_name, force) -> list:
    """A force as actuators, if it is a constant torque or a servo that holds a position."""
    if isinstance(force, Servo) and not callable(force.target) and not callable(force.rate):
        k, d = force.stiffness, force.damping
        return [Actuator(f"servo {force.joint}", force.joint, (k, 0.0, 0.0), (0.0, -k, -d), control=force.target)]
    if isinstance(force, JointTorque) and isinstance(force.torques, Mapping):
        plain = all(isinstance(torque, float) for torque in force.torques.values())
        if plain and all(by_name[joint].axis is not None for joint in force.torques):
            return [Actuator(f"torque {joint}", joint, control=torque) for joint, torque in force.torques.items()]
    return [force]


def least_inertia(model) -> pin.Inertia:
    """What a body without mass has in files that must give it one; too little to change the motion."""
    mass = LEAST * sum(each.mass for each in model.inertias)
    return pin.Inertia(mass, np.zeros(3), mass * np.eye(3))


def in_world(mechanism: Mechanism):
    """(joint, its numbers in q) → those in a file in which free joints are placed relative to the world."""
    model = mechanism.model

    def convert(name, own):
        joint = model.getJointId(name)
        if model.nvs[joint] != 6:
            return own
        return pin.SE3ToXYZQUAT(model.jointPlacements[joint] * pin.XYZQUATToSE3(np.array(own)))

    return convert


def require_same_motion(mechanism, back, convert=None, tolerance=1e-9) -> None:
    """Raise Unsaid unless the accelerations of both mechanisms agree at closed states.

    `convert` maps (joint, its numbers in q) to those of `back`, whose joints have the same names. A free joint may be
    missing there, if the loops determine where its body is.
    """
    model, rng = mechanism.model, np.random.default_rng(0)
    names = {name: _in_file(back.model, name) for name in mechanism.joints}
    for name in [name for name, there in names.items() if there is None]:
        if model.nvs[model.getJointId(name)] != 6 or not mechanism.loops:
            raise Unsaid(f"joint {name!r} is not there when it is read back")
        del names[name]
    start = assemble(mechanism).q if mechanism.loops else np.array(mechanism.guess)
    for _ in range(3):
        q = start if mechanism.loops else integrate(model, start, rng.uniform(-0.5, 0.5, model.nv))
        v = _consistent(mechanism, q, rng.normal(size=model.nv))
        mine = _acceleration(mechanism, q, v)
        q_back, v_back, other = np.array(back.guess), np.zeros(back.nv), np.ones(back.nv, bool)
        for name, there in names.items():
            ours, theirs = places(model, model.getJointId(name)), places(back.model, there)
            q_back[theirs[0]] = convert(name, q[ours[0]]) if convert else q[ours[0]]
            v_back[theirs[1]], other[theirs[1]] = v[ours[1]], False
        if other.any():
            q_back = assemble(back, q_back).q
        v_back = _consistent(back, q_back, v_back, other)
        found = _acceleration(back, q_back, v_back)
        size = max(1.0, np.abs(mine).max(initial=0.0))
        for name, there in names.items():
            ours, theirs = places(model, model.getJointId(name))[1], places(back.model, there)[1]
            if np.abs(mine[ours] - found[theirs]).max() > tolerance * size:
                raise Unsaid(f"joint {name!r} moves differently when it is read back; please report this")


def _in_file(model, name):
    """The index of a joint that was read back; a floating base has its own name there."""
    for each in (name, ROOT_JOINT):
        if model.existJointName(each):
            return model.getJointId(each)
    return None


def _consistent(mechanism, q, v, free=None):
    """The velocity nearest to `v` that the loops allow; the components in the mask `free` may take any value."""
    rows = LoopRows(mechanism.model, mechanism.loops)
    J = rows.at(q)[1]
    if free is not None and free.any() and len(J):
        v[free] = -np.linalg.lstsq(J[:, free], J @ np.where(free, 0.0, v), rcond=1e-9)[0]
    return v - np.linalg.pinv(J, rcond=1e-9) @ (J @ v) if len(J) else v


def _acceleration(mechanism, q, v) -> np.ndarray:
    """The acceleration at a closed state, by least squares, as rows may be redundant."""
    model, data = mechanism.model, mechanism.model.createData()
    M = pin.crba(model, data, q).copy()
    M = np.triu(M) + np.triu(M, 1).T
    force = MechanismSystem(mechanism, q).torque(0.0, q, v) - pin.nle(model, data, q, v)
    rows = LoopRows(model, mechanism.loops)
    J = rows.at(q)[1]
    if not len(J):
        return np.linalg.lstsq(M, force, rcond=None)[0]
    bias = rows.acceleration_bias(0.0, q, v)
    matrix = np.block([[M, J.T], [J, np.zeros((len(J), len(J)))]])
    return np.linalg.lstsq(matrix, np.concatenate((force, -bias)), rcond=1e-12)[0][: model.nv]
