"""Linkages of any size, mass and number of loops, built for the suite from rods in the x-z plane."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from pinconsist.mechanism.assembly import assemble
from pinconsist.mechanism.loops import Loop
from pinconsist.mechanism.mechanism import Mechanism
from pinconsist.reference import Reference, reference_solution

GRAVITY = 9.81
START = {"crank": -1.0}
NAMES = ("crank", "coupler", "rocker")
LENGTHS, MASSES, SPAN = (1.0, 2.0, 1.5), (1.0, 2.0, 1.5), 2.2


def rod(mass, length) -> pin.Inertia:
    """A uniform slender rod along x from its joint."""
    across, along = mass * length**2 / 12, 1e-3 * mass * length**2 / 12
    return pin.Inertia(mass, np.array([length / 2, 0.0, 0.0]), np.diag([along, across, across]))


def shift(x, y=0.0, z=0.0) -> pin.SE3:
    """A placement without rotation."""
    return pin.SE3(np.eye(3), np.array([x, y, z], float))


def add_frame(model, joint, name, placement) -> None:
    """An operational frame of a joint's body."""
    model.addFrame(pin.Frame(name, joint, 0, placement, pin.FrameType.OP_FRAME))


def four_bar(*, size=1.0, masses=MASSES, gravity=GRAVITY, loops=None, forces=(), give=None) -> Mechanism:
    """Crank 1 m, coupler 2 m, rocker 1.5 m on 2.2 m, all times `size`; three hinges in a chain, its end to the ground.

    Parameters
    ----------
    size : float
        Factor of all lengths.
    masses : sequence of 3 float
        kg.
    gravity : float
        Along -z, m/s².
    loops : sequence of (name, kind), optional
        The closures of the chain's end. Default one point.
    forces : sequence
        As for Mechanism.
    give : str, optional
        Name of a prismatic joint along the coupler, between its hinge and its rod.
    """
    model, last, reach = pin.Model(), 0, 0.0
    model.gravity.linear = np.array([0.0, 0.0, -gravity])
    for name, length, mass in zip(NAMES, LENGTHS, masses, strict=True):
        last = model.addJoint(last, pin.JointModelRY(), shift(reach), name)
        reach = size * length
        if give and name == "coupler":
            last = model.addJoint(last, pin.JointModelPX(), pin.SE3.Identity(), give)
        model.appendBodyToJoint(last, rod(mass, reach), pin.SE3.Identity())
    add_frame(model, last, "end", shift(reach))
    closures = [
        Loop(name, kind, "end", xyz2=(SPAN * size, 0.0, 0.0), axis=(0, 1, 0) if kind == "hinge" else None)
        for name, kind in loops or [("end", "point")]
    ]
    guess = {"crank": -1.0, "coupler": 1.3, "rocker": 1.4}
    return Mechanism(model, closures, forces, name="four-bar", guess=guess)


def reference(mech, q0, v0, until) -> Reference:
    """First and last row of scipy's DOP853 at 1e-12, from the assembled start."""
    start = assemble(mech, q0, v0)
    return reference_solution(mech, 0.0, start.q, start.v, [0.0, until], rtol=1e-12, atol=1e-12)
