"""`pinconsist sweep`."""

from __future__ import annotations

import itertools
import os
import sys
from collections import Counter
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from ..errors import InputError
from . import output, scene
from .simulate import METHOD

PANEL = "Cases"
LOGGED = 10  # cases, from which on a log is told of every tenth
MOST_TOLD = 5  # cases without an end, of which the messages are printed


def sweep(
    source: scene.Source,
    vary: Annotated[
        list[str] | None,
        typer.Option(
            "--vary", metavar="NAME=VALUES", rich_help_panel=PANEL, show_default=False,
            help="What varies: JOINT (its start), JOINT_speed, JOINT_torque, LOOP.NUMBER or FORCE.NUMBER as in the "
            "scene file (motor.speed), gravity.z, rtol, atol, step, until. VALUES are FROM:TO:STEP, a list 1,2,5, "
            "normal:MEAN:DEVIATION or uniform:LOW:HIGH. Repeated: every combination.",
        ),
    ] = None,
    count: Annotated[
        int | None,
        typer.Option(
            metavar="N", help="Samples of what is normal: or uniform:.", rich_help_panel=PANEL, show_default=False
        ),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(metavar="N", help="Seed of the samples. Default: 0.", rich_help_panel=PANEL, show_default=False),
    ] = None,
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
        typer.Option(
            metavar="SECONDS", help="Fixed step. Default: it varies.", rich_help_panel=METHOD, show_default=False
        ),
    ] = None,
    rtol: Annotated[float, typer.Option(metavar="NUMBER", help="Relative tolerance.", rich_help_panel=METHOD)] = 1e-6,
    atol: Annotated[float, typer.Option(metavar="NUMBER", help="Absolute tolerance.", rich_help_panel=METHOD)] = 1e-8,
    max_steps: Annotated[
        int | None,
        typer.Option(
            metavar="N", help="Give up a case after so many steps.", rich_help_panel=METHOD, show_default=False
        ),
    ] = None,
    workers: Annotated[int, typer.Option(metavar="N", help="Processes that share the cases.")] = 1,
    out: Annotated[
        str | None,
        typer.Option(
            metavar="FILE.csv", show_default=False,
            help="Write the table here. Until it is whole its rows are in FILE.csv.partial, from which the same "
            "command goes on after it was stopped.",
        ),
    ] = None,
    as_json: output.Json = False,
) -> int:  # fmt: skip
    """Simulate a scene many times, with one thing or several varied.

    Each case is a row: how it ended, the largest gap of a loop, the energy
    balance, q and v at the end. A case that fails is a row too, and the exit
    code is then 1.

    Example: pinconsist sweep crank_rocker --vary crank_speed=5:15:0.1 --workers 2 --out table.csv
    """
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # before numpy: the cases share the cores, and their last
        os.environ.setdefault(name, "1")  # bits do not depend on how many workers there are
    if workers < 1:
        raise InputError(f"--workers must be at least 1, got {workers}")
    if not vary:
        raise InputError("say what varies, such as --vary JOINT=0:1:0.1; pinconsist sweep --help tells what can be")
    if out and Path(out).suffix != ".csv":
        raise InputError(f"--out {out}: a table is saved as .csv")
    output.require_writable(out)
    from ..sweeps.axes import cases_of
    from ..sweeps.study import Study, loaded

    names, cases = cases_of(vary, _number, count=count, seed=seed)
    q0, v0 = scene.joint_values(at, "--at"), scene.joint_values(with_velocity, "--with-velocity")
    _require_once(names, q0, v0)
    recipe = scene.Scene(source, loops, closure, free_flyer, package_dirs or [], reanchor, q0)
    duration = loaded(recipe, anew=True).duration
    until = start + duration if until is None else until
    options = {"rtol": rtol, "atol": atol, "step": step, "max_steps": max_steps}
    options = {name: value for name, value in options.items() if value is not None}
    study = Study(recipe, names, start, until, q0, v0, options)
    study.check(cases[0])  # a name that is none is told now
    if not out:
        return _report(study, cases, *_run(study, cases, workers, {}, lambda *_: None), None, as_json)
    with _journal(out, study, cases) as journal:
        if journal.rows and not as_json:
            print(f"{len(journal.rows)} of {len(cases)} cases are in {journal.path} already")
        rows, whole = _run(study, cases, workers, dict(journal.rows), lambda *row: _keep(journal, *row))
        if whole:
            from ..sweeps.table import write

            _safely(journal, out, lambda: write(out, study, cases, rows))
            journal.remove()
    return _report(study, cases, rows, whole, out, as_json)


def _number(text) -> float:
    (value,) = scene.joint_values([f"value={text}"], "--vary")["value"]
    return value


def _require_once(names, q0, v0):
    for name in names:
        if name in q0 or name.removesuffix("_speed") in v0.keys() - {name}:
            raise InputError(f"{name} is varied, and has a value by --at or --with-velocity too")


def _journal(out, study, cases):
    from ..sweeps.journal import Journal

    return output.written(f"{out}.partial", lambda: Journal(out, study.about(cases)))


def _keep(journal, case, row):
    _safely(journal, journal.path, lambda: journal.add(case, row))


def _safely(journal, file, write):
    try:
        output.written(file, write)
    except InputError as error:
        kept = f"{output.counted(len(journal.rows), 'row')} of the table are safe in {journal.path}"
        raise InputError(f"{error}. {kept}; the same command goes on from there") from error


def _run(study, cases, workers, rows, keep) -> tuple[dict[int, dict], bool]:
    """The rows of all cases, those that are there already included, and whether it came to its end."""
    from ..sweeps.pool import sweep_in_processes
    from ..sweeps.study import ERROR
    from ..sweeps.sweep import sweep as in_a_loop

    missing = [i for i in range(len(cases)) if i not in rows]
    with _progress(len(cases), len(rows)) as one_more:

        def arrived(outcome):
            if outcome.success:
                row = outcome.value
            elif outcome.finished:
                row = {"status": ERROR, "message": f"{outcome.error}: {outcome.message}"}
            else:
                return
            keep(missing[outcome.index], row)
            rows[missing[outcome.index]] = row
            one_more()

        waiting = [cases[i] for i in missing]
        if workers == 1:
            in_a_loop(study, waiting, callback=arrived)
        else:
            sweep_in_processes(study, waiting, min(workers, len(waiting)), arrived)
    return rows, len(rows) == len(cases)


@contextmanager
def _progress(total, done):
    """What to call for each case: it moves a bar where somebody may be watching, and fills a log with ten lines."""
    if not output.on_terminal():
        yield partial(_tell_tenths, total, itertools.count(done + 1))
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (MofNCompleteColumn(), TextColumn("cases"), BarColumn(bar_width=20), TimeRemainingColumn(),
               TextColumn("left"))  # fmt: skip
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=total, completed=done)
        yield lambda: bar.advance(task)


def _tell_tenths(total, numbers):
    number = next(numbers)
    if total >= LOGGED and 10 * number // total > 10 * (number - 1) // total:
        with suppress(OSError):  # a log that cannot be written ends no sweep
            print(f"{number} of {total} cases", file=sys.stderr, flush=True)


def _report(study, cases, measured, whole, out, as_json) -> int:
    from ..sweeps.study import DONE
    from ..sweeps.table import columns, rows

    table, counts = rows(study, cases, measured), Counter(row["status"] for row in measured.values())
    code = output.INTERRUPTED if not whole else output.FINE if counts[DONE] == len(cases) else output.FAILED
    if as_json:
        output.print_json({
            "scene": study.about(cases)["scene"]["name"], "cases": len(cases), "counts": counts,
            "interrupted": not whole, "columns": columns(study), "rows": table,
            "files": {"out": out if whole else None, "partial": f"{out}.partial" if out and not whole else None},
        })  # fmt: skip
        return code
    if not out:
        _print(columns(study), table)
    told = ", ".join(f"{number} {what}" for what, number in sorted(counts.items())) or "none ended"
    print(f"{output.counted(len(cases), 'case')}: {told}")
    ended_early = [row for row in table if measured[row[0]]["status"] != DONE]
    for row in ended_early[:MOST_TOLD]:
        varied = ", ".join(f"{name} = {value:g}" for name, value in zip(study.names, row[1:], strict=False))
        output.paragraph(f"case {row[0]} ({varied}): {row[-1]}", indent="  ", hanging="  ")
    if len(ended_early) > MOST_TOLD:
        print(f"  and {len(ended_early) - MOST_TOLD} more")
    if out and whole:
        print(f"written: {out}")
    elif not whole:
        print(f"interrupted; the same command goes on from {out}.partial" if out else "interrupted")
    return code


def _print(names, table):
    """The table without the velocities and the messages, and its floats in short."""
    shown = [k for k, name in enumerate(names) if not name.startswith("v.") and name != "message"]
    cells = [["" if row[k] is None else f"{row[k]:.6g}" if isinstance(row[k], float) else row[k] for k in shown]
             for row in table]  # fmt: skip
    output.table([names[k] if names[k] == "status" else f"{names[k]}>" for k in shown], cells)
