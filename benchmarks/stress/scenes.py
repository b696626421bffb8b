"""The four-bar of the suite, of any size and mass, built from rods in the x-z plane."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from pinconsist import Loop, Mechanism, assemble, reference_solution

GRAVITY = 9.81
START = {"crank": -1.0}
NAMES = ("crank", "coupler", "rocker")
LENGTHS, MASSES, SPAN = (1.0, 2.0, 1.5), (1.0, 2.0, 1.5), 2.2


def add_frame(model, joint, name, placement) -> None:
    """An operational frame of a joint's body."""
    model.addFrame(pin.Frame(name, joint, 0, placement, pin.FrameType.OP_FRAME))


def four_bar(*, size=1.0, masses=MASSES, gravity=GRAVITY, forces=(), give=None) -> Mechanism:
    """Crank 1 m, coupler 2 m, rocker 1.5 m on 2.2 m, all times `size`; three hinges in a chain, its end on the ground.

    Parameters
    ----------
    size : float
        Factor of all lengths.
    masses : sequence of 3 float
        kg.
    gravity : float
        Along -z, m/s².
    forces : sequence
        As for Mechanism.
    give : str, optional
        Name of a prismatic joint along the coupler, between its hinge and its rod.
    """
    model, last, reach = pin.Model(), 0, 0.0
    model.gravity.linear = np.array([0.0, 0.0, -gravity])

    def shift(x):
        return pin.SE3(np.eye(3), np.array([x, 0.0, 0.0]))

    for name, length, mass in zip(NAMES, LENGTHS, masses, strict=True):
        last = model.addJoint(last, pin.JointModelRY(), shift(reach), name)
        reach = size * length
        if give and name == "coupler":
            last = model.addJoint(last, pin.JointModelPX(), pin.SE3.Identity(), give)
        across = mass * reach**2 / 12  # a uniform slender rod
        rod = pin.Inertia(mass, np.array([reach / 2, 0.0, 0.0]), np.diag([1e-3 * across, across, across]))
        model.appendBodyToJoint(last, rod, pin.SE3.Identity())
    add_frame(model, last, "end", shift(reach))
    loop = Loop("end", "point", "end", xyz2=(SPAN * size, 0.0, 0.0))
    return Mechanism(model, [loop], forces, name="four-bar", guess={"crank": -1.0, "coupler": 1.3, "rocker": 1.4})


def reference(mech, q0, v0, until):
    """First and last row of scipy's DOP853 at 1e-12, from the assembled start."""
    start = assemble(mech, q0, v0)
    return reference_solution(mech, 0.0, start.q, start.v, [0.0, until], rtol=1e-12, atol=1e-12)
