"""`pinconsist render`."""

from typing import Annotated

import typer

from . import options as given
from . import output, replay
from .options import option
from .run import print_in_a_line, run_of
from .terminal import doing


def render(
    source: given.RunOrScene,
    out: Annotated[str, typer.Argument(
        metavar="FILE", help="A film, .mp4 or .gif, or drawings of a planar mechanism, .svg.")],
    at: Annotated[list[float] | None, option(
        "--at", "SECONDS ...", "Times that are drawn, of an .svg. Default: the start.")] = None,
    scene_of_run: given.SceneOfRun = None,
    until: given.Until = None,
    forces: given.Forces = False,
    traces: given.Traces = None,
    speed: given.Speed = None,
) -> int:  # fmt: skip
    """Make a film of a saved run, or a scene, or draw it at some times.

    Example: pinconsist render run.npz run.mp4 --forces
    """
    from ..view.render import require_file

    output.require_writable(FILE=out)
    require_file(out, at or ())
    mech, sol, code = run_of(source, scene_of_run, until, replay.requirement(source, traces, speed))
    with doing(f"drawing {out}"):
        look = replay.look(sol, forces, traces, speed)
        output.written(out, lambda: sol.render(out, mech, **look, at=at or ()))
    print_in_a_line(sol)
    output.print_written(out)
    return code
