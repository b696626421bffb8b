"""Starts off the constraints by every amount: projected by `simulate`, accepted or refused by `integrate`."""

from __future__ import annotations

from functools import partial

import numpy as np
import pinocchio as pin

from pinconsist.dae.sizes import largest
from pinconsist.formats.load import load
from pinconsist.mechanism.assembly import assemble
from pinconsist.mechanism.system import MechanismSystem
from pinconsist.reference import reference_problem

from .case import EITHER, HELD, MAX_STEPS, REFUSED, Case, Figure, completed

REFUSED_FROM = 1e-5
"""Of a position off the constraint, in lengths of the mechanism, that `integrate` must refuse."""


def cases():
    """Yield the cases."""
    for scene in ("four_bar", "stewart_platform"):
        for exponent in (-12, -9, -6, -3, -2, -1, 0):
            off = 10.0**exponent
            expected = HELD if exponent <= -2 else EITHER
            yield Case("inconsistent start", f"{scene}, q0 off by {off:.0e}", partial(_position, scene, off), expected)
        for exponent in (-9, -3, 0, 3, 6):
            off = 10.0**exponent
            yield Case("inconsistent start", f"{scene}, v0 off by {off:.0e} /s", partial(_velocity, scene, off))
    for exponent in range(-15, 0):
        off = 10.0**exponent
        if off < 1e-12:
            expected = HELD
        else:
            expected = REFUSED if off >= REFUSED_FROM else EITHER
        check = partial(_taken_as_it_stands, off)
        yield Case("inconsistent start", f"problem51, p0 as it stands, off by {off:.0e}", check, expected, "constraint")
    for scene in ("four_bar", "stewart_platform"):
        check = partial(_contradiction, scene)
        yield Case("inconsistent start", f"{scene}, v0 of all joints, against the loops", check, REFUSED, "velocit")


def _position(scene, off, by):
    """The configuration is closed, near where it was asked to be."""
    mech = load(scene)
    closed = assemble(mech)
    away = np.random.default_rng(0).normal(size=mech.nv)
    away *= off / np.linalg.norm(away)
    sol = completed(by.simulate(mech, (0.0, 0.1), pin.integrate(mech.model, closed.q, away), max_steps=MAX_STEPS))
    proof = sol.check()
    moved = largest(pin.difference(mech.model, closed.q, sol.q[0]))
    return [
        Figure("loop gap of all rows [m]", proof.position, 1e-9),
        Figure("first constraint forces", proof.force_first, 1e-3),
        Figure("distance from the closed start", moved, 100 * off + 1e-9),
    ]


def _velocity(scene, off, by):
    """The velocity is put on the loops in the mass metric: it is the nearest there, in kinetic energy."""
    mech = load(scene)
    closed = assemble(mech)
    wanted = off * np.random.default_rng(1).normal(size=mech.nv)
    until = 0.05 / max(1.0, off)
    sol = completed(by.simulate(mech, (0.0, until), closed.q, wanted, atol=1e-8 * max(1.0, off), max_steps=MAX_STEPS))
    system = MechanismSystem(mech, sol.q[0])
    J, M = system.loop_rows(sol.q[0])[1], system.mass_matrix(sol.q[0])
    momentum = M @ (wanted - sol.v[0])
    unexplained = momentum - J.T @ np.linalg.lstsq(J.T, momentum, rcond=1e-9)[0]
    return [
        Figure("first velocity off the loops, relative", largest(J @ sol.v[0]) / off, 1e-10),
        Figure("impulse that no loop can give, relative", largest(unexplained) / largest(momentum), 1e-9),
        Figure("first constraint forces", sol.check().force_first, 1e-3),
    ]


def _taken_as_it_stands(off, by):
    """`integrate` assembles nothing: what it accepts must not spoil the multipliers without a word."""
    problem = reference_problem("problem51")
    p0 = problem.p0 * (1.0 + off)
    sol = completed(by.integrate(problem.system, (0.0, 0.1), p0, problem.v0, rtol=1e-6, atol=1e-8, max_steps=MAX_STEPS))
    lam = np.array([problem.exact(t)[2] for t in sol.t])
    return [Figure("error of λ", largest((sol.lam - lam)[1:]), 1e-2)]


def _contradiction(scene, by):
    mech = load(scene)
    speeds = {joint: 1.0 + i for i, joint in enumerate(mech.joints) if mech.model.nvs[i + 1] == 1}
    completed(by.simulate(mech, (0.0, 0.1), None, speeds, max_steps=MAX_STEPS))
    return [Figure("contradicting velocities that went through", 1.0, 0.5)]
