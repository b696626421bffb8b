"""What replay and plot show: a saved run, or a scene that is simulated first."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from ..errors import InputError
from . import output, scene
from .simulate import exit_code, run

Source = Annotated[
    str, typer.Argument(metavar="RUN.npz|SCENE", help="A saved run, or a scene, which is simulated first.")
]
SceneOfRun = Annotated[
    str | None,
    typer.Option("--scene", metavar="SCENE", help="Scene of a saved run, where it is not the one recorded."),
]


def motion(source, scene_of_run, until, require=lambda mech: None):
    """Mechanism, solution and exit code; `require` sees the mechanism before a long run begins."""
    if Path(source).suffix == ".npz":
        if until is not None:
            raise InputError("--until says how long a scene is simulated; a saved run (.npz) has its end")
        mech, sol = saved_run(source, scene_of_run)
        require(mech)
        return mech, sol, output.FINE
    if scene_of_run:
        raise InputError("--scene says of which scene a saved run (.npz) is; a scene itself needs none")
    mech = scene.Scene(source).load()
    require(mech)
    sol = run(mech, (0.0, mech.duration if until is None else until))
    return mech, sol, exit_code(sol)


def saved_run(file, given):
    """Mechanism and solution of a saved run."""
    from ..solution import Solution

    sol = Solution.load(file)
    about = (sol.recipe or {}).get("scene")
    what = scene.Scene.recorded(about, file) if about else scene.Scene(sol.scene)
    if given:
        what = replace(what, source=given)
    mech, _ = scene.loaded(what, file)
    if sol.q.shape[1] != mech.nq:
        raise InputError(
            f"{file} is a run of another scene than {what.source}: it has {sol.q.shape[1]} numbers in a configuration, "
            f"the scene {mech.nq}; say which by --scene"
        )
    return mech, sol


def told(mech, sol) -> str:
    """What is shown, in a line."""
    return f"{mech.name}: t = {sol.t[0]:g} … {sol.t[-1]:g} s, {len(sol.t)} rows; {sol.message}"
