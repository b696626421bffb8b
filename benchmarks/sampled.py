"""What a sample of a digital controller costs, and how exact it is: ``python -m benchmarks sampled``."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace

import numpy as np

from pinconsist import Sampled, Simulation, load, simulate
from pinconsist.cli import output
from pinconsist.paper import reference_solution

from . import report

STIFFNESS, DAMPING, SPEED = 20.0, 1.0, 6.0  # N·m/rad, N·m·s/rad; rad/s, of the target
LEGS, PHASES = np.arange(2, 18, 3), np.arange(6) * np.pi / 3.0  # columns of the lengths


def crank(t, q, v):
    """PD control of the crank."""
    return [STIFFNESS * (SPEED * t - q[0]) + DAMPING * (SPEED - v[0])]


def platform(t, q, v):
    """PD control of the six legs, whose lengths are to swing."""
    return 2e4 * (0.676 + 0.04 * np.sin(2.0 * np.pi * t + PHASES) - q[LEGS]) - 3e2 * v[LEGS]


@dataclass(frozen=True)
class Scene:
    """A mechanism, the joints on which a controller acts, its law, and for how long, s."""

    name: str
    joints: tuple[str, ...]
    law: Callable
    periods: tuple[float, ...]
    span: float

    @property
    def mechanism(self):
        """Without forces of its own."""
        return replace(load(self.name), forces=())


SCENES = (
    Scene("crank_rocker", ("crank",), crank, (1e-3, 5e-3, 1e-2), 1.0),
    Scene("stewart_platform", tuple(f"leg{i}_length" for i in range(1, 7)), platform, (1e-3,), 0.1),
)


def stepped(scene, mech, period, **options):
    """The solution of `Simulation.step` in a loop of Python."""
    sim = Simulation(mech, **options)
    for _ in range(round(scene.span / period)):
        sim.step(period, dict(zip(scene.joints, scene.law(*sim.state), strict=True)))
    return sim.solution


def sampled(scene, mech, period, **options):
    """The solution of `simulate` with a `Sampled`."""
    controller = Sampled(period, scene.law, scene.joints)
    solution = simulate(mech, (0.0, scene.span), forces=[controller], **options)
    return lambda: solution


WAYS = {
    "step, Radau": (stepped, {"rtol": 1e-4}),
    "step, Radau, order 5": (stepped, {"rtol": 1e-4, "order": 5}),
    "Sampled, Radau": (sampled, {"method": "Radau", "rtol": 1e-4}),
    "Sampled, Radau, order 5": (sampled, {"method": "Radau", "rtol": 1e-4, "order": 5}),
    "Sampled, BDF": (sampled, {"rtol": 1e-4}),
    "Sampled, Radau, callback": (sampled, {"method": "Radau", "rtol": 1e-4, "callback": lambda *row: None}),
}


@dataclass(frozen=True)
class Sample:
    """What a way takes for a sample, s of process time, its law included, and the largest errors at the end.

    `iterations` are Newton's a sample, `ahead` is how much faster than real time it is.
    """

    scene: str
    period: float
    way: str
    time: float
    ahead: float
    iterations: float
    q: float
    v: float
    lam: float


def measured(scenes=SCENES, repeats=5) -> list[Sample]:
    """Each way at each period, in turn; the least of the times."""
    return [row for scene in scenes for period in scene.periods for row in _measured(scene, period, repeats)]


def _measured(scene, period, repeats):
    mech, found = scene.mechanism, {}
    times = {way: [] for way in WAYS}
    for _ in range(repeats):
        for way, (run, options) in WAYS.items():
            begun = time.process_time()
            solution = run(scene, mech, period, **options)
            times[way].append((time.process_time() - begun) * period / scene.span)
            found[way] = solution()
    end = by_windows(scene, mech, period)
    for way, sol in found.items():
        errors = (float(np.abs(a[-1] - b).max()) for a, b in zip((sol.q, sol.v, sol.lam), end, strict=True))
        stages = (sol.order[sol.order > 0] + 1) // 2 if sol.method["method"] == "Radau" else 1
        iterations = sol.nfev / np.sum(np.broadcast_to(stages, sol.nsteps)) * sol.nsteps * period / scene.span
        least = min(times[way])
        yield Sample(scene.name, period, way, least, period / least, float(iterations), *errors)


def by_windows(scene, mech, period):
    """(q, v, λ) at the end by DOP853, one run a sample."""
    q, v = Simulation(mech).state[1:]
    for k in range(round(scene.span / period)):
        t = k * period
        held = {joint: float(torque) for joint, torque in zip(scene.joints, scene.law(t, q, v), strict=True)}
        end = reference_solution(mech.add_forces(held), t, q, v, [t + period])
        q, v = end.q[-1], end.v[-1]
    return q, v, end.lam[-1]


# fmt: off
def command(csv: report.Csv = None, as_json: output.Json = False) -> int:
    # fmt: on
    """Time a sample of PD controllers at 1 kHz, 200 Hz and 100 Hz, and compare with DOP853, one run a sample.

    Example: python -m benchmarks sampled
    """
    output.require_writable(csv=csv)
    rows = [asdict(row) for row in measured()]
    if report.in_files(csv, as_json, rows, sampled=rows):
        return output.FINE
    columns = [
        ("period [ms]>", report.scaled("period", 1e3, 0)),
        "way",
        ("sample [µs]>", report.scaled("time", 1e6, 1)),
        ("× real time>", "{ahead:.3g}"),
        "iterations>:.2f",
        ("error of q>", "{q:.0e}"),
        ("of v>", "{v:.0e}"),
        ("of λ>", "{lam:.0e}"),
    ]
    for scene in SCENES:
        joints = scene.joints[0] if len(scene.joints) == 1 else f"{len(scene.joints)} legs"
        title = f"{scene.name}, PD control of the {joints}, {scene.span:g} s, rtol 1e-4"
        report.table([row for row in rows if row["scene"] == scene.name], columns, title)
    return output.FINE
