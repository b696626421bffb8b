"""Fifteen anchors of a delta robot from forty noisy positions of its platform, with derivatives of the closure."""

import numpy as np
from scipy.optimize import least_squares

import pinconsist as pc

MECH = pc.load("delta_robot")
ANCHORS = [  # of rods: those at the arms, xyz1, and those at the platform, xyz2
    ("leg2_left", "xyz1", 0), ("leg2_right", "xyz1", 0), ("leg3_right", "xyz1", 0), ("leg1_left", "xyz2", 0),
    ("leg1_right", "xyz2", 0), ("leg3_left", "xyz2", 1), ("leg1_left", "xyz2", 1), ("leg3_left", "xyz2", 0),
    ("leg1_right", "xyz2", 1), ("leg3_left", "xyz2", 2), ("leg1_left", "xyz2", 2), ("leg2_left", "xyz2", 2),
    ("leg2_right", "xyz2", 1), ("leg3_right", "xyz2", 0), ("leg2_left", "xyz2", 0),
]  # fmt: skip
NAMES = [f"anchor:{loop}.{end}[{axis}]" for loop, end, axis in ANCHORS]
LOOPS = {loop.name: loop for loop in MECH.loops}
DRAWN = np.array([getattr(LOOPS[loop], end)[axis] for loop, end, axis in ANCHORS])
PLATFORM = [MECH.columns(f"platform_{axis}").start for axis in "xyz"]
RNG, NOISE = np.random.default_rng(0), 2e-5  # m, of a laser tracker
MOTORS = 0.3 + RNG.uniform(-0.4, 0.5, (40, 3))  # rad
BUILT = DRAWN + 1e-3 * RNG.normal(size=len(NAMES))  # as the workshop made it


def closed(x):
    """The robot with these anchors, and its configurations at all positions of the motors, (40, nq)."""
    act = pc.Actuation(MECH.with_parameters(dict(zip(NAMES, x, strict=True))))
    return act, act.closure(MOTORS)[0]


def fit(measured):
    """The result of least_squares, and standard deviations."""

    def residuals(x):
        return (closed(x)[1][:, PLATFORM] - measured).ravel() / NOISE

    def jacobian(x):
        act, q = closed(x)
        return act.derivatives(NAMES, q)[:, PLATFORM].reshape(-1, len(x)) / NOISE

    found = least_squares(residuals, DRAWN, jacobian, x_scale="jac")
    return found, np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))


def run():
    """The robot and its calibration."""
    exact = closed(BUILT)[1][:, PLATFORM]
    return MECH, fit(exact + NOISE * RNG.normal(size=exact.shape))


def main() -> float:
    """Return the largest error of an anchor, in its standard deviations."""
    found, deviations = run()[1]
    for name, value, deviation, true in zip(NAMES, found.x, deviations, BUILT, strict=True):
        print(f"{name:26} {value:9.5f} ± {deviation:.5f} m, built {true:9.5f}")
    print(f"chi² = {2 * found.cost:.1f} of {found.fun.size} numbers")
    return float(np.abs((found.x - BUILT) / deviations).max())


if __name__ == "__main__":
    print(f"{main():.4f} standard deviations")
