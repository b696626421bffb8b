"""Impacts and bounces: against closed forms and balances of momentum, and where they accumulate."""

import numpy as np
import pinocchio as pin
import pytest
from helpers import scenes

import pinconsist as pc

G = 9.81
METHODS = ["BDF", "Radau"]


def balls(n=1):
    """n masses of 1 kg on vertical sliders, under gravity."""
    model = pin.Model()
    model.gravity.linear = np.array([0, 0, -G])
    for i in range(n):
        scenes.add_body(model, 0, pin.JointModelPZ(), scenes.at(i, 0), f"z{i}", 1.0, (0, 0, 0), 0.1)
    return pc.Mechanism(model, name="balls")


def pendulum():
    model = pin.Model()
    scenes.add_body(model, 0, pin.JointModelRY(), scenes.at(0, 0), "hinge", 2.0, (0, 0, -0.5), 0.1)
    return pc.Mechanism(model, name="pendulum")


def bounce(factor, scale=1.0, **options):
    return pc.Event(lambda t, q, v, lam: scale * q[0], apply=lambda t, q, v: -factor * v, name="bounce", **options)


def impact_times(height, restitution, n):
    first = np.sqrt(2 * height / G)
    flights = 2 * first * restitution ** np.arange(1, n)
    return first + np.append(0.0, np.cumsum(flights))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("restitution", "scale"), [(0.1, 1e6), (0.5, 1.0), (0.5, 1e-6), (0.8, 1.0)])
def test_bounces_that_accumulate_end_the_run_and_none_falls_through(method, restitution, scale):
    """It fell to -1,705 m, with success. Flights shrink to 0 at t1 (1 + e)/(1 - e)."""
    sol = pc.simulate(balls(), (0.0, 20.0), [1.0], events=bounce(restitution, scale), method=method)
    assert sol.status == -1 and "the event bounce accumulates at t = " in sol.message
    assert sol.q.min() > -1e-11
    times = sol.t_events[0]
    end = np.sqrt(2 / G) * (1 + restitution) / (1 - restitution)
    assert abs(times[-1] - end) < 1e-6
    exact = impact_times(1.0, restitution, len(times))
    resolved = end - exact > 1e-4
    assert resolved.sum() > 2 and np.abs(times - exact)[resolved].max() < 1e-9


@pytest.mark.parametrize("method", METHODS)
def test_bounces_accumulate_on_a_moving_floor_backwards_and_in_a_simulation(method):
    def apply(t, q, v):
        return 0.3 - 0.6 * (v - 0.3)

    event = pc.Event(lambda t, q, v, lam: q[0] - 0.3 * t, apply=apply, name="lift")
    sol = pc.simulate(balls(), (0.0, 20.0), [1.0], events=event, method=method)
    assert "the event lift accumulates" in sol.message and (sol.q[:, 0] - 0.3 * sol.t).min() > -1e-11
    back = pc.simulate(balls(), (0.0, -20.0), [1.0], events=bounce(0.6), method=method)
    assert "the event bounce accumulates at t = -" in back.message and back.q.min() > -1e-11
    sim = pc.Simulation(balls(), [1.0], events=bounce(0.6), method=method)
    with pytest.raises(pc.PinconsistError, match="accumulates"):
        for _ in range(100):
            sim.step(0.05)
    assert sim.state.q[0] > -1e-11 and sim.state.t < 2.0


@pytest.mark.parametrize("method", METHODS)
def test_balls_bounce_in_closed_form(method):
    events = [pc.Impact(f"z{i}", lower=0.0, restitution=e) for i, e in enumerate((0.9, 0.8, 0.95))]
    heights = 1.0, 0.7, 0.4
    sol = pc.simulate(balls(3), (0.0, 3.0), list(heights), events=events, method=method)
    assert sol.success and sol.q.min() > -1e-12
    for found, height, event in zip(sol.t_events, heights, events, strict=True):
        exact = impact_times(height, event.restitution, len(found) + 1)
        np.testing.assert_allclose(found, exact[:-1], rtol=1e-10)
        assert exact[-1] > 3.0 and len(found) > 3


@pytest.mark.parametrize("method", METHODS)
def test_a_pendulum_between_elastic_stops_is_periodic_and_keeps_its_energy(method):
    stops = pc.Impact("hinge", lower=-0.3, upper=0.4, restitution=1.0)
    run = {"method": method, "rtol": 1e-10, "atol": 1e-12}
    sol = pc.simulate(pendulum(), (0.0, 10.0), v0={"hinge": 2.0}, events=stops, **run)
    assert len(sol.t_events[0]) == 25 and np.ptp(np.diff(sol.t_events[0][::2])) < 1e-8
    assert sol.q.max() < 0.4 + 1e-9 and sol.q.min() > -0.3 - 1e-9
    assert np.ptp(sol.energy().total) < 1e-8


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("restitution", [1.0, 0.6, 0.0])
def test_a_linkage_that_hits_a_stop_balances_its_momentum(method, restitution):
    """M (v+ - v-) = n Λ + Jᵀ Λ_loops at the impact, n v+ = -e n v-, and the loops stay closed."""
    mech = pc.load("four_bar")
    stop = pc.Impact("rocker", lower=mech.guess[2] - 0.25, restitution=restitution)
    run = {"v0": {"crank": 3.0}, "method": method}
    sol = pc.simulate(mech, (0.0, 0.6), events=[stop], **run)
    assert len(sol.t_events[0]), sol.message
    row = int(np.flatnonzero(np.diff(sol.t) == 0.0)[0])
    q, before, after = sol.q[row], sol.v[row], sol.v[row + 1]
    assert after[2] == pytest.approx(-restitution * before[2], abs=1e-9) and before[2] < -0.1
    M = pin.crba(mech.model, mech.model.createData(), q)
    J = pc.assemble(mech, q)._rows[0]
    assert np.abs(J @ after).max() < 1e-6
    forces = np.vstack((np.eye(3)[2], J)).T
    impulse = M @ (after - before)
    assert np.abs(impulse - forces @ np.linalg.lstsq(forces, impulse, rcond=None)[0]).max() < 1e-9
    work = 0.5 * (after @ M @ after - before @ M @ before)
    assert work == pytest.approx(-(1 - restitution**2) * 0.5 * before @ M @ before, abs=1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_a_frame_bounces_on_a_plane_and_impacts_are_undone_backwards(method):
    """The tip of a pendulum on a vertical wall is the same as a stop at the angle at which it is there."""
    mech = pendulum()
    scenes.add_point(mech.model, 1, "tip", 0, 0, -1.0)
    mech, run = pc.Mechanism(mech.model), {"method": method, "rtol": 1e-10, "atol": 1e-12}
    wall = pc.Impact(frame="tip", plane=((2.0, 0.0, 0.0), -0.3), restitution=0.7)
    stop = pc.Impact("hinge", upper=np.arcsin(0.3), restitution=0.7)
    a, b = (pc.simulate(mech, (0.0, 2.0), v0={"hinge": 2.0}, events=each, **run) for each in (wall, stop))
    assert len(a.t_events[0]) >= 2
    np.testing.assert_allclose(a.t_events[0], b.t_events[0], rtol=1e-8)
    back = pc.simulate(mech, (2.0, 0.0), a.q[-1], a.v[-1], events=wall, **run)
    np.testing.assert_allclose(back.t_events[0], a.t_events[0][::-1], rtol=1e-7)
    np.testing.assert_allclose((back.q[-1, 0], back.v[-1, 0]), (0.0, 2.0), atol=1e-7)


@pytest.mark.parametrize("method", METHODS)
def test_what_rests_on_its_stop_ends_the_run_and_does_not_pass_it(method):
    for start in ({"q0": [0.0]}, {"q0": [0.5]}):
        floor = pc.Impact("z0", lower=0.0, restitution=0.0)
        sol = pc.simulate(balls(), (0.0, 2.0), events=floor, method=method, **start)
        assert sol.status == -1 and "z0 accumulates" in sol.message and sol.q.min() > -1e-11


@pytest.mark.parametrize("method", METHODS)
def test_pairs_of_events_inside_a_step_are_found(method):
    """Steps of free flight are as long as the run; the height of 0.99 m is passed twice near the top, 1 m."""

    def level(t, q, v, lam):
        return q[0] - 0.99

    start = [1.0 - G / 2], [G]  # the top after 1 s
    sol = pc.simulate(balls(), (0.0, 2.0), *start, events=level, method=method)
    half = np.sqrt(2 * 0.01 / G)
    np.testing.assert_allclose(sol.t_events[0], [1 - half, 1 + half], atol=1e-9)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("rows", [{}, {"t_eval": np.linspace(0.0, 2.0, 201)}])
def test_the_energy_balance_counts_events(method, rows):
    run = {"method": method, **rows}
    right = pc.simulate(balls(), (0.0, 2.0), [1.0], events=pc.Impact("z0", lower=0.0, restitution=0.8), **run)
    energy, n = right.energy(), len(right.t_events[0])
    assert n == 3 and energy.work["events"][-1] == pytest.approx(G * (0.8 ** (2 * n) - 1), rel=1e-6)
    assert energy.balance_error < 1e-6 and right.check(error=False).ok


def test_a_kick_on_purpose_is_in_the_balance_and_no_concern():
    kicked = pc.simulate(balls(), (0.0, 0.7), [1.0], events=bounce(1.85), rtol=1e-9)
    assert kicked.energy().work["events"][-1] == pytest.approx(G * (1.85**2 - 1), rel=1e-6)
    assert kicked.check(error=False).ok


@pytest.mark.parametrize("rows", [{}, {"t_eval": np.linspace(0.0, 0.3, 31)}])
def test_energy_that_a_projection_adds_is_a_concern(rows):
    """One velocity of a linkage is changed, and all are multiplied by -c: the kinetic energy by c²."""

    def reverse(t, q, v):
        v[0] *= -0.5
        return v

    event = pc.Event(lambda t, q, v, lam: t - 0.1, apply=reverse, name="bounce")
    with pytest.warns(UserWarning, match="projected"):
        sol = pc.simulate(pc.load("four_bar"), (0.0, 0.3), v0={"crank": 3.0}, events=event, **rows)
    before, after = (sol._changes[0].v_before, sol._changes[0].v_after)
    factor = (after[0] / before[0]) ** 2
    certificate = sol.check(error=False)
    assert factor > 2.0 and certificate.added == {"bounce": pytest.approx(factor - 1.0, rel=1e-6)}
    assert "look at events" in certificate.verdict and "apply return a mapping" in str(certificate)


@pytest.mark.parametrize(("fields", "words"), [
    ({}, "needs a joint"), ({"frame": "tip", "lower": 0.0}, "or a frame="),
    ({"joint": "hinge", "frame": "tip", "upper": 1.0}, "or a frame="), ({"joint": "hinge", "upper": np.nan}, "upper"),
    ({"joint": "hinge", "upper": 0.0, "lower": 0.1}, "below upper"), ({"frame": "tip", "plane": 3}, "plane"),
    ({"joint": "hinge", "upper": 1.0, "restitution": 1.1}, "from 0 to 1"),
    ({"frame": "tip", "plane": ((0, 0, 0), 1)}, "not all 0"),
], ids=str)  # fmt: skip
def test_impossible_impacts_are_refused(fields, words):
    with pytest.raises(pc.InputError, match=words):
        pc.Impact(**{"restitution": 0.5} | fields)


def test_impacts_that_a_mechanism_cannot_have_are_refused():
    model = pin.Model()
    base = scenes.add_body(model, 0, pin.JointModelFreeFlyer(), scenes.at(0, 0), "base", 1.0, (0, 0, 0), 0.1)
    scenes.add_body(model, base, pin.JointModelRUBY(), scenes.at(0, 0), "wheel", 1.0, (0, 0, 0), 0.1)
    scenes.add_body(model, base, pin.JointModelRY(), scenes.at(0, 0), "arm", 1.0, (0, 0, -0.1), 0.1)
    mech = pc.Mechanism(model)
    for impact, words in (
        (pc.Impact("base", upper=1.0, restitution=0.5), "6 degrees of freedom"),
        (pc.Impact("wheel", upper=1.0, restitution=0.5), "specify both stops"),
        (pc.Impact("arm", restitution=0.5), "no limits in its file"),
        (pc.Impact("arm", upper=-1.0, restitution=0.5), "starts 1 beyond"),
        (pc.Impact("amr", upper=1.0, restitution=0.5), "no joint 'amr'"),
        (pc.Impact(frame="foot", restitution=0.5), "no frame 'foot'"),
    ):
        with pytest.raises(pc.InputError, match=words):
            pc.simulate(mech, (0.0, 1.0), events=impact)
    driven = pendulum().with_loops(pc.Drive("motor", "hinge", lambda t: 0.5 * t))
    sol = pc.simulate(driven, (0.0, 1.0), events=pc.Impact("hinge", upper=0.2, restitution=0.5))
    assert sol.status == -1 and "no impulse can change its velocity" in sol.message


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("way", ["object", "with multipliers", "position too", "mapping"])
def test_no_way_to_write_a_bounce_falls_through(way, method):
    class Height:
        def __call__(self, t, q, v, lam):
            return q[0]

    functions = {"object": Height(), "with multipliers": lambda t, q, v, lam: q[0] if len(lam) == 0 else lam[0]}
    applies = {
        "position too": lambda t, q, v: (np.zeros(1), -0.5 * v),
        "mapping": lambda t, q, v: {"z0": -0.5 * v[0]},
    }
    function = functions.get(way, lambda t, q, v, lam: q[0])
    event = pc.Event(function, apply=applies.get(way, lambda t, q, v: -0.5 * v), name="bounce")
    sol = pc.simulate(balls(), (0.0, 20.0), [1.0], events=event, method=method)
    assert "bounce accumulates" in sol.message and sol.q.min() > -1e-11 and len(sol.t_events[0]) > 10


def test_events_that_take_back_the_position_or_brake_a_little_do_not_accumulate():
    """A ball lifted by 0.3 m each time it is down, and one braked by a billionth at marks: neither comes to rest."""
    lift = pc.Event(lambda t, q, v, lam: q[0], apply=lambda t, q, v: (q + 0.3, 0.0 * v))
    sol = pc.simulate(balls(), (0.0, 3.0), [0.3], events=lift)
    fall = np.sqrt(0.6 / G)
    np.testing.assert_allclose(sol.t_events[0], fall * np.arange(1, 1 + int(3.0 / fall)), rtol=1e-9)
    marks = pc.Event(lambda t, q, v, lam: np.sin(1e4 * q[0]), apply=lambda t, q, v: (1.0 - 1e-9) * v)
    sol = pc.simulate(balls(), (0.0, 0.01), [1.0], [-10.0], events=marks, max_step=2e-5)
    passed = np.floor(1e4 / np.pi) - np.floor(1e4 * (0.9 - 5e-5 * G) / np.pi)
    assert sol.success and len(sol.t_events[0]) == passed


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("angle", [0.3, 0.8, 1.2])
def test_a_free_rod_strikes_the_floor_with_its_end(method, angle):
    """Impulse Λ at the end: m Δvz = Λ, I Δω = x Λ with the lever x, and the end leaves with -e times its speed."""
    model = pin.Model()
    model.gravity.linear = np.array([0, 0, -G])
    m, half, inertia, e = 1.7, 0.5, 0.09, 0.6
    x = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "x")
    z = model.addJoint(x, pin.JointModelPZ(), pin.SE3.Identity(), "z")
    rod = scenes.add_body(model, z, pin.JointModelRY(), scenes.at(0, 0), "turn", m, (0, 0, 0), inertia)
    scenes.add_point(model, rod, "end", half, 0, 0)
    mech = pc.Mechanism(model)
    floor = pc.Impact(frame="end", restitution=e)
    start = {"z": 1.0, "turn": angle}, {"x": 0.3, "turn": 0.5}
    sol = pc.simulate(mech, (0.0, 1.0), *start, events=floor, method=method, rtol=1e-9, atol=1e-11)
    (_, _, theta), (vx, vz, omega) = sol.q_events[0][0], sol.v_events[0][0]
    row = int(np.flatnonzero(np.diff(sol.t) == 0.0)[0])
    lever = -half * np.cos(theta)  # d(height of the end)/d(turn)
    approach = vz + lever * omega
    impulse = -(1 + e) * approach / (1 / m + lever**2 / inertia)
    np.testing.assert_allclose(sol.v[row + 1], [vx, vz + impulse / m, omega + lever * impulse / inertia], atol=1e-8)
    lost = 0.5 * (1 - e**2) * approach**2 / (1 / m + lever**2 / inertia)
    assert sol.energy().work["events"][row + 1] == pytest.approx(-lost, rel=1e-6)
