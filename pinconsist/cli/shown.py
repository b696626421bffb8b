"""Options of commands that show a motion."""

from __future__ import annotations

from math import floor, log10
from typing import Annotated

import typer

from ..errors import InputError

PANEL = "Page"
Forces = Annotated[
    bool,
    typer.Option(
        "--forces", help="Draw forces and moments of loops, and torques of motors, as arrows.", rich_help_panel=PANEL
    ),
]
Traces = Annotated[
    list[str] | None,
    typer.Option(
        "--trace", metavar="FRAME", help="Draw the path of this frame; may be given again.", rich_help_panel=PANEL
    ),
]
Speed = Annotated[
    float | None,
    typer.Option(
        metavar="FACTOR", rich_help_panel=PANEL,
        help="2 plays twice as fast, 0.1 in slow motion. Default: 1; less for what is over in a second.",
    ),
]  # fmt: skip


def pace(speed, sol) -> float:
    """Seconds of motion per second of playing: `speed`, else real time, or less where that would be over at once."""
    length = abs(sol.t[-1] - sol.t[0])
    return speed if speed is not None else 10.0 ** floor(log10(length)) if 0 < length < 1 else 1.0


def require_drawable(mech, traces, speed):
    """Raise InputError before a long run, not after it, for a --trace of no frame or a useless --speed."""
    if speed is not None and not 0 < speed < float("inf"):
        raise InputError(f"--speed {speed}: needs a positive number")
    if traces:
        from ..formats.reading import near

        names = [frame.name for frame in mech.model.frames]
        for name in traces:
            if name not in names:
                raise InputError(f"{mech.name}: no frame {name!r} to trace{near(name, names)}")


def require_page(html, forces, traces, speed):
    """Raise InputError for options of a page that is not asked for."""
    given = {"--forces": forces, "--trace": traces, "--speed": speed is not None}
    without = [name for name, each in given.items() if each]
    if without and not html:
        raise InputError(f"{without[0]} says how the page of --html looks; give --html FILE.html too")
