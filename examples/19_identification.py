"""Masses, friction and stiffness of a crank-rocker from noisy angles: a fit with exact derivatives of the runs."""

import numpy as np
from scipy.optimize import least_squares

import pinconsist as pc

NAMES = ["mass:coupler", "damping:rocker", "stiffness:crank"]
TRUE, GUESS = np.array([1.4, 0.05, 0.5]), np.array([1.8, 0.02, 0.8])
TIMES, NOISE, MEASURED = np.linspace(0.0, 2.0, 61)[1:], 2e-3, [0, 2]  # s, rad, crank and rocker
MECH = pc.load("crank_rocker").add_forces(pc.JointSpring("crank", 0.5))


def derivatives(x):
    """The run with parameters x, and its derivatives with respect to them."""
    mech = MECH.with_parameters(dict(zip(NAMES, x, strict=True)))
    return pc.sensitivities(mech, NAMES, (0.0, 2.0), v0={"crank": 12.0}, t_eval=TIMES)


def measurements():
    """The angles that two noisy encoders would measure, (60, 2)."""
    exact = derivatives(TRUE).solution.q[:, MEASURED]
    return exact + NOISE * np.random.default_rng(0).normal(size=exact.shape)


def fit(angles):
    """The result of least_squares, the standard deviations, and the last run."""
    last = {}

    def at(x):  # residuals and derivatives are requested one after the other for the same parameters
        if last.get("x") != tuple(x):
            last.update(x=tuple(x), found=derivatives(x))
        return last["found"]

    def residuals(x):
        return (at(x).solution.q[:, MEASURED] - angles).ravel() / NOISE

    def jacobian(x):
        return at(x).dq[:, MEASURED].reshape(-1, len(x)) / NOISE

    found = least_squares(residuals, GUESS, jacobian, x_scale=GUESS, bounds=(0, np.inf))
    return found, np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac))), at(found.x)


def run():
    """The mechanism and its fit."""
    return MECH, fit(measurements())


def main() -> float:
    """Return the fitted mass of the coupler, kg."""
    found, deviations, _ = run()[1]
    for name, value, deviation in zip(NAMES, found.x, deviations, strict=True):
        print(f"{name:16} {value:.5f} ± {deviation:.5f}")
    print(f"chi² = {2 * found.cost:.2f} of {found.fun.size} angles")
    return float(found.x[0])


if __name__ == "__main__":
    print(f"{main():.6f} kg")
