"""Problem 5.1 of Arévalo (2008): the first multiplier from exact and from numerically consistent initial values."""

import pinconsist as pc


def run():
    """The first six steps of implicit Euler, for three step sizes."""
    return pc.paper.compare("problem51", [0.01, 0.001, 0.0001], count=6)


def main() -> float:
    """Print the first errors; return the one from consistent values at h = 0.001 s."""
    comparison = run()
    for each in comparison.runs:
        print(f"h = {each.h:g} s: v0 = {each.v_given} -> {each.v_consistent}")
        for t, exact, consistent in list(zip(each.t, each.exact, each.consistent, strict=True))[1:4]:
            print(f"  t = {t:.4f}   error from exact {exact:.4e}   from consistent {consistent:.4e}")
    return float(comparison.runs[1].consistent[1])


if __name__ == "__main__":
    print(f"{main():.4e}")
