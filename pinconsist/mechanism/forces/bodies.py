"""Forces on points of bodies: springs and dampers between two points, and external wrenches."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import sqrt

import numpy as np
import pinocchio as pin

from ...errors import InputError
from ..axes import SMOOTH, turning_columns
from ..breakpoints import time_function
from ..checks import frame_of, name, number, put_checked, returned, triple
from ..lie import integrate
from ..loops import GROUND
from ..motion import first
from .force import BoundForce, ForceRecord

SHORTEST = 1e-9
"""Distance of the two points, m, below which the force of a spring is smoothed, as its direction is undefined at 0."""
ZERO = (0.0, 0.0, 0.0)


# A point of a body at a configuration, in world axes: position (3,), and Jacobians of velocity and spin, (3, nv).
_Point = namedtuple("_Point", "joint x J spin")


class _Points:
    """Kinematics of points on one model, with its own workspace."""

    def __init__(self, model: pin.Model):
        self.model = model.copy()
        self.model.gravity.setZero()  # static torques are then those of the given forces only
        self.data = self.model.createData()
        self._loads = pin.StdVec_Force([pin.Force.Zero() for _ in range(model.njoints)])
        self._still = np.zeros((3, model.nv))

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

    def gradient(self, q, loads, *, turning: bool) -> np.ndarray:
        """∂(Σ Jᵀ f + spinᵀ m)/∂q, shape (nv, nv) in the tangent space, at the `q` of the last :meth:`move`.

        `loads` are (point, force, moment) in world axes, always on the same bodies, each at most once. With `turning`
        they rotate with their bodies; otherwise they keep their directions in the world.
        """
        change = 0.0
        places = [self.data.oMi[point.joint].copy() for point, _, _ in loads]
        for point, force, moment in loads:
            if point.joint:
                about_origin = moment + pin.skew(point.x).dot(force)
                self._loads[point.joint] = self.data.oMi[point.joint].actInv(pin.Force(force, about_origin))
                if not turning:  # a fixed direction rotates relative to its body
                    change += (point.J.T.dot(pin.skew(force)) + point.spin.T.dot(pin.skew(moment))).dot(point.spin)
        change = change - pin.computeStaticTorqueDerivatives(self.model, self.data, q, self._loads)
        if (columns := turning_columns(self.model)).size:
            offsets = [place.actInv(point.x) for place, (point, _, _) in zip(places, loads, strict=True)]

            def torque(xi):
                self.move(integrate(self.model, q, xi))
                total = np.zeros(self.model.nv)
                for place, offset, (point, force, moment) in zip(places, offsets, loads, strict=True):
                    there = self.at(point.joint, offset)
                    turn = self.data.oMi[point.joint].rotation @ place.rotation.T if turning else np.eye(3)
                    total += (turn @ force) @ there.J + (turn @ moment) @ there.spin
                return total

            for column in columns:
                unit = np.arange(self.model.nv) == column
                change[:, column] = first(lambda s, e=unit: torque(s * e), SMOOTH)
            self.move(q)
        return change


class _BoundSpring(BoundForce):
    smooth = True

    def __init__(self, spring, model):
        self.spring, self._points = spring, _Points(model)
        self.ends = []
        for frame, xyz in ((spring.frame1, spring.xyz1), (spring.frame2, spring.xyz2)):
            frame = frame_of(model, frame, spring._who)
            self.ends.append((frame.parentJoint, frame.placement.act(np.array(xyz))))
        if self.ends[0][0] == self.ends[1][0]:
            raise InputError(f"the {spring._who} connects a body to itself")

    def torque(self, t, q, v):
        l, u, J = self._line(q)[:3]
        along = u.dot(J)
        return -self._tension(l, along @ v) * along

    def derivatives(self, t, q, v):
        """Exact: stiffness and damping along the line, T/l across it, and the rotation of the bodies."""
        l, u, J, point1, point2 = self._line(q)
        along, spring, no_moment = u.dot(J), self.spring, np.zeros(3)
        squared = along[:, None] * along
        bend = self._points.gradient(q, ((point1, -u, no_moment), (point2, u, no_moment)), turning=False)
        bend += (J.T.dot(J) - squared) / l  # now ∂²l/∂q²
        by_q = -spring.stiffness * squared - self._tension(l, along.dot(v)) * bend
        if not spring.damping:
            return by_q, None
        return by_q - (spring.damping * along)[:, None] * v.dot(bend), -spring.damping * squared

    def hand_over(self, compiled) -> bool:
        spring, (end1, end2) = self.spring, self.ends
        compiled.add_spring(*end1, *end2, spring.stiffness, spring.length, spring.damping, SHORTEST)
        return True

    def hand_over_damper(self, compiled) -> None:
        """Add only the damper to the compiled system, the part without stored energy."""
        spring, (end1, end2) = self.spring, self.ends
        compiled.add_spring(*end1, *end2, 0.0, spring.length, spring.damping, SHORTEST)

    def stored(self, q, v) -> tuple[float, float]:
        l, u, J = self._line(q)[:3]
        load = self.spring.stiffness * (l - self.spring.length)
        return 0.5 * load * (l - self.spring.length), load * (u @ J @ v)

    def loads(self, t, q, v):
        l, u, J, point1, point2 = self._line(q)
        pull, no_moment = self._tension(l, u @ J @ v) * u, np.zeros(3)
        return [(point1.joint, point1.x, pull, no_moment), (point2.joint, point2.x, -pull, no_moment)]

    def element(self, t, q, v):
        l, u, J = self._line(q)[:3]
        speed = u @ J @ v
        return {"force": self._tension(l, speed), "length": l, "speed": speed}

    def _tension(self, l, rate):
        return self.spring.stiffness * (l - self.spring.length) + self.spring.damping * rate

    def _line(self, q):
        """Length, direction from point 1 to point 2, (3,), J of their difference, (3, nv), and the two points."""
        self._points.move(q)
        point1, point2 = (self._points.at(joint, offset) for joint, offset in self.ends)
        r = point2.x - point1.x
        l = sqrt(r.dot(r) + SHORTEST**2)
        return l, r / l, point2.J - point1.J, point1, point2


@dataclass(frozen=True)
class SpringDamper(ForceRecord):
    """A spring and damper along the line between two points.

    The tension, positive for a pull, is T = k (l - l₀) + d dl/dt, with l the distance between the points. If the points
    coincide, the direction is undefined: within 1e-9 m the force goes to zero continuously. (With l₀ = 0 and no damper
    the law itself is continuous there.)

    Parameters
    ----------
    frame1, frame2 : str
        Frames of the model; ``"universe"`` is the ground.
    stiffness : float
        k, N/m.
    length : float
        l₀ ≥ 0, the length of the unloaded spring, m.
    damping : float
        d ≥ 0, N·s/m.
    xyz1, xyz2 : tuple of 3 float
        The points in their frames, m.

    Raises
    ------
    InputError
        Invalid numbers; on a model, unknown frames, or both frames on one body.
    """

    frame1: str
    frame2: str = GROUND
    stiffness: float = 0.0
    length: float = 0.0
    damping: float = 0.0
    xyz1: tuple[float, float, float] = ZERO
    xyz2: tuple[float, float, float] = ZERO

    _kind, _acts_on, _law = "spring", "_ends", _BoundSpring
    _who = property(lambda self: f"spring between {self.frame1!r} and {self.frame2!r}")
    _ends = property(lambda self: self.frame1 if self.frame2 == GROUND else f"{self.frame1}-{self.frame2}")

    def __post_init__(self):
        put_checked(self, "SpringDamper", name, "frame1", "frame2")
        put_checked(self, self._who, number, "stiffness")
        put_checked(self, self._who, number, "length", "damping", least=0.0)
        put_checked(self, self._who, triple, "xyz1", "xyz2")


class _BoundWrench(BoundForce):
    by_time = True

    def __init__(self, wrench, model):
        frame = frame_of(model, wrench.frame, wrench._who)
        if frame.parentJoint == 0:
            raise InputError(f"{wrench._who}: the frame belongs to the ground, which cannot move")
        self._wrench, self._joint, self._turn = wrench, frame.parentJoint, frame.placement.rotation
        self._offset = frame.placement.act(np.array(wrench.xyz))
        self._points, self._local = _Points(model), wrench.axes == "local"
        self.smooth = not (callable(wrench.force) or callable(wrench.moment))

    def torque(self, t, q, v):
        force, moment = self._in_world(t, q)
        point = self._points.at(self._joint, self._offset)
        return force.dot(point.J) + moment.dot(point.spin)

    def derivatives(self, t, q, v):
        load = self._in_world(t, q)
        point = self._points.at(self._joint, self._offset)
        return self._points.gradient(q, [(point, *load)], turning=self._local), None

    def hand_over(self, compiled) -> bool:
        if self.smooth:
            turn = self._turn if self._local else np.eye(3)
            load = (turn @ np.array(part) for part in (self._wrench.force, self._wrench.moment))
            compiled.add_wrench(self._joint, self._offset, *load, self._local)
        return self.smooth

    def loads(self, t, q, v):
        force, moment = self._in_world(t, q)
        return [(self._joint, self._points.at(self._joint, self._offset).x, force, moment)]

    def element(self, t, q, v):
        force, moment = self._in_world(t, q)
        return {"force": force, "moment": moment}

    def functions_of_time(self, q, v):
        fields = [field for field in ("force", "moment") if callable(getattr(self._wrench, field))]
        return [time_function(getattr(self._wrench, field), partial(self._part, field)) for field in fields]

    def _part(self, field, t):
        part = getattr(self._wrench, field)
        if callable(part):
            part = returned(part, f"the {field} of the {self._wrench._who}", (3,), t)
        return np.array(part)

    def _in_world(self, t, q):
        """Force and moment in world axes at a configuration; moves the points there."""
        self._points.move(q)
        t = self.breakpoints.inside(t)
        parts = [self._part(field, t) for field in ("force", "moment")]
        if not self._local:
            return parts
        R = self._points.data.oMi[self._joint].rotation @ self._turn
        return [R @ part for part in parts]


@dataclass(frozen=True)
class Wrench(ForceRecord):
    """An external force and moment on the body of a frame.

    Parameters
    ----------
    frame : str
        A frame of a body.
    force : tuple of 3 float, or callable
        N; or a function of time that returns three numbers.
    moment : tuple of 3 float, or callable
        N·m; or a function of time that returns three numbers.
    axes : {"world", "local"}
        The axes of both vectors: the world's, or the frame's, with which they then rotate.
    xyz : tuple of 3 float
        The point where the force acts, in the frame, m.

    Raises
    ------
    InputError
        Invalid numbers, unknown axes; on a model, an unknown frame, or one of the ground.
    UserFunctionError
        A function raised an exception.
    """

    frame: str
    force: tuple[float, float, float] | Callable = ZERO
    moment: tuple[float, float, float] | Callable = ZERO
    axes: str = "world"
    xyz: tuple[float, float, float] = ZERO

    _kind, _acts_on, _law = "wrench", "frame", _BoundWrench
    _who = property(lambda self: f"wrench on {self.frame!r}")

    def __post_init__(self):
        put_checked(self, "Wrench", name, "frame")
        put_checked(
            self, self._who, triple, *(field for field in ("force", "moment") if not callable(getattr(self, field)))
        )
        if not isinstance(self.axes, str) or self.axes not in ("world", "local"):
            raise InputError(f"{self._who}: axes must be 'world' or 'local', got {self.axes!r}")
        put_checked(self, self._who, triple, "xyz")
