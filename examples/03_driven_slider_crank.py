"""A slider-crank whose crank is driven at constant speed: the multiplier of the drive is the motor torque."""

import numpy as np

import pinconsist as pc

SPEED = 10.0  # rad/s


def run():
    """A little less than one turn of the crank."""
    mech = pc.load("slider_crank")
    motor = pc.Drive("motor", "crank", pc.Motion(start=-1.0, speed=SPEED))
    driven = mech.add_loops(motor)
    return driven, pc.simulate(driven, (0.0, 0.6), rtol=1e-8, atol=1e-8, t_eval=np.linspace(0, 0.6, 601))


def main() -> float:
    """Return the largest motor torque, N·m."""
    _, sol = run()
    torque = sol.reaction("motor").torque
    worst = int(np.argmax(np.abs(torque)))
    print(f"largest torque {torque[worst]:.2f} N·m at crank angle {sol.q[worst, 0]:.2f} rad")
    return float(abs(torque[worst]))


if __name__ == "__main__":
    print(f"{main():.2f} N·m")
