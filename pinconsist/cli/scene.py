"""Options that say which mechanism is meant and from where it starts, the same for all commands."""

from __future__ import annotations

import re
import sys
from math import pi
from typing import Annotated

import typer

from ..errors import InputError
from ..recording.scene import Scene as Scene
from ..recording.scene import loaded as loaded
from .output import counted

PARTS_OF_PI = re.compile(r"([+-]?)(?:(\d+\.?\d*|\.\d+)\*?)?pi(?:/(\d+\.?\d*))?")
PANEL = "Scene"
START = "Start"
ROUNDING, CLOSE_BY = 1e-9, 1e-2  # rad or m


def _option(*names, panel=PANEL, **more):
    return typer.Option(*names, rich_help_panel=panel, show_default=False, **more)


Source = Annotated[
    str,
    typer.Argument(
        metavar="SCENE",
        help="A built-in scene (see: pinconsist models), a .urdf, .sdf or .xml (MJCF) file, or a folder of a .urdf.",
    ),
]
Loops = Annotated[
    str | None, _option("--loops", metavar="FILE", help="Loop file (YAML). Default: the one beside the .urdf.")
]
Closure = Annotated[
    str | None,
    _option("--closure", metavar="KIND", help="Close every loop by this kind instead, such as point, hinge or frame."),
]
FreeFlyer = Annotated[bool, _option("--free-flyer", help="Let the root link float instead of fixing it to the ground.")]
PackageDirs = Annotated[
    list[str] | None, _option("--package-dir", metavar="DIR", help="Folder to look for meshes in; may be repeated.")
]
Reanchor = Annotated[
    bool, _option("--reanchor", help="Move the anchors of loops that cannot close to where they fit best.")
]
From = Annotated[float, typer.Option("--from", metavar="SECONDS", help="Time at the start.", rich_help_panel=START)]
At = Annotated[
    list[str] | None,
    _option(
        "--at", metavar="JOINT=VALUE ...", panel=START,
        help="Start with these joints here, in rad or m, such as 0.3 or pi/2; the others follow. Several "
        "numbers: joint=0,0,0,1.",
    ),
]  # fmt: skip
WithVelocity = Annotated[
    list[str] | None,
    _option(
        "--with-velocity", metavar="JOINT=VALUE ...", panel=START,
        help="Start with these joint velocities, in rad/s or m/s; the others follow. Default: rest.",
    ),
]  # fmt: skip
Until = Annotated[
    float | None,
    _option(
        "--until", metavar="SECONDS", panel=START,
        help="Time at the end. Default: the scene's own duration, 5 s where it says none.",
    ),
]  # fmt: skip


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
            several = "; several are separated by blanks" if "=" in numbers else ""
            raise InputError(f"{option} {text}: {numbers!r} is not a number{several}") from None
    return values


def _number(text) -> float:
    """A number, also in parts of pi: singular positions are exact or none."""
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


def tell_moved(mech, wanted, assembly):
    """Say on stderr which of the joints named by --at could not stay where they were put.

    Raises
    ------
    InputError
        Each could stay alone, but not all together. Joints that end close by are told only: rounded values that
        choose one of several ways to close the loops are no contradiction.
    """
    from ..mechanism.assembly import assemble

    moved = [joint for joint, value in wanted.items() if not _is_at(mech, assembly.q, joint, value, ROUNDING)]
    if len(wanted) > 1 and any(not _is_at(mech, assembly.q, joint, wanted[joint], CLOSE_BY) for joint in moved):
        alone = {joint: assemble(mech, {joint: wanted[joint]}).q for joint in wanted}
        if all(_is_at(mech, q, joint, wanted[joint], ROUNDING) for joint, q in alone.items()):
            first = next(iter(wanted))
            others = ", ".join(f"{joint} = {_at(mech, alone[first], joint)}" for joint in wanted if joint != first)
            raise InputError(
                f"{mech.name}: the loops do not allow the positions given for {', '.join(wanted)} together: with "
                f"{first} = {_at(mech, alone[first], first)} they close at {others}. Name fewer joints by --at"
            )
    if moved:
        asked = ", ".join(f"{joint} = {' '.join(f'{each:g}' for each in value)}" for joint, value in wanted.items())
        start = ", ".join(f"{joint} = {_at(mech, assembly.q, joint)}" for joint in wanted)
        print(f"pinconsist: note: the loops do not close with {asked}; they do at {start}", file=sys.stderr)


def _is_at(mech, q, joint, value, tolerance) -> bool:
    import numpy as np

    return np.allclose(mech.configuration({joint: value}, base=q), q, rtol=0, atol=tolerance)


def _at(mech, q, joint) -> str:
    numbers = by_joint(mech, q)[joint]
    return " ".join(f"{each:.6g}" for each in (numbers if isinstance(numbers, list) else [numbers]))


def describe(mech, assembly) -> str:
    """The scene in one line."""
    text = f"{mech.name}: {counted(len(mech.joints), 'joint')}, {counted(len(mech.loops), 'loop')}"
    if mech.loops:
        text += f" of {counted(assembly.rows, 'row')} ({assembly.rank} independent)"
    return f"{text}, mobility {assembly.mobility}"
