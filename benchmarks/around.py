"""What stands around the steps of a run: rows, interpolants, events, callbacks, certificates, reactions, the start."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import product
from math import sin
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from pinconsist import Event, Torque, export_html, load, simulate
from pinconsist.cli.output import RunProgress

from .report import least_times

SCENE, *START = "crank_rocker", (0.0, 5.0), {"crank": 0.0}, {"crank": 12.0}
CHECKED = {
    "four_bar": 5.0,
    "delta_robot": 5.0,
    "stewart_platform": 5.0,
    "chain_64": 1.0,
    "bricard": 5.0,
    "andrews": 0.03,
}
"""Other scenes whose certificate is timed: s of their runs from rest."""
METHODS = ("BDF", "Radau")
IMPACTS = 182  # in the first second, where the crank loses 0.2 % of its speed at each of 104 places of a turn
PLAIN, CHECK, FORCE = "plain run", "check(error=False)", "Python force of zero"


@dataclass(frozen=True)
class Around:
    """Something that is done with a run: the least of its process times and of its wall times, s, and these over those
    of the plain run.

    What is done beside a Python force is compared with the run that has this force only.
    """

    scene: str
    method: str
    what: str
    seconds: float
    ratio: float
    wall: float
    wall_ratio: float


def around(repeats=25, checked=CHECKED) -> list[Around]:
    """Time, in turn, the crank-rocker for 5 s at the default tolerances with what people ask for besides, and runs and
    certificates of the other scenes.
    """
    rows = [row for method in METHODS for row in _around(repeats, method)]
    for (scene, until), method in product(checked.items(), METHODS):
        plain = _Plain(load(scene), (0.0, until), method=method)
        rows += _rows(scene, method, least_times({PLAIN: plain, CHECK: plain.check}, repeats))
    return rows


class _Plain:
    """A run and the certificate of its solution: each time of a new one, since a second certificate takes less."""

    def __init__(self, *scene, method):
        self.make = partial(simulate, *scene, method=method)

    def __call__(self):
        self.sol = self.make()

    def check(self):
        self.sol.check(error=False)


def _around(repeats, method):
    mech, (span, q0, v0) = load(SCENE), START
    rest = load("four_bar")
    loop, plain = mech.loops[0].name, _Plain(mech, *START, method=method)
    still = np.zeros(mech.nv)
    force = {"forces": [Torque(lambda t, q, v: still)]}
    impact = Event(lambda t, q, v, lam: sin(52.0 * q[0]), apply=lambda t, q, v: 0.998 * v)
    empty, never = {"callback": lambda t, q, v, lam: None}, {"events": lambda t, q, v, lam: 1.0}

    def run(**options):
        return lambda: simulate(mech, span, q0, v0, method=method, **options)

    with TemporaryDirectory() as folder:
        work = {
            PLAIN: plain,
            "start alone, to 1 µs": lambda: simulate(mech, (0.0, 1e-6), q0, v0, method=method),
            "start of four_bar, from rest": lambda: simulate(rest, (0.0, 1e-6), method=method),
            "on a terminal": run(callback=RunProgress(*span)),
            "empty callback": run(**empty),
            "event that never fires": run(**never),
            "event of a multiplier": run(events=lambda t, q, v, lam: lam[0] - 1e9),
            f"1 s with {IMPACTS} impacts": lambda: _with_impacts(
                simulate(mech, (0.0, 1.0), q0, v0, method=method, events=impact)
            ),
            "t_eval of 1": run(t_eval=[span[1]]),
            "t_eval of 1000": run(t_eval=np.linspace(*span, 1000)),
            "dense_output": run(dense_output=True),
            FORCE: run(**force),
            f"{FORCE}, empty callback": run(**force, **empty),
            f"{FORCE}, event that never fires": run(**force, **never),
            CHECK: plain.check,
            "reaction of a loop": lambda: plain.sol.reaction(loop),
            "energy()": lambda: plain.sol.energy(),
            "page": lambda: export_html(mech, plain.sol, Path(folder) / "page.html"),
        }
        least = least_times(work, repeats)
    return _rows(SCENE, method, least)


def _rows(scene, method, least):
    rows = []
    for what, (seconds, wall) in least.items():
        over = least[FORCE if what.startswith(f"{FORCE}, ") else PLAIN]
        rows.append(Around(scene, method, what, seconds, seconds / over.process, wall, wall / over.wall))
    return rows


def _with_impacts(sol):
    """Refuse the time of a run that has missed one."""
    if len(sol.t_events[0]) != IMPACTS:
        raise RuntimeError(f"{len(sol.t_events[0])} of {IMPACTS} impacts were found")
