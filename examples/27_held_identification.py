"""Masses, friction and an anchor of a five-bar from two noisy encoders, under torques that were held for 10 ms each."""

import numpy as np
from scipy.optimize import least_squares

import pinconsist as pc

MOTORS = ["left_crank", "right_crank"]
NAMES = ["mass:left_distal", "mass:right_distal", "com:left_distal[0]", "damping:left_crank", "damping:right_crank",
         "friction:left_crank", "friction:right_crank", "tip.xyz2[0]", "tip.xyz2[2]"]  # fmt: skip
TRUE = np.array([0.37, 0.33, 0.17, 0.014, 0.008, 0.04, 0.06, 0.002, -0.001])
GUESS = np.array([0.35, 0.35, 0.175, 0.010, 0.010, 0.05, 0.05, 0.0, 0.0])  # masses and lengths of the drawing
LEAST = np.array([0.05] * 2 + [0.0] * 5 + [-0.02] * 2)
TIMES, NOISE = 0.01 * np.arange(80), 1e-3  # s, rad
LOG = pc.HeldTorque(TIMES, np.column_stack([0.5 * np.sin(7.0 * TIMES), 0.4 * np.cos(9.0 * TIMES)]), MOTORS)
FRICTION = pc.JointDamping(dict.fromkeys(MOTORS, 0.01)), pc.JointFriction(dict.fromkeys(MOTORS, 0.05), width=0.05)
MECH = pc.load("five_bar").with_forces(*FRICTION, LOG)
COLUMNS = [MECH.columns(joint).start for joint in MOTORS]
HANGING = pc.equilibrium(pc.load("five_bar"), {"left_crank": 1.2, "right_crank": 1.9}).q
RUN = {"t_span": (0.0, 0.8), "q0": HANGING, "t_eval": TIMES[1:], "rtol": 1e-7, "atol": 1e-9}


def at(x):
    """The mechanism with parameters x."""
    return MECH.with_parameters(dict(zip(NAMES, x, strict=True)))


def measurements():
    """The angles that two noisy encoders would measure, (79, 2)."""
    return pc.simulate(at(TRUE), **RUN).q[:, COLUMNS] + NOISE * np.random.default_rng(0).normal(size=(79, 2))


def fit(angles):
    """The result of least_squares, and standard deviations."""

    def residuals(x):
        return (pc.simulate(at(x), **RUN).q[:, COLUMNS] - angles).ravel() / NOISE

    def jacobian(x):  # over 80 jumps of the torques
        return pc.sensitivities(at(x), NAMES, **RUN).dq[:, COLUMNS].reshape(-1, len(x)) / NOISE

    found = least_squares(residuals, GUESS, jacobian, bounds=(LEAST, np.inf), x_scale="jac")
    return found, np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))


def run():
    """The mechanism, its fit and standard deviations."""
    return MECH, fit(measurements())


def main() -> float:
    """Return the fitted mass of the left distal link, kg."""
    found, deviations = run()[1]
    for row in zip(NAMES, found.x, deviations, TRUE, strict=True):
        print("{:22} {:9.5f} ± {:.5f}, true {:g}".format(*row))
    return float(found.x[0])


if __name__ == "__main__":
    print(f"{main():.6f} kg")
