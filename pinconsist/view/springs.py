"""Springs between two points, as coils that stretch with them."""

from __future__ import annotations

import numpy as np

from ..mechanism.forces import SpringDamper
from ..mechanism.mechanism import Mechanism
from .commands import Node
from .motion import bar_poses, in_world
from .shapes import Shape, buffer

COLOR = 0x5D4037
TURNS, END = 9, 0.12  # of a coil; share of its length that is straight, at each end
WIDE, WIRE = 0.018, 0.003  # radius of a coil and of its wire, in sizes of the scene
SEGMENTS, SIDES = 16, 6  # of a turn, and of the wire's section
LEAST = 1e-5  # m; three.js cannot invert a transformation of scale 0


def springs(mech: Mechanism, poses: np.ndarray, size: float, path: str) -> list[tuple[Node, Shape, np.ndarray]]:
    """Each spring of a mechanism: what moves, its coil, and its two ends over the motion, shape (m, 2, 3).

    Parameters
    ----------
    mech : Mechanism
    poses : ndarray, shape (m, njoints, 7)
        World poses of the joints.
    size : float
        Size of the scene, m.
    path : str
        Below which the nodes stand.
    """
    out = []
    for number, spring in enumerate(each for each in mech.forces if isinstance(each, SpringDamper)):
        ends = []
        for name, xyz in ((spring.frame1, spring.xyz1), (spring.frame2, spring.xyz2)):
            frame = mech.model.frames[mech.model.getFrameId(name)]
            ends.append(in_world(poses[:, frame.parentJoint], [frame.placement.act(np.array(xyz))])[:, 0])
        lengths = np.linalg.norm(ends[1] - ends[0], axis=1)
        stretch = np.ones((len(poses), 3))
        stretch[:, 1] = lengths.clip(LEAST)
        node = Node(f"{path}/springs/{number + 1}", bar_poses(*ends), stretch)
        out.append((node, _coil(max(lengths.mean(), LEAST), size), np.stack(ends, axis=1)))
    return out


def _coil(length: float, size: float) -> Shape:
    """A coil of length 1 along y, about its middle; its wire is round where it is stretched to `length`."""
    share = np.concatenate(([0.0], np.linspace(END, 1 - END, TURNS * SEGMENTS + 1), [1.0]))
    coiled = ((share - END) / (1 - 2 * END)).clip(0, 1)
    angle = 2 * np.pi * TURNS * coiled
    outward = np.column_stack((np.cos(angle), np.zeros_like(angle), np.sin(angle)))
    reach = WIDE * size * (2 * TURNS * np.minimum(coiled, 1 - coiled)).clip(0, 1)  # full after half a turn
    line = reach[:, None] * outward + np.outer(length * (share - 0.5), (0, 1, 0))
    across = np.cross(np.gradient(line, axis=0), outward)
    across /= np.linalg.norm(across, axis=1)[:, None]
    section = 2 * np.pi * np.arange(SIDES) / SIDES
    skin = np.cos(section)[:, None] * outward[:, None] + np.sin(section)[:, None] * across[:, None]
    points = (line[:, None] + WIRE * size * skin).reshape(-1, 3) / (1.0, length, 1.0)
    here = np.arange((len(line) - 1) * SIDES).reshape(-1, SIDES)
    beside = np.roll(here, -1, axis=1)
    corners = np.stack((here, beside, here + SIDES, beside, beside + SIDES, here + SIDES), axis=-1)
    return Shape(0, buffer(points, corners.reshape(-1, 3)), bounds=points, color=COLOR)
