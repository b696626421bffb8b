"""The blocks of rows that loop kinds are made of, as functions of the pose of anchor 2 seen from anchor 1.

``d`` and ``R`` are position and rotation of anchor 2 in the axes of anchor 1; ``linear`` (3, n) and ``angular`` (3, n)
the derivatives by n coordinates of ``d`` and of the rotation of body 2 relative to body 1, both in these axes; ``dd``
and ``ddd`` the time derivatives of ``d``; ``spin`` and ``spin_rate`` the relative angular velocity, and its derivative
as seen from body 1. The table of :mod:`pinconsist.mechanism.loops` says what each block means. Each block has

* ``rows(d, R, linear, angular)``: Φ and J;
* ``bias(d, dd, ddd, R, spin, spin_rate)``: J̇ v, of Turn and Tilt where the loop is closed;
* ``closest``: the nearest d or R with Φ = 0.
"""

import numpy as np
import pinocchio as pin


def unit(vector) -> np.ndarray:
    """The vector at length 1."""
    vector = np.array(vector, float)
    vector /= np.abs(vector).max()
    return vector / np.linalg.norm(vector)


def across(e) -> np.ndarray:
    """Two unit vectors normal to the unit vector `e` and to each other, as rows; with e they are right-handed."""
    u1 = pin.skew(e)[:, np.argmin(np.abs(e))]
    u1 = u1 / np.linalg.norm(u1)
    return np.array([u1, pin.skew(e) @ u1])


class Place:
    """Components of d along fixed directions of anchor 1, the rows of ``directions`` (k, 3)."""

    def __init__(self, directions):
        self.directions = np.array(directions, float)

    def rows(self, d, R, linear, angular):
        return self.directions @ d, self.directions @ linear

    def bias(self, d, dd, ddd, R, spin, spin_rate):
        return self.directions @ ddd

    def closest(self, d):
        return d - self.directions.T @ (self.directions @ d)


class Length:
    """(|d|² − L²) / (2 L)."""

    def __init__(self, length):
        self.length = length

    def rows(self, d, R, linear, angular):
        return np.array([(d @ d - self.length**2) / (2 * self.length)]), (d @ linear / self.length)[None, :]

    def bias(self, d, dd, ddd, R, spin, spin_rate):
        return np.array([(dd @ dd + d @ ddd) / self.length])


class Turn:
    """log R."""

    def rows(self, d, R, linear, angular):
        return pin.log3(R), pin.Jlog3(R) @ R.T @ angular

    def bias(self, d, dd, ddd, R, spin, spin_rate):
        return spin_rate

    def closest(self, R):
        return np.eye(3)


class _Axis:
    """Rows of one axis of body 2, a = R axis2, along fixed directions of anchor 1.

    Where a loop is closed, Φ and J are those of ``directions @ a``, with ``directions`` of shape (k, 3).
    """

    axis2: np.ndarray
    directions: np.ndarray

    def bias(self, d, dd, ddd, R, spin, spin_rate):
        a, W = R @ self.axis2, pin.skew(spin)
        return self.directions @ (W @ (W @ a) + pin.skew(spin_rate) @ a)

    def closest(self, R):
        a = R @ self.axis2
        return pin.Quaternion.FromTwoVectors(a, self.closest_axis(a)).matrix() @ R


class Tilt(_Axis):
    """Tilt of the axis a = R e of body 2 against e, measured by the chord 2 sin(angle/2).

    The chord grows monotonically up to the antiparallel axis, which is therefore no false solution; there its direction
    is undetermined, and within TURNED rad of it Φ and J are those at TURNED.
    """

    TURNED = 1e-6

    def __init__(self, e):
        self.axis2 = e
        self.directions = -across(e) @ pin.skew(e).T  # tilt1 turns about the first row of across(e), tilt2 the second

    def rows(self, d, R, linear, angular):
        e, w, a = self.axis2, self.directions, R @ self.axis2
        tilt = w @ a
        z = 1.0 + e @ a
        if z < 0.5:  # no cancellation: |tilt|² = (1 + e·a)(1 - e·a)
            size = np.linalg.norm(tilt)
            if size < self.TURNED:
                tilt = self.TURNED * (tilt / size if size else np.array([1.0, 0.0]))
            z = tilt @ tilt / (1.0 - e @ a)
        s = np.sqrt(2.0 / z)
        gradient = s * (w - np.outer(tilt, e) / (2 * z))
        return s * tilt, -gradient @ pin.skew(a) @ angular

    def closest_axis(self, a):
        return self.axis2


class Cross(_Axis):
    """e₁·a, the cosine between the axis of body 1 and that of body 2: zero where they are perpendicular.

    Parallel axes are a stationary point, which assembly leaves by its perturbed starts.
    """

    def __init__(self, e1, e2):
        self.axis2, self.directions = e2, e1[None, :]

    def rows(self, d, R, linear, angular):
        a = R @ self.axis2
        return self.directions @ a, -self.directions @ pin.skew(a) @ angular

    def closest_axis(self, a):
        (e,) = self.directions
        square = a - (e @ a) * e
        return square if np.linalg.norm(square) > 1e-9 else across(e)[0]


def blocks(loop):
    """(place, turn) of a loop: its block of translational rows, and of rotational ones or None."""
    kind, everywhere = loop.kind, np.eye(3)
    if kind == "distance":
        return Length(loop.length), None
    if kind == "point":
        return Place(everywhere), None
    if kind == "frame":
        return Place(everywhere), Turn()
    e = unit(loop.axis)
    if kind == "universal":
        return Place(everywhere), Cross(e, unit(loop.axis2))
    directions = {"hinge": everywhere, "slider": across(e), "cylinder": across(e), "plane": e[None, :]}[kind]
    return Place(directions), Turn() if kind == "slider" else Tilt(e)
