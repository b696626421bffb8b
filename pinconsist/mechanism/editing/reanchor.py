"""Loops that cannot close as they were written: their anchors moved to where they fit best."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pinocchio as pin

from ..assembly import impossible_alone
from ..constraints.loop_rows import blocks
from ..loop_solver import CLOSED, LoopSolver
from ..mechanism import Mechanism


def reanchor(mechanism: Mechanism, q=None) -> Mechanism:
    """See :meth:`Mechanism.reanchored`."""
    best = mechanism.guess if q is None else mechanism.configuration(q, base=mechanism.guess)
    result, everything = mechanism, np.ones(mechanism.nv, dtype=bool)
    solver = LoopSolver(result)
    best, _ = solver.close(best, everything)
    to_move = impossible_alone(mechanism, best, solver.gaps(best), {})
    to_move = {loop.name for loop in mechanism.anchored_loops} & to_move.keys()
    while True:  # first the loops that cannot close alone; then, if the others do not follow, those too
        gaps = solver.gaps(best)
        gaps = {loop.name: gaps[loop.name] for loop in mechanism.anchored_loops}  # a drive has no anchor to move
        worst = max(gaps.values(), default=0.0)
        to_move = to_move or {name: gap for name, gap in gaps.items() if worst > CLOSED and gap > 1e-3 * worst}
        if not to_move:
            break
        result = replace(result, loops=_moved_anchors(result, best, to_move))
        to_move, solver = set(), LoopSolver(result)
        best, _ = solver.close(best, everything)
    pairs = zip(mechanism.loops, result.loops, strict=True)
    moves = [_move(before, after) for before, after in pairs if before != after]
    if moves:
        warnings.warn(f"{mechanism.name}: anchor 2 moved to the best fit on loops {', '.join(moves)}", stacklevel=3)
    return replace(result, guess=best)


def _move(before, after):
    if before.kind == "distance":
        return f"{before.name!r} by {after.length - before.length:+.3g} m of length"
    turn = before.placement2.rotation.T @ after.placement2.rotation
    move = f"{before.name!r} by {np.linalg.norm(np.subtract(after.xyz2, before.xyz2)):.3g} m"
    return move if before.kind == "point" else f"{move} and {np.linalg.norm(pin.log3(turn)):.3g} rad"


def _moved_anchors(mechanism, q, names):
    data = mechanism.model.createData()
    pin.framesForwardKinematics(mechanism.model, data, q)
    return tuple(_moved_anchor(mechanism.model, data, loop) if loop.name in names else loop for loop in mechanism.loops)


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
