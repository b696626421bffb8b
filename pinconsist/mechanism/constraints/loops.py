"""Loop closures: the rows Φ(t, q), J(t, q) that the records among the loops of a mechanism stand for.

This is the only file that names Pinocchio's constraint classes.

Conventions (stated here once)
------------------------------
A loop joins anchor 1 (on ``frame1``) to anchor 2 (on ``frame2``); either may sit on the ground, whose frame is
``"universe"``. With ``d`` the position of anchor 2 seen from anchor 1 **in the axes of anchor 1**, ``R`` the
rotation that takes axes of anchor 2 to axes of anchor 1, ``e`` the loop's ``axis`` at length 1, ``u1`` along the
product of e with the coordinate axis that is farthest from it, ``u2 = e × u1``, and ``a = R e`` (of a universal,
``a = R axis2``), the rows are

========== ===== ============================================================== ============================
kind       rows  Φ                                                              λ (equations M v' + nle = τ + Jᵀλ)
========== ===== ============================================================== ============================
point      3     d                                                              force on body 2, N
frame      6     d, log R                                                       force and moment on body 2
hinge      5     d, chord between a and e (two rows, about u1 and u2)           force, moment across the axis
distance   1     (|d|² − L²) / (2L)                                             force along d on body 2: λ < 0 pulls
slider     5     u1·d, u2·d, log R: free to slide along e                       force across the axis, moment
cylinder   4     u1·d, u2·d, chord between a and e: slides along e and turns    force, moment across the axis
plane      3     e·d, chord between a and e: free in the plane normal to e      λ > 0 pushes body 2 along e; moment
universal  4     d, e·a: body 2 turns about e (of body 1) and a (its own)       force; moment on body 2 along a × e
drive      1     q_joint − curve(t)                                             motor torque on the joint
coupling   1     q_joint − offset − ratio·q_other − Σ higher[i]·q_other^(i+2)   force on the joint, N·m or N; the
                                                                                other takes −dq_joint/dq_other of it
constraint any   the user's Φ(t, q)                                             Jᵀλ: N·m per rad or N per m of Φ
========== ===== ============================================================== ============================

all in the axes of anchor 1, acting on body 2 at anchor 2; body 1 receives the opposite, there too. Forces are in N,
moments in N·m, Φ in m and rad. Every J is the exact derivative of Φ in the tangent space, also while a loop is open.
No kind with an axis takes an antiparallel axis of body 2 for a closed loop: the chord is longest there.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ...errors import InputError
from ..checks import frame_of
from .coupling import Coupling, CouplingRow
from .custom import Constraint, ConstraintRows
from .drive import Drive, DriveRow
from .loop import GROUND, ROW_NAMES, Loop
from .loop_rows import blocks

__all__ = ["GROUND", "RECORDS", "ROW_NAMES", "Loop", "LoopRows", "anchor_constraint", "point_constraint"]

RECORDS = (Loop, Drive, Coupling, Constraint)
"""What may stand among the loops of a mechanism."""
TURNING = ("rx", "ry", "rz", "tilt1", "tilt2", "cross")  # rows in rad


class LoopRows:
    """The rows of several loops on one model, evaluated together. Private to systems and assembly.

    Attributes
    ----------
    labels : list of (str, str)
        Loop name and row name of each of the ``nc`` rows.
    slices : dict[str, slice]
        The rows of each loop.
    turns, steady : ndarray of bool, shape (nc,)
        Rows measured in rad; rows whose J does not depend on time.
    moving : bool
        Some Φ depends on time.
    """

    def __init__(self, model: pin.Model, loops):
        self.model, self.loops = model, tuple(loops)
        self.labels = [(loop.name, row) for loop in self.loops for row in loop.rows]
        self.nc = len(self.labels)
        self.slices, start = {}, 0
        for loop in self.loops:
            self.slices[loop.name] = slice(start, start := start + len(loop.rows))
        self.closures = [_rows_of(loop)(model, loop) for loop in self.loops]
        self.turns = np.array([turns for closure in self.closures for turns in closure.turns], dtype=bool)
        self.steady = np.array([closure.steady for closure in self.closures for _ in closure.turns], dtype=bool)
        self.moving = any(closure.moving for closure in self.closures)

    def evaluate(self, data: pin.Data, q=None, t: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Φ, shape (nc,), and J, shape (nc, nv), where ``pin.computeJointJacobians`` was called last on ``data``.

        `q` and `t` are what the rows without anchors look at.
        """
        if not self.closures:
            return np.zeros(0), np.zeros((0, self.model.nv))
        values, jacobians = zip(*(closure.evaluate(data, q, t) for closure in self.closures), strict=True)
        return np.concatenate(values), np.concatenate(jacobians)

    def time_rate(self, t: float, q=None) -> np.ndarray:
        """Φ_t, shape (nc,)."""
        parts = [closure.rate(t, q) if closure.moving else np.zeros(len(closure.turns)) for closure in self.closures]
        return np.concatenate(parts) if parts else np.zeros(0)

    def check_derivatives(self, t: float, q) -> None:
        """Raise InputError where derivatives that a user gave contradict the functions they belong to."""
        for closure in self.closures:
            if hasattr(closure, "check_derivatives"):
                closure.check_derivatives(t, q)

    def acceleration_bias(self, data: pin.Data, t: float = 0.0, q=None, v=None) -> np.ndarray:
        """J̇ v and the like from Φ's dependence on time, shape (nc,), at a closed configuration.

        Needs ``pin.forwardKinematics(model, data, q, v, 0)`` on ``data``. The rotational rows use R = 1 where
        the exact expression has a derivative of the logarithm.
        """
        if not self.closures:
            return np.zeros(0)
        return np.concatenate([closure.acceleration_bias(data, t, q, v) for closure in self.closures])


class AnchoredRows:
    """One loop on one model: anchors as (joint, placement), and the blocks of its rows.

    Attributes
    ----------
    place, turn
        Blocks of :mod:`pinconsist.mechanism.constraints.loop_rows`; `turn` may be None.
    """

    moving, steady = False, True

    def __init__(self, model: pin.Model, loop: Loop):
        self.model, self.loop = model, loop
        self.joint1, self.place1 = _anchor(model, loop, loop.frame1, loop.placement1)
        self.joint2, self.place2 = _anchor(model, loop, loop.frame2, loop.placement2)
        if self.joint1 == self.joint2:
            raise InputError(
                f"loop {loop.name!r}: frames {loop.frame1!r} and {loop.frame2!r} sit on the same body; "
                "a loop joins two bodies, or a body and the ground"
            )
        self.turns = tuple(row in TURNING for row in loop.rows)
        self.place, self.turn = blocks(loop)
        self.constraint = point_constraint(model, self) if self.turn is None else anchor_constraint(model, self)
        self.constraint_data = self.constraint.createData()

    def evaluate(self, data, q=None, t=0.0):
        """Φ and J of this loop."""
        self.constraint.calc(self.model, data, self.constraint_data)
        jacobian = self.constraint.jacobian(self.model, data, self.constraint_data)
        jacobian = jacobian.reshape(-1, self.model.nv)  # Pinocchio gives one column flat
        if self.turn is None:
            return self.place.rows(self.constraint_data.constraint_position_error, None, jacobian, None)
        pose = self.constraint_data.c1Mc2
        d, R = pose.translation, pose.rotation
        angular = jacobian[3:]  # the twist of body 2 relative to body 1 in axes 1, taken at anchor 1; d is at anchor 2
        return self.rows(d, R, jacobian[:3] - pin.skew(d) @ angular, angular)

    def rows(self, d, R, linear, angular):
        """Φ and J from the pose of anchor 2 seen from anchor 1 and its derivatives."""
        parts = [block.rows(d, R, linear, angular) for block in (self.place, self.turn) if block is not None]
        values, jacobians = zip(*parts, strict=True)
        return np.concatenate(values), np.concatenate(jacobians)

    def acceleration_bias(self, data, t=0.0, q=None, v=None):
        """J̇ v of this loop, from the bodies' velocities and velocity-product accelerations."""
        p1, R1, v1, w1, a1, b1 = _anchor_motion(data, self.joint1, self.place1)
        p2, R2, v2, w2, a2, b2 = _anchor_motion(data, self.joint2, self.place2)
        r, rd = p2 - p1, v2 - v1
        W1 = pin.skew(w1)
        rdd = a2 - a1 - pin.skew(b1) @ r - 2 * W1 @ rd + W1 @ (W1 @ r)
        d, dd, ddd = R1.T @ r, R1.T @ (rd - W1 @ r), R1.T @ rdd
        spin = R1.T @ (w2 - w1)
        spin_rate = R1.T @ (b2 - b1 - W1 @ w2)
        motion = d, dd, ddd, R1.T @ R2, spin, spin_rate
        return np.concatenate([block.bias(*motion) for block in (self.place, self.turn) if block is not None])


def anchor_constraint(model, closure):
    """Pinocchio's constraint of six rows between the anchors of a closure."""
    return pin.FrameAnchorConstraintModel(model, closure.joint1, closure.place1, closure.joint2, closure.place2)


def point_constraint(model, closure, shift=None):
    """Pinocchio's constraint of three rows: the position of anchor 2, or of the point at `shift` from it, seen from 1.

    Its error and Jacobian are exact also while the loop is open.
    """
    place2 = closure.place2 if shift is None else closure.place2 * pin.SE3(np.eye(3), shift)
    return pin.PointAnchorConstraintModel(model, closure.joint1, closure.place1, closure.joint2, place2)


def _anchor(model, loop, frame_name, offset):
    frame = frame_of(model, frame_name, f"loop {loop.name!r}")
    return frame.parentJoint, frame.placement * offset


def _anchor_motion(data, joint, placement):
    """Position, axes, velocity, spin, classical acceleration and spin rate of an anchor, in world axes."""
    pose = data.oMi[joint] * placement
    if joint == 0:
        zero = np.zeros(3)
        return pose.translation, pose.rotation, zero, zero, zero, zero
    R = pose.rotation
    velocity, acceleration = placement.actInv(data.v[joint]), placement.actInv(data.a[joint])
    classical = acceleration.linear + pin.skew(velocity.angular) @ velocity.linear
    return pose.translation, R, R @ velocity.linear, R @ velocity.angular, R @ classical, R @ acceleration.angular


def _rows_of(loop):
    kinds = {Loop: AnchoredRows, Drive: DriveRow, Coupling: CouplingRow, Constraint: ConstraintRows}
    return next(rows for record, rows in kinds.items() if isinstance(loop, record))
