"""`pinconsist plot`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..errors import InputError
from . import output, scene
from .replay import SECONDS, saved_run
from .simulate import exit_code, run


def plot(
    source: Annotated[
        str, typer.Argument(metavar="RUN.npz|SCENE", help="A saved run, or a scene, which is simulated first.")
    ],
    what: Annotated[
        str,
        typer.Option(
            metavar="NAME,NAME,...",
            help="Pictures, one under the other: trajectory, multipliers, drift, energy, steps, phase.",
        ),
    ] = "trajectory,multipliers",
    out: Annotated[
        str | None, typer.Option(metavar="FILE.png", help="The figure (or .pdf, .svg). Default: NAME.png here.")
    ] = None,
    until: Annotated[
        float | None, typer.Option(metavar="SECONDS", help=f"How long a scene is simulated. Default: {SECONDS:g} s.")
    ] = None,
    scene_of_run: Annotated[
        str | None,
        typer.Option("--scene", metavar="SCENE", help="Scene of a saved run, where it is not the one recorded."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")] = False,
) -> int:
    """Draw a saved run, or a scene.

    Example: pinconsist plot run.npz --what multipliers,energy --out run.png
    """
    of_run = Path(source).suffix == ".npz"
    out = out or f"{Path(source).resolve().stem}.png"
    if scene_of_run and not of_run:
        raise InputError("--scene says of which scene a saved run (.npz) is; a scene itself needs none")
    if until is not None and of_run:
        raise InputError("--until says how long a scene is simulated; a saved run (.npz) has its end")
    output.require_writable(out)
    output.require_figure(out)
    from ..view.plots import PICTURES, plot_solution

    names = [name.strip() for name in what.split(",")]
    for name in names:
        if name not in PICTURES:
            raise InputError(f"--what {what}: there is no picture {name!r}; there are {', '.join(PICTURES)}")
    if of_run:
        mech, sol = saved_run(source, scene_of_run)
        code = output.FINE
    else:
        mech = scene.Scene(source).load()
        sol = run(mech, (0.0, SECONDS if until is None else until))
        code = exit_code(sol)
    output.written(out, lambda: plot_solution(sol, out, mech, names))
    if as_json:
        output.print_json({
            "scene": mech.name, "t": [sol.t[0], sol.t[-1]], "rows": len(sol.t), "message": sol.message, "what": names,
            "files": {"out": out},
        })  # fmt: skip
        return code
    print(f"{mech.name}: t = {sol.t[0]:g} … {sol.t[-1]:g} s, {len(sol.t)} rows; {sol.message}")
    for name in names:
        print(f"  {name:12} {PICTURES[name][0]}")
    print(f"written: {out}")
    return code
