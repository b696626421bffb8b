"""A mechanism with contacts is either understood or refused by name: nothing leaves its contacts out in silence."""

from dataclasses import replace

import numpy as np
import pytest

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


def test_the_referee_leaves_them_out_and_says_so(touching):
    with pytest.warns(UserWarning, match="leaves out its contacts"):
        judgement = pc.referee(touching, (0.0, 0.02), tools=["pinconsist"])
    assert judgement.rows
