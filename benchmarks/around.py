"""What stands around the steps of a run: rows, interpolants, events, callbacks, certificates, reactions, the start."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from pinconsist import Torque, load, simulate
from pinconsist.cli.terminal import RunProgress

START = (0.0, 5.0), {"crank": 0.0}, {"crank": 12.0}  # of the crank-rocker


@dataclass(frozen=True)
class Around:
    """Something that is done with a run: the least of its process times, s, and this over that of the plain run."""

    what: str
    seconds: float
    ratio: float


def around(repeats=9) -> list[Around]:
    """Time, in turn, the crank-rocker for 5 s at the default tolerances with what people ask for besides."""
    mech, (span, q0, v0) = load("crank_rocker"), START
    loop, sol = mech.loops[0].name, simulate(mech, *START)
    still = np.zeros(mech.nv)

    def run(**options):
        return lambda: simulate(mech, span, q0, v0, **options)

    work = {
        "plain run": run(),
        "start alone, to 1 µs": lambda: simulate(mech, (0.0, 1e-6), q0, v0, first_step=1e-6),
        "on a terminal": run(callback=RunProgress(*span)),
        "empty callback": run(callback=lambda t, q, v, lam: None),
        "event that never fires": run(events=lambda t, q, v, lam: 1.0),
        "t_eval of 1": run(t_eval=[span[1]]),
        "t_eval of 1000": run(t_eval=np.linspace(*span, 1000)),
        "dense_output": run(dense_output=True),
        "Python force of zero": run(forces=[Torque(lambda t, q, v: still)]),
        "check()": sol.check,
        "reaction of a loop": lambda: sol.reaction(loop),
        "energy()": sol.energy,
    }
    least = dict.fromkeys(work, np.inf)
    for _ in range(repeats):
        for what, do in work.items():
            begun = time.process_time()
            do()
            least[what] = min(least[what], time.process_time() - begun)
    return [Around(what, seconds, seconds / least["plain run"]) for what, seconds in least.items()]
