"""Forces that jump, and functions of the user that return nonsense or raise."""

from __future__ import annotations

from functools import partial

import numpy as np

from pinconsist import Constraint, Drive, Event, JointFriction, JointTorque, Torque, assemble
from pinconsist.paper import reference_solution

from ..linkages import START, four_bar
from .case import (
    EITHER,
    MAX_STEPS,
    REFUSED,
    Case,
    Figure,
    Refused,
    certified,
    completed,
    largest,
    relative,
    should_not_be,
)

RTOL = 1e-6
GROWTH = 1e2
"""Of the tolerance, that each jump may add to the error at the end."""
UNTIL = 0.6
JUMP = 0.2345
PUSH = 20.0


def cases():
    family = "discontinuous force"
    for size in (1.0, 1e2, 1e3):
        yield Case(family, f"crank torque jumps by {size:g} N·m in mid-run", partial(_step, size))
    for period in (1e-1, 1e-2, 1e-3):
        yield Case(family, f"square wave of period {period:g} s", partial(_square_wave, period))
    for width in (1e-2, 1e-4, 1e-6, 1e-8):
        yield Case(family, f"dry friction over {width:.0e} rad/s", partial(_friction, width))
    yield Case(family, "sign(v) friction as a user writes it", _bang, EITHER)
    yield Case(family, "random torque, another one at each call", _noise, EITHER)
    for way, function in WAYS.items():
        for since, when in ((0.0, "from the start"), (0.1, "from t = 0.1 s")):
            for place, (build, named) in PLACES.items():
                if place == "event" and way in ("returns infinity", "returns the wrong shape"):
                    continue  # an event that is far away for ever is none; one number in an array is one
                check = partial(_nonsense, build, function, since)
                yield Case("user function", f"{place} {way} {when}", check, REFUSED, named)


def _run(by, *forces, loops=(), max_steps=MAX_STEPS, **options):
    mech = four_bar(forces=forces)
    mech = mech.add_loops(*loops)
    return by.simulate(mech, (0.0, UNTIL), START, rtol=RTOL, atol=RTOL, max_steps=max_steps, **options)


def _pieces(torques, times):
    """scipy piece by piece between the jumps: (q, v) at the end."""
    start = assemble(four_bar(), START)
    q, v = start.q, start.v
    for torque, t0, t1 in zip(torques, times[:-1], times[1:], strict=True):
        rows = reference_solution(four_bar(forces=[{"crank": torque}]), t0, q, v, [t0, t1], rtol=1e-9, atol=1e-9)
        q, v = rows.q[-1], rows.v[-1]
    return q, v


def _compared(sol, q, v, criterion):
    return [
        Figure("error of q", relative(sol.q[-1], q), criterion),
        Figure("error of v, relative", relative(sol.v[-1], v), criterion),
        *certified(sol, position=1e-8),
    ]


def _step(size, by):
    """Stepped over, or met by an event: the error may be ten times that of a run which begins anew at the jump."""
    sol = completed(_run(by, JointTorque({"crank": lambda t: size if t > JUMP else 0.0})))
    q, v = _pieces((0.0, size), (0.0, JUMP, UNTIL))
    pushed = {"size": 0.0}
    jump = Event(lambda t, q, v, lam: t - JUMP, name="jump", apply=lambda t, q, v: pushed.update(size=size))
    smooth = completed(_run(by, JointTorque({"crank": lambda t: pushed["size"]}), events=jump))
    error = max(relative(smooth.q[-1], q), relative(smooth.v[-1], v))
    return _compared(sol, q, v, max(1e-4, 10 * error))


def _square_wave(period, by):
    """The errors of the jumps add up."""
    sol = completed(_run(by, JointTorque({"crank": lambda t: PUSH * (1.0 - 2.0 * (int(t / period) % 2))})))
    count = round(UNTIL / period)
    torques = [PUSH * (1.0 - 2.0 * (i % 2)) for i in range(count)]
    return _compared(sol, *_pieces(torques, np.arange(count + 1) * period), GROWTH * RTOL * count)


def _creep(sol, criterion):
    return Figure("crank's creep [rad]", largest(sol.q[:, 0] - sol.q[0, 0]), criterion)


def _friction(width, by):
    """Friction that exceeds the load holds the crank, and takes no more energy than there is."""
    sol = completed(_run(by, JointFriction(dict.fromkeys(("crank", "coupler", "rocker"), 100.0), width)))
    reported = any("constraint forces" in concern for concern in sol.check().concerns)
    error = 0.0 if reported else sol.check().force
    return [_creep(sol, 2 * width * UNTIL + 1e-6), Figure("constraint forces that are off unreported", error, 1e-2)]


def _bang(by):
    return [_creep(completed(_run(by, lambda t, q, v: -100.0 * np.sign(v), max_steps=1000)), 1e-4)]


def _noise(by):
    rng = np.random.default_rng(0)
    sol = completed(_run(by, lambda t, q, v: rng.normal(size=3), max_steps=1000))
    return [should_not_be("noise that check() does not report", not sol.check().concerns)]


def _raising(shape):
    raise KeyError("a mistake of the user's")


WAYS = {
    "returns NaN": lambda shape: np.full(shape, np.nan),
    "returns infinity": lambda shape: np.full(shape, np.inf),
    "raises": _raising,
    "returns the wrong shape": lambda shape: np.zeros(np.prod(shape, dtype=int) + 1),
    "returns a text": lambda shape: "push",
    "returns complex numbers": lambda shape: np.full(shape, 1.0 + 1.0j),
}
"""What a user's function does in place of returning an array of a shape."""


def _torque(by, f):
    return _run(by, Torque(lambda t, q, v: f(t, (3,), np.zeros(3))))


def _gradient(by, f):
    return _run(by, Torque(lambda t, q, v: -v, lambda t, q, v: (None, f(t, (3, 3), -np.eye(3)))))


def _torque_of_time(by, f):
    return _run(by, JointTorque({"crank": lambda t: f(t, (), 0.0)}))


def _drive(by, f):
    return _run(by, loops=[Drive("motor", "crank", lambda t: f(t, (), -1.0 + t))])


def _constraint(by, f):
    return _run(by, loops=[Constraint("hold", lambda t, q: f(t, (1,), np.array([q[0] + 1.0 - t])), 1)])


def _event(by, f):
    return _run(by, events=lambda t, q, v, lam: f(t, (), 1.0))


PLACES = {
    "torque": (_torque, "torque"),
    "gradient": (_gradient, "gradient|Newton|torque"),
    "torque of time": (_torque_of_time, "crank|torque"),
    "drive": (_drive, "motor|crank"),
    "constraint": (_constraint, "hold"),
    "event": (_event, "event"),
}
"""A run with a user's function f(t, shape, what it should return), and what the reason must name."""


def _nonsense(build, way, since, by):
    """What was reached before is kept; the reason names the function."""
    sol = build(by, lambda t, shape, sense: way(shape) if t >= since else sense)
    if sol.success:
        return [should_not_be("nonsense that went through")]
    if not all(np.isfinite(rows).all() for rows in (sol.q, sol.v, sol.lam)):
        return [should_not_be("a failure whose rows are not finite")]
    raise Refused(sol.message)
