"""Forces as straight arrows, moments as arrows that turn about their axis: how long they are, and how that is said."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .actions import FORCE, MOMENT, Action
from .commands import Node
from .motion import turn_from
from .shapes import Shape, cylinder, ring

COLORS = {FORCE: 0x6A1B9A, MOMENT: 0x1B5E20}
UNITS = {FORCE: "N", MOMENT: "N·m"}
COMMON = {FORCE: 0.25, MOMENT: 0.08}  # sizes of the scene: length or radius of what is common
LONGEST = {FORCE: 0.5, MOMENT: 0.16}  # the most that is drawn
RADIUS, HEAD = 0.006, 0.05  # of a shaft; length of a head; in sizes of the scene
ARC = 1.5 * np.pi  # of a ring, rad
TUBE, TIP = 0.05, 0.4  # thickness of a ring and length of its head, in its radii
LEAST = 1e-5  # of a scale; three.js cannot invert a transformation of scale 0


@dataclass(frozen=True)
class Scale:
    """How large arrows are: ``metres`` for each N or N·m, none more than ``most``; ``text`` says so to a person."""

    metres: float
    most: float
    text: str


def scale_of(kind: str, actions: list[Action], size: float) -> Scale | None:
    """One scale for all forces, or moments, of a picture; None where there are none.

    Common ones show well by it: the median, on a logarithmic scale, of what each exceeds a quarter of the time. Great
    ones are cut, as of wrong multipliers at the start, near dead centres, or of loops that contradict each other.
    """
    sizes = [action.sizes for action in actions if action.kind == kind]
    largest = max((each.max() for each in sizes), default=0.0)
    if not largest > 1e-12:
        return None
    some = [each[each > 1e-6 * largest] for each in sizes]
    common = np.exp(np.median([np.log(np.percentile(each, 75)) for each in some if each.size]))
    unit = UNITS[kind]
    per_metre, most = _round(common / (COMMON[kind] * size)), LONGEST[kind] * size
    length = 10.0 ** np.floor(np.log10(COMMON[kind] * size))
    what = "m of arrow" if kind == FORCE else "m of radius"
    cut = f", larger ones cut at {most * per_metre:.3g} {unit}" if largest > most * per_metre else ""
    return Scale(1 / per_metre, most, f"{length:g} {what} is {length * per_metre:.3g} {unit}{cut}")


def _round(value: float) -> float:
    """The nearest of 1, 2 and 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(min((1, 2, 5, 10), key=lambda step: abs(np.log(value / (step * power)))) * power)


def arrow(path: str, action: Action, scale: Scale, size: float) -> tuple[list[tuple[Node, list[Shape]]], np.ndarray]:
    """The moving parts of an action's arrow with their shapes; and points around it, shape (m, k, 3)."""
    sizes = action.sizes
    reach = np.minimum(sizes * scale.metres, scale.most)
    along = action.vectors / np.where(sizes > 0, sizes, 1.0)[:, None]
    along[sizes == 0] = (0.0, 1.0, 0.0)
    draw = _straight if action.kind == FORCE else _turning
    return draw(path, action.points, along, reach, size)


def _straight(path, points, along, reach, size):
    """Shaft and head; a short arrow is thinner too."""
    radius, head = RADIUS * size, HEAD * size
    thin = np.minimum(1.0, reach / (2 * head))  # keeps the head at half the arrow, at most
    turns = np.array([turn_from((0, 1, 0), each).coeffs() for each in along])
    necks = points + along * (reach - head * thin)[:, None]
    shaft = np.column_stack((thin, reach - head * thin, thin)).clip(LEAST)
    look = {"color": COLORS[FORCE], "on_top": True}
    pointed = cylinder(0, np.zeros(3), (0.0, head, 0.0), 2.4 * radius, **look)
    pointed.geometry["radiusTop"] = 0.0
    heads = Node(f"{path}/head", np.hstack((necks, turns)), np.repeat(thin[:, None], 3, axis=1).clip(LEAST))
    parts = [
        (
            Node(f"{path}/shaft", np.hstack((points, turns)), shaft),
            [cylinder(0, np.zeros(3), (0.0, 1.0, 0.0), radius, **look)],
        ),
        (heads, [pointed]),
    ]
    return parts, (points + along * reach[:, None])[:, None]


def _turning(path, points, along, reach, size):
    """Three quarters of a ring about the axis with a head at its end, right-handed; the radius is the size."""
    turns = np.array([turn_from((0, 0, 1), each).coeffs() for each in along])
    look = {"color": COLORS[MOMENT], "on_top": True}
    end = np.array([np.cos(ARC), np.sin(ARC), 0.0])
    onward = np.array([-end[1], end[0], 0.0])
    pointed = cylinder(0, end, end + TIP * onward, 2.6 * TUBE, **look)
    pointed.geometry["radiusTop"] = 0.0
    node = Node(f"{path}/turn", np.hstack((points, turns)), np.repeat(reach[:, None], 3, axis=1).clip(LEAST))
    around = points[:, None] + reach[:, None, None] * np.vstack((np.eye(3), -np.eye(3)))
    return [(node, [ring(0, ARC, TUBE, **look), pointed])], around
