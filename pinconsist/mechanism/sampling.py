"""Where a function of time changes its character, found by sampling it before a run: pulses, jumps and bends.

Step control sees what a function does at the times at which it is evaluated. After a rest, or a slow motion, steps may
be longer than a pulse. Fourth differences of the samples show where the function leaves what it did before, however
slowly it begins: they vanish for cubic polynomials, are small for slow functions, and do not grow within a fast
oscillation, a periodic function or noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

EPS = float(np.finfo(float).eps)
FEWEST_SAMPLES = 1999  # of a span; a prime, as the next one, so that they do not meet the zeros of a fast oscillation
MOST_SAMPLES = 9973
SAMPLE_SPACING = 0.9727e-3  # s, between samples, where their number allows it; no part of usual periods
COARSER = 4  # ratio of the distances of samples at which differences are taken
COARSEST = 30  # samples of a span, at least
GROWTH = 30.0  # of the fourth difference, relative to those of a window before it, that starts a pulse
SAMPLE_WINDOW = 5  # samples
SLOW_START_GROWTH = 1e3  # growth of the fourth difference within a slow start after which steps end again
SAMPLE_NOISE = 64.0 * EPS  # fourth difference of rounded samples, relative to their size
NEGLIGIBLE = 1e-9  # fourth differences, relative to the largest, that count as zero
PARTS = 12  # subintervals of an interval that is sampled again; the four of a fourth difference are the next interval
CLASSIFIED = 3  # how often, before the order is judged
MOST_CALLS = 10_000  # for exact times; later ones are known to a sample
SMOOTH = 3  # order of what is neither a jump nor a bend
SAMPLES_BESIDE = 2  # samples near a change that may belong to the other side
PEAK = 1e-6  # deviation from a straight line, relative to the size, in which there is no peak


@dataclass(frozen=True)
class Change:
    """A time at which a function changes its character.

    `order` is that of the derivative that jumps, 0 for a jump of the function itself, 1 for a bend, 2 for a jump of its
    acceleration; or 3, if a smooth pulse begins, peaks or ends.
    """

    time: float
    order: int = SMOOTH


def changes(function, t0: float, t1: float, n: int) -> list[Change]:
    """The changes of a function of time between t0 and t1 (or back), sampled n + 1 times; it returns an array.

    It is never called outside; where it fails, it is sampled only up to there.
    """
    watched = _Watched(function)
    times = np.linspace(t0, t1, n + 1)
    values = watched.values(times)
    if len(values) < PARTS:
        return []
    sizes = np.abs(values).max(axis=0)
    varying = np.ptp(values, axis=0) > SAMPLE_NOISE * sizes
    if not varying.any():
        return []
    watched.use(varying, sizes[varying])
    return _Search(watched, times, values[:, varying] / sizes[varying]).found()


def samples_of(length: float) -> int:
    """The number of samples of a span of this length, s."""
    return int(min(max(FEWEST_SAMPLES, length / SAMPLE_SPACING), MOST_SAMPLES))


def continues(function, t: float, step: float) -> bool:
    """Whether a function goes on beyond `t`, an end of a run, as it does before; `step` points outwards.

    Otherwise difference quotients may not use what is beyond.
    """
    values = _Watched(function).values(t + step * np.arange(-PARTS, PARTS // 3))
    if len(values) < PARTS + PARTS // 3:
        return False
    fourth, size = _fourth(values), np.abs(values).max(initial=0.0)
    return bool(fourth.max() <= GROWTH * max(fourth[: PARTS - 4].max(), SAMPLE_NOISE * size))


class _Watched:
    """A function with the components that vary, relative to their sizes."""

    def __init__(self, function):
        self._function, self._columns, self._sizes, self.calls = function, slice(None), 1.0, 0

    def use(self, columns, sizes) -> None:
        self._columns, self._sizes, self.calls = columns, sizes, 0

    def values(self, times) -> np.ndarray:
        """The values at times, (n, ·); only the first ones if it fails, or is not finite."""
        found = []
        for t in times.tolist():
            try:
                found.append(self._function(t))
            except (Exception, SystemExit):  # a run may end before; if not, it reports the error
                break
        self.calls += len(times)
        if not found:
            return np.zeros((0, 1))
        values = np.array(found, float).reshape(len(found), -1)[:, self._columns] / self._sizes
        wrong = np.flatnonzero(~np.isfinite(values).all(axis=1))
        return values[: wrong[0]] if wrong.size else values


def _fourth(values) -> np.ndarray:
    """The largest fourth difference of each five values."""
    return np.abs(np.diff(values, 4, axis=0)).max(axis=1, initial=0.0)


class _Search:
    """The search in samples of a function, relative to their sizes."""

    def __init__(self, function, times, values):
        self._function, self._times, self._values = function, times[: len(values)], values
        self._found: dict[int, Change] = {}  # sample → change near it

    def found(self) -> list[Change]:
        """All changes, in the order of the times."""
        apart = 1
        while len(self._times) > COARSEST * apart:
            self._look(apart)
            apart *= COARSER
        self._peaks()
        return [self._found[i] for i in sorted(self._found)]

    def _look(self, apart) -> None:
        """Add what differences of samples so far apart show, and those of closer ones do not."""
        fourth = _fourth(self._values[::apart])
        activity = np.maximum(fourth, max(SAMPLE_NOISE, NEGLIGIBLE * fourth.max(initial=0.0)))
        begins = {i + 3: i + 3 for i in _growing(activity)}  # interval → the sample outside of the pulse
        ends = {len(activity) - 1 - i: len(activity) - i for i in _growing(activity[::-1])}
        known = np.array(sorted(self._found), float)
        for i, outside in sorted((begins | ends).items()):
            if not (np.abs(known - (i + 0.5) * apart) <= SAMPLE_WINDOW * apart).any():
                place = outside * apart
                self._found[place] = self._exactly(i, place) if apart == 1 else Change(float(self._times[place]))

    def _peaks(self) -> None:
        """Add the peaks between changes, and the ends of the span: a step between these would see nothing else."""
        if not self._found:
            return
        last = len(self._times) - 1
        for i, j in pairwise([0, *sorted(self._found), last]):
            inside = self._values[i + SAMPLES_BESIDE : j + 1 - SAMPLES_BESIDE]
            if len(inside) < SAMPLE_WINDOW:
                continue
            part = np.linspace(0.0, 1.0, len(inside))[:, None]
            off = np.abs(inside - (1.0 - part) * inside[0] - part * inside[-1]).max(axis=1)
            if off.max() > PEAK:
                at = i + SAMPLES_BESIDE + int(np.argmax(off))
                self._found[at] = Change(float(self._times[at]))

    def _exactly(self, i, outside) -> Change:
        """The change in the interval after sample i; if it is smooth, at the sample that is `outside` of the pulse."""
        low, high = self._times[max(i - 1, 0)], self._times[min(i + 2, len(self._times) - 1)]
        largest, order = [], SMOOTH
        while self._function.calls < MOST_CALLS:
            times = np.linspace(low, high, PARTS + 1)
            values = self._function.values(times)
            if len(values) <= PARTS:
                break
            fourth = _fourth(values)
            largest.append(fourth.max())
            if len(largest) == CLASSIFIED + 1:
                fall = np.log(largest[0] / max(largest[-1], SAMPLE_NOISE)) / np.log(PARTS / 4.0)
                order = round(float(fall) / CLASSIFIED)
                if not 0 <= order < SMOOTH:  # below, it is noise
                    order = SMOOTH
                    break
            at = int(np.argmax(fourth))
            if largest[-1] < SAMPLE_NOISE or abs(high - low) < PARTS * np.spacing(abs(low) + abs(high)):
                break
            low, high = times[at], times[at + 4]
        if order == SMOOTH:
            return Change(float(self._times[outside]))
        return Change(float(0.5 * (low + high)), order)


def _growing(activity) -> list[int]:
    """The indices at which activity has grown by GROWTH after a window of rest, and by SLOW_START_GROWTH after that."""
    grows = _quiet(activity, 1) | _quiet(activity, SAMPLE_WINDOW)
    found: list[int] = []
    for i in np.flatnonzero(grows).tolist():
        goes_on = found and grows[found[-1] : i].all()
        if not goes_on or activity[i] > SLOW_START_GROWTH * activity[found[-1]]:
            found.append(i)
    return found


def _quiet(activity, lag):
    """Whether activity is more than GROWTH times what it was in a window so many samples before, or at the start."""
    if len(activity) <= lag:
        return np.zeros(len(activity), bool)
    padded = np.concatenate((np.zeros(SAMPLE_WINDOW - 1), activity[:-lag]))
    before = np.lib.stride_tricks.sliding_window_view(padded, SAMPLE_WINDOW).max(axis=1)
    return np.concatenate((np.zeros(lag, bool), activity[lag:] > GROWTH * before))
