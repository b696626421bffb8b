"""Impacts: events at which a joint reaches a stop, or a point of a body a plane."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import atan2, inf, pi
from sys import float_info

import numpy as np
import pinocchio as pin

from ..errors import InputError
from .checks import finite_array, frame_of, number, places, put
from .closing import LoopSolver
from .rank import null_space

NO_RESPONSE = 1e-10  # response to an impulse, relative to that of the free bodies, of what loops and drives hold


@dataclass(frozen=True)
class Impact:
    """An impact at the stop of a joint, or of a point of a body on a plane; for ``events`` of a run.

    By Newton's law, when the gap closes, its rate u becomes -`restitution` times that before. One impulse Λ acts along
    the gap, without friction; the impulses of the loops keep these closed: v⁺ = v⁻ + K nᵀΛ with the row n of u = n v
    and the velocities K nᵀ caused by a unit impulse. Kinetic energy never increases, and with `restitution` 1 it is
    conserved. Backwards in time, impacts are reversed. Lasting contact is not modelled: where bounces accumulate, the
    run ends with a message.

    Parameters
    ----------
    joint : str
        A joint of one degree of freedom with stops; or `frame` is given.
    upper, lower : float, optional
        The positions of the stops, rad or m. One is sufficient, except for an unbounded revolute joint. Default: the
        limits of the joint in its file.
    frame : str
        A frame whose origin cannot pass below the plane.
    plane : (array (3,), float)
        Normal of the plane, of any length, and offset along it, m, in the world. Default: the floor z = 0.
    restitution : float
        From 0 to 1.
    name : str
        For messages; by default that of the joint or frame.

    Raises
    ------
    InputError
        Invalid values; when the run starts also unknown joints and frames, unsuitable joints, and an initial state
        beyond a stop or below a plane.

    References
    ----------
    F. Pfeiffer, C. Glocker, Multibody Dynamics with Unilateral Contacts, Wiley 1996, chapter 8.
    """

    joint: str = ""
    upper: float | None = field(default=None, kw_only=True)
    lower: float | None = field(default=None, kw_only=True)
    frame: str = field(default="", kw_only=True)
    plane: tuple[Sequence[float], float] = field(default=((0.0, 0.0, 1.0), 0.0), kw_only=True)
    restitution: float = field(kw_only=True)
    name: str = field(default="", kw_only=True)

    def __post_init__(self):
        for which in ("joint", "frame"):
            if not isinstance(getattr(self, which), str):
                raise InputError(f"{which} of an impact must be a name, got {getattr(self, which)!r}")
        limits = self.upper is not None or self.lower is not None
        if bool(self.joint) == bool(self.frame) or (self.frame and limits):
            raise InputError("an impact needs a joint, with upper= or lower= or the limits of its file, or a frame=")
        for limit in ("upper", "lower"):
            if (value := getattr(self, limit)) is not None:
                put(self, **{limit: number(value, f"{limit} of an impact")})
        if None not in (self.upper, self.lower) and not self.lower < self.upper:
            raise InputError(f"lower of an impact must be below upper, got {self.lower:g} and {self.upper:g}")
        restitution = number(self.restitution, "restitution of an impact")
        if not 0.0 <= restitution <= 1.0:
            raise InputError(f"restitution of an impact must be from 0 to 1, got {restitution:g}")
        put(self, restitution=restitution, plane=_plane(self.plane), name=self.name or self.joint or self.frame)

    def bind(self, mechanism) -> dict:
        """The fields of the :class:`Event` of a `mechanism`; a run makes them of its ``events``.

        Raises InputError for joints and frames that it does not have, and for joints without such stops.
        """
        if mechanism is None:
            raise InputError(f"the impact {self.name!r} needs a mechanism; a general problem has no joints and frames")
        distance, row = (self._of_joint if self.joint else self._of_frame)(mechanism)

        def function(t, q, v, lam):
            return distance(q)

        apply = Bounce(self.name, self.restitution, row, LoopSolver(mechanism))
        return {"function": function, "direction": -1.0, "apply": apply, "name": self.name}

    def _of_joint(self, mechanism):
        """The distance to the next stop at a configuration, and its gradient."""
        model, i = mechanism.model, mechanism.joint_index(self.joint)
        if model.nvs[i] != 1:
            raise InputError(
                f"the impact {self.name!r}: joint {self.joint!r} has {model.nvs[i]} degrees of freedom, and a stop "
                "needs a joint with one; use frame= and plane="
            )
        of_q, of_v = places(model, i)
        first, turns = of_q.start, model.nqs[i] == 2
        lower, upper = self._stops(model, first, turns)
        if turns and not (-pi < lower and upper < pi):
            raise InputError(
                f"the impact {self.name!r}: joint {self.joint!r} is unbounded: specify both stops, between -pi and pi"
            )

        def position(q):
            return atan2(q[first + 1], q[first]) if turns else q[first]

        def distance(q):
            x = position(q)
            return min(upper - x, x - lower)

        def row(q):
            x, n = position(q), np.zeros(model.nv)
            n[of_v] = -1.0 if upper - x < x - lower else 1.0
            return n

        return distance, row

    def _stops(self, model, first, turns):
        """The lower and upper stop, infinite where there is none."""
        if self.lower is not None or self.upper is not None:
            return -inf if self.lower is None else self.lower, inf if self.upper is None else self.upper
        stops = float(model.lowerPositionLimit[first]), float(model.upperPositionLimit[first])
        if turns or not stops[0] < stops[1] or min(map(abs, stops)) >= float_info.max:  # Pinocchio's mark of no limit
            raise InputError(
                f"the impact {self.name!r}: joint {self.joint!r} has no limits in its file; pass upper= or lower="
            )
        return stops

    def _of_frame(self, mechanism):
        """The height of a frame above its plane at a configuration, and its gradient."""
        model, data = mechanism.model, mechanism.model.createData()
        normal, offset = np.array(self.plane[0]), self.plane[1]
        frame_of(model, self.frame, f"the impact {self.name!r}")
        i = model.getFrameId(self.frame)

        def distance(q):
            pin.forwardKinematics(model, data, q)
            return float(normal @ pin.updateFramePlacement(model, data, i).translation) - offset

        def row(q):
            J = pin.computeFrameJacobian(model, data, q, i, pin.LOCAL_WORLD_ALIGNED)
            return normal @ J.reshape(6, model.nv)[:3]

        return distance, row


class Bounce:
    """The velocity after an impact; `row` gives the gradient n of the gap at a configuration."""

    one_sided = True  # the gap cannot become negative

    def __init__(self, name, restitution, row, solver):
        self._name, self._restitution, self._row, self._solver = name, restitution, row, solver

    def __call__(self, t, q, v, forward=True):
        n, e = self._row(q), self._restitution
        rate = n @ v if forward else -(n @ v)
        if rate >= 0.0:  # another impact at this time has reversed it
            return v
        if not forward and e == 0.0:
            raise InputError(
                f"the impact {self._name!r} of restitution 0 cannot be undone: the run goes backwards in time"
            )
        response = self._response(t, q, n)
        return v - (n @ v) * (1.0 + (e if forward else 1.0 / e)) / (n @ response) * response

    def _response(self, t, q, n):
        """The velocities that follow an impulse of 1 along the gap while the loops stay closed."""
        solver = self._solver
        solver.t = t
        J = solver.rows(q)[1][solver.kept(q)]
        Z = null_space(J)
        M = pin.crba(solver.model, solver.data, q)
        response = Z @ np.linalg.lstsq(Z.T @ M @ Z, Z.T @ n, rcond=1e-13)[0]
        free = np.linalg.lstsq(M, n, rcond=1e-13)[0]
        if not n @ response > NO_RESPONSE * (n @ free):
            raise InputError(
                f"the impact {self._name!r}: no impulse can change its velocity, because loops or drives determine it; "
                "let a servo with limits move the joint instead of a drive"
            )
        return response


def _plane(plane):
    """A unit normal and an offset."""
    if not isinstance(plane, Sequence) or len(plane) != 2:
        raise InputError(f"plane of an impact must be a normal (3 numbers) and an offset, got {plane!r}")
    normal, offset = finite_array(plane[0], "normal of a plane"), number(plane[1], "offset of a plane")
    if normal.shape != (3,) or not normal.any():
        raise InputError(f"the normal of a plane must be 3 numbers, not all 0, got {plane[0]!r}")
    length = float(np.linalg.norm(normal))
    return tuple((normal / length).tolist()), offset
