"""What the constants of the method are worth: each halved and doubled, ``python -m benchmarks ablate --constants``."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from pinconsist import PinconsistError, assemble, load, simulate
from pinconsist.engine import required

RTOL, ATOL = 1e-6, 1e-8
OF_TABLES = {"FEWEST_STAGES", "FIRST_STAGES", "MOST_STAGES"}  # numbers of stages: there are formulas for some only
FINE = 1e-11  # tolerance of the references
METHODS = ("Radau", "BDF")


@dataclass(frozen=True)
class Worth:
    """A constant with a factor: over all scenes and both methods, relative to the runs without the factor.

    Times are of the processor, medians of the rounds. Errors are of q and v at the end, in tolerances.
    """

    constant: str
    value: float
    factor: float
    time: float  # geometric mean of the ratios
    slowest: float  # the largest of them
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


def worths(scenes: dict[str, float], rounds: int = 3) -> Iterator[Worth]:
    """A :class:`Worth` for each constant and each of the factors 1/2 and 2; `scenes` maps names to durations, s."""
    cases = [(scene, method) for scene in scenes for method in METHODS]
    ends = {scene: _end(scene, until, "Radau", FINE, FINE)[1] for scene, until in scenes.items()}
    _runs(cases, scenes, 1)  # warms up
    _, errors = _measured(cases, scenes, ends, 1)
    for name, value in sorted(required().constants().items()):
        if name in OF_TABLES:
            continue
        plain, halved, doubled = [], [], []
        for _ in range(rounds):  # in turn, as the speed of the machine changes
            plain.append(_runs(cases, scenes, 1)[0])
            for factor, times in ((0.5, halved), (2.0, doubled)):
                with changed(name, factor * value):
                    times.append(_runs(cases, scenes, 1)[0])
        for factor, times in ((0.5, halved), (2.0, doubled)):
            with changed(name, factor * value):
                worst = _measured(cases, scenes, ends, 1)[1].max()
            ratios = np.median(np.array(times) / np.array(plain), axis=0)
            slowest = int(np.argmax(ratios))
            mean = float(np.exp(np.log(ratios).mean()))
            where = " ".join(cases[slowest])
            yield Worth(name, value, factor, mean, float(ratios[slowest]), where, float(worst), float(errors.max()))


def _measured(cases, scenes, ends, rounds):
    """Times and errors of the cases."""
    times, states = _runs(cases, scenes, rounds)
    errors = []
    for (scene, _), state in zip(cases, states, strict=True):
        exact = ends[scene]
        errors.append(np.nan if state is None else np.max(np.abs(state - exact) / (ATOL + RTOL * np.abs(exact))))
    return times, np.array(errors)


def _runs(cases, scenes, rounds):
    """(s of the processor, least of some rounds; state at the end) of each case."""
    found = [min((_end(s, scenes[s], method) for _ in range(rounds)), key=lambda each: each[0]) for s, method in cases]
    return [seconds for seconds, _ in found], [state for _, state in found]


def _end(scene, until, method, rtol=RTOL, atol=ATOL):
    mech = load(scene)
    start = assemble(mech)
    begun = time.process_time()
    try:
        sol = simulate(mech, (0.0, until), start.q, start.v, method=method, rtol=rtol, atol=atol, max_steps=200_000)
    except PinconsistError:
        return time.process_time() - begun, None
    seconds = time.process_time() - begun
    return seconds, np.concatenate((sol.q[-1], sol.v[-1])) if sol.success else None
