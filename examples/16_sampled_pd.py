"""A digital controller: PD control at 100 Hz, torques held between samples, turns a parallelogram to an angle."""

import pinconsist as pc

PERIOD, STIFFNESS, DAMPING, TARGET = 1e-2, 200.0, 20.0, 0.5  # s, N·m/rad, N·m·s/rad, rad


def law(t, q, v):
    """PD control of the first crank."""
    return STIFFNESS * (TARGET - q[0]) - DAMPING * v[0]


def run():
    """The mechanism, and half a second of its motion."""
    mech = pc.load("n_four_bar_1").with_gravity((0.0, 0.0, 0.0))  # its inertia does not depend on the angle
    controller = pc.Sampled(PERIOD, law, joints="crank0")
    return mech, pc.simulate(mech, (0.0, 0.5), method="Radau", forces=[controller])


def main() -> float:
    """Return the crank's angle at the end, rad."""
    _, sol = run()
    print(f"{len(sol.held['sampled crank0'])} samples, {sol.nsteps} steps, forces good to {sol.check().force:.0e}")
    return float(sol.q[-1, 0])


if __name__ == "__main__":
    print(f"{main():.9f} rad")
