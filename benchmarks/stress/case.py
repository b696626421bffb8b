"""A case of the stress suite, and how its outcome is judged.

A case holds where every figure keeps to its criterion, and is refused where the package ends it by an error of its own
or by a solution without success, both with a reason. Anything else has FAILED: a figure beyond its criterion or not a
number, an exception from below, a refusal where there is nothing to refuse, or a success where there is none to have.
"""

from __future__ import annotations

import re
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pinconsist import simulation
from pinconsist.dae.sizes import largest
from pinconsist.errors import PinconsistError

HELD, REFUSED, FAILED = "held", "refused", "FAILED"
EITHER = "held or refused"
MAX_STEPS = 50_000
"""Of every run of the suite: none can hang."""


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

    Attributes
    ----------
    family : str
        What kind of stress it is.
    varied : str
        What was varied, and to which value.
    check : callable
        ``check(by) -> sequence of Figure``; raises :class:`Refused` or an error of the package where it is declined.
        `by` has the functions ``simulate`` and ``integrate`` of :mod:`pinconsist.simulation`.
    expected : str
        HELD, REFUSED or EITHER.
    reason : str
        A regular expression that the reason of a refusal must contain.
    """

    family: str
    varied: str
    check: Callable[..., Sequence[Figure]]
    expected: str = HELD
    reason: str = ""


@dataclass(frozen=True)
class Outcome:
    """What came of a case.

    Attributes
    ----------
    family, varied : str
        As in the case.
    outcome : {"held", "refused", "FAILED"}
    reason : str
        Of a refusal or failure.
    measure : str
        What the figure is: of all figures of the case, the one that takes the largest share of its criterion.
    figure, criterion : float or None
    seconds : float
        How long the case took.
    """

    family: str
    varied: str
    outcome: str
    reason: str = ""
    measure: str = ""
    figure: float | None = None
    criterion: float | None = None
    seconds: float = 0.0


def run(case: Case) -> Outcome:
    """Try a case; never raises, but for an interruption from the keyboard."""
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
    """(outcome, reason, measure, figure, criterion) of a case that came back as a success."""
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


def relative(values, reference) -> float:
    """The largest difference, over 1 or the largest of the reference."""
    return largest(np.subtract(values, reference)) / max(1.0, largest(reference))
