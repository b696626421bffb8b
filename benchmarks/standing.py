"""Steps of 1 ms of mechanisms that touch, in contact and in the air: ``python -m benchmarks standing``."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass

import numpy as np
import pinocchio as pin

import pinconsist as pc
from pinconsist.cli import output

from . import report
from .example import example
from .linkages import GRAVITY, add_body, add_frame, at
from .referee import gripper

SAMPLE, STEPS, ROUNDS = 1e-3, 40, 5  # s; steps of a round; rounds
LIFTED = 0.5  # m, of a body in the air, further than it falls in these steps
TABLE = [(x, y) for x in (0.3, -0.3) for y in (0.25, -0.25)]


@dataclass(frozen=True)
class Stance:
    """A step in contact, in the air, and of the mechanism without contacts, there: the least process times, s."""

    scene: str
    modes: str
    contact: float
    air: float
    free: float


def _planar(*points, friction=0.8, push=0.0):
    """A body of 1 kg that moves along x and z and turns, with contacts at `points`, pushed along x."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -GRAVITY])
    x = add_body(model, 0, pin.JointModelPX(), at(0, 0), "x", 0.0, (0, 0, 0), 0.0)
    z = add_body(model, x, pin.JointModelPZ(), at(0, 0), "z", 0.0, (0, 0, 0), 0.0)
    turn = add_body(model, z, pin.JointModelRY(), at(0, 0), "turn", 1.0, (0, 0, 0), 0.02)
    for i, point in enumerate(points):
        add_frame(model, turn, f"foot{i}", point)
    contacts = [pc.Contact(f"foot{i}", f"foot{i}", friction=friction) for i in range(len(points))]
    forces = [{"x": push}] if push else []
    return pc.Mechanism(model, forces=forces, contacts=contacts, guess={"z": 0.1})


def _block(friction=0.8, push=0.0):
    """A mass of 1 kg that moves along x and z on one contact."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -GRAVITY])
    x = add_body(model, 0, pin.JointModelPX(), at(0, 0), "x", 0.0, (0, 0, 0), 0.0)
    add_body(model, x, pin.JointModelPZ(), at(0, 0), "z", 1.0, (0, 0, 0), 0.1)
    contact = pc.Contact("point", "z", friction=friction)
    return pc.Mechanism(model, forces=[{"x": push}] if push else [], contacts=[contact])


def _table():
    """A free body of 2 kg on four legs."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -GRAVITY])
    add_body(model, 0, pin.JointModelFreeFlyer(), at(0, 0), "table", 2.0, (0, 0, 0), np.diag([0.1, 0.1, 0.2]))
    for i, (x, y) in enumerate(TABLE):
        add_frame(model, 1, f"leg{i}", (x, y, -0.5))
    contacts = [pc.Contact(f"leg{i}", f"leg{i}", friction=0.5) for i in range(len(TABLE))]
    return pc.Mechanism(model, contacts=contacts, guess={"table": [0, 0, 0.5, 0, 0, 0]})


def _gripper():
    """That of the examples, with a stop at which its motor presses, closed there and open."""
    mech = gripper()
    joint = mech.joints[0]
    closed, opened = (pc.assemble(mech, {joint: angle}).q for angle in (-0.1, -1.2))
    stop = float(closed[mech.columns(joint).start])
    return mech.with_contacts(pc.Stop(joint, lower=stop - 1.3, upper=stop)), closed, opened


def scenes():
    """(name, mechanism, state in contact, the same in the air)."""
    both = (-0.2, 0.0, -0.1), (0.2, 0.0, -0.1)
    for name, mech in {
        "block on a point": _block(),
        "block that slides": _block(0.1, 3.0),
        "box on two feet": _planar(*both),
        "box on two feet, pushed": _planar(*both, push=4.5),
        "table on four legs": _table(),
    }.items():
        q = mech.guess.copy()
        joint = "table" if "table" in mech.joints else "z"
        lifted = q.copy()
        lifted[mech.columns(joint).start + (2 if joint == "table" else 0)] += LIFTED
        yield name, mech, (q, None), (lifted, None)
    leg = example("31_standing_leg").scene()
    stands = pc.simulate(leg, (0.0, 0.9))
    lifted = stands.q[-1].copy()
    lifted[leg.columns("z").start] += LIFTED
    yield "leg of two chains", leg, (stands.q[-1], stands.v[-1]), (lifted, None)
    mech, closed, opened = _gripper()
    yield "gripper at a stop", mech, (closed, None), (opened, None)


def measured(only=None) -> list[Stance]:
    """Each scene, or those whose names contain `only`."""
    return [_of_scene(*scene) for scene in scenes() if only is None or only in scene[0]]


def _of_scene(name, mech, stands, flies) -> Stance:
    runs = [pc.Simulation(mech, *stands), pc.Simulation(mech, *flies), pc.Simulation(mech.with_contacts(), *flies)]
    least = [np.inf] * 3
    for _ in range(ROUNDS):
        for i, run in enumerate(runs):
            begun = time.process_time()
            for _ in range(STEPS):
                run.step(SAMPLE)
            least[i] = min(least[i], (time.process_time() - begun) / STEPS)
    modes = ", ".join(dict.fromkeys(each.mode for each in runs[0].solution().modes))
    if any(each.mode != "open" for each in runs[1].solution().modes):
        raise RuntimeError(f"{name} touches in the air")
    return Stance(name, modes, *least)


def command(csv: report.Csv = None, as_json: output.Json = False) -> int:
    """Time steps of 1 ms in contact, in the air, and without contacts.

    Example: python -m benchmarks standing
    """
    output.require_writable(csv=csv)
    rows = [asdict(row) | {"ratio": row.contact / row.air} for row in measured()]
    if report.in_files(csv, as_json, rows, standing=rows):
        return output.FINE
    times = [(f"{title} [µs]>", report.scaled(of, 1e6)) for title, of in _TITLES.items()]
    columns = ["scene", "modes", *times, ("contact / air>", "{ratio:.2f}")]
    report.table(rows, columns, f"a step of 1 ms, the least of {ROUNDS} rounds of {STEPS}")
    return output.FINE


_TITLES = {"in contact": "contact", "in the air": "air", "without contacts": "free"}
