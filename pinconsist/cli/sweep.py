"""`pinconsist sweep`."""

import os
import sys
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import pinconsist as pc

from ..errors import InputError
from . import options as given
from . import output, scene
from .options import Count, Text, Texts, option, present
from .terminal import counting

CASES = "Cases"  # panel of the help
LOGGED = 10  # cases, from which on a log gets a line for every tenth
MOST_SHOWN = 5  # failed cases whose messages are printed


@scene.loads_scene
def sweep(
    *,
    vary: Annotated[Texts, option(
        "--vary", "NAME=VALUES",
        "What varies: JOINT (its initial position), JOINT_speed, JOINT_torque, LOOP.NUMBER or FORCE.NUMBER as in the "
        "scene file (motor.speed), mass:BODY, length:JOINT, stiffness:JOINT and the like, gravity.z, rtol, atol, step, "
        "until. VALUES are FROM:TO:STEP, a list 1,2,5, "
        "normal:MEAN:DEVIATION or uniform:LOW:HIGH. Repeated: every combination.", CASES)] = None,
    count: Annotated[Count, option("--count", "N", "Samples of normal: or uniform: values.", CASES)] = None,
    seed: Annotated[Count, option("--seed", "N", "Seed of the samples. Default: 0.", CASES)] = None,
    source: given.Scene,
    start: given.From = 0.0,
    until: given.Until = None,
    with_velocity: given.WithVelocity = None,
    step: given.Step = None,
    rtol: given.Rtol = 1e-6,
    atol: given.Atol = 1e-8,
    max_steps: given.MaxSteps = None,
    workers: Annotated[int, option("--workers", "N", "Processes that share the cases.")] = 1,
    out: Annotated[Text, option(
        "--out", "FILE.csv", "Write the table here. Until it is complete its rows are in FILE.csv.partial, from which "
        "the same command continues after it was stopped.")] = None,
    as_json: output.Json = False,
) -> int:  # fmt: skip
    """Simulate a scene many times, with one or more parameters varied.

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
        raise InputError("give what varies, such as --vary JOINT=0:1:0.1; pinconsist sweep --help lists what can vary")
    if out and Path(out).suffix != ".csv":
        raise InputError(f"--out {out}: a table is saved as .csv")
    output.require_writable(out=out)
    from ..sweep_cases import cases_of
    from ..sweep_table import Journal, SceneSweep, loaded, write_table

    names, cases = cases_of(vary, scene.number, count=count, seed=seed)
    q0, v0 = source.at, scene.joint_values(with_velocity, "--with-velocity")
    for name in names:
        if name in q0 or name.removesuffix("_speed") in v0.keys() - {name}:
            raise InputError(f"{name} is varied, and also has a value by --at or --with-velocity")
    duration = loaded(source, anew=True).duration
    until = start + duration if until is None else until
    settings = present(rtol=rtol, atol=atol, step=step, max_steps=max_steps)
    scene_sweep = SceneSweep(source, names, start, until, q0, v0, settings)
    scene_sweep.check(cases[0])  # an unknown name is refused before the sweep begins
    if not out:
        return _report(scene_sweep, cases, _run(scene_sweep, cases, workers, {}), out, as_json)
    with output.written(f"{out}.partial", lambda: Journal(out, scene_sweep.about(cases))) as journal:
        if journal.rows and not as_json:
            print(f"{len(journal.rows)} of {len(cases)} cases are in {journal.path} already")
        rows = _run(scene_sweep, cases, workers, dict(journal.rows), journal)
        if len(rows) == len(cases):
            _written(journal, out, lambda: write_table(out, scene_sweep, cases, rows))
            journal.remove()
    return _report(scene_sweep, cases, rows, out, as_json)


def _written(journal, file, write):
    try:
        output.written(file, write)
    except InputError as error:
        saved = f"{output.counted(len(journal.rows), 'row')} of the table are safe in {journal.path}"
        raise InputError(f"{error}. {saved}; the same command continues from there") from error


def _run(scene_sweep, cases, workers, rows, journal=None) -> dict[int, dict]:
    """The rows of all cases that ended, including those that are there already."""
    from ..sweep_table import ERROR
    from ..sweeps import sweep_in_processes

    missing = [i for i in range(len(cases)) if i not in rows]
    with counting("cases", len(cases), len(rows)) as shown:

        def arrived(outcome):
            if not outcome.finished:
                return
            case = missing[outcome.index]
            failed = {"status": ERROR, "message": f"{outcome.error}: {outcome.message}"}
            row = outcome.value if outcome.success else failed
            if journal is not None:
                _written(journal, journal.path, lambda: journal.add(case, row))
            rows[case] = row
            shown(len(rows)) if shown else _log_tenths(len(rows), len(cases))

        waiting = [cases[i] for i in missing]
        if workers == 1:
            pc.sweep(scene_sweep, waiting, callback=arrived)
        else:
            sweep_in_processes(scene_sweep, waiting, min(workers, len(waiting)), arrived)
    return rows


def _log_tenths(number, total):
    """Up to ten lines for a log."""
    if total >= LOGGED and 10 * number // total > 10 * (number - 1) // total:
        with suppress(OSError):  # a log that cannot be written does not end the sweep
            print(f"{number} of {total} cases", file=sys.stderr, flush=True)


def _report(scene_sweep, cases, measured, out, as_json) -> int:
    from ..sweep_table import DONE

    complete, partial = len(measured) == len(cases), f"{out}.partial"
    table, counts = scene_sweep.rows(cases, measured), Counter(row["status"] for row in measured.values())
    code = output.FINE if counts[DONE] == len(cases) else output.FAILED
    code = code if complete else output.INTERRUPTED
    if as_json:
        output.print_json({
            "scene": scene_sweep.about(cases)["scene"]["name"], "cases": len(cases), "counts": counts,
            "interrupted": not complete, "columns": scene_sweep.columns(), "rows": table,
            "files": {"out": out if complete else None, "partial": partial if out and not complete else None},
        })  # fmt: skip
        return code
    if not out:
        _print(scene_sweep.columns(), table, code == output.FINE)
    ends = ", ".join(f"{number} {what}" for what, number in sorted(counts.items())) or "none ended"
    print(f"{output.counted(len(cases), 'case')}: {ends}")
    failed = [row for row in table if measured[row[0]]["status"] != DONE]
    for row in failed[:MOST_SHOWN]:
        varied = ", ".join(f"{name} = {value:g}" for name, value in zip(scene_sweep.names, row[1:], strict=False))
        output.paragraph(f"case {row[0]} ({varied}): {row[-1]}", indent="  ", hanging="  ")
    if len(failed) > MOST_SHOWN:
        print(f"  and {len(failed) - MOST_SHOWN} more")
    if complete:
        output.print_written(out)
    else:
        print(f"interrupted; the same command continues from {partial}" if out else "interrupted")
    return code


def _print(names, table, done):
    """The table without velocities and messages, its floats shortened; how and when cases ended if not all are done."""

    def cell(name, value):
        digits = ".3g" if name in ("gap", "energy_error") else ".6g"
        return output.size(value, digits) if isinstance(value, float) else "" if value is None else value

    without = ("message", *(("status", "t") if done else ()))
    shown = [k for k, name in enumerate(names) if not name.startswith("v.") and name not in without]
    heads = [names[k] if names[k] == "status" else f"{names[k]}>" for k in shown]
    output.table(heads, [[cell(names[k], row[k]) for k in shown] for row in table])
