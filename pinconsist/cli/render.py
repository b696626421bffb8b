"""`pinconsist render`."""

from contextlib import contextmanager
from typing import Annotated

import typer

from . import options as given
from . import output, replay
from .options import option
from .run import print_in_a_line, run_of
from .terminal import bar


def render(
    source: given.RunOrScene,
    out: Annotated[str, typer.Argument(
        metavar="FILE", help="A film (.mp4 or .gif), or drawings of a planar mechanism (.svg).")],
    at: Annotated[list[float] | None, option(
        "--at", "SECONDS ...", "Times to draw in an .svg. Default: the start.")] = None,
    scene_of_run: given.SceneOfRun = None,
    until: given.Until = None,
    forces: given.Forces = False,
    traces: given.Traces = None,
    speed: given.Speed = None,
) -> int:  # fmt: skip
    """Make a film of a saved run or a scene, or draw it at given times.

    Example: pinconsist render run.npz run.mp4 --forces
    """
    from ..view import render as painted

    output.require_writable(FILE=out)
    painted.require_file(out, at or ())
    mech, sol, code = run_of(source, scene_of_run, until, replay.requirement(source, traces, speed))
    look = replay.look(sol, forces, traces, speed) | {"at": at or ()}
    with _progress() as watch:
        output.written(out, lambda: painted.render(mech, sol, out, **look, watch=watch))
    print_in_a_line(sol)
    output.print_written(out)
    return code


@contextmanager
def _progress():
    """A function to call after each frame, which moves a bar on a terminal."""
    if not output.on_terminal():
        yield None
        return
    with bar("{task.completed} of {task.total} frames") as shown:
        task = shown.add_task("", total=None)
        yield lambda done, total: shown.update(task, completed=done, total=total)
