"""The inertia of an MJCF body: from its ``<inertial>``, or from the shapes and densities of its geoms.

Source: "XML Reference" of the MuJoCo documentation, compiler, inertial and geom.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ...errors import FormatError
from .values import flag, number, orientation, vector

TINY = 1e-14
"""Masses and volumes up to here count as none, kg or m³; MuJoCo's own bound."""
_ROUNDED = 1e-9  # relative error of principal moments that files have from rounding
_WATER = 1000.0  # kg/m³


def body_inertia(inertial, geoms, place: pin.SE3, compiler, element: str) -> pin.Inertia:
    """The inertia of a body, in its axes, about its origin's place.

    Parameters
    ----------
    inertial : mapping or None
        Attributes of ``<inertial>``.
    geoms : sequence of Geom
        The geoms of the body.
    place : pin.SE3
        The body's place in its parent.
    compiler : Compiler
    element : str
        The body, for messages.

    Raises
    ------
    FormatError
        Negative masses, impossible moments, a mass that would have to come from a mesh.
    """
    mass, lever, moments = 0.0, place.translation, np.zeros((3, 3))  # to where MuJoCo puts a bound mass
    if inertial is not None:
        mass, lever, moments = _explicit(inertial, compiler, f"{element}: inertial")
    least, most = compiler.inertiagroups
    if compiler.inertiafromgeom == "true" or (inertial is None and compiler.inertiafromgeom == "auto"):
        parts = [_of_geom(geom) for geom in geoms if least <= geom.group <= most]
        parts = [part for part in parts if part.mass > TINY]
        if parts:
            total = sum(parts[1:], parts[0])
            mass, lever, moments = total.mass, total.lever, total.inertia
    return _corrected(mass, lever, moments, compiler, element)


def scaled(inertia: pin.Inertia, factor: float, element: str) -> pin.Inertia:
    """The same body at another density; FormatError where its numbers grow too large."""
    return _made(factor * inertia.mass, inertia.lever, factor * inertia.inertia, element)


def _made(mass, lever, moments, element):
    if not (np.isfinite(mass) and np.isfinite(lever).all() and np.isfinite(moments).all()):
        raise FormatError("its inertia is immense", element=element)
    return pin.Inertia(mass, lever, moments)


def _explicit(given, compiler, element):
    if "mass" not in given or "pos" not in given:
        raise FormatError(f"attribute {'mass' if 'pos' in given else 'pos'!r} is missing", element=element)
    mass = number(given, "mass", element)
    full = vector(given, "fullinertia", element, 6)
    turns = {"quat", "axisangle", "xyaxes", "zaxis", "euler"} & given.keys()
    if full is not None and (turns or "diaginertia" in given):
        other = "diaginertia" if "diaginertia" in given else turns.pop()
        raise FormatError(f"fullinertia and {other} cannot both be given", element=element)
    if full is not None:
        xx, yy, zz, xy, xz, yz = full
        moments = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    else:
        R = orientation(given, compiler, element)
        moments = R @ np.diag(vector(given, "diaginertia", element, 3, (0.0, 0.0, 0.0))) @ R.T
    return mass, vector(given, "pos", element, 3), moments


def _corrected(mass, lever, moments, compiler, element):
    """The inertia within the compiler's bounds; FormatError where no body can have it."""
    moments = (moments + moments.T) / 2
    scale = np.abs(moments).max() or 1.0
    if not np.isfinite(scale):
        raise FormatError("its inertia is immense", element=element)
    principal, axes = np.linalg.eigh(moments / scale)
    principal = principal * scale
    if mass < 0:
        raise FormatError(f"the mass is negative: {mass:g} kg", element=element)
    if principal[0] < -_ROUNDED * scale:
        raise FormatError(f"a principal inertia is negative: {principal[0]:.3g} kg m²", element=element)
    mass = max(mass, compiler.boundmass)
    if principal[0] < compiler.boundinertia:
        principal = np.maximum(principal, compiler.boundinertia)
        moments = axes @ np.diag(principal) @ axes.T
    if principal[2] > principal[0] + principal[1] + _ROUNDED * scale:
        if not compiler.balanceinertia:
            raise FormatError(
                f"no body has the principal inertias {principal[0]:.3g}, {principal[1]:.3g}, {principal[2]:.3g} kg m²: "
                "the largest exceeds the sum of the others. The compiler's balanceinertia would average them",
                element=element,
            )
        moments = principal.mean() * np.eye(3)
    return _made(mass, lever, moments, element)


def _of_geom(geom) -> pin.Inertia:
    """The inertia of a geom in the axes of its body."""
    given, element = geom.attributes, geom.element
    mass = number(given, "mass", element, least=0.0) if "mass" in given else None
    density = number(given, "density", element, default=_WATER, least=0.0)
    if mass == 0 or (mass is None and density == 0) or geom.kind == "plane":
        return pin.Inertia.Zero()
    if geom.kind not in _SHAPES or "mesh" in given:
        raise FormatError(
            f"the mass of its body would follow from a {geom.kind if geom.kind not in _SHAPES else 'mesh'}, which is "
            "not computed here; give the body an <inertial>, or this geom mass=0 (MuJoCo saves a compiled scene with "
            "an <inertial> in every body)",
            element=element,
        )
    if flag(given, "shellinertia", element):
        raise FormatError("the inertia of a shell is not computed here; give the body an <inertial>", element=element)
    volume, gyration = _SHAPES[geom.kind](*geom.size)
    if mass is None:
        mass = density * volume
    elif volume <= TINY:
        return pin.Inertia.Zero()
    return geom.place.act(pin.Inertia(mass, np.zeros(3), mass * np.diag(gyration)))


def _ellipsoid(a, b, c):
    return 4 / 3 * np.pi * a * b * c, ((b * b + c * c) / 5, (a * a + c * c) / 5, (a * a + b * b) / 5)


def _sphere(r):
    return _ellipsoid(r, r, r)


def _box(a, b, c):
    return 8 * a * b * c, ((b * b + c * c) / 3, (a * a + c * c) / 3, (a * a + b * b) / 3)


def _cylinder(r, h):
    across = r * r / 4 + h * h / 3
    return 2 * np.pi * r * r * h, (across, across, r * r / 2)


def _capsule(r, h):
    ball, rod = 4 / 3 * r, 2 * h  # volumes over π r²
    ends = ball / (ball + rod)  # share of the two half balls
    across = ends * (2 / 5 * r * r + h * (3 / 4 * r + h)) + (1 - ends) * (r * r / 4 + h * h / 3)
    along = ends * 2 / 5 * r * r + (1 - ends) * r * r / 2
    return np.pi * r * r * (ball + rod), (across, across, along)


_SHAPES = {"sphere": _sphere, "ellipsoid": _ellipsoid, "box": _box, "cylinder": _cylinder, "capsule": _capsule}
"""Volume, and squared radii of gyration, from the half sizes."""
