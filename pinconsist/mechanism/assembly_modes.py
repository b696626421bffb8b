"""All assembly modes: the closed configurations of a mechanism with the same positions of the joints that move it."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, pi, tau

import numpy as np
import pinocchio as pin

from ..errors import InputError
from .assembly import assembled, not_kept
from .closing import NEARLY_CLOSED, LoopSolver
from .lie import integrate
from .names import BeyondLimit, beyond_limits, is_revolute, velocity_units
from .rank import free_motions

SAME_MODE = 1e-3  # relative to the size: at a double root a gap of NEARLY_CLOSED leaves errors of its square root
STARTS = 2000  # at most
WITHOUT_NEW = 60, 30  # starts without a new mode after which the search ends: at least, and for each mode found
INDEPENDENT = 1e-6  # of the motions of unit length: smaller parts do not determine a joint


@dataclass(frozen=True)
class Mode:
    """A closed configuration; `found` is the number of starts that led to it."""

    q: np.ndarray
    found: int
    gap: float  # largest |Φ|, m or rad
    singular: bool  # whether the rows have a lower rank than in the first mode
    beyond: tuple[BeyondLimit, ...]


@dataclass(frozen=True)
class Modes:
    """All modes that were found: the one that :func:`assemble` finds first, the others by their distance from it."""

    held: tuple[str, ...]  # the joints whose positions are the same in all modes
    modes: tuple[Mode, ...]
    starts: int
    missed: int  # starts from which the loops did not close


def assembly_modes(mechanism, q0=None, seed: int = 0) -> Modes:
    """The assembly modes of a mechanism, from many starts; a mode that few starts lead to may be missing.

    Held are the joints named in `q0`, and of the motors and then of the other joints those that determine the rest. Two
    configurations are the same if all joints, frames, anchors and centres of mass of the bodies are at the same places:
    joint angles that differ by turns, the two sets of angles of a universal joint, and the spin of a rod about itself
    are not two modes.

    Parameters
    ----------
    mechanism : Mechanism
    q0 : mapping, optional
        Joint name → value, as in :func:`assemble`.
    seed : int
        Of the random starts.

    Raises
    ------
    AssemblyError, InputError
        The loops do not close, or not with the values in `q0`.
    """
    solver = LoopSolver(mechanism)
    first = assembled(solver, q0)
    if moved := not_kept(mechanism, q0 or {}, first.q):
        raise InputError(f"{mechanism.name}: the loops do not close with these positions of {', '.join(moved)}")
    held = _held(mechanism, solver, first.q, tuple(q0) if isinstance(q0, dict) else ())
    free = solver.free_columns(held)
    places = _Places(mechanism)
    found, hits = [first.q], [1]
    known = [places.of(first.q)]
    rng, last, starts, missed = np.random.default_rng(seed), 0, 0, 0
    largest = [2.0 * places.size if unit == "m" else pi for unit in velocity_units(mechanism.model)]
    while starts < STARTS and starts - last < max(WITHOUT_NEW[0], WITHOUT_NEW[1] * len(found)) and free.any():
        starts += 1
        away = np.where(free, rng.uniform(-1.0, 1.0, mechanism.nv) * largest, 0.0)
        q, _ = solver.descend(integrate(mechanism.model, first.q, away), free)
        if not solver.size(q) <= NEARLY_CLOSED:
            missed += 1
            continue
        q = _without_turns(solver, q, first.q)
        here = places.of(q)
        same = next((i for i, each in enumerate(known) if np.abs(here - each).max(initial=0.0) < SAME_MODE), None)
        if same is None:
            found.append(q)
            known.append(here)
            hits.append(1)
            last = starts
        else:
            hits[same] += 1
    rank = len(solver.kept(first.q))
    order = [0, *sorted(range(1, len(found)), key=lambda i: float(np.linalg.norm(known[i] - known[0])))]
    modes = [
        Mode(found[i], hits[i], solver.size(found[i]), len(solver.kept(found[i])) < rank,
             beyond_limits(mechanism, [0.0], found[i][None, :]))
        for i in order
    ]  # fmt: skip
    return Modes(held, tuple(modes), starts, missed)


def _without_turns(solver, q, near) -> np.ndarray:
    """The same configuration with angles within half a turn of those of another, if the loops stay closed."""
    model, folded = solver.model, q.copy()
    for joint in list(model.joints)[1:]:
        if is_revolute(joint) and joint.nq == 1:
            folded[joint.idx_q] -= tau * round((q[joint.idx_q] - near[joint.idx_q]) / tau)
    return folded if solver.size(folded) <= NEARLY_CLOSED else q


class _Places:
    """Where the points are that bodies with mass, or with a loop, have: joints, frames, anchors and centres of mass."""

    def __init__(self, mechanism):
        model = self.model = mechanism.model
        self.data = model.createData()
        anchors = [(loop.frame1, loop.placement1) for loop in mechanism.anchored_loops]
        anchors += [(loop.frame2, loop.placement2) for loop in mechanism.anchored_loops]
        frames = [model.frames[model.getFrameId(name)] for name, _ in anchors]
        carriers = {frame.parentJoint for frame in frames}
        points = [(i, np.zeros(3)) for i in range(1, model.njoints)]
        points += [(model.parents[i], model.jointPlacements[i].translation) for i in range(1, model.njoints)]
        points += [(i, inertia.lever) for i, inertia in enumerate(model.inertias)]
        points += [(frame.parentJoint, frame.placement.translation) for frame in model.frames]
        points += [(frame.parentJoint, (frame.placement * place).translation)
                   for frame, (_, place) in zip(frames, anchors, strict=True)]  # fmt: skip
        own = [i for i in range(1, model.njoints) if model.inertias[i].mass > 0.0 or i in carriers]
        self.points = [(i, np.array(point)) for i, point in points if i in own]
        self.size = float(np.linalg.norm(np.ptp([np.zeros(3), *self._at(mechanism.guess)], axis=0))) or 1.0

    def _at(self, q) -> list[np.ndarray]:
        pin.forwardKinematics(self.model, self.data, q)
        return [self.data.oMi[i].act(point) for i, point in self.points]

    def of(self, q) -> np.ndarray:
        """All points, relative to the size."""
        return np.array(self._at(q)).ravel() / self.size


def _held(mechanism, solver, q, named) -> tuple[str, ...]:
    """The joints that are held: the named ones, then motors and others while they move independently."""
    motions = free_motions(solver.rows(q)[1], solver.loop_rows.turns)
    held = list(named)
    for joint in dict.fromkeys((*named, *mechanism.actuated, *mechanism.joints)):
        columns = mechanism.columns(joint)
        part = motions[columns]
        if not motions.shape[1]:
            break
        sizes = np.linalg.svd(part, compute_uv=False)
        if joint not in named and not (len(sizes) == len(part) and sizes.min(initial=inf) > INDEPENDENT):
            continue
        if joint not in named:
            held.append(joint)
        _, values, Vt = np.linalg.svd(part)
        motions = motions @ Vt[np.count_nonzero(values > INDEPENDENT) :].T
    if motions.shape[1]:
        raise InputError(f"{mechanism.name}: no joints were found whose positions determine all others")
    return tuple(held)
