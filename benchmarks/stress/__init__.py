"""The stress suite: what is tried, one file per kind of stress, and what held.

Every case has a criterion, stated next to its figure; see :mod:`benchmarks.stress.case`.
"""

from __future__ import annotations

from collections.abc import Iterator

from pinconsist import InputError

from . import forces, random_chains, scales, singular, starts, steps
from .case import Case

SUBJECTS = {
    "steps": lambda long, count, seed: steps.cases(long),
    "scales": lambda long, count, seed: scales.cases(),
    "singular": lambda long, count, seed: singular.cases(),
    "starts": lambda long, count, seed: starts.cases(),
    "forces": lambda long, count, seed: forces.cases(),
    "tolerances": lambda long, count, seed: steps.tolerance_cases(),
    "chains": lambda long, count, seed: random_chains.cases(count, seed),
}
"""Name → cases."""


def cases(subjects=(), *, long=False, count=100, seed=0) -> Iterator[Case]:
    """The cases of some subjects, or of all.

    With `long`, a million steps where drift is looked at, instead of ten thousand; `count` random chains, the first of
    them from `seed`. Raises InputError for an unknown subject, or a negative number.
    """
    for name in subjects:
        if name not in SUBJECTS:
            raise InputError(f"no stress subject {name!r}; known are {', '.join(SUBJECTS)}")
    if count < 0 or seed < 0:
        raise InputError(f"count and seed must not be negative, got {count} and {seed}")
    return (case for name in subjects or SUBJECTS for case in SUBJECTS[name](long, count, seed))
