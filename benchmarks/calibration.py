"""Two calibrations, with exact derivatives and with differences: ``python -m benchmarks calibration``."""

from __future__ import annotations

import time

import numpy as np
from scipy.optimize import least_squares

import pinconsist as pc
from pinconsist.cli import output

from . import report
from .example import example


def anchors():
    """Ways to calibrate 15 anchors of the delta robot from 40 poses: name, function without arguments."""
    robot = example("26_kinematic_calibration")
    exact = robot.closed(robot.BUILT)[1][:, robot.PLATFORM]
    measured = exact + robot.NOISE * robot.RNG.normal(size=exact.shape)
    deviations = robot.fit(measured)[1]

    def residuals(positions):
        return lambda x: (positions(x)[:, robot.PLATFORM] - measured).ravel() / robot.NOISE

    def assembled(x):
        mech = robot.MECH.with_parameters(dict(zip(robot.NAMES, x, strict=True)))
        poses = [dict(zip(mech.actuated, motors, strict=True)) for motors in robot.MOTORS]
        return np.array([pc.assemble(mech, pose).q for pose in poses])

    ways = {
        "act.derivatives": lambda: robot.fit(measured)[0],
        "differences of act.closure": lambda: least_squares(
            residuals(lambda x: robot.closed(x)[1]), robot.DRAWN, x_scale="jac"
        ),
        "differences of pc.assemble": lambda: least_squares(residuals(assembled), robot.DRAWN, x_scale="jac"),
    }
    return ways, robot.BUILT, deviations


def masses():
    """Ways to identify nine numbers of a five-bar from two encoders."""
    log = example("27_held_identification")
    angles = log.measurements()
    deviations = log.fit(angles)[1]

    def residuals(x):
        return (pc.simulate(log.at(x), **log.RUN).q[:, log.COLUMNS] - angles).ravel() / log.NOISE

    options = {"bounds": (log.LEAST, np.inf), "x_scale": "jac"}
    ways = {
        "pc.sensitivities": lambda: log.fit(angles)[0],
        "2-point differences of runs": lambda: least_squares(residuals, log.GUESS, "2-point", **options),
        "3-point differences of runs": lambda: least_squares(residuals, log.GUESS, "3-point", **options),
    }
    return ways, log.TRUE, deviations


# fmt: off
def command(
    csv: report.Csv = None,
    as_json: output.Json = False,
) -> int:
    # fmt: on
    """Time the calibrations of examples 26 and 27, by exact derivatives and by differences.

    Example: python -m benchmarks calibration
    """
    rows = []
    for scene, made in {"delta_robot, 15 anchors": anchors, "five_bar, 9 numbers": masses}.items():
        ways, true, deviations = made()
        for way, fit in ways.items():
            begun = time.process_time()
            found = fit()
            seconds = time.process_time() - begun
            error = float(np.abs((found.x - true) / deviations).max())
            rows.append({"what": scene, "way": way, "seconds": seconds, "chi2": 2.0 * found.cost, "error": error})
    if report.in_files(csv, as_json, rows, fits=rows):
        return output.FINE
    columns = ["what", "way", "seconds>", "chi2>", "error>"]
    shown = [row | {"seconds": f"{row['seconds']:.2f}", "chi2": f"{row['chi2']:.3f}", "error": f"{row['error']:.2f}"}
             for row in rows]  # fmt: skip
    report.table(shown, columns, "process time of a fit, chi-squared, and the largest error in standard deviations")
    return output.FINE
