"""A leg that lands, stands and is pushed, by contact simulators: ``python -m benchmarks landing``.

The leg of examples/31, whose foot sticks under a push of 12 N and slides under one of 45 N. MuJoCo has loops and
contacts with a time constant of two steps, the stiffest that its documentation allows, or of twenty, which ring less;
its servos are actuators, so that whole parts of the motion are one call.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from functools import cache
from itertools import pairwise, product

import numpy as np

import pinconsist as pc
from pinconsist.cli import output

from . import report
from .example import example

UNTIL, PUSH = 2.0, (1.0, 1.2)  # s
PUSHES = 12.0, 45.0  # N
TIMES = np.linspace(0.0, UNTIL, 201)[1:]
SETTLED = 0.02  # s after an impact from which on velocities and forces are compared: soft contacts need some steps
BALL = 1e-4  # m, radius of MuJoCo's foot, whose centre is as high over its floor when it stands
STEPS = 1e-3, 1e-4, 1e-5  # s
INTEGRATORS = "implicitfast", "RK4"
IMPRATIO, ITERATIONS = 100, 100  # of MuJoCo: friction is harder than normal forces; the solver ends at rounding
SOFT = 2, 20  # steps, the time constant of MuJoCo's constraints: the least that it allows, and one that rings less
RTOLS = 1e-3, 1e-6
EXACT = 1e-11  # rtol of the run with which all are compared
LONG = 1.0  # s: longer runs are timed once
REPEATS = 3
JOINTS = "x", "z", "left_hip", "left_knee", "right_hip", "right_knee"


@dataclass(frozen=True)
class Row:
    """A run: its errors at 200 times, and the processor time for the whole motion.

    The errors of velocities and of the ground's force are root mean squares, outside of 20 ms after the impact.
    """

    push: float  # N
    tool: str
    q: float  # rad or m, the largest
    v: float  # rad/s or m/s
    force: float  # N
    end: float  # rad or m, of q at the end, when the leg stands
    seconds: float


@cache
def standing_leg():
    return example("31_standing_leg")


def scene(push) -> pc.Mechanism:
    """The leg with a push of this size."""
    mech = standing_leg().scene()
    servos = [force for force in mech.forces if isinstance(force, pc.Servo)]
    law = {"x": lambda t: push if PUSH[0] <= t < PUSH[1] else 0.0}
    return mech.with_forces(*servos, *([pc.Piecewise(law, PUSH)] if push else []))


@dataclass(frozen=True)
class Motion:
    """States and forces of the ground (along x and z) at TIMES, and the processor time of the whole motion."""

    q: np.ndarray
    v: np.ndarray
    force: np.ndarray
    seconds: float


def least(run):
    """The last result of some calls, and their least processor time."""
    seconds: list[float] = []
    while len(seconds) < REPEATS and (not seconds or seconds[-1] < LONG):
        begun = time.process_time()
        result = run()
        seconds.append(time.process_time() - begun)
    return result, min(seconds)


def ours(push, rtol) -> tuple[Motion, pc.Solution]:
    mech = scene(push)
    sol, seconds = least(lambda: pc.simulate(mech, (0.0, UNTIL), rtol=rtol, atol=1e-2 * rtol))
    rows = sol.at(TIMES)
    return Motion(rows.q, rows.v, rows.contact("ground").force[:, [0, 2]], seconds), sol


def stepped(push, period) -> Motion:
    """A run that is made in steps of one period, as a controller makes it; the push is a torque that is held."""
    start = pc.Simulation(scene(0.0))
    count = [round(time / period) for time in (*PUSH, UNTIL)]

    def run():
        sim = start.copy()
        for i in range(count[-1]):
            sim.step(period, {"x": push if count[0] <= i < count[1] else 0.0})
        return sim

    sim, seconds = least(run)
    whole = sim.solution()
    rows = whole.at(np.minimum(TIMES, whole.t[-1]))
    return Motion(rows.q, rows.v, rows.contact("ground").force[:, [0, 2]], seconds)


def mjcf(step, integrator, soft) -> str:
    """The leg as MuJoCo's XML; its joints are those of the example, in the same order."""
    leg = standing_leg()
    mech = leg.scene()
    knee = dict(zip(mech.joints, pc.assemble(mech).q, strict=True))
    stiff = f'solref="{soft * step!r} 1" solimp="0.9999 0.9999 0.001 0.5 2"'

    def rod(name, length, place, inner=""):
        turn = leg.LINK * length**2 / 12.0 + 1e-6
        return (
            f'<body pos="{place}"><joint name="{name}" type="hinge" axis="0 1 0"/>'
            f'<inertial mass="{leg.LINK}" pos="0 0 {-length / 2}" diaginertia="{turn} {turn} 1.1e-5"/>{inner}</body>'
        )

    legs, motors = "", ""
    for side, sign in (("left", -1.0), ("right", 1.0)):
        tip = f'<site name="{side}" pos="0 0 {-leg.SHANK}"/>'
        if side == "left":
            tip += f'<geom type="sphere" size="{BALL}" pos="0 0 {-leg.SHANK}" mass="0"/>'
        shank = rod(f"{side}_knee", leg.SHANK, f"0 0 {-leg.THIGH}", tip)
        legs += rod(f"{side}_hip", leg.THIGH, f"{sign * leg.HIPS} 0 0", shank)
        motors += f'<position joint="{side}_hip" kp="{leg.STIFF}" kv="{leg.DAMP}"/>'
    key = " ".join(repr(float(knee[name])) for name in JOINTS)
    control = f"{leg.SPREAD} {-leg.SPREAD}"
    return (
        f'<mujoco><compiler angle="radian"/><option timestep="{step!r}" integrator="{integrator}" gravity="0 0 -9.81" '
        f'cone="elliptic" impratio="{IMPRATIO}" iterations="{ITERATIONS}"/>'
        f'<default><geom friction="0.7 0 0" condim="3" {stiff}/><equality {stiff}/></default><worldbody>'
        f'<geom type="plane" size="5 5 1" pos="0 0 {-BALL}"/><body>'
        f'<joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>'
        f'<inertial mass="{leg.BASE}" pos="0 0 0" diaginertia="1 1 1"/>{legs}</body></worldbody>'
        f'<equality><connect site1="left" site2="right"/></equality><actuator>{motors}</actuator>'
        f'<keyframe><key qpos="{key}" ctrl="{control}"/></keyframe></mujoco>'
    )


class Mujoco:
    """MuJoCo's motion, in steps of its own."""

    def __init__(self, push, step, integrator, soft):
        import mujoco

        self._mujoco, self._push, self._step = mujoco, push, step
        self.model = mujoco.MjModel.from_xml_string(mjcf(step, integrator, soft))
        self.data = mujoco.MjData(self.model)

    def _begin(self):
        self._mujoco.mj_resetDataKeyframe(self.model, self.data, 0)

    def _advance(self, begin, end):
        """From one time to another, at which the push may change."""
        self.data.qfrc_applied[0] = self._push if PUSH[0] <= begin < PUSH[1] else 0.0
        self._mujoco.mj_step(self.model, self.data, nstep=round((end - begin) / self._step))

    def _whole(self):
        self._begin()
        for begin, end in pairwise((0.0, *PUSH, UNTIL)):
            self._advance(begin, end)

    def motion(self) -> Motion:
        _, seconds = least(self._whole)
        self._begin()
        rows = []
        for begin, end in pairwise((0.0, *TIMES)):
            self._advance(begin, end)
            self._mujoco.mj_forward(self.model, self.data)
            rows.append((self.data.qpos.copy(), self.data.qvel.copy(), self._force()))
        return Motion(*map(np.array, zip(*rows, strict=True)), seconds)

    def _force(self):
        """The force on the foot along x and z, N; the frame of a contact has its normal first."""
        total = np.zeros(3)
        for i in range(self.data.ncon):
            wrench = np.zeros(6)
            self._mujoco.mj_contactForce(self.model, self.data, i, wrench)
            frame = self.data.contact[i].frame.reshape(3, 3)
            total += frame.T @ wrench[:3]
        return total[[0, 2]]


def measured(push) -> list[Row]:
    """All runs with a push of this size."""
    exact, sol = ours(push, EXACT)
    settled = ~np.isclose(TIMES[:, None], PUSH).any(axis=1)  # where the push jumps, either side is right
    for impact in sol.impacts:
        settled &= (TIMES < impact.t - max(STEPS)) | (TIMES > impact.t + SETTLED)
    runs = {f"pinconsist, rtol {rtol:.0e}": ours(push, rtol)[0] for rtol in RTOLS}
    runs["pinconsist, steps of 1 ms"] = stepped(push, 1e-3)
    for integrator, h, soft in product(INTEGRATORS, STEPS, SOFT):
        runs[f"{integrator}, {1e3 * h:g} ms, {soft}"] = Mujoco(push, h, integrator, soft).motion()
    rows = []
    for tool, each in runs.items():
        q, v, force = (np.abs(getattr(each, name) - getattr(exact, name)) for name in ("q", "v", "force"))
        means = (float(np.sqrt(np.mean(error[settled] ** 2))) for error in (v, force))
        rows.append(Row(push, tool, float(q.max()), *means, float(q[-1].max()), each.seconds))
    return rows


def command(csv: report.Csv = None, as_json: output.Json = False) -> int:
    """Compare a leg that lands, stands and is pushed with MuJoCo: integrator, step, time constant in steps.

    Example: python -m benchmarks landing
    """
    output.require_writable(csv=csv)
    rows = [asdict(row) for push in PUSHES for row in measured(push)]
    if report.in_files(csv, as_json, rows, landing=rows):
        return output.FINE
    columns = [("error of q>", "{q:.0e}"), ("of v>", "{v:.0e}"), ("of the force [N]>", "{force:.0e}")]
    columns += [("of q at the end>", "{end:.0e}"), ("CPU [ms]>", report.scaled("seconds", 1e3))]
    for push in PUSHES:
        report.table([row for row in rows if row["push"] == push], ["tool", *columns], f"Pushed by {push:g} N")
    return output.FINE
