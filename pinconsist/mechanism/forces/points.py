"""Points of bodies at a configuration, for the forces that are evaluated in Python."""

from collections import namedtuple
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cached_property

import numpy as np
import pinocchio as pin

from ..checks import workspace

# A point of a body at a configuration, in world axes: position (3,), and Jacobians of velocity and spin, (3, nv).
_Point = namedtuple("_Point", "joint x J spin")


_SHARED: ContextVar[dict | None] = ContextVar("kinematics of the forces that are bound together", default=None)


@contextmanager
def shared_points():
    """Within the block, all forces of a model share one :class:`Points`: its workspace has eight arrays of nv³."""
    before = _SHARED.set({})
    try:
        yield
    finally:
        _SHARED.reset(before)


def points_of(model: pin.Model):
    """Points of a model: shared, or new."""
    shared = _SHARED.get()
    if shared is None:
        return Points(model)
    if id(model) not in shared:
        shared[id(model)] = Points(model)
    return shared[id(model)]


class Points:
    """Kinematics of points on one model, at the configuration of the last :meth:`move`."""

    def __init__(self, model: pin.Model):
        self.model = model
        self._still = np.zeros((3, model.nv))

    @cached_property
    def data(self) -> pin.Data:
        """Its workspace, which runs in C++ do not need."""
        return workspace(self.model)

    def move(self, q) -> None:
        pin.computeJointJacobians(self.model, self.data, q)

    def at(self, joint: int, offset) -> _Point:
        """The point fixed at `offset` in a joint's axes."""
        if joint == 0:
            return _Point(joint, offset, self._still, self._still)
        pose = self.data.oMi[joint]
        J = pin.getJointJacobian(self.model, self.data, joint, pin.LOCAL_WORLD_ALIGNED).reshape(6, -1)  # (6,) if nv = 1
        arm = pose.rotation.dot(offset)
        spin = J[3:]
        return _Point(joint, pose.translation + arm, J[:3] - pin.skew(arm).dot(spin), spin)
