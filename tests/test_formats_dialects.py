"""Loops in the words of other programs: each is the loop that it means, where the file says it."""

import json
import re

import numpy as np
import pinocchio as pin
import pytest

import pinconsist as pc
from pinconsist.mechanism.joint_constraints import Coupling
from pinconsist.mechanism.loops import Loop

INERTIAL = """<inertial><origin xyz="{0} 0 0"/><mass value="1"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/></inertial>"""
AXIS = '<axis xyz="0 1 0"/>'


def link(name, middle=0.2):
    return f'<link name="{name}">{INERTIAL.format(middle)}</link>'


def joint(name, parent, child, origin="", kind="continuous", inside=AXIS):
    return f"""<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
    <origin {origin}/>{inside}</joint>"""


CRANK_ROCKER = (
    link("base")
    + link("crank")
    + link("coupler", 0.3)
    + link("rocker")
    + joint("j1", "base", "crank", 'rpy="0 -1.1 0"')
    + joint("j2", "crank", "coupler", 'xyz="0.3 0 0" rpy="0 0.9 0"')
    + joint("j3", "base", "rocker", 'xyz="0.6 0 0" rpy="0 -1.4 0"')
)
"""A four-bar that is open; `END` is the end of the coupler, `TIP` that of the rocker."""
END, TIP = (0.55, 0.0, 0.02), (0.4, 0.0, 0.0)


@pytest.fixture
def robot(tmp_path):
    def written(text, name="robot.urdf", namespaces=""):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f'<robot name="probe"{namespaces}>{text}</robot>')
        return path

    return written


def xyz(point):
    return " ".join(map(str, point))


def gap(mech, loop, q=None):
    """The position and the rotation of anchor 2 seen from anchor 1."""
    model, data = mech.model, mech.model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model) if q is None else q)
    poses = {frame.name: data.oMf[i] for i, frame in enumerate(model.frames)}
    one, two = (poses[getattr(loop, f"frame{i}")] * getattr(loop, f"placement{i}") for i in (1, 2))
    return one.actInv(two)


def closes(mech, loop):
    return np.abs(gap(mech, loop).homogeneous - np.eye(4)).max() < 1e-12


# In a URDF -----------------------------------------------------------------------------------------------------------

SPOKEN = {
    "loop_joint": f"""<loop_joint name="pin" type="revolute"><link1 link="coupler" xyz="{xyz(END)}" rpy="0 0.3 0"/>
        <link2 link="rocker" xyz="{xyz(TIP)}" rpy="0 0.3 0"/>{AXIS}</loop_joint>""",
    "URDF+": f"""<loop name="pin" type="continuous"><predecessor link="coupler"><origin xyz="{xyz(END)}" rpy="0 0.3 0"/>
        </predecessor><successor link="rocker"><origin xyz="{xyz(TIP)}" rpy="0 0.3 0"/></successor>{AXIS}</loop>""",
    "URDF+, prefixed": f"""<a:loop xmlns:a="b" name="pin" type="revolute"><predecessor link="coupler"/>
        <successor link="rocker"/><predecessor_origin xyz="{xyz(END)}" rpy="0 0.3 0"/>
        <successor_origin xyz="{xyz(TIP)}" rpy="0 0.3 0"/>{AXIS}</a:loop>""",
    "urdfdom's fork": f"""<constraint name="pin" type="revolute_joint"><parent link="coupler"/>
        <parent_origin xyz="{xyz(END)}" rpy="0 0.3 0"/><child link="rocker"/>
        <child_origin xyz="{xyz(TIP)}" rpy="0 0.3 0"/>{AXIS}</constraint>""",
    "links as attributes": f"""<loop_joint name="pin" type="hinge" link_a="coupler" link_b="rocker">
        <link_a_origin xyz="{xyz(END)}" rpy="0 0.3 0"/><link_b_origin xyz="{xyz(TIP)}" rpy="0 0.3 0"/>{AXIS}
        </loop_joint>""",
}
HINGE = Loop("pin", "hinge", "coupler", "rocker", END, (0.0, 0.3, 0.0), TIP, (0.0, 0.3, 0.0), (0.0, 1.0, 0.0))


@pytest.mark.parametrize("spoken", SPOKEN)
def test_a_loop_in_a_urdf(robot, spoken):
    assert pc.load(robot(CRANK_ROCKER + SPOKEN[spoken])).loops == (HINGE,)


@pytest.mark.parametrize(
    ("kind", "means"),
    [("spherical_joint", "point"), ("ball", "point"), ("3d", "point"), ("weld", "frame"), ("6D", "frame")],
)
def test_kinds_by_other_names(robot, kind, means):
    text = SPOKEN["urdfdom's fork"].replace("revolute_joint", kind)
    assert [loop.kind for loop in pc.load(robot(CRANK_ROCKER + text)).loops] == [means]


def test_an_origin_that_is_missing_is_that_of_the_link(robot):
    text = f'<constraint name="tie" type="spherical_joint"><parent link="coupler"/><child link="rocker"/>{AXIS}'
    (loop,) = pc.load(robot(CRANK_ROCKER + text + "</constraint>")).loops
    assert loop == Loop("tie", "point", "coupler", "rocker")


def test_a_coupling_of_urdf_plus_is_the_sum_of_the_joints_to_their_common_ancestor(robot):
    """ratio · (to the predecessor) = (to the successor): explicitRollingConstraint of its authors' program."""
    gears = '<coupling name="belt"><predecessor link="crank"/><successor link="rocker"/><ratio value="6.0"/></coupling>'
    assert pc.load(robot(CRANK_ROCKER + gears)).loops == (Coupling("belt", "j3", "j1", 6.0),)
    gears = gears.replace('"crank"', '"coupler"')
    mech = pc.load(robot(CRANK_ROCKER + gears))
    assert mech.loops == (Coupling("belt", "j3", {"j1": 6.0, "j2": 6.0}),)
    sol = pc.simulate(mech, (0.0, 0.5), v0={"j1": 0.5, "j2": -0.3})
    q1, q2, q3 = (sol.q[:, mech.joints.index(name)] for name in ("j1", "j2", "j3"))
    np.testing.assert_allclose(6.0 * (q1 + q2), q3, atol=1e-9)
    assert np.abs(q3 - q3[0]).max() > 0.1


def test_a_coupling_of_a_fixed_link_is_refused(robot):
    gears = '<coupling name="belt"><predecessor link="base"/><successor link="rocker"/><ratio value="6.0"/></coupling>'
    with pytest.raises(pc.FormatError, match="'belt': one of its links does not move"):
        pc.load(robot(CRANK_ROCKER + gears))


def test_a_true_loop_is_cut_and_said_where(robot, recwarn):
    """The rocker is the child of two joints; the one with damping stays in the tree."""
    damped = AXIS + '<dynamics damping="0.3"/>'
    closing = joint("tip", "coupler", "rocker", f'xyz="{xyz(END)}" rpy="0 0.3 0"', inside=damped)
    mech = pc.load(robot(CRANK_ROCKER + closing))
    assert mech.joints == ("j1", "j2", "tip") and "the tree is cut at 'j3'" in str(recwarn[0].message)
    assert mech.loops == (
        Loop("j3", "hinge", "base", "rocker", (0.6, 0.0, 0.0), (0.0, -1.4, 0.0), axis=(0.0, 1.0, 0.0)),
    )
    for kind, means, row in (("fixed", "frame", 6), ("prismatic", "slider", 5), ("planar", "plane", 3)):
        other = joint("tip", "coupler", "rocker", kind=kind, inside='<axis xyz="0 0 1"/>')
        loops = pc.load(robot(CRANK_ROCKER + other)).loops
        assert [(loop.kind, len(loop.rows)) for loop in loops] == [(means, row) if row < 6 else ("hinge", 5)]


def test_links_that_hang_on_themselves_are_refused(robot):
    with pytest.raises(pc.FormatError, match="cycle"):
        pc.load(robot(link("base") + link("a") + link("b") + joint("i", "a", "b") + joint("k", "b", "a")))


def injected(inside="", kind="revolute", parent="coupler", pose="0.4 0 0 0 0.3 0"):
    return f"""<gazebo><joint name="tip" type="{kind}"><parent>{parent}</parent><child>rocker</child>
    <pose>{pose}</pose>{inside}</joint></gazebo>"""


def test_a_joint_that_gazebo_adds_is_where_its_child_is(robot):
    """Its pose is in the child; the parent is joined where that is in the configuration of the URDF."""
    axis = "<axis><xyz>0 1 0</xyz><limit><lower>-1e16</lower><upper>1e16</upper></limit></axis>"
    mech = pc.load(robot(CRANK_ROCKER + injected(axis)))
    (loop,) = mech.loops
    assert (loop.name, loop.kind, loop.frame1, loop.frame2) == ("tip", "hinge", "coupler", "rocker")
    assert (loop.xyz2, loop.axis) == ((0.4, 0.0, 0.0), (0.0, 1.0, 0.0))
    assert closes(mech, loop)


def test_the_axis_of_a_joint_of_gazebo_in_the_frame_of_the_model(robot):
    axis = "<axis><xyz>1 0 0</xyz><use_parent_model_frame>1</use_parent_model_frame></axis>"
    (loop,) = pc.load(robot(CRANK_ROCKER + injected(axis, "prismatic"))).loops
    assert loop.kind == "slider"
    turned = pin.rpy.rpyToMatrix(0.0, -1.4 + 0.3, 0.0)  # of the joint in the world
    np.testing.assert_allclose(turned @ np.array(loop.axis), [1.0, 0.0, 0.0], atol=1e-12)


def test_a_link_on_a_fixed_joint_and_the_world_are_ends(robot):
    more = '<link name="tool"/>' + joint("mount", "coupler", "tool", 'xyz="0.1 0.2 0.3"', "fixed", "")
    mech = pc.load(robot(CRANK_ROCKER + more + injected(parent="tool", kind="ball")))
    assert mech.loops[0].frame1 == "tool" and closes(mech, mech.loops[0])
    mech = pc.load(robot(CRANK_ROCKER + injected(parent="world", kind="ball")))
    assert mech.loops[0].frame1 == "universe"


DETACHABLE = """<gazebo><plugin filename="gz-sim-detachable-joint-system" name="gz::sim::systems::DetachableJoint">
<parent_link>coupler</parent_link><child_model>{}</child_model><child_link>rocker</child_link></plugin></gazebo>"""


def test_a_detachable_joint_welds_bodies_where_they_are(robot, recwarn):
    mech = pc.load(robot(CRANK_ROCKER + DETACHABLE.format("probe")))
    (loop,) = mech.loops
    assert (loop.kind, loop.frame1, loop.frame2, loop.xyz1) == ("frame", "coupler", "rocker", (0.0, 0.0, 0.0))
    assert closes(mech, loop)
    other = DETACHABLE.format("box").replace(">rocker<", ">lid<")
    mech = pc.load(robot(CRANK_ROCKER + other))
    assert mech.loops == () and mech.ignored == ("plugin DetachableJoint of the model 'box', which is not in the file",)


def test_plugins_of_mimic_joints_and_of_closed_loops(robot):
    plugin = """<gazebo><plugin filename="libroboticsgroup_gazebo_mimic_joint_plugin.so" name="m"><joint>j1</joint>
    <mimicJoint>j3</mimicJoint><multiplier>-2.0</multiplier><offset>0.1</offset></plugin></gazebo>"""
    assert pc.load(robot(CRANK_ROCKER + plugin)).loops == (Coupling("j3", "j3", "j1", -2.0, 0.1),)
    twice = CRANK_ROCKER.replace('<joint name="j3"', '<joint name="j3" type="x"', 0)
    assert pc.load(robot(twice + plugin)).loops == (Coupling("j3", "j3", "j1", -2.0, 0.1),)
    plugin = """<gazebo><plugin name="lf" filename="libpegasus_gazebo_closed_loop_plugin.so"><joint>tip</joint>
    <child>rocker</child><parent>coupler</parent><position>0.4 0 0</position><rotation>0 0.3 0</rotation></plugin>
    </gazebo>"""
    mech = pc.load(robot(CRANK_ROCKER + plugin))
    assert (mech.loops[0].kind, mech.loops[0].xyz2, mech.loops[0].axis) == ("hinge", TIP, (0.0, 1.0, 0.0))
    assert closes(mech, mech.loops[0])


def test_the_mimic_plugin_of_a_fixed_joint_is_counted(robot):
    """Reduced models of robots have them."""
    text = link("tool") + joint("mount", "coupler", "tool", kind="fixed", inside="")
    text += """<gazebo><plugin filename="libmimic.so" name="m"><joint>j1</joint><mimicJoint>mount</mimicJoint></plugin>
    </gazebo>"""
    mech = pc.load(robot(CRANK_ROCKER + text))
    assert mech.loops == () and "1 mimic plugin of a fixed joint" in mech.ignored


def test_a_declaration_below_a_comment_is_read(robot):
    """As TinyXML of Gazebo does."""
    path = robot(CRANK_ROCKER)
    text = re.sub(r"<\?xml.*?\?>", "", path.read_text())
    path.write_text(f"<!-- a licence -->\n\n<?xml version='1.0' ?>\n{text}")
    assert len(pc.load(path).joints) == 3


def test_a_plugin_that_repeats_a_mimic_is_not_a_second_coupling(robot):
    text = CRANK_ROCKER.replace(joint("j3", "base", "rocker", 'xyz="0.6 0 0" rpy="0 -1.4 0"'), "")
    text += joint("j3", "base", "rocker", inside=AXIS + '<mimic joint="j1"/>')
    text += """<gazebo><plugin filename="libmimic.so" name="m"><joint>j1</joint><mimicJoint>j3</mimicJoint></plugin>
    </gazebo>"""
    assert pc.load(robot(text)).loops == (Coupling("j3", "j3", "j1"),)


def test_equalities_of_mujoco_in_a_urdf(robot):
    text = f"""<mujoco><equality><connect name="pin" body1="coupler" body2="rocker" anchor="{xyz(END)}"/>
    <weld body1="crank" body2="rocker" active="false"/>
    <joint name="gear" joint1="j3" joint2="j1" polycoef="0.1 -2 0.3 0 0"/></equality></mujoco>"""
    mech = pc.load(robot(CRANK_ROCKER + text))
    assert mech.loops[1] == Coupling("gear", "j3", "j1", -2.0, 0.1, (0.3, 0.0, 0.0))
    assert (mech.loops[0].kind, mech.loops[0].xyz1) == ("point", END)
    assert np.linalg.norm(gap(mech, mech.loops[0]).translation) < 1e-12 and "1 inactive equality" in mech.ignored


# Drake ---------------------------------------------------------------------------------------------------------------

DRAKE = ' xmlns:drake="http://drake.mit.edu"'


def drake(tag, **children):
    inside = "".join(
        f'<drake:{tag}_{key} {"name" if isinstance(value, str) and not value[0].isdigit() else "value"}="{value}"/>'
        for key, value in children.items()
    )
    return f"<drake:{tag}>{inside}</drake:{tag}>"


ENDS = {"body_A": "coupler", "body_B": "rocker", "p_AP": xyz(END), "p_BQ": xyz(TIP)}


def test_constraints_of_drake(robot):
    def loaded(text):
        return pc.load(robot(CRANK_ROCKER + text, namespaces=DRAKE))

    point = {"frame1": "coupler", "frame2": "rocker", "xyz1": END, "xyz2": TIP}
    assert loaded(drake("ball_constraint", **ENDS)).loops == (Loop("ball_constraint", "point", **point),)
    text = drake("distance_constraint", **ENDS, distance=0.5)
    assert loaded(text).loops == (Loop("distance_constraint", "distance", **point, length=0.5),)
    text = drake("distance_constraint", **ENDS, distance=0.5, stiffness=100.0, damping=2.0)
    assert loaded(text).forces == (pc.SpringDamper("coupler", "rocker", 100.0, 0.5, 2.0, END, TIP),)
    text = drake("linear_spring_damper", **ENDS, free_length=0.2, stiffness=100.0, damping=2.0)
    assert loaded(text).forces == (pc.SpringDamper("coupler", "rocker", 100.0, 0.2, 2.0, END, TIP),)


def test_frames_of_drake(robot):
    frames = """<frame name="p" link="coupler" xyz="0.5 0 0" rpy="0 0.3 0"/>
    <frame name="s" link="rocker" xyz="0.4 0 0" rpy="0 0 0"/>"""
    rates = {"bushing_torque_stiffness": "1 2 3", "bushing_torque_damping": "0.1 0.2 0.3"}
    rates |= {"bushing_force_stiffness": "10 20 30", "bushing_force_damping": "4 5 6"}
    inside = '<drake:bushing_frameA name="p"/><drake:bushing_frameC name="s"/>'
    inside += "".join(f'<drake:{key} value="{value}"/>' for key, value in rates.items())
    text = frames + f"<drake:linear_bushing_rpy>{inside}</drake:linear_bushing_rpy>"
    (bushing,) = pc.load(robot(CRANK_ROCKER + text, namespaces=DRAKE)).forces
    assert bushing == pc.Bushing(
        "coupler", "rocker", (10, 20, 30, 1, 2, 3), (4, 5, 6, 0.1, 0.2, 0.3), (0.5, 0, 0), (0, 0.3, 0), (0.4, 0, 0)
    )
    text = frames + '<drake:weld_constraint><drake:parent name="p"/><drake:child name="s"/></drake:weld_constraint>'
    (loop,) = pc.load(robot(CRANK_ROCKER + text, namespaces=DRAKE)).loops
    assert loop == Loop("weld_constraint", "frame", "coupler", "rocker", (0.5, 0, 0), (0, 0.3, 0), (0.4, 0, 0))


def tendon(lower, upper, **shares):
    joints = "".join(f'<drake:tendon_constraint_joint name="{name}" a="{a}"/>' for name, a in shares.items())
    return f"""<drake:tendon_constraint>{joints}<drake:tendon_constraint_offset value="0.5"/>
    <drake:tendon_constraint_lower_limit value="{lower}"/><drake:tendon_constraint_upper_limit value="{upper}"/>
    </drake:tendon_constraint>"""


def test_tendons_of_drake_with_equal_limits_are_couplings(robot):
    """Σ a q + offset = limit."""
    mech = pc.load(robot(CRANK_ROCKER + tendon(1.5, 1.5, j1=2.0, j3=-4.0), namespaces=DRAKE))
    assert mech.loops == (Coupling("tendon_constraint", "j1", "j3", 2.0, 0.5),)
    mech = pc.load(robot(CRANK_ROCKER + tendon(1.5, 1.5, j1=2.0, j2=1.0, j3=-4.0), namespaces=DRAKE))
    q = pc.assemble(mech).q
    assert abs(2.0 * q[0] + q[1] - 4.0 * q[2] + 0.5 - 1.5) < 1e-12
    mech = pc.load(robot(CRANK_ROCKER + tendon(-1, "inf", j1=2.0), namespaces=DRAKE))
    assert mech.loops == () and "1 limited tendon" in mech.ignored


@pytest.mark.parametrize(
    ("kind", "more", "names"),
    [
        ("planar", "", ["JointModelPlanar"]),
        ("ball", "", ["JointModelSpherical"]),
        ("universal", "", ["JointModelRX", "JointModelRY"]),
        ("screw", '<drake:screw_thread_pitch value="0.2"/><axis xyz="0 0 1"/>', ["JointModelHZ"]),
    ],
)
def test_joints_of_drake(robot, kind, more, names):
    text = f"""{link("puck")}<drake:joint name="own" type="{kind}"><parent link="base"/><child link="puck"/>
    <origin xyz="0 0 1"/>{more}</drake:joint>"""
    mech = pc.load(robot(CRANK_ROCKER + text, namespaces=DRAKE))
    own = [model.shortname() for name, model in zip(mech.model.names, mech.model.joints, strict=True) if "own" in name]
    assert own == names
    if kind == "screw":
        data = mech.model.createData()
        pin.framesForwardKinematics(mech.model, data, mech.configuration({"own": 2.0 * np.pi}))
        np.testing.assert_allclose(data.oMf[mech.model.getFrameId("puck")].translation, [0, 0, 1.2], atol=1e-12)


# Files beside a URDF -------------------------------------------------------------------------------------------------


def test_loop_closures_of_the_folder_above_are_found(robot, tmp_path, recwarn):
    (tmp_path / "loop_closures.yaml").write_text(
        f"""ball_loops: [{{name: tie, parent: crank, child: rocker, parent_xyz: [0.1, 0, 0], child_xyz: [0, 0, 0.2]}}]
pin_loops:
- {{name: pin, parent: coupler, child: rocker, parent_xyz: {list(END)}, child_xyz: {list(TIP)}, axis: [0, ±1, 0]}}
ball_upgrades: [j2]
ball_limit_deg: 30
actuated_joints: [j1]
"""
    )
    mech = pc.load(robot(CRANK_ROCKER, "urdf/probe.urdf"))
    tie, hinge = mech.loops
    assert tie == Loop("tie", "point", "crank", "rocker", (0.1, 0.0, 0.0), xyz2=(0.0, 0.0, 0.2))
    assert (hinge.kind, hinge.xyz1, hinge.xyz2, hinge.axis) == ("hinge", END, TIP, (0.0, 1.0, 0.0))
    np.testing.assert_allclose(gap(mech, hinge).rotation, np.eye(3), atol=1e-12)
    assert mech.actuated == ("j1",) and mech.model.nvs[mech.model.getJointId("j2")] == 3
    assert "its loops are taken from" in str(recwarn[0].message) and any("ball_limit_deg" in x for x in mech.ignored)


def test_closures_with_a_point_in_the_root(robot, tmp_path):
    """sw2robot: point and axis in the axes of the root link, in the configuration of the URDF."""
    (tmp_path / "loop_closures.yaml").write_text(
        """closures: [{link_a: coupler, link_b: rocker, point: [0.6, 0.1, 0.3], axis: [0, 0, 2]}]
dependent: [j2, j3]
independent: [j1]
"""
    )
    mech = pc.load(robot(CRANK_ROCKER))
    (loop,) = mech.loops
    assert (loop.kind, mech.actuated) == ("hinge", ("j1",)) and closes(mech, loop)
    data = mech.model.createData()
    pin.framesForwardKinematics(mech.model, data, pin.neutral(mech.model))
    anchor = data.oMf[mech.model.getFrameId("coupler")] * loop.placement1
    np.testing.assert_allclose(anchor.translation, [0.6, 0.1, 0.3], atol=1e-12)
    np.testing.assert_allclose(anchor.rotation @ loop.axis, [0.0, 0.0, 1.0], atol=1e-12)


CLOSING = {
    "prismatic": ("slider", (1.0, 0.0, 0.0)),
    "revolute": ("hinge", (1.0, 0.0, 0.0)),
    "continuous": ("hinge", (1.0, 0.0, 0.0)),
    "fixed": ("frame", None),
}


@pytest.mark.parametrize("kind", CLOSING)
def test_closing_joints_with_an_origin_in_the_parent(robot, tmp_path, kind):
    """fusion2urdf: the child's frame is not at the origin of the joint."""
    entry = {"name": "j", "source": "manual", "type": kind, "parent": "coupler", "child": "rocker"}
    entry |= {"origin_xyz_m": list(END), "origin_rpy_rad": [0.1, 0.2, 0.3], "axis": [1, 0, 0]}
    (tmp_path / "robot_data.yaml").write_text(json.dumps({"links": {"a": 1}, "closing_joints": [entry]}))
    mech = pc.load(robot(CRANK_ROCKER, "probe.urdf"))
    (loop,) = mech.loops
    assert (loop.kind, loop.axis) == CLOSING[kind]
    assert (loop.xyz1, loop.frame1) == (END, "coupler") and closes(mech, loop)
    np.testing.assert_allclose(loop.rpy1, [0.1, 0.2, 0.3], atol=1e-12)


def test_empty_lists_of_loops_close_nothing(robot, tmp_path, recwarn):
    (tmp_path / "robot_data.yaml").write_text("links: {a: 1}\nclosing_joints: []\n")
    assert pc.load(robot(CRANK_ROCKER, "probe.urdf")).loops == () and not len(recwarn)


BAD_LISTS = {
    "no parent": ("pin_loops: [{name: p}]", "pin_loops 1: 'parent' is missing"),
    "no point": ("ball_loops: [{parent: crank, child: rocker}]", "ball_loops 1: 'parent_xyz' is missing"),
    "no axis": (
        "pin_loops: [{parent: crank, child: rocker, parent_xyz: [0, 0, 0], child_xyz: [0, 0, 0]}]",
        "pin_loops 1: 'axis' is missing",
    ),
    "zero axis": (
        "closures: [{link_a: crank, link_b: rocker, point: [0, 0, 0], axis: [0, 0, 0]}]",
        "closures 1: the axis is the zero vector",
    ),
    "link": (
        "closures: [{link_a: crnk, link_b: rocker, point: [0, 0, 0], axis: [0, 0, 1]}]",
        "no frame .crnk.",
    ),
    "type": ("closing_joints: [{parent: crank, child: rocker, type: gear}]", "the type 'gear' is not one of"),
    "itself": ("closing_joints: [{parent: crank, child: crank}]", "both ends are on the link 'crank'"),
    "not a record": ("closures: [3]", "closures 1: keys such as name, parent, child are needed"),
}


@pytest.mark.parametrize(("text", "message"), BAD_LISTS.values(), ids=BAD_LISTS)
def test_bad_lists_of_loops_are_named(robot, tmp_path, text, message):
    (tmp_path / "loop_closures.yaml").write_text(text)
    with pytest.raises(pc.FormatError, match=message) as caught:
        pc.load(robot(CRANK_ROCKER, "probe.urdf"))
    assert caught.value.path == str(tmp_path / "loop_closures.yaml")


BAD = {
    "constraint without a type that is known": ('<constraint name="l" type="gears"/>', "type 'gears' is not one of"),
    "loop without ends": ('<loop name="l"/>', "loop 'l': <link1> is missing"),
    "gazebo's joint of a link that is not there": (injected(parent="hand"), "there is no link 'hand'"),
    "gazebo's gearbox": (injected(kind="gearbox"), "type 'gearbox' is not one of revolute"),
    "gazebo's axis": (injected("<axis><xyz>0 0 0</xyz></axis>"), "the axis is the zero vector"),
    "detachable": (DETACHABLE.format("probe").replace(">rocker<", ">coupler<"), "the same link 'coupler'"),
    "drake's body": (drake("ball_constraint", **(ENDS | {"body_A": "x"})), "there is no link 'x'"),
    "drake's numbers": (drake("ball_constraint", **(ENDS | {"p_AP": "0 0"})), "'0 0' is not 3 finite numbers"),
    "drake's tendon": (tendon(1, 1, j9=1.0), "there is no movable joint 'j9'"),
    "drake's joint": ('<drake:joint name="a" type="rubber"/>', "type 'rubber' is not one of planar, ball"),
    "an equality without joint2": ('<mujoco><equality><joint joint1="j1"/></equality></mujoco>', "joint2 is missing"),
}


@pytest.mark.parametrize(("text", "message"), BAD.values(), ids=BAD)
def test_bad_extensions_are_named(robot, text, message):
    path = robot(CRANK_ROCKER + text, namespaces=DRAKE)
    with pytest.raises(pc.FormatError, match=message) as caught:
        pc.load(path)
    assert caught.value.path == str(path)


# xacro ---------------------------------------------------------------------------------------------------------------

XACRO = ' xmlns:xacro="http://www.ros.org/wiki/xacro"'
needs_xacro = pytest.mark.skipif(
    __import__("importlib.util").util.find_spec("xacro") is None, reason="the package xacro is not installed"
)


@needs_xacro
def test_a_xacro_file_is_expanded_with_its_includes_and_arguments(robot, tmp_path):
    package = tmp_path / "src" / "arm_description"
    (package / "urdf").mkdir(parents=True)
    (package / "package.xml").write_text("<package><name>arm_description</name></package>")
    (package / "urdf" / "tip.xacro").write_text(
        f"<robot{XACRO}><xacro:macro name='tip' params='length'>"
        + SPOKEN["loop_joint"].replace("0.55", "${length}")
        + "</xacro:macro></robot>"
    )
    text = f"""<xacro:arg name="length" default="0.5"/>
    <xacro:include filename="$(find arm_description)/urdf/tip.xacro"/>{CRANK_ROCKER}
    <xacro:if value="${{2 > 1}}"><xacro:tip length="$(arg length)"/></xacro:if>"""
    path = robot(text, "src/arm_description/urdf/arm.urdf.xacro", XACRO)
    assert pc.load(path).name == "arm"
    assert pc.load(path).loops[0].xyz1 == (0.5, 0.0, 0.02)
    assert pc.load(path, args={"length": 0.55}).loops == (HINGE,)
    plain = path.with_name("plain.urdf")  # the ending does not matter
    plain.write_text(path.read_text())
    assert pc.load(plain, args={"length": 0.55}).loops == (HINGE,)
    with pytest.raises(pc.InputError, match="args= is for xacro files"):
        pc.load("four_bar", args={"length": 1})


@needs_xacro
def test_properties_may_begin_with_an_underscore(robot):
    """Single underscores mark private properties in public files; names of Python have two."""
    text = """<xacro:property name="_long" value="0.55"/><xacro:if value="${_long > 1 or _long == 0.55}">"""
    path = robot(f"{text}{SPOKEN['loop_joint']}</xacro:if>{CRANK_ROCKER}", "probe.xacro", XACRO)
    assert pc.load(path).loops == (HINGE,)


@needs_xacro
def test_includes_and_macros_of_a_missing_package_can_be_left_out(robot, tmp_path):
    """A camera of another package: its include, then the call of its macro, each by the name that the message gives."""
    camera = '<xacro:include filename="$(find camera_description)/urdf/camera.xacro"/><xacro:camera parent="crank"/>'
    text = CRANK_ROCKER + SPOKEN["loop_joint"]
    path = robot(text + camera, "probe.xacro", XACRO)
    ignore = []
    for name in ("camera_description", "xacro:camera"):
        with pytest.raises(pc.FormatError, match=rf"ignore=\['{name}'\] leaves out"):
            pc.load(path, ignore=ignore)
        ignore.append(name)
    assert pc.load(path, ignore=ignore).loops == (HINGE,)
    part = tmp_path / "more.xacro"
    part.write_text(f"<robot{XACRO}><xacro:include filename='lost.xacro'/></robot>")
    path = robot(f"{text}<xacro:include filename='more.xacro'/>", "probe.xacro", XACRO)
    assert pc.load(path, ignore=["lost.xacro"]).loops == (HINGE,)


EVIL = {
    "a name of Python": "${__builtins__}",
    "an attribute": "${().__doc__}",
    "a file": "${xacro.load_yaml('/etc/passwd')}",
    "a file above": "<xacro:include filename='../secret.xacro'/>",
    "a file by find": "<xacro:include filename='$(find arm)/x.xacro'/>",
    "open": "$(eval open('/etc/passwd').read())",
    "a class": "${().__class__.__base__.__subclasses__()}",
    "a format": "${'{0.__class__}'.format(1)}",
    "the environment": "$(env HOME)",
    "an import": "$(eval __import__('os').system('touch pwned'))",
    "a long number": "${9**9**9}",
    "itself": "<xacro:include filename='probe.xacro'/>",
}


@needs_xacro
@pytest.mark.parametrize("evil", EVIL)
def test_what_a_xacro_file_must_not_do(robot, tmp_path, evil):
    (tmp_path / "secret.xacro").write_text("<robot><link name='secret'/></robot>")
    text = EVIL[evil] if EVIL[evil].startswith("<") else f'<link name="x{EVIL[evil]}"/>'
    path = robot(CRANK_ROCKER + text, "scene/probe.xacro", XACRO)
    with pytest.raises(pc.FormatError) as caught:
        pc.load(path)
    assert caught.value.path == str(path) and "secret" not in str(caught.value).replace("secret.xacro", "")
    assert not list(tmp_path.rglob("pwned"))


@needs_xacro
@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('<xacro:include filename="$(find arm)/x.xacro"/>', r"\$\(find arm\).*package_dirs="),
        ('<link name="$(arg side)"/>', r"its argument 'side' has no default; pass it: args="),
        ("<xacro:nothing/>", "xacro: .*nothing"),
        ("<xacro:include filename='none.xacro'/>", "xacro: .*none.xacro"),
        ("<xacro:include filename='package://arm/none.xacro'/>", "xacro: .*none.xacro"),
    ],
)
def test_errors_of_xacro_say_what_helps(robot, text, message):
    with pytest.raises(pc.FormatError, match=message):
        pc.load(robot(CRANK_ROCKER + text, "probe.xacro", XACRO))
