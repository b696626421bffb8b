"""The scene of a command: joint values as they are typed, what is printed about it, and what looks like a mistake."""

import logging
import re
import sys
from math import isfinite, pi, remainder, tau

import pinconsist as pc

from ..errors import InputError
from ..run_file import SceneSource as SceneSource
from ..run_file import loaded as loaded
from .output import counted, first

PARTS_OF_PI = re.compile(r"([+-]?)(?:(\d+\.?\d*|\.\d+)\*?)?pi(?:/(\d+\.?\d*))?")
ROUNDING, CLOSE_BY = 1e-9, 1e-2  # rad or m
MOST_SHOWN = 3  # warnings of a kind
TILTS = ("tilt1", "tilt2", "rx", "ry", "rz", "cross")
_log = logging.getLogger(__name__)


def joint_values(texts, option: str) -> dict[str, list[float]]:
    """Joint → numbers from texts like ``crank=0.3``."""
    values = {}
    for text in texts or ():
        joint, sign, numbers = text.partition("=")
        joint = joint.strip()
        if not sign or not joint:
            raise InputError(f"{option} needs joint=value, got {text!r}")
        if joint in values:
            raise InputError(f"{option} names joint {joint!r} twice")
        try:
            values[joint] = [_number(each) for each in numbers.split(",")]
        except ValueError:
            several = "; separate several by spaces" if "=" in numbers else ""
            raise InputError(f"{option} {text}: {numbers!r} is not a number{several}") from None
    return values


def _number(text) -> float:
    """A number, which may be a multiple of pi: only exact values give a singular position."""
    match = PARTS_OF_PI.fullmatch(text.replace(" ", ""))
    if not match:
        return float(text)
    sign, times, over = match.groups()
    if over and float(over) == 0.0:
        raise ValueError(text)
    return float(f"{sign}1") * float(times or 1) * pi / float(over or 1)


def by_joint(mech, vector, *, velocity=False) -> dict:
    """Joint → its number, or list of numbers, in a configuration or a velocity."""
    starts, sizes = (mech.model.idx_vs, mech.model.nvs) if velocity else (mech.model.idx_qs, mech.model.nqs)
    result = {}
    for j, joint in enumerate(mech.joints, start=1):
        part = [float(value) for value in vector[starts[j] : starts[j] + sizes[j]]]
        result[joint] = part[0] if len(part) == 1 else part
    return result


def describe(mech, assembly) -> str:
    """The scene in one line."""
    text = f"{mech.name}: {counted(len(mech.joints), 'joint')}, {counted(len(mech.loops), 'loop')}"
    if mech.loops:
        text += f" of {counted(assembly.rows, 'row')} ({assembly.rank} independent)"
    return f"{text}, mobility {assembly.mobility}"


def report_moved(mech, wanted, assembly):
    """Print on stderr where the joints given by --at are, if they could not stay where they were put.

    InputError if each position is possible, but not all together. Joints that end close by are only reported: rounded
    values that choose one of several ways to close the loops do not contradict each other.
    """

    def is_at(q, joint, tolerance):
        return all(abs(mech.configuration({joint: wanted[joint]}, base=q) - q) <= tolerance)

    def positions(configurations):
        return ", ".join(f"{joint} = {text(by_joint(mech, q)[joint], 6)}" for joint, q in configurations.items())

    moved = [joint for joint in wanted if not is_at(assembly.q, joint, ROUNDING)]
    if len(wanted) > 1 and not all(is_at(assembly.q, joint, CLOSE_BY) for joint in moved):
        alone = {joint: pc.assemble(mech, {joint: wanted[joint]}).q for joint in wanted}
        if all(is_at(q, joint, ROUNDING) for joint, q in alone.items()):
            first, *others = wanted
            q = alone[first]
            raise InputError(
                f"{mech.name}: the loops do not allow the positions given for {', '.join(wanted)} together: with "
                f"{positions({first: q})} they close at {positions(dict.fromkeys(others, q))}. Name fewer joints by "
                "--at"
            )
    if moved:
        asked = ", ".join(f"{joint} = {text(value, 6)}" for joint, value in wanted.items())
        start = positions(dict.fromkeys(wanted, assembly.q))
        print(f"pinconsist: note: the loops do not close with {asked}; they do at {start}", file=sys.stderr)


def text(value, digits=4) -> str:
    """A number, or several with spaces between them."""
    return " ".join(f"{each:.{digits}g}" for each in (value if hasattr(value, "__len__") else [value]))


def scene_warnings(mech, assembly) -> list[str]:
    """What looks like a mistake in a scene that closes: a sentence for each."""
    return first(_outside_limits(mech, assembly.q), MOST_SHOWN, "… and {} more joints") + _immobile(mech, assembly)


def log_warnings(sentences):
    """Log what `scene_warnings` returned."""
    for sentence in sentences:
        _log.warning("%s", sentence)


def _outside_limits(mech, q) -> list[str]:
    """Joints with one coordinate that is outside the limits of their file; whole turns do not count."""
    model, found = mech.model, []
    for i, joint in enumerate(mech.joints, start=1):
        k = model.idx_qs[i]
        low, high, value = model.lowerPositionLimit[k], model.upperPositionLimit[k], q[k]
        if model.nqs[i] != 1 or not low < high or low - ROUNDING <= value <= high + ROUNDING:
            continue
        middle, turns = (low + high) / 2, model.joints[i].shortname().startswith("JointModelR")
        if turns and isfinite(middle) and abs(remainder(value - middle, tau)) <= high - middle:
            continue
        found.append(
            f"{joint} = {value:.6g} is outside the limits of its file, {low:.6g} … {high:.6g}: a wrong anchor or guess?"
        )
    return found


def _immobile(mech, assembly) -> list[str]:
    """A sentence about a mechanism of mobility 0 that no drive moves, and the rows that hold it."""
    import numpy as np

    from ..mechanism.closing import LoopSolver
    from ..mechanism.rank import independent_rows

    if assembly.mobility or not mech.loops:
        return []
    solver = LoopSolver(mech)
    if solver.loop_rows.moving:
        return []
    _, J = solver.rows(assembly.q)
    helping = []
    for loop in mech.loops:
        rows = [row for row in loop.rows if row in TILTS]
        kept = np.array([of != loop.name or row not in rows for of, row in mech.row_labels])
        if left := mech.nv - len(independent_rows(J[kept], solver.loop_rows.turns[kept])):
            helping.append(f"without rows {', '.join(rows)} loop {loop.name!r} would leave {counted(left, 'motion')}")
    advice = f"; {'; '.join(helping[:MOST_SHOWN])}, as a planar hinge does" if helping else ""
    return [
        f"nothing can move: the loops hold all {mech.nv} velocities, and nothing is driven. Check the axes of loops "
        f"and joints{advice}"
    ]
