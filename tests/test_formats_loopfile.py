"""Loop files in both conventions, and the joints they replace."""

from functools import partial

import numpy as np
import pinocchio as pin
import pytest
from urdf_texts import BAR, CHAIN, A, joint, write

from pinconsist.errors import FormatError
from pinconsist.formats import load


@pytest.fixture
def robot(tmp_path):
    return partial(write, tmp_path)


# Loop files -----------------------------------------------------------------------------------------------------------


def test_loop_file_lies_beside_the_robot_or_is_given(robot, tmp_path):
    path = robot(CHAIN)
    assert load(path).loops == ()
    (tmp_path / "robot.yml").write_text("loops: [{name: far, kind: point, frame1: c}]")
    assert [loop.name for loop in load(path).loops] == ["far"]
    (tmp_path / "scene.yaml").write_text("loops: [{name: beside, kind: point, frame1: c}]")
    assert [loop.name for loop in load(tmp_path).loops] == ["beside"]
    assert [loop.name for loop in load(path, loops=str(tmp_path / "robot.yml")).loops] == ["far"]


def test_every_field_of_a_loop_reaches_the_loop(robot):
    text = """{name: n, kind: hinge, frame1: c, frame2: a, xyz1: [1, 2, 3e-1], rpy1: [4, 5, 6], xyz2: [7, 8, 9],
      rpy2: [1, 0, 1], axis: [0, 2, 0]}"""
    (loop,) = load(robot(CHAIN, f"loops:\n  - {text}\nguess: {{j: 1.5}}\nactuated: [k]")).loops
    assert (loop.frame1, loop.frame2, loop.kind, loop.axis) == ("c", "a", "hinge", (0, 2, 0))
    assert (loop.xyz1, loop.rpy1, loop.xyz2, loop.rpy2) == ((1, 2, 0.3), (4, 5, 6), (7, 8, 9), (1, 0, 1))


def test_guess_and_actuated(robot):
    mech = load(robot(CHAIN, "guess: {k: 1.5}\nactuated: [k]"))
    assert mech.actuated == ("k",)
    np.testing.assert_array_equal(mech.guess, [0, 1.5])


@pytest.mark.parametrize(
    ("pair", "name"),
    [
        (("closedloop1_A", "closedloop1_B"), "closedloop1"),
        (("closedloop6D_1B", "closedloop6D_1A"), "closedloop6D_1"),
        (("left_foot", "left_toe"), "left_foot-left_toe"),
        (("A", "B"), "A-B"),
    ],
)
def test_loops_of_robot_yaml_are_named_after_their_frames(robot, pair, name):
    body = A + "".join(f'<link name="{frame}"/>' + joint(f"j{frame}", "a", frame) for frame in pair)
    (loop,) = load(robot(body, f"closed_loop: [{list(pair)}]\ntype: [3D]")).loops
    assert (loop.name, loop.kind) == (name, "point")
    twice = load(robot(body, f"closed_loop: [{list(pair)}, {list(pair)}, {list(pair)}]")).loops
    assert len({loop.name for loop in twice}) == 3 and {loop.kind for loop in twice} == {"frame"}


def test_unknown_keys_of_robot_yaml_are_logged(robot, caplog):
    load(robot(CHAIN, "closed_loop: []\nrotule_name: to_rotule"))
    assert "rotule_name" in caplog.text


# Replaced joints ------------------------------------------------------------------------------------------------------

THREE = (
    CHAIN
    + f'<link name="d">{BAR}</link><link name="e">{BAR}</link>'
    + joint("l", "c", "d", inside='<origin xyz="0.5 0.5 0" rpy="1 0 0"/><axis xyz="1 0 0"/>')
    + joint("m", "b", "e", inside='<origin xyz="0 0.2 0.4"/><axis xyz="0 1 0"/>')
).replace('<axis xyz="0 1 1"/>', '<axis xyz="0 1 1"/><dynamics damping="0.5" friction="0.25"/>')


def by_hand(kinds):
    """The tree THREE with joint k made of the given Pinocchio joints."""
    model, rpy = pin.Model(), pin.rpy.rpyToMatrix
    inertia = pin.Inertia(1.0, np.array([0.5, 0, 0]), np.diag([0.01, 0.09, 0.08]))
    j = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "j")
    last, place = j, pin.SE3(rpy(0.3, 0, 0.2), np.array([1, 0.1, 0.2]))
    for kind in kinds:
        last, place = model.addJoint(last, kind, place, f"k{last}"), pin.SE3.Identity()
    l = model.addJoint(last, pin.JointModelRX(), pin.SE3(rpy(1, 0, 0), np.array([0.5, 0.5, 0])), "l")
    m = model.addJoint(j, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([0, 0.2, 0.4])), "m")
    for body in (j, last, l, m):
        model.inertias[body] = inertia
    return model


@pytest.mark.parametrize(
    ("kind", "joints", "nq"),
    [
        ("SPHERICAL", [pin.JointModelSpherical()], 7),
        ("ujoint_xy", [pin.JointModelRX(), pin.JointModelRY()], 5),
        ("UJOINT_ZX", [pin.JointModelRZ(), pin.JointModelRX()], 5),
    ],
)
def test_replaced_joint_has_the_right_dynamics(robot, kind, joints, nq):
    loops = f"closed_loop: [[k, l]]\njoint_name: [k]\njoint_type: [{kind}]\nname_mot: [k]"
    mech = load(robot(THREE, loops))
    plain = load(robot(THREE, name="plain"))
    model, hand = mech.model, by_hand(joints)
    assert model.nq == nq
    assert mech.actuated == (("k",) if kind == "SPHERICAL" else ("k_" + kind[-2:].upper()[0], "k_" + kind[-1:].upper()))
    assert [frame.name for frame in model.frames] == [frame.name for frame in plain.model.frames]
    own = slice(1, model.nv - 2)  # velocities of k: j comes before, l and m after
    np.testing.assert_array_equal(model.damping[own], 0.5)
    np.testing.assert_array_equal(model.upperDryFrictionLimit[own], 0.25)
    assert not model.damping[own.stop :].any()

    rng = np.random.default_rng(5)
    q = pin.integrate(model, pin.neutral(model), rng.normal(size=model.nv))
    v, a = rng.normal(size=(2, model.nv))
    data, zero = model.createData(), np.zeros(model.nv)
    np.testing.assert_allclose(pin.rnea(model, data, q, v, a), pin.rnea(hand, hand.createData(), q, v, a), atol=1e-12)

    rest = pin.rnea(model, data, q, zero, zero)
    columns = np.column_stack([pin.rnea(model, data, q, zero, e) - rest for e in np.eye(model.nv)])
    mass = np.triu(pin.crba(model, data, q))
    np.testing.assert_allclose(mass + np.triu(mass, 1).T, columns, atol=1e-12)

    by_q, by_v, _ = (part.copy() for part in pin.computeRNEADerivatives(model, data, q, v, a))
    for i, e in enumerate(1e-6 * np.eye(model.nv)):
        forth, back = (pin.rnea(model, data, pin.integrate(model, q, s * e), v, a) for s in (1, -1))
        np.testing.assert_allclose(by_q[:, i], (forth - back) / 2e-6, atol=1e-7)
        forth, back = (pin.rnea(model, data, q, v + s * e, a) for s in (1, -1))
        np.testing.assert_allclose(by_v[:, i], (forth - back) / 2e-6, atol=1e-7)


def test_fixed_joint_is_the_tree_held_at_zero(robot):
    mech = load(robot(THREE, "joint_name: [k]\njoint_type: [FIXED]"))
    whole = load(robot(THREE, name="plain")).model
    held = pin.buildReducedModel(whole, [whole.getJointId("k")], pin.neutral(whole))
    assert mech.joints == ("j", "l", "m")
    q, v, a = np.random.default_rng(1).normal(size=(3, 3))
    expected = pin.rnea(held, held.createData(), q, v, a)
    np.testing.assert_allclose(pin.rnea(mech.model, mech.model.createData(), q, v, a), expected, atol=1e-12)


def test_replacement_that_clashes_or_does_not_apply(robot):
    with pytest.raises(FormatError, match="joint 'k': only hinges and sliders"):
        load(
            robot(
                THREE.replace('"k" type="revolute"', '"k" type="floating"'), "joint_name: [k]\njoint_type: [SPHERICAL]"
            )
        )
    with pytest.raises(FormatError, match="joint 'k_X': another joint has the name"):
        load(robot(THREE.replace('"m"', '"k_X"'), "joint_name: [k]\njoint_type: [UJOINT_XY]"))
