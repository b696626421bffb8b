"""What touches, against closed forms: impacts, rest, lift-off, ropes, friction that sticks and slides."""

import numpy as np
import pinocchio as pin
import pytest
from helpers import touching
from helpers.touching import G
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import pinconsist as pc
from benchmarks import impacts
from benchmarks.linkages import add_body, add_frame, at, four_bar
from pinconsist.run.modes import Modes

SLOW = {"rtol": 1e-9, "atol": 1e-12}


def kinds(sol, name):
    return [each.mode for each in sol.modes if each.contact == name]


def times_of(sol):
    return np.array([each.t for each in sol.impacts])


# Impacts


@pytest.mark.parametrize("restitution", [0.5, 0.8, 0.9])
def test_a_ball_bounces_and_comes_to_rest(restitution):
    """Flights of 2 T eᵏ, which end at T (1 + e) / (1 - e); then it rests, and its stop carries it."""
    sol = pc.simulate(touching.ball(restitution), (0.0, 20.0), {"z": 1.0}, **SLOW)
    found, first = times_of(sol), np.sqrt(2.0 / G)
    exact = first + np.append(0.0, np.cumsum(2.0 * first * restitution ** np.arange(1, len(found))))
    assert sol.success and len(found) > 10
    np.testing.assert_allclose(found, exact, atol=1e-9)
    end = first * (1.0 + restitution) / (1.0 - restitution)
    assert abs(found[-1] - end) < 1e-4
    assert kinds(sol, "z lower") == ["open", "closed"]
    assert abs(sol.q[-1, 0]) < 1e-12 and sol.v[-1, 0] == 0.0
    contact = sol.contact("z")
    assert contact.force[-1] == pytest.approx(G, rel=1e-12) and contact.gap.min() > -1e-11
    lost = sum(each.energy_lost for each in sol.impacts)
    assert lost == pytest.approx(G, rel=1e-8)  # all of m g h


def test_the_first_row_of_multipliers_after_an_impact_is_right():
    sol = pc.simulate(touching.ball(0.0), (0.0, 1.0), {"z": 0.5})
    k = np.flatnonzero(sol.t == sol.impacts[0].t)[-1]
    assert sol.lam[k, 0] == pytest.approx(G, rel=1e-12) and sol.impacts[0].impulses["z lower"] == pytest.approx(
        np.sqrt(2 * G * 0.5), rel=1e-9
    )


def test_a_pendulum_between_elastic_stops_keeps_its_energy_and_its_times():
    """Against scipy, run from stop to stop."""
    sol = pc.simulate(touching.pendulum(-0.4, 0.5, 1.0), (0.0, 30.0), [0.1], [2.0], **SLOW)
    inertia = 0.1 + 2.0 * 0.25

    def rate(t, y):
        return [y[1], -2.0 * G * 0.5 * np.sin(y[0]) / inertia]

    stops = [lambda t, y: y[0] + 0.4, lambda t, y: 0.5 - y[0]]
    for stop in stops:
        stop.terminal, stop.direction = True, -1
    t, y, found = 0.0, np.array([0.1, 2.0]), []
    while True:
        run = solve_ivp(rate, (t, 30.0), y, events=stops, rtol=1e-12, atol=1e-13, method="DOP853")
        if run.status != 1:
            break
        t, y = run.t[-1], run.y[:, -1] * [1.0, -1.0]
        found.append(t)
    assert len(found) > 40
    np.testing.assert_allclose(times_of(sol), found, atol=1e-6)
    energy = sol.energy()
    assert np.ptp(energy.total) < 1e-7 * np.abs(energy.total).max()


def test_two_balls_hit_at_one_time_like_one_after_the_other():
    """Two masses on their own rails: what one does has no effect on the other, also at the same instant."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -G])
    for i in range(2):
        add_body(model, 0, pin.JointModelPZ(), at(i, 0), f"z{i}", 1.0, (0, 0, 0), 0.1)
    stops = [pc.Stop(f"z{i}", lower=0.0, restitution=e) for i, e in enumerate((0.5, 0.25))]
    sol = pc.simulate(pc.Mechanism(model, contacts=stops), (0.0, 0.6), [1.0, 1.0], **SLOW)
    assert len(sol.impacts[0].impulses) == 2
    speed, left = np.sqrt(2 * G), 0.6 - np.sqrt(2 / G)
    np.testing.assert_allclose(sol.v[-1], [e * speed - G * left for e in (0.5, 0.25)], rtol=1e-8)


def linkage_between_stops():
    mech = four_bar()
    start = pc.assemble(mech).q
    joint = mech.joints[0]
    x = start[mech.model.idx_qs[1]]
    return mech.with_contacts(pc.Stop(joint, x - 0.5, x + 0.5, restitution=0.7)), joint


@pytest.mark.parametrize("rtol", [1e-3, 1e-6])
def test_stops_are_reached_to_rounding_at_any_tolerance(rtol):
    """Rows at impacts, and the dense output up to them: it is that of a step that ends there."""
    mech, _, v0, _ = impacts.shaken()
    sol = pc.simulate(mech, (0.0, 12.0), v0=v0, rtol=rtol, atol=1e-2 * rtol)
    crank = sol.position("crank")
    (stop,) = mech.contacts
    gaps = np.minimum(crank - stop.lower, stop.upper - crank)
    at_impacts = np.isin(sol.t, times_of(sol))
    assert len(sol.impacts) > 30 and at_impacts.sum() == 2 * len(sol.impacts)
    assert np.abs(gaps[at_impacts]).max() < 1e-12
    for before, each in zip(sol.t[:-1][np.diff(sol.t) > 0.0], sol.t[1:][np.diff(sol.t) > 0.0], strict=True):
        crank = sol.at(np.linspace(before, each, 5)[1:]).q[:, 0]
        assert min((crank - stop.lower).min(), (stop.upper - crank).min()) > -1e-12


def test_a_four_bar_between_stops_stays_closed_and_balances_its_energy():
    mech, joint = linkage_between_stops()
    sol = pc.simulate(mech, (0.0, 3.0), v0={joint: 3.0}, **SLOW)
    assert sol.success and len(sol.impacts) >= 4
    certificate = sol.check()
    assert certificate.position < 1e-9 and certificate.ok, str(certificate)
    lost = sum(each.energy_lost for each in sol.impacts)
    energy = sol.energy()
    assert energy.total[0] - energy.total[-1] == pytest.approx(lost, rel=1e-7)


@pytest.mark.parametrize(("order", "least"), [(3, 2.4), (5, 4.2)])
def test_after_impacts_all_have_the_order_of_the_method(order, least):
    """q, v, λ, times of impacts and impulses, by halving a fixed step."""
    mech, joint = linkage_between_stops()

    def run(step, order):
        sol = pc.simulate(mech, (0.0, 1.0), v0={joint: 3.0}, step=step, order=order)
        impulses = [value for each in sol.impacts for value in each.impulses.values()]
        return [sol.q[-1], sol.v[-1], sol.lam[-1], times_of(sol)[:3], np.array(impulses)[:3]]

    exact = run(0.25e-2, 9)
    errors = [[np.abs(a - b).max() for a, b in zip(run(h, order), exact, strict=True)] for h in (4e-2, 2e-2, 1e-2)]
    orders = np.log2(np.array(errors)[:-1] / np.array(errors)[1:])
    assert orders.mean(axis=0).min() > least, orders


# Stops and ropes


def test_a_stop_holds_a_motor_and_lets_go():
    """A torque presses a joint against its stop until it changes its sign at t = 1."""
    model = pin.Model()
    model.gravity.linear = np.zeros(3)
    add_body(model, 0, pin.JointModelRY(), at(0, 0), "hinge", 1.0, (0, 0, 0), 0.5)
    mech = pc.Mechanism(model, contacts=[pc.Stop("hinge", upper=0.0)])
    inertia = float(pin.crba(mech.model, mech.model.createData(), np.zeros(1))[0, 0])
    mech = mech.with_forces({"hinge": pc.Motion(start=1.0, speed=-1.0)})
    sol = pc.simulate(mech, (0.0, 3.0), [0.0])
    assert kinds(sol, "hinge upper") == ["closed", "open"]
    assert sol.modes[0].t_end == pytest.approx(1.0, abs=1e-12)
    held = sol.t < 1.0
    np.testing.assert_allclose(sol.contact("hinge").force[held], -(1.0 - sol.t[held]), atol=1e-12)
    np.testing.assert_allclose(sol.q[-1, 0], -(2.0**3) / 6.0 / inertia, rtol=1e-9)


def test_a_rope_catches_a_mass():
    rope = pc.Rope("rope", "universe", "z", length=0.7)
    sol = pc.simulate(touching.block(rope), (0.0, 2.0), [0.0, 0.0], **SLOW)
    impact = sol.impacts[0]
    assert impact.t == pytest.approx(np.sqrt(2 * 0.7 / G), abs=1e-12)
    assert impact.impulses["rope"] == pytest.approx(np.sqrt(2 * G * 0.7), rel=1e-10)
    assert impact.energy_lost == pytest.approx(0.7 * G, rel=1e-10)
    assert sol.contact("rope").force[-1] == pytest.approx(G, rel=1e-10)


def test_a_mass_on_a_rope_leaves_its_circle_where_the_tension_ends():
    """cos θ = (2 g L - v²) / (3 g L), θ from the lowest point."""
    length, speed = 1.0, 1.8 * np.sqrt(G)
    rope = pc.Rope("rope", "universe", "z", length=length)
    sol = pc.simulate(touching.block(rope), (0.0, 1.0), [0.0, -length], [speed, 0.0], **SLOW)
    slack = next(each for each in sol.modes if each.mode == "closed").t_end
    x, z = sol.at(slack).q[0]
    assert -z == pytest.approx((2 * G * length - speed**2) / (3 * G), rel=1e-9) and np.hypot(x, z) == pytest.approx(1.0)
    assert kinds(sol, "rope")[:2] == ["closed", "open"]


def test_a_strut_keeps_two_masses_apart():
    strut = pc.Strut("strut", "universe", "z", length=0.5)
    sol = pc.simulate(touching.block(strut), (0.0, 0.4), [0.0, 1.0])
    assert sol.q[-1, 1] == pytest.approx(0.5) and sol.contact("strut").force[-1] == pytest.approx(G)


# Contacts and friction


def test_a_block_on_a_slope_does_not_creep():
    sol = pc.simulate(touching.block(pc.Contact("c", "z", friction=0.5), slope=0.3), (0.0, 1000.0))
    assert np.abs(sol.q).max() < 1e-15 and kinds(sol, "c") == ["stick"]
    np.testing.assert_allclose(sol.contact("c").force[-1], [-G * np.sin(0.3), 0.0, G * np.cos(0.3)], rtol=1e-12)


def test_a_block_slides_down_a_slope():
    sol = pc.simulate(touching.block(pc.Contact("c", "z", friction=0.2), slope=0.3), (0.0, 1.0))
    assert sol.q[-1, 0] == pytest.approx(0.5 * G * (np.sin(0.3) - 0.2 * np.cos(0.3)), rel=1e-12)
    energy = sol.energy()
    assert energy.work["c"][-1] == pytest.approx(-0.2 * G * np.cos(0.3) * sol.q[-1, 0], rel=1e-10)
    assert energy.balance_error < 1e-12


def test_a_block_breaks_away_under_a_rising_load():
    mech = touching.block(pc.Contact("c", "z", friction=(0.5, 0.4)), forces=[{"x": pc.Motion(speed=1.0)}])
    sol = pc.simulate(mech, (0.0, 10.0))
    start = 0.5 * G
    assert [each.mode for each in sol.modes] == ["stick", "slip"]
    assert sol.modes[0].t_end == pytest.approx(start, abs=1e-11)
    t = 10.0 - start
    exact = (10.0**3 - start**3) / 6.0 - start**2 / 2.0 * t - 0.4 * G * t**2 / 2.0
    assert sol.q[-1, 0] == pytest.approx(exact, rel=1e-10)


def test_dry_friction_of_a_joint_holds_breaks_away_and_slides():
    mech = touching.ball().with_contacts(pc.DryFriction("z", (15.0, 5.0))).with_forces({"z": pc.Motion(speed=-4.0)})
    sol = pc.simulate(mech, (0.0, 3.0))
    start = (15.0 - G) / 4.0
    assert kinds(sol, "z friction") == ["stick", "slip"] and sol.modes[0].t_end == pytest.approx(start, abs=1e-11)
    t = 3.0 - start
    assert sol.v[-1, 0] == pytest.approx(-(2.0 * (9.0 - start**2) + (G - 5.0) * t), rel=1e-10)
    assert np.abs(sol.q[sol.t <= start]).max() == 0.0


def test_a_mass_on_a_belt_sticks_and_slips():
    """The period is (π + 2 φ) / ω + 2 Δ / v with Δ = (μ_s - μ_k) N / k and tan φ = v / (ω Δ)."""
    stiffness, speed, static, kinetic = 40.0, 0.1, 0.6, 0.4
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -G])
    add_body(model, 0, pin.JointModelPX(), at(0, 0), "belt", 1.0, (0, 0, 0), 0.1)
    x = add_body(model, 0, pin.JointModelPX(), at(0, 0), "x", 0.0, (0, 0, 0), 0.0)
    add_body(model, x, pin.JointModelPZ(), at(0, 0), "z", 1.0, (0, 0, 0), 0.1)
    drive = pc.Drive("motor", "belt", pc.Motion(speed=speed))
    contact = pc.Contact("c", "z", on="belt", friction=(static, kinetic))
    mech = pc.Mechanism(model, [drive], [pc.JointSpring("x", stiffness)], contacts=[contact])
    sol = pc.simulate(mech, (0.0, 30.0), v0={"belt": speed, "x": speed}, **SLOW)
    begins = [each.t_begin for each in sol.modes if each.mode == "slip"]
    omega, reach = np.sqrt(stiffness), (static - kinetic) * G / stiffness
    period = (np.pi + 2.0 * np.arctan2(speed / omega, reach)) / omega + 2.0 * reach / speed
    assert len(begins) > 15
    np.testing.assert_allclose(np.diff(begins)[1:], period, rtol=1e-7)


def test_a_puck_slides_to_rest_in_a_straight_line():
    sol = pc.simulate(touching.puck(pc.Contact("c", "puck", friction=0.3)), (0.0, 2.0), v0=[1.2, 0.9, 0.0])
    slides, rests = sol.modes
    assert (slides.mode, rests.mode) == ("slip", "stick")
    assert slides.t_end == pytest.approx(1.5 / (0.3 * G), rel=1e-7)
    np.testing.assert_allclose(sol.q[-1], np.array([0.8, 0.6, 0.0]) * 1.5**2 / (2 * 0.3 * G), atol=1e-7)


def test_a_puck_on_an_incline_turns_its_direction():
    """Against scipy: friction opposes the velocity, which turns downhill."""
    slope, friction = 0.4, 0.3
    mech = touching.puck(pc.Contact("c", "puck", friction=friction), slope=slope)
    sol = pc.simulate(mech, (0.0, 1.0), v0=[0.0, 1.0, 0.0], **SLOW)

    def rate(t, y):
        v = y[2:]
        return [*v, *(G * np.sin(slope) * np.array([1.0, 0.0]) - friction * G * np.cos(slope) * v / np.linalg.norm(v))]

    exact = solve_ivp(rate, (0.0, 1.0), [0.0, 0.0, 0.0, 1.0], rtol=1e-12, atol=1e-13, method="DOP853").y[:, -1]
    np.testing.assert_allclose([*sol.q[-1, :2], *sol.v[-1, :2]], exact, atol=1e-7)
    force = sol.contact("c").force[-1]
    np.testing.assert_allclose(force[:2], -friction * force[2] * exact[2:] / np.linalg.norm(exact[2:]), atol=1e-6)


def test_a_box_rocks_as_housner_says():
    """At each change of the corner the rate falls by 1 - 1.5 sin²α, without restitution and with enough friction."""
    width, height = 0.2, 1.0
    mech = touching.box(width, height)
    alpha, tilt = np.arctan2(width, height), 0.05
    radius = 0.5 * np.hypot(width, height)
    z = radius * np.cos(alpha - tilt)  # on its right corner
    sol = pc.simulate(mech, (0.0, 2.0), [-0.5 * width + radius * np.sin(alpha - tilt), z, tilt], **SLOW)
    assert sol.success, sol.message
    jumps = [k for k in np.flatnonzero(np.diff(sol.t) == 0.0) if abs(sol.v[k + 1, 2] - sol.v[k, 2]) > 1e-3]
    ratios = [sol.v[k + 1, 2] / sol.v[k, 2] for k in jumps[:3]]
    np.testing.assert_allclose(ratios, 1.0 - 1.5 * np.sin(alpha) ** 2, rtol=1e-9)


def test_a_table_stands_on_four_legs_whose_forces_push():
    legs = [(0.5, 0.4), (-0.5, 0.4), (0.5, -0.4), (-0.3, -0.4)]
    sol = pc.simulate(touching.table(legs), (0.0, 1.0))
    assert sol.success and np.abs(sol.v[-1]).max() < 1e-12
    forces = np.array([sol.contact(f"leg{i}").force[-1] for i in range(4)])
    np.testing.assert_allclose(forces.sum(axis=0), [0.0, 0.0, 2 * G], atol=1e-9)
    np.testing.assert_allclose(forces[:, 2] @ np.array(legs), 0.0, atol=1e-9)
    assert forces[:, 2].min() > -1e-9


def test_a_table_that_is_pushed_at_its_top_tips():
    """The force at height h lifts the far legs if F h > m g b."""
    legs = [(0.2, 0.4), (-0.2, 0.4), (0.2, -0.4), (-0.2, -0.4)]
    for force, kind in ((7.0, "stick"), (9.5, "open")):
        push = pc.Wrench("table", force=(force, 0.0, 0.0), axes="world")
        sol = pc.simulate(touching.table(legs, friction=0.8).with_forces(push), (0.0, 0.05))
        assert sol.contact("leg1").mode[-1] == kind  # F 0.5 m against 2 g 0.2 m: 7.85 N


def test_a_stuck_joint_and_its_stop_share_a_load():
    mech = touching.ball().add_contacts(pc.DryFriction("z", 4.0))
    sol = pc.simulate(mech, (0.0, 1.0), {"z": 0.1})
    assert sol.q[-1, 0] == pytest.approx(0.0, abs=1e-12)
    stop, friction = sol.contact("z").force[-1], sol.contact("z friction").force[-1]
    assert stop + friction == pytest.approx(G) and stop >= 0.0 and abs(friction) <= 4.0


def test_a_part_is_lifted_off_its_table_by_two_pads_that_a_drive_moves():
    """Table and pads hold it redundantly; where the drive moves the pads, the table must let go."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -G])
    lift = add_body(model, 0, pin.JointModelPZ(), at(0, 0), "lift", 1.0, (0, 0, 0), 0.1)
    add_body(model, lift, pin.JointModelPX(), at(-0.1, 0), "left", 1.0, (0, 0, 0), 0.1)
    add_body(model, lift, pin.JointModelPX(), at(0.1, 0), "right", 1.0, (0, 0, 0), 0.1)
    x = add_body(model, 0, pin.JointModelPX(), at(0, 0), "x", 0.0, (0, 0, 0), 0.0)
    part = add_body(model, x, pin.JointModelPZ(), at(0, 0), "z", 1.0, (0, 0, 0), 0.1)
    contacts = [pc.Contact("table", "z", friction=0.2)]
    for side, sign in (("left", -1.0), ("right", 1.0)):
        add_frame(model, part, f"{side} face", (0.05 * sign, 0.0, 0.0))
        contacts.append(pc.Contact(side, f"{side} face", on=side, normal=(-sign, 0, 0), friction=0.5))
    loops = [
        pc.Coupling("gears", "left", "right", ratio=-1.0),
        pc.Drive("up", "lift", lambda t: max(t - 0.5, 0.0) ** 3),
    ]
    mech = pc.Mechanism(model, loops, [{"left": 30.0}], contacts=contacts)
    sol = pc.simulate(mech, (0.0, 1.0), {"lift": 0.0, "x": 0.01, "z": 0.0, "left": 0.0, "right": 0.0})
    assert sol.success and sol.position("z")[-1] == pytest.approx(0.5**3, abs=1e-9)
    forces = [sol.contact(name).force[-1] for name in ("left", "right", "table")]
    assert sum(force[2] for force in forces) == pytest.approx(G + 6.0 * 0.5, rel=1e-6)
    assert all(abs(force[2]) <= 0.5 * abs(force[0]) + 1e-9 for force in forces[:2])


def test_a_sliding_rod_jams_and_goes_on():
    """Painlevé's rod: with much friction, no accelerations fit its sliding; an impulse stops it."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -G])
    x = add_body(model, 0, pin.JointModelPX(), at(0, 0), "x", 0.0, (0, 0, 0), 0.0)
    z = add_body(model, x, pin.JointModelPZ(), at(0, 0), "z", 0.0, (0, 0, 0), 0.0)
    add_body(model, z, pin.JointModelRY(), at(0, 0), "turn", 1.0, (0, 0, 0), np.diag([0, 1.0 / 12.0, 0]))
    model.addFrame(pin.Frame("end", 3, pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.5])), pin.FrameType.OP_FRAME))
    mech = pc.Mechanism(model, contacts=[pc.Contact("end", "end", friction=1.6)])
    angle = 0.55
    q = [0.0, 0.5 * np.cos(angle), angle]
    found = []
    for speed in (3.0, -3.0):
        sol = pc.simulate(mech, (0.0, 0.05), q, [speed, 0.0, 0.0])
        assert sol.success, sol.message
        found.append(sum(each.jam for each in sol.impacts))
    assert max(found) >= 1


# The whole


def test_runs_do_not_depend_on_the_order_of_the_contacts():
    mech, q, v = touching.random_chain(17)
    one = pc.simulate(mech, (0.0, 0.3), q, v)
    other = pc.simulate(mech.with_contacts(*mech.contacts[::-1]), (0.0, 0.3), q, v)
    assert len(one.impacts) == len(other.impacts)
    np.testing.assert_allclose(one.q[-1], other.q[-1], atol=1e-6)


@pytest.mark.parametrize("seed", [*range(40), 20107, 20227])  # also one whose friction turns into a jam
def test_random_chains_come_to_an_end_and_obey_all_laws(seed):
    mech, q, v = touching.random_chain(seed)
    sol = pc.simulate(mech, (0.0, 0.4), q, v)
    assert sol.success, sol.message
    largest = 1.0 + np.abs(sol.lam).max(initial=0.0)
    first = mech.nc
    for element in mech.contact_elements:
        own = sol.lam[:, first : first + element.size]
        first += element.size
        if element.pushes:
            assert own[:, 0].min() > -1e-7 * largest, element.name
        limit = element.static * (own[:, 0] if element.pushes else 1.0)
        assert (np.linalg.norm(own[:, element.pushes :], axis=1) - limit).max() < 1e-6 * largest, element.name
    for contact in mech.contacts:
        assert sol.contact(contact.name).gap.min() > -1e-10, contact.name
    total = sol.energy().total
    assert (total - np.minimum.accumulate(total)).max() < 1e-5 * (1.0 + np.ptp(total))


@pytest.mark.parametrize("seed", [30026, 30057, 30245])
def test_loose_tolerances_end_in_closed_gaps(seed):
    """A stop that is left softly, an impact that has no solution with its restitutions, impacts far inside a step."""
    mech, q, v = touching.random_chain(seed)
    sol = pc.simulate(mech, (0.0, 0.4), q, v, rtol=1e-3, atol=1e-5)
    assert sol.success, sol.message
    assert all(sol.contact(each.name).gap.min() > -1e-10 for each in mech.contacts)
    total = sol.energy().total
    assert (total - np.minimum.accumulate(total)).max() < 1e-2 * (1.0 + np.ptp(total))


def test_a_chain_falls_on_a_floor_and_comes_to_rest():
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -G])
    parent = add_body(model, 0, pin.JointModelPX(), at(0, 0), "x", 0.0, (0, 0, 0), 0.0)
    parent = add_body(model, parent, pin.JointModelPZ(), at(0, 0), "z", 0.0, (0, 0, 0), 0.0)
    contacts, place = [], at(0, 0)
    for i in range(5):
        parent = add_body(model, parent, pin.JointModelRY(), place, f"j{i}", 0.2, (0.1, 0, 0), 1e-3)
        place = pin.SE3(np.eye(3), np.array([0.2, 0.0, 0.0]))
        contacts.append(pc.Contact(f"p{i}", f"j{i}", friction=0.5, restitution=0.3))
        model.addFrame(pin.Frame(f"tip{i}", parent, place, pin.FrameType.OP_FRAME))
    contacts.append(pc.Contact("tip", "tip4", friction=0.5, restitution=0.3))
    mech = pc.Mechanism(model, contacts=contacts, name="chain")
    sol = pc.simulate(mech, (0.0, 2.0), [0.0, 0.6, 0.4, 0.3, -0.5, 0.6, -0.2], rtol=1e-4)
    assert sol.success, sol.message
    assert np.abs(sol.v[-1]).max() < 1e-6
    weight = sum(sol.contact(each.name).force[-1][2] for each in contacts)
    assert weight == pytest.approx(G, rel=1e-6)


def test_a_grazing_impact_between_two_looks_is_found():
    """A mass that rises would pass its stop by 1e-6 m for a moment."""
    mech = touching.ball().with_contacts(pc.Stop("z", upper=0.2 - 1e-6, restitution=0.5))
    speed = np.sqrt(2 * G * 0.2)
    sol = pc.simulate(mech, (0.0, 0.3), {"z": 0.0}, {"z": speed}, **SLOW)
    exact = brentq(lambda t: speed * t - 0.5 * G * t**2 - 0.2 + 1e-6, 0.0, speed / G)
    assert len(sol.impacts) == 1 and sol.impacts[0].t == pytest.approx(exact, abs=1e-9)


# Steps of a controller


def in_steps(mech, count, *start):
    sim = pc.Simulation(mech, *start, **SLOW)
    for _ in range(count):
        sim.step(1e-3)
    return sim


@pytest.mark.parametrize("push", [0.0, 4.5, 7.5])
def test_python_is_asked_only_where_a_mode_may_end(push, monkeypatch):
    """A box on two feet, pushed by more than one of them can hold, and by less than both: its forces are shared."""
    asked = []
    monkeypatch.setattr(Modes, "agree", lambda self, t, p, v: asked.append(t) or True)
    mech = touching.box(0.8, 0.2).with_forces({"x": push})
    in_steps(mech, 20)
    sol = pc.simulate(mech, (0.0, 0.1), **SLOW)
    assert not asked and {each.mode for each in sol.modes} == {"stick"}
    both = [sol.contact(name).force[-1] for name in ("left", "right")]
    np.testing.assert_allclose(sum(both), [-push, 0.0, G], atol=1e-8)
    assert all(abs(each[0]) <= 0.8 * each[2] * (1.0 + 1e-9) for each in both)


def test_impacts_happen_within_steps_as_in_a_run():
    sim = in_steps(touching.ball(0.5), 1500, {"z": 0.3})
    sol = pc.simulate(touching.ball(0.5), (0.0, 1.5), {"z": 0.3}, **SLOW)
    assert len(sol.impacts) > 8
    np.testing.assert_allclose([each.t for each in sim.solution().impacts], times_of(sol), atol=1e-9)
    assert sim.state.t == pytest.approx(1.5, abs=1e-12) and sim.lam[0] == pytest.approx(G, rel=1e-9)
    again = sim.copy()
    again.step(0.1)
    assert again.state.v[0] == 0.0


def test_what_sticks_on_both_sides_shares_its_weight_at_rows_and_between_them():
    """A part that a pad presses against a wall: either side alone would slide."""
    model = pin.Model()
    joints = {}
    for name, parent, joint, mass in (
        ("across", 0, pin.JointModelPX(), 0.1),
        ("part", "across", pin.JointModelPZ(), 1.0),
        ("pad", 0, pin.JointModelPX(), 0.2),
    ):
        joints[name] = model.addJoint(joints.get(parent, 0), joint, pin.SE3.Identity(), name)
        model.appendBodyToJoint(joints[name], pin.Inertia(mass, np.zeros(3), 0.1 * np.eye(3)), pin.SE3.Identity())
    sides = [
        pc.Contact("wall", "part", friction=0.8, normal=(1.0, 0.0, 0.0)),
        pc.Contact("side", "pad", friction=0.8, normal=(1.0, 0.0, 0.0), on="part"),
    ]
    mech = pc.Mechanism(model, [], [{"pad": lambda t: -10.0 - 5.0 * t}], contacts=sides)
    sol = pc.simulate(mech, (0.0, 1.0))
    for run in (sol, sol.at(np.linspace(0.05, 0.95, 19))):
        wall, side = run.contact("wall").force, run.contact("side").force
        np.testing.assert_allclose(wall[:, 0], 10.0 + 5.0 * run.t, rtol=1e-9)
        np.testing.assert_allclose(wall[:, 2], 0.5 * 9.81, rtol=1e-9)
        np.testing.assert_allclose(np.abs(side[:, 2]), 0.5 * 9.81, rtol=1e-9)
