"""Co-simulation: the current of a motor, integrated elsewhere, turns a parallelogram linkage, 1 ms at a time."""

import numpy as np

import pinconsist as pc

DT, VOLTAGE, RESISTANCE, INDUCTANCE, CONSTANT = 1e-3, 24.0, 2.0, 5e-3, 1.0  # s, V, Ω, H, N·m/A (V·s/rad)


def circuit(current, speed):
    """The current after DT at constant speed: the other program."""
    final = (VOLTAGE - CONSTANT * speed) / RESISTANCE
    return final + (current - final) * np.exp(-RESISTANCE / INDUCTANCE * DT)


def run():
    """The mechanism, and a fifth of a second of its motion."""
    mech = pc.load("n_four_bar_1").with_gravity((0.0, 0.0, 0.0))  # its inertia does not depend on the angle
    sim, current = pc.Simulation(mech), 0.0
    for _ in range(200):
        torque, current = CONSTANT * current, circuit(current, sim.state.v[0])
        sim.step(DT, {"crank0": torque})
    return sim.mechanism, sim.solution()


def main() -> float:
    """Return the crank's speed at the end, rad/s."""
    _, sol = run()
    print(f"{sol.nsteps} steps, the loop closed to {sol.check().position:.0e} m")
    return float(sol.v[-1, 0])


if __name__ == "__main__":
    print(f"{main():.9f} rad/s")
