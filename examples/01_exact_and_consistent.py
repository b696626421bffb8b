"""Problem 5.1 of Arévalo (2008): the first multiplier from exact and from numerically consistent initial values."""

import pinconsist as pc


def main() -> float:
    """Print the first errors of implicit Euler; return the one from consistent values at h = 0.001 s."""
    comparison = pc.compare("problem51", [0.01, 0.001], count=3)
    for run in comparison.runs:
        print(f"h = {run.h:g} s: v0 = {run.v_given} -> {run.v_consistent}")
        for t, exact, consistent in zip(run.t[1:], run.exact[1:], run.consistent[1:], strict=True):
            print(f"  t = {t:.3f}   error from exact {exact:.4e}   from consistent {consistent:.4e}")
    return comparison.runs[1].consistent[1]


if __name__ == "__main__":
    print(f"{main():.4e}")  # 8.0120e-03
