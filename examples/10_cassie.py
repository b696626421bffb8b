"""Cassie in free fall, from its SDF file: with sixteen loops and gears inside, the centre of mass simply falls.

Needs the robot's files: pip install 'pinconsist[robots]'.
"""

import numpy as np
import pinocchio as pin

import pinconsist as pc

TIME = 0.2  # s


def run():
    """Drop the robot with closed loops, without motor torques, while its knees turn."""
    mech = pc.load("cassie", free_flyer=True)
    spin = {"left-knee-op": 3.0, "right-knee-op": -2.0}
    return mech, pc.simulate(mech, (0.0, TIME), v0=spin, rtol=1e-5, atol=1e-5)


def main() -> float:
    """Return the vertical acceleration of the centre of mass, m/s², from its first state and its last position."""
    mech, sol = run()
    print(sol.summary())
    data = mech.model.createData()
    end = pin.centerOfMass(mech.model, data, sol.q[-1]).copy()
    pin.centerOfMass(mech.model, data, sol.q[0], sol.v[0])
    push = 2 * (end - data.com[0] - TIME * data.vcom[0]) / TIME**2
    print(f"the knees turned by {np.abs(sol.q[-1] - sol.q[0]).max():.2f}, the acceleration of the centre is {push}")
    return float(push[2])


if __name__ == "__main__":
    print(f"{main():.6f} m/s²")
