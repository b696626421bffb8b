"""What calls of an Actuation cost; whether random walks keep their branch: ``python -m benchmarks actuation``."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
import time
import warnings
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from pinconsist import Actuation, Loop, PinconsistError, load
from pinconsist.cli import output
from pinconsist.cli.scene import option

from . import mjcf_actuators, report

SCENES = ("double_pendulum", "four_bar", "andrews", "delta_robot", "stewart_platform")
STEP = 1e-3  # rad or m: what a motor moves in 1 ms at 1 rad/s
CALLS, CALLS_IN_C, REPEATS = 100, 300, 15
CRANK, DISTAL, APART = 0.25, 0.3, 0.2  # m, of the five-bar that walks
STRIDE = 0.4  # rad, standard deviation of a step of the walk
ROTOR = 0.02  # kg·m², of each motor where the ankle is compared
MAIN = """
#include <stdio.h>
#include <time.h>
static double q[] = {%(q)s}, goals[2][MOTORS] = {{%(goals)s}, {%(start)s}};
static double v[MOTORS], A[NV * MOTORS], M[MOTORS * MOTORS], h[MOTORS];
static int call(int which, int i) {
  if (which == 0) return leg_closure(goals[i %% 2], q);
  return which == 1 ? leg_jacobian(q, A) : leg_dynamics(q, v, M, h);
}
int main(void) {
  int which, repeat, i;
  for (which = 0; which < 3; ++which) {
    double least = 1e9;
    for (repeat = 0; repeat < %(repeats)d; ++repeat) {
      const clock_t begun = clock();
      for (i = 0; i < %(calls)d; ++i)
        if (call(which, i)) return 1;
      const double taken = (double)(clock() - begun) / CLOCKS_PER_SEC / %(calls)d;
      if (taken < least) least = taken;
    }
    printf("%%.4g\\n", least);
  }
  return 0;
}
"""


@dataclass(frozen=True)
class Costs:
    """Process time of a call, s, the least of several."""

    scene: str
    velocities: int
    motors: int
    closure: float
    jacobian: float
    reduced: float  # mass matrix
    forward: float
    c_closure: float  # of the C code
    c_jacobian: float
    c_reduced: float  # mass matrix and bias


def measured(scenes=SCENES, calls=CALLS, repeats=REPEATS) -> list[Costs]:
    """The costs on scenes or files."""
    rows = []
    for scene in scenes:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            act = Actuation(mech := load(scene), mech.actuated or mech.joints)
        m, q = len(act.motors), act.q
        goals, zero, count = [act.positions() + STEP, act.positions()], np.zeros(m), [0]

        def closure(act=act, goals=goals, count=count):
            count[0] ^= 1
            act.closure(goals[count[0]])

        ways = (
            closure,
            lambda act=act, q=q: act.jacobian(q),
            lambda act=act, q=q: act.mass_matrix(q),
            lambda act=act, q=q, zero=zero: act.forward(q, zero, zero),
        )
        times = [min(_timed(way, calls) for _ in range(repeats)) for way in ways]
        in_c = measured_in_c(act, repeats)
        rows.append(Costs(Path(scene).name, act.mechanism.nv, m, *times, *in_c))
    return rows


def measured_in_c(act: Actuation, repeats: int) -> list[float]:
    """Times of closure, Jacobian and dynamics, s; NaN where there is no compiler, or no C of it."""
    if (compiler := shutil.which("cc")) is None:
        return [float("nan")] * 3
    start = act.positions()
    numbers = {"q": act.q, "start": start, "goals": start + STEP}
    texts = {key: ", ".join(map(repr, value.tolist())) for key, value in numbers.items()}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "leg.c"
        try:
            act.to_c(path)
        except PinconsistError:
            return [float("nan")] * 3
        with open(path, "a", encoding="utf-8") as stream:
            stream.write(MAIN % (texts | {"repeats": repeats, "calls": CALLS_IN_C}))
        subprocess.run([compiler, "-std=c99", "-O2", "-o", folder + "/leg", path, "-lm"], check=True)
        done = subprocess.run([folder + "/leg"], check=True, capture_output=True, text=True)
    return [float(line) for line in done.stdout.split()]


def _timed(call, calls) -> float:
    begun = time.process_time()
    for _ in range(calls):
        call()
    return (time.process_time() - begun) / calls


def walk(steps: int, seed: int = 0) -> dict:
    """A random walk of a five-bar's motors: how often a singularity blocks it, how often its tip changes sides."""
    mech, at = load("five_bar"), (DISTAL, 0.0, 0.0)
    tip = Loop("tip", "hinge", "left_distal_bar", "right_distal_bar", xyz1=at, xyz2=at, axis=(0, 1, 0))
    act, rng, blocked, jumps = Actuation(mech.with_loops(tip)), np.random.default_rng(seed), 0, 0
    before, begun = _side(act.q), time.process_time()
    for _ in range(steps):
        q, ok = act.closure(act.positions() + rng.normal(0.0, STRIDE, 2))
        blocked, after = blocked + (not ok), _side(q)
        jumps, before = jumps + (after != before), after
    return {"steps": steps, "blocked": blocked, "jumps": jumps, "time": (time.process_time() - begun) / max(steps, 1)}


def _side(q) -> bool:
    """Whether the tip is on the left of the line from elbow to elbow."""
    ends = [np.array([x + CRANK * np.cos(a), -CRANK * np.sin(a)]) for x, a in ((-APART / 2, q[0]), (APART / 2, q[2]))]
    along, arm = ends[1] - ends[0], np.array([np.cos(q[0] + q[1]), -np.sin(q[0] + q[1])])
    return bool(along[0] * arm[1] - along[1] * arm[0] > 0.0)


@dataclass(frozen=True)
class Felt:
    """Inertia that an ankle's motors feel, kg·m², at positions of both of them, rad."""

    position: float
    serial: float  # foot alone, through the linkage
    rods: float  # with all bodies
    whole: float  # with the rotors, too


def reflected(robot, motors, feet, positions=(-0.1, 0.0, 0.1)) -> list[Felt]:
    """The largest inertia that `motors` feel, against that of the bodies from the joints `feet` on alone."""
    mech = load(robot)
    light = mech.model.copy()
    below = {i for joint in feet for i in mech.model.subtrees[mech.model.getJointId(joint)]}
    for i in range(1, light.njoints):
        if i not in below:
            light.inertias[i].setZero()
    rotors = mech.with_armature(dict.fromkeys(motors, ROTOR))
    rows = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        act = Actuation(mech)
        others = [
            Actuation(type(mech)(light, mech.loops, guess=act.q, actuated=mech.actuated)),
            Actuation(rotors, q0=act.q),
        ]
    at, start = [act.motors.index(motor) for motor in motors], act.positions()[[act.motors.index(m) for m in motors]]
    for position in positions:
        q, ok = act.closure(dict(zip(motors, start + position, strict=True)))
        if ok:
            felt = [np.linalg.eigvalsh(each.mass_matrix(q)[np.ix_(at, at)])[-1] for each in (others[0], act, others[1])]
            rows.append(Felt(position, *map(float, felt)))
    return rows


# fmt: off
def command(
    walks: Annotated[int, option("--walk", "N", "Steps of the random walk.")] = 100_000,
    robot: Annotated[str | None, option(
        "--ankle", "FOLDER", "Also compare the inertia that the ankle motors of digit_like feel with that of a serial "
        "model: the folder of its URDF.")] = None,
    mjcf: Annotated[str | None, option(
        "--mjcf", "FOLDER", "Instead compare the actuators of its MJCF files with MuJoCo's qfrc_actuator.")] = None,
    as_json: output.Json = False,
) -> int:
    # fmt: on
    """Time closure, Jacobian and reduced dynamics; walk at random and count changes of branch.

    Example: python -m benchmarks actuation --walk 1000
    """
    if mjcf:
        return _against_mujoco(mjcf, as_json)
    rows, walked = [asdict(row) for row in measured((*SCENES, *([robot] if robot else ())))], walk(walks)
    felt = [asdict(row) for row in reflected(robot, *DIGIT)] if robot else []
    if report.in_files(None, as_json, actuation=rows, walk=walked, reflected=felt):
        return output.FINE
    calls = ("closure", "jacobian", "reduced", "forward", "c_closure", "c_jacobian", "c_reduced")
    times = [(f"{name} [µs]>".replace("_", " "), report.scaled(name, 1e6, 1)) for name in calls]
    title = f"one call; closure over {STEP:g} rad or m of every motor"
    report.table(rows, ["scene", "velocities>", "motors>", *times], title)
    print(
        f"\nrandom walk of a five-bar: {walked['steps']} steps, {walked['blocked']} blocked by a singularity, "
        f"{walked['jumps']} changes of branch, {1e6 * walked['time']:.0f} µs a step"
    )
    if felt:
        columns = [("motors at [rad]>", "{position:+.2f}"), "serial>:.4g", ("bodies>", "{rods:.4g}")]
        columns += [(f"and rotors of {ROTOR:g}>", "{whole:.4g}")]
        report.table(felt, columns, "largest inertia that the ankle motors feel, kg·m²")
    return output.FINE


def _against_mujoco(folder, as_json) -> int:
    rows, refused = mjcf_actuators.compared(folder)
    rows = [asdict(row) for row in rows]
    if as_json:
        output.print_json({"machine": report.machine(), "files": rows, "refused": refused})
        return output.FINE
    columns = ["file", "actuators>", "acting>", "cut>:.0%", "largest>:.3g", "difference>:.1e"]
    report.table(rows, columns, f"torques at {mjcf_actuators.STATES} random states, relative to the largest (or to 1)")
    for file, why in refused.items():
        print(f"{file}: refused: {why}")
    return output.FINE


DIGIT = (("motor_shin1", "motor_shin2"), ("free_foot1",))
