"""Run time against error of the package's methods and of the peers, on the same problems, in one process."""

from __future__ import annotations

import logging
import signal
import time
import warnings
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from pinconsist import InputError, PinconsistError

from .dense_reference import DenseReference
from .equal_error import COMPARED, TARGETS, at_equal_error, median
from .peers import OWN, peers
from .peers.problem import Problem, SolverFailed

TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10)
FINEST = 1e-6
"""Error in q to which methods of fixed step are run."""
FEWEST_STEPS, MOST_STEPS = 125, 1_000_000
"""Steps of a method of fixed step: it takes up to four times as many from run to run, until they reach FINEST."""
LEAST = 0.05
"""s that a timed run takes, by repetition."""
SHORT = 1e-9
"""Part of the span after which a run has done everything but its steps (of which it makes one; BDF its start, six)."""
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
    setups: tuple[float, ...] = ()  # those of runs over SHORT, which are part of them; none for methods of fixed step
    q: float = np.nan  # rad, m
    v: float = np.nan  # in parts of the largest velocity of the run
    lam: float = np.nan  # in parts of the largest multiplier of the run
    q_end: float = np.nan
    lam_row: float = np.nan  # in the first row after the initial values
    lam_first: float = np.nan  # at the first step by the method itself; the package's one-step start is before it
    force: float = np.nan  # Jᵀλ, in parts of its largest: where rows are nearly redundant, λ itself means nothing

    @property
    def time(self) -> float:
        """Median CPU time, s."""
        return median(self.times)

    @property
    def setup(self) -> float:
        """Median CPU time of what a run does besides its steps, s."""
        return median(self.setups)

    @property
    def cores(self) -> tuple[float, ...]:
        """The times of the repeats without their set-ups."""
        return tuple(time - setup for time, setup in zip(self.times, self.setups, strict=bool(self.setups)))


@dataclass(frozen=True)
class Diagram:
    """All methods on one problem."""

    scene: str
    description: str
    until: float  # s of the scene
    budget: float  # s of CPU time that one run may take
    versions: dict  # of the packages whose methods ran
    over: str  # the method that the others are measured against
    reference: float  # how far two references differ in q
    points: tuple[Point, ...]
    equal_error: dict  # what the error is of → ((target, method → Equal, or None where no run reached it), …)

    def series(self) -> dict:
        """Method → (median times, errors in q), as a figure needs them."""
        found = {}
        for point in self.points:
            if point.times:
                found.setdefault(point.method, []).append((point.time, point.q))
        return {method: tuple(map(np.array, zip(*rows, strict=True))) for method, rows in found.items()}


def work_precision(
    problem: Problem, tolerances=TOLERANCES, *, repeats=3, budget=10.0, methods=None, over=OWN, report=lambda name: None
) -> Diagram:
    """Measure a problem with every method that is installed and can do it.

    Every method runs once to warm up, which gives its errors; then all run in turn, `repeats` times: at each tolerance
    one method after the other, each with a run that ends before its first real step. Building models and finding
    multipliers that a method does not give itself is not timed. Methods of fixed step take more and more
    steps in place of `tolerances`. A run that takes longer than `budget` s of CPU time, or as much again for what is
    built before it, is cut, and the finer runs of its method are left out. With `methods` only those whose name
    contains one of these words run ("peers": all of other packages), and the package's BDF; by default the peers, and
    the package's BDF of each order. The method named `over` runs as well, and others are compared with it.
    ``report(name)`` is called before the first run of a method. Raises InputError for impossible numbers, or a word
    that no name contains.
    """
    if repeats < 1 or not budget > 0 or not all(0 < tol < 1 for tol in tolerances) or not len(tolerances):
        raise InputError("a measurement needs repeats ≥ 1, a budget > 0 s, and tolerances between 0 and 1")
    reference = DenseReference(problem)
    runs, points, versions = [], {}, {}
    for peer in _chosen(methods, over):
        report(peer.name)
        if reason := peer.missing() or peer.can(problem):
            points[peer.name, 0] = Point(peer.name, np.nan, reason)
            continue
        versions[peer.package] = peer.version()
        series = _fixed_steps if peer.fixed_step else _tolerances
        for k, (solve, start, point) in enumerate(series(problem, peer, tolerances, reference, budget)):
            points[peer.name, k] = point
            if solve is not None:
                runs.append(((peer.name, k), solve, start))
    runs.sort(key=lambda run: run[0][1])  # the methods that are compared follow each other
    for key, solve, start in repeats * runs:
        with _quiet():
            setups = (*points[key].setups, _timed(start)) if start else ()
            points[key] = replace(points[key], times=(*points[key].times, _timed(solve)), setups=setups)
    found = tuple(points.values())
    equal = {of: tuple((target, at_equal_error(found, target, over, of)) for target in TARGETS) for of in COMPARED}
    about = problem.name, problem.description, problem.span[1], budget, versions, over, reference.uncertainty
    return Diagram(*about, found, equal)


def _timed(solve) -> float:
    """CPU time of one run, s; fast ones are repeated, since the clock may tick slowly."""
    start, count, elapsed = time.process_time(), 0, 0.0
    while elapsed < LEAST:
        solve()
        count, elapsed = count + 1, time.process_time() - start
    return elapsed / count


def _chosen(methods, over=OWN):
    known = peers()
    if not any(peer.name == over for peer in known):
        raise InputError(f"no method {over!r}; there are {', '.join(peer.name for peer in known)}")
    if methods is None:
        return [peer for peer in known if not peer.detail or peer.name == over]

    def named(peer, word):
        return peer.package != "pinconsist" if word == "peers" else word.lower() in peer.name.lower()

    for word in methods:
        if not any(named(peer, word) for peer in known):
            raise InputError(f"no method {word!r}; choose from {', '.join(peer.name for peer in known)}")
    return [peer for peer in known if peer.name in (OWN, over) or any(named(peer, word) for word in methods)]


def _tolerances(problem, peer, tolerances, reference, budget):
    """(solve or None, its set-up or None, Point) of each tolerance, from coarse to fine, until a run is cut."""
    brief = replace(problem, span=(problem.span[0], problem.span[0] + SHORT * (problem.span[1] - problem.span[0])))
    for tol in sorted(set(tolerances), reverse=True):
        solve, point, spent = _first_run(problem, peer, tol, reference, budget)
        yield solve, solve and _setup(brief, peer, tol, budget), replace(point, tol=tol)
        if solve is None and spent >= budget:
            return


def _fixed_steps(problem, peer, tolerances, reference, budget):
    """(solve or None, None, Point) of more and more steps, until FINEST is met or a run would be cut."""
    steps, before = FEWEST_STEPS, None
    while steps <= MOST_STEPS:
        solve, point, spent = _first_run(problem, peer, steps, reference, budget)
        yield solve, None, replace(point, steps=steps)
        if spent >= budget or point.q <= FINEST:
            return
        more = 4 * steps
        if before is not None and point.q < before[1] / 2:  # or what FINEST needs by the order seen
            order = np.log(before[1] / point.q) / np.log(steps / before[0])
            more = min(more, int(1.2 * steps * (point.q / FINEST) ** (1 / order)) + 1)
        if spent * more / steps > budget:
            yield None, None, Point(peer.name, np.nan, f"more steps ({more}) would take longer than {budget:g} s", more)
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
        with _quiet(), building:
            solve, read = peer.prepare(problem, setting)
        start = time.process_time()
        with _quiet(), running:
            result = solve()
        spent = time.process_time() - start
        with _quiet():
            errors = reference.errors(read(result, thin))
        return solve, Point(peer.name, np.nan, "done", steps[0], (), (), *errors), spent
    except _REFUSALS as error:
        spent = time.process_time() - start
        if running.reached:  # some solvers report the interruption in their own words
            status, spent = f"cut after {budget:g} s", budget
        elif building.reached:
            status, spent = f"the building of its model was cut after {budget:g} s", budget
        else:
            status = f"failed: {str(error).splitlines()[0].split('. ')[0] if str(error) else repr(error)}"
        return None, Point(peer.name, np.nan, status), spent


def _setup(brief, peer, tol, budget):
    """A run that ends before its first real step, or None where the method refuses it."""
    try:
        with _quiet(), _Limit(budget):
            solve, read = peer.prepare(brief, tol)
            read(solve(), lambda count, first=1: np.array([0, count - 1]))
        return solve
    except _REFUSALS:
        return None


@contextmanager
def _quiet():
    """No warnings: what a method cannot give is seen in its errors."""
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(logging.NOTSET)


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


_REFUSALS = _OutOfTime, SolverFailed, PinconsistError, ValueError, RuntimeError, ArithmeticError, SystemError
"""How methods say that they cannot go on."""
