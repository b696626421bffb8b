"""Springs and dampers between two points of a mechanism."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
import pinocchio as pin

from ...errors import InputError
from ..checks import frame_of, name, number, put, triple
from ..constraints.loop import GROUND
from .points import Points
from .record import ForceRecord

SHORTEST = 1e-9
"""Distance of the two points within which the direction of a spring fades away, m."""
ZERO = np.zeros(3)


@dataclass(frozen=True)
class SpringDamper(ForceRecord):
    """A spring and damper along the line between two points.

    The tension, positive where it pulls, is T = k (l - l₀) + d dl/dt, with l the distance of the points. Two points
    that coincide have no direction between them: there, and within 1e-9 m, the force fades to zero. (With l₀ = 0 and
    no damper it does so by itself, and nothing is special there.)

    Parameters
    ----------
    frame1, frame2 : str
        Frames of the model; ``"universe"`` is the ground.
    stiffness : float
        k, N/m.
    length : float
        l₀ ≥ 0, the length at which the spring is slack, m.
    damping : float
        d ≥ 0, N·s/m.
    xyz1, xyz2 : tuple of 3 float
        The points in their frames, m.

    Raises
    ------
    InputError
        Impossible numbers; on a model, unknown frames, or both on one body.
    """

    frame1: str
    frame2: str = GROUND
    stiffness: float = 0.0
    length: float = 0.0
    damping: float = 0.0
    xyz1: tuple[float, float, float] = (0.0, 0.0, 0.0)
    xyz2: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self):
        for field in ("frame1", "frame2"):
            name(getattr(self, field), f"SpringDamper: {field}")
        put(self, stiffness=number(self.stiffness, f"{self._who}: stiffness"))
        for field in ("length", "damping"):
            put(self, **{field: number(getattr(self, field), f"{self._who}: {field}", least=0.0)})
        for field in ("xyz1", "xyz2"):
            put(self, **{field: triple(getattr(self, field), f"{self._who}: {field}")})

    @property
    def _who(self):
        return f"spring between {self.frame1!r} and {self.frame2!r}"

    @property
    def label(self) -> str:
        """By what name energy reports and messages speak of it."""
        return f"spring {self.frame1}" if self.frame2 == GROUND else f"spring {self.frame1}-{self.frame2}"

    def bind(self, model: pin.Model) -> _BoundSpring:
        return _BoundSpring(self, model)


class _BoundSpring:
    """A SpringDamper with its own workspace on a model."""

    def __init__(self, spring, model):
        self.spring, self._points = spring, Points(model)
        self._ends = []
        for frame, xyz in ((spring.frame1, spring.xyz1), (spring.frame2, spring.xyz2)):
            frame = frame_of(model, frame, spring._who)
            self._ends.append((frame.parentJoint, frame.placement.act(np.array(xyz))))
        if self._ends[0][0] == self._ends[1][0]:
            raise InputError(f"the {spring._who} joins a body to itself")

    def torque(self, t, q, v):
        l, u, J = self._line(q)[:3]
        along = u.dot(J)
        return -self._tension(l, along @ v) * along

    def derivatives(self, t, q, v):
        """Exact: stiffness and damping along the line, and T/l across it with the turning of the bodies."""
        l, u, J, point1, point2 = self._line(q)
        along, spring = u.dot(J), self.spring
        squared = along[:, None] * along
        bend = self._points.gradient(q, ((point1, -u, ZERO), (point2, u, ZERO)), turning=False)
        bend += (J.T.dot(J) - squared) / l  # now ∂²l/∂q²
        by_q = -spring.stiffness * squared - self._tension(l, along.dot(v)) * bend
        if not spring.damping:
            return by_q, None
        return by_q - (spring.damping * along)[:, None] * v.dot(bend), -spring.damping * squared

    def hand_over(self, twin) -> bool:
        """Tell the compiled twin of this law."""
        spring, (end1, end2) = self.spring, self._ends
        twin.add_spring(*end1, *end2, spring.stiffness, spring.length, spring.damping, SHORTEST)
        return True

    def stored(self, q, v) -> tuple[float, float]:
        """Elastic energy, J, and its rate, W."""
        l, u, J = self._line(q)[:3]
        load = self.spring.stiffness * (l - self.spring.length)
        return 0.5 * load * (l - self.spring.length), load * (u @ J @ v)

    def _tension(self, l, rate):
        return self.spring.stiffness * (l - self.spring.length) + self.spring.damping * rate

    def _line(self, q):
        """Length, direction from point 1 to 2, (3,), J of their difference, (3, nv), and the two points."""
        self._points.move(q)
        point1, point2 = (self._points.at(joint, offset) for joint, offset in self._ends)
        r = point2.x - point1.x
        l = sqrt(r.dot(r) + SHORTEST**2)
        return l, r / l, point2.J - point1.J, point1, point2
