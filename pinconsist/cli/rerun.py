"""`pinconsist rerun` and `pinconsist resume`."""

import time

import pinconsist as pc

from . import options as given
from . import output
from .run import checked, exit_code, print_run, resume_hint
from .terminal import RunProgress


def rerun(run: given.SavedRun, scene_of_run: given.SceneOfRun = None, as_json: output.Json = False) -> int:
    """Repeat a saved run from the settings in its file, and compare every number.

    The exit code is 0 if all are the same, bit for bit, and 1 if not. Other
    differences are named: versions of packages, files of the scene.

    Example: pinconsist rerun run.npz
    """
    with _progress_of(run) as progress:
        made = pc.rerun(run, scene=scene_of_run, callback=progress)
    if as_json:
        about = {"rows": len(made.solution.t), "message": made.solution.message}
        output.print_json({"same": made.same, "differences": made.differences, **about})
    else:
        print(made)
    return output.FINE if made.same else output.FAILED


def resume(run: given.SavedRun, scene_of_run: given.SceneOfRun = None, as_json: output.Json = False) -> int:
    """Continue a run that was interrupted, from its last checkpoint.

    Checkpoints are those of simulate --save-every; a run without any starts
    again. The numbers are those of an uninterrupted run, bit for bit. It is
    saved at checkpoints as before, in the same file.

    Example: pinconsist resume run.npz
    """
    before = pc.Solution.load(run)
    at = (before.recipe or {}).get("checkpoint")
    if before.status != 0 and before.recipe and at is None and not as_json:
        print(f"{run} has no checkpoint (simulate --save-every), so it starts again", flush=True)
    began = time.perf_counter()
    with _progress_of(run) as progress:
        sol = pc.resume(run, scene=scene_of_run, callback=progress)
    seconds = time.perf_counter() - began
    code, start = exit_code(sol), sol.recipe["t_span"][0] if at is None else at["t"]
    if as_json:
        output.print_json({
            "success": sol.success, "message": sol.message, "from": start, "to": sol.t[-1], "steps": sol.nsteps,
            "interrupted": code == output.INTERRUPTED, "seconds": seconds, "file": run,
        })  # fmt: skip
    elif before.status == 0:
        print(f"{run} is complete: {sol.message}")
    else:
        certificate = checked(sol)
        print(f"{'continued' if at else 'started again'} from t = {start:g} s")
        print_run(sol, certificate, seconds)
        output.print_written(run, before="\n")
        if code == output.INTERRUPTED:
            print(resume_hint(sol, run))
    return code


def _progress_of(run):
    from ..run_file import Recipe

    return RunProgress(*Recipe.read(pc.Solution.load(run), run).t_span)
