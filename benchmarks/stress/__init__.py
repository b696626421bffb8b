"""The stress suite: what is tried, one file per kind of stress, and what held.

Every case has a criterion, stated next to its figure; see :mod:`benchmarks.stress.case`.
"""

from __future__ import annotations

from collections.abc import Iterator

from pinconsist import InputError

from . import forces, scales, singular, starts, steps
from .case import Case

SUBJECTS = {
    "steps": steps.cases,
    "scales": lambda long: scales.cases(),
    "singular": lambda long: singular.cases(),
    "starts": lambda long: starts.cases(),
    "forces": lambda long: forces.cases(),
    "tolerances": lambda long: steps.tolerance_cases(),
}
"""Name → cases."""


def cases(subjects=(), *, long=False) -> Iterator[Case]:
    """The cases of some subjects, or of all.

    With `long`, a million steps where drift is looked at, instead of ten thousand. Raises InputError for an unknown
    subject.
    """
    for name in subjects:
        if name not in SUBJECTS:
            raise InputError(f"no stress subject {name!r}; choose from {', '.join(SUBJECTS)}")
    return (case for name in subjects or SUBJECTS for case in SUBJECTS[name](long))
