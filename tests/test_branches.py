"""Positions where branches of a motion meet are named in the verdict of a run that passes them."""

import numpy as np
import pinocchio as pin
import pytest
from helpers.bodies import frame_pose

import pinconsist as pc


@pytest.mark.parametrize("method", ["BDF", "Radau"])
@pytest.mark.parametrize("speed", [1.0, -7.3])
def test_a_parallelogram_passes_its_change_points(method, speed):
    """All links are on one line where the crank, vertical at 0, lies along the ground: twice in each turn."""
    mech = pc.load("n_four_bar_1")
    sol = pc.simulate(mech, (0.0, 3.0), v0={"crank0": speed}, method=method, rtol=1e-8, atol=1e-10)
    crank = sol.position("crank0")
    quarters = np.floor(crank / np.pi + 0.5)
    passed = quarters[1:] != quarters[:-1]
    found = sol.check()
    assert len(found.branches) == np.count_nonzero(passed) > 1
    there = pc.simulate(mech, (0.0, 3.0), v0={"crank0": speed}, t_eval=found.branches)
    assert np.abs(np.cos(there.position("crank0"))).max() < 1e-3
    assert not found.ok and found.verdict.endswith("look at branches")
    assert f"at t = {found.branches[0]:.6g}" in str(found)


def test_a_symmetric_five_bar_falls_through_a_position_where_a_small_torque_decides():
    mech = pc.load("five_bar")
    times = np.linspace(0.0, 0.6, 121)
    alone, *pushed = (
        pc.simulate(mech, (0.0, 0.6), t_eval=times, forces=forces)
        for forces in ([], *([pc.JointTorque({"left_crank": torque})] for torque in (1e-3, -1e-3)))
    )
    found = alone.check()
    assert len(found.branches) == 1 and found.concerns[-1].startswith("the loops pass a singular configuration")
    before = times < found.branches[0] - 0.02
    apart = np.abs(pushed[0].q - pushed[1].q).max(axis=1)
    assert apart[before].max() < 0.01 and apart[-1] > 0.5
    at = np.searchsorted(times, found.branches[0])
    left, right = (arm(mech, alone.q[at], side) for side in ("left", "right"))
    assert abs(left[0] * right[2] - left[2] * right[0]) < 0.1 * np.linalg.norm(left) * np.linalg.norm(right)


def arm(mech, q, side):
    """From the elbow of a side to the tip."""
    (loop,) = (loop for loop in mech.loops if loop.name == "tip")
    tip = frame_pose(mech.model, q, loop.frame1) * loop.placement1
    elbow = mech.model.getJointId(f"{side}_distal")
    data = mech.model.createData()
    pin.forwardKinematics(mech.model, data, q)
    return tip.translation - data.oMi[elbow].translation


@pytest.mark.parametrize("name", ["crank_rocker", "slider_crank", "delta_robot", "bricard", "double_pendulum"])
def test_mechanisms_that_stay_away_from_such_positions_are_no_alarm(name):
    assert pc.simulate(pc.load(name), (0.0, 1.0)).check().branches == ()


def test_a_motion_that_ends_before_is_no_alarm():
    sol = pc.simulate(pc.load("n_four_bar_1"), (0.0, 0.6), v0={"crank0": 1.0})
    assert 0.2 < np.cos(sol.position("crank0")).min() < 0.9 and sol.check().branches == ()
