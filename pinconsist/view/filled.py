"""Solutions for curves: rows, and states between them until straight lines join them well."""

import logging
from dataclasses import replace

import numpy as np

from ..errors import PinconsistError

ROWS = 500  # points of a curve; up to twice as many where rows are far apart
FAR_FROM_LINE = 0.02  # of its range: a value farther from the line through its neighbours needs more points around it
ROUNDS = 4  # of such points
log = logging.getLogger(__name__)


class Arrays:
    """Rows that are no Solution, for instance those of another program; it has nothing of what else a run knows."""

    certificate = contacts = mechanism = system = None
    h = order = ()

    def __init__(self, rows):
        self.method: dict = {}
        self.held: dict = {}
        for name in ("t", "q", "v", "lam"):
            if hasattr(rows, name):
                setattr(self, name, getattr(rows, name))


def as_solution(rows):
    """A Solution as it is, and other objects with its arrays as :class:`Arrays`."""
    return rows if hasattr(rows, "evaluate") else Arrays(rows)


def is_continuous(sol) -> bool:
    """Whether the states between the rows of a result can be computed.

    Multipliers of fixed steps of BDF, and those from exact initial values, have an error of their own, which is shown
    as it is, by lines between rows.
    """
    fixed = sol.method.get("step") is not None and sol.method.get("method") != "Radau"
    every = sol.method.get("consistency") == "every-step"
    return every and not fixed and len(sol.t) > 1


def filled(sol, scene=None, rows=None):
    """A solution with some of its rows, by default all, and states between them, where they can be computed.

    `scene` is the mechanism of a solution that has none. Steps and orders of the rows are left out.
    """
    found = sol if rows is None else only(sol, rows)
    if not is_continuous(sol):
        return found
    try:
        return _filled(sol, scene, only(found, slice(None)))
    except PinconsistError as error:
        log.warning("%s: rows are joined by straight lines, as states between them are missing: %s", sol.scene, error)
        return found


def only(sol, rows):
    """A solution with some of its rows."""
    columns = {name: getattr(sol, name)[rows] for name in ("t", "q", "v", "lam")}
    return replace(sol, **columns, h=np.zeros(0), order=np.zeros(0, int), _run=sol._run or sol)


def _filled(sol, scene, found):
    free = ROWS - len(found.t)
    if free > 0:
        even = np.linspace(found.t[0], found.t[-1], free + 2)[1:-1]
        found = _with(sol, scene, found, np.setdiff1d(even, found.t))
    for _ in range(ROUNDS if free > 0 else 0):
        middles = _middles(found)[: 2 * ROWS - len(found.t)]
        if not len(middles):
            break
        found = _with(sol, scene, found, middles)
    return found


def _with(sol, scene, found, times):
    """A solution with the states at further times, other than those of its rows."""
    sign = 1.0 if sol.t[-1] >= sol.t[0] else -1.0
    more = sol.at(sign * np.sort(sign * times), scene)
    order = np.argsort(sign * np.concatenate((found.t, more.t)), kind="stable")
    columns = {name: np.concatenate((getattr(found, name), getattr(more, name))) for name in ("t", "q", "v", "lam")}
    return replace(found, **{name: column[order] for name, column in columns.items()})


def _middles(found):
    """Times next to values that are far from the line through their neighbours, the farthest first."""
    at, values = np.abs(found.t - found.t[0]), np.hstack((found.lam, found.v))
    before, here, after = at[:-2], at[1:-1], at[2:]
    inner = np.flatnonzero((here > before) & (after > here))
    share = ((here - before)[inner] / (after - before)[inner])[:, None]
    lines = values[inner] + share * (values[inner + 2] - values[inner])
    far = (np.abs(values[inner + 1] - lines) / np.maximum(np.ptp(values, axis=0), 1e-300)).max(axis=1, initial=0.0)
    chosen = inner[far > FAR_FROM_LINE][np.argsort(-far[far > FAR_FROM_LINE], kind="stable")]
    t = found.t
    both = np.column_stack(((t[chosen] + t[chosen + 1]) / 2, (t[chosen + 1] + t[chosen + 2]) / 2)).ravel()
    return both[np.sort(np.unique(both, return_index=True)[1])]
