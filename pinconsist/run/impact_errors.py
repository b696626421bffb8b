"""The impacts of a run, compared one by one with those of a finer run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..engine.norms import EPS, largest
from ..mechanism.contacts import contact_units
from ..mechanism.reactions import listed
from .accuracy import AMPLIFIED, OFF, figure

WINDOW = 200  # impacts of a contact that are paired at once: the work grows with its square
RESTING = 1e-9  # of the fastest approach of a contact: slower, it takes part in the impacts of others
SLOW = 10.0  # tolerances of the velocities: slower impacts may be missing, as where a bouncing body comes to rest
FLAT = 1e5  # roundings of the positions: impacts after lower flights may be missing


class MissingImpact(NamedTuple):
    """An impact that only one of two runs has: contact, time, s, speed of approach and its unit."""

    contact: str
    t: float
    speed: float
    unit: str

    def __str__(self):
        return f"{self.contact!r} at t = {self.t:.6g} s ({self.speed:.2g} {self.unit})"


@dataclass(frozen=True)
class ImpactErrors:
    """The differences between the impacts of a run and those of a finer one.

    The impacts of each contact are paired in their order so that the differences of times are small and what is left
    over is slow.

    Attributes
    ----------
    compared : int
        Number of pairs.
    time : float
        The largest difference of their times, s.
    impulse : float
        The largest difference of their impulses, relative to the largest impulse of the contact.
    time_at, impulse_at : str
        Where each of them is largest: contact and time.
    tolerances : float or None
        The largest difference of times multiplied by the speed of approach, in tolerances of the positions; None for
        fixed steps.
    missed, extra : tuple of MissingImpact
        Impacts that only the finer run has, and those that only the run has, in order of time. Not listed are those
        that are slower than the tolerance of the velocities allows.
    """

    compared: int
    time: float = 0.0
    impulse: float = 0.0
    time_at: str = ""
    impulse_at: str = ""
    tolerances: float | None = None
    missed: tuple[MissingImpact, ...] = ()
    extra: tuple[MissingImpact, ...] = ()

    @property
    def late(self) -> bool:
        """Whether the times differ by so many tolerances that the motion must amplify disturbances."""
        return not (self.tolerances or 0.0) <= AMPLIFIED

    @property
    def figures(self) -> list[str]:
        """Its lines in a certificate."""
        about = f"compared one by one; {len(self.missed)} missed, {len(self.extra)} extra"
        of_largest = self.impulse_at and f"of the largest, {self.impulse_at}"
        return [
            figure("impacts", self.compared, "", bool(self.missed or self.extra), about, "d"),
            figure("error of their times", self.time, "s", self.late, self.time_at),
            figure("error of impulses", self.impulse, "", not self.impulse <= OFF, of_largest),
        ]

    @property
    def concerns(self) -> dict[str, str]:
        """The short form of each concern, with its sentence."""
        found, parts = {}, []
        if self.missed:
            parts.append(f"the run misses impacts of a finer run: {listed(list(map(str, self.missed)))}")
        if self.extra:
            parts.append(f"a finer run does not have the impacts {listed(list(map(str, self.extra)))}")
        if parts:
            found["impacts"] = f"{'; '.join(parts)}. From there on the motion is another one: tighten the tolerance"
        if self.late:
            found["times of impacts"] = (
                f"the times of impacts differ from those of a finer run by up to {self.time:.2g} s, {self.time_at}: "
                "tighten the tolerance, or trust only the beginning of the run"
            )
        if not self.impulse <= OFF:
            found["impulses"] = (
                f"impulses differ from those of a finer run by more than 1 % of the largest, first {self.impulse_at}"
            )
        return found


class _Hit(NamedTuple):
    """A contact's part in an impact in which its gap closes; a jam is as fast as the fastest."""

    t: float
    speed: float
    impulse: np.ndarray


def impact_errors_of(data) -> ImpactErrors | None:
    """The comparison of plain data."""
    if data is None:
        return None
    lists = {name: tuple(MissingImpact(*each) for each in data[name]) for name in ("missed", "extra")}
    return ImpactErrors(**data | lists)


def impact_errors(solution, finer) -> tuple[ImpactErrors | None, np.ndarray]:
    """The comparison, and a mask of the rows of `finer` that lie between an impact of one run and that of the other.

    The comparison is None if neither run has impacts.
    """
    mechanism, times = finer.system.mechanism, solution.t[finer.rows]
    runs = [_hits(contacts, times[0], times[-1]) for contacts in (solution.contacts, finer.contacts)]
    apart, found, middle = np.zeros(len(times), bool), _Found(solution, finer), 0.5 * (times[0] + times[-1])
    for name in dict.fromkeys((*runs[0], *runs[1])):
        ours, theirs = (run.get(name, []) for run in runs)
        pairs = paired(ours, theirs, times[-1] - times[0])
        strongest = max(np.linalg.norm(each.impulse) for each in (*ours, *theirs))
        for i, j in pairs:
            found.compare(name, ours[i], theirs[j], strongest)
            low, high = sorted((ours[i].t, theirs[j].t))
            apart |= (times >= low) & (times <= high)
        unit = f"{contact_units(mechanism, name)[0]}/s"
        for hits, side, of in ((ours, 0, found.extra), (theirs, 1, found.missed)):
            for i in sorted(set(range(len(hits))) - {pair[side] for pair in pairs}):
                if found.beyond(hits[i]):
                    apart |= (times >= hits[i].t) if hits[i].t > middle else (times <= hits[i].t)
                elif found.matters(hits, i):
                    of.append(MissingImpact(name, *hits[i][:2], unit))
    struck = solution.contacts.impacts or finer.contacts.impacts
    return found.errors() if struck else None, apart


def _hits(contacts, start, end) -> dict[str, list[_Hit]]:
    """The hits of each contact after the start, in order of time."""
    found: dict[str, list[_Hit]] = {}
    for impact in contacts.impacts:
        for name, impulse in impact.impulses.items() if start < impact.t <= end else ():
            speed = np.inf if impact.jam else impact.speeds[name]
            found.setdefault(name, []).append(_Hit(impact.t, speed, np.atleast_1d(impulse)))
    for name, hits in found.items():
        fastest = max((each.speed for each in hits if each.speed < np.inf), default=0.0) or 1.0
        hits = [each._replace(speed=min(each.speed, fastest)) for each in hits]
        found[name] = [each for each in hits if each.speed > RESTING * fastest]
    return {name: hits for name, hits in found.items() if hits}


def paired(ours, theirs, span) -> list[tuple[int, int]]:
    """Pairs of indices of two sequences of hits, in order.

    Their cost is least: the difference of times for each pair, and for what is left over the part of the span that its
    speed is of the sum of speeds. So equal impacts are left over rather than displaced by more than two intervals.
    """
    times, speeds = (
        [np.array([getattr(each, name) for each in hits]) for hits in (ours, theirs)] for name in ("t", "speed")
    )
    costs = [span * each / max(*map(np.sum, speeds)) for each in speeds]
    pairs, firsts = [], (0, 0)
    while firsts[0] < len(ours) and firsts[1] < len(theirs):
        parts = [slice(first, first + WINDOW) for first in firsts]
        found = _aligned(*(of[k][part] for of in (times, costs) for k, part in enumerate(parts)))
        ends = all(part.stop >= len(hits) for part, hits in zip(parts, (ours, theirs), strict=True))
        found = found if ends else found[: 3 * len(found) // 4 + 1]  # the end depends on what follows
        if not found:
            break
        pairs += [(firsts[0] + i, firsts[1] + j) for i, j in found]
        firsts = pairs[-1][0] + 1, pairs[-1][1] + 1
    return pairs


def _aligned(ours, theirs, cost_ours, cost_theirs) -> list[tuple[int, int]]:
    """The pairs of least cost, of two sequences of times and the costs of leaving each of them out."""
    n, m = len(ours), len(theirs)
    left_out = np.concatenate(([0.0], np.cumsum(cost_theirs)))
    best, source, together = left_out, np.empty((n, m + 1), int), np.empty((n, m + 1), bool)
    for i in range(n):
        pair = np.append(np.inf, best[:-1] + np.abs(theirs - ours[i]))
        alone = best + cost_ours[i]
        together[i] = pair <= alone
        own = np.minimum(pair, alone) - left_out
        least = np.minimum.accumulate(own)
        source[i] = np.maximum.accumulate(np.where(own <= least, np.arange(m + 1), 0))
        best = least + left_out
    pairs, j = [], m
    for i in reversed(range(n)):
        j = source[i, j]
        if together[i, j]:
            j -= 1
            pairs.append((i, int(j)))
    return pairs[::-1]


class _Found:
    """What the comparison of two runs has found so far."""

    def __init__(self, solution, finer):
        about = solution.method
        size = max(largest(finer.system.position_scale(q)) for q in solution.q)
        fastest, self._end = largest(solution.v), solution.t[-1]
        self._start = solution.t[finer.rows[0]]
        self._fixed = about["step"] is not None
        if self._fixed:
            self._allowed, self._slow = OFF * size / AMPLIFIED, OFF * fastest
        else:
            (rtol_q, rtol_v), (atol_q, atol_v) = ([largest(part) for part in about[key]] for key in ("rtol", "atol"))
            self._allowed, self._slow = rtol_q * size + atol_q, SLOW * (rtol_v * fastest + atol_v)
        self._flat = FLAT * EPS * (1.0 + size)
        self._compared, self._late = 0, 0.0
        self._time, self._impulse = (0.0, ""), (0.0, "")
        self.missed: list[MissingImpact] = []
        self.extra: list[MissingImpact] = []

    def compare(self, name, ours, theirs, strongest):
        """Add a pair."""
        at, late = f"{name} at t = {ours.t:.6g} s", abs(ours.t - theirs.t)
        self._compared += 1
        self._late = max(self._late, late * max(ours.speed, theirs.speed))
        self._time = max(self._time, (late, at), key=_first)
        impulse = float(np.linalg.norm(ours.impulse - theirs.impulse) / strongest)
        self._impulse = max(self._impulse, (impulse, at), key=_first)

    def matters(self, hits, i) -> bool:
        """Whether a hit that only one run has is fast, after a flight that is resolved."""
        speed, flight = hits[i].speed, hits[i].t - (hits[i - 1].t if i else self._start)
        return speed > self._slow and 0.25 * speed * flight > self._flat

    def beyond(self, hit) -> bool:
        """Whether a hit that only one run has may be that of the other run before its start or after its end."""
        return min(self._end - hit.t, hit.t - self._start) * hit.speed <= AMPLIFIED * self._allowed

    def errors(self) -> ImpactErrors:
        tolerances = None if self._fixed else float(self._late / self._allowed)
        missed, extra = (tuple(sorted(part, key=lambda each: each.t)) for part in (self.missed, self.extra))
        (time, time_at), (impulse, impulse_at) = self._time, self._impulse
        return ImpactErrors(self._compared, time, impulse, time_at, impulse_at, tolerances, missed, extra)


def _first(pair):
    return pair[0]
