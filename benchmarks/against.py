"""This pinconsist against another one, run in turn: ``python -m benchmarks overhead --against PYTHON``."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pinconsist import InputError

SCENES = {"crank_rocker": 5.0, "andrews": 0.03, "delta_robot": 1.0, "chain_64": 1.0}
"""The scenes and how long they run, s."""
ELSEWHERE = 1.0  # s, of any other scene
WORKER = """
import json, sys, time
import pinconsist as pc
for line in sys.stdin:
    scene, until, tol, least = json.loads(line)
    mech, count, elapsed = pc.load(scene), 0, 0.0
    v0 = {"crank": 12.0} if scene == "crank_rocker" else None
    pc.simulate(mech, (0.0, until), None, v0, rtol=tol, atol=tol)
    start = time.process_time()
    while elapsed < least:
        sol = pc.simulate(mech, (0.0, until), None, v0, rtol=tol, atol=tol)
        count, elapsed = count + 1, time.process_time() - start
    print(json.dumps([elapsed / count, sol.nsteps]), flush=True)
"""
"""What both do, by public names only: CPU time of a compiled run, and its steps."""


@dataclass(frozen=True)
class Versus:
    """A compiled run of a scene on both: medians of CPU times, s, assembly and start included."""

    scene: str
    steps: int
    other_steps: int
    time: float
    other_time: float
    ratio: float  # of the times here to those of the other, median of the rounds


def against(python, scenes=None, *, tol=1e-7, repeats=9, least=0.3) -> list[Versus]:
    """Compare with the pinconsist that another Python imports; each of them runs for `least` s in each round."""
    rows, root = [], Path(__file__).parents[1]
    python = os.path.abspath(shutil.which(python) or python)  # not resolved: a link tells Python its environment
    with ExitStack() as stack:
        workers = [stack.enter_context(_worker(*where)) for where in ((sys.executable, root), (python, root.anchor))]
        for scene in scenes or SCENES:
            request = json.dumps([scene, SCENES.get(scene, ELSEWHERE), tol, least]) + "\n"
            rounds = np.array([[_asked(worker, request) for worker in workers] for _ in range(repeats)])
            (time, other), steps = np.median(rounds[:, :, 0], axis=0), rounds[-1, :, 1].astype(int)
            ratio = float(np.median(rounds[:, 0, 0] / rounds[:, 1, 0]))
            rows.append(Versus(scene, *map(int, steps), float(time), float(other), ratio))
    return rows


def _worker(python, folder):
    try:
        return subprocess.Popen(
            [python, "-c", WORKER], cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
    except OSError as error:
        raise InputError(f"{python} cannot be run: {error.strerror}") from error


def _asked(worker, request):
    try:
        worker.stdin.write(request)
        worker.stdin.flush()
        return json.loads(worker.stdout.readline())
    except (BrokenPipeError, json.JSONDecodeError):
        raise InputError(f"{worker.args[0]} ended before it was done; its message is above") from None
