"""How robots assemble and run: ``python -m benchmarks robots``."""

from __future__ import annotations

import time
import warnings
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import pinocchio as pin
import typer

from pinconsist import AssemblyError, InputError, PinconsistError, assemble, load, simulate
from pinconsist.cli import output
from pinconsist.cli.scene import option
from pinconsist.formats.catalogue import is_built_in

from . import report

SLIDING = ("cylinder", "slider", "plane")


@dataclass(frozen=True)
class Assemblies:
    """How often the loops of a robot close."""

    from_neutral: bool  # from q = 0
    closed: int  # of those tried from random guesses: each velocity coordinate of q = 0 moved by up to 1 rad or m
    tried: int
    time: float  # median wall time of those that closed, s


@dataclass(frozen=True)
class RobotRun:
    """One robot, released from rest under gravity."""

    robot: str
    closure: str  # how its loops are closed: "as written", "point" or "re-anchored"
    rtol: float  # 0 for the default tolerances
    status: str  # "done", or the message of a failure
    assembly: Assemblies
    steps: int = 0
    gap: float = np.nan  # largest error of the distance of two anchors, by forward kinematics, m; none slides
    energy_error: float = np.nan  # of the largest kinetic energy
    step_time: float = np.nan  # wall time of an accepted step, s


def robots(source, until=0.5, tolerances=(None, 1e-7), tries=20):
    """Assemble robots from `tries` random guesses, and simulate them from rest; yields a :class:`RobotRun` at a time.

    `source` is a folder with one sub-folder for each robot, or a robot that :func:`pinconsist.load` knows by name. One
    whose loops cannot close as written is run with point closures and re-anchored. A tolerance of None means the
    default ones.
    """
    if isinstance(source, str) and is_built_in(source):
        found = {source: source}
    else:
        found = {path.parent.name: path.parent for path in sorted(Path(source).glob("*/*.urdf"))}
    if not found:
        raise InputError(f"no folder with a .urdf file in {source}")
    for name, path in found.items():
        for closure, mech in _variants(path):
            closing = assemblies(mech, tries)
            for tol in tolerances:
                yield _run(name, closure, mech, tol, until, closing)


def assemblies(mech, tries, seed=0) -> Assemblies:
    """Assemble a mechanism from q = 0 and from random guesses around it."""
    rng, neutral, times = np.random.default_rng(seed), pin.neutral(mech.model), []

    def closes(q):
        start = time.perf_counter()
        try:
            assemble(mech, q)
        except AssemblyError:
            return False
        times.append(time.perf_counter() - start)
        return True

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # loops of rounded files that close to some nm only
        from_neutral = closes(neutral)
        times.clear()
        closed = sum(closes(pin.integrate(mech.model, neutral, rng.uniform(-1.0, 1.0, mech.nv))) for _ in range(tries))
    return Assemblies(from_neutral, closed, tries, float(np.median(times)) if times else np.nan)


def _variants(path):
    mech = load(path)
    try:
        assemble(mech)
    except AssemblyError:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # `check` reports which anchors move
            return [("point", load(path, closure="point")), ("re-anchored", mech.reanchored())]
    return [("as written", mech)]


def _run(name, closure, mech, tol, until, closing):
    options = {} if tol is None else {"rtol": tol, "atol": tol}
    start = time.perf_counter()
    try:
        sol = simulate(mech, (0.0, until), **options)
    except PinconsistError as error:
        return RobotRun(name, closure, tol or 0.0, str(error), closing)
    elapsed = time.perf_counter() - start
    figures = sol.nsteps, _largest_gap(mech, sol.q), sol.check().energy_error, elapsed / max(sol.nsteps, 1)
    return RobotRun(name, closure, tol or 0.0, "done" if sol.success else sol.message, closing, *figures)


def _largest_gap(mech, configurations) -> float:
    model, data, gap = mech.model, mech.model.createData(), 0.0
    loops = [loop for loop in mech.anchored_loops if loop.kind not in SLIDING]
    for q in configurations:
        pin.framesForwardKinematics(model, data, q)
        for loop in loops:
            ends = [
                (data.oMf[model.getFrameId(frame)] * place).translation
                for frame, place in ((loop.frame1, loop.placement1), (loop.frame2, loop.placement2))
            ]
            gap = max(gap, abs(float(np.linalg.norm(ends[1] - ends[0])) - (loop.length or 0.0)))
    return gap


# fmt: off
def command(
    source: Annotated[list[str], typer.Argument(metavar="FOLDER|NAME ...", help=(
        "Folders with a sub-folder for each robot; robots by name, such as cassie."))],
    until: Annotated[float, option("--until", "SECONDS", "Simulated time.")] = 0.5,
    csv: report.Csv = None,
    as_json: output.Json = False,
) -> int:
    # fmt: on
    """Assemble robots from q = 0 and from 20 random guesses, and let them fall from rest.

    Example: python -m benchmarks robots robots/ cassie
    """
    output.require_writable(csv=csv)
    rows = [asdict(row) for each in source for row in robots(each, until)]
    flat = [row | row.pop("assembly") for row in map(dict, rows)]
    if report.in_files(csv, as_json, flat, robots=rows):
        return output.FINE
    which = ["robot", ("loops", "{closure}")]
    columns = [
        ("from q = 0", lambda row: "closed" if row["from_neutral"] else "open"),
        ("from random guesses>", "{closed}/{tried}"),
        ("median time [ms]>", report.scaled("time", 1e3)),
    ]
    each = {(row["robot"], row["closure"]): row | row["assembly"] for row in rows}.values()
    report.table(each, which + columns, "assembly from q = 0 and from random guesses within 1 rad of it")
    columns = [
        ("rtol", lambda row: f"{row['rtol']:g}" if row["rtol"] else "default"),
        "steps>",
        ("largest gap [m]>", "{gap:.1e}"),
        ("energy error>", "{energy_error:.1e}"),
        ("step [us]>", report.scaled("step_time", 1e6, 0)),
        ("outcome", "{status}"),
    ]
    report.table(rows, which + columns, f"robots released from rest, {until:g} s")
    return output.FINE
