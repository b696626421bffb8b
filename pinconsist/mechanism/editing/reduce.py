"""The same motion with fewer joints and rows."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
import pinocchio as pin

from ...errors import InputError
from ..assembly import assemble
from ..constraints.drive import Drive
from ..constraints.rank import independent_rows
from ..loop_solver import CLOSED, LoopSolver
from ..mechanism import Mechanism

PLACES = 5
"""Closed configurations, beside the first, in which joints and rows are looked at."""
REACH = 0.4
"""How far these lie from one another, rad and m in all coordinates together."""
IMMOBILE = 1e-7
"""Share of a free motion, and displacement in rad or m, below which a joint counts as still."""
_BY_POINTS = ("frame", "hinge", "universal")
_log = logging.getLogger(__name__)


def reduced(mechanism: Mechanism, q=None) -> Mechanism:
    """See :meth:`Mechanism.reduced`."""
    closed = assemble(mechanism, q).q
    undriven = mechanism.with_loops(*_steady(mechanism.loops))
    places = _places(undriven, closed)
    still = _still_joints(undriven, places)
    if len(still) == len(mechanism.joints):
        raise InputError(f"{mechanism.name}: the loops leave no motion at all, so that nothing would be left of it")
    result = mechanism.lock(still, closed) if still else replace(mechanism, guess=closed)
    left = [k for joint in result.joints for k in _coordinates(mechanism, joint)]
    places = [place[left] for place in places]
    lighter, changes = _with_fewer_rows(result, places)
    if still:
        _log.info("%s: joints that the loops hold still are locked: %s", mechanism.name, ", ".join(still))
    for change in changes:
        _log.info("%s: %s", mechanism.name, change)
    return lighter


def _coordinates(mechanism, joint):
    i = mechanism.joint_index(joint)
    start = mechanism.model.idx_qs[i]
    return range(start, start + mechanism.model.nqs[i])


def _places(mechanism, closed):
    """The closed configuration and others, along a random walk on the loops."""
    solver, everything = LoopSolver(mechanism), np.ones(mechanism.nv, dtype=bool)
    rng, places = np.random.default_rng(0), [closed]
    for _ in range(PLACES):
        free = _free_motions(solver, places[-1])
        if not free.shape[1]:
            break
        motion = free @ rng.standard_normal(free.shape[1])
        near = pin.integrate(mechanism.model, places[-1], REACH * motion / np.linalg.norm(motion))
        place, _ = solver.close(near, everything)
        if solver.size(place) <= CLOSED:
            places.append(place)
    return places


def _free_motions(solver, q):
    """Columns: velocities that the loops allow at q."""
    _, J = solver.rows(q)
    J = J[independent_rows(J, solver.loop_rows.turns)]
    return np.linalg.svd(J)[2][len(J) :].T if len(J) else np.eye(solver.model.nv)


def _still_joints(mechanism, places):
    """The joints that no free motion moves in any of the places, and that stand alike in all of them."""
    solver = LoopSolver(mechanism)
    share = np.zeros(mechanism.nv)
    for place in places[1:] or places:  # the first may be a singular position
        share = np.maximum(share, np.abs(_free_motions(solver, place)).max(axis=1, initial=0.0))
    for place in places[1:]:
        share = np.maximum(share, np.abs(pin.difference(mechanism.model, places[0], place)))
    return tuple(joint for joint in mechanism.joints if share[mechanism.columns(joint)].max() < IMMOBILE)


def _with_fewer_rows(mechanism, places):
    """Loops that add nothing to the others dropped, and loops whose turning rows add nothing made points."""
    changes = []
    for loop in reversed(mechanism.anchored_loops):
        others = [other for other in mechanism.loops if other is not loop]
        if _same_rank(mechanism, others, places):
            mechanism = mechanism.with_loops(*others)
            changes.append(f"loop {loop.name!r} follows from the others and is dropped")
        elif loop.kind in _BY_POINTS:
            point = replace(loop, kind="point", axis=None, axis2=None)
            loops = [point if other is loop else other for other in mechanism.loops]
            if _same_rank(mechanism, loops, places):
                mechanism = mechanism.with_loops(*loops)
                changes.append(f"the turning rows of loop {loop.name!r} follow from the others; it is a point now")
    return mechanism, changes


def _same_rank(mechanism, loops, places):
    """Whether these loops hold all that the mechanism's loops do, drives left out."""
    fewer = LoopSolver(mechanism.with_loops(*_steady(loops)))
    all_of_them = LoopSolver(mechanism.with_loops(*_steady(mechanism.loops)))
    return all(_rank(fewer, place) == _rank(all_of_them, place) for place in places)


def _steady(loops):
    return [loop for loop in loops if not (isinstance(loop, Drive) or getattr(loop, "moving", False))]


def _rank(solver, q):
    return len(independent_rows(solver.rows(q)[1], solver.loop_rows.turns))
