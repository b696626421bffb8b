"""A fit with derivatives and with differences of runs, for ``python -m benchmarks gradients``."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from pinconsist import JointSpring, load, sensitivities, simulate


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


def fits(tolerances) -> list[Fit]:
    """The fit of examples/19_identification.py, with derivatives and with the differences that SciPy makes."""
    mech, speed = load("crank_rocker").add_forces(JointSpring("crank", 0.5)), {"crank": 12.0}

    def angles(x, rtol):
        beside = mech.with_parameters(dict(zip(NAMES, x, strict=True)))
        sol = simulate(beside, (0.0, 2.0), v0=speed, t_eval=TIMES, rtol=rtol, atol=1e-2 * rtol)
        return sol.q[:, [0, 2]].ravel()

    def with_derivatives(rtol):
        """Functions of x that give angles and their derivatives, by one run for both."""
        last = {}

        def at(x):
            if last.get("x") != tuple(x):
                beside = mech.with_parameters(dict(zip(NAMES, x, strict=True)))
                options = {"t_eval": TIMES, "rtol": rtol, "atol": 1e-2 * rtol}
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
        ways["sensitivities"] = *with_derivatives(rtol), {}
        for way, (function, jac, options) in ways.items():
            found, runs, seconds = fitted(function, jac, **options)
            chi2 = float(np.sum(((angles(found.x, 1e-10) - measured) / NOISE) ** 2))
            apart = float(np.abs((found.x - best.x) / deviations).max())
            rows.append(Fit(way, rtol, chi2, apart, runs, seconds))
    return rows
