"""Compiled steps are made ahead of events and callbacks: as few calls as possible, and nothing else is different."""

import signal

import numpy as np
import pytest

import pinconsist as pc
from pinconsist.engine import constant
from pinconsist.run.events import reads_multipliers
from pinconsist.run.steppers import Stepper

START = {"v0": {"crank": 12.0}}
RUN = ("crank_rocker", (0.0, 0.4))


def run(options, ahead=True, monkeypatch=None):
    """A run, with steps made one at a time unless `ahead`."""
    if not ahead:
        monkeypatch.setattr(Stepper, "batch", 1)
    return pc.simulate(pc.load(RUN[0]), RUN[1], **START, **{"method": "BDF", **options})


def turned(limit, **about):
    return pc.Event(lambda t, q, v, lam: np.sin(q[0]) - limit, name=f"turned{limit}", **about)


class Progress:
    """A callback that only follows how far the run has come."""

    each_step = False

    def __init__(self):
        self.calls = []

    def __call__(self, *about):
        self.calls.append(about)


@pytest.mark.parametrize(
    "options",
    [
        {"callback": lambda *state: None},
        {"callback": Progress()},
        {"events": lambda t, q, v, lam: 1.0},
        {"t_eval": np.linspace(0.0, 0.4, 50), "dense_output": True},
    ],
    ids=["callback", "progress", "event", "t_eval and dense"],
)
def test_the_compiled_loop_is_left_rarely(monkeypatch, options):
    calls, advance = [], Stepper.advance
    monkeypatch.setattr(Stepper, "advance", lambda *args: calls.append(1) or advance(*args))
    sol = run(options)
    assert sol.success and sol.nsteps > 150 and len(calls) < 25


@pytest.mark.parametrize(
    "options",
    [
        {"events": [turned(0.5), turned(-0.3, apply=lambda t, q, v: 0.9 * v)]},
        {"events": [turned(0.5), turned(-0.3, apply=lambda t, q, v: 0.9 * v)], "dense_output": True},
        {"events": [turned(0.5), turned(-0.3, terminal=2)], "t_eval": np.linspace(0.0, 0.4, 70)},
        {"events": turned(0.5), "callback": lambda t, *state: t > 0.2},
        {"events": turned(0.5), "max_steps": 70},
    ],
)
def test_it_is_the_run_whose_steps_are_looked_at_one_by_one(monkeypatch, options):
    many, one = run(options), run(options, False, monkeypatch)
    assert many.message == one.message and many.nsteps == one.nsteps
    for name in ("t", "q", "v", "lam", "h", "order"):
        np.testing.assert_array_equal(getattr(many, name), getattr(one, name))
    for found, expected in zip(many.t_events, one.t_events, strict=True):
        np.testing.assert_array_equal(found, expected)
    assert any(map(len, many.t_events))
    if many.sol is not None:
        times = np.linspace(0.0, many.t[-1], 101)
        for found, expected in zip(many.sol(times), one.sol(times), strict=True):
            np.testing.assert_array_equal(found, expected)


def test_a_callback_that_stops_hides_what_lies_beyond():
    """Neither rows, nor events, nor what an event's function raises beyond that step."""

    def g(t, q, v, lam):
        if t > 0.3:
            raise KeyError("too far")
        return np.sin(q[0]) - 0.5

    seen = []
    sol = run({"events": g, "callback": lambda t, *state: seen.append(t) or t > 0.1})
    assert (sol.status, sol.t[-1]) == (1, seen[-1]) and "callback" in sol.message
    assert sol.t_events[0].max() <= sol.t[-1] < 0.15


def test_a_callback_may_change_what_a_force_reads():
    """Then every step is made after the callback has seen the one before: a brake that is let go at a time."""
    brake = {"on": True}

    def callback(t, q, v, lam):
        brake["on"] = t < 0.05

    def force(t, q, v):
        return -2.0 * v if brake["on"] else 0.0 * v

    sol = run({"forces": [force], "callback": callback})
    brake["on"] = True
    held = run({"forces": [force]})
    first = int(np.argmax(sol.t >= 0.05))
    np.testing.assert_array_equal(sol.t[: first + 1], held.t[: first + 1])
    assert np.abs(sol.v[-1]).max() > 1.2 * np.abs(held.v[-1]).max()


def test_progress_says_how_far_the_run_has_come():
    progress = Progress()
    sol = run({"callback": progress})
    times, steps, orders, counts = zip(*progress.calls, strict=True)
    assert sum(counts) == sol.nsteps and times[-1] == sol.t[-1]
    assert steps[-1] == pytest.approx(sol.h[-1]) and orders[-1] == sol.order[-1]


def test_events_get_rows_that_cannot_be_written_to():
    def g(t, q, v, lam):
        with pytest.raises(ValueError, match="read-only"):
            q[:] = 0.0
        return 1.0

    assert run({"events": g}).success


@pytest.mark.parametrize("method", ["BDF", "Radau"])
def test_events_may_keep_what_they_are_given(method):
    """The compiled loop writes into the same arrays again, unless somebody has them, or a part of them."""
    seen = []

    def g(t, q, v, lam):
        seen.append((t, q[1:], v, *q[1:], *v))
        return 1.0

    assert run({"events": [g, g], "method": method}).success and len(seen) > 100
    for _, q, v, *numbers in seen:
        assert [*q, *v] == numbers


@pytest.mark.parametrize("method", ["BDF", "Radau"])
def test_no_event_is_looked_for_beyond_one_that_changes_the_run(method):
    """Steps end where it was found, and looks at the step do."""
    times = []

    def g(t, q, v, lam):
        times.append(t)
        return np.sin(q[0]) - 0.5

    sol = run({"events": pc.Event(g, terminal=True), "method": method})
    latest = max(times)
    assert sol.status == 1 and times[times.index(latest) - 1] < sol.t[-1] <= latest
    assert len(times) <= (sol.nsteps + 1) * (constant("LOOKS" if method == "Radau" else "LOOKS_OF_BDF") + 1) + 80


def test_backwards_events_are_those_of_the_steps_looked_at_one_by_one(monkeypatch):
    there = pc.simulate(pc.load("four_bar"), (0.0, 1.0), v0={"crank": 2.0})
    mech, start = pc.load("four_bar"), (there.q[-1], there.v[-1])
    options = {"events": [turned(0.4), turned(0.1, apply=lambda t, q, v: 0.9 * v)], "dense_output": True}
    many = pc.integrate(mech, (1.0, 0.0), *start, **options)
    monkeypatch.setattr(Stepper, "batch", 1)
    one = pc.integrate(mech, (1.0, 0.0), *start, **options)
    for found, expected in zip(many.t_events, one.t_events, strict=True):
        np.testing.assert_array_equal(found, expected)
    times = np.linspace(0.0, 1.0, 77)
    np.testing.assert_array_equal(many.sol(times)[0], one.sol(times)[0])


@pytest.mark.parametrize("method", ["BDF", "Radau"])
@pytest.mark.parametrize("whose", ["callback", "events"])
def test_a_signal_ends_the_run_at_the_step_that_is_looked_at(whose, method):
    """Also at the first of several looks into one step."""
    sent = []

    def function(t, *state):
        if t > 0.2 and not sent:
            sent.append(t)
            signal.raise_signal(signal.SIGINT)
        return whose == "events"

    sol = run({whose: function, "method": method})
    assert (sol.status, sol.nsteps) == (1, int(np.argmax(sol.t >= sent[0]))) and "interrupted" in sol.message


@pytest.mark.parametrize("method", ["BDF", "Radau"])
@pytest.mark.parametrize("seen_by", ["callback", "event", "both"])
def test_a_force_of_the_users_finds_each_step_seen(monkeypatch, method, seen_by):
    """Callbacks and events may change what it does from the next step on; the compiled loop calls them."""

    def run(one_by_one):
        if one_by_one:
            monkeypatch.setattr(Stepper, "batch", 1)
        last, calls = [0.0], []

        def note(t, q, v, lam):
            last[0] = t
            return t > 0.15 if seen_by == "callback" else np.sin(q[0]) - 0.5

        options = {
            "callback": {"callback": note},
            "event": {"events": note},
            "both": {"events": turned(-0.3, terminal=True), "callback": lambda t, *state: note(t, *state) > 2.0},
        }[seen_by]
        advance = Stepper.advance
        with monkeypatch.context() as patched:
            patched.setattr(Stepper, "advance", lambda *args: calls.append(1) or advance(*args))
            torque = pc.Torque(lambda t, q, v: np.array([last[0], 0.0, 0.0]))
            sol = pc.simulate(pc.load(RUN[0]), (0.0, 0.2), **START, method=method, forces=[torque], **options)
        return sol, len(calls)

    (many, few), (one, _) = run(False), run(True)
    assert many.status == one.status and many.nsteps == one.nsteps and few < 40
    for name in ("t", "q", "v", "lam"):
        np.testing.assert_array_equal(getattr(many, name), getattr(one, name))


def test_multipliers_are_computed_for_events_that_read_them():
    def never(t, q, v, lam):
        return q[0]

    def hidden(t, q, v, lam):
        return locals()["lam"][0]

    readers = [
        lambda t, q, v, lam: lam[0],
        lambda t, q, v, lam: sum(lam[i] for i in range(2)),
        lambda t, q, v, *rest: rest[0][0],
        lambda *state: state[3][0],
        hidden,
        turned(0.5).function.__call__,
    ]
    assert all(map(reads_multipliers, readers)) and not reads_multipliers(never)
    sol = run({"method": "Radau", "events": readers[0], "dense_output": True})
    assert len(sol.t_events[0])
    assert np.abs(sol.sol(sol.t_events[0])[2][:, 0]).max() < 1e-4 * np.abs(sol.lam).max()
