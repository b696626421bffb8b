"""A torque signal of 200 numbers that swings a four-bar up: gradients by a backward pass over the steps."""

import numpy as np

import pinconsist as pc

END, NODES = 2.5, 200  # s, length of the signal
TIMES, SMALL = np.linspace(0.0, END, NODES), {"rtol": 1e-5, "atol": 1e-7, "method": "Radau"}
MECH = pc.load("four_bar").add_forces(pc.JointDamping({"crank": 0.5}), pc.Actuator("motor", "crank"))
NAMES = [f"motor.control.values[{i}]" for i in range(NODES)]
BELOW = pc.equilibrium(MECH).q
ABOVE = pc.equilibrium(MECH, {"crank": BELOW[0] + np.pi}, stable=False).q
CRANK = np.eye(3)[0]


def angle(t, q, v, lam):
    """The angle of the crank from the top."""
    return q[0] - ABOVE[0]


def speed(t, q, v, lam):
    """The speed of the crank."""
    return v[0]


ENDS = (angle, lambda *row: (CRANK, 0.0, 0.0)), (speed, lambda *row: (0.0, CRANK, 0.0))  # with their derivatives


def at_end(torques):
    """Angle and speed of the crank at the end, and their derivatives with respect to all torques."""
    mech = MECH.with_control({"motor": (TIMES, torques)})
    found = [pc.gradient(mech, NAMES, (0.0, END), BELOW, terminal=each, **SMALL) for each in ENDS]
    return np.array([each.value for each in found]), np.array([each.gradient for each in found])


def run():
    """The mechanism; its motion under the torques that were found, and the torques."""
    torques = 8.0 * np.sin(4.0 * TIMES)
    for _ in range(30):  # Newton's method for both values, with the smallest changes of the torques
        value, J = at_end(torques)
        change = -np.linalg.pinv(J) @ value
        torques = torques + change * min(1.0, 8.0 / np.abs(change).max())
        if np.abs(value).max() < 2e-3:
            break
    mech = MECH.with_control({"motor": (TIMES, torques)})
    return mech, (pc.simulate(mech, (0.0, END), BELOW, **SMALL), torques)


def main() -> float:
    """Return the crank's angle at the end, rad."""
    sol, torques = run()[1]
    print(f"torques from {torques.min():.2f} to {torques.max():.2f} N·m")
    print(f"end at {sol.q[-1, 0]:.6f} rad with {sol.v[-1, 0]:.1e} rad/s, the top is at {ABOVE[0]:.6f} rad")
    return float(sol.q[-1, 0])


if __name__ == "__main__":
    print(f"{main():.6f} rad")
