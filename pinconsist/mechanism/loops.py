"""Loop: the record that closes a loop, the kinds of loops, and the conventions of all constraint rows.

Conventions
-----------
A loop connects anchor 1 (on ``frame1``) to anchor 2 (on ``frame2``); either may be on the ground, whose frame is
``"universe"``. With ``d`` the position of anchor 2 relative to anchor 1 **in the axes of anchor 1**, ``R`` the rotation
that takes axes of anchor 2 to axes of anchor 1, ``e`` the loop's ``axis`` normalised, ``u1`` along the cross product of
e with the coordinate axis farthest from it, ``u2 = e × u1``, and ``a = R e`` (for a universal, ``a = R axis2``), the
rows are

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

all in the axes of anchor 1, acting on body 2 at anchor 2; body 1 receives the opposite at the same point. Forces are in
N, moments in N·m, Φ in m and rad. Every J is the exact derivative of Φ in the tangent space, even while a loop is open.
An antiparallel axis of body 2 does not close a loop of a kind with an axis: the chord is longest there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from ..errors import InputError
from .checks import name, number, put, put_checked, triple

GROUND = "universe"


@dataclass(frozen=True)
class Loop:
    """One loop closure between two frames of a model.

    Parameters
    ----------
    name : str
        Name of the loop in reports, errors and reactions.
    kind : {"point", "frame", "hinge", "distance", "slider", "cylinder", "plane", "universal"}
        Type of the closure; see the table of :mod:`pinconsist.mechanism.loops`.
    frame1, frame2 : str
        Names of frames of the model; ``"universe"`` is the ground.
    xyz1, rpy1, xyz2, rpy2 : tuple of 3 float
        Position, m, and orientation, URDF's roll, pitch, yaw in rad, of each anchor in its frame.
    axis : tuple of 3 float
        A vector of any length: the axis of a hinge, slider or cylinder, or the normal of a plane, with the same
        components in both anchors. For a universal, the axis of body 1, in the axes of anchor 1.
    axis2 : tuple of 3 float
        For a universal, the axis of body 2, in the axes of anchor 2; held perpendicular to ``axis``.
    length : float or None
        Distance L > 0 maintained by ``kind="distance"``, m.

    Raises
    ------
    InputError
        Unknown kind, numbers that are not finite, a wrong number of them, a missing or invalid axis or length, or one
        that does not apply to this kind.
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
        if not isinstance(self.kind, str) or self.kind not in LOOP_KINDS:
            raise InputError(f"{who}: unknown kind {self.kind!r}; choose from {', '.join(LOOP_KINDS)}")
        put_checked(self, who, name, "name", "frame1", "frame2")
        own = LOOP_KINDS[self.kind].fields
        for field in ("axis", "axis2", "length"):
            if field not in own and getattr(self, field) is not None:  # most likely another kind was meant
                kinds = ", ".join(kind.name for kind in LOOP_KINDS.values() if field in kind.fields)
                raise InputError(
                    f"{who}: a loop of kind {self.kind!r} has no {field}, which is for {kinds}; in addition to frames "
                    f"and anchors it has {' and '.join(own) or 'no fields'}"
                )
        put_checked(self, who, triple, "xyz1", "rpy1", "xyz2", "rpy2")
        if "length" in own:
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
        return LOOP_KINDS[self.kind].rows

    @property
    def placement1(self) -> pin.SE3:
        """Anchor 1 in ``frame1``."""
        return pin.SE3(pin.rpy.rpyToMatrix(*self.rpy1), np.array(self.xyz1))

    @property
    def placement2(self) -> pin.SE3:
        """Anchor 2 in ``frame2``."""
        return pin.SE3(pin.rpy.rpyToMatrix(*self.rpy2), np.array(self.xyz2))


def anchor(end: int, place: pin.SE3) -> dict:
    """The fields of a loop for anchor 1 or 2 at `place` in its frame."""
    return {f"xyz{end}": tuple(place.translation), f"rpy{end}": tuple(pin.rpy.matrixToRpy(place.rotation))}


# The blocks of rows that make up the kinds; `directions` are vectors in the axes of anchor 1, one a row. Each block has
# the method add_to(compiled, ends), which adds its exact rows to a compiled system, where ends(shift) are the anchors
# with the second one moved by `shift`; and closest (but not Length), which returns the nearest position `d` or rotation
# `R` of anchor 2 in the axes of anchor 1 with Φ = 0.


def unit(vector) -> np.ndarray:
    """The vector scaled to length 1."""
    vector = np.array(vector, float)
    vector /= np.abs(vector).max()
    return vector / np.linalg.norm(vector)


def across(e) -> np.ndarray:
    """Two unit vectors normal to the unit vector `e` and to each other, as rows; with e they are right-handed."""
    u1 = pin.skew(e)[:, np.argmin(np.abs(e))]
    u1 = u1 / np.linalg.norm(u1)
    return np.array([u1, pin.skew(e) @ u1])


class Position:
    """Components of d along fixed directions, (k, 3)."""

    def __init__(self, directions):
        self.directions = np.array(directions, float)

    def add_to(self, compiled, ends):
        compiled.add_anchored(*ends(), self.directions, True)

    def closest(self, d):
        return d - self.directions.T @ (self.directions @ d)


class Length:
    """(|d|² − L²) / (2 L)."""

    def __init__(self, length):
        self.length = length

    def add_to(self, compiled, ends):
        compiled.add_distance(*ends(), self.length)


class RotationVector:
    """log R."""

    def add_to(self, compiled, ends):
        compiled.add_turn(*ends())

    def closest(self, R):
        return np.eye(3)


class _Axis:
    """Rows of one axis of body 2, a = R axis2: in a closed loop those of ``directions @ a``, (k, 3)."""

    axis2: np.ndarray
    directions: np.ndarray

    def closest(self, R):
        a = R @ self.axis2
        return pin.Quaternion.FromTwoVectors(a, self.closest_axis(a)).matrix() @ R


class Tilt(_Axis):
    """Tilt of the axis a = R e of body 2 relative to e, measured by the chord 2 sin(angle/2)."""

    def __init__(self, e):
        self.axis2 = e
        self.directions = -across(e) @ pin.skew(e).T  # tilt1 turns about the first row of across(e), tilt2 the second

    def add_to(self, compiled, ends):
        compiled.add_tilt(*ends(), self.axis2, self.directions)

    def closest_axis(self, a):
        return self.axis2


class Cross(_Axis):
    """e₁·a, the cosine of the angle between the axes of body 1 and body 2: zero if they are perpendicular.

    Parallel axes are a stationary point, which assembly leaves through its perturbed guesses.
    """

    def __init__(self, e1, e2):
        self.axis2, self.directions = e2, e1[None, :]

    def add_to(self, compiled, ends):
        """As the difference of two points, 1 m apart along the axis of body 2."""
        compiled.add_anchored(*ends(), -self.directions, True)
        compiled.add_anchored(*ends(self.axis2), self.directions, False)

    def closest_axis(self, a):
        (e,) = self.directions
        square = a - (e @ a) * e
        return square if np.linalg.norm(square) > 1e-9 else across(e)[0]


@dataclass(frozen=True)
class LoopKind:
    """All that the package needs to know of one kind of loop.

    Translations into the constraints of other programs are with their writers, which refuse kinds that the program
    does not have.

    Parameters
    ----------
    name : str
        The `kind` of its records.
    translations, rotations : tuple of str
        The names of its rows in m, which come first, and of those in rad.
    free : tuple of str or None
        The motions of body 2 relative to body 1 that it leaves free, as UsdPhysics names them, if its axis is along x
        and its axis2 along y; None if they are not along and about axes.
    translation, rotation : callable
        ``translation(loop)`` is the block of its rows in m; ``rotation(loop)`` that of its rows in rad, None without.
    fields : tuple of str
        Fields of the record that only some kinds have, such as its axis.
    file_names : tuple of str
        What files call it, in lower case with underscores.
    label, planar_label : str
        What a curve of its force calls it, in general and in a planar mechanism; by default its name.
    drawn : {"shell", "rail", "plate", "bar"}
        The form of anchor 1 in pictures, in which anchor 2 sits while the loop is closed.
    """

    name: str
    translations: tuple[str, ...]
    rotations: tuple[str, ...]
    free: tuple[str, ...] | None
    translation: Callable[[Any], Any]
    rotation: Callable[[Any], Any] | None = None
    fields: tuple[str, ...] = ()
    file_names: tuple[str, ...] = ()
    label: str = ""
    planar_label: str = ""
    drawn: str = "shell"

    @property
    def rows(self) -> tuple[str, ...]:
        """The names of its rows, in their order."""
        return self.translations + self.rotations

    def label_in(self, planar: bool) -> str:
        """What a curve of its force calls it, in a planar mechanism or in general."""
        return (self.planar_label if planar else "") or self.label or self.name

    @property
    def has_axis(self) -> bool:
        """Whether its records have an axis."""
        return "axis" in self.fields

    @property
    def holds_point(self) -> bool:
        """Whether its anchors coincide."""
        return self.translations == ("x", "y", "z")

    def blocks(self, loop):
        """Its blocks of rows in m and in rad, the latter None if there are none."""
        return self.translation(loop), None if self.rotation is None else self.rotation(loop)


def _at_point(loop) -> Position:
    return Position(np.eye(3))


def _on_axis(loop) -> Position:
    return Position(across(unit(loop.axis)))


def _in_plane(loop) -> Position:
    return Position(unit(loop.axis)[None, :])


def _aligned(loop) -> Tilt:
    return Tilt(unit(loop.axis))


_XYZ = ("x", "y", "z")
_TILTS = ("tilt1", "tilt2")
_ROTATION = ("rx", "ry", "rz")

LOOP_KINDS = {
    kind.name: kind
    for kind in (
        LoopKind(
            name="point",
            translations=_XYZ,
            rotations=(),
            free=("rotX", "rotY", "rotZ"),
            translation=_at_point,
            file_names=("point", "3d", "ball", "spherical", "ball_and_socket", "p2p", "connect"),
            label="ball joint",
            planar_label="pin",
        ),
        LoopKind(
            name="frame",
            translations=_XYZ,
            rotations=_ROTATION,
            free=(),
            translation=_at_point,
            rotation=lambda loop: RotationVector(),
            file_names=("frame", "6d", "fixed", "weld", "rigid", "fixed_relative_transform"),
            label="weld",
        ),
        LoopKind(
            name="hinge",
            translations=_XYZ,
            rotations=_TILTS,
            free=("rotX",),
            translation=_at_point,
            rotation=_aligned,
            fields=("axis",),
            file_names=("hinge", "revolute", "continuous", "pin", "rotational"),
            planar_label="pin",
        ),
        LoopKind(
            name="distance",
            translations=("length",),
            rotations=(),
            free=None,
            translation=lambda loop: Length(loop.length),
            fields=("length",),
            file_names=("distance",),
            label="rod",
            drawn="bar",
        ),
        LoopKind(
            name="slider",
            translations=("across1", "across2"),
            rotations=_ROTATION,
            free=("transX",),
            translation=_on_axis,
            rotation=lambda loop: RotationVector(),
            fields=("axis",),
            file_names=("slider", "prismatic", "translational", "linear"),
            drawn="rail",
        ),
        LoopKind(
            name="cylinder",
            translations=("across1", "across2"),
            rotations=_TILTS,
            free=("transX", "rotX"),
            translation=_on_axis,
            rotation=_aligned,
            fields=("axis",),
            file_names=("cylinder", "cylindrical", "piston"),
            drawn="rail",
        ),
        LoopKind(
            name="plane",
            translations=("normal",),
            rotations=_TILTS,
            free=("transY", "transZ", "rotX"),
            translation=_in_plane,
            rotation=_aligned,
            fields=("axis",),
            file_names=("plane", "planar"),
            drawn="plate",
        ),
        LoopKind(
            name="universal",
            translations=_XYZ,
            rotations=("cross",),
            free=("rotX", "rotY"),
            translation=_at_point,
            rotation=lambda loop: Cross(unit(loop.axis), unit(loop.axis2)),
            fields=("axis", "axis2"),
            file_names=("universal", "cardan"),
        ),
    )
}
"""Name of a kind → what holds for its loops."""
