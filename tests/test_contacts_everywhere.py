"""A mechanism with contacts is either understood or refused by name: nothing leaves its contacts out in silence."""

import json
from dataclasses import replace

import numpy as np
import pytest
from helpers.command_line import called

import pinconsist as pc


@pytest.fixture(scope="module", params=["four_bar", "crank_rocker"])
def touching(request):
    """A four-bar with a stop, and one with friction in its pin."""
    contact = {
        "four_bar": pc.Stop("crank", lower=-1.2, upper=2.0),
        "crank_rocker": pc.PinFriction("rocker_ground", 0.01, (0.2, 0.1)),
    }
    return pc.load(request.param).with_contacts(contact[request.param])


REFUSING = {
    "equilibrium": lambda mech, tmp: pc.equilibrium(mech),
    "linearize": lambda mech, tmp: pc.linearize(mech),
    "inverse_dynamics": lambda mech, tmp: pc.inverse_dynamics(mech.add_loops(pc.Drive("m", "crank", np.sin)), [0, 1]),
    "forward_dynamics": lambda mech, tmp: pc.forward_dynamics(mech, mech.guess),
    "Actuation": lambda mech, tmp: pc.Actuation(mech, ["crank"]),
    "serial_equivalent": lambda mech, tmp: pc.serial_equivalent(mech, ["rocker"], motors=["crank"]),
    "sensitivities": lambda mech, tmp: pc.sensitivities(mech, ["mass:crank"], (0.0, 0.1)),
    "gradient": lambda mech, tmp: pc.gradient(mech, ["mass:crank"], (0.0, 0.1), terminal=lambda t, q, v, lam: q[0]),
    "BDF": lambda mech, tmp: pc.simulate(mech, (0.0, 0.1), method="BDF"),
    "backwards": lambda mech, tmp: pc.simulate(mech, (0.1, 0.0)),
    "sdf": lambda mech, tmp: pc.write(mech, tmp / "it.sdf"),
    "mjcf": lambda mech, tmp: pc.write(mech, tmp / "it.xml"),
    "usd": lambda mech, tmp: pc.write(mech, tmp / "it.usda"),
}


@pytest.mark.parametrize("entry", REFUSING)
def test_what_has_no_contacts_refuses_them(touching, tmp_path, entry):
    with pytest.raises(pc.InputError, match="contact"):
        REFUSING[entry](touching, tmp_path)
    assert not list(tmp_path.iterdir())


def test_what_a_file_and_a_record_say_of_contacts(touching, tmp_path):
    back = pc.load(pc.write(touching, tmp_path / "it.urdf"))
    assert [vars(each) for each in back.contacts] == [vars(each) for each in touching.contacts]
    (contact,) = touching.contacts
    assert f"contacts {contact.name} ({contact.kind})" in str(touching)
    assert f"{contact.kind} {contact.name}" in touching._repr_html_()
    run = tmp_path / "run.npz"
    pc.record(touching, (0.0, 0.2), run)
    other = touching.with_contacts(replace(contact, name="other"))
    assert pc.rerun(run, scene=touching).same
    assert "different contacts" in str(pc.rerun(run, scene=other).differences)


def test_a_record_keeps_in_which_direction_contacts_slide(tmp_path):
    """A joint with dry friction that bounces slides to and fro without rest; the friction turns with it."""
    mech = pc.load("planar_pendulum").with_contacts(
        pc.Stop("pendulum", upper=0.5, lower=-2.0, restitution=0.6), pc.DryFriction("pendulum", 0.5)
    )
    sol = pc.simulate(mech, (0.0, 1.5), {"pendulum": 0.4}, {"pendulum": 6.0})
    for save_every in (None, 0.3):
        options = {} if save_every is None else {"save_every": save_every}
        kept = pc.record(mech, (0.0, 1.5), tmp_path / f"{save_every}", {"pendulum": 0.4}, {"pendulum": 6.0}, **options)
        assert len(kept.impacts) == len(sol.impacts) > 1
        directions = [np.sign(run.contact("pendulum friction").force) for run in (sol, kept)]
        assert len(kept.contacts.tables) == len(sol.contacts.tables)
        assert set(directions[0]) == set(directions[1]) >= {-1.0, 1.0}
        assert kept.check().force < 1e-6


def test_check_tells_contacts_and_counts_only_limits_without_a_stop(tmp_path, capsys):
    robot = (
        '<robot name="bar"><link name="wall"/><link name="bar"><inertial><mass value="1"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link><link name="tip"><inertial>'
        '<mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )
    for joint, parent, child in (("swing", "wall", "bar"), ("wrist", "bar", "tip")):
        robot += (
            f'<joint name="{joint}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
            '<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
        )
    path = tmp_path / "bar.urdf"
    path.write_text(robot + "</robot>")
    path.with_suffix(".yaml").write_text("contacts: [{kind: stop, joint: swing, restitution: 0.3}]")
    code, out, _ = called(capsys, "check", path)
    rows = [line.split() for line in out.splitlines()]
    assert code == 0 and "swing stop joint swing, restitution 0.3".split() in rows
    assert "without effect: limits of 1 joint (watched, not enforced)" in out
    told = json.loads(called(capsys, "check", path, "--json")[1])
    assert told["contacts"] == [{"kind": "stop", "joint": "swing", "restitution": 0.3, "name": "swing"}]
    path.with_suffix(".yaml").write_text("contacts: [{kind: stop, joint: swung}]")
    assert "no joint 'swung'; similar: swing" in called(capsys, "check", path)[2]


def test_the_referee_leaves_them_out_and_says_so(touching):
    with pytest.warns(UserWarning, match="leaves out its contacts"):
        judgement = pc.referee(touching, (0.0, 0.02), tools=["pinconsist"])
    assert judgement.rows
