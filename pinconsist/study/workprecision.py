"""Run time against error of the package's methods and of the peers, on the same problems, in one process."""

from __future__ import annotations

import signal
import time
import warnings
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp

from ..dae.newton import solve_acceleration
from ..dae.start import chart_state, right_hand_side
from ..errors import InputError, PinconsistError
from .peers import OWN, peers
from .peers.problem import Problem, SolverFailed

TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10)
COARSE = (1.0, 1e-2)
"""Further ones for the methods of fixed step, for which a tolerance stands for a number of steps."""
TARGETS = (1e-4, 1e-6)
"""Errors in q at which run times are compared."""
LOOKED_AT = 400
"""Steps of a run at which its error is measured, beside the first and the last."""


@dataclass(frozen=True)
class Point:
    """One method at one tolerance.

    Attributes
    ----------
    method : str
    tol : float
        rtol = atol; for methods of fixed step it chooses the step.
    status : str
        "done", or why there is nothing else.
    steps : int
    times : tuple of float
        CPU times of the repeats, s: what else runs on the machine does not count.
    q, v, lam : float
        Largest error over the run: of positions (rad, m); of velocities and multipliers, in parts of the largest
        velocity and multiplier of the run.
    q_end, lam_first : float
        Error in q at the end, and of the multipliers at the first step.
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
        Method → (time, s, at which it reaches this error in q; how many times that of the package's BDF), medians over
        the repeats; None where no tolerance reached it.
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
        rtol = atol of each run.
    repeats : int
    budget : float
        CPU time of one run, s; a method that needs more is cut, and its finer runs are left out.
    methods : sequence of str, optional
        Only methods in whose name one of these words stands; the package's BDF always runs.
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
        for k, tol in enumerate(sorted({*tolerances, *(COARSE if peer.fixed_step else ())}, reverse=True)):
            solve, point, spent = _first_run(problem, peer, tol, answers, budget)
            points[peer.name, k] = point
            if point.status != "done" and spent >= budget:
                break
            if point.status == "done":
                runs.append(((peer.name, k), solve))
            if peer.fixed_step and spent * 4 > budget:
                break
    for _ in range(repeats):
        for key, solve in runs:
            start = time.process_time()
            solve()
            elapsed = time.process_time() - start
            points[key] = replace(points[key], times=(*points[key].times, elapsed))
    ordered = tuple(points.values())
    return Study(
        problem.name, problem.description, problem.span[1], budget, versions, answers.doubt, ordered,
        tuple(_equal_error(ordered, target) for target in TARGETS),
    )  # fmt: skip


def _chosen(methods):
    known = peers()
    if methods is None:
        return known
    for word in methods:
        if not any(word.lower() in peer.name.lower() for peer in known):
            raise InputError(f"no method {word!r}; there are {', '.join(peer.name for peer in known)}")
    return [p for p in known if p.name == OWN or any(word.lower() in p.name.lower() for word in methods)]


def _first_run(problem, peer, tol, answers, budget):
    """(solve, Point, seconds spent) of a run that is not timed."""
    start = time.process_time()
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"), _limited(budget):
            warnings.simplefilter("ignore")
            solve, read = peer.prepare(problem, tol)
            start = time.process_time()
            result = solve()
            spent = time.process_time() - start
        steps = []

        def thin(count):
            steps.append(count - 1)
            return np.unique(np.concatenate(([0, 1], np.linspace(0, count - 1, LOOKED_AT).astype(int))))

        errors = answers.errors(read(result, thin))
        return solve, Point(peer.name, tol, "done", steps[0], (), *errors), spent
    except _OutOfTime:
        return None, Point(peer.name, tol, f"cut after {budget:g} s"), budget
    except (SolverFailed, PinconsistError, ValueError, RuntimeError, ArithmeticError) as error:
        spent = time.process_time() - start
        if spent >= budget:  # a solver that tells of the interruption in its own words
            return None, Point(peer.name, tol, f"cut after {budget:g} s"), budget
        return None, Point(peer.name, tol, f"failed: {str(error).splitlines()[0] if str(error) else error!r}"), spent


class _limited:
    """Raise _OutOfTime in what runs inside, after some seconds of CPU time."""

    def __init__(self, seconds):
        self.seconds = seconds

    def __enter__(self):
        def stop(number, frame):
            raise _OutOfTime

        self.before = signal.signal(signal.SIGPROF, stop)
        signal.setitimer(signal.ITIMER_PROF, self.seconds, 0.5)  # again, where a callback's exception was swallowed

    def __exit__(self, *error):
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, self.before)


class Answers:
    """The answer of a problem at any time: scipy's DOP853 at 1e-13 on the index-1 equations, its steps dense.

    Attributes
    ----------
    doubt : float
        Largest difference in q to the same at 1e-11.
    """

    def __init__(self, problem: Problem):
        if not problem.system.vector_like:
            raise InputError(f"{problem.name}: no reference for configurations that are no vectors")
        self.problem, self.system = problem, problem.system
        fine, coarse = (self._dense(rtol) for rtol in (1e-13, 1e-11))
        self.dense = fine
        n, times = self.system.nx, np.linspace(*problem.span, 200)
        self.doubt = float(np.abs(fine(times)[:n] - coarse(times)[:n]).max())
        _, v, lam = self.at(times)
        self._largest_v, self._largest_lam = (max(np.abs(part).max(initial=0.0), 1e-300) for part in (v, lam))

    def _dense(self, rtol):
        problem, system = self.problem, self.system
        f = right_hand_side(system, problem.q0)
        y0 = chart_state(system, problem.q0, problem.q0, problem.v0)
        run = solve_ivp(f, problem.span, y0, "DOP853", rtol=rtol, atol=rtol, dense_output=True)
        if not run.success:
            raise PinconsistError(f"{problem.name}: no reference: {run.message}")
        return run.sol

    def at(self, times):
        """(q, v, λ of all rows) at times."""
        y = self.dense(times).T
        q, v = y[:, : self.system.nx], y[:, self.system.nx :]
        kept = np.array([solve_acceleration(self.system, *row)[1] for row in zip(times, q, v, strict=True)])
        return q, v, self.problem.multipliers(q, kept)

    def errors(self, rows) -> tuple[float, ...]:
        """(q, v, λ, q at the end, λ at the first step)."""
        q, v, lam = self.at(np.clip(rows.t, *self.problem.span))
        by_q, by_v, by_lam = (np.abs(a - b).max(axis=1) for a, b in ((rows.q, q), (rows.v, v), (rows.lam, lam)))
        relative = by_lam[1:] / self._largest_lam  # the start is given, not computed
        return (by_q.max(), by_v.max() / self._largest_v, relative.max(), by_q[-1], relative[0])


def _equal_error(points, target):
    """(target, {method: (time, ratio) or None}) by straight lines between the points of a log-log diagram."""
    runs = {}
    for point in points:
        if point.times and np.isfinite(point.q):
            runs.setdefault(point.method, []).append(point)
    times = {method: _times_at(rows, target) for method, rows in runs.items()}
    own = times.get(OWN)
    found = {}
    for method, reached in times.items():
        if reached is None:
            found[method] = None
            continue
        ratio = float(np.median(reached / own)) if own is not None else np.nan
        found[method] = float(np.median(reached)), ratio
    return target, found


def _times_at(rows, target):
    """Times of the repeats at which the error reaches `target`, or None where it does not."""
    for before, after in pairwise(rows):
        if after.q <= target <= before.q:
            part = np.log(before.q / target) / np.log(before.q / after.q)
            logs = [np.log(np.array(point.times)) for point in (before, after)]
            return np.exp(logs[0] + part * (logs[1] - logs[0]))
    return np.array(rows[0].times) if rows and rows[0].q <= target else None
