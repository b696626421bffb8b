"""Run time against error of the package's methods and of the peers, on the same problems, in one process."""

from __future__ import annotations

import signal
import time
import warnings
from dataclasses import dataclass, replace

import numpy as np

from pinconsist.errors import InputError, PinconsistError

from .answers import Answers
from .equal_error import at_equal_error
from .peers import OWN, peers
from .peers.problem import Problem, SolverFailed

TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10)
TARGETS = (1e-4, 1e-6)
"""Errors in q at which run times are compared."""
FEWEST, MOST = 125, 1_000_000
"""Steps of a method of fixed step: it takes up to four times as many from run to run, until the last target is met."""
LEAST = 0.05
"""s that a timed run takes, by repetition."""
LOOKED_AT = 400
"""Steps of a run at which its error is measured, beside the first and the last."""


@dataclass(frozen=True)
class Point:
    """One method at one tolerance.

    Attributes
    ----------
    method : str
    tol : float
        rtol = atol; not a number for methods of fixed step.
    status : str
        "done", or why there is nothing else.
    steps : int
    times : tuple of float
        CPU times of the repeats, s: what else runs on the machine does not count.
    q, v, lam : float
        Largest error over the run: of positions (rad, m); of velocities and multipliers, in parts of the largest
        velocity and multiplier of the run.
    q_end : float
        Error in q at the end.
    lam_row, lam_first : float
        Error of the multipliers in the first row behind the initial values, and at the first step by the method itself:
        the package's rows of the one-step start are before it, for all others it is the first row.
    """

    method: str
    tol: float
    status: str
    steps: int = 0
    times: tuple[float, ...] = ()
    q: float = np.nan
    v: float = np.nan
    lam: float = np.nan
    q_end: float = np.nan
    lam_row: float = np.nan
    lam_first: float = np.nan

    @property
    def time(self) -> float:
        """Median CPU time, s."""
        return float(np.median(self.times)) if self.times else np.nan


@dataclass(frozen=True)
class Study:
    """All methods on one problem.

    Attributes
    ----------
    scene, description : str
    until, budget : float
        s of the scene, and s of CPU time that one run may take.
    versions : dict
        Package → version of the methods that ran.
    reference : float
        How far two references differ in q, rad and m.
    points : tuple of Point
    equal_error : tuple of (target, dict)
        Method → :class:`~benchmarks.equal_error.Equal`, None where no tolerance reached this error in q.
    """

    scene: str
    description: str
    until: float
    budget: float
    versions: dict
    reference: float
    points: tuple[Point, ...]
    equal_error: tuple

    def series(self) -> dict:
        """Method → (median times, errors in q), as a figure wants them."""
        found = {}
        for point in self.points:
            if point.times:
                found.setdefault(point.method, []).append((point.time, point.q))
        return {method: tuple(map(np.array, zip(*rows, strict=True))) for method, rows in found.items()}


class _OutOfTime(Exception):
    """The budget of a run is spent."""


def work_precision(
    problem: Problem, tolerances=TOLERANCES, *, repeats=3, budget=10.0, methods=None, tell=None
) -> Study:
    """Measure a problem with every method that is installed and can do it.

    Every method runs once to warm up, which gives its errors; then all run in turn, `repeats` times. Building models
    and finding multipliers that a method does not give itself is not timed.

    Parameters
    ----------
    problem : Problem
    tolerances : sequence of float
        rtol = atol of each run; methods of fixed step take more and more steps instead.
    repeats : int
    budget : float
        CPU time of one run, s, and as much again for what is built before it; a method that needs more is cut, and its
        finer runs are left out.
    methods : sequence of str, optional
        Only methods in whose name one of these words stands, "peers" for all of other packages; the package's BDF
        always runs. Default: the peers, and the package's BDF of each order.
    tell : callable, optional
        Called with the name of each method before its first run.

    Returns
    -------
    Study

    Raises
    ------
    InputError
        Impossible numbers, or a word that stands in no name.
    """
    if repeats < 1 or not budget > 0 or not all(0 < tol < 1 for tol in tolerances) or not len(tolerances):
        raise InputError("a measurement needs repeats ≥ 1, a budget > 0 s, and tolerances between 0 and 1")
    answers = Answers(problem)
    runs, points, versions = [], {}, {}
    for peer in _chosen(methods):
        if tell is not None:
            tell(peer.name)
        reason = peer.missing() or peer.can(problem)
        if reason:
            points[peer.name, 0] = Point(peer.name, np.nan, reason)
            continue
        versions[peer.package] = peer.version()
        series = _fixed_steps if peer.fixed_step else _tolerances
        for k, (solve, point) in enumerate(series(problem, peer, tolerances, answers, budget)):
            points[peer.name, k] = point
            if solve is not None:
                runs.append(((peer.name, k), solve))
    for _ in range(repeats):
        for key, solve in runs:
            points[key] = replace(points[key], times=(*points[key].times, _timed(solve)))
    ordered = tuple(points.values())
    return Study(
        problem.name, problem.description, problem.span[1], budget, versions, answers.doubt, ordered,
        tuple((target, at_equal_error(ordered, target, OWN)) for target in TARGETS),
    )  # fmt: skip


def _timed(solve) -> float:
    """CPU time of one run, s; fast ones are run until the clock, which may tick slowly, has something to tell."""
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
    return [p for p in known if p.name == OWN or any(named(p, word) for word in methods)]


def _tolerances(problem, peer, tolerances, answers, budget):
    """(solve or None, Point) of each tolerance, from coarse to fine, until a run is cut."""
    for tol in sorted(set(tolerances), reverse=True):
        solve, point, spent = _first_run(problem, peer, tol, answers, budget)
        yield solve, replace(point, tol=tol)
        if solve is None and spent >= budget:
            return


def _fixed_steps(problem, peer, tolerances, answers, budget):
    """(solve or None, Point) of more and more steps, until the last target is met or a run would be cut."""
    steps, before = FEWEST, None
    while steps <= MOST:
        solve, point, spent = _first_run(problem, peer, steps, answers, budget)
        yield solve, replace(point, steps=steps)
        if spent >= budget or point.q <= min(TARGETS):
            return
        more = _more_steps(steps, point.q, before)
        if spent * more / steps > budget:
            yield None, Point(peer.name, np.nan, f"more steps ({more}) would take longer than {budget:g} s", more)
            return
        before, steps = (steps, point.q), more


def _more_steps(steps, error, before):
    """Four times as many, or what the last target needs by the order seen between two runs."""
    if before is not None and error < before[1] / 2:
        order = np.log(before[1] / error) / np.log(steps / before[0])
        return min(4 * steps, int(1.2 * steps * (error / min(TARGETS)) ** (1 / order)) + 1)
    return 4 * steps


def _first_run(problem, peer, setting, answers, budget):
    """(solve, Point, seconds spent) of a run that is not timed; without `solve` where it came to nothing."""
    nothing, limits, start = Point(peer.name, np.nan, ""), (_Limit(budget), _Limit(budget)), time.process_time()
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            with limits[0]:
                solve, read = peer.prepare(problem, setting)
            start = time.process_time()
            with limits[1]:
                result = solve()
            spent = time.process_time() - start
            steps = []

            def thin(count, first=1):
                steps.append(count - 1)
                return np.unique(np.concatenate(([0, 1, first], np.linspace(0, count - 1, LOOKED_AT).astype(int))))

            errors = answers.errors(read(result, thin))
        return solve, Point(peer.name, np.nan, "done", steps[0], (), *errors), spent
    except (_OutOfTime, SolverFailed, PinconsistError, ValueError, RuntimeError, ArithmeticError, SystemError) as error:
        if any(limit.reached for limit in limits):  # some solvers tell of the interruption in their own words
            what = "cut" if limits[1].reached else "the building of its model was cut"
            return None, replace(nothing, status=f"{what} after {budget:g} s"), budget
        said = str(error).splitlines()[0].split(". ")[0] if str(error) else repr(error)
        return None, replace(nothing, status=f"failed: {said}"), time.process_time() - start


class _Limit:
    """Raise _OutOfTime in what runs inside, after some seconds of CPU time.

    Attributes
    ----------
    reached : bool
    """

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
