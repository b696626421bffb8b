"""Statics: the rest position of a closed chain, the force in its loop, and the vibrations about that position."""

import pinconsist as pc


def run():
    """A parallelogram of three equal rods with a damper in one joint: equilibrium, modes, and a run to compare."""
    mech = pc.load("n_four_bar_1").add_forces(pc.JointDamping({"crank0": 0.8}))
    rest = pc.equilibrium(mech, {"crank0": 1.2})
    modes = pc.linearize(mech, rest.q).modes()
    swing = pc.simulate(mech, (0.0, 6.0), rest.q, {"crank0": 0.2}, rtol=1e-8, atol=1e-8)
    return mech, rest, modes, swing


def main() -> float:
    """Print equilibrium and modes; return the natural frequency, rad/s."""
    mech, rest, modes, _ = run()
    print(rest)
    print(f"crank at {rest.q[0]:.6f} rad; the loop carries {rest.reaction(mech.loops[0].name).force[0]} N")
    print(modes)
    return float(modes.frequencies[0])


if __name__ == "__main__":
    print(f"{main():.6f} rad/s")
