"""What the constants of the method are worth: each halved and doubled, ``python -m benchmarks ablate --constants``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from pinconsist import PinconsistError, assemble, load, simulate
from pinconsist.engine import required

RTOL, ATOL = 1e-6, 1e-8
FINE = 1e-11  # tolerance of the references
MOST_STEPS = 200_000
METHODS = ("Radau", "BDF")
OF_TABLES = {"FEWEST_STAGES", "FIRST_STAGES", "MOST_STAGES"}  # numbers of stages: there are formulas for some only


@dataclass(frozen=True)
class Worth:
    """A constant with a factor: over all scenes and both methods, relative to the runs without the factor.

    The work is the number of residuals, which does not depend on the machine. Errors are of q and v at the end, in
    tolerances.
    """

    constant: str
    value: float
    factor: float
    work: float  # geometric mean of the ratios
    most: float  # the largest of them
    where: str  # the scene and method of the latter
    error: float  # the largest, over all scenes; NaN if a run failed
    error_before: float


@contextmanager
def changed(name: str, value: float):
    """The constant has another value within the block."""
    module = required()
    before = module.constant(name)
    module.set_constant(name, value)
    try:
        yield
    finally:
        module.set_constant(name, before)


def worths(scenes: dict[str, float]) -> Iterator[Worth]:
    """A :class:`Worth` for each constant and each of the factors 1/2 and 2; `scenes` maps names to durations, s."""
    cases = [(scene, method) for scene in scenes for method in METHODS]
    exact = {scene: _run(scene, until, "Radau", FINE, FINE)[1] for scene, until in scenes.items()}
    work, errors = _runs(cases, scenes, exact)
    for name, value in sorted(required().constants().items()):
        for factor in (0.5, 2.0) if name not in OF_TABLES else ():
            with changed(name, factor * value):
                own_work, own_errors = _runs(cases, scenes, exact)
            ratios = own_work / work
            mean, most = float(np.exp(np.log(ratios).mean())), int(np.argmax(ratios))
            ends = float(own_errors.max()), float(errors.max())
            yield Worth(name, value, factor, mean, float(ratios[most]), " ".join(cases[most]), *ends)


def _runs(cases, scenes, exact):
    """Residuals and errors of the cases."""
    work, errors = np.ones(len(cases)), np.full(len(cases), np.nan)
    for i, (scene, method) in enumerate(cases):
        work[i], end = _run(scene, scenes[scene], method)
        if end is not None:
            errors[i] = np.max(np.abs(end - exact[scene]) / (ATOL + RTOL * np.abs(exact[scene])))
    return work, errors


def _run(scene, until, method, rtol=RTOL, atol=ATOL):
    """(number of residuals, state at the end or None) of a run from rest."""
    mech = load(scene)
    start, given = assemble(mech), {"method": method, "rtol": rtol, "atol": atol, "max_steps": MOST_STEPS}
    try:
        sol = simulate(mech, (0.0, until), start.q, start.v, **given)
    except PinconsistError:
        return 1.0, None
    return float(sol.nfev), np.concatenate((sol.q[-1], sol.v[-1])) if sol.success else None
