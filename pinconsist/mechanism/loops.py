"""Loop: the record by which a user closes a loop, and the conventions of all constraint rows.

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

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ..errors import InputError
from .checks import name, number, put, put_checked, triple

ROW_NAMES = {
    "point": ("x", "y", "z"),
    "frame": ("x", "y", "z", "rx", "ry", "rz"),
    "hinge": ("x", "y", "z", "tilt1", "tilt2"),
    "distance": ("length",),
    "slider": ("across1", "across2", "rx", "ry", "rz"),
    "cylinder": ("across1", "across2", "tilt1", "tilt2"),
    "plane": ("normal", "tilt1", "tilt2"),
    "universal": ("x", "y", "z", "cross"),
}
OWN_FIELDS = {
    **dict.fromkeys(("hinge", "slider", "cylinder", "plane"), ("axis",)),
    "universal": ("axis", "axis2"),
    "distance": ("length",),
}  # the fields that only some kinds have
GROUND = "universe"


@dataclass(frozen=True)
class Loop:
    """One loop closure between two frames of a model.

    Parameters
    ----------
    name : str
        Name by which reports, errors and reactions speak of the loop.
    kind : {"point", "frame", "hinge", "distance", "slider", "cylinder", "plane", "universal"}
        What the closure holds together; see the table of :mod:`pinconsist.mechanism.loops`.
    frame1, frame2 : str
        Names of frames of the model; ``"universe"`` is the ground.
    xyz1, rpy1, xyz2, rpy2 : tuple of 3 float
        Position, m, and orientation, URDF's roll, pitch, yaw in rad, of each anchor in its frame.
    axis : tuple of 3 float
        A direction of any length. The axis of a hinge, slider or cylinder, and the normal of a plane: the same
        components in both anchors. Of a universal, the axis that belongs to body 1, in anchor 1.
    axis2 : tuple of 3 float
        Of a universal, the axis that belongs to body 2, in anchor 2; held perpendicular to ``axis``.
    length : float or None
        Distance L > 0 held by ``kind="distance"``, m.

    Raises
    ------
    InputError
        Unknown kind, numbers that are not finite or of the wrong count, a missing or useless axis or length, or one
        that a loop of this kind does not have.
    """

    name: str
    kind: str
    frame1: str
    frame2: str = GROUND
    xyz1: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rpy1: tuple[float, float, float] = (0.0, 0.0, 0.0)
    xyz2: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rpy2: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axis: tuple[float, float, float] | None = None
    length: float | None = None
    axis2: tuple[float, float, float] | None = None

    def __post_init__(self):
        who = f"loop {self.name!r}"
        if not isinstance(self.kind, str) or self.kind not in ROW_NAMES:
            raise InputError(f"{who}: unknown kind {self.kind!r}; known are {', '.join(ROW_NAMES)}")
        put_checked(self, who, name, "name", "frame1", "frame2")
        own = OWN_FIELDS.get(self.kind, ())
        for field in ("axis", "axis2", "length"):
            if field not in own and getattr(self, field) is not None:  # most likely another kind was meant
                kinds = ", ".join(kind for kind, fields in OWN_FIELDS.items() if field in fields)
                raise InputError(
                    f"{who}: a loop of kind {self.kind!r} has no {field}, which is for {kinds}; besides frames and "
                    f"anchors it has {' and '.join(own) or 'nothing'}"
                )
        put_checked(self, who, triple, "xyz1", "rpy1", "xyz2", "rpy2")
        if self.kind == "distance":
            put(self, length=number(self.length, f"{who}: the length of a distance, in m,", above=0.0))
            return
        for field in own:
            if getattr(self, field) is None:
                raise InputError(f"{who}: a {self.kind} needs its {field}, for instance {field} = (0, 1, 0)")
            put_checked(self, who, triple, field)
            if not 1e-100 < max(map(abs, axis := getattr(self, field))) < 1e100:
                raise InputError(f"{who}: the {self.kind} {field} is the zero vector, or too large: {axis}")

    @property
    def rows(self) -> tuple[str, ...]:
        """Names of the loop's rows, in their order."""
        return ROW_NAMES[self.kind]

    @property
    def placement1(self) -> pin.SE3:
        """Anchor 1 in ``frame1``."""
        return pin.SE3(pin.rpy.rpyToMatrix(*self.rpy1), np.array(self.xyz1))

    @property
    def placement2(self) -> pin.SE3:
        """Anchor 2 in ``frame2``."""
        return pin.SE3(pin.rpy.rpyToMatrix(*self.rpy2), np.array(self.xyz2))
