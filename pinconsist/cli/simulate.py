"""`pinconsist simulate`, `rerun` and `resume`: the commands that run a simulation."""

import time
from pathlib import Path
from typing import Annotated

import pinconsist as pc

from ..errors import InputError, SavingError
from ..run.interrupts import deferred
from . import output, scene
from .scene import METHOD, RESULTS, Count, Number, Text, Texts, look, option, present, require_drawable, require_page


@scene.loads_scene
def simulate(
    source: scene.Scene,
    start: scene.From = 0.0,
    until: scene.Until = None,
    with_velocity: scene.WithVelocity = None,
    control: scene.Control = None,
    step: scene.Step = None,
    order: Annotated[Count, option(
        "--order", "K", "Radau: 1, 3, 5, 9 or 13 (default: variable). BDF: maximum order, 1 to 5 (default 5); with "
        "--step the constant order, 1 to 6.", METHOD)] = None,
    method: Annotated[Text, option(
        "--method", "NAME", "Radau, BDF or ImplicitEuler. Default: Radau; BDF for more than 32 degrees of freedom.",
        METHOD)] = None,
    rtol: scene.Rtol = 1e-6,
    atol: scene.Atol = 1e-8,
    max_step: Annotated[Number, option("--max-step", "SECONDS", "Largest variable step.", METHOD)] = None,
    max_steps: scene.MaxSteps = None,
    consistency: Annotated[str, option(
        "--consistency", "MODE", "every-step: accurate forces throughout. initial: only the initial velocities are "
        "changed (needs --step). exact: plain BDF, whose first forces are wrong.", METHOD)] = "every-step",
    out: Annotated[Text, option("--out", "FILE.npz", "Save the run.", RESULTS)] = None,
    save_every: Annotated[Number, option(
        "--save-every", "SECONDS", "Also save the run at these intervals of simulated time; pinconsist resume "
        "continues from there.", RESULTS)] = None,
    html: Annotated[Text, option("--html", "FILE.html", "Write a page that plays the run.", RESULTS)] = None,
    forces: scene.Forces = False,
    traces: scene.Traces = None,
    speed: scene.Speed = None,
    plot: Annotated[Text, option("--plot", "FILE.png", "Plot the run over time (or .pdf, .svg).", RESULTS)] = None,
    table: Annotated[Text, option(
        "--csv", "FILE.csv", "Write positions, velocities, accelerations and multipliers, by name, with units.",
        RESULTS)] = None,
    csv_forces: Annotated[Texts, option(
        "--csv-force", "NAME", "Additional columns of --csv: the force of this loop, joint or force of the scene (in "
        "quotes), in world axes; may be repeated.", RESULTS)] = None,
    every: Annotated[Number, option(
        "--every", "SECONDS", "Rows of --csv at equally spaced times, as accurate as the run. Default: every step.",
        RESULTS)] = None,
    as_json: Annotated[bool, option("--json", None, "Print one JSON object instead.", RESULTS)] = False,
) -> int:  # fmt: skip
    """Simulate a scene: close its loops, integrate, and certify the result.

    Example: pinconsist simulate crank_rocker --with-velocity crank=12 --until 2 --out run.npz --html run.html
    """
    out = _run_file(out, save_every)
    output.require_writable(out=out, html=html, csv=table, figure=plot)
    _require_table(table, csv_forces, every)
    require_page(html, forces, traces, speed)
    from ..run.checkpoints import Recipe
    from ..run.results import require_columns

    q0, v0 = source.at, scene.joint_values(with_velocity, "--with-velocity")
    mech, hashes = source.load_with_hashes()
    require_drawable(source.source, traces, speed, mech)
    require_columns(mech, csv_forces or ())
    until = start + mech.duration if until is None else until
    commands = scene.commands_of(control)
    if commands:
        mech.with_control(commands)  # raises an error for unknown names before the run
    assembly = scene.assembled(mech, q0, v0, start)
    scene.scene_warnings(mech, assembly)
    if not as_json:
        print(scene.describe(mech, assembly) + "\n")
    settings = {
        "step": step, "rtol": rtol, "atol": atol, "consistency": consistency,
        **present(method=method, order=order, max_step=max_step, max_steps=max_steps, control=commands or None),
    }  # fmt: skip
    where = source.record(out or "run.npz")
    recipe = Recipe.of(where, hashes, mech, (start, until), q0 or None, v0 or None, (), settings, save_every)
    sol, certificate, seconds = _carried_out(recipe, mech, out)
    with deferred(impatient=False):  # another Ctrl-C takes effect after the files are written and listed
        try:
            if html:
                _written(html, sol, out, lambda: pc.export_html(mech, sol, html, **look(sol, forces, traces, speed)))
            if plot:
                _written(plot, sol, out, lambda: sol.plot(file=plot, mechanism=mech))
            if table:
                _written(table, sol, out, lambda: _rows(sol, every).to_csv(table, mech, forces=csv_forces or ()))
        finally:  # after the warnings of what was written
            if not as_json:
                print_run(sol, certificate, seconds)
        if as_json:
            files = {"out": out, "html": html, "plot": plot, "csv": table}
            output.print_json(_report(mech, assembly, sol, certificate, seconds, files))
        else:
            output.print_written(out, html, plot, table, before="\n")
            if out and exit_code(sol) == output.INTERRUPTED:
                print(resume_hint(sol, out))
    return exit_code(sol) if certificate else output.INTERRUPTED


def _run_file(out, save_every):
    """The file of the run, or None; InputError for another suffix, and for intervals without a file."""
    if out and not Path(out).suffix:
        out = str(Path(out).with_suffix(".npz"))
    if out and Path(out).suffix != ".npz":
        raise InputError(f"--out {out}: a run is saved as .npz")
    if save_every is not None and not out:
        raise InputError("--save-every needs a file for the run; add --out FILE.npz")
    return out


def _require_table(table, csv_forces, every) -> None:
    """InputError for options of a table without one, and for impossible times."""
    if (csv_forces or every is not None) and not table:
        raise InputError(f"--{'csv-force' if csv_forces else 'every'} is for the table; add --csv FILE.csv")
    if every is not None and not 0.0 < every < float("inf"):
        raise InputError(f"--every must be a time above 0 s, got {every:g}")


def _carried_out(recipe, mech, out):
    """The run, its certificate, or None if Ctrl-C skipped it, and the seconds that the run took."""
    from ..run.checkpoints import carry_out, saved

    began = time.perf_counter()
    with output.RunProgress(*recipe.t_span) as progress:  # the run is saved before anything else can go wrong
        sol = carry_out(recipe, mech, out, callback=progress)
    seconds = time.perf_counter() - began
    certificate = checked(sol)
    if certificate and out:
        saved(sol, out)
    return sol, certificate, seconds


def _rows(sol, every):
    """The solution at even times; as it is if there is no step of time."""
    if every is None:
        return sol
    start, end = float(sol.t[0]), float(sol.t[-1])
    count = int(abs(end - start) / every * (1.0 + 1e-12))  # the last time is there if the step leads to it
    step = every if end >= start else -every
    times = [start + k * step for k in range(count + 1)]
    return sol.at([*times[:-1], min(times[-1], end) if step > 0 else max(times[-1], end)])


def _written(file, sol, out, write):
    """Call `write`, which writes `file`; if that fails, a run that is not saved yet is not lost."""
    try:
        with output.doing(f"writing {file}"):
            output.written(file, write)
    except InputError as error:
        if out:
            raise
        raise SavingError(str(error), solution=sol) from error


def _report(mech, assembly, sol, certificate, seconds, files) -> dict:
    from ..mechanism.names import by_joint
    from ..run.certificate import plain

    judged = ("verdict", "ok", "concerns", "not_judged")
    return {
        "scene": {
            "name": mech.name, "joints": len(mech.joints), "nq": mech.nq, "nv": mech.nv,
            "loops": [loop.name for loop in mech.loops], "rows": assembly.rows, "rank": assembly.rank,
            "mobility": assembly.mobility,
        },
        "run": {
            "success": sol.success, "interrupted": exit_code(sol) == output.INTERRUPTED, "message": sol.message,
            "t": [sol.t[0], sol.t[-1]], "steps": sol.nsteps, "rejected": sol.rejected, "nfev": sol.nfev,
            "njev": sol.njev, "nlu": sol.nlu, "seconds": seconds, "method": sol.method,
        },
        "certificate": certificate and {name: getattr(certificate, name) for name in judged} | plain(certificate),
        "end": {"q": by_joint(mech, sol.q[-1]), "v": by_joint(mech, sol.v[-1])},
        "files": files,
    }  # fmt: skip


def rerun(run: scene.SavedRun, scene_of_run: scene.SceneOfRun = None, as_json: output.Json = False) -> int:
    """Repeat a saved run from the settings in its file, and compare every number.

    The exit code is 0 if all are the same, bit for bit, and 1 if not. Different
    versions of packages and changed files of the scene are listed.

    Example: pinconsist rerun run.npz
    """
    with _progress_of(pc.Solution.load(run), run) as progress:
        made = pc.rerun(run, scene=scene_of_run, callback=progress)
    if as_json:
        about = {"rows": len(made.solution.t), "message": made.solution.message}
        output.print_json({"same": made.same, "differences": made.differences, **about})
    else:
        print(made)
    return output.FINE if made.same else output.FAILED


def resume(run: scene.SavedRun, scene_of_run: scene.SceneOfRun = None, as_json: output.Json = False) -> int:
    """Continue an interrupted run from its last checkpoint.

    Checkpoints are made by simulate --save-every; a run without any starts
    again. The numbers are those of an uninterrupted run, bit for bit. The run is
    saved at checkpoints as before, in the same file.

    Example: pinconsist resume run.npz
    """
    from ..run.checkpoints import saved

    before = pc.Solution.load(run)
    at = (before.recipe or {}).get("checkpoint")
    if before.status != 0 and before.recipe and at is None and not as_json:
        print(f"{run} has no checkpoint (simulate --save-every), so it starts again", flush=True)
    began = time.perf_counter()
    with _progress_of(before, run) as progress:
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
        if certificate:
            saved(sol, run)
        print(f"{'continued' if at else 'started again'} from t = {start:g} s")
        print_run(sol, certificate, seconds)
        output.print_written(run, before="\n")
        if code == output.INTERRUPTED:
            print(resume_hint(sol, run))
    return code


def _progress_of(sol, file):
    from ..run.checkpoints import Recipe

    return output.RunProgress(*Recipe.read(sol, file).t_span)


def exit_code(sol) -> int:
    """The exit code of a run; the only callback never stops it, so a stopped run was interrupted."""
    return {0: output.FINE, 1: output.INTERRUPTED, -1: output.FAILED}[sol.status]


def resume_hint(sol, file) -> str:
    if at := sol.recipe["checkpoint"]:
        return f"pinconsist resume {file} continues it from t = {at['t']:g} s, its last checkpoint"
    start = f"{sol.recipe['t_span'][0]:g} s"
    return f"pinconsist resume {file} starts again at t = {start}: without --save-every there are no checkpoints"


def print_in_a_line(sol):
    output.paragraph(
        f"{sol.scene or 'general problem'}: t = {sol.t[0]:g} … {sol.t[-1]:g} s, {len(sol.t)} rows; "
        f"{output.in_options(sol.message)}"
    )


def checked(sol):
    """The certificate of a run; None if Ctrl-C skipped it."""
    again = "again " if exit_code(sol) == output.INTERRUPTED else ""
    try:
        with output.doing(f"checking (Ctrl-C {again}skips)"):
            return sol.check(error=False if again else None)  # after an interrupt, no second run is made
    except KeyboardInterrupt:
        return None


def print_run(sol, certificate, seconds):
    """Print how a run ended and its verdict, a line each, then the details."""
    print_in_a_line(sol)
    if certificate:
        output.verdict(certificate)
    else:
        print("not checked: interrupted")
    _, *details = sol.summary().splitlines()
    print()
    for line in (*details, f"took {seconds:.3g} s"):
        output.paragraph(line, hanging="  ")
