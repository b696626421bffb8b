"""Scenes of any size, by name: ``chain_16``, ``n_four_bar_2``; written as a URDF text and the record of a loop file.

Plane x-z, gravity along -z. A rod is slender and uniform, 1 m and 1 kg, and extends along +x of its link frame (a crank
of the four-bars along +z: upright at zero); a positive angle about +y turns +z to +x and +x to -z.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from math import pi, sin
from typing import NamedTuple

from scipy.optimize import brentq

from ..errors import InputError
from ..mechanism.constraints.loop import GROUND, Loop
from .loopfile import LoopFile

MOST = 2000
"""Of dense matrices with several times as many rows, more do not fit into memory."""
RADIUS = 0.02  # m, of a rod
SPAN = 0.6  # of a chain's length: how far its ends are apart
BLUE, ORANGE, DARK, STEEL = "0.16 0.44 0.72 1", "0.93 0.52 0.14 1", "0.20 0.22 0.25 1", "0.55 0.58 0.62 1"
PIN = f'<geometry><cylinder radius="{1.5 * RADIUS}" length="{4 * RADIUS}"/></geometry>'
ACROSS = f"{pi / 2!r} 0 0"  # rpy of a pin
AXIS = (0.0, 1.0, 0.0)


class Scene(NamedTuple):
    """A URDF text, and what a loop file would say of it."""

    urdf: bytes
    record: LoopFile


@dataclass(frozen=True)
class Family:
    """Scenes that differ in a number.

    Attributes
    ----------
    description : str
        One line.
    least : int
        Smallest number.
    build : callable
        ``build(name, n) -> Scene``.
    """

    description: str
    least: int
    build: Callable


def member(name: str) -> Scene | None:
    """The scene of a name such as ``chain_16``, or None where the name has not this form; raises as :func:`found`."""
    known = found(name)
    return known and known[0].build(name, known[1])


def found(name: str) -> tuple[Family, int] | None:
    """The family and the number in a name such as ``chain_16``, or None where the name has not this form.

    Raises
    ------
    InputError
        A number that the family does not have.
    """
    match = re.fullmatch(r"(\w+)_(\d+)", name, re.ASCII)
    if not match or match[1] not in FAMILIES:
        return None
    family, n = FAMILIES[match[1]], int(match[2]) if len(match[2]) < 10 else MOST + 1
    if not family.least <= n <= MOST:
        raise InputError(f"{match[1]}_<n> needs a number from {family.least} to {MOST}, got {match[2]}")
    return family, n


def listed() -> dict[str, str]:
    """The families by the form of their names, with a line of description each."""
    return {f"{name}_<n>": family.description for name, family in FAMILIES.items()}


def _chain(name, n):
    """Rods one after the other, the last pinned to the ground; they hang in the arc of a circle."""
    turn = _arc(n)
    links = [_ground([(0.0, 0.0), (SPAN * n, 0.0)])]
    guess, last = {}, ("ground", 0.0, 0.0)
    for i in range(n):
        links += [_rod(f"rod{i}", (BLUE, ORANGE)[i % 2]), _hinge(f"joint{i}", *last, f"rod{i}")]
        guess[f"joint{i}"] = -turn if i else turn * (n - 1) / 2
        last = (f"rod{i}", 1.0, 0.0)
    end = Loop("end", "hinge", last[0], GROUND, xyz1=(1.0, 0.0, 0.0), xyz2=(SPAN * n, 0.0, 0.0), axis=AXIS)
    return Scene(_robot(name, links), LoopFile(loops=(end,), guess=guess))


def _arc(n) -> float:
    """The angle between neighbours of n chords of length 1 that span SPAN n."""

    def excess(turn):
        return sin(n * turn / 2) / sin(turn / 2) - SPAN * n

    return brentq(excess, 1e-9, 2 * pi / n, xtol=1e-15)


def _n_four_bar(name, n):
    """Upright cranks side by side, level couplers between their ends."""
    links = [_ground([(float(i), 0.0) for i in range(n + 1)])]
    links += [_rod("crank0_bar", BLUE, upright=True), _hinge("crank0", "ground", 0.0, 0.0, "crank0_bar")]
    end, loops = ("crank0_bar", 0.0, 1.0), []
    for i in range(n):
        links += [_rod(f"coupler{i}_bar", ORANGE), _hinge(f"coupler{i}", *end, f"coupler{i}_bar")]
        end = (f"coupler{i}_bar", 1.0, 0.0)
    for i in range(1, n + 1):
        crank = f"crank{i}_bar"
        links += [_rod(crank, BLUE, upright=True), _hinge(f"crank{i}", "ground", float(i), 0.0, crank)]
        ends = {"xyz1": (1.0, 0.0, 0.0), "xyz2": (0.0, 0.0, 1.0)}
        loops.append(Loop(f"B{i}", "hinge", f"coupler{i - 1}_bar", crank, axis=AXIS, **ends))
    return Scene(_robot(name, links), LoopFile(loops=tuple(loops)))


FAMILIES = {
    "chain": Family(f"chain of n rods of 1 m, n ≥ 2, pinned at both ends, {SPAN:g} n m apart", 2, _chain),
    "n_four_bar": Family("n four-bars side by side, n ≥ 1, that pass through singular positions", 1, _n_four_bar),
}


def _robot(name, parts):
    return ("\n".join((f'<robot name="{name}">', *parts, "</robot>"))).encode()


def _ground(pivots):
    shape = f'<geometry><box size="{6 * RADIUS} {6 * RADIUS} {3 * RADIUS}"/></geometry>'
    visuals = "".join(_visual(f"{x!r} 0 {z - 1.5 * RADIUS!r}", "0 0 0", shape, STEEL) for x, z in pivots)
    return f'<link name="ground">{visuals}</link>'


def _rod(name, color, upright=False):
    """m l²/12 across, m r²/2 along."""
    along, across = RADIUS**2 / 2, 1 / 12
    (ixx, izz), middle = ((across, along), "0 0 0.5") if upright else ((along, across), "0.5 0 0")
    size = f"{2 * RADIUS} {RADIUS} 1" if upright else f"1 {RADIUS} {2 * RADIUS}"
    bar = _visual(middle, "0 0 0", f'<geometry><box size="{size}"/></geometry>', color)
    return (
        f'<link name="{name}"><inertial><origin xyz="{middle}"/><mass value="1"/>'
        f'<inertia ixx="{ixx!r}" ixy="0" ixz="0" iyy="{across!r}" iyz="0" izz="{izz!r}"/></inertial>'
        f"{bar}{_visual('0 0 0', ACROSS, PIN, DARK)}</link>"
    )


def _visual(xyz, rpy, shape, color):
    material = f'<material name="{color}"><color rgba="{color}"/></material>'
    return f'<visual><origin xyz="{xyz}" rpy="{rpy}"/>{shape}{material}</visual>'


def _hinge(name, parent, x, z, child):
    axis = " ".join(f"{each:g}" for each in AXIS)
    return (
        f'<joint name="{name}" type="continuous"><origin xyz="{x!r} 0 {z!r}"/><parent link="{parent}"/>'
        f'<child link="{child}"/><axis xyz="{axis}"/></joint>'
    )
