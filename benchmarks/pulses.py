"""Whether runs see pulses of functions of time, however short: ``python -m benchmarks pulses``.

A parallelogram, whose inertia is constant, and a suspension on a road, at rest or swinging, against SciPy's solution of
their one equation in the three parts before, in and after a pulse.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cache, partial
from itertools import pairwise, product
from math import cos, exp, pi, sin

import numpy as np
import pinocchio as pin
from scipy.integrate import solve_ivp

import pinconsist as pc
from pinconsist.cli import output

from . import report

SPAN, BEGIN = 10.0, 3.14159  # s
WIDTHS = 0.1, 0.03, 0.01, 0.005  # of the span
METHODS = "Radau", "BDF"
RTOL, ATOL = 1e-6, 1e-8
INERTIA = 5.0 / 3.0  # kg m², of the parallelogram: two rods and one that they carry, 1 m and 1 kg each
STIFFNESS, DAMPING, MASS = 40.0, 1.0, 2.0  # N·m/rad or N/m, with the unit of the damping; kg


def smooth(x):
    """A pulse with all derivatives, and its second derivative."""
    if not 0.0 < x < 1.0:
        return 0.0, 0.0
    y = x * (1.0 - x)
    rate, bend = (1.0 - 2.0 * x) / y**2, -2.0 / y**2 - 2.0 * (1.0 - 2.0 * x) ** 2 / y**3
    value = exp(4.0 - 1.0 / y)
    return value, value * (rate**2 + bend)


def cosine(x):
    """A pulse whose second derivative jumps at its ends."""
    w = 2.0 * pi
    return (0.5 - 0.5 * cos(w * x), 0.5 * w**2 * cos(w * x)) if 0.0 < x < 1.0 else (0.0, 0.0)


def sine(x):
    """A pulse that bends at its ends."""
    return (sin(pi * x) if 0.0 < x < 1.0 else 0.0), 0.0


def rectangle(x):
    """A pulse that jumps."""
    return (1.0 if 0.0 <= x < 1.0 else 0.0), 0.0


def saw(x):
    """A pulse that bends, and then jumps."""
    return (x if 0.0 < x < 1.0 else 0.0), 0.0


def bell(x):
    """A Gaussian pulse, which has no beginning."""
    z = 8.0 * (x - 0.5)
    value = exp(-0.5 * z * z)
    return value, 64.0 * (z * z - 1.0) * value


@dataclass(frozen=True)
class Pulse:
    """A function of time: `size` times a shape, from BEGIN on, for a time `width`, s."""

    shape: Callable
    size: float
    width: float

    def __call__(self, t):
        return self.size * self.shape((t - BEGIN) / self.width)[0]

    def second(self, t):
        """Its second derivative."""
        return self.size * self.shape((t - BEGIN) / self.width)[1] / self.width**2


@cache
def parallelogram():
    """Two cranks and a coupler, without gravity, with a spring and a damper on a crank."""
    mech = pc.load("n_four_bar_1").with_gravity((0.0, 0.0, 0.0))
    return mech.add_forces(pc.JointSpring("crank0", STIFFNESS), pc.JointDamping({"crank0": DAMPING}))


@cache
def suspension():
    """A body above a wheel that follows the road; both slide vertically."""
    model = pin.Model()
    model.gravity.setZero()
    joint = 0
    for name in ("wheel", "body"):
        joint = model.addJoint(joint, pin.JointModelPZ(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(joint, pin.Inertia(MASS, np.zeros(3), np.eye(3)), pin.SE3.Identity())
        model.addFrame(pin.Frame(f"{name}_frame", joint, 0, pin.SE3.Identity(), pin.FrameType.BODY))
    return pc.Mechanism(model, forces=(pc.JointSpring("body", STIFFNESS), pc.JointDamping({"body": DAMPING})))


def torque(pulse):
    return parallelogram().add_forces(pc.JointTorque({"crank0": pulse}))


def moment(pulse):
    return parallelogram().add_forces(pc.Wrench("crank0", moment=lambda t: (0.0, pulse(t), 0.0)))


def law(pulse):
    return parallelogram().add_forces(lambda t, q, v: [pulse(t), 0.0, 0.0])


def servo(pulse):
    return parallelogram().add_forces(pc.Servo("crank0", pulse, 1.0))


def table(pulse):
    """A table of an actuator, through some values of the pulse."""
    times = BEGIN + pulse.width * np.linspace(0.0, 1.0, 9)
    return with_motor(times, [0.0, *(pulse(t) for t in times[1:-1]), 0.0])


def with_motor(times, values):
    """The parallelogram with an actuator and a table of its command."""
    mech = parallelogram().add_forces(pc.Actuator("motor", "crank0"))
    return mech.with_control({"motor": (times, values)})


def push(pulse):
    wheel = pc.Drive("road", "wheel", pc.Motion())
    return suspension().with_loops(wheel).add_forces(pc.Wrench("body_frame", force=lambda t: (0.0, 0.0, pulse(t))))


def drive(pulse):
    return suspension().with_loops(pc.Drive("road", "wheel", pulse))


def constraint(pulse):
    return suspension().with_loops(pc.Constraint("road", lambda t, q: [q[0] - pulse(t)], 1))


LAWS = {
    "torque": torque, "moment": moment, "law": law, "servo": servo, "table": table, "push": push, "drive": drive,
    "constraint": constraint,
}  # fmt: skip
SUSPENDED = {"push", "drive", "constraint"}
MOVED = {"drive", "constraint"}
SCENES = (
    ("torque", smooth, 0.0), ("torque", sine, 0.4), ("torque", bell, 0.0), ("moment", cosine, 0.0),
    ("moment", saw, 0.4), ("law", smooth, 0.0), ("law", rectangle, 0.4), ("servo", smooth, 0.0), ("servo", bell, 0.4),
    ("table", smooth, 0.0), ("table", sine, 0.4), ("push", rectangle, 0.0), ("push", smooth, 0.4), ("push", saw, 0.0),
    ("drive", smooth, 0.0), ("drive", cosine, 0.0), ("drive", bell, 0.0), ("drive", smooth, 0.05),
    ("constraint", cosine, 0.0), ("constraint", smooth, 0.05),
)  # fmt: skip
"""How a pulse acts, its shape, and the speed at the start, rad/s or m/s."""


@dataclass(frozen=True)
class Row:
    """A run: its error of q and v at the end, in tolerances, its steps and its calls of the pulse."""

    scene: str
    width: float
    method: str
    way: str
    error: float
    steps: int
    status: str


def equation(kind, pulse, values=None):
    """x'' of the only coordinate."""
    stiffness = STIFFNESS + (kind == "servo")
    mass = MASS if kind in SUSPENDED else INERTIA
    force = values or pulse
    if kind in MOVED:
        return lambda t, y: [y[1], -(STIFFNESS * y[0] + DAMPING * y[1]) / MASS - pulse.second(t)]
    return lambda t, y: [y[1], (force(t) - stiffness * y[0] - DAMPING * y[1]) / mass]


def exact(rhs, state, times, width):
    """The state at the end by DOP853, part by part of `times`, with steps of at most a twentieth of the pulse."""
    for a, b in pairwise(times):
        h = 1e-12 * np.sign(b - a)  # on the right side of jumps
        inside = min(a, b) > BEGIN - 5.0 * width and max(a, b) < BEGIN + 6.0 * width
        longest = 0.05 * width if inside else 0.1
        state = solve_ivp(rhs, (a + h, b - h), state, "DOP853", rtol=1e-12, atol=1e-14, max_step=longest).y[:, -1]
    return state


def parts(width):
    """Times between which an equation is smooth, and where its steps are short."""
    around = [BEGIN - 4.0 * width, BEGIN, *BEGIN + width * np.linspace(0.0, 1.0, 9)[1:], BEGIN + 5.0 * width]
    return [0.0, *(t for t in around if 0.0 < t < SPAN), SPAN]


def run(mech, kind, start, end, back, method):
    """A run from a state of the coordinate to another; (error in tolerances, steps, why it ended)."""
    joint = "body" if kind in SUSPENDED else "crank0"
    span = (SPAN, 0.0) if back else (0.0, SPAN)
    q0, v0 = ({joint: float(x)} for x in start)
    sol = pc.simulate(mech, span, q0, v0, method=method, rtol=RTOL, atol=ATOL)
    place = mech.columns(joint).start
    if not sol.success:
        return np.inf, sol.nsteps, sol.message
    found = np.array([sol.q[-1, place], sol.v[-1, place]])
    size = np.array([np.abs(sol.q).max(), np.abs(sol.v).max()])
    return float((np.abs(found - end) / (RTOL * size + ATOL)).max()), sol.nsteps, "ok"


def measured(scenes=SCENES, widths=WIDTHS, methods=METHODS, ways=(False, True)) -> list[Row]:
    """All scenes with pulses of all widths, by both methods and in both directions."""
    rows = []
    for (kind, shape, speed), width in product(scenes, widths):
        pulse = Pulse(shape, 0.05 if kind in MOVED else 20.0, width * SPAN)
        mech, values = LAWS[kind](pulse), None
        if kind == "table":
            control = mech.forces[-1].control
            values = partial(np.interp, xp=control.times, fp=control.values)
        rhs, times = equation(kind, pulse, values), parts(pulse.width)
        begin = np.array([0.0, speed])
        end = exact(rhs, begin, times, pulse.width)
        for method, back in product(methods, ways):
            ends = (end, begin) if back else (begin, end)
            error, steps, status = run(mech, kind, *ends, back, method)
            name = f"{kind}, {shape.__name__}, {'swinging' if speed else 'at rest'}"
            rows.append(Row(name, width, method, "backwards" if back else "forwards", error, steps, status))
    return rows


@dataclass(frozen=True)
class Tables:
    """Runs with random tables of two pulses: the largest error in tolerances, and how many are above 100."""

    method: str
    runs: int
    worst: float
    lost: int


def random_tables(runs=80, methods=METHODS, seed=0) -> list[Tables]:
    """Two pulses of 1 to 300 ms at random times in a table of commands, each of three values."""
    rng, rows = np.random.default_rng(seed), {method: [] for method in methods}
    for _ in range(runs):
        times, values = [0.0], [0.0]
        for begin in np.sort(rng.uniform(0.2, 9.4, 2)):
            width = 10.0 ** rng.uniform(-3.0, np.log10(0.3))
            begin = max(begin, times[-1] + 1e-3)
            times += [begin, begin + 0.5 * width, begin + width]
            values += [0.0, rng.uniform(-30.0, 30.0), 0.0]
        mech = with_motor(times, values)
        rhs = equation("table", None, partial(np.interp, xp=times, fp=values))
        end = np.zeros(2)
        for a, b in pairwise([*times, SPAN]):
            end = solve_ivp(rhs, (a, b), end, "DOP853", rtol=1e-12, atol=1e-14, max_step=0.1).y[:, -1]
        for method in methods:
            rows[method].append(run(mech, "table", np.zeros(2), end, False, method)[0])
    return [Tables(method, runs, max(each), int(np.sum(np.array(each) > 100.0))) for method, each in rows.items()]


# fmt: off
def command(csv: report.Csv = None, as_json: output.Json = False) -> int:
    # fmt: on
    """Run 20 scenes with one pulse of 10 to 0.5 % of 10 s, and 80 random tables of commands with two.

    Example: python -m benchmarks pulses
    """
    output.require_writable(csv=csv)
    rows, tables = [asdict(row) for row in measured()], [asdict(row) for row in random_tables()]
    if report.in_files(csv, as_json, rows, pulses=rows, tables=tables):
        return output.FINE
    width, error = report.scaled("width", 1e2, 1), "{error:.3g}"
    columns = ["scene", ("width [%]>", width), "method", "way", ("error in tolerances>", error), "steps>", "status"]
    report.table(rows, columns, f"One pulse in {SPAN:g} s, rtol {RTOL:g}")
    report.table(tables, ["method", "runs>", ("worst>", "{worst:.3g}"), "lost>"], "Random tables of commands")
    return output.FINE
