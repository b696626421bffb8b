"""What closes a URDF without a loop file: frames with closing names, <loop_joint>, <mimic>; Pinocchio's own objects."""

import re
from functools import partial
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from helpers.bodies import loop_rows
from helpers.urdf_texts import BAR, CHAIN, A, B, C, joint, write
from helpers.warned import told
from pinocchio.robot_wrapper import RobotWrapper

import pinconsist as pc
from pinconsist.mechanism.joint_constraints import Coupling

MODELS = Path(__file__).resolve().parents[1] / "models"
ROBOTS = Path(__file__).resolve().parents[2] / "shared" / "robots"
FOUR_BAR = (MODELS / "four_bar.urdf").read_text(encoding="utf-8")


@pytest.fixture
def robot(tmp_path):
    return partial(write, tmp_path)


def links(*names):
    """Massless links fixed to a: frames of these names."""
    return "".join(f'<link name="{name}"/>' + joint(f"{name}_mount", "a", name, "fixed", "") for name in names)


def on_c(*names):
    return "".join(f'<link name="{name}"/>' + joint(f"{name}_mount", "c", name, "fixed", "") for name in names)


def same_rows(mech, other, seed=0):
    for q in np.random.default_rng(seed).uniform(-3, 3, (5, mech.nq)):
        for mine, theirs in zip(loop_rows(mech, q), loop_rows(other, q), strict=True):
            np.testing.assert_allclose(mine, theirs, atol=1e-13)


# Frames with closing names --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("one", "two", "name", "kind"),
    [
        ("closing_knee_1", "closing_knee_2", "closing_knee", "point"),
        ("closing_left_1_1", "closing_left_1_2", "closing_left_1", "point"),
        ("closedloop1_A", "closedloop1_B", "closedloop1", "frame"),
        ("closedloop6D_1A", "closedloop6D_1B", "closedloop6D_1", "frame"),
        ("closedloop3D_1A", "closedloop3D_1B", "closedloop3D_1", "point"),
        ("closedloop0_A_3D", "closedloop0_B_3D", "closedloop0_3D", "point"),
        ("closedloop_ankle_left_2A", "closedloop_ankle_left_2B", "closedloop_ankle_left_2", "frame"),
    ],
)
def test_closing_frames_close_a_loop_and_say_so(robot, recwarn, one, two, name, kind):
    (loop,) = pc.load(robot(CHAIN + links(two) + on_c(one))).loops
    assert (loop.name, loop.kind, loop.frame1, loop.frame2) == (name, kind, one, two)
    assert f"{name} ({kind})" in told(recwarn) and "closure=" in told(recwarn)


def test_closing_frames_yield_to_whatever_else_closes_loops(robot, recwarn):
    body = CHAIN + links("closing_k_2") + on_c("closing_k_1")
    assert pc.load(robot(body, "guess: {j: 1.0}")).loops == ()
    written = '<loop_joint name="tip" type="ball"><link1 link="a"/><link2 link="c"/></loop_joint>'
    assert [loop.name for loop in pc.load(robot(body + written, name="other")).loops] == ["tip"]
    assert "from the names of its frames" not in told(recwarn)


def test_a_closing_frame_alone_is_told_and_closes_nothing(robot, recwarn):
    assert pc.load(robot(CHAIN + on_c("closing_k_1", "closedloop1_B", "closing_", "closedloop1_C"))).loops == ()
    alone = re.findall(r"the frame '(\w+)' does not close a loop", told(recwarn))
    assert sorted(alone) == ["closedloop1_B", "closing_k_1"]


def test_closure_overrides_what_closing_frames_assume(robot):
    path = robot(CHAIN + links("closing_k_2") + on_c("closing_k_1"))
    (loop,) = pc.load(path, closure="hinge").loops
    assert (loop.kind, loop.axis) == ("hinge", (0, 0, 1))  # the axis of the exporter's mates
    assert pc.load(path, closure="frame").loops[0].kind == "frame"


@pytest.mark.skipif(not ROBOTS.is_dir(), reason="the public robots are not beside the repository")
@pytest.mark.parametrize("name", ["5bar_linkage", "5bar_linkage_iso6d", "robot_delta", "cassie_like", "digit_like"])
def test_closing_names_of_real_robots_say_what_their_loop_files_say(tmp_path, name):
    (tmp_path / "robot.urdf").write_bytes((ROBOTS / name / "robot.urdf").read_bytes())
    by_name, by_file = (
        {(loop.name, loop.kind, frozenset((loop.frame1, loop.frame2))) for loop in pc.load(folder).loops}
        for folder in (tmp_path, ROBOTS / name)
    )
    assert by_name == by_file


# <loop_joint> ---------------------------------------------------------------------------------------------------------

ENDS = '<link1 link="a" xyz="1 2 3" rpy="0.1 0.2 0.3"/><link2 link="c" xyz="4 5 6" rpy="0.4 0.5 0.6"/>'


def loop_joint(kind='type="revolute"', inside=ENDS, name="tip"):
    return f'<loop_joint name="{name}" {kind}>{inside}</loop_joint>'


@pytest.mark.parametrize(
    ("written", "kind", "free"),
    [
        ('type="fixed"', "frame", 0),
        ('type="revolute"', "hinge", 1),
        ('type="continuous"', "hinge", 1),
        ("", "hinge", 1),
        ('type="prismatic"', "slider", 1),
        ('type="planar"', "plane", 3),
        ('type="spherical"', "point", 3),
        ('type="ball"', "point", 3),
    ],
)
def test_loop_joint_leaves_free_what_its_type_says(robot, written, kind, free):
    (loop,) = pc.load(robot(CHAIN + loop_joint(written, ENDS + '<axis xyz="0 2 0"/>'))).loops
    assert (loop.name, loop.kind, loop.frame1, loop.frame2) == ("tip", kind, "a", "c")
    assert (loop.xyz1, loop.rpy1) == ((1, 2, 3), (0.1, 0.2, 0.3))
    assert (loop.xyz2, loop.rpy2) == ((4, 5, 6), (0.4, 0.5, 0.6))
    assert len(loop.rows) == 6 - free
    assert loop.axis == (None if kind in ("frame", "point") else (0, 2, 0))


def test_loop_joint_moves_about_its_axis_only(robot):
    """A free body held to the ground by loop joints: the velocities they leave free are those of the joint."""
    body = A + B + joint(kind="floating", inside="")
    ends = '<link1 link="a" xyz="0 0 1"/><link2 link="b" rpy="0 0 1.5707963267948966"/><axis xyz="0 0 1"/>'
    q = np.array([0, 0, 1, *pin.Quaternion(pin.rpy.rpyToMatrix(0, 0, -np.pi / 2)).coeffs()])
    # the twist of b in its own axes, at its own origin, which the anchor shares
    for kind, free in (("revolute", [0, 0, 0, 0, 0, 1]), ("prismatic", [0, 0, 1, 0, 0, 0])):
        mech = pc.load(robot(body + loop_joint(f'type="{kind}"', ends)))
        phi, J = loop_rows(mech, q)
        np.testing.assert_allclose(phi, 0, atol=1e-15)
        null = np.linalg.svd(J)[2][len(J) :]
        assert len(null) == 1
        np.testing.assert_allclose(np.abs(null[0]), free, atol=1e-15)


def test_loop_joint_has_urdfs_default_axis_and_defaults_for_places(robot):
    (loop,) = pc.load(robot(CHAIN + loop_joint(inside='<link1 link="a"/><link2 link="c"/>'))).loops
    assert (loop.axis, loop.xyz1, loop.rpy2) == ((1, 0, 0), (0, 0, 0), (0, 0, 0))


def test_four_bar_by_loop_joint_has_the_rows_of_the_loop_file(tmp_path):
    ends = '<link1 link="coupler_bar" xyz="2 0 0"/><link2 link="rocker_bar" xyz="1.5 0 0"/><axis xyz="0 1 0"/>'
    path = tmp_path / "four_bar.urdf"
    path.write_text(FOUR_BAR.replace("</robot>", loop_joint(inside=ends, name="coupler_rocker") + "</robot>"))
    same_rows(pc.load(path), pc.load("four_bar"))


def test_loop_joints_and_a_loop_file_add_up(robot):
    path = robot(CHAIN + loop_joint(), "loops: [{name: other, kind: point, frame1: c}]")
    assert [loop.name for loop in pc.load(path).loops] == ["tip", "other"]
    path = robot(CHAIN + loop_joint(), "loops: [{name: tip, kind: point, frame1: c}]")
    with pytest.raises(pc.FormatError, match="two loops are named 'tip'"):
        pc.load(path)


BAD_LOOP_JOINTS = {
    "type": (loop_joint('type="gears"'), "loop_joint 'tip': type 'gears' is not one of fixed, revolute"),
    "floating": (loop_joint('type="floating"'), "type 'floating' is not one of"),
    "no name": (loop_joint().replace('name="tip"', ""), "loop_joint number 1: it has no name"),
    "twice": (loop_joint() * 2, "loop_joint 'tip': two loop_joints have this name"),
    "no link2": (loop_joint(inside='<link1 link="a"/>'), "loop_joint 'tip': <link2> is missing"),
    "link": (loop_joint(inside=ENDS.replace('"c"', '"cc"')), "'tip': link2: there is no link 'cc'; similar: c"),
    "no attribute": (loop_joint(inside="<link1/>" + ENDS), "'tip': <link1> is missing, or has no name"),
    "itself": (loop_joint(inside=ENDS.replace('"c"', '"a"')), "both ends are on the link 'a'"),
    "number": (loop_joint(inside=ENDS.replace("4 5 6", "4 5")), "'tip': link2: xyz='4 5' is not 3 finite numbers"),
    "axis": (loop_joint(inside=ENDS + '<axis xyz="0 0 0"/>'), "'tip': the axis is the zero vector"),
    "huge axis": (
        loop_joint(inside=ENDS + '<axis xyz="1e200 0 0"/>'),
        "'tip': axis: .* is not 3 finite numbers .the largest is 1e.30",
    ),
    "one body": (loop_joint(inside=ENDS.replace('"c"', '"f"')) + links("f"), "'tip'.*same body"),
}


@pytest.mark.parametrize(("written", "message"), BAD_LOOP_JOINTS.values(), ids=BAD_LOOP_JOINTS)
def test_bad_loop_joint_is_named(robot, written, message):
    path = robot(CHAIN + written)
    with pytest.raises(pc.FormatError, match=message) as caught:
        pc.load(path)
    assert caught.value.path == str(path)


def test_what_does_not_act_on_a_loop_joint_is_told(robot, recwarn):
    pc.load(robot(CHAIN + loop_joint(inside=ENDS + '<limit lower="0"/><dynamics damping="1"/>')))
    assert "<limit> does not act" in told(recwarn) and "<dynamics> does not act" in told(recwarn)


DRAKE = ' xmlns:drake="http://drake.mit.edu"'
FOREIGN = {  # tag in messages → what is written, and what declares its prefix
    "equality": ('<equality name="l"><connect body1="a" body2="c"/></equality>', ""),
    "mujoco/equality": ("<mujoco><compiler/><equality><flex/></equality></mujoco>", ""),
    "gazebo/link": ('<gazebo><link name="l"/></gazebo>', ""),
    "loopjoint": ('<loopjoint name="l"><link1 link="a"/><link2 link="c"/></loopjoint>', ""),
    "Loop_Joint": ('<Loop_Joint name="l"/>', ""),
    "lop_joint": ('<lop_joint name="l"/>', ""),
    "drake:other_constraint": ('<drake:other_constraint name="l"/>', DRAKE),
    "drake:coupler_constraint": ("<drake:coupler_constraint/>", ""),  # as Drake reads it, too
}


@pytest.mark.parametrize("tag", FOREIGN)
def test_what_closes_loops_elsewhere_is_refused_with_its_line(robot, tag):
    written, declared = FOREIGN[tag]
    path = robot(CHAIN + "\n\n" + written, head=f'<?xml version="1.0"?>\n<!-- <a:b> -->\n<robot name="r"{declared}>')
    line = 1 + path.read_text(encoding="utf-8").partition(written)[0].count("\n")
    with pytest.raises(pc.FormatError, match=f"the extension <{tag}> is not supported") as caught:
        pc.load(path)
    named = " 'l'" if 'name="l"' in written else ""
    assert (caught.value.path, caught.value.element) == (str(path), f"line {line}, {tag}{named}")
    ignored = (tag, [tag], [tag.rpartition(":")[2].rpartition("/")[2]], *([["other", "l"]] if named else []))
    assert f"ignore=[{tag!r}] loads the file without it" in str(caught.value)
    for ignore in ignored:
        assert pc.load(path, ignore=ignore).loops == ()
    with pytest.raises(pc.FormatError):
        pc.load(path, ignore=["something else"])


HARMLESS = """<transmission name="t"><joint name="j"/><actuator name="m"/></transmission>
<gazebo reference="j"><implicitSpringDamper>1</implicitSpringDamper></gazebo>
<gazebo><plugin name="p" filename="libjoint_state_publisher.so"><joint>j</joint></plugin></gazebo>
<mujoco><compiler angle="radian"/></mujoco><ros2_control name="x" type="system"><joint name="j"/></ros2_control>
<drake:collision_filter_group name="g"><drake:member link="a"/></drake:collision_filter_group>
<drake:rotor_inertia value="1"/><sensor name="s"><parent link="a"/></sensor><disable_collisions link1="a" link2="c"/>
<virtual_joint name="v"/><passive_joint name="j"/><group name="arm"><joint name="j"/></group><contact/>"""


def test_what_closes_no_loop_is_left_out_with_a_line_that_counts_what_is_unknown(robot, recwarn):
    mech = pc.load(robot(CHAIN + HARMLESS))
    assert mech.joints == pc.load(robot(CHAIN)).joints
    (line,) = told(recwarn).splitlines()
    assert line.partition("without effect here: ")[2] == ", ".join(mech.ignored)
    unknown = (
        "<drake:rotor_inertia>",
        "<disable_collisions>",
        "<virtual_joint>",
        "<passive_joint>",
        "<contact>",
    )
    assert mech.ignored == tuple(f"1 {tag}" for tag in unknown)


def test_a_plugin_that_couples_joints_is_refused(robot):
    plugin = '<gazebo><plugin name="p" filename="libmimic.so"><mimicJoint>k</mimicJoint></plugin></gazebo>'
    with pytest.raises(pc.FormatError, match=r"plugin p.*would be different: it closes a loop or joins bodies"):
        pc.load(robot(CHAIN + plugin))
    assert pc.load(robot(CHAIN + plugin), ignore=["plugin p"]).joints == pc.load(robot(CHAIN)).joints


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda path: pc.load(path, ignore=[3]), "ignore= needs tags or names"),
        (lambda path: pc.load(pc.load(path).model, ignore=["loop"]), "ignore= is for files"),
    ],
)
def test_ignore_that_cannot_be(robot, call, told):
    with pytest.raises(pc.InputError, match=told):
        call(robot(CHAIN))


def test_a_run_whose_scene_ignores_something_is_repeated(robot, tmp_path):
    path = robot(CHAIN + "<loopjoint/>")
    sol = pc.record(path, (0.0, 0.02), tmp_path / "a.npz", load={"ignore": "loopjoint"})
    assert np.array_equal(sol.q, pc.rerun(tmp_path / "a.npz").solution.q)


# <mimic> --------------------------------------------------------------------------------------------------------------


def pair(mimic='<mimic joint="j"/>', kind="continuous", other="continuous"):
    """Two bodies on the ground link a: j turns b, k turns c."""
    axis = '<axis xyz="0 1 0"/>'
    return A + B + C + joint("j", "a", "b", other, axis) + joint("k", "a", "c", kind, axis + mimic)


def test_mimic_is_a_coupling_named_like_its_joint(robot):
    assert pc.load(robot(pair())).loops == (Coupling("k", "k", "j", 1.0, 0.0),)
    mech = pc.load(robot(pair('<mimic joint="j" multiplier="-0.5" offset="0.25"/>', "prismatic")))
    assert mech.loops == (Coupling("k", "k", "j", -0.5, 0.25),)
    assert mech.nv == 2


def test_mimic_holds_over_whole_turns(robot):
    """A ratio of 0.3 on continuous joints: after several turns of one, the other is where counted turns put it."""
    mech = pc.load(robot(pair('<mimic joint="j" multiplier="0.3" offset="0.2"/>'))).with_gravity([0, 0, 0])
    sol = pc.simulate(mech, (0.0, 1.0), {"j": 0.5}, {"j": 20.0})
    assert sol.success and sol.q[-1, 0] > 4 * np.pi
    np.testing.assert_allclose(sol.q[:, 1], 0.3 * sol.q[:, 0] + 0.2, atol=1e-10)
    np.testing.assert_allclose(sol.q[-1, 0], 0.5 + 20.0, rtol=1e-6)  # both bodies are balanced by nothing: no force


def test_mimic_of_a_mimic_follows_through(robot):
    follow = ('<mimic joint="{}" multiplier="{}" offset="{}"/>'.format(*each) for each in (("j", 2, 1), ("k", 3, -1)))
    axis = '<axis xyz="0 1 0"/>'
    body = pair(next(follow)) + f'<link name="d">{BAR}</link>' + joint("l", "a", "d", "continuous", axis + next(follow))
    q = pc.assemble(pc.load(robot(body)), fixed={"j": 0.7}).q
    np.testing.assert_allclose(q, [0.7, 2.4, 6.2], atol=1e-12)


BAD_MIMICS = {
    "unknown": (pair('<mimic joint="i"/>'), "joint 'k': mimic: there is no joint 'i' to follow.*j"),
    "nothing": (pair("<mimic/>"), "joint 'k': mimic: there is no joint '' to follow"),
    "itself": (pair('<mimic joint="k"/>'), "joint 'k': mimic: the joint follows itself"),
    "circle": (
        pair().replace('name="j" type="continuous">', 'name="j" type="continuous"><mimic joint="k"/>'),
        "joints follow each other in a cycle: j → k → j",
    ),
    "of fixed": (pair(other="fixed"), "joint 'k': mimic: joint 'j' is fixed and cannot be followed"),
    "floating": (pair(other="floating"), "joint 'j' is floating and cannot be followed"),
    "multiplier": (pair('<mimic joint="j" multiplier="x"/>'), "joint 'k': mimic: multiplier='x' is not a finite"),
    "offset": (pair('<mimic joint="j" offset="nan"/>'), "joint 'k': mimic: offset='nan' is not a finite"),
    "two": (pair('<mimic joint="j"/><mimic joint="j"/>'), "joint 'k': mimic: a joint can follow only one other joint"),
}


def test_the_mimic_of_a_fixed_joint_is_told(robot):
    """Reduced models of robots have them; the joint stays fixed."""
    with pytest.warns(UserWarning, match="mimic"):
        mech = pc.load(robot(pair(kind="fixed")))
    assert mech.joints == ("j",) and not mech.loops


@pytest.mark.parametrize(("body", "message"), BAD_MIMICS.values(), ids=BAD_MIMICS)
def test_bad_mimic_is_named(robot, body, message):
    with pytest.raises(pc.FormatError, match=message):
        pc.load(robot(body))


def test_mimic_joint_made_spherical_is_refused(robot):
    with pytest.raises(pc.FormatError, match="coupling 'k': joint 'k' has 3 degrees of freedom"):
        pc.load(robot(pair(), "joint_name: [k]\njoint_type: [SPHERICAL]"))


# Pinocchio's own objects ----------------------------------------------------------------------------------------------


def anchors(model, closed=None):
    """(joint, placement) of the frames that close the four-bar; the second turned so that both coincide at `closed`."""
    coupler, rocker = (model.frames[model.getFrameId(name)] for name in ("coupler_tip", "rocker_tip"))
    place = rocker.placement
    if closed is not None:
        data = model.createData()
        pin.forwardKinematics(model, data, closed)
        place = data.oMi[rocker.parentJoint].actInv(data.oMi[coupler.parentJoint] * coupler.placement)
    return [coupler.parentJoint, coupler.placement, rocker.parentJoint, place]


CONSTRAINTS = {
    "point": ("point", pin.PointAnchorConstraintModel),
    "frame": ("frame", pin.FrameAnchorConstraintModel),
    "erased": ("point", lambda *args: pin.ConstraintModel(pin.PointAnchorConstraintModel(*args))),
    "rigid 3D": ("point", lambda *args: pin.RigidConstraintModel(pin.ContactType.CONTACT_3D, *args, pin.LOCAL)),
    "rigid 6D": ("frame", lambda *args: pin.RigidConstraintModel(pin.ContactType.CONTACT_6D, *args, pin.LOCAL)),
}


@pytest.mark.parametrize(("kind", "make"), CONSTRAINTS.values(), ids=CONSTRAINTS)
def test_constraint_models_are_loops(kind, make):
    """Where Pinocchio's own residual vanishes, so does ours, and the Jacobians span the same rows there."""
    model, closed = pc.load("four_bar").model, pc.load("four_bar").guess
    constraint = make(model, *anchors(model, closed))
    mech = pc.load(model, loops=[constraint])
    assert [(loop.name, loop.kind) for loop in mech.loops] == [("loop1", kind)]
    data, constraint_data = model.createData(), constraint.createData()
    pin.computeJointJacobians(model, data, closed)
    constraint.calc(model, data, constraint_data)
    jacobian = constraint.jacobian(model, data, constraint_data)
    phi, J = loop_rows(mech, closed)
    np.testing.assert_allclose(phi, 0, atol=1e-15)
    assert J.shape == jacobian.shape
    rank = np.linalg.matrix_rank(J, tol=1e-9)
    assert rank == (2 if kind == "point" else 3) == np.linalg.matrix_rank(np.vstack((J, jacobian)), tol=1e-9)
    if kind == "point":
        same_rows(mech, pc.load("four_bar", closure="point"))


def test_constraint_to_the_ground_and_names(caplog):
    model = pc.load("crank_rocker").model
    tip = model.frames[model.getFrameId("rocker_tip")]
    pivot = pin.SE3(np.eye(3), np.array([0.8, 0, 0]))
    constraint = pin.RigidConstraintModel(
        pin.ContactType.CONTACT_3D, model, tip.parentJoint, tip.placement, 0, pivot, pin.LOCAL
    )
    constraint.name = "pivot"
    mech = pc.load(model, loops=[constraint, constraint])
    assert [loop.name for loop in mech.loops] == ["pivot", "pivot (2)"]
    assert mech.loops[0].frame2 == "universe" and mech.loops[0].xyz2 == (0.8, 0, 0)


def test_joints_without_frames_get_one_in_a_copy():
    model = pin.Model()
    upper = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "upper")
    lower = model.addJoint(upper, pin.JointModelRY(), pin.SE3.Random(), "lower")
    model.appendBodyToJoint(lower, pin.Inertia.Random(), pin.SE3.Identity())
    model.addFrame(pin.Frame("lower", upper, 0, pin.SE3.Random(), pin.FrameType.OP_FRAME), False)  # a trap
    place1, place2, before = pin.SE3.Random(), pin.SE3.Random(), model.copy()
    constraint = pin.FrameAnchorConstraintModel(model, 0, place1, lower, place2)
    mech = pc.load(model, loops=[constraint])
    assert model == before
    q = np.array([0.3, -0.4])
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    gap = place1.actInv(data.oMi[lower] * place2)
    np.testing.assert_allclose(loop_rows(mech, q)[0], [*gap.translation, *pin.log3(gap.rotation)], atol=1e-13)


def test_joints_of_a_model_are_frames_whether_or_not_frames_were_added():
    """In loops, in forces, in results; the model itself stays as it is."""
    results = []
    for with_frames in (False, True):
        model = pin.Model()
        for name, x in zip("ab", (0.0, 1.0), strict=True):
            at = pin.SE3(np.eye(3), np.array([x, 0.0, 0.0]))
            index = model.addJoint(0, pin.JointModelRY(), at, name)
            model.appendBodyToJoint(index, pin.Inertia(1.0, np.array([0.4, 0, 0]), np.eye(3)), pin.SE3.Identity())
            if with_frames:
                model.addJointFrame(index)
        before = model.nframes
        tips = {"xyz1": (0.7, 0.0, 0.0), "xyz2": (0.8, 0.0, 0.0)}
        mech = pc.load(model, loops=[pc.Loop("tie", "distance", "a", "b", length=1.0, **tips)])
        mech = mech.add_forces(pc.SpringDamper("a", "b", stiffness=30.0, length=0.2), pc.Wrench("b", force=(0, 0, 1)))
        sol = pc.simulate(mech, (0.0, 0.1))
        assert model.nframes == before and sorted(frame.name for frame in mech.model.frames) == ["a", "b", "universe"]
        results.append(np.hstack((sol.q, sol.lam, sol.reaction("tie").force)))
    np.testing.assert_allclose(*results, rtol=0, atol=1e-12)


def test_records_stand_among_constraint_models_and_closure_holds_for_both():
    model = pc.load("four_bar").model
    constraint = pin.PointAnchorConstraintModel(model, *anchors(model))
    ours = pc.Loop("ours", "point", "coupler_tip", "rocker_tip")
    drive = pc.Drive("motor", "crank", np.sin)
    mech = pc.load(model, loops=[drive, constraint, ours], closure="frame")
    assert [(loop.name, loop.kind) for loop in mech.loops] == [
        ("motor", "drive"),
        ("loop1", "frame"),
        ("ours", "frame"),
    ]


def test_robot_wrapper_is_its_model():
    path = str(MODELS / "four_bar.urdf")
    wrapper = RobotWrapper.BuildFromURDF(path, str(MODELS))
    mech = pc.load(wrapper)
    assert mech.name == "four_bar" and mech.model == wrapper.model and mech.geometry is None
    built = RobotWrapper(pc.load("four_bar").model)
    assert pc.load(built, loops=[pin.PointAnchorConstraintModel(built.model, *anchors(built.model))]).nc == 3


def refused_constraints(model):
    four = anchors(model)
    offset = pin.PointAnchorConstraintModel(model, *four)
    offset.desired_constraint_offset = np.array([0.1, 0, 0])
    yield "desired_constraint_offset is not zero", offset
    moving = pin.RigidConstraintModel(pin.ContactType.CONTACT_6D, model, *four, pin.LOCAL)
    moving.desired_contact_velocity = pin.Motion(np.ones(6))
    yield "desired_contact_velocity is not zero", moving
    soft = pin.FrameAnchorConstraintModel(model, *four)
    soft.setCompliance(np.full(6, 1e-3))
    yield "compliant", soft
    yield "a int cannot be read", 3


@pytest.mark.parametrize("number", range(4))
def test_other_constraints_are_refused_by_name(number):
    model = pc.load("four_bar").model
    message, constraint = list(refused_constraints(model))[number]
    with pytest.raises(pc.InputError, match=message):
        pc.load(model, loops=[constraint])


def test_wrong_objects_are_refused():
    with pytest.raises(pc.InputError, match=r"a pin\.Model or a RobotWrapper, got Data"):
        pc.load(pin.Model().createData())
    model = pc.load("four_bar").model
    with pytest.raises(pc.InputError, match="needs a sequence"):
        pc.load(model, loops="four_bar.yaml")
    with pytest.raises(pc.InputError, match="free_flyer= is for files"):
        pc.load(model, free_flyer=True)
    with pytest.raises(pc.InputError, match="closure='weld' is not one of"):
        pc.load(model, closure="weld")
