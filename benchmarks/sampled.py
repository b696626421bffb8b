"""What a sample of a digital controller costs, and how exact it is: ``python -m benchmarks sampled``."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass

import numpy as np

from pinconsist import Sampled, Simulation, load, reference_solution, simulate
from pinconsist.cli import output

from . import report

SCENE, JOINT, SPAN = "crank_rocker", "crank", 1.0  # s
PERIODS = (1e-3, 5e-3, 1e-2)  # s
STIFFNESS, DAMPING, SPEED = 20.0, 1.0, 6.0  # N·m/rad, N·m·s/rad; rad/s, of the target


def law(t, q, v):
    """PD control of the crank."""
    return STIFFNESS * (SPEED * t - q[0]) + DAMPING * (SPEED - v[0])


def stepped(mech, period, **options):
    """The solution of `Simulation.step` in a loop of Python."""
    sim = Simulation(mech, **options)
    for _ in range(round(SPAN / period)):
        t, q, v = sim.state
        sim.step(period, {JOINT: law(t, q, v)})
    return sim.solution


def sampled(mech, period, **options):
    """The solution of `simulate` with a `Sampled`."""
    solution = simulate(mech, (0.0, SPAN), forces=[Sampled(period, law, JOINT)], **options)
    return lambda: solution


WAYS = {
    "step, Radau": (stepped, {"rtol": 1e-4}),
    "step, Radau, order 5": (stepped, {"rtol": 1e-4, "max_order": 5}),
    "Sampled, Radau": (sampled, {"method": "Radau", "rtol": 1e-4}),
    "Sampled, BDF": (sampled, {"rtol": 1e-4}),
    "Sampled, Radau, callback": (sampled, {"method": "Radau", "rtol": 1e-4, "callback": lambda *row: None}),
}


@dataclass(frozen=True)
class Sample:
    """What a way takes for a sample, s of process time, its law included, and the largest errors at the end."""

    period: float
    way: str
    time: float
    q: float
    v: float
    lam: float


def measured(periods=PERIODS, repeats=5) -> list[Sample]:
    """Each way at each period, in turn; the least of the times."""
    mech, rows = load(SCENE), []
    for period in periods:
        times = {way: [] for way in WAYS}
        found = {}
        for _ in range(repeats):
            for way, (run, options) in WAYS.items():
                begun = time.process_time()
                solution = run(mech, period, **options)
                times[way].append((time.process_time() - begun) * period / SPAN)
                found[way] = solution()
        q, v, lam = by_windows(mech, period)
        for way, sol in found.items():
            errors = (float(np.abs(a[-1] - b).max()) for a, b in ((sol.q, q), (sol.v, v), (sol.lam, lam)))
            rows.append(Sample(period, way, min(times[way]), *errors))
    return rows


def by_windows(mech, period):
    """(q, v, λ) at the end by DOP853, one run a sample."""
    q, v = Simulation(mech).state[1:]
    for k in range(round(SPAN / period)):
        t = k * period
        end = reference_solution(mech.with_forces({JOINT: float(law(t, q, v))}), t, q, v, [t + period])
        q, v = end.q[-1], end.v[-1]
    return q, v, end.lam[-1]


# fmt: off
def command(csv: report.Csv = None, as_json: output.Json = False) -> int:
    # fmt: on
    """Time a sample of a PD controller at 1 kHz, 200 Hz and 100 Hz, and compare with DOP853, one run a sample.

    Example: python -m benchmarks sampled
    """
    output.require_writable(csv=csv)
    rows = [asdict(row) for row in measured()]
    if report.in_files(csv, as_json, rows, sampled=rows):
        return output.FINE
    columns = [
        ("period [ms]>", report.scaled("period", 1e3, 0)),
        ("way", "{way}"),
        ("sample [µs]>", report.scaled("time", 1e6, 1)),
        ("error of q>", "{q:.0e}"),
        ("of v>", "{v:.0e}"),
        ("of λ>", "{lam:.0e}"),
    ]
    report.table(rows, columns, f"{SCENE}, PD control of the {JOINT}, {SPAN:g} s, rtol 1e-4")
    return output.FINE
