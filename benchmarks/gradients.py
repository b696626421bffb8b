"""Derivatives of runs: their accuracy, their cost, and what they do for a fit: ``python -m benchmarks gradients``."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from itertools import product

import numpy as np
from scipy.optimize import least_squares

from pinconsist import (
    Actuator,
    Drive,
    JointDamping,
    JointSpring,
    Motion,
    gradient,
    load,
    sensitivities,
    simulate,
)
from pinconsist.cli import output
from pinconsist.gradients.adjoint import STILL
from pinconsist.gradients.sensitivities import prepared
from pinconsist.gradients.varied import Variants

from . import report
from .gradient_reference import differences, worst

TOLERANCES, METHODS, MANY = (1e-6, 1e-8), ("BDF", "Radau"), 1000


def driven():
    """The slider-crank on a curve of time."""
    mech = load("slider_crank")
    return mech.with_loops(*mech.loops, Drive("motor", "crank", Motion(-1.0, 3.0, 0.4, 1.3, 0.2)))


SCENES = {  # mechanism, parameters, end, initial velocity
    "crank_rocker": (
        lambda: load("crank_rocker").with_parameters({"damping:rocker": 0.1}),
        ["mass:coupler", "anchor:rocker_ground.xyz2[0]", "damping:rocker", "crank_speed"],
        0.6,
        {"crank": 12.0},
    ),
    "andrews": (
        lambda: load("andrews"), ["stiffness:D-stage", "torque beta.beta", "mass:beta", "E3.xyz2[0]"], 0.01, None
    ),
    "delta_robot": (
        lambda: load("delta_robot"),
        ["stiffness:leg1_arm", "servo leg1_arm.amplitude", "mass:platform_roll", "leg1_left.xyz2[1]"],
        0.1,
        None,
    ),
    "bricard": (
        lambda: load("bricard").with_parameters({"damping:hinge0": 0.05}),
        ["mass:hinge2", "damping:hinge0", "gravity[2]"],
        2.5,
        None,
    ),
    "slider_crank": (driven, ["motor.amplitude", "motor.frequency", "length:rod"], 0.6, None),
    "stewart_platform": (
        lambda: load("stewart_platform"),
        ["mass:platform_pose", "stiffness:leg1_length", "anchor:leg2.xyz2[0]"],
        0.05,
        None,
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Accuracy:
    """The largest errors of dq, dv and dλ over their largest values, of the worst parameter."""

    scene: str
    method: str
    rtol: float
    steps: int
    dq: float
    dv: float
    dlam: float


def accuracy(scenes=tuple(SCENES), tolerances=TOLERANCES) -> list[Accuracy]:
    """Each scene at each tolerance, against differences of reference runs."""
    rows = []
    for scene in scenes:
        make, names, until, v0 = SCENES[scene]
        mech, times = make(), np.linspace(0.0, until, 9)
        exact = differences(mech, names, times, None, v0)
        for method, rtol in product(METHODS, tolerances):
            run = {"t_eval": times, "method": method, "rtol": rtol, "atol": rtol}
            found = sensitivities(mech, names, (0.0, until), None, v0, **run)
            errors = worst((found.dq, found.dv, found.dlam), exact)
            rows.append(Accuracy(scene, method, rtol, found.solution.nsteps, *errors))
    return rows


@dataclass(frozen=True)
class Cost:
    """Process time of a run, s, and over it that of its derivatives at all steps; s, that of their starts."""

    scene: str
    method: str
    steps: int
    run: float
    fixed: float
    parameter: float
    start: float
    adjoint: float


def cost(scenes=tuple(SCENES), repeats=5, rtol=1e-8) -> list[Cost]:
    """The run, its derivatives with no parameter of the equations and with all, and all of it, in turn."""
    rows = []
    for scene, method in product(scenes, METHODS):
        make, names, until, v0 = SCENES[scene]
        mech, run = make(), {"rtol": rtol, "atol": 1e-2 * rtol, "method": method}
        solution, legs, variants, base, *_ = prepared(
            mech, names, (0.0, until), None, v0, None, None, (), None, rtol, 1e-2 * rtol, "auto", {"method": method}
        )
        moving = sum(not variant.inert for variant in variants)
        still = Variants(("",), np.ones(1), base, {0: STILL}, [], None)

        def steps(parameters, legs=legs, base=base):
            for leg in legs:
                residuals, (lines, columns) = parameters.residuals(leg.system), leg.seeds()[0].shape
                leg.follow(base.index1(leg.system), residuals, np.zeros((lines, len(residuals), columns)))
                leg.at(leg.t, 1.0)

        def back(legs=legs, base=base):
            for leg in legs:
                system, seeds = leg.system, leg.seeds()
                leg.sow(leg.t, np.ones((len(leg.t), system.nx + system.nv + system.nc)), seeds, 1.0)
                leg.follow_back(base.index1(system), [], seeds)

        work = {
            "run": lambda mech=mech, until=until, v0=v0, run=run: simulate(mech, (0.0, until), v0=v0, **run),
            "fixed": lambda still=still: steps(still),
            "all": lambda variants=variants: steps(variants),
            "whole": lambda m=mech, n=names, u=until, v=v0, run=run: sensitivities(m, n, (0.0, u), None, v, **run),
            "back": back,
        }
        least = report.least_times(work, repeats)
        once, fixed = least["run"], least["fixed"]
        each = (least["all"] - fixed) / moving / once
        start = (least["whole"] - once - least["all"]) / len(names)
        rows.append(Cost(scene, method, solution.nsteps, once, fixed / once, each, start, least["back"] / once))
    return rows


def swung():
    """A crank-rocker swung by a torque of 1,000 values, and their names."""
    times = np.linspace(0.0, 2.5, MANY)
    mech = load("four_bar").with_forces(JointDamping({"crank": 0.5}), Actuator("motor", "crank"))
    names = [f"motor.control.values[{i}]" for i in range(MANY)]
    return mech.with_control({"motor": (times, 8.0 * np.sin(4.0 * times))}), names, 2.5


def long_chain():
    """A chain of 100 rods with springs and dampers in its joints, and ten numbers of each rod and its joint."""
    mech = load("chain_100")
    own = *(f"com:{{0}}[{i}]" for i in range(3)), *(f"inertia:{{0}}[{ij}]" for ij in ("xx", "yy", "zz", "xz"))
    kinds = "mass:{0}", *own, "stiffness:{0}", "damping:{0}"
    names = [kind.format(joint) for joint in mech.joints for kind in kinds]
    springs = (JointSpring(joint, 2.0) for joint in mech.joints)
    return mech.with_forces(JointDamping(dict.fromkeys(mech.joints, 0.5)), *springs), names, 0.5


@dataclass(frozen=True)
class Many:
    """Process time of a run, s, and over it that of the derivative of one number by many parameters, with the run."""

    scene: str
    method: str
    parameters: int
    steps: int
    run: float
    gradient: float


def many(scenes=(swung, long_chain), repeats=5, rtol=1e-8) -> list[Many]:
    """The run and its gradient in turn."""
    rows = []
    for scene, method in product(scenes, METHODS):
        mech, names, until = scene()
        run, unit = {"rtol": rtol, "atol": 1e-2 * rtol, "method": method}, np.eye(mech.nv)[0]
        end = (lambda t, q, v, lam: q[0]), (lambda t, q, v, lam, unit=unit: (unit, 0.0, 0.0))
        work = {
            "run": lambda mech=mech, until=until, run=run: simulate(mech, (0.0, until), **run),
            "all": lambda m=mech, n=names, u=until, end=end, run=run: gradient(m, n, (0.0, u), terminal=end, **run),
        }
        steps, least = simulate(mech, (0.0, until), **run).nsteps, report.least_times(work, repeats)
        once = least["run"]
        rows.append(Many(scene.__name__, method, len(names), steps, once, least["all"] / once))
    return rows


@dataclass(frozen=True)
class Fit:
    """A fit of three parameters: χ² where it ended by a run at 1e-10, standard deviations from the optimum, s."""

    way: str
    rtol: float
    chi2: float
    apart: float
    runs: int
    seconds: float


NAMES, TRUE = ["mass:coupler", "damping:rocker", "stiffness:crank"], np.array([1.4, 0.05, 0.5])
GUESS, TIMES, NOISE = np.array([1.8, 0.02, 0.8]), np.linspace(0.0, 2.0, 61)[1:], 2e-3


def fits(tolerances=TOLERANCES) -> list[Fit]:
    """The fit of examples/19_identification.py, with derivatives and with the differences that SciPy makes."""
    mech, speed = load("crank_rocker").with_forces(JointSpring("crank", 0.5)), {"crank": 12.0}

    def angles(x, rtol):
        beside = mech.with_parameters(dict(zip(NAMES, x, strict=True)))
        sol = simulate(beside, (0.0, 2.0), v0=speed, t_eval=TIMES, rtol=rtol, atol=1e-2 * rtol)
        return sol.q[:, [0, 2]].ravel()

    def with_derivatives(rtol, method="BDF"):
        """Functions of x that give angles and their derivatives, by one run for both."""
        last = {}

        def at(x):
            if last.get("x") != tuple(x):
                beside = mech.with_parameters(dict(zip(NAMES, x, strict=True)))
                options = {"t_eval": TIMES, "rtol": rtol, "atol": 1e-2 * rtol, "method": method}
                last.update(x=tuple(x), found=sensitivities(beside, NAMES, (0.0, 2.0), v0=speed, **options))
            return last["found"]

        def derivatives(x):
            return at(x).dq[:, [0, 2]].reshape(-1, len(NAMES)) / NOISE

        return lambda x: at(x).solution.q[:, [0, 2]].ravel(), derivatives

    noise = NOISE * np.random.default_rng(0).normal(size=2 * len(TIMES))
    measured = angles(TRUE, 1e-11) + noise

    def fitted(way, jac, **options):
        begun, runs, last = time.process_time(), 0, None

        def residuals(x):
            nonlocal runs, last
            runs, last = runs + (last != tuple(x)), tuple(x)
            return (way(x) - measured) / NOISE

        found = least_squares(residuals, GUESS, jac=jac, x_scale=GUESS, bounds=(0, np.inf), **options)
        return found, runs, time.process_time() - begun

    best = fitted(*with_derivatives(1e-10), xtol=1e-12, ftol=1e-14, gtol=1e-12)[0]
    deviations = np.sqrt(np.diag(np.linalg.inv(best.jac.T @ best.jac)))
    rows = []
    for rtol in tolerances:
        ways = {
            "2-point differences": ("2-point", {}),
            "3-point differences": ("3-point", {}),
            "differences of 1e-4": ("2-point", {"diff_step": 1e-4}),
        }
        ways = {way: ((lambda x, rtol=rtol: angles(x, rtol)), *rest) for way, rest in ways.items()}
        ways |= {f"sensitivities, {method}": (*with_derivatives(rtol, method), {}) for method in METHODS}
        for way, (function, jac, options) in ways.items():
            found, runs, seconds = fitted(function, jac, **options)
            chi2 = float(np.sum(((angles(found.x, 1e-10) - measured) / NOISE) ** 2))
            apart = float(np.abs((found.x - best.x) / deviations).max())
            rows.append(Fit(way, rtol, chi2, apart, runs, seconds))
    return rows


# fmt: off
def command(csv: report.Csv = None, as_json: output.Json = False) -> int:
    # fmt: on
    """Measure derivatives of runs: accuracy against differences of DOP853 runs, cost, and a fit with them.

    Example: python -m benchmarks gradients
    """
    output.require_writable(csv=csv)
    exact, costs, backwards, fit = ([asdict(row) for row in rows()] for rows in (accuracy, cost, many, fits))
    if report.in_files(csv, as_json, exact, accuracy=exact, cost=costs, many=backwards, fits=fit):
        return output.FINE
    errors = [("scene", "{scene}"), ("method", "{method}"), ("rtol>", "{rtol:.0e}"), ("steps>", "{steps}")]
    errors += [(name, f"{{{key}:.0e}}") for name, key in (("dq>", "dq"), ("dv>", "dv"), ("dλ>", "dlam"))]
    report.table(exact, errors, "errors over the largest values, of the worst parameter")
    columns = [("scene", "{scene}"), ("method", "{method}"), ("steps>", "{steps}")]
    columns += [("run [ms]>", report.scaled("run", 1e3, 1))]
    columns += [("fixed part>", "{fixed:.2f}"), ("a parameter>", "{parameter:.2f}"), ("backwards>", "{adjoint:.2f}")]
    columns += [("start of one [ms]>", report.scaled("start", 1e3, 1))]
    report.table(costs, columns, "\nprocess time of derivatives at all steps over that of the run, rtol 1e-8")
    columns = [("scene", "{scene}"), ("parameters>", "{parameters:,}"), ("method", "{method}"), ("steps>", "{steps:,}")]
    columns += [("run [ms]>", report.scaled("run", 1e3, 1)), ("gradient>", "{gradient:.1f}")]
    report.table(backwards, columns, "\nprocess time of run and gradient of one number over that of the run, rtol 1e-8")
    columns = [("way", "{way}"), ("rtol>", "{rtol:.0e}"), ("χ²>", "{chi2:.2f}"), ("from optimum [σ]>", "{apart:.4f}")]
    columns += [("runs>", "{runs}"), ("time [s]>", "{seconds:.2f}")]
    report.table(fit, columns, "\nfit of three parameters to 120 noisy angles")
    return output.FINE
