"""Six PD loops at 1 kHz on the legs of a Stewart platform: it wobbles for a second and comes to rest."""

from dataclasses import replace
from time import perf_counter

import numpy as np

import pinconsist as pc

PERIOD, END, STIFFNESS, DAMPING = 1e-3, 2.0, 2e4, 3e2  # s, s, N/m, N·s/m
LENGTH, AMPLITUDE, LEGS = 0.676, 0.04, [f"leg{i}_length" for i in range(1, 7)]  # m, m
MECH = replace(pc.load("stewart_platform"), forces=())  # without the servos of its file
COLUMNS, PHASES = np.arange(2, 18, 3), np.arange(6) * np.pi / 3.0


def law(t, q, v):
    """The forces in the legs: PD control of their lengths."""
    wobble = AMPLITUDE * np.sin(np.pi * t) * np.sin(2.0 * np.pi * t + PHASES) if t < 1.0 else 0.0
    return STIFFNESS * (LENGTH + wobble - q[COLUMNS]) - DAMPING * v[COLUMNS]


def run():
    """The mechanism, and two seconds of its motion."""
    controllers = pc.Sampled(PERIOD, law, joints=LEGS)
    return MECH, pc.simulate(MECH, (0.0, END), method="Radau", rtol=1e-5, forces=[controllers])


def main() -> float:
    """Return the height of the platform at the end, m."""
    begun = perf_counter()
    sol = run()[1]
    taken = perf_counter() - begun
    print(f"{sol.nsteps} steps, {END / taken:.1f} times faster than real time")
    return float(sol.position("platform_pose")[-1, 2])


if __name__ == "__main__":
    print(f"{main():.9f} m")
