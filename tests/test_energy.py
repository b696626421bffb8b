"""Energy, power and work against closed forms, and the balance of scenes in which everything acts."""

import dataclasses

import numpy as np
import pinocchio as pin
import pytest
from helpers import touching
from helpers.scenes import slider

import pinconsist as pc
from pinconsist.paper.index1 import acceleration

TIGHT = {"rtol": 1e-9, "atol": 1e-11}
M, G = 2.0, 9.81


def everything():
    """Forces of every kind for the four-bar."""
    return [
        pc.JointDamping({"crank": 0.4, "rocker": 0.2}),
        pc.JointFriction({"coupler": 0.5}, width=0.5),
        pc.JointSpring("rocker", 6.0, -1.0),
        pc.SpringDamper("coupler_tip", "universe", 20.0, 0.8, 1.5, xyz1=(-0.5, 0, 0), xyz2=(1.0, 0, 1.0)),
        pc.JointTorque({"crank": lambda t: 3.0 * np.sin(4 * t)}),
        pc.Servo("coupler", lambda t: 0.6 + 0.3 * np.sin(3 * t), 12.0, 0.7),
        pc.Wrench("rocker_tip", (3.0, 0.0, -2.0), (0.0, 0.4, 0.0)),
        pc.Wrench("coupler_tip", lambda t: (2.0, 0.0, t), axes="local", xyz=(-1.0, 0.0, 0.1)),
        lambda t, q, v: np.array([0.0, -0.3 * v[1] * abs(v[1]), np.cos(t)]),
    ]


def motor_of_four_bar():
    """The four-bar, its crank driven unevenly against friction and springs."""
    mech = pc.load("four_bar")
    return mech.add_loops(pc.Drive("motor", "crank", pc.Motion(-1.0, 2.0, 0.4, 1.0)))


SCENES = {"free": lambda: pc.load("four_bar"), "driven": motor_of_four_bar}


@pytest.mark.parametrize("scene", SCENES)
def test_the_balance_with_everything_acting_holds_to_the_order_of_the_method(scene):
    errors = []
    for h in (0.01, 0.005):
        sol = pc.simulate(SCENES[scene](), (0.0, 1.0), step=h, order=4, forces=everything(), method="BDF")
        energy = sol.energy()
        assert min(np.ptp(power) for power in energy.power.values() if power.any()) > 1e-2  # each of them acts
        errors.append(energy.balance_error)
    assert errors[1] < 1e-4 and np.log2(errors[0] / errors[1]) > 3.5, errors
    assert len(energy.power) == 9 + (scene == "driven")
    assert sol.check(error=False).energy_error == energy.balance_error
    np.testing.assert_array_equal(sol.check(error=False).energy, energy.total)


@pytest.mark.parametrize("scene", SCENES)
def test_powers_add_up_to_the_rate_of_the_energy(scene):
    """At single states: d(total)/dt by differences of the energy along the differential equation's acceleration."""
    mech = SCENES[scene]().add_forces(*everything())
    sol = pc.simulate(mech, (0.0, 0.5), **TIGHT)
    energy, h = sol.energy(), 1e-4
    for i in (0, len(sol.t) // 2, -1):
        t, q, v = sol.t[i], sol.q[i], sol.v[i]
        a = acceleration(sol.system, t, q, v)[0]
        near = [s * h for s in (-2, -1, 1, 2)]
        rows = dataclasses.replace(
            sol, t=np.array([t + s for s in near]), q=np.array([q + s * v + 0.5 * s**2 * a for s in near]),
            v=np.array([v + s * a for s in near]), lam=np.tile(sol.lam[i], (4, 1)),
        )  # fmt: skip
        e = rows.energy().total
        rate = (e[0] - 8 * e[1] + 8 * e[2] - e[3]) / (12 * h)
        powers = {name: power[i] for name, power in energy.power.items()}
        assert rate == pytest.approx(sum(powers.values()), abs=1e-5 * (1 + max(map(abs, powers.values())))), powers


def test_damped_oscillator():
    """Kinetic, potential and elastic energy by hand; what the damper takes is the rest."""
    k, d, rest = 50.0, 3.0, 0.4
    forces = [pc.JointSpring("slide", k, rest), pc.JointDamping({"slide": d})]
    sol = pc.simulate(slider(M, G), (0.0, 1.0), {"slide": 1.0}, forces=forces, max_step=0.01, **TIGHT)
    x, v, energy = sol.q[:, 0], sol.v[:, 0], sol.energy()
    np.testing.assert_allclose(energy.kinetic, 0.5 * M * v**2, rtol=1e-12)
    np.testing.assert_allclose(energy.potential, M * G * x, rtol=1e-12)
    np.testing.assert_allclose(energy.elastic, 0.5 * k * (x - rest) ** 2, rtol=1e-12)
    np.testing.assert_array_equal(energy.stored["spring slide"], energy.elastic)
    np.testing.assert_array_equal(energy.total, energy.kinetic + energy.potential + energy.elastic)
    np.testing.assert_allclose(energy.power["damping slide"], -d * v**2, rtol=1e-12)
    assert np.abs(energy.power["spring slide"]).max() < 1e-12  # what it takes is stored
    np.testing.assert_allclose(energy.work["damping slide"], energy.total - energy.total[0], atol=1e-6)


def test_a_spring_with_a_damper_in_it():
    spring = pc.SpringDamper("universe", "block", 80.0, 1.0, 4.0, xyz1=(0.0, 0.0, 3.0))
    sol = pc.simulate(slider(M), (0.0, 1.0), {"slide": 1.5}, forces=[spring], **TIGHT)
    energy = sol.energy()
    np.testing.assert_allclose(energy.elastic, 0.5 * 80.0 * (3.0 - sol.q[:, 0] - 1.0) ** 2, rtol=1e-9)
    np.testing.assert_allclose(energy.power["spring universe-block"], -4.0 * sol.v[:, 0] ** 2, rtol=1e-9, atol=1e-12)


def test_work_of_friction_torque_and_wrench():
    """f times the way, for each of three constant forces."""
    forces = [pc.JointFriction({"slide": 3.0}), {"slide": 5.0}, pc.Wrench("block", (7.0, 0, -1.5))]
    sol = pc.simulate(slider(M), (0.0, 1.0), v0={"slide": 2.0}, forces=forces, max_step=0.02)
    way, work = sol.q[-1, 0] - sol.q[0, 0], sol.energy().work
    assert way == pytest.approx(2.0 + 0.5 * (5.0 - 3.0 - 1.5) / M, rel=1e-6)
    assert work["friction slide"][-1] == pytest.approx(-3.0 * way, rel=1e-7)
    assert work["torque slide"][-1] == pytest.approx(5.0 * way, rel=1e-7)
    assert work["wrench block"][-1] == pytest.approx(-1.5 * way, rel=1e-7)
    assert list(work) == ["friction slide", "torque slide", "wrench block"]


def test_power_of_a_motor_is_its_torque_times_its_speed():
    motion = pc.Motion(0.2, 1.0, 0.3, 0.7)
    mech = slider(M, G).with_loops(pc.Drive("motor", "slide", motion))
    sol = pc.simulate(mech, (0.0, 2.0), **TIGHT)
    energy = sol.energy()
    rate = np.array([motion.rate(t) for t in sol.t])
    force = M * (np.array([motion.acceleration(t) for t in sol.t]) + G)
    np.testing.assert_allclose(energy.power["motor"], force * rate, atol=1e-6)
    assert energy.work["motor"][-1] == pytest.approx(energy.total[-1] - energy.total[0], abs=1e-5)


def test_a_users_constraint_that_moves_has_its_power_too():
    """The block is carried by Φ = q - sin t, without derivatives."""
    carried = pc.Constraint("carrier", lambda t, q: [q[0] - np.sin(t)], 1)
    sol = pc.simulate(slider(M, G).with_loops(carried), (0.0, 2.0), **TIGHT)
    expected = M * (G - np.sin(sol.t)) * np.cos(sol.t)
    np.testing.assert_allclose(sol.energy().power["carrier"], expected, atol=1e-6)


def test_names_of_forces_and_drives_do_not_meet():
    mech = slider(M).with_loops(pc.Drive("servo slide", "slide", pc.Motion(speed=1.0)))
    energy = pc.simulate(mech, (0.0, 0.1), forces=[pc.Servo("slide", 0.0, 1.0), {"slide": 1.0}]).energy()
    assert list(energy.power) == ["servo slide", "torque slide", "servo slide 2"]
    assert not energy.stored and not energy.elastic.any()


def test_what_an_impact_takes_is_work_of_events():
    impact = pc.Event(lambda t, q, v, lam: q[0], direction=-1, apply=lambda t, q, v: -0.5 * v)
    sol = pc.simulate(slider(M, G), (0.0, 0.8), {"slide": 1.0}, events=impact)
    energy = sol.energy()
    fall = M * G * 1.0
    assert len(sol.t_events[0]) == 1
    assert energy.work["events"][-1] == pytest.approx(-0.75 * fall, rel=1e-6) and energy.work["events"][0] == 0.0
    assert energy.balance_error < 1e-9
    quiet = pc.simulate(slider(M, G), (0.0, 0.1), {"slide": 1.0}).energy()
    assert quiet.work == {} and quiet.power == {}


def test_backwards_the_same_works_come_out_with_the_other_sign():
    damping = [pc.JointDamping({"slide": 3.0})]
    there = pc.simulate(slider(M, G), (0.0, 0.5), v0={"slide": 3.0}, forces=damping, **TIGHT)
    back = pc.simulate(slider(M, G), (0.5, 0.0), there.q[-1], there.v[-1], forces=damping, **TIGHT)
    works = [sol.energy().work["damping slide"][-1] for sol in (there, back)]
    assert works[0] < -1.0 and works[1] == pytest.approx(-works[0], rel=1e-6)
    assert back.energy().balance_error < 1e-6


def test_the_energy_of_a_stored_solution_needs_its_mechanism(tmp_path):
    mech, forces = slider(M, G), [pc.JointDamping({"slide": 3.0})]
    sol = pc.simulate(mech, (0.0, 0.5), forces=forces)
    back = pc.Solution.load(sol.save(tmp_path / "run"))
    with pytest.raises(pc.InputError, match=r"needs its mechanism here: sol\.energy\(mechanism\)"):
        back.energy()
    with pytest.raises(pc.InputError, match=r"1 forces .*add_forces"):
        back.energy(mech)
    np.testing.assert_array_equal(back.energy(mech.add_forces(*forces)).error, sol.energy().error)
    problem = pc.paper.reference_problem("problem52")
    general = pc.integrate(problem.system, (1.0, 1.1), problem.p0, problem.v0)
    with pytest.raises(pc.InputError, match="energy is defined for mechanisms only"):
        general.energy()
    empty = pc.simulate(pc.load("four_bar"), (0.0, 1.0), t_eval=[1.0], max_steps=5)
    with pytest.raises(pc.InputError, match="no rows"):
        empty.energy()


def test_it_prints_as_a_table():
    energy = pc.simulate(slider(M, G), (0.0, 0.5), {"slide": 1.0}, forces=[pc.JointDamping({"slide": 3.0})]).energy()
    lines = str(energy).splitlines()
    assert [line.split("  ")[0] for line in lines] == [
        "energy, J", "kinetic", "potential", "elastic", "total", "work of damping slide", "balance error",
    ]  # fmt: skip
    assert f"{energy.total[0]:12.5g} {energy.total[-1]:12.5g}" in lines[4]


def test_rest_where_the_weights_cancel_is_no_alarm():
    """Two rods of a triangle on the ground, one above and one below zero: nothing moves, the total is zero."""
    model, last = pin.Model(), 0
    for i, place in enumerate((1.0, -1.0)):
        last = model.addJoint(last, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([0, 0, place])), f"j{i}")
        model.appendBodyToJoint(last, pin.Inertia(1.0, np.array([0.0, 0, -0.5]), np.eye(3) / 12), pin.SE3.Identity())
    model.addFrame(pin.Frame("tip", last, 0, pin.SE3(np.eye(3), np.array([0.0, 0, -1])), pin.FrameType.OP_FRAME))
    held = pc.Loop("held", "point", "tip", xyz2=(0.0, 0.0, -0.96))
    sol = pc.simulate(pc.Mechanism(model, [held]), (0.0, 0.3), {"j0": 0.2})
    assert np.abs(sol.energy().total).max() < 2.0 and sol.energy().balance_error < 1e-6 and not sol.check().concerns


def test_the_work_of_forces_between_few_rows_is_by_states():
    """Six rows of a run that is right; one with steps that are too long is still named."""
    mech = pc.load("four_bar").add_forces(pc.JointDamping({"crank": 0.5}))
    few = pc.simulate(mech, (0.0, 2.0), t_eval=np.linspace(0.0, 2.0, 6)).check(error=False)
    assert few.energy_error < 1e-5 and few.ok and "energy balanced to" in few.verdict
    wrong = pc.simulate(mech, (0.0, 2.0), step=0.05, order=1, method="BDF").check(error=False)
    assert not wrong.ok and "energy balance" in " ".join(wrong.concerns)


def test_the_work_in_single_steps_between_jumps():
    """Two powers do not tell it: the balance was off by 5 %."""
    mech = pc.load("crank_rocker").add_forces(pc.Actuator("servo", "crank", (20.0, 0, 0), (0, -20.0, -1.0)))
    sim = pc.Simulation(mech, rtol=1e-9, atol=1e-11)
    for command in (0.3, 0.3, -0.5, -0.5, 0.0, 1.0):
        sim.step(0.02, {"servo": command})
    check = sim.solution().check(error=False)
    assert check.energy_error < 1e-8 and check.ok


@pytest.mark.parametrize("rows", [8, 40])
def test_what_impacts_take_counts_at_rows_of_ones_own(rows):
    """A bouncing ball in oil: few rows, none of them at an impact."""
    oil = pc.JointDamping({"z": 0.5})
    for kept in (
        {"events": pc.Impact("z", lower=0.0, restitution=0.8), "mech": touching.ball().with_contacts()},
        {"mech": touching.ball().with_contacts(pc.Stop("z", lower=0.0, restitution=0.8))},
    ):
        mech = kept.pop("mech").add_forces(oil)
        sol = pc.simulate(mech, (0.0, 1.5), {"z": 1.0}, t_eval=np.linspace(0.0, 1.5, rows), **kept)
        assert sol.energy().balance_error < 1e-3 and sol.check().energy_error < 1e-3
        assert sol.check().ok


def test_work_of_a_motor_on_what_touches_all_the_time():
    """A cam under a follower that never lifts off: its motor works against the follower, too."""
    cam, radius = 0.01, 0.05
    model = pin.Model()
    shaft = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "shaft")
    model.appendBodyToJoint(shaft, pin.Inertia(1.0, np.zeros(3), 1e-3 * np.eye(3)), pin.SE3.Identity())
    place = pin.SE3(np.eye(3), np.array([cam, 0.0, 0.0]))
    model.addFrame(pin.Frame("centre", shaft, 0, place, pin.FrameType.OP_FRAME))
    tappet = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "tappet")
    model.appendBodyToJoint(tappet, pin.Inertia(2.0, np.zeros(3), 1e-3 * np.eye(3)), pin.SE3.Identity())
    face = pc.Contact("face", "centre", radius=radius, normal=(0.0, 0.0, -1.0), on="tappet")
    motor = pc.Drive("motor", "shaft", pc.Motion(speed=20.0))
    mech = pc.Mechanism(model, [motor], [pc.JointDamping({"tappet": 3.0})], contacts=[face])
    sol = pc.simulate(mech, (0.0, 1.0), {"tappet": radius}, {"shaft": 20.0, "tappet": -20.0 * cam})
    assert [each.mode for each in sol.modes] == ["closed"]
    assert sol.check().energy_error < 1e-3
    speed = -20.0 * cam * np.cos(20.0 * sol.t)
    mean = 3.0 * (20.0 * cam) ** 2 / 2.0
    assert sol.energy().work["motor"][-1] == pytest.approx(
        mean * (1.0 + np.sin(40.0) / 40.0) + speed[-1] ** 2 - speed[0] ** 2 - 2.0 * 9.81 * cam * np.sin(20.0), rel=1e-4
    )
