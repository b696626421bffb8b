"""Masses of solids of uniform density, for files that give a density instead of inertias."""

import math

import numpy as np
import pinocchio as pin

from ..errors import FormatError


def box(x: float, y: float, z: float) -> pin.Inertia:
    """A box of these sizes, m, about its centre; of density 1 kg/m³, as all solids here."""
    mass = x * y * z
    return _diagonal(mass, mass / 12.0 * np.array([y * y + z * z, x * x + z * z, x * x + y * y]))


def ellipsoid(a: float, b: float, c: float) -> pin.Inertia:
    """An ellipsoid of these semi-axes; a sphere if they are equal."""
    mass = 4.0 / 3.0 * math.pi * a * b * c
    return _diagonal(mass, mass / 5.0 * np.array([b * b + c * c, a * a + c * c, a * a + b * b]))


def cylinder(radius: float, length: float) -> pin.Inertia:
    """A cylinder along z, about its centre."""
    mass = math.pi * radius**2 * length
    across = mass * (3.0 * radius**2 + length**2) / 12.0
    return _diagonal(mass, np.array([across, across, 0.5 * mass * radius**2]))


def capsule(radius: float, length: float) -> pin.Inertia:
    """A cylinder of this length along z with half a sphere on both ends."""
    ball = 2.0 / 3.0 * math.pi * radius**3  # mass of half a sphere
    middle = 0.375 * radius  # its centre of mass, from its plane
    own = 2.0 / 5.0 * ball * radius**2 - ball * middle**2
    across = 2.0 * (own + ball * (0.5 * length + middle) ** 2)
    caps = _diagonal(2.0 * ball, np.array([across, across, 4.0 / 5.0 * ball * radius**2]))
    return caps + cylinder(radius, length)


def cone(radius: float, length: float) -> pin.Inertia:
    """A cone along z, whose tip is at z = length/2 and whose base at -length/2."""
    mass = math.pi * radius**2 * length / 3.0
    across = 3.0 / 80.0 * mass * (4.0 * radius**2 + length**2)
    centred = _diagonal(mass, np.array([across, across, 0.3 * mass * radius**2]))
    return pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.25 * length])).act(centred)


def mesh(points: np.ndarray, triangles: np.ndarray) -> pin.Inertia:
    """A solid whose closed surface has these points, (n, 3), and triangles, (m, 3), in either orientation.

    Its moments are the sums of those of the tetrahedra between the triangles and the origin. The inertia is zero if the
    surface has no volume.
    """
    a, b, c = (np.asarray(points, float)[np.asarray(triangles, int)[:, i]] for i in range(3))
    volumes = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0
    mass = volumes.sum()
    if not mass:
        return pin.Inertia.Zero()
    middle = (volumes[:, None] * (a + b + c)).sum(axis=0) / 4.0 / mass
    a, b, c = a - middle, b - middle, c - middle
    volumes = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0
    total = a + b + c
    second = sum(np.einsum("i,ij,ik->jk", volumes, each, each) for each in (a, b, c, total)) / 20.0
    inertia = np.trace(second) * np.eye(3) - second
    sign = np.sign(mass)
    return _inertia(sign * mass, middle, sign * inertia)


def moved(inertia: pin.Inertia, matrix: np.ndarray) -> pin.Inertia:
    """The inertia of a solid of the same density whose points are moved by an affine map, (4, 4) or (3, 4)."""
    A, b = matrix[:3, :3], matrix[:3, 3]
    size = abs(np.linalg.det(A))
    mass, lever = size * inertia.mass, A @ inertia.lever + b
    second = 0.5 * np.trace(inertia.inertia) * np.eye(3) - inertia.inertia  # ∫ x xᵀ dm about the centre of mass
    second = size * A @ second @ A.T
    return _inertia(mass, lever, np.trace(second) * np.eye(3) - second)


def scaled(inertia: pin.Inertia, factor: float) -> pin.Inertia:
    """The inertia of the same solid with another density."""
    return _inertia(factor * inertia.mass, inertia.lever, factor * inertia.inertia)


def _diagonal(mass, moments):
    return _inertia(mass, np.zeros(3), np.diag(moments))


def _inertia(mass, lever, moments) -> pin.Inertia:
    """FormatError if a size or a density is negative, or too large for its moments to be numbers."""
    if not (0.0 <= mass < math.inf and np.isfinite(lever).all() and np.isfinite(moments).all()):
        raise FormatError(f"a solid of this size and density has a mass of {mass:.3g} kg")
    if not (np.diag(moments) >= 0.0).all():
        raise FormatError(f"a solid of this size has moments of {np.diag(moments)} kg·m²")
    found = pin.Inertia.Zero()
    found.mass, found.lever, found.inertia = mass, lever, 0.5 * (moments + moments.T)
    return found
