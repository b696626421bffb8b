"""Derivatives of runs: their accuracy, their cost, and what they do for a fit: ``python -m benchmarks gradients``."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import asdict, dataclass

import numpy as np

from pinconsist import Event, MissingExtraError, gradient, load, sensitivities, simulate
from pinconsist.cli import output
from pinconsist.gradients.passes import NO_VARIANT
from pinconsist.gradients.prepare import prepared
from pinconsist.gradients.variants import Variants

from . import report
from .gradient_fit import fits
from .gradient_reference import SIX, differences, slopes, worst
from .gradient_scenes import SCENES, long_chain, swung

TOLERANCES = (1e-6, 1e-8)


@dataclass(frozen=True)
class Accuracy:
    """The largest errors of dq, dv and dλ over their largest values, of the worst parameter.

    `back` is by how much the derivative of a random number of the run, found backwards, differs from that found
    forwards, relative.
    """

    scene: str
    rtol: float
    steps: int
    dq: float
    dv: float
    dlam: float
    back: float


def accuracy(scenes=tuple(SCENES), tolerances=TOLERANCES) -> list[Accuracy]:
    """Each scene at each tolerance, against differences of reference runs."""
    rows = []
    for name, scene, mech in _made(scenes):
        times = np.linspace(0.0, scene.until, scene.rows)
        exact = differences(mech, scene.names, times, None, scene.v0, scene.relative, SIX)
        for rtol in tolerances:
            run = {"t_eval": times, "rtol": rtol, "atol": rtol}
            found = sensitivities(mech, scene.names, (0.0, scene.until), None, scene.v0, **run)
            parts, others = (found.dq, found.dv, found.dlam), exact
            if scene.nearly_dependent:
                parts, others = ((*each[:2], _forces(found, each[2])) for each in (parts, others))
            back = _backwards(mech, scene, found, run)
            rows.append(Accuracy(name, rtol, found.solution.nsteps, *worst(parts, others), back))
    return rows


def _made(names):
    """(name, scene, mechanism) of the scenes whose files are installed."""
    for name in names:
        with suppress(MissingExtraError):
            yield name, SCENES[name], SCENES[name].make()


def _forces(found, dlam):
    """Jᵀ dλ"""
    loops = found._legs[0].system.loop_rows
    return np.array([loops(q)[1].T @ rows for q, rows in zip(found.solution.q, dlam, strict=True)])


def _backwards(mech, scene, found, run):
    """How far derivatives found backwards are from those found forwards, relative, of the worst parameter.

    Multipliers of nearly dependent rows nearly cancel: there relative to the sizes of what is summed up.
    """
    rng, times, parts = np.random.default_rng(0), run["t_eval"], (found.dq, found.dv, found.dlam)
    weights = [rng.normal(size=part.shape[:2]) / np.abs(part).max() for part in parts]
    if scene.nearly_dependent:
        forces, loops = _forces(found, found.dlam), found._legs[0].system.loop_rows
        ways = rng.normal(size=forces.shape[:2]) / np.abs(forces).max()
        weights[2] = np.array([loops(q)[1] @ way for q, way in zip(found.solution.q, ways, strict=True)])

    def by_state(t, q, v, lam):
        return [part[np.argmin(np.abs(times - t))] for part in weights]

    rows = (lambda t, q, v, lam: 0.0), by_state
    back = gradient(mech, scene.names, (0.0, scene.until), None, scene.v0, rows=rows, **run).gradient
    terms = [weight[..., None] * part for weight, part in zip(weights, parts, strict=True)]
    exact, sizes = (sum(each.sum(axis=(0, 1)) for each in some) for some in (terms, map(np.abs, terms)))
    return float((np.abs(back - exact) / (sizes if scene.nearly_dependent else np.abs(exact))).max())


@dataclass(frozen=True)
class Occurrences:
    """The largest errors of derivatives of event times, and of dq after a jump, over their largest values."""

    rtol: float
    jump: float
    load: float
    dq: float


def events(tolerances=TOLERANCES) -> list[Occurrences]:
    """A crank-rocker whose crank loses speed at an angle, which is a parameter, and whose pin is overloaded later."""
    mech, v0, times = load("crank_rocker"), {"crank": 12.0}, np.linspace(0.0, 0.2, 5)
    theta, run = np.array([1.4, 2.1]), {"v0": v0, "t_eval": times}

    def build(theta):
        return mech.with_parameters({"mass:coupler": theta[0]})

    def happens(theta):
        jump = Event(lambda t, q, v, lam: q[0] - theta[1], apply=lambda t, q, v: 0.8 * v, name="jump")
        return [jump, Event(lambda t, q, v, lam: lam[0] - 5.0, name="load")]

    def beside(moved):
        sol = simulate(build(moved), (0.0, 0.2), events=happens(moved), rtol=1e-12, atol=1e-12, **run)
        return [*sol.t_events, sol.q]

    exact = slopes(beside, theta, 1e-2)
    rows = []
    for rtol in tolerances:
        run |= {"rtol": rtol, "atol": rtol}
        found = sensitivities(build, theta, (0.0, 0.2), events=happens, **run)
        parts = zip((*found.event_times, found.dq), exact, strict=True)
        errors = (
            max(float(np.abs(part[..., i] - other[..., i]).max() / np.abs(other[..., i]).max()) for i in range(2))
            for part, other in parts
        )
        rows.append(Occurrences(rtol, *errors))
    return rows


@dataclass(frozen=True)
class Cost:
    """Process time of a run, s, and over it that of its derivatives at all steps; s, that of their starts."""

    scene: str
    steps: int
    run: float
    fixed: float
    parameter: float
    start: float
    adjoint: float


def cost(scenes=tuple(SCENES), repeats=5, rtol=1e-8) -> list[Cost]:
    """The run, its derivatives with no parameter of the equations and with all, and all of it, in turn."""
    rows = []
    for name, scene, mech in _made(scenes):
        names, until, v0 = scene.names, scene.until, scene.v0
        run = {"rtol": rtol, "atol": 1e-2 * rtol}
        solution, legs, variants, base, *_ = prepared(
            mech, names, (0.0, until), None, v0, None, None, (), None, rtol, 1e-2 * rtol, {}
        )
        moving = sum(not variant.inert for variant in variants)
        still = Variants(("",), np.ones(1), base, {0: NO_VARIANT}, [], None)

        def steps(parameters, legs=legs, base=base):
            for leg in legs:
                residuals = parameters.residuals(leg.system)
                start = np.zeros((len(residuals), leg.system.nx + leg.system.nv))
                leg.follow(base.index1(leg.system), residuals, start)
                leg.at(leg.t)

        def back(legs=legs, base=base):
            for leg in legs:
                system, seeds = leg.system, leg.seeds()
                leg.add_seeds(leg.t, np.ones((len(leg.t), system.nx + system.nv + system.nc)), seeds)
                leg.follow_back(base.index1(system), [], seeds)

        work = {
            "run": lambda mech=mech, until=until, v0=v0, run=run: simulate(
                mech, (0.0, until), v0=v0, method="Radau", **run
            ),
            "fixed": lambda still=still: steps(still),
            "all": lambda variants=variants: steps(variants),
            "whole": lambda m=mech, n=names, u=until, v=v0, run=run: sensitivities(m, n, (0.0, u), None, v, **run),
            "back": back,
        }
        least = {name: times.process for name, times in report.least_times(work, repeats).items()}
        once, fixed = least["run"], least["fixed"]
        each = (least["all"] - fixed) / moving / once
        start = (least["whole"] - once - least["all"]) / len(names)
        rows.append(Cost(name, solution.nsteps, once, fixed / once, each, start, least["back"] / once))
    return rows


@dataclass(frozen=True)
class Many:
    """Process time of a run, s, and over it that of the derivative of one number by many parameters, with the run."""

    scene: str
    parameters: int
    steps: int
    run: float
    gradient: float


def many(scenes=(swung, long_chain), repeats=5, rtol=1e-8) -> list[Many]:
    """The run and its gradient in turn."""
    rows = []
    for scene in scenes:
        mech, names, until = scene()
        run, unit = {"rtol": rtol, "atol": 1e-2 * rtol}, np.eye(mech.nv)[0]
        end = (lambda t, q, v, lam: q[0]), (lambda t, q, v, lam, unit=unit: (unit, 0.0, 0.0))
        work = {
            "run": lambda mech=mech, until=until, run=run: simulate(mech, (0.0, until), method="Radau", **run),
            "all": lambda m=mech, n=names, u=until, end=end, run=run: gradient(m, n, (0.0, u), terminal=end, **run),
        }
        steps, least = simulate(mech, (0.0, until), method="Radau", **run).nsteps, report.least_times(work, repeats)
        once, whole = least["run"].process, least["all"].process
        rows.append(Many(scene.__name__, len(names), steps, once, whole / once))
    return rows


# fmt: off
def command(csv: report.Csv = None, as_json: output.Json = False) -> int:
    # fmt: on
    """Measure derivatives of runs: accuracy against differences of DOP853 runs, cost, and a fit with them.

    Example: python -m benchmarks gradients
    """
    output.require_writable(csv=csv)
    measured = accuracy(), events(), cost(), many(), fits(TOLERANCES)
    exact, happened, costs, backwards, fit = ([asdict(row) for row in rows] for rows in measured)
    tables = {"accuracy": exact, "events": happened, "cost": costs, "many": backwards, "fits": fit}
    if report.in_files(csv, as_json, exact, **tables):
        return output.FINE
    errors = ["scene", "rtol>:.0e", "steps>", "dq>:.0e", "dv>:.0e", ("dλ>", "{dlam:.0e}")]
    title = "errors over the largest, worst parameter (cassie: Jᵀ dλ); backwards against forwards (cassie: over terms)"
    report.table(exact, [*errors, ("backwards>", "{back:.0e}")], title)
    times = ("time of a jump>", "{jump:.0e}"), ("time of a load>", "{load:.0e}")
    columns: list = ["rtol>:.0e", *times, "dq>:.0e"]
    report.table(happened, columns, "\nthe same of event times, and of dq through a jump")
    columns = ["scene", "steps>", ("run [ms]>", report.scaled("run", 1e3, 1))]
    columns += [("fixed part>", "{fixed:.2f}"), ("per parameter>", "{parameter:.2f}"), ("backwards>", "{adjoint:.2f}")]
    columns += [("start of one [ms]>", report.scaled("start", 1e3, 1))]
    report.table(costs, columns, "\nprocess time of derivatives at all steps over that of the run, rtol 1e-8")
    columns = ["scene", "parameters>:,", "steps>:,"]
    columns += [("run [ms]>", report.scaled("run", 1e3, 1)), "gradient>:.1f"]
    report.table(backwards, columns, "\nprocess time of run and gradient of one number over that of the run, rtol 1e-8")
    columns = ["way", "rtol>:.0e", ("χ²>", "{chi2:.2f}"), ("from optimum [σ]>", "{apart:.4f}")]
    columns += ["runs>", ("time [s]>", "{seconds:.2f}")]
    report.table(fit, columns, "\nfit of three parameters to 120 noisy angles")
    return output.FINE
