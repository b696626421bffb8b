"""Motor torques for a motion, and the map between motor torques and forces at frames."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from ..errors import InputError, SingularSystemError
from ..mechanism.checks import finite_array, frame_of
from ..mechanism.mechanism import Mechanism
from ..mechanism.names import joints_in
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
    """

    mechanism: Mechanism = field(repr=False)
    t: float = field(repr=False)
    q: np.ndarray = field(repr=False)
    v: np.ndarray = field(repr=False)
    a: np.ndarray = field(repr=False)
    lam: np.ndarray = field(repr=False)
    tau: np.ndarray = field(repr=False)
    torques: dict[str, float]


def torques_for(act, q, v, a, forces, t) -> MotorTorques:
    """See :meth:`Actuation.torques`."""
    if not isinstance(forces, Mapping):
        raise InputError(f"forces= needs a mapping of frames to forces, got {forces!r}")
    loads = sum((_load(act, q, frame, force) for frame, force in forces.items()), np.zeros(act.mechanism.nv))
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
    return MotorTorques(act.mechanism, t, *state, lam, tau, torques)


def _load(act, q, frame, force):
    """Jᵀ f of a force, or force and moment, at a frame, (nv,)."""
    force, J = _checked(force, frame), _frame_jacobian(act, q, _frame_id(act, frame))
    return J[: len(force)].T @ force


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
