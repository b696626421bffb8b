"""`pinconsist simulate`."""

from __future__ import annotations

import time
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated

import typer

from ..errors import InputError, SavingError
from ..interrupts import deferred
from . import doubts, output, scene, shown
from .progress import Progress, doing

METHOD, FILES = "Method", "Results"


def simulate(
    source: scene.Source,
    loops: scene.Loops = None,
    closure: scene.Closure = None,
    free_flyer: scene.FreeFlyer = False,
    package_dirs: scene.PackageDirs = None,
    reanchor: scene.Reanchor = False,
    start: scene.From = 0.0,
    until: scene.Until = None,
    at: scene.At = None,
    with_velocity: scene.WithVelocity = None,
    step: Annotated[
        float | None,
        typer.Option(metavar="SECONDS", help="Fixed step. Default: step and order vary.", rich_help_panel=METHOD),
    ] = None,
    order: Annotated[
        int | None,
        typer.Option(
            metavar="K", help="Highest order, 1 to 5 (default 5); with --step the order throughout, 1 to 6.",
            rich_help_panel=METHOD,
        ),
    ] = None,
    method: Annotated[str, typer.Option(metavar="NAME", help="BDF or ImplicitEuler.", rich_help_panel=METHOD)] = "BDF",
    rtol: Annotated[
        float, typer.Option(metavar="NUMBER", help="Relative tolerance of each step.", rich_help_panel=METHOD)
    ] = 1e-6,
    atol: Annotated[
        float, typer.Option(metavar="NUMBER", help="Absolute tolerance of each step.", rich_help_panel=METHOD)
    ] = 1e-8,
    max_step: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="Largest varying step.", rich_help_panel=METHOD)
    ] = None,
    max_steps: Annotated[
        int | None, typer.Option(metavar="N", help="Give up after so many steps.", rich_help_panel=METHOD)
    ] = None,
    consistency: Annotated[
        str,
        typer.Option(
            metavar="MODE", rich_help_panel=METHOD,
            help="every-step: forces right throughout. initial: only the initial velocities are changed (needs "
            "--step). exact: plain BDF, whose first forces are wrong.",
        ),
    ] = "every-step",
    out: Annotated[
        str | None, typer.Option(metavar="FILE.npz", help="Save the run.", rich_help_panel=FILES)
    ] = None,
    save_every: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS", rich_help_panel=FILES,
            help="Save the run at every so many simulated seconds too; from there pinconsist resume continues it.",
        ),
    ] = None,
    html: Annotated[
        str | None, typer.Option(metavar="FILE.html", help="Write a page that plays it.", rich_help_panel=FILES)
    ] = None,
    forces: shown.Forces = False,
    traces: shown.Traces = None,
    speed: shown.Speed = None,
    plot: Annotated[
        str | None, typer.Option(metavar="FILE.png", help="Draw it over time (or .pdf, .svg).", rich_help_panel=FILES)
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object instead.", rich_help_panel=FILES)
    ] = False,
) -> int:  # fmt: skip
    """Simulate a scene: close its loops, integrate, and certify what came out.

    Example: pinconsist simulate crank_rocker --with-velocity crank=12 --until 2 --out run.npz --html run.html
    """
    out = out and str(Path(out).with_suffix(".npz") if not Path(out).suffix else out)
    if out and Path(out).suffix != ".npz":
        raise InputError(f"--out {out}: a run is saved as .npz")
    files = [file for file in (out, html, plot) if file]
    if len({Path(file).absolute() for file in files}) < len(files):
        raise InputError("two of --out, --html and --plot name the same file")
    if save_every is not None and not out:
        raise InputError("--save-every says when the run is saved; give --out FILE.npz too")
    output.require_writable(*files)
    output.require_figure(plot)
    shown.require_page(html, forces, traces, speed)
    from ..mechanism.assembly import assemble
    from ..recording.recipe import recipe_of
    from ..recording.stretches import carried_out

    q0 = scene.joint_values(at, "--at")
    v0 = scene.joint_values(with_velocity, "--with-velocity")
    what = scene.Scene(source, loops, closure, free_flyer, package_dirs or [], reanchor, q0)
    mech, read = what.load_with_hashes()
    shown.require_drawable(mech, traces, speed)
    until = start + mech.duration if until is None else until
    assembly = assemble(mech, q0 or None, v0 or None)
    scene.tell_moved(mech, q0, assembly)
    doubts.tell(doubts.doubts(mech, assembly))
    if not as_json:
        print(scene.describe(mech, assembly) + "\n")
    options = {"method": method, "step": step, "rtol": rtol, "atol": atol, "consistency": consistency}
    given = {"max_order": order, "max_step": max_step, "max_steps": max_steps}
    options |= {name: value for name, value in given.items() if value is not None}
    where = what.record(out or "run.npz")
    recipe = recipe_of(where, read, mech, (start, until), q0 or None, v0 or None, (), options, save_every)
    began = time.perf_counter()
    with watched(start, until) as progress:  # what was reached is saved before anything else can go wrong
        sol = carried_out(recipe, mech, out, callback=progress)
    seconds = time.perf_counter() - began
    if not as_json:
        print(f"{sol.summary()}\ntook {seconds:.3g} s\n")
    certificate = _checked(sol)
    if not as_json:
        print(certificate or "not checked: interrupted")
    with deferred(impatient=False):  # one more Ctrl-C waits until the files are there and are told
        if html:
            from ..view.page import export_html

            look = {"speed": shown.pace(speed, sol), "traces": traces or (), "forces": forces}
            drawn(html, sol, out, lambda: export_html(mech, sol, html, **look))
        if plot:
            from ..view.plots.pictures import plot_solution

            drawn(plot, sol, out, lambda: plot_solution(sol, plot, mech))
        if as_json:
            written = {"out": out, "html": html, "plot": plot}
            output.print_json(_report(mech, assembly, sol, certificate, seconds, written))
        elif files:
            print(f"\nwritten: {', '.join(files)}")
        if out and exit_code(sol) == output.INTERRUPTED and not as_json:
            print(to_be_continued(sol, out))
    return exit_code(sol) if certificate else output.INTERRUPTED


def _checked(sol):
    """The certificate; None where it took too long for who watched."""
    try:
        with doing("checking"):
            return sol.check()
    except KeyboardInterrupt:
        return None


def run(mech, span, **options):
    """Simulate, with a progress bar where somebody may watch it; Ctrl-C returns what was reached."""
    from ..simulation import simulate as simulate_mechanism

    with watched(*span) as progress:
        return simulate_mechanism(mech, span, callback=progress, **options)


def watched(start, end):
    """A progress bar, as a callback, where somebody may watch it."""
    return Progress(start, end) if output.on_terminal() else nullcontext()


def drawn(file, sol, out, write):
    """Call `write`, which writes `file`; where that fails, a run that is in no file yet is not lost."""
    try:
        with doing(f"writing {file}"):
            output.written(file, write)
    except InputError as error:
        if out:
            raise
        raise SavingError(str(error), solution=sol) from error


def to_be_continued(sol, file) -> str:
    """What `pinconsist resume` will do with a run that was interrupted."""
    at, start = sol.recipe["checkpoint"], sol.recipe["t_span"][0]
    if at:
        return f"pinconsist resume {file} continues it from t = {at['t']:g} s, its last checkpoint"
    return f"pinconsist resume {file} begins again at t = {start:g} s: without --save-every there are no checkpoints"


def exit_code(sol) -> int:
    """Of a run; its only callback never stops it, so a run that was stopped was interrupted."""
    return {0: output.FINE, 1: output.INTERRUPTED, -1: output.FAILED}[sol.status]


def _report(mech, assembly, sol, certificate, seconds, files) -> dict:
    about_scene = {
        "name": mech.name, "joints": len(mech.joints), "nq": mech.nq, "nv": mech.nv,
        "loops": [loop.name for loop in mech.loops], "rows": assembly.rows, "rank": assembly.rank,
        "mobility": assembly.mobility,
    }  # fmt: skip
    about_run = {
        "success": sol.success, "interrupted": exit_code(sol) == output.INTERRUPTED, "message": sol.message,
        "t": [sol.t[0], sol.t[-1]], "steps": sol.nsteps, "rejected": sol.rejected, "nfev": sol.nfev,
        "njev": sol.njev, "nlu": sol.nlu, "seconds": seconds, "method": sol.method,
    }  # fmt: skip
    names = ("position", "position_at", "velocity", "force", "force_first", "energy_error")
    return {
        "scene": about_scene,
        "run": about_run,
        "certificate": certificate and {name: getattr(certificate, name) for name in names},
        "end": {"q": scene.by_joint(mech, sol.q[-1]), "v": scene.by_joint(mech, sol.v[-1], velocity=True)},
        "files": files,
    }
