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
            raise InputError(f"{option} {text}: {numbers!r} is not a number") from None
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
    """Say on stderr which of the joints named by --at could not stay where they were put."""
    import numpy as np

    for joint, value in wanted.items():
        if not np.allclose(mech.configuration({joint: value}, base=assembly.q), assembly.q, rtol=0, atol=1e-9):
            asked, start = " ".join(f"{each:g}" for each in value), by_joint(mech, assembly.q)[joint]
            print(f"pinconsist: note: the loops do not close with {joint} = {asked}; it is at {start}", file=sys.stderr)


def describe(mech, assembly) -> str:
    """The scene in one line."""
    text = f"{mech.name}: {counted(len(mech.joints), 'joint')}, {counted(len(mech.loops), 'loop')}"
    if mech.loops:
        text += f" of {counted(assembly.rows, 'row')} ({assembly.rank} independent)"
    return f"{text}, mobility {assembly.mobility}"
