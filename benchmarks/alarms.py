"""``python -m benchmarks alarms``: how often the verdict of a run is wrong."""

from __future__ import annotations

import time
import warnings
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from typing import Annotated

import numpy as np
import pinocchio as pin

from pinconsist import InputError, PinconsistError, Torque, simulate
from pinconsist.cli import output
from pinconsist.cli.scene import option
from pinconsist.engine.norms import EPS

from . import report
from .chains.campaign import FLOOR, MAX_STEPS, off
from .chains.reference import Reference
from .chains.scenes import random_chain
from .child import Child

QUANTITIES = ("q", "v", "force")
TOLERANCES = (1e-4, 1e-7)
METHODS = ("BDF", "Radau")
PULSES = 0.1, 0.005
"""Longest and shortest duration of the pulses, in parts of the span."""
ROWS = 200
"""Rows that are compared, evenly spread, the first and the last among them."""
SMALL = 1e-3
"""Of a tolerance: errors and estimates below it are taken to be as large, as rounding decides them."""
OF_ERRORS = ("loops", "velocities", "forces", "energy", "error")
"""Concerns that say that numbers are wrong; the others are facts of the scene."""
BARS = {"q": 100.0, "v": 100.0, "force": 0.01}
"""Errors of q and v in tolerances, and of forces relative to the largest, at which a verdict must not be ok."""
ROUNDING = 1e-9
"""Of the other forces, and of masses times squared speeds: loop forces that are all smaller are rounding."""
ROUNDED = 16.0
"""Rounding of these forces, in EPS: errors of loop forces up to there are none."""
NEAR, FAR = 3.0, 10.0
"""Factors between estimated and true errors: that of a good estimate, and that beyond which ``ok`` misleads."""


@dataclass(frozen=True)
class Judged:
    """The verdict of one run, the errors that it states and the true ones; they are the largest over all rows."""

    seed: int
    pulse: float  # duration of a pulse, in parts of the span; 0 without one
    method: str
    tol: float
    verdict: str = ""
    concerns: tuple[str, ...] = ()
    estimated: bool = False
    stated: tuple[float, ...] = ()  # of q, v (rad or m, and per s) and forces, relative
    true: tuple[float, ...] = ()
    tolerances: tuple[float, ...] = ()  # true errors of q and v in tolerances
    seconds: float = 0.0
    why: str = ""  # there is nothing to compare

    @property
    def alarmed(self) -> bool:
        """Whether the verdict says that numbers are wrong."""
        return any(name in self.concerns for name in OF_ERRORS)

    @property
    def missed(self) -> bool:
        """Whether the verdict is ok although an error is far above the one stated."""
        return not self.alarmed and self.estimated and max(self.ratios, default=1.0) > FAR

    @property
    def blind(self) -> bool:
        """Whether the verdict is ok, without an estimate, although an error is large."""
        return not self.alarmed and not self.estimated and self._relative > 1.0

    @property
    def false(self) -> bool:
        """Whether the verdict says that numbers are wrong although all are right."""
        return self.alarmed and self._relative < 0.1

    @property
    def _relative(self) -> float:
        """The largest of the errors in parts of its bar."""
        return max(size / bar for size, bar in zip((*self.tolerances, self.true[2]), BARS.values(), strict=True))

    @property
    def ratios(self) -> list[float]:
        """True errors over stated ones."""
        small = SMALL * self.tol
        return [max(true, small) / max(stated, small) for true, stated in zip(self.true, self.stated, strict=True)]


@dataclass(frozen=True)
class Pulse:
    """A force on one coordinate for a short time, smooth: size·sin²."""

    coordinate: int
    size: float
    start: float
    duration: float

    def __call__(self, t, q, v):
        tau, part = np.zeros(len(v)), (t - self.start) / self.duration
        if 0.0 < part < 1.0:
            tau[self.coordinate] = self.size * np.sin(np.pi * part) ** 2
        return tau


def scene(seed: int, pulse: float, until: float):
    """(mechanism, q, v, times at which forces begin or end) of a chain, with a pulse that lasts a part of the span."""
    mech, q, v = random_chain(seed)
    if not pulse:
        return mech, q, v, ()
    rng = np.random.default_rng(seed)
    duration = pulse * until
    start = rng.uniform(0.05 * until, 0.95 * until - duration)
    force = Pulse(int(rng.integers(mech.nv)), rng.uniform(5.0, 50.0) * rng.choice((-1.0, 1.0)), start, duration)
    return mech.add_forces(Torque(force)), q, v, (start, start + duration)


# fmt: off
def command(
    count: Annotated[int, option("--count", "N", "How many random closed chains.")] = 100,
    pulses: Annotated[int, option("--pulses", "N", "How many of them again with a pulse of a force.")] = 20,
    seed: Annotated[int, option("--seed", "N", "Seed of the first of them.")] = 1,
    tol: Annotated[list[float] | None, option(
        "--tol", "NUMBER", "An rtol, atol being a hundredth; may be repeated. Default: 1e-4, 1e-7.")] = None,
    method: Annotated[list[str] | None, option(
        "--method", "NAME", "As of simulate; may be repeated. Default: BDF, Radau.")] = None,
    until: Annotated[float, option("--until", "SECONDS", "Span of a run.")] = 1.0,
    limit: Annotated[float, option("--limit", "SECONDS", "How long a run and its reference may take.")] = 120.0,
    csv: report.Csv = None,
    as_json: output.Json = False,
) -> int:
    # fmt: on
    """Compare the verdicts of runs with their true errors.

    The scenes are those of `chains`, and some of them once more with a pulse
    of a force that lasts 10 to 0.5 % of the span. Prints the runs that are
    called ok although an error is more than 10 times the one that is stated,
    those that are called wrong although all errors are below a tenth of what
    would be wrong, and how many of the stated errors are right within 3. The
    exit code is 1 if there are any of the former.

    Example: python -m benchmarks alarms --count 500 --csv alarms.csv
    """
    output.require_writable(csv=csv)
    if count < 0 or pulses < 0 or seed < 0 or count + pulses < 1:
        raise InputError(f"--count, --pulses and --seed must not be negative, got {count}, {pulses} and {seed}")
    durations = np.geomspace(*PULSES, pulses) if pulses else []
    scenes = [(seed + i, 0.0) for i in range(count)] + [(seed + i, float(part)) for i, part in enumerate(durations)]
    plan = [(scene, each, name) for scene in scenes for name in method or METHODS for each in tol or TOLERANCES]
    rows, child = [], Child(_answer)
    try:
        with report.status() as show:
            for (number, pulse), each, name in plan:
                blank = Judged(number, pulse, name, each)
                found, why = child.ask((blank, until), limit)
                rows.append(found or replace(blank, why=why))
                show(f"{len(rows)} of {len(plan)}: seed {number}")
    finally:
        child.end()
    compared = [row for row in rows if not row.why]
    wrong = [row for row in compared if row.missed or row.blind or row.false]
    figures = summary(compared)
    tables = {"wrong": [asdict(row) | {"kind": kind(row)} for row in wrong], "summary": figures}
    if not report.in_files(csv, as_json, [asdict(row) | {"kind": kind(row)} for row in rows], **tables):
        report.table(tables["wrong"], WRONG, "false and missed alarms")
        report.table(figures, SUMMARY, "of stated errors, and of verdicts")
        reasons = ", ".join(sorted({row.why.splitlines()[0][:60] for row in rows if row.why}))
        print(f"{len(compared)} of {len(rows)} runs were compared" + (f"; the others: {reasons}" if reasons else ""))
    return output.FAILED if wrong else output.FINE


def kind(row: Judged) -> str:
    """What is wrong with a verdict, or an empty string."""
    if row.why:
        return ""
    return "missed" if row.missed else "not seen" if row.blind else "false" if row.false else ""


def summary(rows: list[Judged]) -> list[dict]:
    """Of each method and tolerance, with and without pulses: shares of good estimates, and numbers of wrong alarms."""
    found = []
    for pulsed, name, tol in sorted({(row.pulse > 0.0, row.method, row.tol) for row in rows}):
        alike = [row for row in rows if (row.pulse > 0.0, row.method, row.tol) == (pulsed, name, tol)]
        ratios = np.array([row.ratios for row in alike if row.estimated]).reshape(-1, len(QUANTITIES))
        good = (np.abs(np.log(ratios)) <= np.log(NEAR)).mean(axis=0) if len(ratios) else [np.nan] * len(QUANTITIES)
        found.append(
            {"pulses": "yes" if pulsed else "", "method": name, "tol": tol, "runs": len(alike)}
            | {f"good_{quantity}": float(share) for quantity, share in zip(QUANTITIES, good, strict=True)}
            | {"estimated": len(ratios), "alarmed": sum(row.alarmed for row in alike)}
            | {word: sum(kind(row) == word for row in alike) for word in ("missed", "not seen", "false")}
        )
    return found


def _answer(question) -> Judged:
    row, until = question
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            return judged(row, until)
    except PinconsistError as error:
        return replace(row, why=f"refused: {error}")


def judged(row: Judged, until: float) -> Judged:
    """A run with its verdict, compared with the reference of its scene."""
    mech, q, v, _ = scene(row.seed, row.pulse, until)
    reference = _reference(row.seed, row.pulse, until)
    if reference.why:
        return replace(row, why=f"reference: {reference.why}")
    sol = simulate(mech, (0.0, until), q, v, rtol=row.tol, atol=FLOOR * row.tol, method=row.method, max_steps=MAX_STEPS)
    if not sol.success:
        return replace(row, why="run ended early")
    began = time.perf_counter()
    certificate = sol.check(error=True)  # on a busy machine, a second run may take more than check() waits
    seconds = time.perf_counter() - began
    error = certificate.error
    forces = max(error.force, certificate.force) if error else certificate.force
    stated = (float(error.q), float(error.v), float(forces)) if error else (0.0, 0.0, float(forces))
    true, tolerances = true_errors(sol, reference, row.tol)
    return replace(
        row, verdict=certificate.verdict, concerns=tuple(certificate._named_concerns), estimated=error is not None,
        stated=stated, true=true, tolerances=tolerances, seconds=seconds,
    )  # fmt: skip


def true_errors(sol, reference, tol):
    """((q, v, force), (q, v) in tolerances), the largest of the rows."""
    kinematics, found, sizes, states = reference.equations.kinematics, [], [], []
    for i in np.unique(np.linspace(0, len(sol.t) - 1, ROWS).astype(int)):
        q, v, force = reference.at(sol.t[i])
        ours = sol.system.loop_rows(sol.q[i], sol.t[i])[1].T @ sol.lam[i]
        errors = kinematics.difference(q, sol.q[i]), sol.v[i] - v, ours - force
        found.append([np.abs(error).max() for error in errors])
        sizes.append(np.abs(force).max())
        states.append((sol.t[i], sol.q[i], sol.v[i], ours))
    q, v, force = np.max(found, axis=0)
    over = off(reference, states)
    others = np.abs(sol.system.evaluate(sol.t[0], sol.q[0], sol.v[0], 0.0 * sol.v[0])[0]).max()
    masses = np.abs(pin.crba(sol.system.model, sol.system.model.createData(), sol.q[0])).max()
    others = max(others, masses * np.abs(sol.v).max() ** 2)
    scale = max(*sizes, ROUNDING * others) or 1.0
    force = max(force - ROUNDED * EPS * others, 0.0)
    return (float(q), float(v), float(force / scale)), (over["q"] / tol, over["v"] / tol)


@lru_cache(maxsize=1)
def _reference(seed, pulse, until):
    mech, q, v, ends = scene(seed, pulse, until)
    return Reference(mech, q, v, until, ends=ends)


def _numbers(name):
    return lambda row: " ".join(f"{number:.1g}" for number in row[name])


WRONG = [
    "seed>", "pulse>:.2g", "method", "tol>:g", "kind", ("stated q, v, force", _numbers("stated")),
    ("true", _numbers("true")), ("in tol", _numbers("tolerances")), ("verdict", "{verdict}"),
]  # fmt: skip
SUMMARY = [
    "pulses", "method", "tol>:g", "runs>", "estimated>", ("q within 3>", "{good_q:.1%}"),
    ("v within 3>", "{good_v:.1%}"), ("forces within 3>", "{good_force:.1%}"),
    "alarmed>", "missed>", "not seen>", "false>",
]  # fmt: skip
