"""Runs of random chains, each judged by the reference."""

from __future__ import annotations

import time
import traceback
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from pinconsist import InputError, PinconsistError, simulate

from ..child import Child
from .reference import Reference
from .scenes import random_chain

FINE, REFUSED, OPEN, FALSE, FOREIGN, HUNG = "fine", "refused", "loop open", "FALSE REFUSAL", "TRACEBACK", "HUNG"
FAILURES = (OPEN, FALSE, FOREIGN, HUNG)
CLOSED_GAP = 1e-10
"""Gap of a loop, relative to the largest coordinate, above which a success is none."""
ROWS = 100
"""Rows that are compared, evenly spread, the first and the last among them."""
FLOOR = 1e-2
"""atol over rtol: a coordinate that stays below it is judged as if it reached it."""
BESIDE = 1e-3
"""Part of the span by which the reference may get further than a run that was rightly refused."""
LARGE, TILT = 30.0, 1e-8
"""Error over tolerance from which the amplification is measured, and the change of velocity that measures it."""
MAX_STEPS = 300_000


@dataclass(frozen=True)
class Run:
    """One run. Errors are over the tolerance: the largest of the run, each coordinate in parts of its largest value."""

    seed: int
    scene: str
    method: str
    tol: float
    outcome: str
    message: str = ""
    steps: int | None = None
    rejected: int | None = None
    seconds: float | None = None
    gap: float | None = None  # relative
    q: float | None = None
    v: float | None = None
    force: float | None = None  # of Jᵀλ, relative to its largest
    estimate: float | None = None  # of q and v by the solution itself
    amplification: float | None = None  # of a small change of the first velocity, where an error is large
    reference: str = ""  # why it ends early


def runs(seeds, tolerances, method="BDF", *, until=1.0, limit=60.0) -> Iterator[Run]:
    """Every chain at every tolerance, each run ended after `limit` s."""
    if not (limit > 0 and until > 0):
        raise InputError(f"a run needs a span and a limit of some seconds, got {until:g} and {limit:g}")
    child = Child(_answer)
    try:
        for seed in seeds:
            scene, why = child.ask((seed, until), limit)
            for tol in tolerances:
                blank = Run(seed, scene or "", method, tol, HUNG, why)
                found, why_not = child.ask((blank, until), limit) if scene else (blank, "")
                yield found or replace(blank, message=why_not)
    finally:
        child.end()


def _answer(question):
    """Of a seed: what the scene is, in words. Of a run that has not been made: the run."""
    which, until = question
    if isinstance(which, Run):
        return judged(which, until)
    mech, _, _ = random_chain(which)
    joints = ", ".join(joint.rstrip("0123456789") for joint in mech.joints)
    forces = ", ".join(type(force).__name__ for force in mech.forces)
    return f"{joints} closed by {', '.join(loop.kind for loop in mech.loops)}" + (f" with {forces}" if forces else "")


def judged(run: Run, until: float) -> Run:
    """A run, made and compared with the reference of its seed."""
    mech, q, v = random_chain(run.seed)
    reference = _reference(run.seed, until)
    options = {"rtol": run.tol, "atol": FLOOR * run.tol, "method": run.method}
    start = time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            sol = simulate(mech, (0.0, until), q, v, max_steps=MAX_STEPS, **options)
    except PinconsistError as error:
        return replace(run, outcome=_refused(reference, 0.0, until), message=str(error), reference=reference.why)
    except Exception:
        return replace(run, outcome=FOREIGN, message=traceback.format_exc(limit=-3), reference=reference.why)
    seconds = time.perf_counter() - start
    gap, errors = compared(sol, reference)
    outcome = FINE if gap <= CLOSED_GAP else OPEN
    if not sol.success:
        outcome = _refused(reference, sol.t[-1], until)
    errors = {name: error / run.tol for name, error in errors.items()}
    large = not reference.why and max(errors.values()) > LARGE
    amplified = _amplification(run.seed, until) if large else None
    estimate = sol.error.tolerances if sol.success and sol.error else None
    return replace(
        run, outcome=outcome, message="" if sol.success else sol.message, steps=sol.nsteps,
        rejected=sum(sol.rejected.values()), seconds=seconds, gap=gap, amplification=amplified, reference=reference.why,
        estimate=estimate, **errors,
    )  # fmt: skip


def compared(sol, reference):
    """(largest gap, relative, {name: error}) of a solution; the errors as far as the reference goes."""
    chosen = np.unique(np.linspace(0, len(sol.t) - 1, ROWS).astype(int))
    rows = [(sol.t[i], sol.q[i], sol.v[i], sol.lam[i]) for i in chosen]
    gap = max(reference.equations.gap(t, q) / (1.0 + np.abs(q).max()) for t, q, _, _ in rows)
    rows = [(t, q, v, sol.system.loop_rows(q, t)[1].T @ lam) for t, q, v, lam in rows if t <= reference.until]
    return gap, off(reference, rows) if len(rows) > 1 else {}


def off(reference, rows) -> dict[str, float]:
    """The largest errors of rows (t, q, v, Jᵀλ), each coordinate in parts of its largest value; forces of any one."""
    kinematics, errors, sizes = reference.equations.kinematics, [], []
    for t, q, v, force in rows:
        true_q, true_v, true_force = reference.at(t)
        errors.append([kinematics.difference(true_q, q), v - true_v, force - true_force])
        sizes.append([kinematics.sizes(true_q), np.abs(true_v), np.full(len(v), np.abs(true_force).max())])
    relative = np.abs(errors).max(axis=0) / (np.max(sizes, axis=0) + FLOOR)
    return dict(zip(("q", "v", "force"), relative.max(axis=1).tolist(), strict=True))


def _refused(reference, reached, until):
    """What a refusal is: true where the reference does not get further either."""
    return FALSE if reference.until > reached + BESIDE * until else REFUSED


@lru_cache(maxsize=1)
def _reference(seed, until):
    return Reference(*random_chain(seed), until)


@lru_cache(maxsize=1)
def _amplification(seed, until):
    """By how much a change of the first velocity grows, at most."""
    mech, q, v = random_chain(seed)
    reference = _reference(seed, until)
    tilt = TILT * np.random.default_rng(seed).normal(size=len(v))
    other = Reference(mech, q, v + tilt, until)
    moved = [
        np.abs(reference.at(t)[1] - other.at(t)[1]).max()
        for t in np.linspace(0.0, min(reference.until, other.until), ROWS)
    ]
    return float(max(moved) / max(moved[0], 1e-30))
