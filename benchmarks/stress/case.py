"""A case of the stress suite, and how its outcome is judged.

A case holds where every figure keeps to its criterion, and is refused where the package ends it by an error of its own
or by a solution without success, both with a reason. Anything else has FAILED: a figure beyond its criterion or not a
number, an exception of another package, a refusal of a valid case, or a success where a refusal is expected.
"""

from __future__ import annotations

import re
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pinconsist import PinconsistError, assemble
from pinconsist.paper import reference_solution
from pinconsist.run import simulation

HELD, REFUSED, FAILED = "held", "refused", "FAILED"
EITHER = "held or refused"
MAX_STEPS = 50_000
"""Of every run of the suite: none can hang."""
RTOL = 1e-7
"""Default rtol and atol of a run."""


class Figure(NamedTuple):
    """A measured number, and the largest that it may be."""

    measure: str
    value: float
    criterion: float

    @property
    def share(self) -> float:
        """Of the criterion; above 1, or not a number, the figure does not hold."""
        return self.value / self.criterion


class Refused(Exception):
    """The package declined a case with a reason."""


@dataclass(frozen=True)
class Case:
    """One thing to try.

    ``check(by)`` returns figures, and raises :class:`Refused` or an error of the package where the case is declined;
    `by` has the functions ``simulate`` and ``integrate`` of :mod:`pinconsist.run.simulation`.
    """

    family: str  # what kind of stress it is
    varied: str  # what was varied, and to which value
    check: Callable[..., Sequence[Figure]]
    expected: str = HELD  # or REFUSED or EITHER
    reason: str = ""  # a regular expression that the reason of a refusal must contain


@dataclass(frozen=True)
class Outcome:
    """What came of a case: of all its figures the one that takes the largest share of its criterion."""

    family: str
    varied: str
    outcome: str  # HELD, REFUSED or FAILED
    reason: str = ""  # of a refusal or failure
    measure: str = ""  # what the figure is
    figure: float | None = None
    criterion: float | None = None
    seconds: float = 0.0  # how long the case took


def run(case: Case) -> Outcome:
    """Try a case; never raises, except for an interruption from the keyboard."""
    start = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)  # NaN must be met on purpose, not by way of numpy's warnings
        judged = _judged(case)
    return Outcome(case.family, case.varied, *judged, seconds=time.perf_counter() - start)


def _judged(case) -> tuple:
    try:
        figures = case.check(simulation)
    except (Refused, PinconsistError) as error:
        reason = str(error)
        if case.expected != HELD and not (reason and re.search(case.reason, reason)):
            return FAILED, f"was refused for another reason than {case.reason!r}: {reason}"
        return declined(case, reason)
    except Exception as error:
        return FAILED, f"{type(error).__name__}: {error}"
    return measured(case, figures)


def declined(case, reason) -> tuple:
    """(outcome, reason) of a case that was declined."""
    return (FAILED, f"was refused: {reason}") if case.expected == HELD else (REFUSED, reason)


def measured(case, figures) -> tuple:
    """(outcome, reason, measure, figure, criterion) of a case that was a success."""
    worst = max(figures, key=lambda figure: np.nan_to_num(figure.share, nan=np.inf))
    numbers = worst.measure, float(worst.value), float(worst.criterion)
    if case.expected == REFUSED:
        return FAILED, "came back as a success", *numbers
    if not worst.share <= 1.0:
        return FAILED, f"{worst.measure} is beyond its criterion", *numbers
    return HELD, "", *numbers


def completed(solution):
    """The solution, or Refused with its message where it is no success."""
    if not solution.success:
        raise Refused(solution.message)
    return solution


def solved(by, mech, until, q0=None, v0=None, *, tol=RTOL, **options):
    """The completed solution from t = 0 to `until` at one tolerance."""
    options = {"rtol": tol, "atol": tol, "max_steps": MAX_STEPS} | options
    return completed(by.simulate(mech, (0.0, until), q0, v0, **options))


NAMES = {
    "position": "loop gap [m]",
    "velocity": "velocity off the loops [m/s]",
    "energy_error": "energy error",
    "force": "constraint forces",
    "force_first": "first constraint forces",
}


def certified(sol, **criteria) -> list[Figure]:
    """Figures of the solution's certificate, by the names of its fields."""
    proof = sol.check()
    return [Figure(NAMES[name], getattr(proof, name), criterion) for name, criterion in criteria.items()]


def should_not_be(what, found=True) -> Figure:
    """A figure that holds only where `found` is false."""
    return Figure(what, float(found), 0.5)


def largest(values) -> float:
    return np.abs(values).max(initial=0.0)


def relative(values, reference) -> float:
    """The largest difference, over 1 or the largest of the reference."""
    return largest(np.subtract(values, reference)) / max(1.0, largest(reference))


def reference(mech, q0, v0, until):
    """First and last row of scipy's DOP853 at 1e-12, from the assembled start."""
    start = assemble(mech, q0, v0)
    return reference_solution(mech, 0.0, start.q, start.v, [0.0, until], rtol=1e-12, atol=1e-12)
