"""What stands around the steps of a run: rows, interpolants, events, callbacks, certificates, reactions, the start."""

from __future__ import annotations

from dataclasses import dataclass
from math import sin
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from pinconsist import Event, Torque, export_html, load, simulate
from pinconsist.cli.terminal import RunProgress

from .report import least_times

START = (0.0, 5.0), {"crank": 0.0}, {"crank": 12.0}  # of the crank-rocker


METHODS = ("BDF", "Radau")
IMPACTS = 182  # in the first second, where the crank loses 0.2 % of its speed at each of 104 places of a turn
FORCE = "Python force of zero"


@dataclass(frozen=True)
class Around:
    """Something that is done with a run: the least of its process times, s, and this over that of the plain run.

    What is done beside a Python force is compared with the run that has this force only.
    """

    method: str
    what: str
    seconds: float
    ratio: float


def around(repeats=25) -> list[Around]:
    """Time, in turn, the crank-rocker for 5 s at the default tolerances with what people ask for besides."""
    return [row for method in METHODS for row in _around(repeats, method)]


def _around(repeats, method):
    mech, (span, q0, v0) = load("crank_rocker"), START
    rest = load("four_bar")
    loop, sol = mech.loops[0].name, simulate(mech, *START, method=method)
    still = np.zeros(mech.nv)
    force = {"forces": [Torque(lambda t, q, v: still)]}
    impact = Event(lambda t, q, v, lam: sin(52.0 * q[0]), apply=lambda t, q, v: 0.998 * v)
    empty, never = {"callback": lambda t, q, v, lam: None}, {"events": lambda t, q, v, lam: 1.0}

    def run(**options):
        return lambda: simulate(mech, span, q0, v0, method=method, **options)

    with TemporaryDirectory() as folder:
        work = {
            "plain run": run(),
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
            "check(error=False)": lambda: sol.check(error=False),
            "reaction of a loop": lambda: sol.reaction(loop),
            "energy()": sol.energy,
            "page": lambda: export_html(mech, sol, Path(folder) / "page.html"),
        }
        least = least_times(work, repeats)
    over = {what: FORCE if what.startswith(f"{FORCE}, ") else "plain run" for what in work}
    return [Around(method, what, seconds, seconds / least[over[what]]) for what, seconds in least.items()]


def _with_impacts(sol):
    """Refuse the time of a run that has missed one."""
    if len(sol.t_events[0]) != IMPACTS:
        raise RuntimeError(f"{len(sol.t_events[0])} of {IMPACTS} impacts were found")
