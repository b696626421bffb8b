"""Forces on points of bodies: springs, dampers and bushings between two bodies, and external wrenches."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import inf

import numpy as np
import pinocchio as pin

from ...errors import InputError
from ..axes import SMOOTH
from ..breakpoints import TimeCurve
from ..checks import frame_of, name, number, numbers, put, put_checked, triple
from ..lie import integrate
from ..loops import GROUND
from ..motion import first
from .force import BoundForce, CompiledForce, ForceRecord, StoringForce
from .points import points_of

SHORTEST = 1e-9
"""Distance of the two points, m, below which the force of a spring is smoothed, as its direction is undefined at 0."""
ZERO = (0.0, 0.0, 0.0)


class _BoundSpring(StoringForce):
    smooth = True

    def __init__(self, spring, model):
        super().__init__(model)
        self.spring, self.ends = spring, []
        for frame, xyz in ((spring.frame1, spring.xyz1), (spring.frame2, spring.xyz2)):
            frame = frame_of(model, frame, spring._who)
            self.ends.append((frame.parentJoint, frame.placement.act(np.array(xyz))))
        if self.ends[0][0] == self.ends[1][0]:
            raise InputError(f"the {spring._who} connects a body to itself")

    def hand_over(self, compiled) -> None:
        spring, (end1, end2) = self.spring, self.ends
        compiled.add_spring(*end1, *end2, spring.stiffness, spring.length, spring.damping, SHORTEST)

    def element(self, t, q, v):
        return self._along(t, q, v)


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


class _BoundWrench(CompiledForce):
    by_time = True

    def __init__(self, wrench, model):
        super().__init__(model)
        frame = frame_of(model, wrench.frame, wrench._who)
        if frame.parentJoint == 0:
            raise InputError(f"{wrench._who}: the frame belongs to the ground, which cannot move")
        self._wrench, self._joint = wrench, frame.parentJoint
        self._frame = frame.placement * pin.SE3(np.eye(3), np.array(wrench.xyz))
        self._force = self._part("force")
        self._moment = self._part("moment")
        self.smooth = not self.curves

    def _part(self, field):
        """Three numbers, or a curve."""
        given = getattr(self._wrench, field)
        if not callable(given):
            return np.array(given)
        curve = TimeCurve(given, f"the {field} of the {self._wrench._who}", (3,))
        self.curves.append(curve)
        return curve

    def hand_over(self, compiled) -> None:
        local = self._wrench.axes == "local"
        compiled.add_wrench(self._joint, self._frame.homogeneous, self._force, self._moment, local)

    def element(self, t, q, v):
        ((_, _, force, moment),) = self.loads(t, q, v)
        return {"force": force, "moment": moment}


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
