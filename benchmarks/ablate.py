"""What is saved by the work that a run skips: ``python -m benchmarks ablate``.

Each variant does one piece of this work, and its time is compared with that of a plain run. What the method does for
speed alone has a switch; the rest is requested. That dependent and zero rows leave the system cannot be switched off:
with them the Newton matrix is singular.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Annotated

import numpy as np
import typer

from pinconsist import Event, InputError, assemble, load
from pinconsist.cli import output
from pinconsist.engine import constant
from pinconsist.mechanism.system import MechanismSystem
from pinconsist.run.control import Switches
from pinconsist.run.integrate import integrate
from pinconsist.run.options import Options
from pinconsist.run.output import Output
from pinconsist.run.steppers import stepper_for
from pinconsist.view.visuals import visuals

from . import report
from .constants import worths
from .rules import rules

SCENES = {"crank_rocker": 2.0, "andrews": 0.02, "bricard": 4.0, "delta_robot": 0.5, "chain_8": 1.0, "chain_64": 1.0}
"""The scenes and how long they run, s."""
ELSEWHERE = 0.5  # s, of any other scene


@dataclass(frozen=True)
class Variant:
    """A run that skips one piece of work less."""

    name: str
    off: str = ""  # the switch that is off
    output: Output = field(default_factory=Output)  # what is requested
    before: Callable = lambda mechanism: None  # what is read first
    concerns: Callable[[MechanismSystem], bool] = lambda system: True  # else the variant changes nothing


def _switched_off(switch):
    """The compiled method without one of its switches, where the size of the system lets it act."""
    concerns = {
        "jacobian_reuse": lambda system: system.nv >= constant("WORTH"),
        "kept_derivatives": lambda system: system.nv < constant("WORTH"),
    }
    name = f"{switch.replace('_', ' ')} off"
    return Variant(name, off=switch, concerns=concerns.get(switch, Variant.concerns))


PLAIN = Variant("nothing switched off")
VARIANTS = (
    PLAIN,
    *(_switched_off(switch.name) for switch in fields(Switches)),
    Variant("dense output", output=Output(dense=True)),
    Variant("an event", output=Output(events=(Event(lambda t, q, v, lam: t + 1.0),))),
    Variant("a callback", output=Output(callback=lambda *args: False)),
    Variant("geometry", before=visuals, concerns=lambda system: system.mechanism.geometry is not None),
)


@dataclass(frozen=True)
class Cost:
    """A scene with one variant: medians of the rounds, in the time of the processor."""

    scene: str
    variant: str
    ratio: float  # of its time, assembly and start included, to that of the plain run
    time: float  # s
    steps: int  # accepted
    residuals: int
    matrices: int


def ablate(scenes=None, repeats: int = 7) -> Iterator[Cost]:
    """Run each variant on scenes (built-in models or files); yields a :class:`Cost` for each, the plain run first.

    In each of the rounds all variants run one after the other. Raises InputError for less than one round.
    """
    if repeats < 1:
        raise InputError(f"repeats must be at least 1, got {repeats!r}")
    for scene in scenes or SCENES:
        mech, until = load(scene), SCENES.get(scene, ELSEWHERE)
        system = MechanismSystem(mech, assemble(mech).q)
        variants = [variant for variant in VARIANTS if variant.concerns(system)]
        rounds = [[timed_run(mech, until, variant) for variant in variants] for _ in range(repeats + 1)]
        times = np.array([[seconds for seconds, _ in runs] for runs in rounds[1:]])  # the first warms up
        for variant, own, (_, run) in zip(variants, times.T, rounds[-1], strict=True):
            base = times[:, variants.index(PLAIN)]
            ratio, seconds = float(np.median(own / base)), float(np.median(own))
            yield Cost(scene, variant.name, ratio, seconds, run.nsteps, run.nfev, run.njev)


def timed_run(mech, until, variant, tol=1e-6, atol=1e-8):
    """(s of the processor, trajectory) of a run from rest."""
    begun, span = time.process_time(), (0.0, until)
    variant.before(mech)
    start = assemble(mech)
    system = MechanismSystem(mech, start.q)
    method = Options("BDF", rtol=tol, atol=atol).for_span(span)
    if variant.off:
        method = replace(method, switches=replace(method.switches, **{variant.off: False}))
    stepper = stepper_for(system, method)
    run = integrate(system, span, start.q, start.v, method, variant.output, stepper)
    return time.process_time() - begun, run


def command(
    scene: Annotated[
        list[str] | None, typer.Argument(metavar="[NAME|PATH ...]", help="Default: one scene of every kind.")
    ] = None,
    repeats: Annotated[int, typer.Option(metavar="N", help="Rounds, in each of which all variants run in turn.")] = 3,
    constants: Annotated[
        bool, typer.Option("--constants", help="Halve and double each constant of the method.")
    ] = False,
    by_rules: Annotated[
        bool, typer.Option("--rules", help="Switch off each rule of the method by its constant.")
    ] = False,
    csv: report.Csv = None,
    as_json: output.Json = False,
) -> int:
    """Do each piece of work that a run skips, in turn, and print what it costs; or change each constant of the method.

    Example: python -m benchmarks ablate crank_rocker
    """
    output.require_writable(csv=csv)
    if constants:
        return _constants(scene, csv, as_json)
    if by_rules:
        return _rules(csv, as_json)
    rows = [asdict(cost) for cost in ablate(scene, repeats)]
    if report.in_files(csv, as_json, rows, ablate=rows):
        return output.FINE
    for name in dict.fromkeys(row["scene"] for row in rows):
        times = ("time>", "{ratio:.2f}"), ("[ms]>", report.scaled("time", 1e3))
        columns = ["variant", *times, "steps>", "residuals>", "matrices>"]
        own = [row for row in rows if row["scene"] == name]
        report.table(own, columns, f"{name}: time over that of the plain run")
    return output.FINE


def _rules(csv, as_json) -> int:
    rows = [asdict(row) for row in rules()]
    if report.in_files(csv, as_json, rows, rules=rows):
        return output.FINE
    columns = [
        "method",
        "constant",
        ("off>", "{off:g}"),
        ("changed>", "{changed} of {runs}"),
        ("steps>", "{steps:.3f}"),
    ]
    columns += [("most>", "{most:.2f}"), ("error>", "{error:.2g}"), "where", "failures"]
    report.table(rows, columns, "Rules switched off: steps and errors over those with them")
    return output.FINE


def _constants(scenes, csv, as_json) -> int:
    rows = [asdict(row) for row in worths({name: SCENES.get(name, ELSEWHERE) for name in scenes or SCENES})]
    if report.in_files(csv, as_json, rows, constants=rows):
        return output.FINE
    columns = ["constant", "value>", ("x>", "{factor:g}"), ("work>", "{work:.2f}"), ("most>", "{most:.2f}"), "where"]
    columns += [("error>", "{error:.2g}"), ("before>", "{error_before:.2g}")]
    report.table(
        rows, columns, "Constants halved and doubled: residuals over those without; largest error, in tolerances"
    )
    return output.FINE
