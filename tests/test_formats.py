"""Files → Mechanism: the built-in models, what URDF says and leaves out, real robots."""

import pickle
from functools import partial
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from helpers.bodies import loop_rows
from helpers.urdf_texts import CHAIN, A, B, C, joint, write
from helpers.warned import told

from pinconsist.errors import InputError
from pinconsist.formats import load, models

ROBOTS = Path(__file__).parents[2] / "shared" / "robots"
needs_robots = pytest.mark.skipif(not ROBOTS.is_dir(), reason="the public robots are not beside the repository")


@pytest.fixture
def robot(tmp_path):
    return partial(write, tmp_path)


# Built-in models ------------------------------------------------------------------------------------------------------

BUILT_IN = {
    "planar_pendulum": (["pendulum"], []),
    "double_pendulum": (["upper", "lower"], []),
    "four_bar": (["crank", "coupler", "rocker"], ["coupler_rocker"]),
    "five_bar": (["left_crank", "left_distal", "right_crank", "right_distal"], ["tip"]),
    "slider_crank": (["crank", "rod", "piston"], ["piston_pin"]),
    "crank_rocker": (["crank", "coupler", "rocker"], ["rocker_ground"]),
}


def test_catalogue_lists_the_models_with_one_line_each():
    listed = models()
    assert set(BUILT_IN) < set(listed)  # all of them are looked at in test_models.py
    assert all(text and "\n" not in text for text in listed.values())


@pytest.mark.parametrize("name", BUILT_IN)
def test_built_in_model(name):
    joints, loops = BUILT_IN[name]
    mech = load(name)
    assert mech.name == name
    assert list(mech.joints) == joints
    assert mech.nq == mech.nv == len(joints)
    assert [loop.name for loop in mech.loops] == loops
    assert all(loop.kind == "hinge" for loop in mech.loops)
    gap, jacobian = loop_rows(mech, mech.guess)
    assert np.max(np.abs(gap), initial=0.0) < 1e-14
    assert not loops or np.linalg.matrix_rank(jacobian) == 2 * len(loops)
    assert pickle.loads(pickle.dumps(mech)).geometry == mech.geometry


@pytest.mark.parametrize(
    ("name", "rods"),
    {
        "planar_pendulum": {"pendulum": (1, 1)},
        "double_pendulum": {"upper": (1, 1), "lower": (1, 1)},
        "four_bar": {"crank": (1, 1), "coupler": (2, 2), "rocker": (1.5, 1.5)},
        "five_bar": {
            f"{side}_{bar}": (l, l) for side in ("left", "right") for bar, l in (("crank", 0.25), ("distal", 0.35))
        },
        "slider_crank": {"crank": (0.3, 0.6), "rod": (0.9, 1.8)},
        "crank_rocker": {"crank": (0.25, 0.5), "coupler": (0.7, 1.4), "rocker": (0.6, 1.2)},
    }.items(),
)
def test_rods_are_uniform_and_thin(name, rods):
    model = load(name).model
    for rod, (length, mass) in rods.items():
        inertia = model.inertias[model.getJointId(rod)]
        across = mass * length**2 / 12
        assert inertia.mass == mass
        np.testing.assert_allclose(inertia.lever, [length / 2, 0, 0], atol=1e-15)
        np.testing.assert_allclose(np.diag(inertia.inertia)[1:], across, rtol=1e-12)
        assert 0 < inertia.inertia[0, 0] < 0.05 * across
        tips = [
            frame for frame in model.frames if frame.name.endswith("tip") and frame.parentJoint == model.getJointId(rod)
        ]
        for tip in tips:
            np.testing.assert_allclose(tip.placement.translation, [length, 0, 0])


def test_four_bar_starts_on_the_open_branch_above_the_ground():
    mech = load("four_bar")
    data = mech.model.createData()
    pin.framesForwardKinematics(mech.model, data, mech.guess)
    knee = data.oMi[mech.joint_index("coupler")].translation
    tip = data.oMf[mech.model.getFrameId("rocker_tip")].translation
    np.testing.assert_allclose(knee, [np.cos(1), 0, np.sin(1)], atol=1e-15)
    np.testing.assert_allclose(data.oMi[mech.joint_index("rocker")].translation, [2.2, 0, 0])
    assert tip[2] > knee[2] > 0


@pytest.mark.parametrize("name", BUILT_IN)
def test_shapes_of_the_models_can_be_built(name):
    mech = load(name)
    shapes = pin.buildGeomFromUrdfString(mech.model, mech.geometry.urdf, pin.GeometryType.VISUAL)
    assert shapes.ngeoms >= 1 + mech.nv
    assert {shape.parentJoint for shape in shapes.geometryObjects} == set(range(mech.nv + 1))
    assert len({tuple(shape.meshColor) for shape in shapes.geometryObjects}) > 1


def test_closure_replaces_the_kind_of_every_loop_but_distances(robot):
    assert [loop.kind for loop in load("five_bar", closure="point").loops] == ["point"]
    path = robot(
        CHAIN,
        "loops: [{name: s, kind: distance, frame1: c, length: 1e-1}, "
        "{name: t, kind: hinge, frame1: b, axis: [0, 1, 0]}]",
    )
    assert [loop.kind for loop in load(path, closure="frame").loops] == ["distance", "frame"]
    assert [loop.kind for loop in load(path, closure="hinge").loops] == ["distance", "hinge"]
    with pytest.raises(InputError, match=r"closure=.distance. is not one of .point., .frame., .hinge."):
        load("four_bar", closure="distance")
    with pytest.raises(InputError, match="'s': a hinge needs its axis"):
        load(robot(CHAIN, "loops: [{name: s, kind: frame, frame1: c}]"), closure="hinge")


def test_a_loop_file_of_another_name_is_not_overlooked_in_silence(robot, recwarn):
    path = robot(CHAIN)
    (path.parent / "closures.yaml").write_text("loops: []")
    assert load(path).loops == ()
    assert "closures.yaml" in told(recwarn) and "loops=" in told(recwarn)


# URDF -----------------------------------------------------------------------------------------------------------------


def test_continuous_joint_is_one_angle_without_limits(robot):
    model = load(
        robot(A + B + joint(kind="continuous", inside='<axis xyz="0 -2 0"/><limit effort="3" velocity="4"/>'))
    ).model
    assert (model.nq, model.nv) == (1, 1)
    assert model.lowerPositionLimit[0] == -np.inf and model.upperPositionLimit[0] == np.inf
    assert (model.effortLimit[0], model.velocityLimit[0]) == (3, 4)
    data = model.createData()
    pin.forwardKinematics(model, data, np.array([7.0]))
    np.testing.assert_allclose(data.oMi[1].rotation, pin.rpy.rpyToMatrix(0, -7.0, 0), atol=1e-15)


def test_what_urdf_leaves_out_gets_its_default(robot):
    body = (
        A + B + C + joint(inside="") + joint("k", "b", "c", "prismatic", '<limit upper="2" effort="1" velocity="1"/>')
    )
    model = load(robot(body + "<transmission><x/></transmission><gazebo/>", head="<robot>")).model
    np.testing.assert_array_equal(model.jointPlacements[1].homogeneous, np.eye(4))
    assert [joint.shortname() for joint in model.joints][1:] == ["JointModelRX", "JointModelPX"]
    np.testing.assert_array_equal(model.lowerPositionLimit, [-np.inf, -np.inf])
    np.testing.assert_array_equal(model.upperPositionLimit, [np.inf, 2])


@pytest.mark.parametrize(("kind", "nq", "nv"), [("floating", 7, 6), ("planar", 4, 3), ("prismatic", 1, 1)])
def test_joint_types(robot, kind, nq, nv):
    mech = load(robot(A + B + joint(kind=kind)))
    assert (mech.nq, mech.nv) == (nq, nv)


def test_dynamics_and_massless_links_and_namespaces_are_read(robot):
    body = A + '<link name="b"/>' + joint(inside='<axis xyz="1 0 0"/><dynamics damping="0.3" friction="0.2"/>')
    model = load(robot(body, head='<robot name="r" xmlns="http://ros.org" xmlns:g="x">')).model
    assert (model.damping[0], model.upperDryFrictionLimit[0], model.inertias[1].mass) == (0.3, 0.2, 0)


def test_a_robot_without_moving_joints_floats(robot):
    path = robot(A + B + joint(kind="fixed"))
    with pytest.warns(UserWarning, match="no joint of it moves, and its link 'a' floats"):
        mech = load(path)
    assert (mech.nq, mech.nv, mech.joints) == (7, 6, ("root_joint",))
    asked = load(path, free_flyer=True)
    assert asked.joints == mech.joints and asked.model.inertias[1] == mech.model.inertias[1]


def test_shapes_keep_colours_and_unknown_ones_are_left_out(robot):
    def visual(shape, material=""):
        return f'<link name="a"><visual><geometry>{shape}</geometry>{material}</visual><visual/></link>'

    two = "<color rgba='{} 0 0 1'/>"
    body = (
        f'<material name="m">{two.format(0.25)}</material>'
        + visual('<sphere radius="1"/>', f'<material name="m">{two.format(0.5)}</material>')
        + visual('<box size="1 2 3"/>', '<material name="m"/>').replace('"a"', '"b"')
        + visual("<torus/>", '<material name="undefined"/>').replace('"a"', '"c"')
        + joint()
        + joint("k", "b", "c")
    )
    mech = load(robot(body))
    shapes = pin.buildGeomFromUrdfString(mech.model, mech.geometry.urdf, pin.GeometryType.VISUAL).geometryObjects
    assert [shape.meshColor[0] for shape in shapes] == [0.5, 0.25]


# Real robots ----------------------------------------------------------------------------------------------------------

TABLE = {  # nv, loops, rows, rank and largest gap (m) at q = 0: PROBLEMS.md
    "5bar_linkage": (6, 1, 6, 3, 0.30),
    "5bar_linkage_iso6d": (8, 1, 6, 6, 0.08),
    "robot_delta": (14, 3, 18, 9, 0.03),
    "cassie_like": (19, 2, 12, 12, 0.55),
    "digit_like": (27, 3, 18, 18, 0.34),
    "kangaroo_like": (63, 11, 66, 53, 0.43),
}


@needs_robots
@pytest.mark.parametrize("name", TABLE)
def test_real_robot(name, capfd):
    nv, loops, rows, rank, gap = TABLE[name]
    mech = load(ROBOTS / name)
    assert mech.name == name
    assert (mech.nv, len(mech.loops), mech.nc) == (nv, loops, rows)
    assert mech.actuated and all(loop.name.startswith("closedloop") for loop in mech.loops)
    phi, jacobian = loop_rows(mech, pin.neutral(mech.model))
    singular = np.linalg.svd(jacobian, compute_uv=False)
    assert np.sum(singular > 1e-8 * singular[0]) == rank
    assert abs(np.abs(phi.reshape(-1, 6)[:, :3]).max() - gap) < 0.0051
    assert capfd.readouterr() == ("", "")


@needs_robots
def test_both_conventions_say_the_same(tmp_path):
    entries = [
        f"{{name: closedloop{i}, kind: frame, frame1: closedloop{i}_{a}, frame2: closedloop{i}_{b}}}"
        for i, a, b in ((1, "B", "A"), (2, "A", "B"))
    ]
    own = tmp_path / "own.yaml"
    own.write_text(
        f"loops: [{', '.join(entries)}]\nactuated: [motor_hip1, motor_hip2, motor_tigh, motor_knee, motor_ankle]"
    )
    theirs, ours = load(ROBOTS / "cassie_like"), load(ROBOTS / "cassie_like", loops=own)
    assert theirs.loops == ours.loops
    assert theirs.actuated == ours.actuated
    assert theirs.model == ours.model
