"""Motor torques for a motion, forces at frames; the range of each motor, and tables on a grid of motor positions."""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import product
from math import inf, tau

import numpy as np
import pinocchio as pin

from ..errors import InputError, SingularSystemError
from ..files import as_path, write_csv, written_whole
from ..mechanism.checks import finite_array, frame_of
from ..mechanism.forces import Wrench
from ..mechanism.mechanism import Mechanism
from ..mechanism.names import beyond_limits, joints_in, position_names, position_units, velocity_units
from ..mechanism.reactions import HasReactions
from .variations import Locked

UNBALANCED = 1e-8  # relative to the loads: largest force that the motors may leave unbalanced
AXES = pin.LOCAL_WORLD_ALIGNED


@dataclass(frozen=True, eq=False)
class MotorTorques(Locked, HasReactions):
    """Motor torques for a motion.

    Attributes
    ----------
    mechanism : Mechanism
        The mechanism.
    t : float
        Time, s.
    q, v, a : ndarray, shapes (nq,), (nv,), (nv,)
        The state and its acceleration.
    lam : ndarray, shape (nc,)
        Multipliers of all rows, those of smallest norm; see :meth:`reaction`.
    tau : ndarray, shape (m,)
        Torques of the motors, N·m or N, in the order of :attr:`Actuation.motors`.
    torques : dict[str, float]
        The same by the names of the motors.
    forces : dict[str, ndarray]
        Frame → force, N, or force and moment, N·m, in world axes.
    """

    mechanism: Mechanism = field(repr=False)
    t: float = field(repr=False)
    q: np.ndarray = field(repr=False)
    v: np.ndarray = field(repr=False)
    a: np.ndarray = field(repr=False)
    lam: np.ndarray = field(repr=False)
    tau: np.ndarray = field(repr=False)
    torques: dict[str, float]
    forces: dict[str, np.ndarray] = field(default_factory=dict, repr=False)

    def _motion(self):
        return self.v, self.a

    def _scene(self):
        model, wrenches = self.mechanism.model, []
        for frame, force in self.forces.items():
            if frame_of(model, frame, self.mechanism.name).parentJoint:
                wrenches.append(Wrench(frame, *force.reshape(-1, 3)))
        return self.mechanism.add_forces(*wrenches)


def torques_for(act, q, v, a, forces, t) -> MotorTorques:
    """See :meth:`Actuation.torques`."""
    if not isinstance(forces, Mapping):
        raise InputError(f"forces= needs a mapping of frames to forces, got {forces!r}")
    loads = np.zeros(act.mechanism.nv)
    forces = {frame: _checked(force, frame) for frame, force in forces.items()}
    for frame, force in forces.items():
        loads += _frame_jacobian(act, q, _frame_id(act, frame))[: len(force)].T @ force
    reduced = act._reduced(q, v, t, loads)
    every, a = act._of_motors(a, "a")
    y = a[act._chosen.columns] if every else reduced.coordinates(a)
    M, h = reduced.every
    load, n = M @ y + h, len(reduced.h)
    left = np.abs(load[n:]).max(initial=0.0)
    if every and left > UNBALANCED * max(np.abs(load).max(), np.abs(h).max()):
        names = joints_in(act.mechanism, reduced.Z[:, n:])
        raise SingularSystemError(
            f"{act.mechanism.name}: the motors cannot produce this motion: {left:.3g} N·m or N remain unbalanced in "
            f"the free motions of {', '.join(names)}. Pass the accelerations of the motors only; the others follow",
            names=names,
        )
    tau, acceleration = reduced.share.T @ load[:n], reduced.Z @ y + reduced.drift
    carried = reduced.inertia @ acceleration + reduced.f
    carried[act._columns] -= tau
    J = act._solver.rows(q)[1]
    lam = np.linalg.lstsq(J.T, carried, rcond=1e-10)[0]
    torques = dict(zip(act.motors, tau.tolist(), strict=True))
    state = np.array(q), reduced.v.copy(), acceleration
    return MotorTorques(act.mechanism, t, *state, lam, tau, torques, forces)


def _checked(force, frame):
    force = finite_array(force, f"the force at {frame!r}")
    if force.shape not in ((3,), (6,)):
        raise InputError(f"the force at {frame!r} needs three or six numbers, got shape {force.shape}")
    return force


def _frame_id(act, frame):
    model = act.mechanism.model
    return model.getFrameId(frame_of(model, frame, act.mechanism.name).name)


def _frame_jacobian(act, q, frame):
    """The Jacobian of a frame, (6, nv): velocity of its origin and angular velocity, in world axes."""
    return pin.computeFrameJacobian(act.mechanism.model, act._chosen.system.data, q, frame, AXES).reshape(6, -1)


class MotorFrame:
    """The map from motors to a frame, in world axes at its origin.

    Attributes
    ----------
    name : str
        Name of the frame.

    See Also
    --------
    Actuation.frame : returns it.
    """

    def __init__(self, act, name: str):
        self._act, self.name, self._frame = act, name, _frame_id(act, name)

    def __repr__(self):
        return f"MotorFrame({self.name!r})"

    def pose(self, q=None) -> pin.SE3:
        """The pose in a closed configuration `q`, by default the last one that the closure reached."""
        model, data = self._act.mechanism.model, self._act._chosen.system.data
        pin.forwardKinematics(model, data, self._act._q(q))
        return pin.SE3(pin.updateFramePlacement(model, data, self._frame))

    def jacobian(self, q=None) -> np.ndarray:
        """The velocity, m/s, and angular velocity, rad/s, for unit velocities of the motors, shape (6, m), at `q`."""
        q = self._act._q(q)
        A = self._act.jacobian(q)
        return _frame_jacobian(self._act, q, self._frame) @ A

    def torques(self, force, q=None) -> np.ndarray:
        """The motor torques, shape (m,), with which the frame exerts this `force` on its environment, at `q`.

        Three numbers, N, or six with the moment, N·m. For weights and inertia see :meth:`Actuation.torques`.
        """
        force = _checked(force, self.name)
        return self.jacobian(q)[: len(force)].T @ force

    def force(self, torques, q=None, *, moment: bool = False) -> np.ndarray:
        """The force, N, that the frame exerts on its environment with these motor `torques`, at `q`; shape (3,).

        It is the least-squares solution of least norm; with `moment`, force and moment, shape (6,).
        """
        tau = self._act._of_motors(torques, "torques", full=False)[1]
        J = self.jacobian(q)[: 6 if moment else 3]
        return np.linalg.lstsq(J.T, tau, rcond=1e-10)[0]


MOTOR_STRIDE = 0.05  # rad, or lengths of the mechanism: step in which a motor is moved
MOST_STRIDES = 400  # of a sliding motor
LIMIT_HALVINGS = 40


@dataclass(frozen=True)
class MotorRange:
    """How far a motor can go, the others held.

    Attributes
    ----------
    motor : str
        Name of the motor.
    lower, upper : float
        The ends of the range, rad or m; infinite if it can turn all the way round, or if no end was found.
    lower_by, upper_by : str
        The reason for each end: the joint that is at its limit, ``"singular"``, or ``"nothing"``.
    lower_condition, upper_condition : float
        :meth:`Actuation.condition` at the ends.
    lower_moves, upper_moves : tuple of str
        Joints that can move with all motors held in the singular configuration at the end.
    """

    motor: str
    lower: float
    upper: float
    lower_by: str
    upper_by: str
    lower_condition: float
    upper_condition: float
    lower_moves: tuple[str, ...]
    upper_moves: tuple[str, ...]

    def __str__(self):
        return (
            f"{self.motor}: {self.lower:.6g} ({self.lower_by}, condition {self.lower_condition:.2g}) … "
            f"{self.upper:.6g} ({self.upper_by}, condition {self.upper_condition:.2g})"
        )


def ranges(act, q) -> list[MotorRange]:
    """See :meth:`Actuation.limits`."""
    chosen, found, units = act._chosen, [], velocity_units(act.mechanism.model)
    for k in range(chosen.n_motors):
        column = chosen.columns[k]
        stride, most = MOTOR_STRIDE * chosen.sizes[column], tau if units[column] == "rad" else inf
        name, start = act.motors[chosen.own[k]], act.positions(q)[chosen.own[k]]
        ends = [_end(act, q, k, start, sign * stride, most) for sign in (-1.0, 1.0)]
        found.append(MotorRange(name, *(each for pair in zip(*ends, strict=True) for each in pair)))
    return found


def _end(act, q, k, start, stride, most):
    """(position, its reason, condition, joints that can move there) of the end of a motor's range in one direction."""
    chosen, begun, advanced = act._chosen, q, 0.0
    unit = np.zeros(len(chosen.columns))
    unit[k] = stride

    def beyond(there):
        """The joint that is farthest outside its limits, or an empty string."""
        found = beyond_limits(act.mechanism, (0.0, 1.0), np.array([begun, there]))
        return max(found, key=lambda one: max(one.value - one.upper, one.lower - one.value)).joint if found else ""

    by = beyond(q)
    while not by and abs(advanced) < most and abs(advanced) < MOST_STRIDES * abs(stride):
        there, share = chosen.follower.follow(q, unit)
        if by := beyond(there):
            low, high = 0.0, share
            for _ in range(LIMIT_HALVINGS):
                middle = 0.5 * (low + high)
                inside = not (joint := beyond(chosen.follower.follow(q, middle * unit)[0]))
                by, low, high = joint or by, middle if inside else low, high if inside else middle
            there, share = chosen.follower.follow(q, low * unit)[0], low
        q, advanced = there, advanced + share * stride
        if share < 1.0:
            by = by or "singular"
    sizes, motions = chosen.weakest(q)
    n = chosen.n_motors
    moves = joints_in(act.mechanism, motions[:, n - 1]) if by == "singular" else ()
    end = start + advanced if by else np.sign(stride) * inf
    return float(end), by or "nothing", float(sizes[n - 1]), moves


def table(act, positions, file=None) -> dict[str, np.ndarray]:
    """See :meth:`Actuation.table`."""
    suffix = "" if file is None else as_path(file).suffix
    if file is not None and suffix not in (".npz", ".csv"):
        raise InputError(f"{file}: a table is written as .npz or .csv")
    if not isinstance(positions, Mapping) or not positions:
        raise InputError(f"a table needs a mapping of motors to positions, got {positions!r}")
    if wrong := [joint for joint in positions if joint not in act.motors]:
        raise InputError(f"{wrong[0]!r} is not a motor; the motors are {', '.join(act.motors)}")
    axes = [np.atleast_1d(finite_array(values, f"positions of {joint!r}")) for joint, values in positions.items()]
    if deep := [joint for joint, axis in zip(positions, axes, strict=True) if axis.ndim != 1]:
        raise InputError(f"positions of {deep[0]!r} must be one-dimensional")
    sizes, joints, start = [len(axis) for axis in axes], list(positions), act.q
    points = np.array([each.ravel() for each in np.meshgrid(*axes, indexing="ij")]).T
    q, ok = _filled(act, joints, points, sizes)
    act.closure({}, q=start)
    requested = np.tile(act.positions(start), (len(points), 1))
    requested[:, [act.motors.index(joint) for joint in joints]] = points
    jacobian = np.zeros((len(q), act.mechanism.nv, len(act.motors)))
    condition = np.array([act.condition(each) if np.isfinite(each).all() else np.nan for each in q])
    for i in np.flatnonzero(ok):
        jacobian[i] = act.jacobian(q[i])
    found = {"positions": requested, "q": q, "ok": ok, "condition": condition, "jacobian": jacobian}
    if suffix == ".npz":
        with written_whole(file) as stream:
            names = {"motors": np.array(act.motors), "joints": np.array(position_names(act.mechanism.model))}
            np.savez(stream, **names, **found)  # type: ignore[arg-type]
    elif suffix == ".csv":
        of_v = velocity_units(act.mechanism.model)
        names = [*act.motors, *(f"q.{name}" for name in position_names(act.mechanism.model)), "ok", "condition"]
        units = [*(of_v[i] for i in act._columns), *position_units(act.mechanism.model), "", ""]
        parts = found["positions"], found["q"], found["ok"][:, None], found["condition"][:, None]
        write_csv(file, names, units, np.hstack(parts))
    return found


def _filled(act, joints, points, sizes):
    """(q, ok) at the points of a grid, each reached from a neighbour, the first from the current motor positions."""
    q, ok = np.full((len(points), act.mechanism.nq), np.nan), np.zeros(len(points), bool)
    here = act.q

    def reach(i, origin):
        q[i], ok[i] = act.closure(dict(zip(joints, points[i], strict=True)), q=origin)
        return ok[i]

    now = act.positions(here)[[act.motors.index(joint) for joint in joints]]
    nearest = np.argsort(np.abs(points - now).max(axis=1), kind="stable")
    first = next((int(i) for i in nearest if reach(i, here)), None)
    waiting = deque([] if first is None else [first])
    while waiting:
        i = waiting.popleft()
        place = np.unravel_index(i, sizes)
        for axis, step in product(range(len(sizes)), (-1, 1)):
            beside = place[axis] + step
            if 0 <= beside < sizes[axis]:
                j = int(np.ravel_multi_index((*place[:axis], beside, *place[axis + 1 :]), sizes))
                if not ok[j] and reach(j, q[i]):
                    waiting.append(j)
    return q, ok
