"""What a step costs, compared with Pinocchio's own calls, and as a chain grows: ``python -m benchmarks overhead``."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from typing import Annotated

import numpy as np
import pinocchio as pin
import typer
from scipy.linalg.lapack import dgesv

from pinconsist import assemble, load, simulate
from pinconsist.cli import output
from pinconsist.cli.scene import option
from pinconsist.mechanism.rows import AnchoredRows
from pinconsist.mechanism.system import MechanismSystem
from pinconsist.run.options import Options
from pinconsist.run.steppers import stepper_for

from . import report
from .against import against
from .around import SCENE, START, around

CHAINS = {8: 1.0, 32: 1.0, 64: 1.0, 128: 1.0, 256: 1.0}  # links → s


@dataclass(frozen=True)
class Overhead:
    """A step and the bare Pinocchio calls of one residual: medians of wall times, s."""

    rtol: float
    steps: int  # accepted
    residuals: float  # per accepted step
    step_time: float
    run_time: float  # of the whole run, assembly and start included, divided by its steps
    bare_time: float  # of rnea, computeJointJacobians, constraint calc and Jacobian, called from Python
    least_time: float  # the same and computeRNEADerivatives, and dgesv of the KKT matrix for three right-hand sides
    ratio: float  # of a step to the bare calls, measured alternately


def overhead(scene=SCENE, tolerances=(1e-6, 1e-7, 1e-8), repeats=9) -> list[Overhead]:
    """Measure a scene against the bare calls on its model, alternately: the crank-rocker for 5 s from 12 rad/s, other
    scenes from rest for a tenth of their duration.
    """
    mech = load(scene)
    span, *start = START if scene == SCENE else ((0.0, 0.1 * mech.duration), None, None)
    begin = assemble(mech, *start)
    system = MechanismSystem(mech, begin.q)
    rows = []
    for tol in tolerances:
        times = []
        for _ in range(repeats):
            begun = time.perf_counter()
            sol = simulate(mech, span, *start, method="BDF", rtol=tol, atol=tol)
            run = (time.perf_counter() - begun) / sol.nsteps
            steps, seconds = _steps(system, begin, span[1], tol)
            times.append((seconds / steps, run, *_bare_calls(system, begin.q)))
        step, run, bare, least = np.array(times).T
        medians = map(float, np.median((step, run, bare, least, step / bare), axis=1))
        rows.append(Overhead(tol, sol.nsteps, sol.nfev / sol.nsteps, *medians))
    return rows


def _bare_calls(system, q, count=2000) -> tuple[float, float]:
    """Seconds that Pinocchio's calls of one residual take, and the same with derivatives and LAPACK's solution."""
    model, data, v, a = system.model, system.data, np.ones(system.nv), np.ones(system.nv)
    closures = [each for each in system.rows.closures if isinstance(each, AnchoredRows)]
    ends = [(each.joint1, each.place1, each.joint2, each.place2) for each in closures]
    constraints = [pin.PointAnchorConstraintModel(model, *each) for each in ends]
    pairs = [(constraint, constraint.createData()) for constraint in constraints]
    matrix = np.asfortranarray(np.eye(system.nv + system.nc) + 0.1)
    sides = np.ones((len(matrix), 3), order="F")
    start = time.perf_counter()
    for _ in range(count):
        pin.rnea(model, data, q, v, a)
        pin.computeJointJacobians(model, data, q)
        for constraint, constraint_data in pairs:
            constraint.calc(model, data, constraint_data)
            constraint.jacobian(model, data, constraint_data)
    bare = time.perf_counter()
    for _ in range(count):
        pin.computeRNEADerivatives(model, data, q, v, a)
        dgesv(matrix, sides)
    return (bare - start) / count, (time.perf_counter() - start) / count


@dataclass(frozen=True)
class ChainStep:
    """Median time of an accepted step of a hanging chain, its start not counted, s."""

    links: int
    steps: int
    step_time: float


def chain_steps(chains=None, repeats=3) -> list[ChainStep]:
    """Measure the steps of ``chain_<n>``, released from rest, at tolerance 1e-6."""
    rows = []
    for links, until in (chains or CHAINS).items():
        mech = load(f"chain_{links}")
        start = assemble(mech)
        system = MechanismSystem(mech, start.q)
        found = [_steps(system, start, until) for _ in range(repeats)]
        steps, seconds = found[0][0], np.median([seconds for _, seconds in found])
        rows.append(ChainStep(links, steps, float(seconds / steps)))
    return rows


def _steps(system, start, until, tol=1e-6) -> tuple[int, float]:
    """Accepted steps, and the seconds that they took."""
    span = (0.0, until)
    method = Options("BDF", rtol=tol, atol=tol).for_span(span)
    stepper = stepper_for(system, method)
    stepper.place(0.0, start.q, start.v)
    steps, begun = 0, time.perf_counter()
    while stepper.t != until:
        made = stepper.advance(until)
        if made.why:
            raise RuntimeError(made.why)
        steps += stepper.read().steps
    return steps, time.perf_counter() - begun


# fmt: off
def command(
    scene: Annotated[list[str] | None, typer.Argument(metavar="[NAME|PATH ...]", help=(
        "Default: the crank-rocker, and chains of 8 to 256 links; with --against four scenes."))] = None,
    other: Annotated[str | None, option(
        "--against", "PYTHON", "Time compiled runs in turn with those of the pinconsist that this interpreter imports, "
        "such as that of another checkout, instead.")] = None,
    csv: report.Csv = None,
    as_json: output.Json = False,
) -> int:
    # fmt: on
    """Time a step against the bare Pinocchio calls of one residual, and what is done around the steps of a run.

    Steps of chains go to FILE_chains.csv, what stands around a run to FILE_around.csv.

    Example: python -m benchmarks overhead crank_rocker andrews
    """
    output.require_writable(csv=csv)
    if other:
        return _against(other, scene, csv, as_json)
    results = {name: [asdict(row) for row in overhead(name)] for name in scene or [SCENE]}
    chains = [] if scene else [asdict(row) for row in chain_steps()]
    besides = [] if scene else [asdict(row) for row in around()]
    if csv:
        report.write_csv(report.beside(csv, "chains"), chains)
        report.write_csv(report.beside(csv, "around"), besides)
    more = {"chains": chains, "around": besides} if chains else {}
    every = [{"scene": name} | row for name, rows in results.items() for row in rows]
    if report.in_files(csv, as_json, every, overhead=results, **more):
        return output.FINE
    for name, rows in results.items():
        _print_overhead(name, rows)
    output.paragraph(
        "run/steps: the whole run, assembly and start included; K⁻¹: computeRNEADerivatives and LAPACK's dgesv, "
        "which a step with a Newton matrix of its own needs besides; step/bare: the median over runs made in turn"
    )
    print()
    if chains:
        _print_chains(chains)
        _print_around(besides)
    return output.FINE


def _against(other, scenes, csv, as_json):
    rows = [asdict(row) for row in against(other, scenes)]
    if report.in_files(csv, as_json, rows, against=rows):
        return output.FINE
    times = ("run [ms]>", report.scaled("time", 1e3, 2)), ("other's [ms]>", report.scaled("other_time", 1e3, 2))
    columns = ["scene", "steps>", ("other's>", "{other_steps}"), *times, "ratio>:.3f"]
    report.table(rows, columns, f"compiled runs in turn with those of {other}: ratio below 1, faster than the other")
    return output.FINE


def _print_overhead(name, rows):
    named = {"step": "step_time", "run/steps": "run_time", "bare calls": "bare_time", "with K⁻¹": "least_time"}
    times = [(f"{heading} [us]>", report.scaled(key, 1e6, 2)) for heading, key in named.items()]
    columns = ["rtol>:g", "steps>", ("residuals/step>", "{residuals:.2f}"), *times]
    start = "5 s from 12 rad/s" if name == SCENE else "from rest"
    title = f"{name}, {start}: a step, and rnea + joint Jacobians + constraint + its Jacobian"
    report.table(rows, [*columns, ("step/bare>", "{ratio:.2f}")], title)


def _print_chains(rows):
    def growth(row, name):
        return row[name] / rows[0][name]

    times = [
        ("step [us]>", report.scaled("step_time", 1e6)),
        ("over the shortest>", lambda row: f"{growth(row, 'step_time'):.1f}"),
        ("over linear>", lambda row: f"{growth(row, 'step_time') / growth(row, 'links'):.2f}"),
    ]
    title = "hanging chains from rest, 1 s at 1e-6: a step, the start not counted"
    report.table(rows, ["links>", "steps>", *times], title)


def _print_around(rows):
    columns = [
        "scene", "method", ("", "{what}"),
        ("process [ms]>", report.scaled("seconds", 1e3, 2)), ("over the run>", "{ratio:.2f}"),
        ("wall [ms]>", report.scaled("wall", 1e3, 2)), ("over it>", "{wall_ratio:.2f}"),
    ]  # fmt: skip
    report.table(rows, columns, title="compiled runs, least times in turn: the run, and what is asked for besides")
