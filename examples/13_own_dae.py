"""An index-3 system of your own, without rigid bodies: the car axis, whose constraint depends on time."""

import numpy as np

import pinconsist as pc

# A car axis on two springs. The left wheel rests, the right one rolls over waves. p = (xl, yl, xr, yr) are the ends.
EPS, MASS, LENGTH, REST, WAVE, OMEGA = 1e-2, 10.0, 1.0, 0.5, 0.1, 10.0
K = MASS * EPS**2 / 2


def road(t):
    """The point where the right wheel touches the wave."""
    yb = WAVE * np.sin(OMEGA * t)
    return np.sqrt(LENGTH**2 - yb**2), yb


def springs(t, p, v):
    """Accelerations due to the two springs and gravity."""
    left, right = p[:2], p[2:] - road(t)
    forces = [(REST - np.linalg.norm(end)) * end / np.linalg.norm(end) - (0, K) for end in (left, right)]
    return np.concatenate(forces) / K


def constraint(t, p):
    """The left spring stays perpendicular to the line between the wheels; the axis keeps its length."""
    xl, yl, xr, yr = p
    xb, yb = road(t)
    return np.array([xl * xb + yl * yb, (xl - xr) ** 2 + (yl - yr) ** 2 - LENGTH**2])


def directions(t, p, v):
    """The directions in which the two multipliers act."""
    xl, yl, xr, yr = p
    xb, yb = road(t)
    return np.array([[xb, 2 * (xl - xr)], [yb, 2 * (yl - yr)], [0, -2 * (xl - xr)], [0, -2 * (yl - yr)]]) / K


def run():
    """Three seconds, about five waves."""
    problem = pc.HessenbergProblem(U=lambda t, p, v: v, F=springs, G=directions, R=constraint)
    p0, v0 = [0.0, 0.5, 1.0, 0.5], [-0.5, 0.0, -0.5, 0.0]
    return problem, pc.integrate(problem, (0.0, 3.0), p0, v0, rtol=1e-6, atol=1e-6)


def main() -> float:
    """Return the height of the right end after three seconds."""
    _, sol = run()
    print(sol.summary())
    print(f"multipliers at the end {sol.lam[-1]}")
    return float(sol.q[-1, 3])


if __name__ == "__main__":
    print(f"{main():.6f}")
