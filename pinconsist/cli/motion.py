"""What replay and plot show: a saved run, or a scene that is simulated first."""

from __future__ import annotations

import logging
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
_log = logging.getLogger(__name__)


def motion(source, scene_of_run, until, require=lambda mech: None):
    """Mechanism, solution and exit code; `require` sees the mechanism before a long run begins.

    The mechanism of a saved general problem, which has no scene, is None.
    """
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
    """Mechanism, None of a general problem, and solution of a saved run."""
    from ..solution import Solution

    sol = Solution.load(file)
    what = _scene_of(sol, file, given)
    if what is None:
        return None, sol
    mech, now = scene.loaded(what, file)
    sizes = sol.q.shape[1], sol.v.shape[1], sol.lam.shape[1]
    if sizes != (mech.nq, mech.nv, mech.nc):
        raise InputError(
            f"{file} is a run of another scene than {what.source}: it has {sizes[0]} numbers in a configuration, "
            f"{sizes[1]} in a velocity and {sizes[2]} multipliers, the scene {mech.nq}, {mech.nv} and {mech.nc}; say "
            "which by --scene"
        )
    _tell_changed(sol, now)
    return mech, sol


def _scene_of(sol, file, given):
    """The scene of a saved run; None of a general problem, which no file of the folder must stand in for."""
    from ..formats.catalogue import is_built_in

    about = (sol.recipe or {}).get("scene")
    if about:
        recorded = scene.Scene.recorded(about, file)
        return replace(recorded, source=given) if given else recorded
    if given:
        return scene.Scene(given)
    if sol.scene and not is_built_in(sol.scene):
        raise InputError(
            f"{file} says of its scene only the name, {sol.scene!r}, as a run does that was made in Python; say where "
            "it is by --scene"
        )
    return scene.Scene(sol.scene) if sol.scene else None


def _tell_changed(sol, now):
    from ..recording.rerun import changed_files

    if changed := changed_files((sol.recipe or {}).get("files", now), now):
        _log.warning(
            "the scene is not as it was when this run was made (%s); energies and forces are those of the "
            "changed scene",
            "; ".join(changed),
        )


def told(mech, sol) -> str:
    """What is shown, in a line."""
    name = "general problem" if mech is None else mech.name
    return f"{name}: t = {sol.t[0]:g} … {sol.t[-1]:g} s, {len(sol.t)} rows; {sol.message}"
