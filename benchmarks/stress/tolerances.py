"""Tolerances from 1e-2 to 1e-13: an error in proportion, bounded work, and no step size below the rounding floor."""

from __future__ import annotations

from functools import cache, partial

from pinconsist.formats.load import load

from .case import EITHER, HELD, Case, Figure, completed, relative
from .scenes import reference

UNTIL = 0.5
SCENES = {"crank_rocker": {"crank": 12.0}, "four_bar": None, "bricard": None, "stewart_platform": None}
GROWTH = 1e3
"""Of the tolerance, that an end error may have: these mechanisms move on for many times their steps."""
FLOOR = 1e-9
"""Of the errors, what is left at tolerances near rounding."""


def cases():
    """Yield the cases."""
    for scene in SCENES:
        for exponent in range(2, 14):
            expected = HELD if exponent <= 10 else EITHER
            yield Case("tolerance", f"{scene}, rtol = atol = 1e-{exponent:02}", partial(_at, scene, exponent), expected)


@cache
def _answer(scene):
    return reference(load(scene), None, SCENES[scene], UNTIL)


def _at(scene, exponent, by):
    tol = 10.0**-exponent
    most = int(20 * tol**-0.25) + 500
    sol = completed(by.simulate(load(scene), (0.0, UNTIL), None, SCENES[scene], rtol=tol, atol=tol, max_steps=most))
    proof, rows = sol.check(), _answer(scene)
    return [
        Figure("error of q", relative(sol.q[-1], rows.q[-1]), GROWTH * tol + FLOOR),
        Figure("error of v, relative", relative(sol.v[-1], rows.v[-1]), GROWTH * tol + FLOOR),
        Figure("loop gap [m]", proof.position, max(1e-10, 1e-2 * tol)),
        Figure("first constraint forces", proof.force_first, 10 * GROWTH * tol + 100 * FLOOR),
    ]
