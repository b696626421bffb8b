"""Mechanisms made from mechanisms: redundant joints and rows left out, anchors moved to where loops close."""

import logging
from dataclasses import replace

import numpy as np
import pinocchio as pin

from ..errors import InputError
from .assembly import assemble, impossible_alone
from .blocks import blocks
from .checks import warn
from .closing import CLOSED, LoopSolver, steady
from .correction import Walk
from .names import by_joint
from .rank import RANK_TOLERANCE, free_motions

PLACES = 5  # closed configurations, besides the first, in which joints and rows are examined
IMMOBILE = 1e-7  # share of a free motion, and displacement in rad or m, below which a joint counts as immobile
_log = logging.getLogger(__name__)


def reduced(mechanism, q=None):
    """See :meth:`Mechanism.reduced`."""
    closed = assemble(mechanism, q).q
    walk = Walk(mechanism.with_loops(*steady(mechanism.loops)), RANK_TOLERANCE)
    places = [closed, *walk.places(1 + PLACES, closed)[1:]]
    still = _still_joints(walk.solver, places)
    if len(still) == len(mechanism.joints):
        raise InputError(f"{mechanism.name}: the loops leave no motion at all: nothing would be left of the mechanism")
    result = mechanism.lock(still, closed) if still else replace(mechanism, guess=closed)
    shares = [by_joint(mechanism, place) for place in places]
    left = [result.configuration({joint: each[joint] for joint in result.joints}) for each in shares]
    lighter, changes = _with_fewer_rows(result, left)
    if still:
        _log.info("%s: joints that the loops hold still are locked: %s", mechanism.name, ", ".join(still))
    for change in changes:
        _log.info("%s: %s", mechanism.name, change)
    return lighter


def _still_joints(solver, places):
    """The joints that no free motion moves in any of the places, and that are at the same value in all of them."""
    share, mechanism = np.zeros(solver.model.nv), solver.mechanism
    for place in places[1:] or places:  # the first may be a singular position
        free = free_motions(solver.rows(place)[1], solver.loop_rows.turns)
        share = np.maximum(share, np.abs(free).max(axis=1, initial=0.0))
        share = np.maximum(share, np.abs(pin.difference(solver.model, places[0], place)))
    return tuple(joint for joint in mechanism.joints if share[mechanism.columns(joint)].max() < IMMOBILE)


def _with_fewer_rows(mechanism, places):
    """Loops that add nothing to the others dropped, and loops whose turning rows add nothing made points."""
    changes, ranks = [], _ranks(mechanism, mechanism.loops, places)
    for loop in reversed(mechanism.anchored_loops):
        others = [other for other in mechanism.loops if other is not loop]
        if _ranks(mechanism, others, places) == ranks:
            mechanism = mechanism.with_loops(*others)
            changes.append(f"loop {loop.name!r} follows from the others and is dropped")
        elif loop.kind in ("frame", "hinge", "universal"):
            point = replace(loop, kind="point", axis=None, axis2=None)
            loops = [point if other is loop else other for other in mechanism.loops]
            if _ranks(mechanism, loops, places) == ranks:
                mechanism = mechanism.with_loops(*loops)
                changes.append(f"the turning rows of loop {loop.name!r} follow from the others; it is a point now")
    return mechanism, changes


def _ranks(mechanism, loops, places):
    """The rank of these loops, without those that move, in each place."""
    solver = LoopSolver(mechanism.with_loops(*steady(loops)))
    return [len(solver.kept(place)) for place in places]


def reanchored(mechanism, q=None):
    """See :meth:`Mechanism.reanchored`."""
    result, solver = mechanism, LoopSolver(mechanism)
    best, _ = solver.close(mechanism.guess if q is None else mechanism.configuration(q, base=mechanism.guess))
    anchored = [loop.name for loop in mechanism.anchored_loops]  # a drive has no anchor to move
    to_move = impossible_alone(mechanism, best, solver.gaps(best), {}).keys() & set(anchored)
    while True:  # first the loops that cannot close alone; then, if the others do not follow, those too
        gaps = solver.gaps(best)
        worst = max((gaps[name] for name in anchored), default=0.0)
        to_move = to_move or {name for name in anchored if worst > CLOSED and gaps[name] > 1e-3 * worst}
        if not to_move:
            break
        model, data = result.model, result.model.createData()
        pin.framesForwardKinematics(model, data, best)
        loops = (_moved_anchor(model, data, loop) if loop.name in to_move else loop for loop in result.loops)
        result = replace(result, loops=tuple(loops))
        to_move, solver = set(), LoopSolver(result)
        best, _ = solver.close(best)
    pairs = zip(mechanism.loops, result.loops, strict=True)
    moves = [_move(before, after) for before, after in pairs if before != after]
    if moves:
        warn(f"{mechanism.name}: anchor 2 moved to the best fit on loops {', '.join(moves)}")
    return replace(result, guess=best)


def _move(before, after):
    if before.kind == "distance":
        return f"{before.name!r} by {after.length - before.length:+.3g} m of length"
    turn = before.placement2.rotation.T @ after.placement2.rotation
    move = f"{before.name!r} by {np.linalg.norm(np.subtract(after.xyz2, before.xyz2)):.3g} m"
    return move if before.kind == "point" else f"{move} and {np.linalg.norm(pin.log3(turn)):.3g} rad"


def _moved_anchor(model, data, loop):
    """The loop with anchor 2 at the nearest pose that closes it; a distance gets the length that is there."""
    pose1 = data.oMf[model.getFrameId(loop.frame1)] * loop.placement1
    pose2 = data.oMf[model.getFrameId(loop.frame2)]
    gap = pose1.actInv(pose2 * loop.placement2)
    if loop.kind == "distance":
        return replace(loop, length=float(np.linalg.norm(gap.translation)))
    place, turn = blocks(loop)
    closed = pin.SE3(gap.rotation if turn is None else turn.closest(gap.rotation), place.closest(gap.translation))
    anchor = pose2.actInv(pose1 * closed)
    rpy = loop.rpy2 if turn is None else tuple(pin.rpy.matrixToRpy(anchor.rotation))
    return replace(loop, xyz2=tuple(anchor.translation), rpy2=rpy)
