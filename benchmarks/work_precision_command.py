"""``python -m benchmarks work-precision``."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from pinconsist.cli import output

from . import report
from .equal_error import Equal
from .peers import OWN
from .peers.scenes import problem_of
from .work_precision import TOLERANCES, work_precision

SCENE = "crank_rocker"


def command(
    scene: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[NAME|PATH ...]",
            help="problem51, pendulum, stiff_four_bar, any built-in model (bricard, chain_64, …), file or folder of a "
            f"robot. Default: {SCENE}.",
        ),
    ] = None,
    tol: Annotated[
        list[float] | None,
        typer.Option("--tol", metavar="NUMBER", help="A tolerance; may be repeated. Default: 1e-4 … 1e-10."),
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
    until: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="Simulated time. Default: each scene's own.")
    ] = None,
    plot: Annotated[
        Path | None, typer.Option("--plot", metavar="FILE", help="Draw time against error of the first scene.")
    ] = None,
    csv: report.Csv = None,
    as_json: output.Json = False,
) -> int:
    """Run time against error of all methods and peers. Times at equal error go to FILE_equal_error.csv.

    Example: python -m benchmarks work-precision crank_rocker --tol 1e-5 --tol 1e-7
    """
    output.require_writable(plot, csv)
    output.require_figure(plot)
    if not as_json:
        print(output.machine() + "\n")
    studies = []
    for name in scene or [SCENE]:
        with report.status() as show:
            options = {"repeats": repeats, "budget": budget, "methods": method}
            options["tell"] = lambda peer, name=name: show(f"{name}: {peer}")
            studies.append(work_precision(problem_of(name, until), tol or TOLERANCES, **options))
        if not as_json:
            _print_study(studies[-1], repeats)
    if plot is not None:
        _draw(studies[0], plot)
    if csv:
        _write(csv, studies, repeats)
    if as_json:
        output.print_json({"machine": output.machine(), "scenes": [asdict(study) for study in studies]})
    return output.FINE


def _write(file, studies, repeats):
    points, equal = [], []
    for study in studies:
        run = {"scene": study.scene, "until": study.until, "repeats": repeats, "budget": study.budget}
        for point in study.points:
            points.append(run | asdict(point) | {"times": point.time})
        for target, found in study.equal_error:
            for method, one in found.items():
                values = one._asdict() if one else dict.fromkeys(Equal._fields)
                equal.append(run | {"target": target, "method": method} | values)
    report.write_csv(file, points)
    report.write_csv(report.beside(file, "equal_error"), equal)


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
        title=f"time at equal error in q (largest over the run), {targets}; its ratio to {OWN}: median of ratios; "
        "errors of the first multipliers",
    )


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
    from pinconsist.view.plots.comparison import plot_work_precision

    output.written(file, lambda: plot_work_precision(study.series(), file))
