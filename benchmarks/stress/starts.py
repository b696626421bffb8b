"""Starts off the constraints by every amount: projected by `simulate`, accepted or refused by `integrate`."""

from __future__ import annotations

from functools import partial

import numpy as np
import pinocchio as pin

from pinconsist import assemble, load
from pinconsist.mechanism.system import MechanismSystem
from pinconsist.paper import reference_problem

from .case import EITHER, HELD, MAX_STEPS, REFUSED, Case, Figure, certified, completed, largest, should_not_be, solved

FAMILY = "inconsistent start"
ROUNDING, REFUSED_FROM = 1e-12, 1e-5
"""Of a position off the constraint, in lengths of the mechanism, what `integrate` must accept and refuse."""
DEFAULTS = {"tol": 1e-6, "atol": 1e-8}


def cases():
    for scene in ("four_bar", "stewart_platform"):
        for off in (1e-12, 1e-9, 1e-6, 1e-3, 1e-2, 1e-1, 1.0):
            expected = HELD if off <= 1e-2 else EITHER
            yield Case(FAMILY, f"{scene}, q0 off by {off:.0e}", partial(_position, scene, off), expected)
        for off in (1e-9, 1e-3, 1.0, 1e3, 1e6):
            yield Case(FAMILY, f"{scene}, v0 off by {off:.0e} /s", partial(_velocity, scene, off))
        contradiction = f"{scene}, v0 of all joints, against the loops"
        yield Case(FAMILY, contradiction, partial(_contradiction, scene), REFUSED, "velocit")
    for exponent in range(-15, 0):
        off = 10.0**exponent
        expected = HELD if off < ROUNDING else REFUSED if off >= REFUSED_FROM else EITHER
        check = partial(_taken_as_it_stands, off)
        yield Case(FAMILY, f"problem51, p0 as it stands, off by {off:.0e}", check, expected, "constraint")


def _position(scene, off, by):
    """The configuration is closed, near where it was asked to be."""
    mech = load(scene)
    closed = assemble(mech)
    away = np.random.default_rng(0).normal(size=mech.nv)
    away *= off / np.linalg.norm(away)
    sol = solved(by, mech, 0.1, pin.integrate(mech.model, closed.q, away), **DEFAULTS)
    moved = largest(pin.difference(mech.model, closed.q, sol.q[0]))
    return [
        *certified(sol, position=1e-9, force_first=1e-3),
        Figure("distance from the closed start", moved, 100 * off + 1e-9),
    ]


def _velocity(scene, off, by):
    """The velocity is put on the loops in the mass metric: it is the nearest there, in kinetic energy."""
    mech = load(scene)
    wanted = off * np.random.default_rng(1).normal(size=mech.nv)
    sol = solved(by, mech, 0.05 / max(1.0, off), assemble(mech).q, wanted, tol=1e-6, atol=1e-8 * max(1.0, off))
    system = MechanismSystem(mech, sol.q[0])
    J, M = system.loop_rows(sol.q[0])[1], system.mass_matrix(sol.q[0])
    momentum = M @ (wanted - sol.v[0])
    unexplained = momentum - J.T @ np.linalg.lstsq(J.T, momentum, rcond=1e-9)[0]
    return [
        Figure("first velocity off the loops, relative", largest(J @ sol.v[0]) / off, 1e-10),
        Figure("impulse that no loop can give, relative", largest(unexplained) / largest(momentum), 1e-9),
        *certified(sol, force_first=1e-3),
    ]


def _taken_as_it_stands(off, by):
    """`integrate` assembles nothing: what it accepts must not spoil the multipliers silently."""
    problem = reference_problem("problem51")
    p0 = problem.p0 * (1.0 + off)
    sol = completed(by.integrate(problem.system, (0.0, 0.1), p0, problem.v0, rtol=1e-6, atol=1e-8, max_steps=MAX_STEPS))
    lam = np.array([problem.exact(t)[2] for t in sol.t])
    return [Figure("error of λ", largest((sol.lam - lam)[1:]), 1e-2)]


def _contradiction(scene, by):
    mech = load(scene)
    speeds = {joint: 1.0 + i for i, joint in enumerate(mech.joints) if mech.model.nvs[i + 1] == 1}
    solved(by, mech, 0.1, None, speeds, **DEFAULTS)
    return [should_not_be("contradicting velocities that went through")]
