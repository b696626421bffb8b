"""What a step of Radau IIA costs by each instruction set: ``python -m benchmarks lanes``."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import Annotated

import numpy as np
import typer

from pinconsist import InputError, assemble, load
from pinconsist.cli import output
from pinconsist.engine import required
from pinconsist.mechanism.system import MechanismSystem
from pinconsist.run.integrate import integrate
from pinconsist.run.options import Options
from pinconsist.run.output import Output
from pinconsist.run.steppers import stepper_for

from . import report

SCENES = {
    "crank_rocker": 10.0, "four_bar": 6.0, "andrews": 0.05, "delta_robot": 2.0, "stewart_platform": 2.0,
    "five_bar": 4.0, "jansen_leg": 1.0, "chain_20": 1.0, "chain_64": 0.2,
}  # fmt: skip
"""The scenes and how long they run, s."""
ELSEWHERE = 0.5  # s, of any other scene
ONE_BY_ONE = "one by one"


@dataclass(frozen=True)
class Step:
    """A scene by one way of evaluating stages."""

    scene: str
    instructions: str
    step: float  # s of the processor, the least of the rounds, without the start of the run
    ratio: float  # of the time of a step one stage after another to this one
    steps: int
    residuals: int


def measured(scenes=None, repeats: int = 9) -> Iterator[Step]:
    """Run scenes (built-in models or files) from rest, in turn by each way of evaluating the stages of a step.

    Raises InputError for less than one round.
    """
    if repeats < 1:
        raise InputError(f"repeats must be at least 1, got {repeats!r}")
    ways = [ONE_BY_ONE, *required().instruction_sets()]
    for scene in scenes or SCENES:
        mech, until = load(scene), SCENES.get(scene, ELSEWHERE)
        start = assemble(mech)
        system = MechanismSystem(mech, start.q)
        least, runs = np.full(len(ways), np.inf), {}
        for _ in range(repeats):
            for i, way in enumerate(ways):
                seconds, runs[way] = _run(system, start, until, way)
                least[i] = min(least[i], seconds)
        costs = least / [runs[way].nsteps for way in ways]
        for way, cost in zip(ways, costs.tolist(), strict=True):
            yield Step(scene, way, cost, costs[0] / cost, runs[way].nsteps, runs[way].nfev)


def _run(system, start, until, way):
    """(s of the processor, trajectory) of a run, less a run of one tiny step."""
    required().use_instruction_set("" if way == ONE_BY_ONE else way)
    try:
        seconds = []
        for span in ((0.0, 1e-9 * until), (0.0, until)):
            method = Options("Radau").for_span(span)
            method = replace(method, switches=replace(method.switches, lanes=way != ONE_BY_ONE))
            begun = time.process_time()
            run = integrate(system, span, start.q, start.v, method, Output(), stepper_for(system, method))
            seconds.append(time.process_time() - begun)
    finally:
        required().use_instruction_set("")
    return seconds[1] - seconds[0], run


def command(
    scene: Annotated[
        list[str] | None, typer.Argument(metavar="[NAME|PATH ...]", help="Default: scenes of every size.")
    ] = None,
    repeats: Annotated[int, typer.Option(metavar="N", help="Rounds, in each of which all ways are run in turn.")] = 9,
    csv: report.Csv = None,
    as_json: output.Json = False,
) -> int:
    """Time a step of Radau IIA by each instruction set of this processor, and with one stage evaluated after another.

    Example: python -m benchmarks lanes crank_rocker
    """
    output.require_writable(csv=csv)
    rows = [asdict(step) for step in measured(scene, repeats)]
    if report.in_files(csv, as_json, rows, lanes=rows):
        return output.FINE
    for name in dict.fromkeys(row["scene"] for row in rows):
        times = ("[µs]>", report.scaled("step", 1e6)), ("ratio>", "{ratio:.2f}")
        columns = ["instructions", *times, "steps>", "residuals>"]
        report.table([row for row in rows if row["scene"] == name], columns, f"{name}: a step of Radau IIA")
    return output.FINE
