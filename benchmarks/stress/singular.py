"""Singular positions, met and started from, and loops that say the same thing several times."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from scipy.integrate import solve_ivp

from pinconsist.dae.sizes import largest
from pinconsist.formats.load import load
from pinconsist.mechanism.loops import Loop
from pinconsist.mechanism.system import MechanismSystem

from .case import EITHER, HELD, MAX_STEPS, REFUSED, Case, Figure, completed, relative
from .scenes import GRAVITY, START, four_bar

RTOL = 1e-7


def cases():
    """Yield the cases."""
    for n in (1, 2, 5):
        yield Case(
            "singular position", f"{n} parallelograms through several", partial(_parallelograms, n, 2.0, 1.0, 0.0)
        )
    for exponent in range(1, 13):
        away = 10.0**-exponent
        expected = HELD if exponent <= 3 else EITHER  # nearer, v is known to less than the tolerance on the way through
        check = partial(_parallelograms, 1, 0.3, 1.0, np.pi / 2 - away)
        yield Case("singular position", f"start {away:.0e} rad from one", check, expected, "singular|dependent|branch")
    yield Case(
        "singular position", "start in one", partial(_parallelograms, 1, 0.3, 1.0, np.pi / 2), REFUSED, "singular"
    )
    for count in (2, 3, 5):
        for scene in ("four_bar", "bricard", "stewart_platform", "five_bar"):
            yield Case("redundant loops", f"{scene}, each loop {count} times", partial(_repeated, scene, count))
    for kinds in (("hinge",), ("point", "hinge"), ("frame",), ("hinge", "hinge", "point", "distance")):
        expected = REFUSED if "frame" in kinds else HELD
        yield Case("redundant loops", f"four-bar closed by {' and '.join(kinds)}", partial(_kinds, kinds), expected)


def _parallelograms(n, until, rate, angle, by):
    """On the branch where all cranks stay parallel it is one pendulum, integrated by scipy on its angle alone."""
    mech = load(f"n_four_bar_{n}")
    cranks = [joint for joint in mech.joints if joint.startswith("crank")]
    couplers = [joint for joint in mech.joints if joint.startswith("coupler")]
    q0 = {joint: angle for joint in cranks} | {couplers[0]: -angle}
    sol = completed(by.simulate(mech, (0.0, until), q0, {"crank0": rate}, rtol=RTOL, atol=RTOL, max_steps=MAX_STEPS))
    torque, inertia = GRAVITY * ((n + 1) / 2 + n), (n + 1) / 3 + n
    answer = solve_ivp(
        lambda t, y: [y[1], torque / inertia * np.sin(y[0])],
        (0.0, until), [angle, rate], "DOP853", rtol=1e-12, atol=1e-12,
    ).y[:, -1]  # fmt: skip
    columns = [mech.columns(joint).start for joint in cranks]
    proof = sol.check()
    return [
        Figure("crank angles, of the parallel branch", largest(sol.q[-1][columns] - answer[0]), 1e-3),
        Figure("crank rates, of the parallel branch", largest(sol.v[-1][columns] - answer[1]), 1e-2),
        Figure("energy error", proof.energy_error, 1e-3),
        Figure("loop gap [m]", proof.position, 1e-8),
    ]


def _repeated(scene, count, by):
    """The same loop again changes nothing but how the load is shared: q, v and Jᵀλ stay."""
    once = load(scene)
    copies = [replace(loop, name=f"{loop.name}_{i}") for i in range(1, count) for loop in once.loops]
    return _same_motion(once, once.with_loops(*once.loops, *copies), None, by)


def _kinds(kinds, by):
    """The chain's end closed in several ways at once; only a welded end leaves nothing to move."""
    once = four_bar()
    end = once.loops[0]
    loops = []
    for i, kind in enumerate(kinds):
        more = {"axis": (0, 1, 0)} if kind == "hinge" else {}
        xyz = end.xyz2
        if kind == "distance":  # to the point below, at the distance that the closed loop has
            more, xyz = {"length": 1.0}, (end.xyz2[0], 0.0, -1.0)
        loops.append(Loop(f"{kind}{i}", kind, end.frame1, end.frame2, xyz2=xyz, **more))
    return _same_motion(once, once.with_loops(*loops), START, by)


def _same_motion(one, other, q0, by):
    until = 0.5
    options = {"rtol": RTOL, "atol": RTOL, "max_steps": MAX_STEPS, "t_eval": np.linspace(0.0, until, 11)}
    if not hasattr(by, "peer"):  # an error test could choose other steps for the other system, by rounding alone
        options["step"] = until / 100
    a, b = (completed(by.simulate(mech, (0.0, until), q0, **options)) for mech in (one, other))
    forces = []
    for mech, sol in ((one, a), (other, b)):
        system = MechanismSystem(mech, sol.q[0])
        forces.append([system.loop_rows(q)[1].T @ lam for q, lam in zip(sol.q, sol.lam, strict=True)])
    size = largest(forces[0])
    return [
        Figure("q of one loop and of several", relative(b.q, a.q), 1e-9),
        Figure("v of one loop and of several", relative(b.v, a.v), 1e-8),
        Figure("Jᵀλ of one loop and of several", largest(np.subtract(*forces)) / size, 1e-7),
    ]
