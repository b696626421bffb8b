"""The loops' forces as arrows: which force is drawn where, how long, and how that is said."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..mechanism.reactions import reaction
from .commands import Node
from .motion import Run, anchors, in_world, turn_from_y
from .shapes import Shape, cylinder

ARROW = 0x6A1B9A
COMMON, LONGEST = 0.25, 0.5  # lengths in sizes of the scene: of an arrow that a quarter exceeds, and the most drawn
LEAST = 1e-5  # of a scale; three.js cannot invert a transformation of scale 0


@dataclass(frozen=True, eq=False)
class Pull:
    """The force of one loop over the frames."""

    loop: str
    points: np.ndarray  # (m, 3), m, where it acts
    forces: np.ndarray  # (m, 3), N, world axes


@dataclass(frozen=True)
class Scale:
    """How long arrows are: ``metres`` for each newton, none longer than ``most``; ``text`` says so to a person."""

    metres: float
    most: float
    text: str


def pulls(run: Run, poses: np.ndarray) -> list[Pull]:
    """Forces of all loops, each on the loop's body 2, or on its body 1 where the other is the ground.

    Parameters
    ----------
    run : Run
        With multipliers, at the frames' times.
    poses : ndarray, shape (m, njoints, 7)
        World poses of the joints.
    """
    out = []
    for loop in run.mech.anchored_loops:
        joint, place = anchors(run.mech.model, loop)[1]
        points = in_world(poses[:, joint], [place.translation])[:, 0]
        force = reaction(run.mech, loop.name, run.t, run.q, run.lam).force
        out.append(Pull(loop.name, points, force if joint else -force))
    return out


def scale_of(all_pulls: list[Pull], size: float) -> Scale | None:
    """One scale for all arrows of a picture; None where no loop pulls.

    Common forces show well by it. Great ones, as of wrong multipliers at the start or near dead centres, are cut.
    """
    newtons = np.concatenate([np.linalg.norm(pull.forces, axis=1) for pull in all_pulls] or [np.zeros(0)])
    if not newtons.max(initial=0.0) > 1e-12:
        return None
    common = np.percentile(newtons[newtons > 1e-6 * newtons.max()], 75)
    per_metre, most = _round(common / (COMMON * size)), LONGEST * size
    length = 10.0 ** np.floor(np.log10(COMMON * size))
    cut = f", longer ones cut at {most * per_metre:.3g} N" if newtons.max() > most * per_metre else ""
    return Scale(1 / per_metre, most, f"{length:g} m of arrow is {length * per_metre:.3g} N{cut}")


def _round(value: float) -> float:
    """The nearest of 1, 2 and 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(min((1, 2, 5, 10), key=lambda step: abs(np.log(value / (step * power)))) * power)


def arrow(path: str, pull: Pull, scale: Scale, size: float) -> tuple[list[tuple[Node, Shape]], np.ndarray]:
    """Shaft and head with their shapes; and the tips, shape (m, 3). A short arrow is thinner too."""
    newtons = np.linalg.norm(pull.forces, axis=1)
    lengths = np.minimum(newtons * scale.metres, scale.most)
    along = pull.forces / np.where(newtons > 0, newtons, 1.0)[:, None]
    along[newtons == 0] = (0.0, 1.0, 0.0)
    radius, head = 0.006 * size, 0.05 * size
    thin = np.minimum(1.0, lengths / (2 * head))  # keeps the head at half the arrow, at most
    turns = np.array([turn_from_y(each).coeffs() for each in along])
    necks = pull.points + along * (lengths - head * thin)[:, None]
    shaft = np.column_stack((thin, lengths - head * thin, thin)).clip(LEAST)
    pointed = cylinder(0, np.zeros(3), (0.0, head, 0.0), 2.4 * radius, color=ARROW, on_top=True)
    pointed.geometry["radiusTop"] = 0.0
    return [
        (
            Node(f"{path}/shaft", np.hstack((pull.points, turns)), shaft),
            cylinder(0, np.zeros(3), (0.0, 1.0, 0.0), radius, color=ARROW, on_top=True),
        ),
        (Node(f"{path}/head", np.hstack((necks, turns)), np.repeat(thin[:, None], 3, axis=1).clip(LEAST)), pointed),
    ], pull.points + along * lengths[:, None]
