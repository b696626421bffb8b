"""A delta robot on three driven arms: the platform only translates; the multipliers of the drives are the torques."""

from dataclasses import replace

import numpy as np

import pinconsist as pc


def run():
    """One cycle of the platform; the arms follow sine curves with phases a third of a turn apart."""
    mech = pc.load("delta_robot")
    drives = []
    for i in (1, 2, 3):
        sine = pc.Motion(0.3, amplitude=0.25, frequency=1.0, phase=2 * np.pi * (i - 1) / 3)
        drives.append(pc.Drive(f"motor{i}", f"leg{i}_arm", sine))
    driven = replace(mech, loops=(*mech.loops, *drives), forces=())  # in place of the servos of the model
    return driven, pc.simulate(driven, (0.0, 1.0), t_eval=np.linspace(0, 1, 101))


def main() -> float:
    """Print the motors' largest torques; return the largest distance of the platform from the central axis, m."""
    mech, sol = run()
    for i in (1, 2, 3):
        print(sol.reaction(f"motor{i}"))
    x, y = (sol.q[:, mech.columns(f"platform_{axis}")][:, 0] for axis in "xy")
    return float(np.hypot(x, y).max())


if __name__ == "__main__":
    print(f"{main():.6f} m")
