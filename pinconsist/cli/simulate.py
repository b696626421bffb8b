"""`pinconsist simulate`."""

import time
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import pinconsist as pc

from ..errors import InputError, SavingError
from ..interrupts import deferred
from . import options as given
from . import output, replay, scene
from .options import METHOD, RESULTS, Count, Number, Text, option, present
from .run import checked, exit_code, print_run, resume_hint
from .terminal import RunProgress, doing


@scene.loads_scene
def simulate(
    source: given.Scene,
    start: given.From = 0.0,
    until: given.Until = None,
    with_velocity: given.WithVelocity = None,
    control: given.Control = None,
    step: given.Step = None,
    order: Annotated[Count, option(
        "--order", "K", "BDF: highest order, 1 to 5 (default 5); with --step the order throughout, 1 to 6. Radau: "
        "the order, 1, 3, 5, 9 or 13 (default: it chooses).", METHOD)] = None,
    method: Annotated[str, option("--method", "NAME", "BDF, Radau or ImplicitEuler.", METHOD)] = "BDF",
    rtol: given.Rtol = 1e-6,
    atol: given.Atol = 1e-8,
    max_step: Annotated[Number, option("--max-step", "SECONDS", "Largest variable step.", METHOD)] = None,
    max_steps: given.MaxSteps = None,
    consistency: Annotated[str, option(
        "--consistency", "MODE", "every-step: forces right throughout. initial: only the initial velocities are "
        "changed (needs --step). exact: plain BDF, whose first forces are wrong.", METHOD)] = "every-step",
    out: Annotated[Text, option("--out", "FILE.npz", "Save the run.", RESULTS)] = None,
    save_every: Annotated[Number, option(
        "--save-every", "SECONDS", "Also save the run after each such interval of simulated time; pinconsist resume "
        "continues from there.", RESULTS)] = None,
    html: Annotated[Text, option("--html", "FILE.html", "Write a page that plays it.", RESULTS)] = None,
    forces: given.Forces = False,
    traces: given.Traces = None,
    speed: given.Speed = None,
    plot: Annotated[Text, option("--plot", "FILE.png", "Draw it over time (or .pdf, .svg).", RESULTS)] = None,
    table: Annotated[Text, option(
        "--csv", "FILE.csv", "Write positions, velocities, accelerations and multipliers, by name, with units.",
        RESULTS)] = None,
    as_json: Annotated[bool, option("--json", None, "Print one JSON object instead.", RESULTS)] = False,
) -> int:  # fmt: skip
    """Simulate a scene: close its loops, integrate, and certify the result.

    Example: pinconsist simulate crank_rocker --with-velocity crank=12 --until 2 --out run.npz --html run.html
    """
    out = out and str(Path(out).with_suffix(".npz") if not Path(out).suffix else out)
    if out and Path(out).suffix != ".npz":
        raise InputError(f"--out {out}: a run is saved as .npz")
    if save_every is not None and not out:
        raise InputError("--save-every sets when the run is saved; give --out FILE.npz too")
    output.require_writable(out=out, html=html, csv=table, figure=plot)
    replay.require_page(html, forces, traces, speed)
    from ..checkpoints import carry_out
    from ..run_file import recipe_of

    q0, v0 = source.at, scene.joint_values(with_velocity, "--with-velocity")
    mech, hashes = source.load_with_hashes()
    replay.require_drawable(source.source, traces, speed, mech)
    until = start + mech.duration if until is None else until
    commands = scene.commands_of(control)
    if commands:
        mech.with_control(commands)  # refuses unknown ones before the run
    assembly = scene.assembled(mech, q0, v0, start)
    scene.log_warnings(scene.scene_warnings(mech, assembly))
    if not as_json:
        print(scene.describe(mech, assembly) + "\n")
    settings = {
        "method": method, "step": step, "rtol": rtol, "atol": atol, "consistency": consistency,
        **present(max_order=order, max_step=max_step, max_steps=max_steps, control=commands or None),
    }  # fmt: skip
    where = source.record(out or "run.npz")
    recipe = recipe_of(where, hashes, mech, (start, until), q0 or None, v0 or None, (), settings, save_every)
    began = time.perf_counter()
    with RunProgress(start, until) as progress:  # what was reached is saved before anything else can go wrong
        sol = carry_out(recipe, mech, out, callback=progress)
    seconds = time.perf_counter() - began
    certificate = checked(sol)
    with deferred(impatient=False):  # a further Ctrl-C takes effect when the files are written and named
        try:
            if html:
                look = replay.look(sol, forces, traces, speed)
                _written(html, sol, out, lambda: pc.export_html(mech, sol, html, **look))
            if plot:
                _written(plot, sol, out, lambda: pc.plot_solution(sol, plot, mech))
            if table:
                _written(table, sol, out, lambda: sol.to_csv(table, mech))
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


def _written(file, sol, out, write):
    """Call `write`, which writes `file`; if that fails, a run that is in no file yet is not lost."""
    try:
        with doing(f"writing {file}"):
            output.written(file, write)
    except InputError as error:
        if out:
            raise
        raise SavingError(str(error), solution=sol) from error


def _report(mech, assembly, sol, certificate, seconds, files) -> dict:
    from ..mechanism.names import by_joint

    names = ("verdict", "ok", "position", "position_at", "velocity", "force", "force_first", "energy_error")
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
        "certificate": certificate and {name: getattr(certificate, name) for name in names}
        | {"beyond_limits": [asdict(each) for each in certificate.beyond_limits]}
        | {"error": certificate.error and asdict(certificate.error)},
        "end": {"q": by_joint(mech, sol.q[-1]), "v": by_joint(mech, sol.v[-1])},
        "files": files,
    }  # fmt: skip
