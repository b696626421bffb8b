"""Run time against error of the package's methods and of the peers, on the same problems, in one process."""

from __future__ import annotations

import signal
import time
import warnings
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from pinconsist import InputError, PinconsistError

from .dense_reference import DenseReference
from .peers import OWN, peers
from .peers.problem import Problem, SolverFailed

TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10)
TARGETS = (1e-3, 1e-4, 1e-6, 1e-8)
"""Errors in q and λ at which run times are compared."""
FINEST = 1e-6
"""Error in q to which methods of fixed step are run."""
FEWEST, MOST = 125, 1_000_000
"""Steps of a method of fixed step: it takes up to four times as many from run to run, until they reach FINEST."""
LEAST = 0.05
"""s that a timed run takes, by repetition."""
LOOKED_AT = 400
"""Steps of a run at which its error is measured, besides the first and the last."""


@dataclass(frozen=True)
class Point:
    """One method at one tolerance; errors are the largest over the run, against the reference."""

    method: str
    tol: float  # rtol = atol; not a number for methods of fixed step
    status: str  # "done", or why there is nothing else
    steps: int = 0
    times: tuple[float, ...] = ()  # CPU times of the repeats, s: what else runs on the machine does not count
    q: float = np.nan  # rad, m
    v: float = np.nan  # in parts of the largest velocity of the run
    lam: float = np.nan  # in parts of the largest multiplier of the run
    q_end: float = np.nan
    lam_row: float = np.nan  # in the first row after the initial values
    lam_first: float = np.nan  # at the first step by the method itself; the package's one-step start is before it

    @property
    def time(self) -> float:
        """Median CPU time, s."""
        return float(np.median(self.times)) if self.times else np.nan


class Equal(NamedTuple):
    """One method where its largest error is the target: medians over the repeats, errors of the first multipliers."""

    time: float  # CPU time, s
    ratio: float  # to that of the package
    lam_row: float
    lam_first: float


@dataclass(frozen=True)
class Diagram:
    """All methods on one problem."""

    scene: str
    description: str
    until: float  # s of the scene
    budget: float  # s of CPU time that one run may take
    versions: dict  # of the packages whose methods ran
    reference: float  # how far two references differ in q
    points: tuple[Point, ...]
    equal_error: tuple  # in q: (target, method → Equal, or None where no run reached it)
    equal_lam: tuple  # in λ

    def series(self) -> dict:
        """Method → (median times, errors in q), as a figure needs them."""
        found = {}
        for point in self.points:
            if point.times:
                found.setdefault(point.method, []).append((point.time, point.q))
        return {method: tuple(map(np.array, zip(*rows, strict=True))) for method, rows in found.items()}


def work_precision(
    problem: Problem, tolerances=TOLERANCES, *, repeats=3, budget=10.0, methods=None, report=lambda name: None
) -> Diagram:
    """Measure a problem with every method that is installed and can do it.

    Every method runs once to warm up, which gives its errors; then all run in turn, `repeats` times. Building models
    and finding multipliers that a method does not give itself is not timed. Methods of fixed step take more and more
    steps in place of `tolerances`. A run that takes longer than `budget` s of CPU time, or as much again for what is
    built before it, is cut, and the finer runs of its method are left out. With `methods` only those whose name
    contains one of these words run ("peers": all of other packages), and the package's BDF; by default the peers, and
    the package's BDF of each order. ``report(name)`` is called before the first run of a method. Raises InputError for
    impossible numbers, or a word that no name contains.
    """
    if repeats < 1 or not budget > 0 or not all(0 < tol < 1 for tol in tolerances) or not len(tolerances):
        raise InputError("a measurement needs repeats ≥ 1, a budget > 0 s, and tolerances between 0 and 1")
    reference = DenseReference(problem)
    runs, points, versions = [], {}, {}
    for peer in _chosen(methods):
        report(peer.name)
        if reason := peer.missing() or peer.can(problem):
            points[peer.name, 0] = Point(peer.name, np.nan, reason)
            continue
        versions[peer.package] = peer.version()
        series = _fixed_steps if peer.fixed_step else _tolerances
        for k, (solve, point) in enumerate(series(problem, peer, tolerances, reference, budget)):
            points[peer.name, k] = point
            if solve is not None:
                runs.append(((peer.name, k), solve))
    for _ in range(repeats):
        for key, solve in runs:
            points[key] = replace(points[key], times=(*points[key].times, _timed(solve)))
    ordered = tuple(points.values())
    return Diagram(
        problem.name, problem.description, problem.span[1], budget, versions, reference.uncertainty, ordered,
        *(tuple((target, at_equal_error(ordered, target, OWN, of)) for target in TARGETS) for of in ("q", "lam")),
    )  # fmt: skip


def at_equal_error(points, target, own, of="q") -> dict:
    """Method → :class:`Equal` or None at one error of q (or "lam"), by straight lines in log-log diagrams.

    Where the coarsest run is already better it stands as it is. `own` is the method whose time is 1.
    """
    runs = {}
    for point in points:
        if point.times and np.isfinite(getattr(point, of)):
            runs.setdefault(point.method, []).append(point)
    reached = {method: _at(rows, target, of) for method, rows in runs.items()}
    reference = reached.get(own) or (np.nan,)
    return {
        method: found and Equal(float(np.median(found[0])), float(np.median(found[0] / reference[0])), *found[1])
        for method, found in reached.items()
    }


def _at(rows, target, of):
    """(times of the repeats, first multipliers' errors) where the error of q or λ reaches `target`, or None."""

    def error(point):
        return getattr(point, of)

    def values(point):
        return np.array(point.times), np.array((point.lam_row, point.lam_first))

    for before, after in pairwise(rows):
        if error(after) <= target <= error(before):
            part = np.log(error(before) / target) / np.log(error(before) / error(after))
            return tuple(a ** (1.0 - part) * b**part for a, b in zip(values(before), values(after), strict=True))
    return values(rows[0]) if rows and error(rows[0]) <= target else None


def _timed(solve) -> float:
    """CPU time of one run, s; fast ones are repeated, since the clock may tick slowly."""
    start, count, elapsed = time.process_time(), 0, 0.0
    while elapsed < LEAST:
        solve()
        count, elapsed = count + 1, time.process_time() - start
    return elapsed / count


def _chosen(methods):
    known = peers()
    if methods is None:
        return [peer for peer in known if not peer.detail]

    def named(peer, word):
        return peer.package != "pinconsist" if word == "peers" else word.lower() in peer.name.lower()

    for word in methods:
        if not any(named(peer, word) for peer in known):
            raise InputError(f"no method {word!r}; there are {', '.join(peer.name for peer in known)}")
    return [peer for peer in known if peer.name == OWN or any(named(peer, word) for word in methods)]


def _tolerances(problem, peer, tolerances, reference, budget):
    """(solve or None, Point) of each tolerance, from coarse to fine, until a run is cut."""
    for tol in sorted(set(tolerances), reverse=True):
        solve, point, spent = _first_run(problem, peer, tol, reference, budget)
        yield solve, replace(point, tol=tol)
        if solve is None and spent >= budget:
            return


def _fixed_steps(problem, peer, tolerances, reference, budget):
    """(solve or None, Point) of more and more steps, until FINEST is met or a run would be cut."""
    steps, before = FEWEST, None
    while steps <= MOST:
        solve, point, spent = _first_run(problem, peer, steps, reference, budget)
        yield solve, replace(point, steps=steps)
        if spent >= budget or point.q <= FINEST:
            return
        more = 4 * steps
        if before is not None and point.q < before[1] / 2:  # or what FINEST needs by the order seen
            order = np.log(before[1] / point.q) / np.log(steps / before[0])
            more = min(more, int(1.2 * steps * (point.q / FINEST) ** (1 / order)) + 1)
        if spent * more / steps > budget:
            yield None, Point(peer.name, np.nan, f"more steps ({more}) would take longer than {budget:g} s", more)
            return
        before, steps = (steps, point.q), more


def _first_run(problem, peer, setting, reference, budget):
    """(solve, Point, seconds spent) of a run that is not timed; `solve` is None where it failed or was cut."""
    building, running = _Limit(budget), _Limit(budget)
    start, steps = time.process_time(), []

    def thin(count, first=1):
        steps.append(count - 1)
        return np.unique(np.concatenate(([0, 1, first], np.linspace(0, count - 1, LOOKED_AT).astype(int))))

    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            with building:
                solve, read = peer.prepare(problem, setting)
            start = time.process_time()
            with running:
                result = solve()
            spent = time.process_time() - start
            errors = reference.errors(read(result, thin))
        return solve, Point(peer.name, np.nan, "done", steps[0], (), *errors), spent
    except (_OutOfTime, SolverFailed, PinconsistError, ValueError, RuntimeError, ArithmeticError, SystemError) as error:
        spent = time.process_time() - start
        if running.reached:  # some solvers report the interruption in their own words
            status, spent = f"cut after {budget:g} s", budget
        elif building.reached:
            status, spent = f"the building of its model was cut after {budget:g} s", budget
        else:
            status = f"failed: {str(error).splitlines()[0].split('. ')[0] if str(error) else repr(error)}"
        return None, Point(peer.name, np.nan, status), spent


class _OutOfTime(Exception):
    """The budget of a run is spent."""


class _Limit:
    """Raise _OutOfTime in what runs inside, after some seconds of CPU time; then `reached` is true."""

    def __init__(self, seconds):
        self.seconds, self.reached = seconds, False

    def __enter__(self):
        def stop(number, frame):
            self.reached = True
            raise _OutOfTime

        self.before = signal.signal(signal.SIGPROF, stop)
        signal.setitimer(signal.ITIMER_PROF, self.seconds, 0.5)  # again, where a callback's exception was swallowed

    def __exit__(self, *error):
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, self.before)
