"""Steps of 1 ms, of one run and of many, with their errors, and MuJoCo's: ``python -m benchmarks stepped``."""

from __future__ import annotations

import time
import warnings
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import numpy as np
import typer

import pinconsist as pc
from pinconsist.cli import output

from . import report

SCENES = ("four_bar", "crank_rocker", "delta_robot", "stewart_platform")
SAMPLE, STEPS, ROUNDS, RUNS = 1e-3, 50, 6, 64  # s; steps of a round; rounds in turn; runs at once
TOLERANCES = (1e-6, 1e-3, 1e-1)
EXACT = 1e-10


@dataclass(frozen=True)
class Way:
    """A way to make a step: its process time and wall time for a run, s, the medians of the rounds, and its errors.

    `q` is the largest error of positions after all rounds, against a run of rtol 1e-10; `gap` is that of the loops.
    """

    scene: str
    way: str
    time: float
    wall: float
    q: float
    gap: float


def measured(scenes=None) -> list[Way]:
    """Steps from rest under the weight alone, without other forces, as MuJoCo has not all of them."""
    return [row for scene in scenes or SCENES for row in _of_scene(scene)]


def _of_scene(scene) -> list[Way]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        mech = pc.load(scene).with_forces()
    sims = {f"rtol {tol:g}": pc.Simulation(mech, rtol=tol, atol=tol) for tol in TOLERANCES}
    many = {f"{RUNS} at once, {_threads(n)}": pc.Simulations(mech, RUNS, threads=n) for n in (1, 2)}
    ways = {name: (_repeated(sim.step), 1) for name, sim in sims.items()}
    ways |= {name: (_repeated(each.step), RUNS) for name, each in many.items()}
    peer = _mujoco(mech)
    if peer is not None:
        ways |= peer.ways
    times = {name: [] for name in ways}
    for _ in range(ROUNDS):
        for name, (steps, runs) in ways.items():
            begun = time.process_time(), time.perf_counter()
            steps()
            ended = time.process_time(), time.perf_counter()
            times[name].append([(b - a) / (STEPS * runs) for a, b in zip(begun, ended, strict=True)])
    exact = pc.Simulation(mech, rtol=EXACT, atol=EXACT)
    for _ in range(ROUNDS * STEPS):
        exact.step(SAMPLE)
    system = exact.solution().system
    rows = []
    for name in ways:
        process, wall = np.median(times[name], axis=0).tolist()
        error, gap = np.nan, np.nan
        if name.startswith("MuJoCo"):
            gap = peer.gap()
        else:
            q = sims[name].state.q if name in sims else many[name].state.q[-1]
            error = float(np.abs(q - exact.state.q).max())
            gap = float(np.abs(system.loop_rows(q)[0]).max(initial=0.0))
        rows.append(Way(scene, name, process, wall, error, gap))
    return rows


def _threads(n) -> str:
    return f"{n} thread{'s' * (n > 1)}"


def _repeated(step):
    """A function that makes the steps of a round one by one."""

    def steps():
        for _ in range(STEPS):
            step(SAMPLE)

    return steps


def _mujoco(mech):
    """MuJoCo with this mechanism; None if it is not installed, or cannot have it."""
    try:
        import mujoco
    except ImportError:
        return None
    with TemporaryDirectory() as folder:
        file = Path(folder) / "scene.xml"
        try:
            pc.write(mech, file)
            model = mujoco.MjModel.from_xml_path(str(file))
        except (pc.PinconsistError, ValueError):
            return None
    return MuJoCo(mujoco, model)


class MuJoCo:
    """The rounds of MuJoCo: one run step by step, and many at once by its `rollout`, a whole round in one call."""

    def __init__(self, mujoco, model):
        from mujoco import rollout

        model.opt.timestep = SAMPLE
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        self._data = mujoco.MjData(model)
        if model.nkey:
            mujoco.mj_resetDataKeyframe(model, self._data, 0)
        self.ways = {"MuJoCo implicitfast": (_repeated(lambda dt: mujoco.mj_step(model, self._data)), 1)}
        start = np.empty(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
        mujoco.mj_getState(model, self._data, start, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        states = {n: np.tile(start, (RUNS, 1)) for n in (1, 2)}
        for n in states:
            own = [mujoco.MjData(model) for _ in range(n)]
            pool = rollout.Rollout(nthread=n if n > 1 else 0)  # 0: the calling thread

            def steps(n=n, own=own, pool=pool):
                found, _ = pool.rollout(model, own, states[n], nstep=STEPS)
                states[n] = np.ascontiguousarray(found[:, -1])

            self.ways[f"MuJoCo rollout, {RUNS} at once, {_threads(n)}"] = steps, RUNS

    def gap(self) -> float:
        """How far the loops are open, m."""
        return float(np.abs(self._data.efc_pos[: self._data.ne]).max(initial=0.0))


def command(
    scene: Annotated[
        list[str] | None, typer.Argument(metavar="[NAME|PATH ...]", help="Default: four built-in scenes.")
    ] = None,
    csv: report.Csv = None,
    as_json: output.Json = False,
) -> int:
    """Time steps of 1 ms, as of a controller, by tolerance, and of 64 runs at once; MuJoCo's where it is installed.

    Example: python -m benchmarks stepped delta_robot
    """
    output.require_writable(csv=csv)
    rows = [asdict(row) for row in measured(scene)]
    if report.in_files(csv, as_json, rows, stepped=rows):
        return output.FINE
    for name in dict.fromkeys(row["scene"] for row in rows):
        times = ("process [µs]>", report.scaled("time", 1e6)), ("wall [µs]>", report.scaled("wall", 1e6))
        columns = ["way", *times, ("error of q>", "{q:.0e}"), ("gap>", "{gap:.0e}")]
        title = f"{Path(name).name}: a step of 1 ms of a run, from rest, {ROUNDS * STEPS} steps"
        report.table([row for row in rows if row["scene"] == name], columns, title)
    return output.FINE
