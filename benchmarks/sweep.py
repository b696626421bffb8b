"""What a sweep costs beyond its runs, and what a second thread brings: ``python -m benchmarks sweep``."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import numpy as np

from pinconsist import Simulations, load, simulate, sweep
from pinconsist.cli import output
from pinconsist.cli.scene import option
from pinconsist.run.steppers import Stepper
from pinconsist.run.sweep_table import Journal, SceneSweep, write_table

from . import report

SPEEDS = 8.0, 16.0  # rad/s, of the crank at the start
PART = 50  # cases that are run in turn, alone and in the sweep
WAYS = {"pc.sweep": False, "pinconsist sweep, with its table": True}


@cache
def mechanism():
    """The crank-rocker, loaded once as a sweep does."""
    return load("crank_rocker")


@dataclass(frozen=True)
class Scene:
    """The crank-rocker, as a sweep loads it."""

    def load(self):
        return mechanism()


@dataclass(frozen=True)
class Sweep:
    """Process times, s, of the runs of all cases, and of a sweep over them."""

    way: str
    cases: int
    runs: float
    sweep: float
    ratio: float


def run(case, until=5.0, method="BDF"):
    """The run of a case."""
    return simulate(mechanism(), (0.0, until), {"crank": 0.0}, {"crank": case[0]}, method=method)


def steps(case):
    """How many steps its run takes: what a sweep would keep of it."""
    return run(case).nsteps


def sweeps(count=1000) -> list[Sweep]:
    """Time the runs of the cases and sweeps over them, in turn."""
    cases = [[float(speed)] for speed in np.linspace(*SPEEDS, count)]
    table = SceneSweep(Scene(), ("crank_speed",), 0.0, 5.0, {"crank": 0.0}, {}, {"rtol": 1e-6, "atol": 1e-8})
    rows = []
    run(cases[0])
    for way, to_table in WAYS.items():
        alone, swept = 0.0, 0.0
        with TemporaryDirectory() as folder:
            out = Path(folder) / "table.csv"
            for i in range(0, count, PART):
                part = cases[i : i + PART]
                alone += _seconds(lambda part=part: [run(case) for case in part])
                work = partial(_tabulated, table, part, out) if to_table else partial(sweep, steps, part)
                swept += _seconds(work)
        rows.append(Sweep(way, count, alone, swept, swept / alone))
    return rows


def _tabulated(table, cases, out):
    """What the command does with the cases, in one process."""
    with Journal(out, table.about(cases)) as journal:
        sweep(table, cases, callback=lambda outcome: journal.add(outcome.index, outcome.value))
        write_table(out, table, cases, journal.rows)
        journal.remove()


def _seconds(work) -> float:
    begun = time.process_time()
    work()
    return time.process_time() - begun


@dataclass(frozen=True)
class Threads:
    """How many times as many cases two threads run as one: the least wall times of both, in turn.

    `free` is the share of a run's processor time in which other threads may run, `cores` those that two threads used.
    """

    method: str
    until: float
    free: float
    cores: float
    ratio: float


def threads(until, method, repeats=7, cases=40) -> Threads:
    """Measure runs of this length, s."""
    work, speeds = partial(run, until=until, method=method), [[speed] for speed in np.linspace(*SPEEDS, cases)]
    free, least, cores = _free_share(work, speeds), {1: np.inf, 2: np.inf}, 0.0
    for _ in range(repeats):
        for count in least:
            with ThreadPoolExecutor(count) as executor:
                list(executor.map(work, speeds[:count]))
                used, begun = time.process_time(), time.perf_counter()
                list(executor.map(work, speeds))
                used, taken = time.process_time() - used, time.perf_counter() - begun
            least[count], cores = min(least[count], taken), max(cores, used / taken)
    return Threads(method, until, free, cores, least[1] / least[2])


def _free_share(work, cases) -> float:
    """The share of the time in the loop around the steps, which holds no lock of Python's."""
    inside, advance = [], Stepper.advance

    def timed(*arguments, **named):
        begun = time.thread_time()
        try:
            return advance(*arguments, **named)
        finally:
            inside.append(time.thread_time() - begun)

    Stepper.advance = timed
    try:
        begun = time.thread_time()
        for case in cases:
            work(case)
        return sum(inside) / (time.thread_time() - begun)
    finally:
        Stepper.advance = advance


@dataclass(frozen=True)
class Ensemble:
    """Many cases that differ in a mass: their wall and process time, s, from the mechanism to the last states."""

    way: str
    cases: int
    wall: float
    process: float
    per_second: float


def ensembles(count=2000, rounds=3) -> list[Ensemble]:
    """Time crank-rockers with random masses, 1 s each, the ways in turn; the least times."""
    masses = np.random.default_rng(0).uniform(0.5, 2.0, count)
    ways = {
        "pc.sweep of simulate": partial(_swept, masses),
        "Simulations, 1 thread": partial(_at_once, masses, 1),
        "Simulations, 2 threads": partial(_at_once, masses, 2),
    }
    least = {way: np.array([np.inf, np.inf]) for way in ways}
    ends = {}
    for _ in range(rounds):
        for way, work in ways.items():
            begun = time.perf_counter(), time.process_time()
            ends[way] = work()
            ended = time.perf_counter(), time.process_time()
            least[way] = np.minimum(least[way], np.subtract(ended, begun))
    first, *others = ends.values()
    if not all(np.array_equal(first, each) for each in others):
        raise AssertionError("the ways do not agree to the last bit")
    return [Ensemble(way, count, *times.tolist(), count / times[0]) for way, times in least.items()]


def _with_mass(mass):
    sol = simulate(mechanism().with_parameters({"mass:coupler": mass}), (0.0, 1.0), v0={"crank": SPEEDS[0]})
    return sol.q[-1]


def _swept(masses):
    return np.array([outcome.value for outcome in sweep(_with_mass, masses.tolist())])


def _at_once(masses, threads):
    sims = Simulations(mechanism(), len(masses), v0={"crank": SPEEDS[0]}, threads=threads)
    sims.set_parameters({"mass:coupler": masses})
    return sims.step(1.0).q


# fmt: off
def command(
    count: Annotated[int, option("--count", "N", "Cases of the sweeps.")] = 1000,
    csv: report.Csv = None,
    as_json: output.Json = False,
) -> int:
    # fmt: on
    """Compare sweeps over runs of the crank-rocker with these runs alone, two threads with one, and many runs at once.

    Threads go to FILE_threads.csv, runs at once to FILE_ensembles.csv.

    Example: python -m benchmarks sweep --count 300
    """
    output.require_writable(csv=csv)
    rows = [asdict(row) for row in sweeps(count)]
    pairs = [asdict(threads(until, method)) for method in ("BDF", "Radau") for until in (1.0, 5.0)]
    many = [asdict(row) for row in ensembles(2 * count)]
    if csv:
        report.write_csv(report.beside(csv, "threads"), pairs)
        report.write_csv(report.beside(csv, "ensembles"), many)
    if report.in_files(csv, as_json, rows, sweeps=rows, threads=pairs, ensembles=many):
        return output.FINE
    columns = [
        ("sweep", "{way}"),
        ("cases>", "{cases}"),
        ("runs [s]>", "{runs:.2f}"),
        ("sweep [s]>", "{sweep:.2f}"),
        ("sweep / runs>", "{ratio:.2f}"),
    ]
    report.table(rows, columns, "crank_rocker, 5 s, speeds of the crank: process times of parts made in turn")
    columns = [
        ("method", "{method}"),
        ("run [s]>", "{until:g}"),
        ("without lock [%]>", report.scaled("free", 100.0, 0)),
        ("processors used>", "{cores:.2f}"),
        ("cases of two threads / one>", "{ratio:.2f}"),
    ]
    report.table(pairs, columns, "two threads: least wall times; of a machine that has two processors to spare")
    columns = [
        ("way", "{way}"),
        ("cases>", "{cases}"),
        ("wall [s]>", "{wall:.2f}"),
        ("process [s]>", "{process:.2f}"),
        ("cases a second>", "{per_second:.0f}"),
    ]
    report.table(many, columns, "crank_rocker, 1 s, random masses: from the mechanism to the last states")
    return output.FINE
