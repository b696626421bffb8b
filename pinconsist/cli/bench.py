"""`pinconsist bench`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from . import output


def bench(
    overhead: Annotated[
        bool, typer.Option("--overhead", help="Time of a step beside the bare Pinocchio calls of one residual.")
    ] = False,
    robots: Annotated[
        Path | None, typer.Option("--robots", metavar="FOLDER", help="Let every robot of FOLDER fall from rest.")
    ] = None,
    until: Annotated[float, typer.Option(help="How long the robots fall, s.")] = 0.5,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object instead of tables.")] = False,
) -> int:
    """Measure run time and accuracy on this machine. Pin the threads first: OMP_NUM_THREADS=1.

    Example: pinconsist bench --overhead --robots robots/
    """
    from ..errors import InputError
    from ..study import bench as study

    if not overhead and robots is None:
        raise InputError("nothing to measure: say --overhead, --robots FOLDER, or both")
    results = {"machine": output.machine()}
    if overhead:
        results["overhead"] = [asdict(row) for row in study.overhead()]
    if robots is not None:
        results["robots"] = [asdict(row) for row in study.robots(robots, until)]
    if as_json:
        output.print_json(results)
        return output.FINE
    print(results["machine"] + "\n")
    if overhead:
        _print_overhead(results["overhead"])
    if robots is not None:
        _print_robots(results["robots"], until)
    return output.FINE


def _print_overhead(rows):
    output.table(
        ("rtol", "steps>", "residuals/step>", "step [us]>", "bare calls [us]>", "ratio>"),
        [
            (f"{row['rtol']:g}", row["steps"], f"{row['residuals']:.2f}", f"{1e6 * row['step_time']:.1f}",
             f"{1e6 * row['bare_time']:.2f}", f"{row['ratio']:.1f}")
            for row in rows
        ],
        title="crank-rocker, 5 s from 12 rad/s: a step beside rnea + joint Jacobians + constraint + its Jacobian",
    )  # fmt: skip


def _print_robots(rows, until):
    output.table(
        ("robot", "loops", "rtol", "steps>", "largest gap [m]>", "energy error>", "step [us]>", "outcome"),
        [
            (row["robot"], row["closure"], f"{row['rtol']:g}" if row["rtol"] else "default", row["steps"],
             f"{row['gap']:.1e}", f"{row['energy_error']:.1e}", f"{1e6 * row['step_time']:.0f}", row["status"])
            for row in rows
        ],
        title=f"robots released from rest, {until:g} s",
    )  # fmt: skip
