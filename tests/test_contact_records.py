"""Contacts as records: files, messages, results, saved and continued runs, controllers and events."""

import pickle

import numpy as np
import pinocchio as pin
import pytest
from helpers import touching
from helpers.touching import G

import pinconsist as pc


def test_a_loop_file_holds_contacts(tmp_path):
    mech = pc.load("planar_pendulum").with_contacts(
        pc.Stop("pendulum", -0.9, 0.5, restitution=0.3),
        pc.DryFriction("pendulum", (0.4, 0.3)),
        pc.Contact("tip", "pendulum_tip", offset=-0.9, friction=(0.8, 0.6)),
        pc.Rope("rope", "pendulum_tip", length=2.5, xyz2=(0.0, 0.0, 1.0)),
    )
    back = pc.load(pc.write(mech, tmp_path / "scene.urdf"))
    assert back.contacts == mech.contacts
    one, other = (pc.simulate(each, (0.0, 1.0), [0.3], [1.0]) for each in (mech, back))
    np.testing.assert_allclose(other.q[-1], one.q[-1], atol=1e-9)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ("{kind: stop, joint: knee}", "contact 1 .stop.: .*no joint 'knee'"),
        ("{kind: stop, joint: pendulum, uper: 0.1}", "contact 1 .stop.: the key 'uper' is not known; similar: upper"),
        ("{kind: stopp, joint: pendulum}", "contact 1: unknown kind 'stopp'"),
        ("{kind: stop, joint: pendulum, lower: 1, upper: 0}", "lower must be below upper"),
        ("{kind: contact, name: a, frame: foot}", "no frame 'foot'"),
        ("{kind: rope, name: a, frame1: pendulum_tip}", "length must be greater than 0"),
    ],
)
def test_messages_name_the_contact_of_a_file(tmp_path, entry, message):
    mech = pc.load("planar_pendulum")
    path = pc.write(mech, tmp_path / "scene.urdf")
    loops = path.with_suffix(".yaml")
    loops.write_text((loops.read_text() if loops.exists() else "") + f"\ncontacts:\n  - {entry}\n")
    with pytest.raises(pc.FormatError, match=message):
        pc.load(path)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: pc.Stop("a", 1.0, 0.0), "lower must be below upper"),
        (lambda: pc.Stop("a", restitution=1.5), "restitution must be from 0 to 1"),
        (lambda: pc.Stop("a", upper=np.nan), "not finite"),
        (lambda: pc.Stop(3), "stop: joint"),
        (lambda: pc.Contact("c", "f", normal=(0, 0, 0)), "the normal is the zero vector"),
        (lambda: pc.Contact("c", "f", friction=(0.5, 0.8)), "kinetic friction must not be above the static one"),
        (lambda: pc.Contact("c", "f", friction="much"), "friction must be"),
        (lambda: pc.Contact("c", "f", radius=0.1, friction=0.3), "a sphere with friction may roll"),
        (lambda: pc.Rope("r", "a", length=0.0), "length must be greater than 0"),
        (lambda: pc.DryFriction("j", -1.0), "at least 0"),
        (lambda: touching.ball().with_contacts(pc.Stop("knee", 0.0, 1.0)), "the model has no joint 'knee'"),
        (lambda: touching.ball().with_contacts(pc.Contact("c", "foot")), "the model has no frame 'foot'"),
        (lambda: touching.ball().with_contacts(pc.Stop("z", 0.0), pc.Stop("z", 0.0)), "two contacts or loops"),
        (lambda: touching.ball().with_contacts("floor"), "Contact, DryFriction and PinFriction objects"),
        (lambda: touching.ball().with_contacts(pc.Rope("r", "z", "z", length=1.0)), "are on the same body"),
        (lambda: touching.ball().with_contacts(pc.Stop("z")), "has no limits in its file"),
        (lambda: pc.simulate(touching.ball(), (0, 1), {"z": -0.1}), "violated by 0.1 at the start"),
        (lambda: pc.simulate(touching.ball(), (1, 0), {"z": 1.0}), "cannot run backwards in time"),
        (lambda: pc.simulate(touching.ball(), (0, 1), {"z": 1.0}, method="BDF"), "take method='Radau'"),
        (lambda: pc.simulate(touching.ball(), (0, 1), {"z": 1.0}).contact("floor"), "no contact 'floor'"),
    ],
)
def test_bad_input_is_named(make, message):
    with pytest.raises(pc.InputError, match=message):
        make()


def test_derivatives_are_refused():
    with pytest.raises(pc.InputError, match="a differentiated run does not support contacts"):
        pc.sensitivities(touching.ball(), ["mass:z"], (0.0, 1.0), {"z": 1.0})


def test_limits_of_a_file_are_the_stops_by_default():
    model = touching.ball().model.copy()
    model.lowerPositionLimit[:], model.upperPositionLimit[:] = -0.2, 0.7
    mech = pc.Mechanism(model, contacts=[pc.Stop("z")])
    sol = pc.simulate(mech, (0.0, 1.0))
    assert sol.q[-1, 0] == pytest.approx(-0.2)
    assert [each.name for each in mech.contact_elements] == ["z lower", "z upper"]


def test_contacts_are_added_replaced_locked_and_vary_as_parameters():
    mech = touching.block(pc.Contact("c", "z"), slope=0.1)
    both = mech.add_contacts(pc.Stop("x", upper=1.0))
    assert [each.name for each in both.contacts] == ["c", "x"] and mech.with_contacts().contacts == ()
    assert [each.name for each in both.lock("x").contacts] == ["c"]
    assert both.with_parameters({"x.upper": 0.5}).contacts[1].upper == 0.5


def test_results_have_names_units_and_files(tmp_path):
    mech = touching.block(pc.Contact("c", "z", friction=0.5), slope=0.3)
    sol = pc.simulate(mech, (0.0, 0.5), [0.0, 0.3])
    assert mech.row_labels == [("c", "n"), ("c", "t1")] and sol.lam.shape[1] == 2
    names = sol.to_csv(tmp_path / "run.csv").read_text().splitlines()[0]
    assert "lam.c.n [N],lam.c.t1 [N]" in names
    np.testing.assert_allclose(sol.at(0.45).lam[0], sol.lam[-1], rtol=1e-9)
    for other in (pc.Solution.load(sol.save(tmp_path / "run.npz")), pickle.loads(pickle.dumps(sol))):
        assert other.modes == sol.modes and len(other.impacts) == 1
        assert other.impacts[0].energy_lost == pytest.approx(sol.impacts[0].energy_lost)
        np.testing.assert_array_equal(other.contact("c", mech).force, sol.contact("c").force)
        assert other.check(mech).ok


def test_joint_forces_include_contacts():
    """The rail x carries nothing but what is not on the floor: the whole weight stands on the contact."""
    sol = pc.simulate(touching.block(pc.Contact("c", "z", friction=0.5)), (0.0, 0.2))
    np.testing.assert_allclose(sol.joint_force("x").force[-1], 0.0, atol=1e-12)


def test_a_run_is_recorded_and_resumed_inside_a_mode(tmp_path):
    mech = touching.block(pc.Contact("c", "z", friction=0.2, restitution=0.4), slope=0.3)
    whole = pc.simulate(mech, (0.0, 2.0), [0.0, 0.5])
    parts = pc.record(mech, (0.0, 2.0), tmp_path / "run.npz", [0.0, 0.5], save_every=0.7)
    assert parts.success and len(parts.impacts) == len(whole.impacts)
    np.testing.assert_allclose(parts.q[-1], whole.q[-1], atol=1e-5)
    assert pc.Solution.load(tmp_path / "run.npz").modes == parts.modes


def test_a_simulation_steps_through_impacts_and_is_copied_inside_a_mode():
    mech = touching.block(pc.Contact("c", "z", friction=0.5, restitution=0.5), slope=0.3)
    whole = pc.simulate(mech, (0.0, 2.0), [0.0, 0.4], [1.0, 0.0])
    sim = pc.Simulation(mech, [0.0, 0.4], [1.0, 0.0])
    for _ in range(100):
        sim.step(0.01)
    other = sim.copy()
    for _ in range(100):
        sim.step(0.01)
        other.step(0.01)
    np.testing.assert_allclose(sim.state.q, whole.q[-1], atol=1e-5)
    np.testing.assert_allclose(other.state.q, sim.state.q, atol=1e-9)
    assert sim.solution().check(error=False).ok


def test_a_controller_pushes_a_block_until_it_slides():
    """The torque jumps at 0.5 s to more than friction holds, and back."""
    law = pc.HeldTorque([0.0, 0.5, 1.0], [[0.0, 0.0], [8.0, 0.0], [2.0, 0.0]])
    mech = touching.block(pc.Contact("c", "z", friction=(0.6, 0.5)), forces=[law])
    sol = pc.simulate(mech, (0.0, 3.0))
    acceleration = 8.0 - 0.5 * G
    stop = 1.0 + 0.5 * acceleration / (0.5 * G - 2.0)
    assert [each.mode for each in sol.modes] == ["stick", "slip", "stick"]
    assert sol.modes[1].t_begin == pytest.approx(0.5) and sol.modes[1].t_end == pytest.approx(stop, rel=1e-9)
    sim = pc.Simulation(touching.block(pc.Contact("c", "z", friction=(0.6, 0.5))))
    for torque in (0.0, 8.0):
        sim.step(0.5, {"x": torque})
    assert sim.state.v[0] == pytest.approx(0.5 * acceleration, rel=1e-9)


def test_events_of_the_user_happen_with_those_of_contacts():
    seen = []
    events = [
        pc.Event(lambda t, q, v, lam: q[0] - 0.3, name="passes"),
        pc.Event(lambda t, q, v, lam: lam[0] - 5.0, terminal=True, name="carried"),
    ]
    mech = touching.ball(0.5)
    sol = pc.simulate(mech, (0.0, 10.0), {"z": 1.0}, events=events, callback=lambda *row: seen.append(row))
    assert sol.status == 1 and "carried" in sol.message and len(sol.t_events[0]) == 1
    assert sol.t[-1] == pytest.approx(np.sqrt(2 / G) * 3.0, abs=1e-4)
    kick = pc.Event(lambda t, q, v, lam: t - 5.0, apply=lambda t, q, v: {"z": 2.0}, name="kick")
    sol = pc.simulate(mech, (0.0, 5.1), {"z": 1.0}, events=kick)
    assert sol.q[-1, 0] == pytest.approx(0.2 - 0.5 * G * 0.01, rel=1e-9)


def test_rows_at_given_times_and_dense_output():
    mech = touching.ball(0.5)
    times = np.linspace(0.0, 2.0, 41)
    rows = pc.simulate(mech, (0.0, 2.0), {"z": 1.0}, t_eval=times)
    dense = pc.simulate(mech, (0.0, 2.0), {"z": 1.0}, dense_output=True)
    np.testing.assert_allclose(dense.sol(times)[0], rows.q, atol=1e-9)
    assert rows.lam[-1, 0] == pytest.approx(G) and dense.sol(1.9)[2][0] == pytest.approx(G)
    assert rows.contact("z").mode[-1] == "closed"


def test_a_mechanism_that_floats_stands_with_its_weight_on_its_feet():
    """On SO(3): a table that is dropped turned, with enough friction, comes to rest on its legs."""
    mech = touching.table([(0.5, 0.4), (-0.5, 0.4), (0.5, -0.4), (-0.5, -0.4)], friction=0.7)
    start = mech.q({"table": [0.0, 0.0, 0.7, 0.05, 0.1, 0.3]})
    sol = pc.simulate(mech, (0.0, 3.0), start, rtol=1e-5)
    assert sol.success, sol.message
    assert np.abs(sol.v[-1]).max() < 1e-6
    height = sum(sol.contact(f"leg{i}").force[-1][2] for i in range(4))
    assert height == pytest.approx(2.0 * G, rel=1e-6)
    certificate = sol.check(error=False)
    assert certificate.position < 1e-8, str(certificate)


def test_a_page_shows_a_run_with_contacts(tmp_path):
    sol = pc.simulate(touching.ball(0.5), (0.0, 1.0), {"z": 1.0})
    assert sol.export_html(tmp_path / "run.html").exists()


def test_runs_without_contacts_have_no_modes():
    sol = pc.simulate(touching.ball().with_contacts(), (0.0, 0.1))
    assert sol.modes == [] and sol.impacts == () and sol.contacts is None
    assert isinstance(sol.mechanism.model, pin.Model)


def test_tables_and_quantities_have_gaps_forces_and_modes(tmp_path):
    """A ball with friction of its rail: at 0.1 m it falls, and rests on its stop."""
    mech = touching.ball().add_contacts(pc.DryFriction("z", 1.0))
    sol = pc.simulate(mech, (0.0, 1.0), {"z": 0.1})
    text = sol.to_csv(tmp_path / "run.csv").read_text().splitlines()
    headings, last = text[0].split(","), [float(each) for each in text[-1].split(",")]
    row = dict(zip(headings, last, strict=True))
    assert row["gap.z [m]"] == pytest.approx(0.0, abs=1e-12)
    assert row["force.z [N]"] + row["force.z friction [N]"] == pytest.approx(9.81)
    assert row["mode.z [0 open; 1 closed; 2 stick; 3 slip]"] == 1.0
    assert row["mode.z friction [0 open; 1 closed; 2 stick; 3 slip]"] == 2.0
    assert sol.evaluate("gap z lower at 0") == pytest.approx(0.1)
    fall = np.sqrt(2.0 * 0.1 * (9.81 - 1.0))
    assert sol.evaluate("max slip z friction") == pytest.approx(fall, rel=1e-6)
    with pytest.raises(pc.InputError, match="no contact 'heel'"):
        sol.evaluate("gap heel")


def test_quantities_of_a_point_are_vectors():
    mech = touching.block(pc.Contact("heel", "z", friction=0.5), slope=0.3)
    sol = pc.simulate(mech, (0.0, 1.0))
    assert sol.evaluate("contact heel z") == pytest.approx(9.81 * np.cos(0.3))
    assert sol.evaluate("peak contact heel") == pytest.approx(9.81)


def test_what_the_refusal_to_linearise_advises_works():
    """A pendulum that rests on its stop, and one whose tip sticks to a wall, held by loops instead."""
    mech = pc.load("planar_pendulum")
    sim = pc.Simulation(mech.with_contacts(pc.Stop("pendulum", upper=0.5)))
    sim.step(1e-3)
    with pytest.raises(pc.InputError, match="with_contacts") as raised:
        sim.linearized(1e-3)
    assert "pc.Loop of kind 'point'" in str(raised.value) and "pc.Drive" in str(raised.value)
    for other in (mech.with_contacts(), mech.add_loops(pc.Drive("held", "pendulum", pc.Motion(start=0.5)))):
        free = pc.Simulation(other, *sim_state(other))
        free.step(1e-3)
        A, _ = free.linearized(1e-3)
        assert np.isfinite(A).all()


def sim_state(mech):
    assembly = pc.assemble(mech)
    return assembly.q, assembly.v
