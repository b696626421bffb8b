"""Many runs from scattered starts, in parallel: mechanisms and solutions are picklable, so that any pool does."""

from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import repeat

import numpy as np

import pinconsist as pc

TIMES = np.linspace(0.0, 3.0, 61)


def starts(count=24, seed=0):
    """Angles of the rod from hanging, rad."""
    return np.random.default_rng(seed).normal(1.0, 0.3, count)


def run():
    """A pendulum let go at each of the angles."""
    mech = pc.load("planar_pendulum")
    simulate = partial(pc.simulate, rtol=1e-8, atol=1e-8, t_eval=TIMES)
    guesses = [{"pendulum": np.pi / 2 - angle} for angle in starts()]  # the scene counts from level
    with ProcessPoolExecutor(max_workers=2) as pool:
        return mech, list(pool.map(simulate, repeat(mech), repeat((0.0, 3.0)), guesses))


def main() -> float:
    """Return the mean angle from hanging at the end, rad."""
    _, solutions = run()
    angles = np.array([np.pi / 2 - sol.q[:, 0] for sol in solutions])
    for i in range(0, len(TIMES), 20):
        print(f"t = {TIMES[i]:.1f} s: mean {angles[:, i].mean():+.4f} rad, scatter {angles[:, i].std():.4f} rad")
    return float(angles[:, -1].mean())


if __name__ == "__main__":
    print(f"{main():.6f} rad")
