"""`pinconsist sweep`: the cases of --vary, their runs, and the table."""

import itertools
import math
import os
import sys
from collections import Counter
from contextlib import suppress
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Annotated

import pinconsist as pc

from ..errors import InputError
from . import output, scene
from .scene import QUANTITY, Count, Text, Texts, option, present

CASES = "Cases"  # panel of the help
LOGGED = 10  # smallest number of cases for which a log gets a line for every tenth of them
MOST_SHOWN = 5  # failed cases whose messages are printed
MAX_CASES = 1_000_000
DISTRIBUTIONS = {"normal": "normal:MEAN:DEVIATION", "uniform": "uniform:LOW:HIGH"}
FORMS = "FROM:TO:STEP, VALUE,VALUE,..., normal:MEAN:DEVIATION or uniform:LOW:HIGH"


@scene.loads_scene
def sweep(
    *,
    vary: Annotated[Texts, option(
        "--vary", "NAME=VALUES",
        "NAME is JOINT (its initial position), JOINT_speed, JOINT_torque, LOOP.NUMBER or FORCE.NUMBER as in the "
        "scene file (motor.speed), mass:BODY, length:JOINT, stiffness:JOINT and so on, gravity.z, rtol, atol, step or "
        "until. VALUES are FROM:TO:STEP, a list 1,2,5, "
        "normal:MEAN:DEVIATION or uniform:LOW:HIGH. If repeated, all combinations are simulated.", CASES)] = None,
    of: Annotated[Texts, option(
        "--of", "QUANTITY", f"An additional column, in quotes: {QUANTITY}. At the end of the run by default. May be "
        "repeated.", CASES)] = None,
    count: Annotated[Count, option("--count", "N", "Number of samples of normal: or uniform: values.", CASES)] = None,
    seed: Annotated[Count, option("--seed", "N", "Seed of the samples. Default: 0.", CASES)] = None,
    source: scene.Scene,
    start: scene.From = 0.0,
    until: scene.Until = None,
    with_velocity: scene.WithVelocity = None,
    step: scene.Step = None,
    rtol: scene.Rtol = 1e-6,
    atol: scene.Atol = 1e-8,
    max_steps: scene.MaxSteps = None,
    workers: Annotated[int, option("--workers", "N", "Number of processes that share the cases.")] = 1,
    out: Annotated[Text, option(
        "--out", "FILE.csv", "Write the table here. Until it is complete, its rows are in FILE.csv.partial; the same "
        "command continues from there after an interruption.")] = None,
    as_json: output.Json = False,
) -> int:  # fmt: skip
    """Simulate a scene many times, with one or more parameters varied.

    Each case has a row: how it ended, the largest gap of a loop, the energy
    balance, the quantities of --of, and q and v at the end. A case that fails
    also has a row, and the exit code is then 1.

    Example: pinconsist sweep crank_rocker --vary crank_speed=5:15:0.1 --workers 2 --out table.csv
    """
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # before numpy: the cases share the cores, and their last
        os.environ.setdefault(name, "1")  # bits do not depend on how many workers there are
    if workers < 1:
        raise InputError(f"--workers must be at least 1, got {workers}")
    if not vary:
        raise InputError("--vary is needed, such as --vary JOINT=0:1:0.1; pinconsist sweep --help lists the names")
    if out and Path(out).suffix != ".csv":
        raise InputError(f"--out {out}: a table is saved as .csv")
    output.require_writable(out=out)
    from ..run.sweep_table import Journal, SceneSweep, loaded, write_table

    names, cases = cases_of(vary, count, seed)
    q0, v0 = source.at, scene.joint_values(with_velocity, "--with-velocity")
    for name in names:
        if name in q0 or name.removesuffix("_speed") in v0.keys() - {name}:
            raise InputError(f"{name} is varied, but also has a value in --at or --with-velocity")
    duration = loaded(source, anew=True).duration
    until = start + duration if until is None else until
    settings = present(rtol=rtol, atol=atol, step=step, max_steps=max_steps)
    scene_sweep = SceneSweep(source, names, start, until, q0, v0, settings, tuple(dict.fromkeys(of or ())))
    scene_sweep.check(cases[0])  # an unknown name is refused before the sweep begins
    with output.written(f"{out}.partial", lambda: Journal(out, out and scene_sweep.about(cases))) as journal:
        if journal.rows and not as_json:
            print(f"{len(journal.rows)} of {len(cases)} cases are already in {journal.path}")
        _run(scene_sweep, cases, workers, journal)
        if out and len(journal.rows) == len(cases):
            _written(journal, out, lambda: write_table(out, scene_sweep, cases, journal.rows))
            journal.remove()
    return _report(scene_sweep, cases, journal.rows, out, as_json)


def cases_of(texts, count: int | None = None, seed: int | None = None):
    """Names and cases of texts such as ``crank_speed=5:15:0.1``: tuples of str, and of numbers; or InputError.

    The cases are all combinations of the lists; the last list varies fastest. All random names together are one more
    list, of `count` samples; sample i is drawn with the i-th of ``numpy.random.SeedSequence(seed).spawn(count)``, so
    that it does not change if `count` grows.
    """
    lists, random = {}, {}
    for text in texts:
        name, sign, values = (part.strip() for part in text.rpartition("="))
        if not sign or not name or not values:
            raise InputError(f"--vary needs name=values, got {text!r}; values are {FORMS}")
        if name in lists or name in random:
            raise InputError(f"--vary names {name!r} twice")
        try:
            if values.split(":")[0] in DISTRIBUTIONS:
                random[name] = _distribution(*values.split(":"))
            else:
                lists[name] = _list(values)
        except InputError as error:
            raise InputError(f"--vary {text}: {error}") from None
    if bool(random) != (count is not None):
        raise InputError("--count is the number of samples of normal: and uniform: values; use both or neither")
    if seed is not None and not random:
        raise InputError("--seed is for normal: and uniform: values")
    size = math.prod(map(len, lists.values())) * (count or 1)
    if size > MAX_CASES:
        raise InputError(
            f"{size} cases are more than a million; use larger steps or random samples (normal:, uniform:)"
        )
    samples = [()] if count is None else _samples(random.values(), count, seed or 0)
    cases = [(*values, *sample) for *values, sample in itertools.product(*lists.values(), samples)]
    return (*lists, *random), cases


def _samples(distributions, count, seed):
    import numpy as np

    if count < 1 or seed < 0:
        raise InputError(f"--count must be at least 1 and --seed not negative, got {count} and {seed}")
    generators = map(np.random.default_rng, np.random.SeedSequence(seed).spawn(count))
    return [tuple(float(getattr(each, kind)(*by)) for kind, *by in distributions) for each in generators]


def _distribution(kind, *parameters):
    if len(parameters) != 2:
        raise InputError(f"needs {DISTRIBUTIONS[kind]}")
    first, second = map(_number, parameters)
    if kind == "normal" and second < 0:
        raise InputError("the deviation is negative")
    if kind == "uniform" and second < first:
        raise InputError("the end is below the start")
    return kind, first, second


def _list(values):
    if ":" not in values:
        found = [_number(each) for each in values.split(",")]
        if len(set(found)) < len(found):
            raise InputError("a value is given twice")
        return found
    if values.count(":") != 2:
        raise InputError("a range needs FROM:TO:STEP")
    try:
        start, end, step = map(Decimal, values.split(":"))  # 5.3, not 5.300000000000001 as with floats
    except InvalidOperation:
        start, end, step = map(_number, values.split(":"))
    if not all(map(math.isfinite, (start, end, step))) or step == 0 or (end - start) / step < 0:
        raise InputError("the step must lead from the start to the end")
    if (count := float((end - start) / step)) > MAX_CASES:
        raise InputError("that makes more than a million cases")
    return [float(start + k * step) for k in range(int(count + 1e-9) + 1)]


def _number(text) -> float:
    try:
        value = scene.number(text)
    except ValueError:
        raise InputError(f"{text!r} is not a number; values are {FORMS}") from None
    if not math.isfinite(value):
        raise InputError(f"{text!r} is not a finite number")
    return value


def _written(journal, file, write):
    saved = f"{output.counted(len(journal.rows), 'row')} of the table are saved in {journal.path}"
    output.written(file, write, f". {saved}; the same command continues from there")


def _run(scene_sweep, cases, workers, journal):
    """Add the rows of the cases that are missing in the journal."""
    from ..run.sweep_table import ERROR
    from ..run.sweeps import sweep_in_processes

    total, missing = len(cases), [i for i in range(len(cases)) if i not in journal.rows]
    with output.counting("cases", total, len(journal.rows)) as shown:

        def arrived(outcome):
            if not outcome.finished:
                return
            case = missing[outcome.index]
            failed = {"status": ERROR, "message": f"{outcome.error}: {outcome.message}"}
            row = outcome.value if outcome.success else failed
            _written(journal, journal.path, lambda: journal.add(case, row))
            done = len(journal.rows)
            if shown:
                shown(done)
            elif total >= LOGGED and 10 * done // total > 10 * (done - 1) // total:  # up to ten lines for a log
                with suppress(OSError):  # an unwritable stderr must not end the sweep
                    print(f"{done} of {total} cases", file=sys.stderr, flush=True)

        waiting = [cases[i] for i in missing]
        if workers == 1:
            pc.sweep(scene_sweep, waiting, callback=arrived)
        else:
            sweep_in_processes(scene_sweep, waiting, min(workers, len(waiting)), arrived)


def _report(scene_sweep, cases, measured, out, as_json) -> int:
    from ..run.sweep_table import DONE, loaded

    complete, partial = len(measured) == len(cases), f"{out}.partial"
    table, counts = scene_sweep.rows(cases, measured), Counter(row["status"] for row in measured.values())
    code = output.FINE if counts[DONE] == len(cases) else output.FAILED
    code = code if complete else output.INTERRUPTED
    if as_json:
        output.print_json({
            "scene": loaded(scene_sweep.scene).name, "cases": len(cases), "counts": counts,
            "interrupted": not complete, "columns": scene_sweep.columns(), "rows": table,
            "files": {"out": out if complete else None, "partial": partial if out and not complete else None},
        })  # fmt: skip
        return code
    if not out:
        _print(scene_sweep.columns(), table, code == output.FINE)
    ends = ", ".join(f"{number} {what}" for what, number in sorted(counts.items())) or "none ended"
    print(f"{output.counted(len(cases), 'case')}: {ends}")
    failed = []
    for i, *values, message in (row for row in table if measured[row[0]]["status"] != DONE):
        varied = ", ".join(f"{name} = {value:g}" for name, value in zip(scene_sweep.names, values, strict=False))
        failed.append(f"case {i} ({varied}): {message}")
    for line in output.first(failed, MOST_SHOWN, "and {} more"):
        output.paragraph(line, indent="  ", hanging="  ")
    if complete:
        output.print_written(out)
    else:
        print(f"interrupted; the same command continues from {partial}" if out else "interrupted")
    return code


def _print(names, table, done):
    """Print the table without velocities and messages; with status and end time only if some cases are not done."""
    without = ("message", *(("status", "t") if done else ()))
    shown = [k for k, name in enumerate(names) if not name.startswith("v.") and name not in without]
    digits = {"status": "", "gap": ">.3g", "energy_error": ">.3g"}
    heads = [names[k] + digits.get(names[k], ">.6g") for k in shown]
    output.table(heads, [["" if row[k] is None else row[k] for k in shown] for row in table])
