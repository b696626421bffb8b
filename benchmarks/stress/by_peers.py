"""The cases of the suite tried by the peers: the same mechanisms, starts, tolerances, figures and criteria.

The package assembles every start, and judges every solution by the same residuals. A peer may refuse a case in any
words, or by an exception from below; and where a criterion is tighter than the tolerance lets errors grow (loops that
are closed to rounding), it need only meet that. Cases about steps of a given size, about starts off the loops or
about events are the package's own.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterable, Iterator

import numpy as np

from pinconsist import InputError, Solution, assemble
from pinconsist.run import simulation
from pinconsist.run.simulation import system_of

from ..child import DIED, Child
from ..peers import peers
from ..peers.problem import Peer, Problem
from .case import FAILED, Case, Outcome, declined, measured
from .scales import GROWTH

OWN = "pinconsist"
CANNOT, CUT = "cannot", "cut"
STEPS = 10_000
"""Of a method of fixed step."""
LOOKED_AT = 2000
"""Rows that are judged."""
LIMIT = 5.0
"""s for each case and method."""
SUBJECTS = ("scales", "singular", "forces", "tolerances")


class Cannot(Exception):
    """A case is not for this method, or its interface cannot say it."""


class ByPeer:
    """What `simulate` and `integrate` are to a case, by a peer."""

    def __init__(self, peer: Peer):
        self.peer, self.tolerance = peer, 0.0

    def allowed(self, figure):
        """The figure, its criterion no tighter than errors at the tolerance of the runs so far may be."""
        return figure._replace(criterion=max(figure.criterion, GROWTH * self.tolerance))

    def simulate(self, mech, t_span, q0=None, v0=None, *, rtol=1e-6, t_eval=None, **options) -> Solution:
        """The solution of the assembled problem; of a peer, whose rtol is its atol, too, and that counts no steps."""
        closed = assemble(mech, q0, v0, t=t_span[0])
        return self._run(mech, t_span, closed.q, closed.v, rtol, t_eval, options)

    def integrate(self, system, t_span, p0, v0, *, rtol=1e-6, **options) -> Solution:
        """The same from a start as it stands."""
        return self._run(system, t_span, p0, v0, rtol, None, options)

    def _run(self, mech, t_span, q0, v0, rtol, t_eval, options):
        if foreign := options.keys() - {"atol", "max_steps"}:
            raise Cannot(f"{', '.join(sorted(foreign))}: not with this method")
        problem = Problem(mech.name, "", mech, t_span, q0, v0)
        if reason := self.peer.missing() or self.peer.can(problem):
            raise Cannot(reason)
        self.tolerance = max(self.tolerance, rtol)
        solve, read = self.peer.prepare(problem, STEPS if self.peer.fixed_step else rtol)

        def thin(count, first=1):
            looked_at = 2 if t_eval is not None else LOOKED_AT
            return np.unique(np.linspace(0, count - 1, looked_at).astype(int))

        rows, system = read(solve(), thin), system_of(mech, t_span[0], q0, v0)
        return Solution(
            t=rows.t, q=rows.q, v=rows.v, lam=rows.lam, h=np.diff(rows.t), order=np.ones(len(rows.t) - 1, int),
            success=True, status=0, message="", nsteps=len(rows.t) - 1, nfev=0, njev=0, nlu=0, rejected={},
            method={"forces": len(mech.forces)}, scene=mech.name, system=system,
        )  # fmt: skip


def sample(cases: Iterable[Case], each: int) -> list[Case]:
    """So many cases of each family, evenly spread over it."""
    if each < 1:
        raise InputError(f"a sample needs at least one case of each family, got {each}")
    families = {}
    for case in cases:
        families.setdefault(case.family, []).append(case)
    chosen = [np.unique(np.linspace(0, len(family) - 1, each).astype(int)) for family in families.values()]
    return [family[i] for family, places in zip(families.values(), chosen, strict=True) for i in places]


def methods() -> dict[str, Peer | None]:
    """Name → peer; the package itself, by its default method, first."""
    return {OWN: None} | {peer.name: peer for peer in peers() if peer.package != "pinconsist"}


def missing() -> list[str]:
    """Why methods are not there, a sentence for each package."""
    return list(dict.fromkeys(filter(None, (peer.missing() for peer in methods().values() if peer))))


def judged(case: Case, peer: Peer | None) -> tuple:
    """(outcome, reason, measure, figure, criterion); the words may be those of any exception."""
    if peer is not None and peer.fixed_step and case.family == "tolerance":
        return CANNOT, "it has no error control"
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            by = ByPeer(peer) if peer else None
            figures = [by.allowed(figure) for figure in case.check(by)] if by else case.check(simulation)
    except Cannot as error:
        return CANNOT, str(error)
    except Exception as error:
        return declined(case, f"{type(error).__name__}: {error}")
    return measured(case, figures)


def outcomes(cases: list[Case], *, limit: float = LIMIT) -> Iterator[tuple[str, Outcome]]:
    """(method, Outcome) of every case by every method, each in a child process that is ended after `limit` s."""
    if not limit > 0:
        raise InputError(f"a case needs a limit of some seconds, got {limit:g}")
    known = methods()
    child = Child(lambda question: judged(cases[question[0]], known[question[1]]))
    try:
        for i, case in enumerate(cases):
            for name in known:
                start = time.perf_counter()
                found, why = child.ask((i, name), limit)
                found = found or (FAILED if DIED in why else CUT, why)
                yield name, Outcome(case.family, case.varied, *found, seconds=time.perf_counter() - start)
    finally:
        child.end()
