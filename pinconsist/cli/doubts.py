"""What looks like a mistake in a scene that closes and can be integrated."""

from __future__ import annotations

import sys
from math import isfinite, remainder, tau

from .output import counted

ROUNDING = 1e-9  # rad or m beyond a limit
MOST_TOLD = 3
TILTS = ("tilt1", "tilt2", "rx", "ry", "rz", "cross")


def doubts(mech, assembly) -> list[str]:
    """A sentence for each: coordinates outside of the limits of their file, loops that leave no motion."""
    found = outside_limits(mech, assembly.q)
    told = found[:MOST_TOLD] + ([f"… and {len(found) - MOST_TOLD} more joints"] if len(found) > MOST_TOLD else [])
    stuck = nothing_moves(mech, assembly)
    return [*told, *([stuck] if stuck else [])]


def tell(sentences):
    """On stderr."""
    for sentence in sentences:
        print(f"pinconsist: warning: {sentence}", file=sys.stderr)


def outside_limits(mech, q) -> list[str]:
    """Joints of one number that stand outside of the limits of their file; whole turns do not count."""
    model, found = mech.model, []
    for i, joint in enumerate(mech.joints, start=1):
        k = model.idx_qs[i]
        low, high, value = model.lowerPositionLimit[k], model.upperPositionLimit[k], q[k]
        if model.nqs[i] != 1 or not low < high or low - ROUNDING <= value <= high + ROUNDING:
            continue
        middle = (low + high) / 2
        if _turns(model.joints[i]) and isfinite(middle) and abs(remainder(value - middle, tau)) <= high - middle:
            continue
        found.append(
            f"{joint} = {value:.6g} is outside the limits of its file, {low:.6g} … {high:.6g}: a wrong anchor or guess?"
        )
    return found


def _turns(joint) -> bool:
    return joint.shortname().startswith("JointModelR")


def nothing_moves(mech, assembly) -> str:
    """What holds a mechanism of mobility 0 that no drive moves; empty for others."""
    import numpy as np

    from ..mechanism.constraints.rank import independent_rows
    from ..mechanism.loop_solver import LoopSolver

    if assembly.mobility or not mech.loops:
        return ""
    solver = LoopSolver(mech)
    if solver.loop_rows.moving:
        return ""
    _, J = solver.rows(assembly.q)
    labels, turns = mech.row_labels, solver.loop_rows.turns
    helping = []
    for loop in mech.loops:
        rows = [row for row in loop.rows if row in TILTS]
        kept = np.array([label not in [(loop.name, row) for row in rows] for label in labels])
        left = mech.nv - len(independent_rows(J[kept], turns[kept]))
        if left:
            helping.append(f"without rows {', '.join(rows)} loop {loop.name!r} would leave {counted(left, 'motion')}")
    told = f"; {'; '.join(helping[:MOST_TOLD])}, as a planar hinge does" if helping else ""
    return (
        f"nothing can move: the loops hold all {mech.nv} velocities, and nothing is driven. Check the axes of loops "
        f"and joints{told}"
    )
