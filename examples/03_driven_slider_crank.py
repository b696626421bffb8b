"""A slider-crank whose crank is driven at constant speed: the multiplier of the drive is the motor torque."""

import numpy as np

import pinconsist as pc

SPEED = 10.0  # rad/s


def main() -> float:
    """Drive the crank for one turn; return the largest motor torque, N·m."""
    mech = pc.load("slider_crank")
    motor = pc.Drive("motor", "crank", lambda t: -1.0 + SPEED * t, lambda t: SPEED, lambda t: 0.0)
    driven = mech.with_loops(*mech.loops, motor)
    sol = pc.simulate(driven, (0.0, 2 * np.pi / SPEED), rtol=1e-8, atol=1e-8, t_eval=np.linspace(0, 0.6, 601))
    torque = sol.lam[:, -1]  # the last row belongs to the last loop, the motor
    worst = int(np.argmax(np.abs(torque)))
    print(f"largest torque {torque[worst]:.2f} N·m at crank angle {sol.q[worst, 0]:.2f} rad")
    return float(abs(torque[worst]))


if __name__ == "__main__":
    print(f"{main():.2f} N·m")
