"""Joints of MJCF as plain records."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ...errors import FormatError
from ..reading import shown
from .settings import Compiler
from .values import direction, keyword, number, vector

KINDS = ("hinge", "slide", "ball", "free")


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint of a body. Angles in rad, everything in the axes of the body.

    Attributes
    ----------
    ref : float
        Its value where the body stands as the file places it; 0 for ball and free joints.
    limits : tuple of 2 float
        Infinite where there are none.
    stiffness, springref : float
        Torque -stiffness (q - springref).
    """

    name: str
    element: str
    kind: str
    pos: np.ndarray
    axis: np.ndarray
    ref: float = 0.0
    limits: tuple[float, float] = (-np.inf, np.inf)
    stiffness: float = 0.0
    springref: float = 0.0
    damping: float = 0.0
    frictionloss: float = 0.0
    armature: float = 0.0


def joint(name: str, given: dict[str, str], frame: pin.SE3, compiler: Compiler, element: str) -> Joint:
    """A joint from all its attributes, in a frame of its body."""
    kind = keyword(given, "type", element, KINDS)
    if np.any(vector(given, "springdamper", element, 2, (0.0, 0.0))):
        raise FormatError("springdamper is not computed here; give stiffness and damping", element=element)
    if np.any(vector(given, "springyield", element, (1, 3), (0.0,))):
        raise FormatError("springs that yield are not computed here", element=element)
    pos = frame.act(vector(given, "pos", element, 3, (0.0, 0.0, 0.0)))
    axis = frame.rotation @ direction(vector(given, "axis", element, 3, (0.0, 0.0, 1.0)), "axis", element)
    stiffness, damping = (_linear(given, key, element) for key in ("stiffness", "damping"))
    friction, armature = (number(given, key, element, least=0.0) for key in ("frictionloss", "armature"))
    passive = {"stiffness": stiffness, "damping": damping, "frictionloss": friction, "armature": armature}
    if kind not in ("hinge", "slide"):
        _check_several(kind, passive, element)
        if kind == "free":
            _check_alignment(given, compiler, element)
        return Joint(name, element, kind, pos, axis, **passive)
    angle = compiler.angle if kind == "hinge" else float
    ref, springref = (angle(number(given, key, element)) for key in ("ref", "springref"))
    limits = tuple(map(angle, _limits(given, compiler, element)))
    return Joint(name, element, kind, pos, axis, ref, limits, springref=springref, **passive)


def _check_several(kind, passive, element):
    """Refuse what joints of several degrees of freedom do otherwise here than in MuJoCo."""
    if passive["stiffness"]:
        raise FormatError(f"springs of {kind} joints are not computed here", element=element)
    if kind == "free" and (passive["armature"] or passive["frictionloss"]):
        raise FormatError(
            "armature and frictionloss of a free joint act along the world's axes, which is not computed here; set "
            "them to zero, as <freejoint/> does",
            element=element,
        )


def _check_alignment(given, compiler, element):
    align = keyword(given, "align", element, ("auto", "true", "false"))
    if align == "true" or (align == "auto" and compiler.alignfree):
        raise FormatError("a body is not aligned with its principal axes here; set align=false", element=element)


def _limits(given, compiler, element):
    limited = keyword(given, "limited", element, ("auto", "true", "false"))
    ends = vector(given, "range", element, 2, (0.0, 0.0))
    if limited == "false" or (limited == "auto" and not (compiler.autolimits and ends.any())):
        return -np.inf, np.inf
    if ends[0] >= ends[1]:
        raise FormatError(f"the range from {ends[0]:g} to {ends[1]:g} is empty", element=element)
    return ends


def _linear(given, key, element):
    """The coefficient of a force that grows linearly."""
    values = vector(given, key, element, (1, 3), (0.0,))
    if np.any(values[1:]):
        raise FormatError(f"nonlinear {key} is not computed here: {shown(given[key])}", element=element)
    if values[0] < 0:
        raise FormatError(f"{key}={values[0]:g} is negative", element=element)
    return float(values[0])
