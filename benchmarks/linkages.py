"""Mechanisms whose numbers the measurements vary: four-bars of rods in the x-z plane, and a pendulum."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from pinconsist import JointSpring, Loop, Mechanism, load

GRAVITY = 9.81
START = {"crank": -1.0}
NAMES = ("crank", "coupler", "rocker")
LENGTHS, MASSES, SPAN = (1.0, 2.0, 1.5), (1.0, 2.0, 1.5), 2.2
BUSHING, DAMPER = 1e7, 1e4  # N/m, N·s/m


def at(x, y, z=0.0) -> pin.SE3:
    """A place, not turned."""
    return pin.SE3(np.eye(3), np.array([x, y, z], dtype=float))


def add_body(model, parent, joint, place, name, mass, com, inertia) -> int:
    """A joint with one body; `com` (3,) and inertia about it: a number (every axis alike) or a 3×3 matrix."""
    index = model.addJoint(parent, joint, place, name)
    inertia = np.diag([inertia, inertia, inertia]) if np.isscalar(inertia) else np.asarray(inertia)
    model.appendBodyToJoint(index, pin.Inertia(mass, np.array(com, float), inertia), pin.SE3.Identity())
    return index


def add_frame(model, joint, name, place=(0.0, 0.0, 0.0)) -> None:
    """An operational frame of a joint's body."""
    model.addFrame(pin.Frame(name, joint, 0, at(*place), pin.FrameType.OP_FRAME))


def four_bar(*, size=1.0, masses=MASSES, gravity=GRAVITY, forces=(), give=None) -> Mechanism:
    """Crank 1 m, coupler 2 m, rocker 1.5 m on 2.2 m, all times `size`; three hinges in a chain, its end on the ground.

    `give` is the name of a prismatic joint along the coupler, between its hinge and its rod.
    """
    (a, b, c), hinge = size * np.array(LENGTHS), pin.JointModelRY
    coupler = [("coupler", hinge(), a, b, masses[1])]
    if give:
        coupler = [("coupler", hinge(), a, 0.0, 0.0), (give, pin.JointModelPX(), 0.0, b, masses[1])]
    model = _rods([("crank", hinge(), 0.0, a, masses[0]), *coupler, ("rocker", hinge(), b, c, masses[2])], gravity)
    loop = Loop("end", "point", "end", xyz2=(SPAN * size, 0.0, 0.0))
    return Mechanism(model, [loop], forces, name="four-bar", guess={"crank": -1.0, "coupler": 1.3, "rocker": 1.4})


def stiff_four_bar() -> Mechanism:
    """The crank-rocker with a stiff slider, a bushing, in the middle of its coupler."""
    original = load("crank_rocker")
    model = _rods(
        [
            ("crank", pin.JointModelRY(), 0.0, 0.25, 0.5),
            ("coupler", pin.JointModelRY(), 0.25, 0.35, 0.7),
            ("bushing", pin.JointModelPX(), 0.35, 0.35, 0.7),
            ("rocker", pin.JointModelRY(), 0.35, 0.60, 1.2),
        ]
    )
    model.damping = np.array([0.0, 0.0, DAMPER, 0.0])
    pivot = Loop("pivot", "point", "end", xyz2=(0.80, 0.0, 0.0))
    angles = dict(zip(original.joints, original.guess, strict=True))
    return Mechanism(model, [pivot], [JointSpring("bushing", BUSHING)], name="stiff_four_bar", guess=angles)


def rssr() -> Mechanism:
    """A crank and a rocker on skew axes; the coupler has a ball at each end, one of which closes the loop."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -GRAVITY])
    parts = {  # joint, the one before, its place there, length of the rod along x
        "crank": (pin.JointModelRZ(), 0, (0.0, 0.0, 0.0), 0.3),
        "coupler": (pin.JointModelSpherical(), 1, (0.3, 0.0, 0.0), 1.1),
        "rocker": (pin.JointModelRY(), 0, (1.0, 0.4, -0.5), 0.7),
    }
    for name, (joint, before, place, length) in parts.items():
        inertia = length**3 / 12 * np.diag([0.05, 1.0, 1.1])  # 1 kg/m
        index = add_body(model, before, joint, at(*place), name, length, (length / 2, 0.0, 0.0), inertia)
        add_frame(model, index, f"{name}_end", (length, 0.0, 0.0))
    ball = Loop("ball", "point", "rocker_end", "coupler_end")
    return Mechanism(model, [ball], name="rssr", guess={"rocker": -1.5})


def pendulum() -> Mechanism:
    """A point mass of 1 kg on a rod of 1 m in Cartesian coordinates, from the horizontal (IFToMM A01)."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -GRAVITY])
    x = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "x")
    z = add_body(model, x, pin.JointModelPZ(), pin.SE3.Identity(), "z", 1.0, (0, 0, 0), 0.0)
    add_frame(model, z, "mass")
    rod = Loop("rod", "distance", "universe", "mass", length=1.0)
    return Mechanism(model, [rod], name="pendulum", guess=[-1.0, 0.0])


def _rods(parts, gravity=GRAVITY):
    """A chain of (name, joint, offset along the rod before, length and mass of its own uniform rod), its tip "end"."""
    model, last = pin.Model(), 0
    model.gravity.linear = np.array([0.0, 0.0, -gravity])
    for name, joint, offset, length, mass in parts:
        inertia = mass * length**2 / 12 * np.diag([1e-3, 1.0, 1.0])
        last = add_body(model, last, joint, at(offset, 0), name, mass, (length / 2, 0.0, 0.0), inertia)
    add_frame(model, last, "end", (length, 0.0, 0.0))
    return model
