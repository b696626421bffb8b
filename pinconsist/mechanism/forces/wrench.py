"""An external wrench on a body."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...errors import InputError
from ..checks import frame_of, name, put, returned, triple
from .points import Points
from .record import ForceRecord

ZERO = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Wrench(ForceRecord):
    """A force and a moment from outside on the body of a frame.

    Parameters
    ----------
    frame : str
        A frame of a body.
    force : tuple of 3 float, or callable
        N; or a function of time that returns three numbers.
    moment : tuple of 3 float, or callable
        N·m; or a function of time that returns three numbers.
    axes : {"world", "local"}
        The axes in which both are given: the world's, or the frame's, with which they then turn.
    xyz : tuple of 3 float
        The point where the force acts, in the frame, m.

    Raises
    ------
    InputError
        Impossible numbers, unknown axes; on a model, an unknown frame, or one of the ground.
    UserFunctionError
        A function raised an exception.
    """

    frame: str
    force: tuple[float, float, float] | Callable = ZERO
    moment: tuple[float, float, float] | Callable = ZERO
    axes: str = "world"
    xyz: tuple[float, float, float] = ZERO

    def __post_init__(self):
        who = f"wrench on {name(self.frame, 'Wrench: frame')!r}"
        for field in ("force", "moment"):
            if not callable(given := getattr(self, field)):
                put(self, **{field: triple(given, f"{who}: {field}")})
        if self.axes not in ("world", "local"):
            raise InputError(f"{who}: axes must be 'world' or 'local', got {self.axes!r}")
        put(self, xyz=triple(self.xyz, f"{who}: xyz"))

    @property
    def label(self) -> str:
        """By what name energy reports and messages speak of it."""
        return f"wrench {self.frame}"

    def bind(self, model) -> _BoundWrench:
        return _BoundWrench(self, model)


class _BoundWrench:
    """A Wrench with its own workspace on a model."""

    def __init__(self, wrench, model):
        who = f"wrench on {wrench.frame!r}"
        frame = frame_of(model, wrench.frame, who)
        if frame.parentJoint == 0:
            raise InputError(f"{who}: the frame belongs to the ground, which nothing moves")
        self._wrench, self._joint, self._turn = wrench, frame.parentJoint, frame.placement.rotation
        self._offset = frame.placement.act(np.array(wrench.xyz))
        self._points, self._local = Points(model), wrench.axes == "local"
        self._parts = [_function(getattr(wrench, field), f"the {field} of the {who}") for field in ("force", "moment")]

    def torque(self, t, q, v):
        force, moment = self._in_world(t, q)
        point = self._points.at(self._joint, self._offset)
        return force.dot(point.J) + moment.dot(point.spin)

    def derivatives(self, t, q, v):
        load = self._in_world(t, q)
        point = self._points.at(self._joint, self._offset)
        return self._points.gradient(q, [(point, *load)], turning=self._local), None

    def hand_over(self, twin) -> bool:
        """Tell the compiled twin of this law; False where it has to ask Python."""
        own = not (callable(self._wrench.force) or callable(self._wrench.moment))
        if own:
            turn = self._turn if self._local else np.eye(3)
            load = (turn @ np.array(part) for part in (self._wrench.force, self._wrench.moment))
            twin.add_wrench(self._joint, self._offset, *load, self._local)
        return own

    def _in_world(self, t, q):
        """Force and moment in world axes, at a configuration to which this moves."""
        self._points.move(q)
        parts = [part(t) for part in self._parts]
        if not self._local:
            return parts
        R = self._points.data.oMi[self._joint].rotation @ self._turn
        return [R @ part for part in parts]


def _function(given, what):
    if callable(given):
        return lambda t: returned(given, what, (3,), t)
    constant = np.array(given)
    return lambda t: constant
