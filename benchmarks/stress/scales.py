"""Masses, lengths, stiffnesses and speeds of any size, on a four-bar whose answer follows from one of ordinary size."""

from __future__ import annotations

from functools import cache, partial

import numpy as np
import pinocchio as pin

from pinconsist import JointDamping, JointSpring, Loop, Mechanism

from ..linkages import GRAVITY, MASSES, NAMES, START, add_body, add_frame, four_bar
from .case import EITHER, HELD, RTOL, Case, Figure, certified, largest, reference, relative, should_not_be, solved

UNTIL = 1.0
BEFORE_DEAD_CENTRE = 0.3
"""Until when no rod is lined up with another, s: a heavy rocker whips a light crank through its dead centre."""
GROWTH = 1e3
"""Of the tolerance, that an end error may have."""


def cases():
    for exponent in (2, 4, 6, 8):
        for ratio in (10.0**exponent, 10.0**-exponent):
            for part, name in enumerate(NAMES):
                yield Case("mass ratio", f"{name} times {ratio:.0e}", partial(_mass, part, ratio))
        whipped = f"rocker times {10.0**exponent:.0e}, through the crank's dead centre"
        yield Case("mass ratio", whipped, partial(_whipped, 10.0**exponent), EITHER)
    for exponent in (-6, -5, -4, -3, -2, -1, 1, 2, 3):
        yield Case("length", f"all lengths times {10.0**exponent:.0e}", partial(_length, 10.0**exponent))
    for exponent in range(4, 11):
        stiffness = 10.0**exponent
        spring = f"coupler on a spring of {stiffness:.0e} N/m"
        yield Case("stiffness", f"{spring}, with damper", partial(_stiffness, stiffness, True), HELD, "steps")
        # an undamped one may well need more steps than there are
        yield Case("stiffness", f"{spring}, undamped", partial(_stiffness, stiffness, False), EITHER, "steps")
    for speed in (1.0, 1e2, 1e4, 1e6):
        yield Case("speed", f"crank at {speed:.0e} rad/s, two turns", partial(_speed, speed))
    for speed in (1e2, 1e4):
        yield Case("speed", f"top on a pivot loop at {speed:.0e} rad/s, 10 turns", partial(_top, speed))
    yield Case("speed", "crank at 1e+12 rad/s for a second", _hopeless, EITHER, "max_steps|step")


def _against(sol, rows, scale=1.0, time=1.0):
    """Figures of the last row against a reference of unit size whose forces are `scale`, times `time` as large."""
    error = largest(sol.lam[-1] / scale - rows.lam[-1]) / largest(rows.lam[-1])
    return [
        Figure("error of q", relative(sol.q[-1], rows.q[-1]), GROWTH * RTOL),
        Figure("error of v, relative", relative(sol.v[-1] * time, rows.v[-1]), GROWTH * RTOL),
        Figure("error of λ, relative", error, 10 * GROWTH * RTOL),
    ]


@cache
def _usual(until, *, part=0, ratio=1.0, gravity=GRAVITY, speed=None):
    """The answer for the four-bar of ordinary size, or with one body `ratio` times as heavy."""
    return reference(_heavy(part, ratio, gravity), START, speed and {"crank": speed}, until)


def _heavy(part, ratio, gravity=GRAVITY):
    return four_bar(masses=[mass * (ratio if i == part else 1.0) for i, mass in enumerate(MASSES)], gravity=gravity)


def _mass(part, ratio, by):
    """One body much heavier or lighter than the others, against scipy."""
    sol = solved(by, _heavy(part, ratio), BEFORE_DEAD_CENTRE, START)
    return _against(sol, _usual(BEFORE_DEAD_CENTRE, part=part, ratio=ratio))


def _whipped(ratio, by):
    """The light crank reaches thousands of rad/s for a moment, and no energy must be made there."""
    return certified(solved(by, _heavy(2, ratio), UNTIL, START), energy_error=1e-3, position=1e-8)


def _length(size, by):
    """Under the same gravity all angles are the same at times √size: only the numbers differ."""
    slow = np.sqrt(size)
    sol = solved(by, four_bar(size=size), UNTIL * slow, START, atol=(RTOL, RTOL / slow))
    return _against(sol, _usual(UNTIL), time=slow)


def _stiffness(stiffness, damped, by):
    """A coupler that gives: the motion of the rigid one up to what its load, about 100 N, stretches it."""
    forces = [JointSpring("give", stiffness)]
    if damped:
        forces.append(JointDamping({"give": 2 * np.sqrt(stiffness)}))
    sol = solved(by, four_bar(forces=forces, give="give"), BEFORE_DEAD_CENTRE, START | {"give": 0.0})
    error = largest(sol.q[-1][[0, 1, 3]] - _usual(BEFORE_DEAD_CENTRE).q[-1])
    return [
        Figure("angles against the rigid coupler's", error, 1e3 / stiffness + GROWTH * RTOL),
        *certified(sol, force=1e-2, position=1e-8),
    ]


def _speed(speed, by):
    """Without gravity all speeds give one path; forces grow with the square."""
    mech, turns = four_bar(gravity=0.0), 4 * np.pi
    sol = solved(by, mech, turns / speed, START, {"crank": speed}, atol=(RTOL, RTOL * speed))
    return _against(sol, _usual(turns, gravity=0.0, speed=1.0), scale=speed**2, time=1.0 / speed)


def _top(speed, by):
    """A free body, round about its axis, on a pivot: without gravity axis and angular momentum stand still."""
    model = pin.Model()
    model.gravity.setZero()
    inertia = np.diag([0.02, 0.02, 0.03])
    add_body(model, 0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "top", 1.0, (0.0, 0.0, 0.3), inertia)
    add_frame(model, 1, "pivot")
    mech = Mechanism(model, [Loop("pivot", "point", "pivot")])
    spin = np.array([0.0, 0.0, 0.0, 0.3 * speed, 0.1 * speed, speed])
    sol = solved(by, mech, 20 * np.pi / speed, None, spin, atol=(RTOL, RTOL * speed))
    about_pivot = np.diag([0.11, 0.11, 0.03])
    momenta = [pin.Quaternion(q[3:7]).matrix() @ about_pivot @ v[3:] for q, v in zip(sol.q, sol.v, strict=True)]
    error = largest(np.subtract(momenta, momenta[0])) / largest(momenta[0])
    return [
        Figure("angular momentum, relative", error, GROWTH * RTOL),
        *certified(sol, energy_error=GROWTH * RTOL, position=1e-8),
    ]


def _hopeless(by):
    """More turns than steps are allowed: it must end, and say so."""
    solved(by, four_bar(gravity=0.0), 1.0, START, {"crank": 1e12}, tol=1e-6, atol=1e-8, max_steps=200)
    return [should_not_be("a success with fewer steps than turns")]
