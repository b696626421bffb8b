"""A spring sized to minimise the peak force in a pin, the largest of many forces, by their derivatives."""

from functools import lru_cache

import numpy as np
from scipy.optimize import minimize

import pinconsist as pc

TIMES = np.linspace(0.0, 2.0 * np.pi, 61)  # one turn, s
NAMES, GUESS, SIZE = ["stiffness:rocker", "spring rocker.rest"], np.array([1.0, 1.0]), 20.0  # N·m/rad, rad; N

BOUNDS = [(0.0, None), (-np.pi, np.pi), (0.0, None)]


def driven():
    """A four-bar that a motor turns at 1 rad/s, with a spring at its rocker."""
    mech, motor = pc.load("four_bar"), pc.Drive("motor", "crank", pc.Motion(speed=1.0))
    return mech.add_loops(motor).add_forces(pc.JointSpring("rocker", *GUESS))


MECH = driven()
PIN = [i for i, (loop, row) in enumerate(MECH.row_labels) if loop == "coupler_rocker" and row in ("x", "y", "z")]


def forces(x):
    """The squared force in the pin during one revolution, divided by SIZE², and its derivatives."""
    mech = MECH.with_parameters(dict(zip(NAMES, x, strict=True)))
    found = pc.sensitivities(mech, NAMES, (0.0, TIMES[-1]), t_eval=TIMES, rtol=1e-7, atol=1e-9)
    F, dF = found.solution.lam[:, PIN] / SIZE, found.dlam[:, PIN] / SIZE
    return (F**2).sum(axis=1), 2.0 * np.einsum("ni,nip->np", F, dF)


def run():
    """The mechanism with the best spring; times, forces for the guess and for the best spring, and its parameters."""
    remembered = lru_cache(lambda *x: forces(x))

    def at(x):
        return remembered(*x[:2])

    below = {  # all forces stay below the last unknown, which is made small
        "type": "ineq",
        "fun": lambda x: x[2] - at(x)[0],
        "jac": lambda x: np.hstack((-at(x)[1], np.ones((len(TIMES), 1)))),
    }
    start = np.append(GUESS, forces(GUESS)[0].max())
    found = minimize(lambda x: x[2], start, jac=lambda x: np.eye(3)[2], constraints=below, bounds=BOUNDS)
    best = MECH.with_parameters(dict(zip(NAMES, found.x[:2], strict=True)))
    return best, (TIMES, SIZE * np.sqrt(forces(GUESS)[0]), SIZE * np.sqrt(at(found.x)[0]), found.x)


def main() -> float:
    """Return the least peak force, N."""
    _, before, now, x = run()[1]
    print(f"{x[0]:.3f} N·m/rad, rest at {x[1]:.4f} rad: peak {now.max():.3f} N, of the guess {before.max():.3f} N")
    return float(now.max())


if __name__ == "__main__":
    print(f"{main():.6f} N")
