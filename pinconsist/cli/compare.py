"""`pinconsist compare`."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

import typer

from ..errors import InputError
from . import output, scene
from .progress import doing

STEPS = (0.002, 0.0002)  # of the duration
LONGEST = 10.0  # s of playing


def compare(
    subject: Annotated[
        str, typer.Argument(metavar="SUBJECT", help="problem51, problem52, or a scene as in: pinconsist simulate.")
    ],
    loops: scene.Loops = None,
    closure: scene.Closure = None,
    free_flyer: scene.FreeFlyer = False,
    reanchor: scene.Reanchor = False,
    at: scene.At = None,
    with_velocity: scene.WithVelocity = None,
    step: Annotated[
        list[float] | None,
        typer.Option(
            metavar="SECONDS ...",
            help="Step sizes, one or several. Default: 0.01 0.001; of a scene, a 500th and a 5000th of its duration.",
        ),
    ] = None,
    order: Annotated[int, typer.Option(metavar="K", help="BDF order, 1 to 6.")] = 1,
    rows: Annotated[int, typer.Option(metavar="N", help="Steps to take and print.")] = 6,
    plot: Annotated[str | None, typer.Option(metavar="FILE.png", help="Draw the errors over time.")] = None,
    html: Annotated[
        str | None,
        typer.Option(
            metavar="FILE.html",
            help="Write a page that plays the steps from exact beside those from consistent values, with their forces, "
            "in slow motion, for the first step size.",
        ),
    ] = None,
    as_json: output.Json = False,
) -> int:  # fmt: skip
    """Compare the first constraint forces from exact and from numerically consistent initial values.

    Prints the tables of Arévalo (2008): the error of the multipliers at each
    step from exact initial values, from consistent ones, and with every step
    corrected. The reference of a scene is scipy's DOP853.

    Example: pinconsist compare problem51 --step 0.01 0.001
    """
    if plot and html and Path(plot).absolute() == Path(html).absolute():
        raise InputError("--plot and --html name the same file")
    output.require_writable(plot, html)
    output.require_figure(plot)
    from ..comparison import compare as compare_errors
    from ..mechanism.mechanism import Mechanism
    from ..reference import PROBLEMS, reference_problem

    q0, v0 = scene.joint_values(at, "--at"), scene.joint_values(with_velocity, "--with-velocity")
    if subject in PROBLEMS:
        if loops or closure or free_flyer or reanchor or q0 or v0:
            raise InputError(f"{subject} has its own loops and initial values; these options are for scenes")
        what, names, duration = subject, None, Mechanism.duration
        if html and not isinstance(reference_problem(subject).system, Mechanism):
            raise InputError(f"--html shows bodies, and {subject} has none")
    else:
        what = scene.Scene(subject, loops, closure, free_flyer, [], reanchor, q0).load()
        duration = what.duration
        names = [name for name, size in zip(what.joints, list(what.model.nvs)[1:], strict=True) for _ in range(size)]
    steps = step or [duration * share for share in STEPS]
    runs = []
    for k, h in enumerate(steps, start=1):
        with doing(f"step size {h:g} s, {k} of {len(steps)}: {rows} steps in three ways, and the reference"):
            result = compare_errors(what, [h], order=order, count=rows, q0=q0 or None, v0=v0 or None)
            runs += result.runs
    result = replace(result, runs=tuple(runs))
    if html:
        _show(what, html, result.runs[0], order, q0 or None, v0 or None)
    if plot:
        from ..view.plots.comparison import plot_comparison

        output.written(plot, lambda: plot_comparison(result.runs, plot))
    if as_json:
        runs = [asdict(run) for run in result.runs]
        output.print_json(
            {"name": result.name, "order": result.order, "runs": runs, "files": {"plot": plot, "html": html}}
        )
        return output.FINE
    start = f"; rows 0 to {order - 1} are its exact start" if order > 1 else ""
    print(f"{result.name}, BDF of order {order}: error of the multipliers, largest component{start}\n")
    for run in result.runs:
        _print_run(run, order, names)
    if not any(run.v_given.any() for run in result.runs):
        print("from rest exact values are nearly consistent; --with-velocity JOINT=VALUE shows more\n")
    if plot or html:
        print(f"written: {', '.join(filter(None, (plot, html)))}")
    return output.FINE


def _show(what, file, run, order, q0, v0):
    """A page of the first steps from exact beside those from consistent values: a second each, ten in all at most."""
    from ..mechanism.assembly import assemble
    from ..mechanism.mechanism import Mechanism
    from ..reference import reference_problem
    from ..simulation import integrate
    from ..view.page import export_html

    if isinstance(what, Mechanism):
        start = assemble(what, q0, v0)
        mech, q, v = what, start.q, start.v
    else:
        problem = reference_problem(what)
        mech, q, v = problem.system, problem.p0, problem.v0
    options = {"step": run.h, "max_order": order}
    sols = {
        title: integrate(mech, (run.t[0], run.t[-1]), q, v, consistency=mode, **options)
        for title, mode in (("from exact values", "exact"), ("from consistent values", "initial"))
    }
    speed = max(run.h, (run.t[-1] - run.t[0]) / LONGEST)
    output.written(file, lambda: export_html(mech, sols, file, speed=speed, forces=True))


def _print_run(run, order, names):
    columns = zip(run.t, run.exact, run.consistent, run.every_step, strict=True)
    rows = [  # the first `order` rows are the exact start, of which nothing can be learnt
        (k, f"{t:.9g}", *map(output.number, errors)) for k, (t, *errors) in enumerate(columns) if k >= order
    ]
    output.table(
        ("row>", "t [s]>", "from exact>", "from consistent>", "every step>"), rows, title=f"step size h = {run.h:g} s"
    )
    names = names or [f"v{k + 1}" for k in range(len(run.v_given))]
    columns = zip(names, run.v_given, run.v_consistent, run.v_consistent - run.v_given, strict=True)
    output.table(
        ("initial velocity", "given>", "consistent>", "change>"),
        [(name, f"{given:.9g}", f"{new:.9g}", output.number(change)) for name, given, new, change in columns],
    )
