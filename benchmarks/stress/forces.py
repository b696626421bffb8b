"""Forces that jump, and functions of the user that return nonsense or raise."""

from __future__ import annotations

from functools import partial

import numpy as np

from pinconsist.dae.events import Event
from pinconsist.dae.sizes import largest
from pinconsist.mechanism.assembly import assemble
from pinconsist.mechanism.custom import Constraint
from pinconsist.mechanism.forces import JointFriction, JointTorque, Torque
from pinconsist.mechanism.joint_constraints import Drive
from pinconsist.reference import reference_solution

from .case import EITHER, MAX_STEPS, REFUSED, Case, Figure, Refused, completed, relative
from .scenes import START, four_bar

RTOL = 1e-6
GROWTH = 1e2
"""Of the tolerance, that each jump may add to the error at the end."""
UNTIL = 0.6
JUMP = 0.2345
PUSH = 20.0


def cases():
    """Yield the cases."""
    for size in (1.0, 1e2, 1e3):
        yield Case("discontinuous force", f"crank torque jumps by {size:g} N·m in mid-run", partial(_step, size))
    for period in (1e-1, 1e-2, 1e-3):
        yield Case("discontinuous force", f"square wave of period {period:g} s", partial(_square_wave, period))
    for width in (1e-2, 1e-4, 1e-6, 1e-8):
        yield Case("discontinuous force", f"dry friction over {width:.0e} rad/s", partial(_friction, width))
    yield Case("discontinuous force", "sign(v) friction as a user writes it", _bang, EITHER)
    yield Case("discontinuous force", "random torque, another one at each call", _noise, EITHER)
    for way, function in WAYS.items():
        for since in (0.0, 0.1):
            when = "from the start" if not since else "from t = 0.1 s"
            for place, build in PLACES.items():
                if place == "event" and way in ("returns infinity", "returns the wrong shape"):
                    continue  # an event that is far away for ever is none; one number in an array is one
                what = f"{place} {way} {when}"
                check = partial(_nonsense, build, function, since)
                yield Case("user function", what, check, REFUSED, NAMES[place])


def _run(by, *forces, loops=(), max_steps=MAX_STEPS, **options):
    mech = four_bar(forces=forces)
    mech = mech.with_loops(*mech.loops, *loops)
    return by.simulate(mech, (0.0, UNTIL), START, rtol=RTOL, atol=RTOL, max_steps=max_steps, **options)


def _pieces(torques, times):
    """scipy piece by piece between the jumps: (q, v) at the end."""
    start = assemble(four_bar(), START)
    q, v = start.q, start.v
    for torque, t0, t1 in zip(torques, times[:-1], times[1:], strict=True):
        mech = four_bar(forces=[{"crank": torque}])
        rows = reference_solution(mech, t0, q, v, [t0, t1], rtol=1e-9, atol=1e-9)
        q, v = rows.q[-1], rows.v[-1]
    return q, v


def _compared(sol, q, v, criterion):
    return [
        Figure("error of q", relative(sol.q[-1], q), criterion),
        Figure("error of v, relative", relative(sol.v[-1], v), criterion),
        Figure("loop gap [m]", sol.check().position, 1e-8),
    ]


def _step(size, by):
    """Stepped over, or told by an event: the error may be ten times that of a run which begins anew at the jump."""
    sol = completed(_run(by, JointTorque({"crank": lambda t: size if t > JUMP else 0.0})))
    q, v = _pieces((0.0, size), (0.0, JUMP, UNTIL))
    told = completed(_told(size, by))
    smooth = max(relative(told.q[-1], q), relative(told.v[-1], v))
    return _compared(sol, q, v, max(1e-4, 10 * smooth))


def _told(size, by):
    pushed = {"size": 0.0}

    def push(t, q, v):
        pushed["size"] = size

    jump = Event(lambda t, q, v, lam: t - JUMP, name="jump", apply=push)
    return _run(by, JointTorque({"crank": lambda t: pushed["size"]}), events=jump)


def _square_wave(period, by):
    """The errors of the jumps add up."""
    sol = completed(_run(by, JointTorque({"crank": lambda t: PUSH * (1.0 - 2.0 * (int(t / period) % 2))})))
    count = round(UNTIL / period)
    times = np.arange(count + 1) * period
    torques = [PUSH * (1.0 - 2.0 * (i % 2)) for i in range(count)]
    return _compared(sol, *_pieces(torques, times), GROWTH * RTOL * count)


def _friction(width, by):
    """Friction that exceeds the load holds the crank, and takes no more energy than there is."""
    sol = completed(_run(by, JointFriction(dict.fromkeys(("crank", "coupler", "rocker"), 100.0), width)))
    untold = not any("constraint forces" in concern for concern in sol.check().concerns)
    return [
        Figure("crank's creep [rad]", largest(sol.q[:, 0] - sol.q[0, 0]), 2 * width * UNTIL + 1e-6),
        Figure("constraint forces that are off untold", sol.check().force if untold else 0.0, 1e-2),
    ]


def _bang(by):
    def friction(t, q, v):
        return -100.0 * np.sign(v)

    sol = completed(_run(by, friction, max_steps=1000))
    return [Figure("crank's creep [rad]", largest(sol.q[:, 0] - sol.q[0, 0]), 1e-4)]


def _noise(by):
    rng = np.random.default_rng(0)
    sol = completed(_run(by, lambda t, q, v: rng.normal(size=3), max_steps=1000))
    told = bool(sol.check().concerns)
    return [Figure("noise that check() does not tell", 0.0 if told else 1.0, 0.5)]


def _not_a_number(shape):
    return np.full(shape, np.nan)


def _infinite(shape):
    return np.full(shape, np.inf)


def _raising(shape):
    raise KeyError("a mistake of the user's")


def _wrong_shape(shape):
    return np.zeros(np.prod(shape, dtype=int) + 1)


def _no_numbers(shape):
    return "push"


def _complex(shape):
    return np.full(shape, 1.0 + 1.0j)


WAYS = {
    "returns NaN": _not_a_number,
    "returns infinity": _infinite,
    "raises": _raising,
    "returns the wrong shape": _wrong_shape,
    "returns a text": _no_numbers,
    "returns complex numbers": _complex,
}


def _torque(by, nonsense):
    return _run(by, Torque(lambda t, q, v: nonsense(t, (3,), np.zeros(3))))


def _gradient(by, nonsense):
    return _run(by, Torque(lambda t, q, v: -v, lambda t, q, v: (None, nonsense(t, (3, 3), -np.eye(3)))))


def _torque_of_time(by, nonsense):
    return _run(by, JointTorque({"crank": lambda t: nonsense(t, (), 0.0)}))


def _drive(by, nonsense):
    return _run(by, loops=[Drive("motor", "crank", lambda t: nonsense(t, (), -1.0 + t))])


def _constraint(by, nonsense):
    def hold(t, q):
        return nonsense(t, (1,), np.array([q[0] + 1.0 - t]))

    return _run(by, loops=[Constraint("hold", hold, 1)])


def _event(by, nonsense):
    return _run(by, events=lambda t, q, v, lam: nonsense(t, (), 1.0))


PLACES = {
    "torque": _torque,
    "gradient": _gradient,
    "torque of time": _torque_of_time,
    "drive": _drive,
    "constraint": _constraint,
    "event": _event,
}
NAMES = {
    "torque": "torque",
    "gradient": "gradient|Newton|torque",
    "torque of time": "crank|torque",
    "drive": "motor|crank",
    "constraint": "hold",
    "event": "event",
}
"""What the reason must name."""


def _nonsense(build, way, since, by):
    """What was reached before is kept; the reason names the function."""

    def nonsense(t, shape, sense):
        return way(shape) if t >= since else sense

    sol = build(by, nonsense)
    if not sol.success:
        if not (np.isfinite(sol.q).all() and np.isfinite(sol.v).all() and np.isfinite(sol.lam).all()):
            return [Figure("a failure whose rows are not finite", 1.0, 0.5)]
        raise Refused(sol.message)
    return [Figure("nonsense that went through", 1.0, 0.5)]
