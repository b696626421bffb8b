"""`pinconsist bench`."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from . import output

SCENE = "crank_rocker"


def bench(
    scene: Annotated[
        list[str] | None,
        typer.Option(
            "--scene",
            metavar="NAME|PATH",
            help="Run time against error of all methods and peers on this scene; may be repeated. problem51, pendulum, "
            f"stiff_four_bar, any built-in model (bricard, chain_64, …), file or folder of a robot. Default: {SCENE}.",
        ),
    ] = None,
    tol: Annotated[
        list[float] | None,
        typer.Option(
            "--tol", metavar="NUMBER", help="A tolerance of the scenes; may be repeated. Default: 1e-4 … 1e-10."
        ),
    ] = None,
    method: Annotated[
        list[str] | None,
        typer.Option(
            "--method",
            metavar="WORD",
            help="Only methods with this word in their name: scipy, Exudyn, pinconsist (every order and consistency, "
            "variable and fixed step), or peers, all others; may be repeated.",
        ),
    ] = None,
    repeats: Annotated[int, typer.Option(metavar="N", help="Timed runs of each method and tolerance, in turn.")] = 3,
    budget: Annotated[float, typer.Option(metavar="SECONDS", help="After which one run is cut.")] = 10.0,
    plot: Annotated[
        Path | None, typer.Option("--plot", metavar="FILE", help="Draw time against error of the first scene.")
    ] = None,
    ablate: Annotated[
        bool,
        typer.Option(
            "--ablate",
            help="Switch off each thing that a run skips, in turn, and tell what that costs: on every --scene, by "
            "default on a few.",
        ),
    ] = False,
    overhead: Annotated[
        bool,
        typer.Option(
            "--overhead",
            help="Time of a step beside the bare Pinocchio calls of one residual, on every --scene; by default on the "
            "crank-rocker, and on chains of 8 to 256 links.",
        ),
    ] = False,
    robots: Annotated[
        list[str] | None,
        typer.Option(
            "--robots",
            metavar="FOLDER|NAME",
            help="Assemble every robot of FOLDER, or one known by NAME such as cassie, from q = 0 and 20 random "
            "guesses, and let it fall from rest; may be repeated.",
        ),
    ] = None,
    until: Annotated[
        float | None,
        typer.Option(metavar="SECONDS", help="Simulated time. Default: 0.5 for robots, for scenes their own."),
    ] = None,
    as_json: output.Json = False,
) -> int:
    """Measure run time and accuracy on this machine. Pin the threads first: OMP_NUM_THREADS=1.

    Example: pinconsist bench --scene crank_rocker --scene andrews --plot bench.png
    """
    from ..study import bench as study

    output.require_writable(plot)
    output.require_figure(plot)
    scenes = [] if ablate or overhead else scene or ([] if robots else [SCENE])
    results = {"machine": output.machine()}
    if not as_json:
        print(results["machine"] + "\n")
    if scenes:
        studies = [_measure(name, tol, method, repeats, budget, until, as_json) for name in scenes]
        results["scenes"] = [asdict(each) for each in studies]
        if plot is not None:
            _draw(studies[0], plot)
    if ablate:
        from .ablate import ablate as measure_skips

        results["ablate"] = measure_skips(scene, repeats, as_json)
    if overhead:
        from .overhead import overhead as measure_overhead

        results |= measure_overhead(scene, as_json)
    if robots:
        fall = 0.5 if until is None else until
        results["robots"] = [asdict(row) for source in robots for row in study.robots(source, fall)]
        if not as_json:
            _print_robots(results["robots"], fall)
    if as_json:
        output.print_json(results)
    return output.FINE


def _measure(name, tol, method, repeats, budget, until, as_json):
    from ..study.peers.scenes import problem_of
    from ..study.workprecision import TOLERANCES, work_precision

    def tell(method_name):
        if output.on_terminal():
            print(f"\r\033[K{name}: {method_name}", end="", file=sys.stderr, flush=True)

    options = {"repeats": repeats, "budget": budget, "methods": method, "tell": tell}
    study = work_precision(problem_of(name, until), tol or TOLERANCES, **options)
    if output.on_terminal():
        print("\r\033[K", end="", file=sys.stderr, flush=True)
    if not as_json:
        _print_study(study, repeats)
    return study


def _print_study(study, repeats):
    print(
        f"{study.scene}: {study.description}, {study.until:g} s\n"
        + ", ".join(f"{package} {version}" for package, version in study.versions.items())
        + f"\nCPU times, medians of {repeats} runs in turn in one process; a run is cut after {study.budget:g} s; "
        f"the reference is good to {study.reference:.0e} in q"
    )
    rows, targets = [], " and ".join(f"{target:.0e}" for target, _ in study.equal_error)
    for point in study.points:
        start = (point.method, "" if point.tol != point.tol else f"{point.tol:g}")
        if point.status == "done":
            errors = (point.q, point.q_end, point.v, point.lam, point.lam_row, point.lam_first)
            errors = (f"{value:.1e}" for value in errors)
            rows.append((*start, point.steps, f"{1e3 * point.time:.1f}", *errors, ""))
        else:
            rows.append((*start, point.steps or "", *[""] * 7, point.status))
    output.table(
        (
            "method",
            "tol>",
            "steps>",
            "time [ms]>",
            "q>",
            "q at end>",
            "v>",
            "λ>",
            "λ, 1st row>",
            "λ, 1st step>",
            "remark",
        ),
        rows,
        title="largest errors over the run: q in rad and m, v and λ in parts of their largest value",
    )
    output.table(
        (
            "method",
            *(f"{what}>" for _ in study.equal_error for what in ("time [ms]", "ratio", "λ, 1st row", "1st step")),
        ),
        _equal_rows(study.equal_error),
        title=f"time at equal error in q (largest over the run), {targets}; its ratio to {_own()}: median of ratios; "
        "errors of the first multipliers",
    )


def _own():
    from ..study.peers import OWN

    return OWN


def _equal_rows(equal_error):
    rows = []
    for method in dict.fromkeys(name for _, found in equal_error for name in found):
        cells = []
        for _, found in equal_error:
            one = found.get(method)
            if one is None:
                cells += ["not reached", "", "", ""]
                continue
            ratio = f"{one.ratio:.2f}" if one.ratio == one.ratio else ""
            cells += [f"{1e3 * one.time:.1f}", ratio, f"{one.lam_row:.1e}", f"{one.lam_first:.1e}"]
        rows.append((method, *cells))
    return rows


def _draw(study, file):
    from ..view.plots.comparison import plot_work_precision

    output.written(file, lambda: plot_work_precision(study.series(), file))


def _print_robots(rows, until):
    closings = {(row["robot"], row["closure"]): row["assembly"] for row in rows}
    output.table(
        ("robot", "loops", "from q = 0", "from random guesses>", "median time [ms]>"),
        [
            (robot, closure, "closed" if closing["from_neutral"] else "open", f"{closing['closed']}/{closing['tried']}",
             f"{1e3 * closing['time']:.1f}")
            for (robot, closure), closing in closings.items()
        ],
        title="assembly from q = 0 and from random guesses within 1 rad of it",
    )  # fmt: skip
    output.table(
        ("robot", "loops", "rtol", "steps>", "largest gap [m]>", "energy error>", "step [us]>", "outcome"),
        [
            (row["robot"], row["closure"], f"{row['rtol']:g}" if row["rtol"] else "default", row["steps"],
             f"{row['gap']:.1e}", f"{row['energy_error']:.1e}", f"{1e6 * row['step_time']:.0f}", row["status"])
            for row in rows
        ],
        title=f"robots released from rest, {until:g} s",
    )  # fmt: skip
