"""Step sizes down to 1e-9 s against the theory of rounding, and drift over very many steps."""

from __future__ import annotations

from functools import partial

import numpy as np
import pinocchio as pin

from pinconsist.dae.sizes import largest
from pinconsist.mechanism.loops import GROUND, Loop
from pinconsist.mechanism.mechanism import Mechanism
from pinconsist.reference import reference_problem

from .case import Case, Figure, completed
from .scenes import GRAVITY, add_frame, four_bar

EPS = np.finfo(float).eps
STEPS = 20
TRUNCATION = {1: 10.0, 3: 40.0, 5: 1000.0}
"""C of the bound C hᵏ of the multipliers' error, 2 to 4 times what problem 5.1 shows at h = 1/400."""
ROUNDING = 100.0
"""Of eps/h (eps/h² where the steps are not corrected); about 10 is what is seen."""


def cases(long=False):
    """Yield the cases; `long` for the million steps."""
    sizes = [10.0**-n for n in range(2, 10)]
    for name in ("problem51", "problem52"):
        for order in TRUNCATION:
            for h in sizes:
                yield Case("step size", f"{name}, order {order}, h = {h:.0e} s", partial(_floor, name, order, h))
    for h in sizes:
        yield Case("step size", f"problem51, order 1, h = {h:.0e} s, raw", partial(_raw_floor, h))
    count = 1_000_000 if long else 10_000
    yield Case("drift", f"pendulum, order 5, {count:,} steps of 1 ms", partial(_pendulum, count))
    yield Case("drift", f"four-bar, order 3, {count:,} steps of 1 ms", partial(_four_bar, count))


def _run(by, name, order, h, **options):
    problem = reference_problem(name)
    span = problem.t0, problem.t0 + STEPS * h
    sol = completed(by.integrate(problem.system, span, problem.p0, problem.v0, step=h, max_order=order, **options))
    p, v, lam = (np.array(column) for column in zip(*map(problem.exact, sol.t), strict=True))
    return sol, p, v, lam


def _floor(name, order, h, by):
    sol, p, v, lam = _run(by, name, order, h)
    truncation, floor = TRUNCATION[order] * h**order, ROUNDING * EPS / h
    span = STEPS * h
    return [
        Figure("error of λ against C hᵏ + 100 eps/h", largest((sol.lam - lam)[1:]), truncation + floor),
        Figure("error of v", largest(sol.v - v), truncation * span + ROUNDING * EPS),
        Figure("error of q", largest(sol.q - p), truncation * span + ROUNDING * EPS),
    ]


def _raw_floor(h, by):
    """From exact values the first multiplier is off by its nature; noise at least is told by the certificate."""
    sol, _, _, lam = _run(by, "problem51", 1, h, consistency="exact")
    error = largest((sol.lam - lam)[2:])
    figures = [Figure("error of λ against C h + 100 eps/h²", error, 2 * TRUNCATION[1] * h + ROUNDING * EPS / h**2)]
    if error > 0.05 * largest(lam):
        told = any("constraint forces" in concern for concern in sol.check().concerns)
        figures.append(Figure("noise in λ that check() does not tell", 0.0 if told else 1.0, 0.5))
    return figures


def _pendulum(count, by):
    """A point mass on a rod of 1 m in Cartesian coordinates, from the horizontal (IFToMM A01)."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -GRAVITY])
    x = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "x")
    z = model.addJoint(x, pin.JointModelPZ(), pin.SE3.Identity(), "z")
    model.appendBodyToJoint(z, pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
    add_frame(model, z, "mass", pin.SE3.Identity())
    mech = Mechanism(model, [Loop("rod", "distance", GROUND, "mass", length=1.0)], guess=[-1.0, 0.0])
    return _drift(by, mech, count, 5, None, 1e-9)


def _four_bar(count, by):
    return _drift(by, four_bar(), count, 3, {"crank": -1.0}, 1e-5)


def _drift(by, mech, count, order, q0, energy_error):
    """`energy_error` is of 10⁴ steps: a method's dissipation adds up in proportion to time, rounding more slowly."""
    until, rows = 1e-3 * count, np.arange(0, count + 1, 50)
    sol = completed(
        by.simulate(mech, (0.0, until), q0, step=1e-3, max_order=order, t_eval=np.minimum(1e-3 * rows, until))
    )
    proof = sol.check()
    return [
        Figure("loop gap [m]", proof.position, 1e-12),
        Figure("velocity off the loops [m/s]", proof.velocity, 1e-11),
        Figure("energy error", proof.energy_error, energy_error * count / 10_000),
    ]
