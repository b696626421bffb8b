"""Andrews' squeezing mechanism, a stiff classic from the test set for initial value problems: 7 bodies, 3 loops."""

import pinconsist as pc


def run():
    """Simulate the interval of the benchmark, which is the duration of the scene."""
    mech = pc.load("andrews")
    return mech, pc.simulate(mech, (0.0, mech.duration), rtol=1e-7, atol=1e-7)


def main() -> float:
    """Return the crank's angle β at t = 0.03 s, rad."""
    mech, sol = run()
    print(sol.summary())
    for loop in mech.loops:
        print(sol.reaction(loop.name))
    return float(sol.q[-1, mech.columns("beta")][0])


if __name__ == "__main__":
    print(f"{main():.6f} rad")
