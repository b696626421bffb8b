"""Events: where they are found, what they change, in which order; interrupts, callbacks and what they leave behind."""

import numpy as np
import pinocchio as pin
import pytest
from helpers import scenes

import pinconsist as pc

G = 9.81
FIXED_AND_ADAPTIVE = [{}, {"step": 0.013}, {"rtol": 1e-4, "atol": 1e-4}, {"step": 0.01, "order": 2}]


def balls(n=1):
    """n masses of 1 kg on vertical sliders, under gravity."""
    model = pin.Model()
    model.gravity.linear = np.array([0, 0, -G])
    for i in range(n):
        scenes.add_body(model, 0, pin.JointModelPZ(), scenes.at(i, 0), f"z{i}", 1.0, (0, 0, 0), 0.1)
    return pc.Mechanism(model, name="balls")


def bead():
    """A mass of 1 kg on two sliders, held on the unit circle: without forces the angle is ω t and λ = -ω²."""
    model = pin.Model()
    model.gravity.setZero()
    x = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "x")
    y = scenes.add_body(model, x, pin.JointModelPY(), pin.SE3.Identity(), "y", 1.0, (0, 0, 0), 0.0)
    scenes.add_point(model, y, "mass", 0, 0)
    circle = pc.Loop("circle", "distance", "universe", "mass", length=1.0)
    return pc.Mechanism(model, [circle], name="bead", guess=(1.0, 0.0))


def bounce(restitution=1.0, i=0, **options):
    def apply(t, q, v):
        v = v.copy()
        v[i] *= -restitution
        return v

    return pc.Event(lambda t, q, v, lam: q[i], apply=apply, name=f"bounce{i}", **options)


def impact_times(height, restitution, until):
    t = np.sqrt(2 * height / G)
    times, v = [t], G * t
    while times[-1] < until:
        v *= restitution
        times.append(times[-1] + 2 * v / G)
    return np.array(times[:-1])


@pytest.mark.parametrize("direction", [-1, 0])
@pytest.mark.parametrize("options", FIXED_AND_ADAPTIVE)
def test_a_bouncing_ball_hits_when_it_should(options, direction):
    """Impact times and speeds in closed form; with direction 0 the rebound must not count as a second impact."""
    sol = pc.simulate(balls(), (0.0, 3.0), q0=[1.0], events=bounce(0.8, direction=direction), **options, method="BDF")
    expected = impact_times(1.0, 0.8, 3.0)
    assert sol.status == 0 and len(expected) == 6
    np.testing.assert_allclose(sol.t_events[0], expected, rtol=1e-11)
    np.testing.assert_allclose(sol.q_events[0], 0.0, atol=1e-11)
    speeds = -np.sqrt(2 * G) * 0.8 ** np.arange(6)  # of arrival
    np.testing.assert_allclose(sol.v_events[0][:, 0], speeds, rtol=1e-10)
    t, z = sol.t[-1] - expected[-1], sol.q[-1, 0]
    assert z == pytest.approx(-speeds[-1] * 0.8 * t - G * t**2 / 2, abs=1e-10) and sol.q.min() > -1e-12


def test_each_impact_is_two_rows_at_one_time():
    sol = pc.simulate(balls(), (0.0, 1.0), q0=[1.0], events=bounce(0.5), step=0.05)
    row = int(np.flatnonzero(np.diff(sol.t) == 0.0)[0])
    assert sol.t[row] == sol.t_events[0][0] and sol.h[row] == 0.0 and sol.order[row] == 0
    np.testing.assert_allclose(sol.v[row + 1], -0.5 * sol.v[row])
    assert len(sol.h) == len(sol.t) - 1


@pytest.mark.parametrize("options", FIXED_AND_ADAPTIVE)
def test_impacts_on_a_closed_chain_restart_with_right_multipliers(options):
    """A bead on a circle hits a wall at 60° and loses half its speed: λ = -ω² at once, in the very next row."""
    wall = np.cos(np.radians(60.0))
    event = pc.Event(lambda t, q, v, lam: q[0] - wall, direction=-1, apply=lambda t, q, v: -0.5 * v, name="wall")
    sol = pc.simulate(bead(), (0.0, 1.5), v0=(0.0, 2.0), events=event, **options, method="BDF")
    hit = np.radians(60.0) / 2.0
    np.testing.assert_allclose(sol.t_events[0], [hit], atol=2e-3 if options.get("order") == 2 else 2e-4)
    after = sol.t > sol.t_events[0][0]
    jump = int(np.flatnonzero(np.diff(sol.t) == 0.0)[0])
    tol = 2e-2 if options.get("order") == 2 else 3e-3
    np.testing.assert_allclose(sol.lam[jump, 0], -4.0, atol=tol)
    np.testing.assert_allclose(sol.lam[jump + 1, 0], -1.0, atol=tol)
    np.testing.assert_allclose(sol.lam[after, 0], -1.0, atol=tol)
    angle = np.arctan2(sol.q[-1, 1], sol.q[-1, 0])
    assert angle == pytest.approx(np.radians(60.0) - (1.5 - sol.t_events[0][0]), abs=tol)
    assert sol.check(error=False).position < 1e-7  # the row before the impact is interpolated


def test_terminal_as_a_truth_and_as_a_count():
    once = pc.simulate(balls(), (0.0, 3.0), q0=[1.0], events=bounce(1.0, terminal=True))
    first = np.sqrt(2 / G)
    assert (once.status, once.success) == (1, True) and "bounce0" in once.message
    assert once.t[-1] == once.t_events[0][0] == pytest.approx(first) and once.v[-1, 0] < 0  # before apply
    thrice = pc.simulate(balls(), (0.0, 9.0), q0=[1.0], events=bounce(1.0, terminal=3))
    np.testing.assert_allclose(thrice.t_events[0], first * np.array([1, 3, 5]), rtol=1e-10)
    assert thrice.status == 1 and thrice.t[-1] == thrice.t_events[0][2]


def test_functions_with_scipys_attributes():
    def ground(t, q, v, lam):
        return q[0]

    ground.terminal, ground.direction = 1, -1
    sol = pc.simulate(balls(), (0.0, 3.0), q0=[1.0], events=ground)
    assert sol.status == 1 and "ground" in sol.message and sol.t[-1] == pytest.approx(np.sqrt(2 / G))
    ground.direction = 1
    assert pc.simulate(balls(), (0.0, 1.0), q0=[1.0], events=ground).status == 0  # it only falls
    ground.terminal, ground.direction, ground.apply = False, 0, lambda t, q, v: -v
    back = pc.simulate(balls(), (0.0, 2 * np.sqrt(2 / G)), q0=[1.0], events=ground)
    np.testing.assert_allclose(back.q[-1], 1.0, rtol=1e-9)


@pytest.mark.parametrize(("direction", "count"), [(0, 6), (1, 3), (-1, 3)])
@pytest.mark.parametrize("backwards", [False, True])
def test_direction_counts_passages(direction, count, backwards):
    """x of a bead at 1 rad/s is zero at odd multiples of π/2: six times in 6π, falling first, either way in time."""
    span = (0.0, -6 * np.pi + 0.01) if backwards else (0.0, 6 * np.pi - 0.01)
    sol = pc.simulate(
        bead(), span, v0=(0.0, 1.0), events=pc.Event(lambda t, q, v, lam: q[0], direction=direction), rtol=1e-8
    )
    expected = (np.pi / 2 + np.pi * np.arange(6))[
        {0: slice(None), 1: slice(1, None, 2), -1: slice(0, None, 2)}[direction]
    ]
    assert len(sol.t_events[0]) == count
    np.testing.assert_allclose(np.abs(sol.t_events[0]), expected, atol=5e-5)
    assert (np.diff(sol.t_events[0]) * (span[1] - span[0]) > 0).all()


@pytest.mark.parametrize("span", [(0.0, 0.5), (-0.5, 0.0), (0.5, 0.0)])
@pytest.mark.parametrize("options", [{"step": 0.1}, {"rtol": 1e-3}])
def test_events_of_one_step_come_in_the_order_of_time(span, options):
    """Three marks are passed in one step; the second stops the run, and the third has not happened."""
    seen = []

    def mark(level, **more):
        def apply(t, q, v):
            seen.append(level)
            return v

        return pc.Event(lambda t, q, v, lam: q[0] - level, apply=apply, name=str(level), **more)

    marks = [mark(0.2), mark(0.6), mark(0.4, terminal=2), mark(0.4)]
    sol = pc.simulate(balls(), span, q0=[1.0], events=marks, **options)
    assert seen == [0.6, 0.4, 0.4, 0.2] or seen == [0.6, 0.4, 0.2, 0.4]
    times = [abs(float(t[0]) - span[0]) for t in sol.t_events]
    np.testing.assert_allclose(times, np.sqrt(2 * (1 - np.array([0.2, 0.6, 0.4, 0.4])) / G), rtol=1e-9)
    seen.clear()
    stopped = pc.simulate(balls(), span, q0=[1.0], events=[mark(0.2), mark(0.6), mark(0.4, terminal=True)], **options)
    assert seen == [0.6] and stopped.status == 1 and len(stopped.t_events[0]) == 0
    assert abs(stopped.t[-1] - span[0]) == pytest.approx(np.sqrt(1.2 / G))


def test_two_impacts_at_the_same_moment_both_happen():
    """Neither ball may fall through the floor because the other one hit it first."""
    note = pc.Event(lambda t, q, v, lam: q[0], name="note")
    sol = pc.simulate(balls(2), (0.0, 3.0), q0=[1.0, 1.0], events=[note, bounce(i=0), bounce(i=1)])
    expected = np.sqrt(2 / G) * np.array([1, 3, 5])
    for times in sol.t_events:
        np.testing.assert_allclose(times, expected, rtol=1e-10)
    assert sol.q.min() > -1e-12


@pytest.mark.parametrize(("method", "end"), [("Radau", 0.5), ("Radau", -0.5), ("BDF", 0.1)])
def test_impacts_in_close_succession_are_all_found(method, end):
    """A bead loses 0.2 % of its speed at each of 52 marks a half turn; several lie in what would be one step."""
    seen = []

    def slower(t, q, v):
        seen.append(np.linalg.norm(v))
        return 0.998 * v

    marks = pc.Event(lambda t, q, v, lam: np.sin(52 * np.arctan2(q[1], q[0])), apply=slower)
    sol = pc.simulate(bead(), (0.0, end), v0=(0.0, 12.0), events=marks, method=method)
    times = np.cumsum(np.pi / 52 / (12.0 * 0.998 ** np.arange(200)))
    times = times[times < abs(end)]
    np.testing.assert_allclose(np.abs(sol.t_events[0]), times, rtol=1e-6)
    speeds = 12.0 * 0.998 ** np.arange(len(times))
    np.testing.assert_allclose(seen, speeds, rtol=1e-6)
    angles = np.arctan2(sol.q_events[0][:, 1], sol.q_events[0][:, 0]) * np.sign(end)
    np.testing.assert_allclose(np.sin(52 * angles), 0.0, atol=1e-8)
    np.testing.assert_allclose(sol.lam[:-1][np.diff(sol.t) == 0.0][:, 0], -(speeds**2), rtol=1e-5)
    if method == "Radau":  # it goes on with the step that it had
        assert sol.nsteps <= len(times) + 20


def test_an_event_at_the_start_is_not_found_but_the_next_one_is():
    throw = pc.simulate(balls(), (0.0, 1.0), v0=[G / 4], events=pc.Event(lambda t, q, v, lam: q[0], terminal=True))
    assert throw.t_events[0].tolist() == pytest.approx([0.5])
    rest = pc.simulate(balls(), (0.0, 0.1), events=pc.Event(lambda t, q, v, lam: q[0], terminal=True))
    assert rest.status == 0 and len(rest.t_events[0]) == 0


def test_an_event_exactly_at_a_step_is_found_once():
    for when in (0.25, 0.5, 1.0):  # at a step, at another, at the end
        sol = pc.simulate(
            bead(),
            (0.0, 1.0),
            v0=(0.0, 1.0),
            step=0.125,
            order=2,
            events=lambda t, q, v, lam, w=when: t - w,
            method="BDF",
        )
        assert sol.t_events[0].tolist() == [when] and sol.status == 0


def test_an_event_that_changes_the_state_at_the_very_end():
    event = pc.Event(lambda t, q, v, lam: t - 1.0, apply=lambda t, q, v: 0.5 * v)
    sol = pc.simulate(bead(), (0.0, 1.0), v0=(0.0, 1.0), step=0.125, events=event)
    assert sol.status == 0 and sol.t[-2:].tolist() == [1.0, 1.0]
    np.testing.assert_allclose(sol.v[-1], 0.5 * sol.v[-2], atol=1e-14)
    assert sol.lam[-1, 0] == pytest.approx(-0.25, abs=1e-3)


@pytest.mark.parametrize("options", [{}, {"step": 0.01}])
def test_backwards_impacts_undo_forward_ones(options):
    event = bounce(1.0)
    there = pc.simulate(balls(), (0.0, 2.0), q0=[1.0], events=event, **options)
    back = pc.integrate(balls(), (2.0, 0.0), there.q[-1], there.v[-1], events=event, **options)
    np.testing.assert_allclose(back.t_events[0], there.t_events[0][::-1], rtol=1e-9)
    np.testing.assert_allclose((back.q[-1, 0], back.v[-1, 0]), (1.0, 0.0), atol=1e-9)


def test_apply_may_return_the_position_too():
    """A bead put back to the start of the circle each time it comes to the top."""
    event = pc.Event(lambda t, q, v, lam: q[0], direction=-1, apply=lambda t, q, v: ((1.0, 0.0), (0.0, 2.0)))
    sol = pc.simulate(bead(), (0.0, 2.0), v0=(0.0, 2.0), events=event, rtol=1e-8)
    np.testing.assert_allclose(sol.t_events[0], np.pi / 4 * np.array([1, 2]), atol=1e-6)
    angle = np.arctan2(sol.q[-1, 1], sol.q[-1, 0])
    assert angle == pytest.approx(2 * (2.0 - np.pi / 2), abs=1e-5)


def test_what_apply_returns_is_put_on_the_constraints():
    """Position moved off the circle and a velocity with a radial part: both come back to the nearest that fits."""

    def apply(t, q, v):
        return 1.001 * q, v + 3.0 * q

    event = pc.Event(lambda t, q, v, lam: q[0] - 0.5, apply=apply)
    with pytest.warns(UserWarning, match="projected"):  # the radial part is lost
        sol = pc.simulate(bead(), (0.0, 1.0), v0=(0.0, 2.0), events=event, rtol=1e-8)
    jump = int(np.flatnonzero(np.diff(sol.t) == 0.0)[0])
    np.testing.assert_allclose(sol.q[jump + 1], sol.q[jump], atol=1e-12)
    np.testing.assert_allclose(sol.v[jump + 1], sol.v[jump], atol=1e-12)
    assert sol.check(error=False).velocity < 1e-9 and np.abs(sol.lam + 4.0).max() < 1e-4  # a twentieth of rtol |v|


@pytest.mark.parametrize("returned", [(1.0, 2.0, 3.0), np.array([np.nan, 0.0]), (np.zeros(2), np.zeros(3)), "stop"])
def test_a_bad_apply_ends_the_run_with_its_name(returned):
    event = pc.Event(lambda t, q, v, lam: q[0] - 0.5, apply=lambda t, q, v: returned, name="kick")
    try:
        sol = pc.simulate(bead(), (0.0, 1.0), v0=(0.0, 2.0), events=event)
    except pc.InputError as error:
        message = str(error)
    else:
        assert sol.status == -1 and sol.t[-1] < 0.6
        message = sol.message
    assert "kick" in message and "apply" in message


def test_apply_gets_copies_and_none_keeps_the_state():
    def apply(t, q, v):
        q[:] = np.nan
        v[:] = np.nan

    event = pc.Event(lambda t, q, v, lam: q[0] - 0.5, apply=apply)
    sol = pc.simulate(bead(), (0.0, 1.0), v0=(0.0, 2.0), events=event, rtol=1e-8)
    assert sol.status == 0 and len(sol.t_events[0]) == 1
    np.testing.assert_allclose(sol.lam, -4.0, atol=1e-4)


def test_a_latch_switches_a_force_and_restarts():
    """A ball falls 1 m; there a support takes its weight, and it goes on at constant speed: exact only if restarted."""
    state = {"held": False}

    def support(t, q, v):
        return np.array([G if state["held"] else 0.0])

    def latch(t, q, v):
        state["held"] = True

    event = pc.Event(lambda t, q, v, lam: q[0], direction=-1, apply=latch, name="latch")
    sol = pc.simulate(balls(), (0.0, 1.0), q0=[1.0], forces=[support], events=event)
    hit, speed = np.sqrt(2 / G), np.sqrt(2 * G)
    assert sol.q[-1, 0] == pytest.approx(-speed * (1.0 - hit), abs=1e-9)
    after = sol.t > hit
    np.testing.assert_allclose(sol.v[after, 0], -speed, rtol=1e-10)
    assert sum(sol.rejected.values()) == 0  # the jump was never integrated over


def test_a_latch_that_stops_a_joint():
    """Perfectly plastic: v = 0 on apply, held by its multiplier from the first row on."""
    event = pc.Event(lambda t, q, v, lam: q[0] - 0.5, apply=lambda t, q, v: 0.0 * v)
    sol = pc.simulate(bead(), (0.0, 2.0), v0=(0.0, 2.0), events=event, rtol=1e-8)
    after = sol.t > sol.t_events[0][0]
    assert after.any() and np.abs(sol.v[after]).max() < 1e-12 and np.abs(sol.lam[after]).max() < 1e-10


def test_an_event_without_apply_changes_nothing():
    watched = pc.simulate(bead(), (0.0, 2.0), v0=(0.0, 2.0), events=lambda t, q, v, lam: q[0], method="BDF")
    plain = pc.simulate(bead(), (0.0, 2.0), v0=(0.0, 2.0), method="BDF")
    np.testing.assert_array_equal(watched.q, plain.q)
    assert len(watched.t_events[0]) == 1 and watched.nfev == plain.nfev


def test_events_see_the_multipliers_of_all_rows():
    """The hinge of a planar loop has rows that are zero; an event on λ sees all five, as the solution has them."""
    sizes = set()

    def pull(t, q, v, lam):
        sizes.add(lam.shape)
        return lam[0] - 5.0

    sol = pc.simulate(pc.load("four_bar"), (0.0, 2.0), events=pull, dense_output=True, method="BDF")
    assert sizes == {(5,)} and len(sol.t_events[0]) > 0
    for t in sol.t_events[0]:
        assert sol.sol(t)[2][0] == pytest.approx(5.0, abs=1e-9)


@pytest.mark.parametrize("options", [{}, {"step": 0.02}])
def test_events_with_t_eval_and_dense_output(options):
    times = np.linspace(0.0, 3.0, 61)
    event = bounce(0.8, direction=-1)
    rows = pc.simulate(balls(), (0.0, 3.0), q0=[1.0], events=event, t_eval=times, dense_output=True, **options)
    assert rows.t.tolist() == times.tolist() and len(rows.h) == 0
    hits, start, z, speed = impact_times(1.0, 0.8, 3.0), 0.0, 1.0, 0.0
    expected = np.empty(61)
    for begin, end in zip((0.0, *hits), (*hits, 3.1), strict=True):
        if begin:
            start, z, speed = begin, 0.0, np.sqrt(2 * G) * 0.8 ** (1 + np.flatnonzero(hits == begin)[0])
        inside = (times >= begin) & (times < end)
        expected[inside] = z + speed * (times[inside] - start) - G * (times[inside] - start) ** 2 / 2
    np.testing.assert_allclose(rows.q[:, 0], expected, atol=1e-9)
    np.testing.assert_allclose(rows.sol(times)[0][:, 0], expected, atol=1e-9)
    hit = rows.t_events[0][0]
    assert rows.sol(hit)[1][0] < 0 < rows.sol(hit + 1e-9)[1][0]


# --- callbacks, interrupts, limits


def test_a_callback_sees_every_row_and_stops():
    seen = []

    def callback(t, q, v, lam):
        seen.append(t)
        return t > 0.5

    sol = pc.simulate(bead(), (0.0, 1.0), v0=(0.0, 2.0), step=0.05, order=2, callback=callback, method="BDF")
    assert seen == sol.t.tolist() and (sol.status, sol.success) == (1, True)
    at_once = pc.simulate(bead(), (0.0, 1.0), v0=(0.0, 2.0), callback=lambda *state: True, method="BDF")
    assert at_once.t.tolist() == [0.0] and at_once.status == 1


@pytest.mark.parametrize("options", [{}, {"step": 0.01}, {"t_eval": [0.0, 0.1, 0.2, 0.9]}, {"dense_output": True}])
def test_an_interrupt_in_a_callback_returns_what_was_reached(options):
    def callback(t, q, v, lam):
        if t > 0.3:
            raise KeyboardInterrupt

    sol = pc.simulate(pc.load("four_bar"), (0.0, 1.0), callback=callback, **options)
    assert (sol.status, sol.success) == (1, True) and "interrupted" in sol.message
    assert (0.19 if "t_eval" in options else 0.3) < sol.t[-1] < 0.9 and sol.q.shape == (len(sol.t), 3)
    assert sol.check(error=False).position < 1e-7 and "interrupted" in sol.summary()


@pytest.mark.parametrize("call", [1, 2, 4, 30, 300])
def test_an_interrupt_in_a_force_returns_what_was_reached(call):
    """Before the first row, in the start, in the middle."""
    calls = [0]

    def law(t, q, v):
        calls[0] += 1
        if calls[0] == call:
            raise KeyboardInterrupt
        return 0.0 * v

    sol = pc.simulate(pc.load("four_bar"), (0.0, 2.0), forces=[law], method="BDF")
    n = len(sol.t)
    assert (sol.status, n) == (1, {1: 0, 2: 1, 4: 1, 30: 1}.get(call, n)) and "interrupted" in sol.message
    assert (sol.q.shape, sol.v.shape, sol.lam.shape) == ((n, 3), (n, 3), (n, 5))
    assert sol.summary() and (call < 300 or n > 20)


def test_an_interrupt_in_an_event_returns_what_was_reached():
    def event(t, q, v, lam):
        if t > 0.3:
            raise KeyboardInterrupt
        return 1.0

    sol = pc.simulate(pc.load("four_bar"), (0.0, 1.0), events=event)
    assert sol.status == 1 and 0.1 < sol.t[-1] <= 0.3 and len(sol.t_events[0]) == 0


def test_max_steps_with_t_eval_keeps_the_rows_reached():
    sol = pc.simulate(bead(), (0.0, 1.0), v0=(0.0, 2.0), step=0.01, t_eval=[0.0, 0.1, 0.9], max_steps=20)
    assert (sol.status, sol.nsteps) == (-1, 20) and sol.t.tolist() == [0.0, 0.1]


@pytest.mark.parametrize("value", [np.nan, np.zeros(2), "x"])
def test_an_event_that_is_no_number_ends_the_run_with_its_name(value):
    event = pc.Event(lambda t, q, v, lam: value if t > 0.5 else 1.0, name="latch")
    sol = pc.simulate(pc.load("four_bar"), (0.0, 1.0), events=event)
    assert not sol.success and "'latch'" in sol.message and 0.3 < sol.t[-1] <= 0.6


@pytest.mark.parametrize("failure", [np.nan, KeyError("lost"), KeyboardInterrupt()])
def test_an_event_that_fails_only_where_it_is_located_ends_the_run(failure):
    """Between the looks into a step of Radau."""

    def law(t, q, v, lam):
        if abs(t - 0.5) > 1e-4:
            return t - 0.5
        if isinstance(failure, BaseException):
            raise failure
        return failure

    sol = pc.simulate(pc.load("four_bar"), (0.0, 1.0), method="Radau", events=pc.Event(law, name="latch"))
    assert 0.0 < sol.t[-1] < 0.5 and len(sol.t_events[0]) == 0
    if isinstance(failure, KeyboardInterrupt):
        assert sol.status == 1 and "interrupted" in sol.message
    else:
        assert sol.status == -1 and "the event 'latch'" in sol.message


@pytest.mark.parametrize("whose", ["callback", "apply"])
def test_what_a_users_function_raises_on_the_way_is_told_and_loses_nothing(whose):
    def late(t, *state):
        if t > 0.5:
            raise KeyError("lost")

    event = pc.Event(lambda t, q, v, lam: t - 0.6, apply=late, name="bump")
    wish = {"callback": late} if whose == "callback" else {"events": event}
    sol = pc.simulate(pc.load("four_bar"), (0.0, 1.0), **wish)
    assert sol.status == -1 and 0.4 < sol.t[-1] <= 0.6 + 1e-9
    what = "the callback" if whose == "callback" else "apply of the event 'bump'"
    assert sol.message.startswith(f"{what} raised KeyError: 'lost' (at t = ")


@pytest.mark.parametrize("power", [3, 9])
def test_a_zero_of_higher_order_is_located(power):
    """The secants of Brent's method are no help at such a zero; halving is."""
    event = pc.Event(lambda t, q, v, lam: (t - 0.5) ** power, terminal=True, name="flat")
    sol = pc.simulate(pc.load("four_bar"), (0.0, 1.0), events=event, method="BDF")
    assert sol.status == 1 and abs(sol.t[-1] - 0.5) < 1e-12


def test_a_callback_cannot_change_the_solution():
    seen = []

    def change(t, q, v, lam):
        for array in (q, v, lam):
            seen.append(array.copy())
            with pytest.raises(ValueError, match="read-only"):
                array[:] = 0.0

    sol = pc.simulate(pc.load("four_bar"), (0.0, 0.2), callback=change)
    assert sol.success and len(seen) == 3 * len(sol.t)
    np.testing.assert_array_equal(seen[-3], sol.q[-1])


@pytest.mark.parametrize("method", ["Radau", "BDF"])
@pytest.mark.parametrize("late", [1e-14, 1e-12])
def test_an_event_just_after_the_start_of_a_step(method, late):
    """No step can be made up to there."""
    mech, options = pc.load("crank_rocker"), {"method": method}
    sol = pc.simulate(mech, (0.0, 0.1), events=lambda t, q, v, lam: t - late, **options)
    assert sol.success and len(sol.t_events[0]) == 1 and abs(sol.t_events[0][0] - late) < 1e-11
    sim = pc.Simulation(mech, events=lambda t, q, v, lam: t - 0.8, **options)
    for _ in range(9):  # 8 of them end at 0.7999999999999999
        sim.step(0.1)
    assert np.abs(np.array(sim.events[0]) - 0.8).max() < 1e-15 and len(sim.events[0]) == 1


@pytest.mark.parametrize("method", ["Radau", "BDF"])
def test_infinite_values_have_a_sign(method):
    jump = pc.Event(lambda t, q, v, lam: np.inf if t > 0.05 else -np.inf)
    sol = pc.simulate(pc.load("crank_rocker"), (0.0, 0.1), method=method, events=jump)
    assert len(sol.t_events[0]) == 1 and abs(sol.t_events[0][0] - 0.05) < 1e-7


@pytest.mark.parametrize("method", ["Radau", "BDF"])
@pytest.mark.parametrize("force", [
    pc.HeldTorque([0.0, 0.1], [0.0, 60.0], "crank"), pc.Piecewise({"crank": lambda t: 60.0 * (t > 0.1)}, times=[0.1]),
    pc.Sampled(0.05, lambda t, q, v: [60.0 * (t > 0.08)], "crank"),
], ids=lambda force: type(force).__name__)  # fmt: skip
def test_multipliers_that_jump_past_zero(method, force):
    """They jump from 19 to 105 N; the event was found only where they fell again."""
    mech, run = pc.load("crank_rocker"), {"method": method, "forces": [force]}
    overload = pc.Event(lambda t, q, v, lam: lam[0] - 50.0, terminal=True, name="overload")
    sol = pc.simulate(mech, (0.0, 0.15), events=overload, **run)
    assert sol.message == "stopped by the event overload at t = 0.1"
    assert sol.t[-1] == sol.t[-2] == 0.1 and sol.lam[-2, 0] < 50.0 < sol.lam[-1, 0]
    lock = pc.Event(lambda t, q, v, lam: lam[0] - 50.0, apply=lambda t, q, v: 0.5 * v)
    sol = pc.simulate(mech, (0.0, 0.11), v0={"crank": 1.0}, events=lock, **run)
    v = sol.v[sol.t == 0.1]
    assert np.abs(v[-1] - 0.5 * v[0]).max() < 1e-8


@pytest.mark.parametrize(("fields", "words"), [
    ({"function": 1.0}, "needs a function g"), ({"apply": 3}, "apply of an event must be a function"),
    ({"terminal": "yes"}, "terminal of an event must be True"), ({"terminal": 1.5}, "occurrences, and direction"),
    ({"direction": "up"}, "direction a number"), ({"terminal": -1}, "got -1"),
], ids=str)  # fmt: skip
def test_impossible_events_are_refused_before_the_run(fields, words):
    with pytest.raises(pc.InputError, match=words):
        pc.Event(**{"function": lambda t, q, v, lam: t} | fields)


def _kicked(apply, method, **options):
    """The velocities of four_bar before and after an event at 0.3 s."""
    event = pc.Event(lambda t, q, v, lam: t - 0.3, apply=apply, name="kick")
    run = {"v0": {"crank": 3.0}, "events": event, "method": method}
    sol = pc.simulate(pc.load("four_bar"), (0.0, 0.5), **run, **options)
    assert sol.success, sol.message
    jump = int(np.flatnonzero(np.diff(sol.t) == 0.0)[0])
    return sol.v[jump], sol.v[jump + 1]


@pytest.mark.parametrize("method", ["Radau", "BDF"])
@pytest.mark.parametrize("options", [{}, {"step": 0.01}])
def test_a_joint_keeps_the_velocity_that_apply_gives_it_by_name(method, options):
    """A linkage of one degree of freedom: all velocities are multiplied alike."""
    for apply in (lambda t, q, v: {"crank": -0.5 * v[0]}, lambda t, q, v: (q, {"rocker": -0.5 * v[2]})):
        before, after = _kicked(apply, method, **options)
        np.testing.assert_allclose(after, -0.5 * before, rtol=1e-6)


def test_a_velocity_that_the_projection_changes_is_told_once():
    def reverse(t, q, v):
        v[0] *= -0.5
        return v

    with pytest.warns(UserWarning, match="kick.*velocity of crank to .* mapping"):
        before, after = _kicked(reverse, "Radau")
    assert not np.allclose(after[0], -0.5 * before[0], rtol=0.1)
    assert _kicked(lambda t, q, v: -0.5 * v, "Radau")  # warnings are errors here
    marks = pc.Event(lambda t, q, v, lam: np.sin(40.0 * t), apply=reverse, name="marks")
    with pytest.warns(UserWarning) as told:
        pc.simulate(pc.load("four_bar"), (0.0, 0.5), v0={"crank": 3.0}, events=marks)
    assert len(told) == 1


def test_unnamed_joints_change_as_by_impulses_at_the_named_ones():
    """A double pendulum whose first joint is stopped: the second one gets M22 Δv2 = -M12 Δv1; another body nothing."""
    model = pin.Model()
    first = scenes.add_body(model, 0, pin.JointModelRY(), scenes.at(0, 0), "first", 1.3, (0, 0, -0.4), 0.1)
    scenes.add_body(model, first, pin.JointModelRY(), scenes.at(0, -0.9), "second", 0.7, (0.1, 0, -0.3), 0.05)
    scenes.add_body(model, 0, pin.JointModelPX(), scenes.at(2, 0), "apart", 1.0, (0, 0, 0), 0.1)
    mech = pc.Mechanism(model)
    event = pc.Event(lambda t, q, v, lam: t - 0.2, apply=lambda t, q, v: {"first": -1.0})
    sol = pc.simulate(mech, (0.0, 0.3), q0={"first": 0.4, "second": 0.3}, v0=[2.0, -1.0, 5.0], events=event)
    jump = int(np.flatnonzero(np.diff(sol.t) == 0.0)[0])
    (q, before, after), data = (sol.q[jump], sol.v[jump], sol.v[jump + 1]), model.createData()
    M = pin.crba(model, data, q)
    impulses = M @ (after - before)
    assert after[0] == pytest.approx(-1.0, abs=1e-12)
    np.testing.assert_allclose(impulses[1:], 0.0, atol=1e-12)


@pytest.mark.parametrize(("returned", "words"), [
    ({"crnk": 1.0}, "no joint 'crnk'"), ({"crank": 1.0, "rocker": 9.0}, "name fewer joints"),
    ({"crank": "fast"}, "crank"), ({"crank": np.nan}, "crank"),
], ids=str)  # fmt: skip
def test_a_mapping_that_cannot_be_used_ends_the_run_with_a_reason(returned, words):
    event = pc.Event(lambda t, q, v, lam: t - 0.3, apply=lambda t, q, v: returned, name="kick")
    sol = pc.simulate(pc.load("four_bar"), (0.0, 0.5), v0={"crank": 3.0}, events=event)
    assert sol.status == -1 and sol.message.startswith("apply of the event 'kick' at t = 0.3") and words in sol.message


def test_a_general_problem_has_no_joints_to_name():
    problem = pc.HessenbergProblem(
        U=lambda t, p, v: v, F=lambda t, p, v: np.array([0.0, -G]), G=lambda t, p, v: p[:, None],
        R=lambda t, p: np.array([p @ p / 2 - 0.5]),
    )  # fmt: skip
    event = pc.Event(lambda t, q, v, lam: t - 0.1, apply=lambda t, q, v: {"x": 1.0}, name="kick")
    sol = pc.integrate(problem, (0.0, 0.2), np.array([1.0, 0.0]), np.zeros(2), events=event)
    assert sol.status == -1 and "'kick'" in sol.message and "a general problem has no joints" in sol.message
