"""Singular positions, met and started from, and loops that say the same thing several times."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from scipy.integrate import solve_ivp

from pinconsist import Loop, load
from pinconsist.mechanism.system import MechanismSystem

from ..linkages import GRAVITY, START, four_bar
from .case import EITHER, HELD, REFUSED, Case, Figure, certified, largest, relative, solved


def cases():
    singular, redundant = "singular configuration", "redundant loops"
    for n in (1, 2, 5):
        yield Case(singular, f"{n} parallelograms through several", partial(_parallelograms, n, 2.0, 0.0))
    for exponent in range(1, 13):
        away = 10.0**-exponent
        expected = HELD if exponent <= 3 else EITHER  # nearer, v is known to less than the tolerance on the way through
        check = partial(_parallelograms, 1, 0.3, np.pi / 2 - away)
        yield Case(singular, f"start {away:.0e} rad from one", check, expected, "singular|dependent|branch")
    yield Case(singular, "start in one", partial(_parallelograms, 1, 0.3, np.pi / 2), REFUSED, "singular")
    for count in (2, 3, 5):
        for scene in ("four_bar", "bricard", "stewart_platform", "five_bar"):
            yield Case(redundant, f"{scene}, each loop {count} times", partial(_repeated, scene, count))
    for kinds in (("hinge",), ("point", "hinge"), ("frame",), ("hinge", "hinge", "point", "distance")):
        expected = REFUSED if "frame" in kinds else HELD
        yield Case(redundant, f"four-bar closed by {' and '.join(kinds)}", partial(_kinds, kinds), expected)


def _parallelograms(n, until, angle, by):
    """On the branch where all cranks stay parallel it is one pendulum, integrated by scipy on its angle alone."""
    mech = load(f"n_four_bar_{n}")
    cranks = [joint for joint in mech.joints if joint.startswith("crank")]
    coupler = next(joint for joint in mech.joints if joint.startswith("coupler"))
    sol = solved(by, mech, until, dict.fromkeys(cranks, angle) | {coupler: -angle}, {"crank0": 1.0})
    torque, inertia = GRAVITY * ((n + 1) / 2 + n), (n + 1) / 3 + n
    answer = solve_ivp(
        lambda t, y: [y[1], torque / inertia * np.sin(y[0])],
        (0.0, until), [angle, 1.0], "DOP853", rtol=1e-12, atol=1e-12,
    ).y[:, -1]  # fmt: skip
    columns = [mech.columns(joint).start for joint in cranks]
    return [
        Figure("crank angles, of the parallel branch", largest(sol.q[-1][columns] - answer[0]), 1e-3),
        Figure("crank rates, of the parallel branch", largest(sol.v[-1][columns] - answer[1]), 1e-2),
        *certified(sol, energy_error=1e-3, position=1e-8),
    ]


def _repeated(scene, count, by):
    """The same loop again changes nothing but how the load is shared: q, v and Jᵀλ stay."""
    once = load(scene)
    copies = [replace(loop, name=f"{loop.name}_{i}") for i in range(1, count) for loop in once.loops]
    return _same_motion(once, once.add_loops(*copies), None, by)


def _kinds(kinds, by):
    """The chain's end closed in several ways at once; only a welded end leaves nothing to move."""
    once = four_bar()
    end, loops = once.loops[0], []
    for i, kind in enumerate(kinds):
        options = {"xyz2": end.xyz2}
        if kind == "hinge":
            options["axis"] = (0, 1, 0)
        if kind == "distance":  # to the point below, at the distance that the closed loop has
            options = {"length": 1.0, "xyz2": (end.xyz2[0], 0.0, -1.0)}
        loops.append(Loop(f"{kind}{i}", kind, end.frame1, end.frame2, **options))
    return _same_motion(once, once.with_loops(*loops), START, by)


def _same_motion(one, other, q0, by):
    # A fixed step: where an error test chooses it, rounding may choose another for the other system. Peers do choose.
    options = {"t_eval": np.linspace(0.0, 0.5, 11)} | ({} if hasattr(by, "peer") else {"step": 0.005})
    sols = [solved(by, mech, 0.5, q0, **options) for mech in (one, other)]
    forces = []
    for mech, sol in zip((one, other), sols, strict=True):
        system = MechanismSystem(mech, sol.q[0])
        forces.append([system.loop_rows(q)[1].T @ lam for q, lam in zip(sol.q, sol.lam, strict=True)])
    a, b = sols
    return [
        Figure("q of one loop and of several", relative(b.q, a.q), 1e-9),
        Figure("v of one loop and of several", relative(b.v, a.v), 1e-8),
        Figure("Jᵀλ of one loop and of several", largest(np.subtract(*forces)) / largest(forces[0]), 1e-7),
    ]
