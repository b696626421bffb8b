"""Pulses, jumps and bends of functions of time are seen, after a rest too, against SciPy and closed forms."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline, PchipInterpolator

import pinconsist as pc
from benchmarks import pulses
from pinconsist.mechanism.sampling import changes

SHORT = (0.005,)  # of the span


@pytest.mark.parametrize("scene", pulses.SCENES, ids=lambda scene: f"{scene[0]}-{scene[1].__name__}-{scene[2]}")
def test_a_pulse_of_half_a_percent_of_the_span_is_seen(scene):
    """By both methods, in both directions; a run that misses it is off by thousands of tolerances."""
    for row in pulses.measured([scene], widths=SHORT):
        assert row.error < 10.0, row


def test_two_pulses_in_a_table_of_commands_are_seen():
    for row in pulses.random_tables(runs=6, seed=5):
        assert row.worst < 10.0, row


def test_a_wrench_of_40_ms_moves_a_body_by_its_impulse():
    force = pc.Wrench("body_frame", force=lambda t: (0.0, 0.0, 50.0 if 4.0 <= t < 4.04 else 0.0))
    mech = pulses.suspension().with_loops(pc.Drive("road", "wheel", pc.Motion()))
    free = replace(mech, forces=(force,))
    for method in ("BDF", "Radau"):
        sol = pc.simulate(free, (0.0, 10.0), method=method)
        assert sol.v[-1, 1] == pytest.approx(50.0 * 0.04 / pulses.MASS, rel=1e-6)
        assert sol.q[-1, 1] == pytest.approx(50.0 * 0.04 / pulses.MASS * (10.0 - 4.02), rel=1e-6)
        assert sol.check().error.v < 1e-5


@pytest.mark.parametrize("method", ["BDF", "Radau"])
def test_max_step_is_no_trap(method):
    """Differences over 3 ms saw the bump before it began."""
    bump = pulses.Pulse(pulses.cosine, 0.05, 0.2)
    sol = pc.simulate(pulses.drive(bump), (0.0, 10.0), method=method, max_step=0.05)
    assert sol.success
    np.testing.assert_allclose(sol.q[:, 0], [bump(t) for t in sol.t], atol=1e-9)


@pytest.mark.parametrize("method", ["BDF", "Radau"])
def test_a_drive_with_a_jump_of_its_rate_acts_as_an_impulse(method):
    """The wheel starts to move at once; what is above it, held by a spring only, does not."""
    mech = pulses.suspension().with_loops(pc.Drive("road", "wheel", lambda t: max(0.0, t - 1.2345)))
    sol = pc.simulate(mech, (0.0, 2.0), method=method)
    (i,) = np.flatnonzero(np.diff(sol.t) == 0.0)
    assert sol.t[i] == pytest.approx(1.2345, abs=1e-9)
    np.testing.assert_allclose(sol.v[i], 0.0, atol=1e-9)
    np.testing.assert_allclose(sol.v[i + 1], [1.0, -1.0], atol=1e-8)
    rhs = pulses.equation("push", lambda t: 0.0)
    end = solve_ivp(rhs, (1.2345, 2.0), [0.0, -1.0], rtol=1e-11, atol=1e-12).y[:, -1]
    np.testing.assert_allclose([sol.q[-1, 1], sol.v[-1, 1]], end, atol=1e-5)


TIMES, VALUES = [1.0, 1.5, 2.0, 2.2], [0.0, 0.1, 0.05, 0.05]


def test_the_curve_of_a_table_is_a_spline_at_rest_at_both_ends():
    drive = pc.Drive("road", "wheel", (TIMES, VALUES))
    spline = CubicSpline(TIMES, VALUES, bc_type="clamped")
    for method in ("BDF", "Radau"):
        sol = pc.simulate(pulses.suspension().with_loops(drive), (0.0, 3.0), method=method)
        assert sol.success and set(TIMES) <= set(sol.t)
        inside = np.clip(sol.t, TIMES[0], TIMES[-1])
        np.testing.assert_allclose(sol.q[:, 0], spline(inside), atol=1e-12)
        np.testing.assert_allclose(sol.v[:, 0], spline(inside, 1), atol=1e-9)
        doubled = sol.t[1:][np.diff(sol.t) == 0.0]
        np.testing.assert_array_equal(doubled, [TIMES[0], TIMES[-1]])  # where its acceleration jumps


@pytest.mark.parametrize("kind", [PchipInterpolator, CubicSpline])
def test_steps_end_at_the_knots_of_scipys_splines(kind):
    curve = kind([0.0, *TIMES, 3.0], [0.0, *VALUES, 0.0])
    rate, bend = curve.derivative(1), curve.derivative(2)
    for drive in (pc.Drive("road", "wheel", curve), pc.Drive("road", "wheel", curve, rate, bend)):
        sol = pc.simulate(pulses.suspension().with_loops(drive), (0.0, 3.0))
        assert sol.success and set(TIMES) <= set(sol.t)
        np.testing.assert_allclose(sol.v[:, 0], rate(sol.t), atol=1e-8)


def test_knots_of_a_drive():
    bump = pulses.Pulse(pulses.cosine, 0.05, 0.2)
    ends = pulses.BEGIN, pulses.BEGIN + 0.2
    drive = pc.Drive("road", "wheel", bump, knots=ends)
    sol = pc.simulate(pulses.suspension().with_loops(drive), (0.0, 10.0))
    assert set(ends) <= set(sol.t)
    np.testing.assert_allclose(sol.q[:, 0], [bump(t) for t in sol.t], atol=1e-12)
    assert pc.simulate(pulses.suspension().with_loops(drive), (0.0, 5.0), step=0.01).success


@pytest.mark.parametrize(
    "table, words",
    [
        (
            [(0, 0), (1, 1)],
            r"times of a table must increase.*for a list of points pass their transpose",
        ),
        (([0, 1, 2], [0, 1]), r"two rows of the same length, at least 2; got shapes \(3,\) and \(2,\)"),
        ([1.0, 2.0, 3.0], r"a function of time or a table \(times, values\)"),
        (([0, 1], [0, np.nan]), "not finite"),
    ],
)
def test_bad_tables_are_named(table, words):
    with pytest.raises(pc.InputError, match=r"drive 'road'.*" + words):
        pc.Drive("road", "wheel", table)


@pytest.mark.parametrize("size", [0.0, 3.0])
def test_gradients_by_the_nodes_of_a_table(size):
    """Steps across nodes had them wrong by a third where all values were zero."""
    mech, times = pc.load("four_bar").add_forces(pc.Actuator("motor", "crank")), np.linspace(0.0, 0.3, 50)
    values = size * np.random.default_rng(1).standard_normal(50)
    names = [f"motor.control.values[{i}]" for i in range(50)]
    options = {"rtol": 1e-8, "atol": 1e-10}

    def end(values):
        sol = pc.simulate(mech, (0.0, 0.3), control={"motor": (times, values)}, method="Radau", rtol=1e-12, atol=1e-13)
        return sol.q[-1]

    commanded = mech.with_control({"motor": (times, values)})
    dq = pc.sensitivities(commanded, names, (0.0, 0.3), **options).dq[-1]
    back = pc.gradient(commanded, names, (0.0, 0.3), terminal=lambda t, q, v, lam: q[0], **options)
    np.testing.assert_allclose(back.gradient, dq[0], atol=1e-8 * np.abs(dq).max())
    for i in (0, 10, 49):
        e = 0.3 * np.eye(50)[i]
        differences = (8.0 * (end(values + e) - end(values - e)) - end(values + 2 * e) + end(values - 2 * e)) / 3.6
        np.testing.assert_allclose(dq[:, i], differences, atol=1e-7 * np.abs(dq).max())


def test_gradients_past_a_jump_of_a_function_of_time():
    base = pc.load("four_bar")

    def build(theta):
        return base.add_forces({"crank": lambda t: theta[0] * (0.0771 <= t < 0.2)})

    def end(x):
        return pc.simulate(build([x]), (0.0, 0.3), method="Radau", rtol=1e-12, atol=1e-13).q[-1]

    exact = (8.0 * (end(1.1) - end(0.9)) - end(1.2) + end(0.8)) / 1.2
    dq = pc.sensitivities(build, [1.0], (0.0, 0.3), rtol=1e-8, atol=1e-10).dq[-1]
    np.testing.assert_allclose(dq[:, 0], exact, atol=1e-6 * np.abs(exact).max())


def test_a_long_step_of_a_simulation_sees_pulses():
    pulse = pulses.Pulse(pulses.smooth, 20.0, 0.05)
    sim, whole = pc.Simulation(pulses.torque(pulse)), pc.simulate(pulses.torque(pulse), (0.0, 10.0), method="Radau")
    for _ in range(2):
        sim.step(5.0)
    np.testing.assert_allclose(sim.state.q, whole.q[-1], atol=1e-6)
    table = pulses.table(pulse)
    sim, whole = pc.Simulation(table), pc.simulate(table, (0.0, 10.0), method="Radau")
    sim.step(10.0)
    np.testing.assert_allclose(sim.state.q, whole.q[-1], atol=1e-6)


def test_a_recorded_run_sees_pulses_and_is_made_again(tmp_path):
    pulse = pulses.Pulse(pulses.sine, 20.0, 0.05)
    mech = pulses.torque(pulse)
    whole = pc.simulate(mech, (0.0, 10.0))
    sol = pc.record(mech, (0.0, 10.0), tmp_path / "run.npz", save_every=4.0)
    np.testing.assert_allclose(sol.q[-1], whole.q[-1], atol=1e-6)
    assert pc.rerun(tmp_path / "run.npz", scene=mech).same


def test_functions_are_called_a_bounded_number_of_times_and_only_within_the_span():
    called = []

    def force(t):
        called.append(t)
        return 20.0 * (t > 2.3456)

    for span in ((1.0, 3.0), (3.0, 1.0)):
        called.clear()
        sol = pc.simulate(pulses.torque(force), span, method="Radau")
        assert sol.success and len(called) < 6000
        assert min(called) >= 1.0 - 1e-12 and max(called) <= 3.0 + 1e-12
        assert np.abs(sol.t - 2.3456).min() < 1e-12


def test_laws_are_not_disturbed():
    """One that does not use time is not sampled; of one that is an object, a copy is."""
    called = []

    def damper(t, q, v):
        called.append(v[0])
        return -0.1 * v

    mech = pulses.parallelogram()
    pc.simulate(mech, (0.0, 1.0), forces=[damper], method="Radau", step=0.5, order=1)
    plain = len(called)
    called.clear()
    pc.simulate(mech, (0.0, 1.0), forces=[damper], method="Radau")
    assert len(called) < 2000 and plain < 200

    class Counter:
        calls = 0

        def __call__(self, t, q, v):
            self.calls += 1
            return np.array([20.0 * (t > 0.54321), 0.0, 0.0])

    counter = Counter()
    sol = pc.simulate(mech, (0.0, 1.0), forces=[counter], method="Radau")
    assert counter.calls < 1900 and np.abs(sol.t - 0.54321).min() < 1e-12


def orders(function, a=0.0, b=10.0, n=1999):
    return [(each.time, each.order) for each in changes(function, a, b, n)]


@pytest.mark.parametrize("order, near", [(0, 1e-12), (1, 1e-9), (2, 1e-5)])
@pytest.mark.parametrize("a, b", [(0.0, 10.0), (10.0, 0.0), (1e6, 1e6 + 10.0)])
def test_jumps_and_bends_are_found_where_they_are(order, near, a, b):
    at = min(a, b) + np.pi
    found = orders(lambda t: float(t > at) * (t - at) ** order, a, b)
    times = [time for time, each in found if each == order]
    assert times and np.abs(np.array(times) - at).max() < near + 1e-9 * (a > 1e5)


@pytest.mark.parametrize(
    "function",
    [np.sin, np.exp, lambda t: t**3, lambda t: np.sin(20.0 * t), lambda t: 3.0, lambda t: np.sin(600.0 * np.pi * t)],
)
def test_smooth_and_fast_functions_have_no_break_points(function):
    assert orders(function) == []


def test_periodic_functions_do_not_end_steps_without_number():
    assert len(orders(lambda t: np.sin(2000.0 * np.pi * t), 0.0, 100.0, 9973)) < 20
    noise = np.random.default_rng(3).standard_normal(20000)
    assert len(orders(lambda t: noise[int(1e3 * t)])) < 20


def test_every_part_of_a_table_counts():
    """A straight table between unequal times, against its exact integral."""
    times, values = [0.0, 3.0, 3.001, 3.004, 6.0], [0.0, 0.0, 200.0, 0.0, 0.0]
    mech = pulses.with_motor(times, values)
    impulse = sum(0.5 * (b - a) * (u + v) for (a, u), (b, v) in pairwise(zip(times, values, strict=True)))
    bare = replace(mech, forces=mech.forces[-1:])
    sol = pc.simulate(bare, (0.0, 6.0))
    assert sol.v[-1, 0] == pytest.approx(impulse / pulses.INERTIA, rel=1e-6)


RISE, FALL, HEIGHT = 0.4, 0.55, 0.05  # s, s, m


def road(t):
    """A bump whose acceleration jumps where it begins and ends."""
    part = (t - RISE) / (FALL - RISE)
    return HEIGHT * np.sin(np.pi * part) ** 2 if 0.0 < part < 1.0 else 0.0


def road_acceleration(t):
    inside = (RISE < t) & (t < FALL)
    w = 2.0 * np.pi / (FALL - RISE)
    return np.where(inside, 0.5 * HEIGHT * w**2 * np.cos(w * (t - RISE)), 0.0)


@pytest.mark.parametrize("method", ["BDF", "Radau"])
@pytest.mark.parametrize("knots", [(), (RISE, FALL)])
@pytest.mark.parametrize("offset", [0.0, 3.0])
def test_forces_near_knots_are_those_of_their_side(tmp_path, method, knots, offset):
    """λ = m (g + z''): differences neither reach across knots, nor take rounding for a slope next to them.

    With an offset the constraint is the small difference of larger numbers, as with the pose of a frame.
    """
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "z")
    model.appendBodyToJoint(joint, pin.Inertia(2.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    follows = pc.Constraint(
        "road", lambda t, q: np.array([(q[0] + offset) - (road(t) + offset)]), 1, lambda t, q: np.eye(1), knots=knots
    )
    mech = pc.Mechanism(model, [follows])
    sol = pc.simulate(mech, (0.0, 1.0), method=method)
    size = 2.0 * HEIGHT * 0.5 * (2.0 * np.pi / (FALL - RISE)) ** 2
    away = np.abs(sol.t[:, None] - [RISE, FALL]).min(axis=1) > 1e-7  # knots that are found are not exact
    known = 2.0 * (9.81 + road_acceleration(sol.t))
    np.testing.assert_allclose(sol.lam[away, 0], known[away], atol=3e-5 * size)
    np.testing.assert_allclose(sol.acceleration("z")[away], road_acceleration(sol.t)[away], atol=3e-5 * size)
    assert sol.check().ok, sol.check().verdict
    times = np.sort(np.concatenate([knot + np.array([-2e-3, -1e-4, -1e-6, 1e-6, 1e-4, 2e-3]) for knot in (RISE, FALL)]))
    for each, scene in ((sol, None), (pc.Solution.load(sol.save(tmp_path / "run")), mech)):
        found = each.at(times, scene)
        np.testing.assert_allclose(found.lam[:, 0], 2.0 * (9.81 + road_acceleration(times)), atol=3e-5 * size)
        np.testing.assert_allclose(found.acceleration("z", scene), road_acceleration(times), atol=3e-5 * size)


def test_splines_that_swing_far_beyond_their_table_are_told(recwarn):
    """Through a bump of 5 cm between long rests the spline goes to -29 cm."""
    times, values = [0.0, 1.0, 1.05, 1.15, 1.2, 3.0], [0.0, 0.0, 0.05, 0.05, 0.0, 0.0]
    drive = pc.Drive("bump", "road", (times, values))
    assert min(drive.curve(t) for t in np.linspace(0.0, 3.0, 200)) < -0.28
    assert "goes from -0.2888 to 0.06927, far beyond its values, 0 … 0.05" in str(recwarn[0].message)
    pchip = PchipInterpolator(times, values)  # what it advises
    assert min(pchip(t) for t in np.linspace(0.0, 3.0, 200)) >= 0.0
    pc.Drive("bump", "road", pchip)
    rng = np.random.default_rng(1)
    for _ in range(100):
        pc.Drive("any", "road", (np.arange(12.0), rng.normal(size=12)))
    assert len(recwarn) == 1
