"""Step sizes down to 1e-9 s against the theory of rounding, drift over very many steps, and tolerances to 1e-13."""

from __future__ import annotations

from functools import cache, partial

import numpy as np

from pinconsist import load
from pinconsist.paper import reference_problem

from ..linkages import START, four_bar, pendulum
from .case import EITHER, HELD, Case, Figure, certified, completed, largest, reference, relative, should_not_be, solved

EPS = np.finfo(float).eps
STEPS = 20
TRUNCATION = {1: 10.0, 3: 40.0, 5: 1000.0}
"""C of the bound C hᵏ of the multipliers' error, 2 to 4 times what problem 5.1 shows at h = 1/400."""
ROUNDING = 100.0
"""Of eps/h (eps/h² where the steps are not corrected); about 10 is what is seen."""
UNTIL = 0.5
SPEEDS = {"crank_rocker": {"crank": 12.0}, "four_bar": None, "bricard": None, "stewart_platform": None}
GROWTH = 1e3
"""Of the tolerance, that an end error may have: these mechanisms move on for many times their steps."""
FLOOR = 1e-9
"""Of the errors, what is left at tolerances near rounding."""


def cases(long=False):
    """Yield the cases of step sizes; `long` for the million steps."""
    sizes = [10.0**-n for n in range(2, 10)]
    for name in ("problem51", "problem52"):
        for order in TRUNCATION:
            for h in sizes:
                yield Case("step size", f"{name}, order {order}, h = {h:.0e} s", partial(_floor, name, order, h))
    for h in sizes:
        yield Case("step size", f"problem51, order 1, h = {h:.0e} s, raw", partial(_raw_floor, h))
    count = 1_000_000 if long else 10_000
    yield Case("drift", f"pendulum, order 5, {count:,} steps of 1 ms", partial(_drift, pendulum, None, count, 5, 1e-9))
    yield Case("drift", f"four-bar, order 3, {count:,} steps of 1 ms", partial(_drift, four_bar, START, count, 3, 1e-5))


def tolerance_cases():
    """Yield the cases of tolerances: an error in proportion, bounded work, no step size below the rounding floor."""
    for scene in SPEEDS:
        for exponent in range(2, 14):
            expected = HELD if exponent <= 10 else EITHER
            yield Case("tolerance", f"{scene}, rtol = atol = 1e-{exponent:02}", partial(_at, scene, exponent), expected)


def _run(by, name, order, h, **options):
    problem = reference_problem(name)
    span = problem.t0, problem.t0 + STEPS * h
    sol = completed(
        by.integrate(problem.system, span, problem.p0, problem.v0, method="BDF", step=h, order=order, **options)
    )
    p, v, lam = (np.array(column) for column in zip(*map(problem.exact, sol.t), strict=True))
    return sol, p, v, lam


def _floor(name, order, h, by):
    sol, p, v, lam = _run(by, name, order, h)
    truncation = TRUNCATION[order] * h**order
    state = truncation * STEPS * h + ROUNDING * EPS
    return [
        Figure("error of λ against C hᵏ + 100 eps/h", largest((sol.lam - lam)[1:]), truncation + ROUNDING * EPS / h),
        Figure("error of v", largest(sol.v - v), state),
        Figure("error of q", largest(sol.q - p), state),
    ]


def _raw_floor(h, by):
    """From exact values the first multiplier is off by its nature; the certificate reports noise at least."""
    sol, _, _, lam = _run(by, "problem51", 1, h, consistency="exact")
    error = largest((sol.lam - lam)[2:])
    figures = [Figure("error of λ against C h + 100 eps/h²", error, 2 * TRUNCATION[1] * h + ROUNDING * EPS / h**2)]
    if error > 0.05 * largest(lam):
        silent = not any("constraint forces" in concern for concern in sol.check().concerns)
        figures.append(should_not_be("noise in λ that check() does not report", silent))
    return figures


def _drift(build, q0, count, order, energy_error, by):
    """`energy_error` is of 10⁴ steps: a method's dissipation adds up in proportion to time, rounding more slowly."""
    until, rows = 1e-3 * count, np.arange(0, count + 1, 50)
    options = {"method": "BDF", "step": 1e-3, "order": order, "t_eval": np.minimum(1e-3 * rows, until)}
    sol = completed(by.simulate(build(), (0.0, until), q0, **options))
    return certified(sol, position=1e-12, velocity=1e-11, energy_error=energy_error * count / 10_000)


@cache
def _answer(scene):
    return reference(load(scene), None, SPEEDS[scene], UNTIL)


def _at(scene, exponent, by):
    tol, rows = 10.0**-exponent, _answer(scene)
    sol = solved(by, load(scene), UNTIL, None, SPEEDS[scene], tol=tol, max_steps=int(20 * tol**-0.25) + 500)
    return [
        Figure("error of q", relative(sol.q[-1], rows.q[-1]), GROWTH * tol + FLOOR),
        Figure("error of v, relative", relative(sol.v[-1], rows.v[-1]), GROWTH * tol + FLOOR),
        *certified(sol, position=max(1e-10, 1e-2 * tol), force_first=10 * GROWTH * tol + 100 * FLOOR),
    ]
