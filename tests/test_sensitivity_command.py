"""`pinconsist sensitivity`, against geometry; and parameters by name in `pinconsist sweep`."""

import json
from functools import partial

import numpy as np
import pinocchio as pin
import pytest
from helpers.command_line import called

import pinconsist as pc


@pytest.fixture
def run(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return partial(called, capsys)


def foot(mech, t):
    """Where the leg's foot is at a time: its crank is driven, so that geometry alone says it."""
    q = pc.assemble(mech, t=t).q
    data = mech.model.createData()
    pin.framesForwardKinematics(mech.model, data, q)
    return data.oMf[mech.model.getFrameId("foot")].translation.copy()


def test_the_foot_of_a_leg_by_its_lengths(run):
    code, out, err = run(
        "sensitivity", "jansen_leg", "--of", "foot", "--to", "length", "motor.speed", "--until", "0.05", "--json"
    )
    assert code == 0, err
    found = json.loads(out)
    mech = pc.load("jansen_leg")
    assert found["quantities"] == ["x", "y", "z"] and not found["refused"] and len(found["rows"]) == 7
    for row in found["rows"]:
        step = 1e-4 * row["value"]
        sides = (foot(mech.with_parameters({row["parameter"]: row["value"] + way}), 0.05) for way in (step, -step))
        exact = np.subtract(*sides) / (2 * step)
        np.testing.assert_allclose(row["derivatives"], exact, atol=1e-6 * (1 + np.abs(exact).max()))
        assert row["percent"] == pytest.approx(0.01 * row["value"] * np.linalg.norm(exact), rel=1e-4)


def test_lengths_that_part_a_loop_are_left_out_and_named(run):
    code, out, _ = run("sensitivity", "bricard", "--of", "hinge5", "--to", "mass", "length:hinge1", "--until", "0.05")
    assert code == 0 and "mass:hinge4" in out and "left out: length:hinge1" in out
    code, _, err = run("sensitivity", "bricard", "--of", "hinge5", "--to", "length:hinge1", "--until", "0.05")
    assert code == 2 and "cannot vary alone" in err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("four_bar",), "--of NAME (a frame"),
        (("four_bar", "--of", "crnk", "--to", "mass"), "no joint, loop, frame or force 'crnk'"),
        (("four_bar", "--of", "crank", "--to", "mas:crank"), "no parameter 'mas:crank'"),
        (("four_bar", "--of", "crank", "--to", "stiffness"), "no parameters of the kind stiffness"),
    ],
)
def test_refusals(run, arguments, words):
    code, _, err = run("sensitivity", *arguments)
    assert code == 2 and words in " ".join(err.split())


def test_of_a_joint_with_an_initial_velocity(run):
    start = "--with-velocity", "crank=12", "--until", "0.1"
    code, out, _ = run("sensitivity", "crank_rocker", "--of", "crank", "--to", "mass:coupler", "crank_speed", *start)
    assert code == 0 and "mass:coupler" in out and "crank_speed" in out and "12" in out


def test_a_sweep_varies_parameters_by_name(run):
    code, out, _ = run("sweep", "four_bar", "--vary", "mass:coupler=1:2:0.5", "--until", "0.05", "--json")
    rows = json.loads(out)["rows"]
    assert code == 0 and [row[1] for row in rows] == [1.0, 1.5, 2.0] and rows[0][2:] != rows[1][2:]
