"""Forces on points of bodies: springs, dampers and bushings between two bodies, and external wrenches."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cached_property, partial
from math import inf, sqrt

import numpy as np
import pinocchio as pin

from ...errors import InputError
from ..axes import SMOOTH, turning_columns
from ..breakpoints import time_function
from ..checks import frame_of, name, number, numbers, put, put_checked, returned, triple, workspace
from ..lie import integrate
from ..loops import GROUND
from ..motion import first
from .force import BoundForce, ForceRecord

SHORTEST = 1e-9
"""Distance of the two points, m, below which the force of a spring is smoothed, as its direction is undefined at 0."""
ZERO = (0.0, 0.0, 0.0)


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
        self._given = model
        self._still = np.zeros((3, model.nv))

    @cached_property
    def model(self) -> pin.Model:
        """The model without gravity: static torques are then those of the given forces only."""
        model = self._given.copy()
        model.gravity.setZero()
        return model

    @cached_property
    def data(self) -> pin.Data:
        """Its workspace, which runs in C++ do not need."""
        return workspace(self.model)

    @cached_property
    def _loads(self):
        return pin.StdVec_Force([pin.Force.Zero() for _ in range(self._given.njoints)])

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

        `loads` are (point, force, moment) in world axes, on each body at most once. With `turning`
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
        for point, _, _ in loads:
            self._loads[point.joint] = pin.Force.Zero()
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
    smooth = stores = True

    def __init__(self, spring, model):
        self.spring, self._points = spring, points_of(model)
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


class _BetweenFrames(ForceRecord):
    """A force between two frames, by whose names it is called."""

    frame1: str
    frame2: str

    _acts_on = "_ends"

    @property
    def _ends(self) -> str:
        return self.frame1 if self.frame2 == GROUND else f"{self.frame1}-{self.frame2}"


@dataclass(frozen=True)
class SpringDamper(_BetweenFrames):
    """A spring and damper along the line between two points.

    The tension is T = k (l - l₀) + d dl/dt, with l the distance between the points. If the points coincide, the
    direction is undefined: within 1e-9 m the force goes to zero continuously. (With l₀ = 0 and no damper the law itself
    is continuous there.)

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

    _kind, _law = "spring", _BoundSpring
    _who = property(lambda self: f"spring between {self.frame1!r} and {self.frame2!r}")

    def __post_init__(self):
        put_checked(self, "SpringDamper", name, "frame1", "frame2")
        put_checked(self, self._who, number, "stiffness")
        put_checked(self, self._who, number, "length", "damping", least=0.0)
        put_checked(self, self._who, triple, "xyz1", "xyz2")


class _BoundBushing(BoundForce):
    smooth = stores = True

    def __init__(self, bushing, model):
        self._points, self._model = points_of(model), model
        self._stiffness, self._damping = np.array(bushing.stiffness), np.array(bushing.damping)
        self.ends = []
        for end in (1, 2):
            frame = frame_of(model, getattr(bushing, f"frame{end}"), bushing._who)
            place = pin.SE3(
                pin.rpy.rpyToMatrix(*getattr(bushing, f"rpy{end}")), np.array(getattr(bushing, f"xyz{end}"))
            )
            self.ends.append((frame.parentJoint, frame.placement * place))
        if self.ends[0][0] == self.ends[1][0]:
            raise InputError(f"the {bushing._who} connects a body to itself")

    def _coordinates(self, q):
        """The six coordinates y, ∂y/∂(velocity, spin) of anchor 2 seen from anchor 1, (6, 6), and these as J."""
        self._points.move(q)
        point1, point2 = (self._points.at(joint, place.translation) for joint, place in self.ends)
        R1, R2 = (self._points.data.oMi[joint].rotation @ place.rotation for joint, place in self.ends)
        r, R = point2.x - point1.x, R1.T @ R2
        motion = np.vstack(
            (R1.T @ (point2.J - point1.J + pin.skew(r) @ point1.spin), R1.T @ (point2.spin - point1.spin))
        )
        turn, d = pin.log3(R), R1.T @ r
        half, angles = pin.exp3(0.5 * turn), pin.rpy.matrixToRpy(R)
        half_spin = 0.5 * half @ pin.Jexp3(0.5 * turn) @ pin.Jlog3(R) @ R.T
        rates = np.zeros((6, 6))
        rates[:3, :3], rates[:3, 3:] = half.T, half.T @ pin.skew(d) @ half_spin
        rates[3:, 3:] = pin.rpy.computeRpyJacobianInverse(angles, pin.WORLD)
        return np.concatenate((half.T @ d, angles)), rates, motion, point2.x, R1

    def torque(self, t, q, v):
        y, rates, motion, _, _ = self._coordinates(q)
        J = rates @ motion
        return -J.T @ (self._stiffness * y + self._damping * (J @ v))

    def derivatives(self, t, q, v):
        """∂τ/∂v exact, ∂τ/∂q by differences."""
        _, rates, motion, _, _ = self._coordinates(q)
        J, by_q = rates @ motion, np.zeros((len(v), len(v)))
        for column in np.flatnonzero(motion.any(axis=0)):
            unit = np.arange(len(v)) == column
            by_q[:, column] = first(lambda s, e=unit: self.torque(t, integrate(self._model, q, s * e), v), SMOOTH)
        return by_q, -J.T @ (self._damping[:, None] * J)

    def stored(self, q, v) -> tuple[float, float]:
        y, rates, motion, _, _ = self._coordinates(q)
        load = self._stiffness * y
        return 0.5 * load @ y, load @ (rates @ motion @ v)

    def _wrench(self, q, v):
        """The force and the moment on body 2, at anchor 2, in world axes, and that point."""
        y, rates, motion, x, R1 = self._coordinates(q)
        load = -(self._stiffness * y + self._damping * (rates @ motion @ v)) @ rates
        return R1 @ load[:3], R1 @ load[3:], x

    def loads(self, t, q, v):
        force, moment, x = self._wrench(q, v)
        return [(self.ends[0][0], x, -force, -moment), (self.ends[1][0], x, force, moment)]

    def element(self, t, q, v):
        force, moment, _ = self._wrench(q, v)
        return {"force": force, "moment": moment}


@dataclass(frozen=True)
class Bushing(_BetweenFrames):
    """A spring and damper in six directions between two frames.

    Its coordinates are those of anchor 2 relative to anchor 1: the position, with components in the axes halfway
    between both (half of the rotation from one to the other), and roll, pitch and yaw. Each has a force or moment
    -(stiffness · coordinate + damping · rate), so that the work is ½ Σ stiffness · coordinate². The angles are singular
    at a pitch of 90°: use a bushing only far from it. Source: Drake's LinearBushingRollPitchYaw.

    Parameters
    ----------
    frame1, frame2 : str
        Frames of the model; ``"universe"`` is the ground.
    stiffness : tuple of 6 float
        Along x, y and z, N/m; about x (roll), y (pitch) and z (yaw), N·m/rad.
    damping : tuple of 6 float
        N·s/m and N·m·s/rad, each ≥ 0.
    xyz1, rpy1, xyz2, rpy2 : tuple of 3 float
        Position, m, and orientation, URDF's roll, pitch and yaw in rad, of each anchor in its frame.

    Raises
    ------
    InputError
        Invalid numbers; on a model, unknown frames, or both frames on one body.
    """

    frame1: str
    frame2: str = GROUND
    stiffness: tuple[float, ...] = (0.0,) * 6
    damping: tuple[float, ...] = (0.0,) * 6
    xyz1: tuple[float, float, float] = ZERO
    rpy1: tuple[float, float, float] = ZERO
    xyz2: tuple[float, float, float] = ZERO
    rpy2: tuple[float, float, float] = ZERO

    _kind, _law = "bushing", _BoundBushing
    _who = property(lambda self: f"bushing between {self.frame1!r} and {self.frame2!r}")

    def __post_init__(self):
        put_checked(self, "Bushing", name, "frame1", "frame2")
        put_checked(self, self._who, triple, "xyz1", "rpy1", "xyz2", "rpy2")
        for field, least in (("stiffness", -inf), ("damping", 0.0)):
            given = numbers(getattr(self, field), f"{self._who}: {field}", least)
            if len(given) != 6:
                raise InputError(f"{self._who}: {field} needs six numbers, of x, y, z, roll, pitch, yaw; got {given}")
            put(self, **{field: given})


class _BoundWrench(BoundForce):
    by_time = True

    def __init__(self, wrench, model):
        frame = frame_of(model, wrench.frame, wrench._who)
        if frame.parentJoint == 0:
            raise InputError(f"{wrench._who}: the frame belongs to the ground, which cannot move")
        self._wrench, self._joint, self._turn = wrench, frame.parentJoint, frame.placement.rotation
        self._offset = frame.placement.act(np.array(wrench.xyz))
        self._points, self._local = points_of(model), wrench.axes == "local"
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
        The axes of both vectors: those of the world, or those of the frame, with which they then rotate.
    xyz : tuple of 3 float
        The point of application, in the frame, m.

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
