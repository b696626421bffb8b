"""Many runs from random starts, in parallel: one function, called for each case in any pool."""

from concurrent.futures import ProcessPoolExecutor
from functools import partial

import numpy as np

import pinconsist as pc

TIMES = np.linspace(0.0, 3.0, 61)


def starts(count=24, seed=0):
    """Initial angles of the rod from the hanging position, rad."""
    return np.random.default_rng(seed).normal(1.0, 0.3, count)


def run():
    """Simulate a pendulum released at each of the angles."""
    mech = pc.load("planar_pendulum")
    let_go = partial(pc.simulate, mech, (0.0, 3.0), rtol=1e-8, atol=1e-8, t_eval=TIMES)
    guesses = [{"pendulum": np.pi / 2 - angle} for angle in starts()]  # the angle is measured from the horizontal
    with ProcessPoolExecutor(max_workers=2) as pool:
        outcomes = pc.sweep(let_go, guesses, executor=pool)
    return mech, [outcome.value for outcome in outcomes]


def main() -> float:
    """Return the mean angle from the hanging position at the end, rad."""
    _, solutions = run()
    angles = np.array([np.pi / 2 - sol.q[:, 0] for sol in solutions])
    for i in range(0, len(TIMES), 20):
        print(f"t = {TIMES[i]:.1f} s: mean {angles[:, i].mean():+.4f} rad, scatter {angles[:, i].std():.4f} rad")
    return float(angles[:, -1].mean())


if __name__ == "__main__":
    print(f"{main():.6f} rad")
