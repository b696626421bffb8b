"""Options of commands that show a motion."""

from __future__ import annotations

from typing import Annotated

import typer

from ..errors import InputError

PANEL = "Page"
Forces = Annotated[
    bool, typer.Option("--forces", help="Draw the force of every loop as an arrow.", rich_help_panel=PANEL)
]
Traces = Annotated[
    list[str] | None,
    typer.Option(
        "--trace", metavar="FRAME", help="Draw the path of this frame; may be given again.", rich_help_panel=PANEL
    ),
]
Speed = Annotated[
    float, typer.Option(metavar="FACTOR", help="2 plays twice as fast, 0.1 in slow motion.", rich_help_panel=PANEL)
]


def require_drawable(mech, traces, speed):
    """Raise InputError before a long run, not after it, for a --trace of no frame or a useless --speed."""
    if not 0 < speed < float("inf"):
        raise InputError(f"--speed {speed}: needs a positive number")
    if traces:
        from ..view.scene import require_frames

        require_frames(mech, traces)


def require_page(html, forces, traces, speed):
    """Raise InputError for options of a page that is not asked for."""
    given = {"--forces": forces, "--trace": traces, "--speed": speed != 1.0}
    without = [name for name, each in given.items() if each]
    if without and not html:
        raise InputError(f"{without[0]} says how the page of --html looks; give --html FILE.html too")
