"""The run of a command: simulated while its progress is shown, or read from a file; its exit code."""

import logging
from dataclasses import replace
from pathlib import Path

import pinconsist as pc

from ..errors import InputError
from . import output, scene
from .terminal import RunProgress, doing

_log = logging.getLogger(__name__)


def exit_code(sol) -> int:
    """The exit code of a run; its only callback never stops it, so a run that was stopped was interrupted."""
    return {0: output.FINE, 1: output.INTERRUPTED, -1: output.FAILED}[sol.status]


def resume_hint(sol, file) -> str:
    """What `pinconsist resume` will do with a run that was interrupted."""
    if at := sol.recipe["checkpoint"]:
        return f"pinconsist resume {file} continues it from t = {at['t']:g} s, its last checkpoint"
    start = f"{sol.recipe['t_span'][0]:g} s"
    return f"pinconsist resume {file} starts again at t = {start}: without --save-every there are no checkpoints"


def run_of(source, scene_of_run, until, require=lambda mech: None):
    """Mechanism, solution and exit code of a saved run, or of a scene, which is simulated first.

    The mechanism of a saved general problem, which has no scene, is None. `require` is called with the mechanism
    before a long run begins.
    """
    if Path(source).suffix == ".npz":
        if until is not None:
            raise InputError("--until is for scenes; the end of a saved run (.npz) is fixed")
        mech, sol = _saved(source, scene_of_run)
        require(mech)
        return mech, sol, output.FINE
    if scene_of_run:
        raise InputError("--scene names the scene of a saved run (.npz); a scene itself needs none")
    mech = scene.SceneSource(source).load()
    require(mech)
    span = (0.0, mech.duration if until is None else until)
    with RunProgress(*span) as progress:
        sol = pc.simulate(mech, span, callback=progress)
    return mech, sol, exit_code(sol)


def print_in_a_line(sol):
    output.paragraph(
        f"{sol.scene or 'general problem'}: t = {sol.t[0]:g} … {sol.t[-1]:g} s, {len(sol.t)} rows; "
        f"{output.in_options(sol.message)}"
    )


def checked(sol):
    """The certificate of a run; None where Ctrl-C skipped it."""
    again = "again " if exit_code(sol) == output.INTERRUPTED else ""
    try:
        with doing(f"checking (Ctrl-C {again}skips)"):
            return sol.check(error=False if again else None)  # who interrupts does not want another run
    except KeyboardInterrupt:
        return None


def print_run(sol, certificate, seconds):
    """How a run ended and its verdict, a line each, then the details."""
    print_in_a_line(sol)
    if certificate:
        output.verdict(certificate)
    else:
        print("not checked: interrupted")
    _, *details = sol.summary().splitlines()
    print()
    for line in (*details, f"took {seconds:.3g} s"):
        output.paragraph(line, hanging="  ")


def _saved(file, given):
    """Mechanism (None for a general problem) and solution of a saved run."""
    from ..runs import changed_files
    from ..solution import require_mechanism

    sol = pc.Solution.load(file)
    what = _scene_of(sol, file, given)
    if what is None:
        return None, sol
    mech, hashes = scene.loaded(what, file)
    require_mechanism(sol, mech, file, "; name its scene by --scene")
    if changed := changed_files((sol.recipe or {}).get("files", hashes), hashes):
        _log.warning(
            "the scene is not as it was when this run was made (%s); energies and forces are those of the "
            "changed scene",
            "; ".join(changed),
        )
    return mech, sol


def _scene_of(sol, file, given):
    """The scene of a saved run; None for a general problem, also where a file in the folder has its name."""
    from ..formats.catalogue import is_built_in

    about = (sol.recipe or {}).get("scene")
    if about:
        recorded = scene.SceneSource.recorded(about, file)
        return replace(recorded, source=given) if given else recorded
    name = given or sol.scene
    if name and not given and not is_built_in(name):
        raise InputError(
            f"{file} holds only the name of its scene, {name!r}, because the run was made in Python; give the scene "
            "by --scene"
        )
    return scene.SceneSource(name) if name else None
