"""All modes of assembly, against geometry."""

from __future__ import annotations

import json

import numpy as np
import pinocchio as pin
import pytest
from helpers.command_line import called

import pinconsist as pc
from pinconsist.mechanism.assembly_modes import assembly_modes


def ends(mech, q, frame):
    data = mech.model.createData()
    pin.framesForwardKinematics(mech.model, data, np.asarray(q))
    return data.oMf[mech.model.getFrameId(frame)].translation


def meeting(a, r, b, s):
    """The two points at the distances r of a and s of b, in the x-z plane."""
    between = b - a
    d = np.linalg.norm(between)
    along = (d**2 + r**2 - s**2) / (2 * d)
    across = np.array([-between[2], 0.0, between[0]]) / d
    height = np.sqrt(r**2 - along**2)
    return [a + along * between / d + side * height * across for side in (1.0, -1.0)]


@pytest.mark.parametrize("crank", [-1.0, 0.4, 2.0])
def test_a_four_bar_has_the_two_intersections_of_two_circles(crank):
    """Bars of 1, 2 and 1.5 m on pivots 2.2 m apart."""
    mech = pc.load("four_bar")
    found = assembly_modes(mech, {"crank": crank})
    assert found.held == ("crank",) and len(found.modes) == 2
    start = np.array([np.cos(crank), 0.0, -np.sin(crank)])
    points = meeting(start, 2.0, np.array([2.2, 0.0, 0.0]), 1.5)
    tips = [ends(mech, mode.q, "coupler_tip") for mode in found.modes]
    for point in points:
        assert min(np.linalg.norm(point - tip) for tip in tips) < 1e-8
    first = pc.assemble(mech, {"crank": crank}).q
    np.testing.assert_array_equal(found.modes[0].q, first)
    assert all(mode.gap < 1e-8 and mode.q[0] == pytest.approx(crank, abs=1e-12) for mode in found.modes)
    assert np.abs(found.modes[1].q - first).max() <= np.pi  # no turns more than needed


def test_three_dyads_have_eight_modes_and_each_is_closed():
    mech = pc.load("jansen_leg")
    found = assembly_modes(mech)
    assert len(found.modes) == 8 and found.held == ()  # its crank is driven
    for mode in found.modes:
        assert pc.assemble(mech, mode.q).largest_gap[1] < 1e-9


def test_the_modes_of_a_platform_on_a_plane_base_are_mirror_images():
    """Each has its image in the plane of the base; the spin of legs and the angles of their joints do not count."""
    mech = pc.load("stewart_platform")
    found = assembly_modes(mech)
    assert len(found.held) == 6 and len(found.modes) % 2 == 0
    middles = np.array([ends(mech, mode.q, mech.loops[0].frame2) for mode in found.modes])
    joints = [mech.model.joints[1 + i] for i in range(mech.model.njoints - 1)]
    level = {round(float(mech.model.jointPlacements[j.id].translation[2]), 9) for j in joints
             if mech.model.parents[j.id] == 0 and mech.model.names[j.id].startswith("leg")}  # fmt: skip
    assert len(level) == 1
    mirrored = middles * [1.0, 1.0, -1.0] + [0.0, 0.0, 2.0 * level.pop()]
    for image in mirrored:
        assert np.linalg.norm(middles - image, axis=1).min() < 1e-5


def test_a_mechanism_without_another_mode_has_one():
    found = assembly_modes(pc.load("double_pendulum"))
    assert len(found.modes) == 1 and len(found.held) == 2


def test_the_command_lists_them(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, err = called(capsys, "assemble", "five_bar", "--all-modes", "--html", "modes.html")
    assert '"clock":[0.0,1.0,0.0,1]' in (tmp_path / "modes.html").read_text(encoding="utf-8")  # nothing plays
    assert (code, err) == (0, "")
    assert "2 assembly modes with left_crank, right_crank held" in out and "mode 2" in out
    assert all(f"mode {i}" in (tmp_path / "modes.html").read_text() for i in (1, 2))
    code, out, _ = called(capsys, "assemble", "five_bar", "--all-modes", "--at", "left_crank=2", "--json")
    record = json.loads(out)
    assert code == 0 and record["held"][0] == "left_crank" and len(record["modes"]) == 2
    assert all(mode["q"]["left_crank"] == pytest.approx(2.0) for mode in record["modes"])
    code, out, _ = called(capsys, "assemble", "four_bar", "--json")
    assert code == 0 and list(json.loads(out)["modes"][0]["q"].values()) == pytest.approx(
        pc.assemble(pc.load("four_bar")).q
    )
    code, _, err = called(capsys, "assemble", "four_bar", "--at", "crank=0.3", "rocker=0.1", "--all-modes")
    assert code == 2 and "the loops do not close with these positions of" in err
