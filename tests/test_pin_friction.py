"""Friction of pins, whose limit depends on the load: against closed forms and scipy."""

import numpy as np
import pinocchio as pin
import pytest
from helpers.touching import G
from scipy.integrate import solve_ivp

import pinconsist as pc
from benchmarks.linkages import add_body, add_frame, at

MASS, LENGTH, INERTIA = 2.0, 0.5, 0.1  # kg; m, from the pin to the centre; kg m²
ARM = 0.02 * 0.3  # m: radius times friction coefficient


def pendulum(*, friction=0.3, forces=()):
    """A body that moves in the x-z plane, on a pin of radius 20 mm; at angle 0 it hangs."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -G])
    x = add_body(model, 0, pin.JointModelPX(), at(0, 0), "x", 0.0, (0, 0, 0), 0.0)
    z = add_body(model, x, pin.JointModelPZ(), at(0, 0), "z", 0.0, (0, 0, 0), 0.0)
    turn = add_body(model, z, pin.JointModelRY(), at(0, 0), "turn", MASS, (0, 0, -LENGTH), INERTIA)
    add_frame(model, turn, "end", (0, 0, 0))
    loop = pc.Loop("pin", "hinge", "universe", "end", axis=(0, 1, 0))
    return pc.Mechanism(model, [loop], forces, contacts=[pc.PinFriction("pin", 0.02, friction)], name="pendulum")


def slider_crank(friction=0.2, radius=0.03):
    """A crank of 0.1 m, whose pin has friction, and a rod of 0.3 m to a slider that is a tree of its own."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -G])
    crank = add_body(model, 0, pin.JointModelRY(), at(0, 0), "crank", 1.0, (0.05, 0, 0), 0.02)
    add_frame(model, crank, "tip", (0.1, 0, 0))
    slider = add_body(model, 0, pin.JointModelPX(), at(0, 0), "slider", 0.8, (0, 0, 0), 0.1)
    rod = add_body(model, slider, pin.JointModelRY(), at(0, 0), "rod", 0.5, (-0.15, 0, 0), 0.005)
    add_frame(model, rod, "end", (-0.3, 0, 0))
    loop = pc.Loop("pin", "hinge", "tip", "end", axis=(0, 1, 0))
    contacts = [pc.PinFriction("pin", radius, friction)] if friction else []
    return pc.Mechanism(model, [loop], contacts=contacts, guess={"crank": 0.5, "slider": 0.38}, name="slider-crank")


def accelerations(angle, rate):
    """Angular acceleration of the pendulum that turns, and the force on its pin: its friction depends on them."""
    about, a = INERTIA + MASS * LENGTH**2, 0.0
    for _ in range(60):
        across = MASS * (LENGTH * a + G * np.sin(angle))
        load = np.hypot(across, MASS * (LENGTH * rate**2 + G * np.cos(angle)))
        a = (-MASS * G * LENGTH * np.sin(angle) - ARM * load * np.sign(rate)) / about
    return a, load


def test_a_pendulum_with_a_pin_that_turns():
    sol = pc.simulate(pendulum(), (0.0, 0.6), {"turn": 1.0}, {"turn": -1.0}, rtol=1e-10, atol=1e-12)
    assert sol.success and [each.mode for each in sol.modes] == ["slip"]
    exact = solve_ivp(lambda t, y: [y[1], accelerations(*y)[0]], (0.0, 0.6), [1.0, -1.0], rtol=1e-12, atol=1e-13)
    assert abs(sol.q[-1, 2] - exact.y[0, -1]) < 1e-9 and abs(sol.v[-1, 2] - exact.y[1, -1]) < 1e-9
    load = accelerations(sol.q[-1, 2], sol.v[-1, 2])[1]
    assert np.linalg.norm(sol.reaction("pin").force[-1]) == pytest.approx(load, rel=1e-9)
    assert sol.contact("pin friction").force[-1] == pytest.approx(ARM * load, rel=1e-9)  # against a rate below zero


def test_its_swings_end_where_the_pin_holds():
    """|R| = m g at rest: it may stop where m g l |sin φ| ≤ μ r m g."""
    sol = pc.simulate(pendulum(), (0.0, 60.0), {"turn": 0.1})
    modes = [each.mode for each in sol.modes]
    assert modes[-1] == "stick" and set(modes[:-1]) == {"slip"}
    assert abs(np.sin(sol.q[-1, 2])) * LENGTH <= ARM * (1.0 + 1e-6)
    assert np.abs(np.diff(sol.q[sol.t > sol.modes[-1].t_begin], axis=0)).max(initial=0.0) < 1e-15


def test_a_pin_that_sticks_does_not_creep():
    angle = np.arcsin(0.99 * ARM / LENGTH)
    sol = pc.simulate(pendulum(), (0.0, 1000.0), {"turn": angle})
    assert [each.mode for each in sol.modes] == ["stick"]
    assert np.ptp(sol.q[:, 2]) < 1e-15
    assert sol.contact("pin friction").force[-1] == pytest.approx(MASS * G * LENGTH * np.sin(angle), rel=1e-9)
    sol = pc.simulate(pendulum(), (0.0, 0.1), {"turn": np.arcsin(1.01 * ARM / LENGTH)})
    assert [each.mode for each in sol.modes] == ["slip"]


def test_a_pin_breaks_away_under_a_rising_torque():
    """At μ_s r m g; then it slides with μ_k."""
    mech = pendulum(friction=(0.3, 0.2), forces=[{"turn": lambda t: 0.1 * t}])
    begins = ARM * MASS * G / 0.1
    sol = pc.simulate(mech, (0.0, begins + 0.1), rtol=1e-9, atol=1e-12)
    assert [each.mode for each in sol.modes] == ["stick", "slip"]
    assert sol.modes[0].t_end == pytest.approx(begins, abs=1e-9)
    k = np.flatnonzero(sol.t == sol.modes[0].t_end)[-1]
    assert sol.contact("pin friction").force[k] == pytest.approx(-2.0 / 3.0 * ARM * MASS * G, rel=1e-3)


@pytest.mark.parametrize("order", [3, 5])
def test_a_slider_crank_with_a_pin_keeps_the_order(order):
    """2s - 1 of positions, velocities and multipliers, against steps of high order."""

    def run(step, order):
        return pc.simulate(slider_crank(), (0.0, 0.1), v0={"crank": 20.0}, method="Radau", order=order, step=step)

    exact = run(1e-3, 9)
    assert [each.mode for each in exact.modes] == ["slip"]
    coarse, fine = run(2e-3, order), run(1e-3, order)
    for of in "q", "v", "lam":
        right = getattr(exact, of)
        one = np.abs(getattr(coarse, of) - right[::2]).max()
        half = np.abs(getattr(fine, of) - right).max()
        assert np.log2(one / half) > order - 0.5, of


def test_the_friction_of_a_slider_crank_takes_its_energy():
    sol = pc.simulate(slider_crank(), (0.0, 0.5), v0={"crank": 20.0}, rtol=1e-9, atol=1e-11)
    energy = sol.energy()
    assert np.abs(energy.error).max() < 1e-6 * energy.kinetic[0] and energy.total[-1] < 0.95 * energy.total[0]
    assert energy.power["pin friction"].max() < 0.0
    torque, rate = sol.contact("pin friction").force, sol.contact("pin friction").slip[:, 0]
    load = np.linalg.norm(sol.reaction("pin").force, axis=1)
    np.testing.assert_allclose(torque, -0.2 * 0.03 * load * np.sign(rate), rtol=1e-8)
    assert sol.check().ok


def test_steps_of_a_controller_are_the_same():
    mech, sim = slider_crank(), pc.Simulation(slider_crank(), v0={"crank": 20.0}, rtol=1e-9, atol=1e-11)
    for _ in range(100):
        sim.step(1e-3)
    sol = pc.simulate(mech, (0.0, 0.1), v0={"crank": 20.0}, rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(sim.state.q, sol.q[-1], atol=1e-9)
    np.testing.assert_allclose(sim.lam, sol.lam[-1], rtol=1e-6)


@pytest.mark.parametrize(
    "record, message",
    [
        (pc.PinFriction("pim", 0.02, 0.3), "no loop 'pim'; similar: pin"),
        (pc.PinFriction("rod", 0.02, 0.3), "no loop"),
    ],
)
def test_what_is_no_pin_is_refused(record, message):
    with pytest.raises(pc.InputError, match=message):
        slider_crank().with_contacts(record)


def test_loops_of_other_kinds_and_overdetermined_ones_are_refused():
    with pytest.raises(pc.InputError, match="is a point, and a pin is a loop of kind 'hinge'"):
        pc.load("andrews").with_contacts(pc.PinFriction("E3", 0.01, 0.1))
    mech = pc.load("bricard")
    with pytest.raises(pc.InputError, match="overdetermined"):
        pc.simulate(mech.with_contacts(pc.PinFriction(mech.loops[0].name, 0.01, 0.1)), (0.0, 0.1))
    with pytest.raises(pc.InputError, match="radius"):
        pc.PinFriction("pin", 0.0, 0.1)


def test_a_loop_file_has_it(tmp_path):
    mech = slider_crank()
    back = pc.load(pc.write(mech, tmp_path / "it.urdf"))
    assert [vars(each) for each in back.contacts] == [vars(each) for each in mech.contacts]
    assert "pin friction (pin-friction)" in str(mech)
