"""`pinconsist rerun` and `pinconsist resume`."""

from __future__ import annotations

import time
from typing import Annotated

import typer

from . import output
from .motion import SceneOfRun
from .simulate import exit_code, to_be_continued, watched

Run = Annotated[str, typer.Argument(metavar="RUN.npz", help="A saved run.")]


def rerun(run: Run, scene_of_run: SceneOfRun = None, as_json: output.Json = False) -> int:
    """Make a saved run again from what its file says, and compare every number.

    The exit code is 0 if all are the same, bit for bit, and 1 if not. What
    else is not as it was is said: versions of packages, files of the scene.

    Example: pinconsist rerun run.npz
    """
    from ..recording.keep import rerun as again

    with watched(*_span(run)) as progress:
        made = again(run, scene=scene_of_run, callback=progress)
    if as_json:
        sol = made.solution
        about = {"same": made.same, "differences": list(made.differences), "rows": len(sol.t), "message": sol.message}
        output.print_json(about)
    else:
        print(made)
    return output.FINE if made.same else output.FAILED


def resume(run: Run, scene_of_run: SceneOfRun = None, as_json: output.Json = False) -> int:
    """Continue a run that was interrupted, from its last checkpoint.

    Checkpoints are those of simulate --save-every; a run without begins again.
    The numbers are those of the run that was not interrupted, bit for bit. It
    is saved on the way as before, in the same file.

    Example: pinconsist resume run.npz
    """
    from ..recording.keep import resume as go_on
    from ..solution import Solution

    before = Solution.load(run)
    at = (before.recipe or {}).get("checkpoint")
    if before.status != 0 and before.recipe and at is None and not as_json:
        print(f"{run} has no checkpoint (simulate --save-every), so that it begins again", flush=True)
    began = time.perf_counter()
    with watched(*_span(run)) as progress:
        sol = go_on(run, scene=scene_of_run, callback=progress)
    seconds = time.perf_counter() - began
    start = sol.recipe["t_span"][0] if at is None else at["t"]
    if as_json:
        about = {"success": sol.success, "message": sol.message, "from": start, "to": sol.t[-1], "steps": sol.nsteps}
        about |= {"interrupted": exit_code(sol) == output.INTERRUPTED}
        output.print_json(about | {"seconds": seconds, "file": run})
    elif before.status == 0:
        print(f"{run} is complete: {sol.message}")
    else:
        how = f"continued from t = {start:g} s" if at else f"made again from t = {start:g} s"
        print(f"{how}\n{sol.summary()}\ntook {seconds:.3g} s\n\nwritten: {run}")
        if exit_code(sol) == output.INTERRUPTED:
            print(to_be_continued(sol, run))
    return exit_code(sol)


def _span(run):
    """Start and end of a saved run, for the progress bar."""
    from ..recording.recipe import Recipe
    from ..solution import Solution

    return Recipe.read(Solution.load(run), run).t_span
