"""The scenes of ``python -m benchmarks work-precision``, each with its start and its time span."""

from __future__ import annotations

from pathlib import Path

from pinconsist import AssemblyError, InputError, assemble, load
from pinconsist.formats.catalogue import is_built_in
from pinconsist.paper import reference_problem

from ..linkages import BUSHING, DAMPER, pendulum, stiff_four_bar
from .problem import Problem

STARTS = {  # span in s, start, velocities, what it is; and what makes a scene that is none of the models
    "andrews": ((0.0, 0.03), None, None, "Andrews' squeezing mechanism"),
    "crank_rocker": ((0.0, 5.0), {"crank": 0.0}, {"crank": 12.0}, "crank at 12 rad/s"),
    "bricard": ((0.0, 1.2), None, None, "from rest, until just before the rows that are kept are a poor choice"),
    "pendulum": ((0.0, 5.0), None, None, "point mass on a rod of constant length, from rest", pendulum),
    "stiff_four_bar": (  # four turns: the reference follows so far
        (0.0, 2.0), None, {"crank": 12.0},
        f"crank-rocker, its coupler cut by a bushing of {BUSHING:g} N/m with {DAMPER:g} N·s/m, crank at 12 rad/s",
        stiff_four_bar,
    ),
}  # fmt: skip
OTHERS = ((0.0, 1.0), None, None, "from rest")
CHAINS = ((0.0, 0.1), None, None, "from rest")  # ever more links whip ever faster


def problem_of(name: str, until: float | None = None) -> Problem:
    """A scene by name, or any mechanism by name or path: released from rest for 1 s (chains: 0.1 s), or `until`.

    A file whose loops cannot close as written has them closed as points.
    """
    if name == "problem51":
        given = reference_problem(name)
        span, about = (0.0, 1.0), "Arévalo (2008), problem 5.1"
        return Problem(name, about, given.system, (0.0, until or span[1]), given.p0, given.v0)
    span, q0, v0, about, *build = STARTS.get(name, CHAINS if name.startswith("chain_") else OTHERS)
    mechanism = build[0]() if build else load(name)
    try:
        assembly = assemble(mechanism, q0, v0)
    except AssemblyError:
        if is_built_in(name) or name in STARTS:
            raise
        mechanism, about = load(name, closure="point"), f"{about}; does not close as written: loops closed as points"
        assembly = assemble(mechanism, q0, v0)
    label = name if is_built_in(name) or name in STARTS else Path(name).stem
    if until is not None and not until > 0:
        raise InputError(f"a scene must run for a positive number of seconds, got {until:g}")
    return Problem(label, about, mechanism, (0.0, until or span[1]), assembly.q, assembly.v)
