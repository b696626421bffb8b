"""`pinconsist compare`."""

from dataclasses import asdict, replace
from typing import Annotated

import typer

import pinconsist as pc

from ..errors import InputError
from . import output, scene
from .scene import Text, option

STEPS = (0.002, 0.0002)  # relative to the duration
PLAYING_TIME = 10.0  # s, playing time


@scene.loads_scene
def compare(
    source: Annotated[scene.SceneSource, typer.Argument(
        metavar="SUBJECT", help="problem51, problem52, or a scene as for pinconsist simulate.")],
    with_velocity: scene.WithVelocity = None,
    step: Annotated[list[float] | None, option(
        "--step", "SECONDS ...",
        "One or more step sizes. Default: 0.01 0.001; for a scene 1/500 and 1/5000 of its duration.")] = None,
    order: Annotated[int, option("--order", "K", "BDF order.", min=1, max=6)] = 1,
    rows: Annotated[int, option("--rows", "N", "Number of steps to take and print.", min=1)] = 6,
    plot: Annotated[Text, option("--plot", "FILE.png", "Plot the errors over time.")] = None,
    html: Annotated[Text, option(
        "--html", "FILE.html", "Write a page that plays the runs from exact and from consistent values side by side, "
        "with their forces, in slow motion, for the smallest step size.")] = None,
    as_json: output.Json = False,
) -> int:  # fmt: skip
    """Compare the first constraint forces from exact and from numerically consistent initial values.

    Prints the tables of Arévalo (2008): the error of the force in a loop at each
    step from exact initial values, from consistent ones, and with every step
    corrected. The loop is the one with the largest error at the first step; if no
    loop connects bodies, a torque or multiplier is compared. The reference of a
    scene is scipy's DOP853.

    Example: pinconsist compare problem51 --step 0.01 0.001
    """
    output.require_writable(html=html, figure=plot)
    from ..paper.problems import PROBLEMS

    subject, q0 = source.source, source.at or None
    v0 = scene.joint_values(with_velocity, "--with-velocity") or None
    if subject in PROBLEMS:
        if source != scene.SceneSource(subject) or v0:
            raise InputError(f"{subject} has its own loops and initial values; these options are for scenes")
        what, duration = subject, pc.Mechanism.duration
        if html and not isinstance(pc.paper.reference_problem(subject).system, pc.Mechanism):
            raise InputError(f"--html shows bodies, but {subject} has none")
    else:
        what = source.load()
        duration = what.duration
    steps = step or [duration * share for share in STEPS]
    runs = []
    for k, h in enumerate(steps, start=1):
        with output.doing(f"step size {h:g} s, {k} of {len(steps)}: three runs of {rows} steps, and the reference"):
            result = pc.paper.compare(what, [h], order=order, count=rows, q0=q0, v0=v0)
            runs += result.runs
    if html:
        _show(what, html, min(runs, key=lambda run: run.h))
    if plot:
        output.written(plot, lambda: pc.paper.plot_comparison(runs, plot))
    result = replace(result, runs=tuple(runs))
    if as_json:
        output.print_json(asdict(result) | {"files": {"plot": plot, "html": html}})
    else:
        _print(result, None if subject in PROBLEMS else what)
        output.print_written(plot, html)
    return output.FINE


def _show(what, file, run):
    """A page with the first steps from exact and from consistent values side by side: a second each, ten s at most.

    It stops at the first step of the method, where the wrong force is shown next to the true one.
    """
    from ..view.page import write_page

    mech = pc.paper.reference_problem(what).system if isinstance(what, str) else what
    start, options = ((run.t[0], run.t[-1]), run.q[0], run.v_given), {"step": run.h, "order": run.order}
    sols = {
        title: pc.integrate(mech, *start, consistency=mode, **options)
        for title, mode in (("from exact values", "exact"), ("from consistent values", "initial"))
    }
    speed = max(run.h, (run.t[-1] - run.t[0]) / PLAYING_TIME)
    output.written(file, lambda: write_page(file, mech, sols, speed=speed, forces=True, first=run))


def _print(result, mech):
    from ..mechanism.names import velocity_names

    order = result.order
    start = f"; rows 0 to {order - 1} are its exact start" if order > 1 else ""
    print(f"{result.name}, BDF of order {order}: error of the first forces{start}\n")
    for run in result.runs:
        output.paragraph(run.verdict, hanging="  ")
    print()
    for run in result.runs:
        rows = list(zip(range(len(run.t)), run.t, run.exact, run.consistent, run.every_step, strict=True))
        heads = ("row>", "t [s]>.9g", "from exact>.4e", "from consistent>.4e", "every step>.4e")
        unit = f", {run.unit}" if run.unit else ""
        output.table(heads, rows[order:], title=f"step size h = {run.h:g} s: error of {run.of}{unit}")
        names = [f"v{k + 1}" for k in range(len(run.v_given))]
        names = names if mech is None else velocity_names(mech.model)
        change = run.v_consistent - run.v_given
        rows = list(zip(names, run.v_given, run.v_consistent, change, strict=True))
        output.table(("initial velocity", "given>.9g", "consistent>.9g", "change>.4e"), rows)
    if not any(run.v_given.any() for run in result.runs):
        print("at rest, exact values are nearly consistent; --with-velocity JOINT=VALUE shows more\n")
