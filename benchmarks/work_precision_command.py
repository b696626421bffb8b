"""``python -m benchmarks work-precision``."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from pinconsist.cli import output
from pinconsist.cli.scene import Number, Texts, option

from . import report
from .equal_error import COMPARED, Equal
from .peers import OWN
from .peers.scenes import problem_of
from .work_precision import TOLERANCES, work_precision
from .work_precision_figure import plot_work_precision

SCENE = "crank_rocker"


# fmt: off
def command(
    scene: Annotated[list[str] | None, typer.Argument(metavar="[NAME|PATH ...]", help=(
        "problem51, pendulum, stiff_four_bar, any built-in model (bricard, chain_64, …), file or folder of a robot. "
        f"Default: {SCENE}."))] = None,
    tol: Annotated[list[float] | None, option(
        "--tol", "NUMBER", "A tolerance; may be repeated. Default: 1e-4 … 1e-10.")] = None,
    tolerances: Annotated[int, option("--tolerances", "N", "So many from 1e-2 to 1e-10.", min=0)] = 0,
    method: Annotated[Texts, option(
        "--method", "WORD", "Only methods with this word in their name: scipy, Exudyn, pinconsist (every order and "
        "consistency, variable and fixed step), or peers, all others; may be repeated.")] = None,
    repeats: Annotated[int, option("--repeats", "N", "Timed runs of each method and tolerance, in turn.")] = 3,
    over: Annotated[str, option("--over", "METHOD", "The method that the others are compared with.")] = OWN,
    budget: Annotated[float, option("--budget", "SECONDS", "After which one run is cut.")] = 10.0,
    until: Annotated[Number, option("--until", "SECONDS", "Simulated time. Default: each scene's own.")] = None,
    plot: Annotated[Path | None, option("--plot", "FILE", "Draw time against error of the first scene.")] = None,
    csv: report.Csv = None,
    as_json: output.Json = False,
) -> int:
    # fmt: on
    """Run time against error of all methods and peers. Times at equal error go to FILE_equal_error.csv.

    Example: python -m benchmarks work-precision crank_rocker --tol 1e-5 --tol 1e-7
    """
    output.require_writable(csv=csv, figure=plot)
    tol = np.logspace(-2, -10, tolerances).tolist() if tolerances else tol or TOLERANCES
    if not as_json:
        print(report.machine() + "\n")
    diagrams = []
    for name in scene or [SCENE]:
        with report.status() as show:
            options = {"repeats": repeats, "budget": budget, "methods": method, "over": over}
            options["report"] = lambda peer, name=name: show(f"{name}: {peer}")
            diagrams.append(work_precision(problem_of(name, until), tol, **options))
        if not as_json:
            _print(diagrams[-1], repeats)
    if plot is not None:
        output.written(plot, lambda: plot_work_precision(diagrams[0].series(), plot))
    if csv:
        _write(csv, diagrams, repeats)
    if as_json:
        output.print_json({"machine": report.machine(), "scenes": [asdict(diagram) for diagram in diagrams]})
    return output.FINE


def _write(file, diagrams, repeats):
    points, equal = [], []
    for diagram in diagrams:
        run = {"scene": diagram.scene, "until": diagram.until, "repeats": repeats, "budget": diagram.budget}
        points += [run | _row(point) for point in diagram.points]
        for of, targets in diagram.equal_error.items():
            for target, found in targets:
                for method, one in found.items():
                    values = one._asdict() if one else dict.fromkeys(Equal._fields)
                    equal.append(run | {"of": of, "target": target, "method": method} | values)
    report.write_csv(file, points)
    report.write_csv(report.beside(file, "equal_error"), equal)


def _row(point):
    """A point with its median times in place of all times."""
    medians = {"times": ("time", point.time), "setups": ("setup", point.setup)}
    return dict(medians.get(name, (name, value)) for name, value in asdict(point).items())


def _done(format, scale=1.0):
    """Cell that stays empty where there is no result."""
    name, _, spec = format.partition(":")
    return lambda row: f"{scale * row[name]:{spec}}" if row["status"] == "done" else ""


def _print(diagram, repeats):
    versions = ", ".join(f"{package} {version}" for package, version in diagram.versions.items())
    print(
        f"{diagram.scene}: {diagram.description}, {diagram.until:g} s\n{versions}\n"
        f"CPU times, medians of {repeats} runs in turn in one process; a run is cut after {diagram.budget:g} s; "
        f"the reference is good to {diagram.reference:.0e} in q"
    )
    columns = [
        "method",
        ("tol>", lambda row: "" if row["tol"] != row["tol"] else f"{row['tol']:g}"),
        ("steps>", lambda row: row["steps"] or ""),
        ("time [ms]>", _done("time:.2f", 1e3)),
        ("set-up>", _done("setup:.2f", 1e3)),
        ("q>", _done("q:.1e")),
        ("q at end>", _done("q_end:.1e")),
        ("v>", _done("v:.1e")),
        ("λ>", _done("lam:.1e")),
        ("Jᵀλ>", _done("force:.1e")),
        ("λ, 1st row>", _done("lam_row:.1e")),
        ("λ, 1st step>", _done("lam_first:.1e")),
        ("remark", lambda row: "" if row["status"] == "done" else row["status"]),
    ]
    title = "largest errors over the run: q in rad and m, v, λ and Jᵀλ in parts of their largest value"
    report.table(map(_row, diagram.points), columns, title)
    for of, what in COMPARED.items():
        equal = diagram.equal_error[of]
        methods = dict.fromkeys(name for _, found in equal for name in found)
        output.table(
            ("method", *(f"{target:.0e}>" for target, _ in equal)),
            [(name, *(_equal(found.get(name), name == diagram.over) for _, found in equal)) for name in methods],
            title=f"time at equal error in {what} (largest over the run), over that of {diagram.over}; in parentheses "
            "without the set-ups of both",
        )


def _equal(one, is_unit):
    """Cell of a ratio with set-up and without, or of the times where they are the unit, or there is none."""
    if one is None:
        return ""
    if is_unit or one.ratio != one.ratio:
        whole, core = f"{1e3 * one.time:.2f} ms", 1e3 * one.core
    else:
        whole, core = f"{one.ratio:.2f}", one.core_ratio
    return whole if core != core else f"{whole} ({core:.2f})"
