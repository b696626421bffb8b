"""All assembly modes: the closed configurations of a mechanism with the same positions of the joints that move it."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, pi

import numpy as np
import pinocchio as pin

from ..errors import InputError
from .assembly import assembled
from .axes import turning_columns
from .closing import NEARLY, LoopSolver
from .lie import difference, integrate
from .names import BeyondLimit, beyond_limits
from .rank import free_motions

SAME = 1e-3  # rad, and relative to the size: at a double root a gap of NEARLY leaves errors of its square root
STARTS = 2000  # at most
PATIENCE = 60, 30  # starts without a new mode after which the search ends: at least, and for each mode found
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
    configurations are the same if all bodies that have mass or carry a loop are at the same place: joint angles that
    differ by turns, or the two sets of angles of a universal joint, are not two modes.
    """
    solver = LoopSolver(mechanism)
    first = assembled(solver, q0)
    held = _held(mechanism, solver, first.q, tuple(q0) if isinstance(q0, dict) else ())
    free = solver.free_columns(held)
    places = _Places(mechanism)
    found, hits = [first.q], [1]
    known = [places.of(first.q)]
    rng, last, starts, missed = np.random.default_rng(seed), 0, 0, 0
    largest = _ranges(mechanism, first.q, places.size)
    while starts < STARTS and starts - last < max(PATIENCE[0], PATIENCE[1] * len(found)) and free.any():
        starts += 1
        away = np.where(free, rng.uniform(-1.0, 1.0, mechanism.nv) * largest, 0.0)
        q, _ = solver.descend(integrate(mechanism.model, first.q, away), free)
        if not solver.size(q) <= NEARLY:
            missed += 1
            continue
        here = places.of(q)
        same = next((i for i, each in enumerate(known) if np.abs(here - each).max(initial=0.0) < SAME), None)
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


class _Places:
    """Where the bodies are that have mass or carry a loop: rotations, and positions relative to the size."""

    def __init__(self, mechanism):
        self.model, self.data = mechanism.model, mechanism.model.createData()
        ends = [frame for loop in mechanism.anchored_loops for frame in (loop.frame1, loop.frame2)]
        carriers = {self.model.frames[self.model.getFrameId(frame)].parentJoint for frame in ends}
        masses = [inertia.mass > 0.0 for inertia in self.model.inertias]
        self.bodies = [i for i in range(1, self.model.njoints) if masses[i] or i in carriers]
        self.size = 1.0
        pin.forwardKinematics(self.model, self.data, mechanism.guess)
        points = np.array([self.data.oMi[i].translation for i in range(self.model.njoints)])
        levers = max((float(np.linalg.norm(inertia.lever)) for inertia in self.model.inertias), default=0.0)
        self.size = max(float(np.linalg.norm(np.ptp(points, axis=0))), levers) or 1.0

    def of(self, q) -> np.ndarray:
        pin.forwardKinematics(self.model, self.data, q)
        poses = [self.data.oMi[i] for i in self.bodies]
        return np.array([[*pose.rotation.ravel(), *(pose.translation / self.size)] for pose in poses]).ravel()


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


def _ranges(mechanism, q, size) -> np.ndarray:
    """How far each velocity coordinate may start from a configuration: half a turn, or twice the size."""
    return np.where(turning_columns(mechanism.model), pi, 2.0 * size)
