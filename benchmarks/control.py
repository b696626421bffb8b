"""What the calls of a controller's model cost: ``python -m benchmarks control``."""

from __future__ import annotations

import time
import warnings
from dataclasses import asdict, dataclass
from typing import Annotated

import numpy as np

import pinconsist as pc
from pinconsist.cli import output
from pinconsist.cli.scene import option

from . import report

SCENES = ("four_bar", "five_bar", "delta_robot", "stewart_platform")
SAMPLE = 1e-3  # s
NODES, NODE = 20, 1e-2  # of a horizon, s
CALLS, REPEATS = 50, 9


@dataclass(frozen=True)
class Prices:
    """Process time of a call, s, the least of several."""

    scene: str
    velocities: int
    build: float  # Simulation(mech, q, v)
    step: float  # of 1 ms with another torque than before
    linearized: float  # of that step, in all coordinates
    reduced: float  # in those of the motors alone
    reset: float  # to a state on the constraints
    assembled: float  # to a state that is not
    parameters: float  # another mass
    copy: float
    forward: float  # forward dynamics, each of many states
    horizon: float  # 20 steps of 10 ms from a state, and their reduced linearisations


def priced(scene, calls=CALLS, repeats=REPEATS) -> Prices:
    """The prices on one scene, from a state in motion."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        mech = pc.load(scene)
    sim = pc.Simulation(mech)
    (_, q, v), count = sim.step(0.05), [0]
    open_q = {mech.joints[0]: mech.q()[0]}
    joint = next(name for name, inertia in zip(mech.joints, list(mech.model.inertias)[1:], strict=True) if inertia.mass)
    torques, many = np.zeros(mech.nv), (np.tile(q, (calls, 1)), np.tile(v, (calls, 1)))
    column = mech.columns((mech.actuated or mech.joints)[0])

    def step():
        count[0] += 1
        torques[column] = 1e-3 * (count[0] % 2)
        sim.step(SAMPLE, control=torques.copy())

    def several(work):
        return lambda: [work() for _ in range(calls)]

    step()
    work = {
        "build": several(lambda: pc.Simulation(mech, q, v)), "step": several(step),
        "linearized": several(lambda: sim.linearized().A), "reduced": several(lambda: sim.linearized().A_reduced),
        "copy": several(sim.copy), "forward": lambda: pc.forward_dynamics(mech, *many),
    }  # fmt: skip
    least = {name: each.process / calls for name, each in report.least_times(work, repeats).items()}
    other = pc.Simulation(mech)

    def horizon():
        other.reset(q, v)
        for k in range(NODES):
            torques[column] = 1e-3 * (k % 2)
            other.step(NODE, control=torques.copy())
            assert other.linearized().A_reduced is not None

    work = {
        "reset": several(lambda: other.reset(q, v)), "assembled": several(lambda: other.reset(open_q)),
        "horizon": several(horizon),
        "parameters": several(lambda: other.set_parameters({f"mass:{joint}": 0.5 + 1e-6 * time.perf_counter() % 1e-3})),
    }  # fmt: skip
    least |= {name: each.process / calls for name, each in report.least_times(work, repeats).items()}
    return Prices(scene, mech.nv, **least)


# fmt: off
def command(
    scenes: Annotated[list[str] | None, option("--scene", "SCENE", "A scene or file; may be repeated.")] = None,
    csv: report.Csv = None,
    as_json: output.Json = False,
) -> int:
    # fmt: on
    """Time the calls of a Simulation that controllers make: steps, linearisations, resets, changes, copies.

    Example: python -m benchmarks control
    """
    rows = [asdict(priced(scene)) for scene in scenes or SCENES]
    if report.in_files(csv, as_json, rows, prices=rows):
        return output.FINE
    names = ("build", "step", "linearized", "reduced", "reset", "assembled", "parameters", "copy", "forward", "horizon")
    columns = ["scene", "velocities>", *((f"{name} [µs]>", report.scaled(name, 1e6, 0)) for name in names)]
    report.table(rows, columns, f"one call; a step is {1e3 * SAMPLE:g} ms, from a state in motion")
    return output.FINE
