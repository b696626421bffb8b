"""How wrong loop forces are in robotics simulators: ``python -m benchmarks referee``."""

from __future__ import annotations

import warnings
from dataclasses import asdict, dataclass
from typing import Annotated

import numpy as np
import pinocchio as pin

import pinconsist as pc
from pinconsist.cli import output
from pinconsist.cli.scene import option

from . import report
from .example import example

FIVE_BAR = {
    "left_crank": pc.Motion(start=-2.2, amplitude=0.4, frequency=1.5),
    "right_crank": pc.Motion(start=-0.9415926535897931, amplitude=0.4, frequency=1.0),
}
SCENES = {
    "four_bar": {"until": 5.0},
    "crank_rocker": {"until": 2.0, "v0": {"crank": 12.0}},
    "slider_crank": {"until": 5.0},
    "five_bar": {"until": 2.0, "motion": FIVE_BAR},
    "jansen_leg": {"until": 5.0},
    "andrews": {"until": 0.03},
    "delta_robot": {"until": 2.0},
    "stewart_platform": {"until": 2.0},
    "gripper": {"until": 0.3},
    "ankle": {"until": 0.3},
}
"""Scene → how long it runs, s, its initial velocities, and a motion that joints follow."""
HORN, BACK, WIDE, HEIGHT, ROD = 0.04, 0.05, 0.03, 0.25, 0.25  # m, of the ankle: its rods are vertical where it is level
DEFAULT = {"MuJoCo": "default loops", "Pinocchio": "without correction", "pinconsist": "1e-06"}


@dataclass(frozen=True)
class Case:
    """One simulator on one scene: its defaults, and the cheapest setting with forces right to 1 %.

    Errors are relative, times in s of processor time per second of motion.
    """

    scene: str
    tool: str
    default: str
    force: float  # of the defaults
    force_here: float
    gap: float  # m
    default_time: float
    right: str  # the cheapest setting
    right_force: float
    right_time: float


def scene_of(name):
    """The mechanism of a scene; a folder or a file is one, too."""
    if name == "ankle":
        return ankle()
    if name == "gripper":
        return gripper()
    return pc.load(name)


def gripper():
    """That of the examples: two parallelograms, coupled by gears."""
    mech, _ = example("11_gripper").run()
    return mech.with_loops(*(loop for loop in mech.loops if loop.name != "ball"))


def ankle():
    """A foot on two hinges, moved by two motors through rods of fixed length behind it."""
    model = pin.Model()

    def add(parent, joint, place, name, mass, centre, size):
        index = model.addJoint(parent, joint, pin.SE3(np.eye(3), np.array(place, float)), name)
        inertia = pin.Inertia(mass, np.array(centre, float), size * np.eye(3))
        model.appendBodyToJoint(index, inertia, pin.SE3.Identity())
        return index

    def point(joint, name, place):
        place = pin.SE3(np.eye(3), np.array(place, float))
        model.addFrame(pin.Frame(name, joint, 0, place, pin.FrameType.OP_FRAME))

    pitch = add(0, pin.JointModelRY(), (0, 0, 0), "pitch", 0.05, (0, 0, 0), 1e-5)
    roll = add(pitch, pin.JointModelRX(), (0, 0, 0), "roll", 0.8, (0.04, 0, -0.03), 2e-3)
    loops = []
    for name, y in (("left", WIDE), ("right", -WIDE)):
        motor = add(0, pin.JointModelRY(), (HORN - BACK, y, HEIGHT), name, 0.05, (-HORN / 2, 0, 0), 1e-5)
        model.armature[model.idx_vs[motor]] = 0.01
        point(motor, f"{name}_horn", (-HORN, 0, 0))
        point(roll, f"{name}_heel", (-BACK, y, 0))
        loops.append(pc.Loop(f"{name}_rod", "distance", f"{name}_horn", f"{name}_heel", length=ROD))
    return pc.Mechanism(model, loops, [{"left": 0.5, "right": -0.3}], name="ankle", actuated=("left", "right"))


def judged(scenes, budget):
    """Yield (judgement, its cases) for each of the scenes, name → its entry of `SCENES`."""
    for name, about in scenes.items():
        options = {key: value for key, value in about.items() if key != "until"}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            judgement = pc.referee(scene_of(name), (0.0, about["until"]), budget=budget, **options)
        yield judgement, [_case(judgement, tool) for tool in judgement.cheapest]


def _case(judgement, tool) -> Case:
    rows = judgement.of(tool)
    default = next((row for row in rows if DEFAULT[tool] in row.setting), rows[-1])
    best = judgement.cheapest[tool]
    right = (best.setting, best.force, best.time) if best else ("none tried", np.nan, np.nan)
    name = judgement.mechanism.name
    return Case(name, tool, default.setting, default.force, default.force_here, default.gap, default.time, *right)


# fmt: off
def command(
    robot: Annotated[list[str] | None, option(
        "--robot", "FOLDER", "Also judge the robot in this folder, for 0.1 s from rest; may be repeated.")] = None,
    budget: Annotated[float, option("--budget", "SECONDS", "Time that one run may take.")] = 10.0,
    csv: report.Csv = None,
    as_json: output.Json = False,
) -> int:
    # fmt: on
    """Judge simulators on ten mechanisms: their defaults, and the cheapest setting with forces right to 1 %.

    Example: python -m benchmarks referee --csv referee.csv
    """
    scenes = SCENES | {each: {"until": 0.1} for each in robot or ()}
    cases, refused = [], {}
    for judgement, found in judged(scenes, budget):
        cases += [asdict(case) for case in found]
        refused |= {f"{judgement.mechanism.name}, {tool}": why for tool, why in judgement.not_judged.items()}
    if report.in_files(csv, as_json, cases, cases=cases, refused=refused):
        return output.FINE
    columns = [
        "scene", "tool", "default", ("forces [%]>", report.scaled("force", 100, 2)),
        ("here [%]>", report.scaled("force_here", 100, 2)), ("gap [mm]>", report.scaled("gap", 1e3, 3)),
        ("[ms/s]>", report.scaled("default_time", 1e3)), "right", ("to [%]>", report.scaled("right_force", 100, 3)),
        ("for [ms/s]>", report.scaled("right_time", 1e3)),
    ]  # fmt: skip
    report.table(cases, columns, "loop forces with the defaults, and the cheapest setting with forces right to 1 %")
    for what, why in refused.items():
        print(f"{what}: {why}")
    return output.FINE
