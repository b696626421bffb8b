"""Springs and dampers between two points of a mechanism."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ..errors import InputError
from .loop import GROUND


@dataclass(frozen=True)
class SpringDamper:
    """A spring and damper along the line between two points.

    The tension, positive where it pulls, is k (l - l₀) + d dl/dt with l the distance of the points.

    Parameters
    ----------
    frame1, frame2 : str
        Frames of the model; ``"universe"`` is the ground.
    stiffness : float
        k, N/m.
    length : float
        l₀, the length at which the spring is slack, m.
    damping : float
        d, N·s/m.
    xyz1, xyz2 : tuple of 3 float
        The points in their frames, m.
    """

    frame1: str
    frame2: str = GROUND
    stiffness: float = 0.0
    length: float = 0.0
    damping: float = 0.0
    xyz1: tuple[float, float, float] = (0.0, 0.0, 0.0)
    xyz2: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def bind(self, model: pin.Model) -> _BoundSpring:
        """The force on one model."""
        return _BoundSpring(self, model)


class _BoundSpring:
    """A SpringDamper with its own workspace on a model."""

    def __init__(self, spring, model):
        self.spring, self.model, self.data = spring, model, model.createData()
        self._ends = [_end(model, spring.frame1, spring.xyz1), _end(model, spring.frame2, spring.xyz2)]
        if self._ends[0][0] == self._ends[1][0]:
            raise InputError(f"the spring between {spring.frame1!r} and {spring.frame2!r} joins a body to itself")

    def torque(self, t, q, v):
        _, tension, J = self._line(q, v)
        return -tension * J

    def derivatives(self, t, q, v):
        """Stiffness and damping along the line; its turning is left to the iteration."""
        _, _, J = self._line(q, v)
        return -self.spring.stiffness * np.outer(J, J), -self.spring.damping * np.outer(J, J)

    def _line(self, q, v):
        """Length, tension, and the gradient J of the length, shape (nv,)."""
        pin.computeJointJacobians(self.model, self.data, q)
        (x1, J1), (x2, J2) = (self._point(*end) for end in self._ends)
        r = x2 - x1
        l = np.linalg.norm(r)
        if l == 0.0:
            return 0.0, 0.0, np.zeros(self.model.nv)
        J = r @ (J2 - J1) / l
        spring = self.spring
        return l, spring.stiffness * (l - spring.length) + spring.damping * (J @ v), J

    def _point(self, joint, offset):
        pose = self.data.oMi[joint]
        if joint == 0:
            return offset, np.zeros((3, self.model.nv))
        J = pin.getJointJacobian(self.model, self.data, joint, pin.LOCAL_WORLD_ALIGNED)
        arm = pose.rotation @ offset
        return pose.translation + arm, J[:3] - pin.skew(arm) @ J[3:]


def _end(model, name, xyz):
    if not model.existFrame(name):
        raise InputError(f"spring: the model has no frame {name!r}")
    frame = model.frames[model.getFrameId(name)]
    return frame.parentJoint, frame.placement.act(np.array(xyz, float))
