"""What the rules of the method are worth: each switched off by its constant, ``python -m benchmarks ablate --rules``.

Scenes at rest, a chain, and N four-bars that pass singular positions, from loose to tight tolerances. What a rule is
for need not be among them: its tests say it, see the meaning of its constant in ``engine/tuning.hpp``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from pinconsist import PinconsistError, load, models, simulate

from .constants import changed

TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-9)
FINE = 1e-12  # tolerance of the references, of Radau
LONGEST_RUN, SINGULAR = 0.5, 2.0  # s
MAX_STEPS = 60_000
NEVER = 1e300
LEAST_ERROR = 0.3  # tolerances: smaller errors count as this
OFF = {
    "Radau": {
        "UNMOVED": 0.0, "STAGNATED": 0.0, "LAST": 0.0, "NOTABLE": 0.0, "FITTING": NEVER, "RESOLVED": NEVER,
        "NEXT_MODE": 0.0, "BETWEEN": NEVER, "CALM": 0.0, "FELT": 0.0,
        "RESTARTED": NEVER, "STIFF": NEVER, "STIFF_PART": 0.0, "UNSEEN": 0.0, "COARSE": NEVER, "SETBACKS": 1e9,
        "POSITION_ROUNDING": 0.0, "STAGE_LEFT": NEVER, "FIRST_CHANGE": 0.0,
    },
    "BDF": {
        "UNMOVED": 0.0, "STAGNATED": 0.0, "LAST": 0.0, "LOWER_ORDER": 1.0, "START_APART": 1.0, "UNNOTICED": 1.0,
        "PROBING": 1e9, "SUDDEN": NEVER, "BESIDE": NEVER, "SETBACKS": 1e9, "POSITION_ROUNDING": 0.0,
        "VELOCITY_ROUNDING": 0.0,
    },
}  # fmt: skip
"""Method → constant → the value with which its rule never acts."""


@dataclass(frozen=True)
class RuleWorth:
    """A rule that is switched off: over all scenes and tolerances, relative to the runs with it."""

    method: str
    constant: str
    off: float  # value of the constant
    changed: int  # runs whose number of steps is another
    runs: int
    steps: float  # geometric mean of the ratios
    most: float  # the largest of them
    error: float  # the largest ratio of errors; those below LEAST_ERROR tolerances count as this
    where: str  # of the latter
    failures: str  # runs that reached their end with the rule only


def rules(methods=tuple(OFF), scenes=None) -> Iterator[RuleWorth]:
    """A :class:`RuleWorth` for each rule; `scenes` maps names to (duration, start velocities)."""
    scenes = scenes or _scenes()
    exact = {name: _run(name, *about, "Radau", FINE)[1] for name, about in scenes.items()}
    cases = [(name, tol) for name in scenes for tol in TOLERANCES]
    for method in methods:
        before = {case: _run(case[0], *scenes[case[0]], method, case[1]) for case in cases}
        for constant, off in OFF[method].items():
            with changed(constant, off):
                after = {case: _run(case[0], *scenes[case[0]], method, case[1]) for case in cases}
            yield _compared(method, constant, off, before, after, exact)


def _compared(method, constant, off, before, after, exact) -> RuleWorth:
    both = [case for case in before if before[case][1] is not None and after[case][1] is not None]
    ratios = np.array([after[case][0] / before[case][0] for case in both])
    errors = [_error(after, case, exact) / max(_error(before, case, exact), LEAST_ERROR) for case in both]
    worst = int(np.argmax(errors))
    name, tol = both[worst]
    failed = [f"{name} {tol:g}" for name, tol in before if (name, tol) not in both and before[name, tol][1] is not None]
    return RuleWorth(
        method=method,
        constant=constant,
        off=off,
        changed=sum(before[case][0] != after[case][0] for case in before),
        runs=len(before),
        steps=float(np.exp(np.log(ratios).mean())),
        most=float(ratios.max()),
        error=float(errors[worst]),
        where=f"{name} {tol:g}",
        failures=", ".join(failed),
    )


def _error(found, case, exact) -> float:
    """The error of q and v at the end, in tolerances."""
    name, tol = case
    return float(np.max(np.abs(found[case][1] - exact[name]) / (tol * (1.0 + np.abs(exact[name]).max()))))


def _scenes() -> dict:
    found = {}
    for name in [*(name for name in models() if "<" not in name), "chain_16"]:
        found[name] = min(load(name).duration, LONGEST_RUN), 0.0
    return found | {f"n_four_bar_{n}": (SINGULAR, -1.0) for n in (2, 10, 20)}


def _run(name, until, speed, method, tol):
    """(number of steps, state at the end or None) of a run with this speed of the first motor or joint."""
    mech = load(name)
    v0 = {(mech.actuated or mech.joints)[0]: speed} if speed else None
    try:
        sol = simulate(mech, (0.0, until), v0=v0, method=method, rtol=tol, atol=0.01 * tol, max_steps=MAX_STEPS)
    except PinconsistError:
        return 0, None
    return sol.nsteps, np.concatenate((sol.q[-1], sol.v[-1])) if sol.success else None
