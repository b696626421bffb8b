"""A built-in four-bar linkage: simulate it, check the solution, and write a page that plays the motion."""

import tempfile
from pathlib import Path

import pinconsist as pc


def run():
    """Five seconds from rest."""
    mech = pc.load("four_bar")
    return mech, pc.simulate(mech, (0.0, 5.0), rtol=1e-9, atol=1e-9)


def main() -> float:
    """Print the certificate of the solution and write its page; return the crank's angle at the end, rad."""
    mech, sol = run()
    print(sol.summary())
    print(sol.check())
    page = pc.export_html(mech, sol, Path(tempfile.mkdtemp()) / "four_bar.html")
    print(f"open {page}")
    return float(sol.q[-1, 0])


if __name__ == "__main__":
    print(f"{main():.4f} rad")
