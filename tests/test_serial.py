"""Serial equivalents, against geometry, power and energy."""

import re
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
import yaml
from helpers import actuated

import pinconsist as pc

PITCH, ROLL = 0.1, -0.15
EFFORT = np.array([20.0, 15.0])


def slopes(pitch=PITCH, roll=ROLL, h=1e-5):
    """How the motors of the ankle move with pitch and roll, from the length of the rods."""
    sides = [
        (actuated.ankle_motors(pitch + a, roll + b), actuated.ankle_motors(pitch - a, roll - b))
        for a, b in ((h, 0), (0, h))
    ]
    return np.column_stack([(plus - minus) / (2 * h) for plus, minus in sides])


@pytest.fixture(scope="module")
def found():
    return pc.serial_equivalent(
        actuated.ankle(), ["pitch", "roll"], q0={"pitch": PITCH, "roll": ROLL}, stiffness=50.0,
        efforts={"left": 20.0, "right": 15.0}, speeds=6.0, damping={"left": 1.0, "right": 2.0},
        workspace={"pitch": (0.0, 0.2), "roll": (-0.2, 0.0)},
    )  # fmt: skip


def test_speeds_of_motors_by_geometry(found):
    np.testing.assert_allclose(found.T, slopes(), atol=1e-8)
    assert found.motors == ("left", "right") and found.joints == ("pitch", "roll")


def test_inertias_by_energy(found):
    """½ vᵀ M v of unit speeds: of rotors alone, of motors and horns, and of all bodies."""
    mech, T = actuated.ankle(), slopes()
    np.testing.assert_allclose(found.rotors, 0.01 * T.T @ T, atol=1e-9)
    horn = 1e-5 + 0.05 * (actuated.HORN / 2) ** 2  # about the axis of a motor
    np.testing.assert_allclose(found.linkage, horn * T.T @ T, atol=1e-9)
    data = mech.model.createData()
    for i, unit in enumerate(np.eye(2)):
        v = np.zeros(mech.nv)
        for joint, speed in zip((*found.joints, *found.motors), (*unit, *T @ unit), strict=True):
            v[mech.columns(joint)] = speed
        assert 2 * pin.computeKineticEnergy(mech.model, data, found.q, v) == pytest.approx(
            found.inertia[i, i], rel=1e-6
        )
    act = pc.Actuation(mech, q0=found.q)
    np.testing.assert_allclose(T.T @ act.mass_matrix(found.q) @ T, found.inertia, atol=1e-8)


def test_torques_of_motors_do_the_work_of_those_of_joints(found):
    T = slopes()
    for corner in found.torque_vertices:
        motors = np.linalg.solve(T.T, corner)
        np.testing.assert_allclose(np.abs(motors), EFFORT, rtol=1e-6)
    assert len(found.torque_vertices) == 4
    for k, unit in enumerate(np.eye(2)):
        motors = np.abs(np.linalg.solve(T.T, found.torque[k] * unit))
        assert (motors <= EFFORT * (1 + 1e-6)).all() and (np.isclose(motors, EFFORT)).any()
        assert np.abs(T @ (found.speed[k] * unit)).max() == pytest.approx(6.0, rel=1e-6)
    corners = [found.torque_together * signs for signs in ((1, 1), (1, -1))]
    worst = max((np.abs(np.linalg.solve(T.T, corner)) / EFFORT).max() for corner in corners)
    assert worst == pytest.approx(1.0, rel=1e-6)
    together = max(np.abs(T @ (found.speed_together * signs)).max() for signs in ((1, 1), (1, -1)))
    assert together == pytest.approx(6.0, rel=1e-6)


def test_gains_are_those_of_virtual_work(found):
    T = slopes()
    np.testing.assert_allclose(found.stiffness_matrix, 50.0 * T.T @ T, atol=1e-6)
    np.testing.assert_allclose(found.damping_matrix, T.T @ np.diag([1.0, 2.0]) @ T, atol=1e-7)
    over = [50.0 * slopes(*each).T @ slopes(*each) for each in np.stack(np.meshgrid(*workspace()), -1).reshape(-1, 2)]
    np.testing.assert_allclose(found.stiffness, np.mean([np.diag(each) for each in over], axis=0), rtol=1e-6)
    worst = max(np.linalg.norm(each - np.diag(found.stiffness), 2) / np.linalg.norm(each, 2) for each in over)
    assert found.cost.stiffness == pytest.approx(worst, rel=1e-6) and found.cost.points == found.cost.tried == 49


def workspace():
    return np.linspace(0.0, 0.2, 7), np.linspace(-0.2, 0.0, 7)


def test_a_rhombus_fills_half_of_its_box():
    level = pc.serial_equivalent(
        actuated.ankle(), ["pitch", "roll"], efforts=20.0, workspace={"pitch": (0.0, 0.0), "roll": (0.0, 0.0)}
    )
    assert level.cost.torque == pytest.approx(0.5, abs=1e-3)
    np.testing.assert_allclose(level.torque_together, level.torque / 2, rtol=1e-3)


def test_an_arm_whose_first_joint_is_a_motor():
    """The five-bar as an arm of two joints: the motor on the ground is felt by both, in geometry's proportion."""
    mech = actuated.five_bar().with_armature({"left_crank": 0.02, "right_crank": 0.03})
    found = pc.serial_equivalent(mech, ["left_crank", "left_distal"])
    assert found.motors == ("left_crank", "right_crank")
    left, right = found.q[0], found.q[2]
    h = 1e-6
    moved = [actuated.five_bar_configuration(left + a, right + b) for a, b in ((h, 0), (-h, 0), (0, h), (0, -h))]
    by_left, by_right = (moved[0] - moved[1])[1] / (2 * h), (moved[2] - moved[3])[1] / (2 * h)
    T = np.array([[1.0, 0.0], [-by_left / by_right, 1 / by_right]])
    np.testing.assert_allclose(found.T, T, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found.rotors, T.T @ np.diag([0.02, 0.03]) @ T, rtol=1e-6)
    assert np.isnan(found.torque).all() and not len(found.torque_vertices)


def test_one_joint_and_its_motor():
    """A boom on a cylinder: the lever arm is the derivative of the law of cosines."""
    mech = actuated.boom()
    found = pc.serial_equivalent(mech, ["boom"], efforts=1000.0, workspace={"boom": (-0.1, 0.1)})
    length, h = found.q[2], 1e-6
    lever = (actuated.boom_angle(length + h) - actuated.boom_angle(length - h)) / (2 * h)
    assert found.T[0, 0] == pytest.approx(1 / lever, rel=1e-6)
    assert found.torque[0] == pytest.approx(1000.0 / abs(lever), rel=1e-6) and found.cost.torque == 1.0
    assert "N·m" in str(found) and found.torque_vertices.shape == (2, 1)


def test_three_motors_on_two_joints():
    """One more motor than needed, on the pitch axis itself: torques alone add."""
    mech = actuated.ankle()
    found = pc.serial_equivalent(mech, ["pitch", "roll"], ["left", "right", "pitch"], efforts=20.0)
    two = pc.serial_equivalent(mech, ["pitch", "roll"], efforts=20.0)
    assert found.torque[0] == pytest.approx(two.torque[0] + 20.0, rel=1e-6)
    assert found.T[2].tolist() == [1.0, 0.0] and len(found.torque_vertices) == 6


def test_texts(found, tmp_path):
    data = yaml.safe_load(found.to_yaml(tmp_path / "a.yaml"))
    assert yaml.safe_load((tmp_path / "a.yaml").read_text("utf-8")) == data
    assert data["joints"]["pitch"]["armature"] == pytest.approx(found.armature[0])
    np.testing.assert_allclose(data["matrices"]["T"], found.T)
    root = ElementTree.fromstring(f"<a>{found.to_mjcf()}</a>")
    pitch, roll = root.findall("joint")
    assert pitch.get("name") == "pitch" and float(roll.get("armature")) == pytest.approx(found.armature[1], rel=1e-5)
    assert float(pitch.get("actuatorfrcrange").split()[1]) == pytest.approx(found.torque[0], rel=1e-5)
    assert float(root.find("position").get("kp")) == pytest.approx(found.stiffness[0], rel=1e-5)
    assert re.search(r"inertia that joints feel is off by up to [\d.]+ %", found.to_mjcf())


def test_the_elements_are_read_by_mujoco(found):
    mujoco = pytest.importorskip("mujoco")
    joints, actuators = (re.findall(rf"<{tag} .*?/>", found.to_mjcf()) for tag in ("joint", "position"))
    pitch, roll = (f'<body>{each}<geom size=".1"/>' for each in joints)
    text = (
        f"<mujoco><worldbody>{pitch}{roll}</body></body></worldbody><actuator>{''.join(actuators)}</actuator></mujoco>"
    )
    model = mujoco.MjModel.from_xml_string(text)
    np.testing.assert_allclose(model.dof_armature, found.armature, rtol=1e-5)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"joints": ["pich"]}, "no joint 'pich'"),
        ({"joints": ["pitch", "roll"], "motors": ["left"]}, "2 joints need as many motors, got left"),
        ({"joints": ["pitch", "roll"], "efforts": {"left": 1.0}}, "no number for motor 'right'"),
        ({"joints": ["pitch", "roll"], "efforts": {"lft": 1.0}}, "'lft' is not among the motors; similar: left"),
        ({"joints": ["pitch", "roll"], "speeds": -1.0}, "speeds"),
        ({"joints": ["pitch", "roll"], "workspace": {"pitch": (0.2, 0.0)}}, "the lower one first"),
        ({"joints": ["pitch", "roll"], "workspace": {"yaw": (0.0, 0.2)}}, "a mapping of pitch, roll"),
        ({"joints": ["pitch", "roll"], "workspace": {"pitch": 0.2}}, "two numbers"),
        ({"joints": ["pitch"]}, "can move while pitch stands: name another joint"),
    ],
)
def test_refusals(options, words):
    with pytest.raises(pc.PinconsistError) as caught:
        pc.serial_equivalent(actuated.ankle(), **options)
    assert re.search(words, str(caught.value)), caught.value


def test_a_scene_without_motors():
    with pytest.raises(pc.InputError, match="has no motors"):
        pc.serial_equivalent(pc.load("double_pendulum"), ["upper"])
