"""Points of bodies: where they are, how they move with v, and how the joint torques of forces on them change with q."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin


class Point(NamedTuple):
    """A point of a body at a configuration, in world axes: position (3,), and J of its velocity and spin, (3, nv)."""

    joint: int
    x: np.ndarray
    J: np.ndarray
    spin: np.ndarray


class Points:
    """Kinematics of points on one model, with its own workspace."""

    def __init__(self, model: pin.Model):
        self.model = model.copy()
        self.model.gravity.setZero()  # static torques are then those of the given forces alone
        self.data = self.model.createData()
        self._loads = pin.StdVec_Force([pin.Force.Zero() for _ in range(model.njoints)])
        self._still = np.zeros((3, model.nv))

    def move(self, q) -> None:
        """Go to a configuration."""
        pin.computeJointJacobians(self.model, self.data, q)

    def at(self, joint: int, offset) -> Point:
        """The point fixed at `offset` in a joint's axes."""
        if joint == 0:
            return Point(joint, offset, self._still, self._still)
        pose = self.data.oMi[joint]
        J = pin.getJointJacobian(self.model, self.data, joint, pin.LOCAL_WORLD_ALIGNED).reshape(6, -1)  # (6,) if nv = 1
        arm = pose.rotation.dot(offset)
        spin = J[3:]
        return Point(joint, pose.translation + arm, J[:3] - pin.skew(arm).dot(spin), spin)

    def gradient(self, q, loads, *, turning: bool) -> np.ndarray:
        """∂(Σ Jᵀ f + spinᵀ m)/∂q, shape (nv, nv) in the tangent space.

        Parameters
        ----------
        q : ndarray
            The configuration, where :meth:`move` went.
        loads : sequence of (Point, force, moment)
            In world axes; always on the same bodies, each at most once.
        turning : bool
            Whether they turn with their bodies; else they keep their directions in the world.
        """
        change = 0.0
        for point, force, moment in loads:
            if point.joint:
                about_origin = moment + pin.skew(point.x).dot(force)
                self._loads[point.joint] = self.data.oMi[point.joint].actInv(pin.Force(force, about_origin))
                if not turning:  # a fixed direction turns in the axes of its body
                    change += (point.J.T.dot(pin.skew(force)) + point.spin.T.dot(pin.skew(moment))).dot(point.spin)
        return change - pin.computeStaticTorqueDerivatives(self.model, self.data, q, self._loads)
