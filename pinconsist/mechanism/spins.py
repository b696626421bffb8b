"""Rods that spin freely about their own axis: found, and locked.

A rod between two ball joints, or its two halves, can turn about its axis without moving anything else. If it is round,
its axial speed stays what it is, zero in most runs, and has no effect; but each spin is a coordinate, and under rough
control rounding and iteration errors let it grow. A rod without axial inertia moves the other bodies in the same way
whether its spin is locked or not.
"""

import logging
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from .assembly import assemble
from .closing import LoopSolver
from .correction import Walk
from .editing import body_of
from .loops import Loop
from .names import is_revolute
from .rank import RANK_TOLERANCE

ROUND = 1e-5  # relative: largest difference of the moments of inertia across the axis, and distances from it
SPIN_STILL = 1e-7  # largest |J| of a spin that moves nothing
SPIN_PLACES = 3  # closed configurations, besides the first, at which this is examined
_log = logging.getLogger(__name__)


@dataclass
class Spin:
    """A joint about the own axis of the body that it carries."""

    joint: str
    index: int
    axis: np.ndarray


def lock_spins(mechanism, q=None):
    """See :meth:`Mechanism.lock_spins`."""
    closed = assemble(mechanism, q).q
    spins = _spins(mechanism)
    opened = mechanism
    while spins:
        loops = tuple(_opened(loop, mechanism, spins, closed) for loop in mechanism.loops)
        opened = mechanism.with_loops(*loops)
        free = _free(opened, spins, closed)
        if len(free) == len(spins):
            break
        spins = free
    if not spins:
        _log.info("%s: no rod spins freely about its own axis", mechanism.name)
        return mechanism
    names = [spin.joint for spin in spins]
    _log.info("%s: rods that spin freely are locked: %s", mechanism.name, ", ".join(names))
    model = mechanism.model.copy()
    for spin in spins:
        model.inertias[spin.index] = _without_spin(model.inertias[spin.index], spin.axis)
    return replace(opened, model=model).lock(names, closed)


def _spins(mechanism) -> list[Spin]:
    """Joints without motor, force or inertia of their own that turn a round body, with loops, about its axis."""
    model, found = mechanism.model, []
    looped = {body_of(model, frame) for loop in mechanism.anchored_loops for frame in (loop.frame1, loop.frame2)}
    busy = _busy(mechanism)
    parents = set(model.parents)
    for i, name in enumerate(mechanism.joints, start=1):
        axis = _axis(model.joints[i])
        own = mechanism.columns(name)
        plain = not any(getattr(model, what)[own].any() for what in ("armature", "damping", "friction"))
        if axis is None or i in parents or i not in looped or name in busy or i in busy or not plain:
            continue
        if _is_round(model.inertias[i], axis):
            found.append(Spin(name, i, axis))
    return found


def _busy(mechanism) -> set:
    """The joints and the bodies, by their index, on which motors, forces, couplings, drives or contacts act."""
    found: set = set(mechanism.actuated)
    for record in (*mechanism.forces, *mechanism.contacts, *mechanism.loops):
        if isinstance(record, Loop):
            continue
        frames = [getattr(record, field, "") for field in ("frame", "frame1", "frame2", "on")]
        named = [getattr(record, field, ()) for field in ("joint", "joints", "arms", "coefficients", "torques")]
        known = any(frames) or any(isinstance(each, str | dict | tuple | list) and len(each) for each in named)
        if not known:  # a law of the user's, which may act on every joint
            return {*mechanism.joints}
        found |= {body_of(mechanism.model, frame) for frame in frames if isinstance(frame, str) and frame}
        for each in named:
            found |= {each} if isinstance(each, str) else {name for name in each if isinstance(name, str)}
    return found


def _axis(joint):
    """The axis of a revolute joint; None for others."""
    return np.ravel(joint.createData().S)[3:] if is_revolute(joint) else None


def _is_round(inertia, axis) -> bool:
    """Whether a body has its centre of mass on an axis, and the same moments of inertia across it."""
    if inertia.mass <= 0.0:
        return False
    across = np.linalg.svd(axis[None])[2][1:]
    moments = np.vstack((across, axis)) @ inertia.inertia @ np.vstack((across, axis)).T
    size = np.abs(moments).max()
    off = np.array([moments[0, 0] - moments[1, 1], moments[0, 1], moments[0, 2], moments[1, 2]])
    aside = inertia.mass * np.linalg.norm(across @ inertia.lever) ** 2
    return bool(
        np.abs(off).max() <= ROUND * size and aside <= ROUND**2 * (size + inertia.mass * inertia.lever @ inertia.lever)
    )


def _opened(loop, mechanism, spins, q):
    """A loop of whole poses between two halves of a rod, as a hinge about its axis; other loops as they are."""
    if not (isinstance(loop, Loop) and loop.kind == "frame"):
        return loop
    model = mechanism.model
    ends = {spin.index: spin for spin in spins}
    one, other = (ends.get(body_of(model, frame)) for frame in (loop.frame1, loop.frame2))
    if one is None or other is None:
        return loop
    frame = model.frames[model.getFrameId(loop.frame1)]
    return replace(loop, kind="hinge", axis=tuple((frame.placement * loop.placement1).rotation.T @ one.axis))


def _free(mechanism, spins, closed) -> list[Spin]:
    """The spins that move no loop, at several closed configurations."""
    places = [closed, *Walk(mechanism, RANK_TOLERANCE).places(1 + SPIN_PLACES, closed)[1:]]
    solver = LoopSolver(mechanism)
    largest = np.max([np.abs(solver.rows(place)[1]) for place in places], axis=(0, 1))
    return [spin for spin in spins if largest[mechanism.columns(spin.joint)].max() <= SPIN_STILL]


def _without_spin(inertia, axis):
    """The inertia of a body without that about an axis through its centre of mass."""
    own = inertia.inertia
    return pin.Inertia(inertia.mass, inertia.lever, own - (axis @ own @ axis) * np.outer(axis, axis))
