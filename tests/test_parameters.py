"""Parameters by name: what they are, what they change, and what is said of unknown ones."""

import numpy as np
import pinocchio as pin
import pytest

import pinconsist as pc
from pinconsist.mechanism.parameters import names_of, parameter


def test_numbers_of_bodies():
    mech = pc.load("crank_rocker")
    values = {"mass:coupler": 2.1, "com:coupler[0]": 0.3, "inertia:coupler[yy]": 0.07, "gravity[2]": -1.62}
    changed = mech.with_parameters(values)
    for name, value in values.items():
        assert parameter(changed, name).value == pytest.approx(value, rel=1e-14)
    before, after = (each.model.inertias[2] for each in (mech, changed))
    assert after.mass == 2.1 and after.lever[0] == 0.3 and after.lever[1] == before.lever[1]
    assert after.inertia[1, 1] == 0.07 and after.inertia[0, 0] == before.inertia[0, 0]
    assert mech.model.inertias[2].mass == before.mass != 2.1  # the first is what it was
    assert changed.model.gravity.linear[2] == -1.62


def test_lengths_of_joints_and_of_frames():
    mech = pc.load("crank_rocker")
    changed = mech.with_parameters({"length:rocker": 0.9, "length:rocker_tip": 0.5})
    q = np.array([0.2, 0.4, -0.1])
    data = changed.model.createData()
    pin.framesForwardKinematics(changed.model, data, q)
    arm = np.linalg.norm(data.oMi[3].translation - data.oMi[2].translation)
    tip = data.oMf[changed.model.getFrameId("rocker_tip")].translation
    assert arm == pytest.approx(0.9) and np.linalg.norm(tip - data.oMi[3].translation) == pytest.approx(0.5)


def test_numbers_of_loops_and_forces():
    mech = pc.load("andrews").add_forces(pc.JointDamping({"beta": 0.2}), pc.JointSpring("theta", 3.0, 0.1))
    values = {
        "stiffness:D-stage": 300.0, "length:D-stage": 0.08, "anchor:E3.xyz2[1]": 0.01, "damping:beta": 0.3,
        "stiffness:theta": 4.0, "damping:theta": 0.5, "friction:theta": 0.6, "torque beta.beta": 0.04,
    }  # fmt: skip
    changed = mech.with_parameters(values)
    for name, value in values.items():
        assert parameter(changed, name).value == value != parameter(mech, name).value
    spring, torque, damping, own = changed.forces
    assert (spring.stiffness, spring.length) == (300.0, 0.08) and torque.torques["beta"] == 0.04
    assert damping.coefficients["beta"] == 0.3 and own.stiffness == 4.0
    assert changed.loops[0].xyz2[1] == 0.01
    columns = mech.columns("theta")
    assert changed.model.damping[columns] == 0.5 and changed.model.friction[columns] == 0.6


def test_all_of_a_kind():
    mech = pc.load("crank_rocker")
    assert names_of(mech, "mass") == ["mass:crank", "mass:coupler", "mass:rocker"]
    assert names_of(mech, "length") == ["length:coupler", "length:rocker"]
    assert names_of(mech, "gravity") == ["gravity[2]"]
    assert names_of(pc.load("delta_robot"), "stiffness") == [f"servo leg{i}_arm.stiffness" for i in (1, 2, 3)]


@pytest.mark.parametrize(
    ("name", "match"),
    {
        "mass:coupla": "no parameter 'mass:coupla'; similar: mass:coupler",
        "com:coupler": r"needs com:coupler\[0\] or com:coupler\[1\]",
        "inertia:coupler[ab]": r"needs inertia:coupler\[xx\]",
        "length:crank": "the lengths of the body that it carries are length:coupler",
        "stiffness:crank": "no parameter 'stiffness:crank'",
        "anchor:rocker_grund.xyz2[0]": "no parameter",
        "rocker_ground.xyz2.7": "has no number 'xyz2.7'",
        "gravity[3]": "similar: gravity",
        "weight": r"Its parameters are mass:, com:, inertia:, length:.*rocker_ground \(NAME.NUMBER\)",
    }.items(),
)
def test_unknown_names(name, match):
    with pytest.raises(pc.InputError, match=match):
        pc.load("crank_rocker").with_parameters({name: 1.0})


def test_impossible_numbers():
    mech = pc.load("crank_rocker")
    with pytest.raises(pc.InputError, match="negative mass"):
        mech.with_parameters({"mass:coupler": -1.0})
    with pytest.raises(pc.InputError, match="damping:crank"):
        mech.with_parameters({"damping:crank": -1.0})
    with pytest.raises(pc.InputError, match="needs a mapping"):
        mech.with_parameters(["mass:coupler"])
