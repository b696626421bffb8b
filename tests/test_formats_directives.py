"""Model directives of Drake, and models that SDF files include: URDF, and merged ones."""

import numpy as np
import pinocchio as pin
import pytest

import pinconsist as pc
from pinconsist.mechanism.joint_constraints import Coupling

ARM = """<robot name="arm"><link name="base"/>
<link name="upper"><inertial><origin xyz="0.3 0.1 0"/><mass value="2"/>
  <inertia ixx="0.1" ixy="0.01" ixz="0" iyy="0.2" iyz="0" izz="0.3"/></inertial></link>
<link name="lower"><inertial><origin xyz="0.2 0 0" rpy="0.1 0.2 0.3"/><mass value="1"/>
  <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.2" iyz="0.02" izz="0.3"/></inertial></link><link name="tip"/>
<joint name="shoulder" type="revolute"><origin xyz="0 0 0.5" rpy="0 0.3 0"/><parent link="base"/><child link="upper"/>
  <axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="9" velocity="3"/><dynamics damping="0.4" friction="0.1"/>
  </joint>
<joint name="lower" type="continuous"><origin xyz="0.6 0 0" rpy="0.2 0 0"/><parent link="upper"/><child link="lower"/>
  <axis xyz="0 0.6 0.8"/></joint>
<joint name="flange" type="fixed"><origin xyz="0.4 0 0" rpy="0 0 0.5"/><parent link="lower"/><child link="tip"/></joint>
</robot>"""
TOOL = """<sdf version="1.9"><model name="tool"><link name="body"><inertial><pose>0.1 0 0 0 0 0</pose><mass>0.5</mass>
  <inertia><ixx>0.01</ixx><iyy>0.01</iyy><izz>0.01</izz></inertia></inertial></link>
  <frame name="grip" attached_to="body"><pose>0 0 0.2 0.4 0 0</pose></frame>
  <link name="jaw"><pose>0.2 0 0 0 0 0</pose><inertial><mass>0.2</mass>
  <inertia><ixx>0.01</ixx><iyy>0.01</iyy><izz>0.01</izz></inertia></inertial></link>
  <joint name="slide" type="prismatic"><parent>body</parent><child>jaw</child><axis><xyz>1 0 0</xyz></axis></joint>
</model></sdf>"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "arm.urdf").write_text(ARM)
    (tmp_path / "tool.sdf").write_text(TOOL)
    return tmp_path


def directives(folder, text, name="scene.dmd.yaml"):
    (folder / name).write_text(f"directives:\n{text}")
    return folder / name


def place(xyz, rpy):
    return pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array(xyz, float))


def poses(mech, q):
    data = mech.model.createData()
    pin.framesForwardKinematics(mech.model, data, q)
    return {frame.name: data.oMf[i] for i, frame in enumerate(mech.model.frames)}


def matrices(mech, q):
    model, data = mech.model, mech.model.createData()
    M = pin.crba(model, data, q)
    return np.triu(M), pin.computeGeneralizedGravity(model, data, q)


WELDED = """- add_model: {name: left, file: arm.urdf, default_joint_positions: {shoulder: [0.3], lower_joint: [-0.4]}}
- add_weld: {parent: world, child: "left::base", X_PC: {translation: [1, 0, 0], rotation: !Rpy {deg: [0, 0, 90]}}}
- add_model: {name: tool, file: ./tool.sdf}
- add_frame: {name: mount, X_PF: {base_frame: tip, translation: [0.1, 0, 0], rotation: !AngleAxis {axis: [1, 0, 0],
    angle_deg: 30}}}
- add_weld: {parent: "left::mount", child: "tool::grip"}
"""


def test_models_are_placed_and_welded(folder):
    mech = pc.load(directives(folder, WELDED))
    assert set(mech.joints) == {"left::shoulder", "left::lower_joint", "tool::slide"}
    start = dict(zip(mech.joints, mech.guess, strict=True))
    assert (start["left::shoulder"], start["left::lower_joint"], start["tool::slide"]) == (0.3, -0.4, 0.0)
    q = np.array([{"left::shoulder": 0.3, "left::lower_joint": -0.4, "tool::slide": 0.2}[name] for name in mech.joints])
    axis = pin.AngleAxis(-0.4, np.array([0.0, 0.6, 0.8])).toRotationMatrix()
    tip = (
        place((1, 0, 0), (0, 0, np.pi / 2)) * place((0, 0, 0.5), (0, 0.3, 0)) * place((0, 0, 0), (0, 0.3, 0))
        * place((0.6, 0, 0), (0.2, 0, 0)) * pin.SE3(axis, np.zeros(3)) * place((0.4, 0, 0), (0, 0, 0.5))
    )  # fmt: skip
    body = tip * place((0.1, 0, 0), (np.pi / 6, 0, 0)) * place((0, 0, 0.2), (0.4, 0, 0)).inverse()
    found = poses(mech, q)
    np.testing.assert_allclose(found["left::tip"].homogeneous, tip.homogeneous, atol=1e-12)
    np.testing.assert_allclose(found["tool::body"].homogeneous, body.homogeneous, atol=1e-12)
    jaw = body * place((0.4, 0, 0), (0, 0, 0))
    np.testing.assert_allclose(found["tool::jaw"].homogeneous, jaw.homogeneous, atol=1e-12)


def test_what_is_not_welded_floats(folder):
    text = """- add_model: {name: arm, file: arm.urdf}
- add_weld: {parent: world, child: arm::base}
- add_model: {name: tool, file: tool.sdf, default_free_body_pose: {body: {translation: [0, 0, 2],
    rotation: !Quaternion {wxyz: [0, 1, 0, 0]}}}}
"""
    mech = pc.load(directives(folder, text))
    assert mech.nv == 2 + 6 + 1
    body = poses(mech, mech.guess)["tool::body"]
    np.testing.assert_allclose(body.homogeneous, place((0, 0, 2), (np.pi, 0, 0)).homogeneous, atol=1e-12)
    with pytest.raises(pc.InputError, match="free_flyer= is not for directives of Drake"):
        pc.load(directives(folder, text), free_flyer=True)


def test_directives_of_other_files_have_a_namespace(folder):
    (folder / "arms").mkdir()
    directives(folder, WELDED.replace("arm.urdf", "../arm.urdf").replace("./tool", "../tool"), "arms/one.dmd.yaml")
    text = "- add_directives: {file: arms/one.dmd.yaml, model_namespace: right}\n"
    mech = pc.load(directives(folder, text))
    assert set(mech.joints) == {"right::left::shoulder", "right::left::lower_joint", "right::tool::slide"}
    plain = pc.load(directives(folder, WELDED, "plain.dmd.yaml"))
    for one, two in zip(matrices(mech, mech.guess), matrices(plain, plain.guess), strict=True):
        np.testing.assert_allclose(one, two, atol=1e-12)


def test_loops_of_a_model_stay(folder):
    tie = """<drake:ball_constraint xmlns:drake="http://drake.mit.edu"><drake:ball_constraint_body_A>body
      </drake:ball_constraint_body_A><drake:ball_constraint_p_AP>0.5 0 0</drake:ball_constraint_p_AP>
      <drake:ball_constraint_body_B>jaw</drake:ball_constraint_body_B><drake:ball_constraint_p_BQ>0.2 0 0
      </drake:ball_constraint_p_BQ></drake:ball_constraint>"""
    (folder / "tool.sdf").write_text(TOOL.replace("</model>", f"{tie}</model>"))
    mech = pc.load(directives(folder, WELDED))
    (loop,) = mech.loops
    assert (loop.kind, loop.frame1, loop.frame2) == ("point", "tool::body", "tool::jaw")
    assert pc.assemble(mech).q[mech.joints.index("tool::slide")] == pytest.approx(0.1, abs=1e-12)


WRONG = {
    "key": ("- add_mdel: {name: a}\n", "directive 1: 'add_mdel' is not known; similar: add_model"),
    "file": ("- add_model: {name: a, file: none.urdf}\n", r"there is no such model .*ignore=\['none\.urdf'\]"),
    "no file": ("- add_model: {name: a}\n", "directive 1, add_model a: 'file' is missing"),
    "frame": (WELDED.replace("left::base", "left2::base"), "directive 2, add_weld: there is no frame 'left2::base'"),
    "twice": (WELDED + '- add_weld: {parent: world, child: "tool::body"}\n', "directive 6, .*'tool' is welded twice"),
    "numbers": (WELDED.replace("[1, 0, 0], rotation", "[1, 0], rotation"), r"directive 2.*\[1, 0\] is not 3 finite"),
    "rotation": (WELDED.replace("!Rpy {deg: [0, 0, 90]}", "!Uniform {}"), "the rotation !Uniform is not one of Rpy"),
    "joint": (WELDED.replace("shoulder: [0.3]", "elbow: [0.3]"), "there is no joint 'left::elbow'"),
    "position": (WELDED.replace("[0.3]", "[x]"), r"directive 1, add_model left: shoulder: \['x'\] is not a position"),
    "itself": ("- add_directives: {file: scene.dmd.yaml}\n", "nested more than 20 deep"),
    "outside": ("- add_model: {name: a, file: ../../etc/passwd}\n", "outside the folder|no such model"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_directives(folder, case):
    text, message = WRONG[case]
    with pytest.raises(pc.FormatError, match=rf"(?s)scene\.dmd\.yaml: .*{message}"):
        pc.load(directives(folder, text))


# SDF -----------------------------------------------------------------------------------------------------------------


def test_an_included_urdf_is_what_it_is_by_itself(folder):
    """Equal mass matrices, gravity and frames; its joint, which has the name of a link, gets another."""
    text = '<sdf version="1.9"><world name="w"><gravity>0 0 -9.81</gravity><include><uri>arm.urdf</uri></include>'
    fixed = '<joint name="f" type="fixed"><parent>world</parent><child>arm::base</child></joint></world></sdf>'
    (folder / "world.sdf").write_text(text + fixed)
    mech, plain = pc.load(folder / "world.sdf"), pc.load(folder / "arm.urdf")
    assert mech.joints == ("arm::shoulder", "arm::lower_joint") and plain.joints == ("shoulder", "lower")
    for q in np.random.default_rng(2).uniform(-1, 1, (3, 2)):
        for one, two in zip(matrices(mech, q), matrices(plain, q), strict=True):
            np.testing.assert_allclose(one, two, atol=1e-12)
        tip = poses(mech, q)["arm::tip"].homogeneous
        np.testing.assert_allclose(tip, poses(plain, q)["tip"].homogeneous, atol=1e-12)
    for key in ("damping", "upperDryFrictionLimit", "upperPositionLimit"):
        np.testing.assert_array_equal(getattr(mech.model, key), getattr(plain.model, key))
    assert mech.model.upperEffortLimit[0] == 9.0


def test_mimics_and_plugins_of_an_included_urdf(folder):
    mimic = '<mimic joint="shoulder" multiplier="-2" offset="0.1"/>'
    weld = """<gazebo><plugin filename="x" name="gz::sim::systems::DetachableJoint"><parent_link>upper</parent_link>
      <child_model>arm</child_model><child_link>tip</child_link></plugin></gazebo>"""
    text = ARM.replace('<axis xyz="0 0.6 0.8"/>', f'<axis xyz="0 0.6 0.8"/>{mimic}').replace(
        "</robot>", f"{weld}</robot>"
    )
    (folder / "arm.urdf").write_text(text)
    (folder / "world.sdf").write_text(
        '<sdf version="1.9"><world name="w"><include><uri>arm.urdf</uri></include></world></sdf>'
    )
    mech = pc.load(folder / "world.sdf")
    frame, coupling = mech.loops
    assert (frame.kind, frame.frame1, frame.frame2) == ("frame", "upper", "tip")
    assert coupling == Coupling("lower_joint mimic", "lower_joint", "shoulder", -2.0, 0.1)
    loop = '<loop_joint name="l"><link1 link="base"/><link2 link="tip"/></loop_joint>'
    (folder / "arm.urdf").write_text(ARM.replace("</robot>", f"{loop}</robot>"))
    with pytest.raises(pc.FormatError, match="an included URDF cannot have a <loop_joint>; load it by itself"):
        pc.load(folder / "world.sdf")


def test_a_merged_model_is_the_same_as_if_it_were_written_there(folder):
    """Against the same elements in the model itself, moved by hand; axes and frames refer to the merged model."""
    inner = TOOL.replace('"slide" type="prismatic">', '"slide" type="prismatic"><pose>0 0 0 0 0 1.2</pose>')
    inner = inner.replace("<xyz>1", '<xyz expressed_in="__model__">1')
    (folder / "tool.sdf").write_text(inner)
    top = """<sdf version="1.9"><model name="m"><link name="base"/>
      <joint name="ground" type="fixed"><parent>world</parent><child>base</child></joint>
      <joint name="hinge" type="revolute"><parent>base</parent><child>body</child><axis><xyz>0 1 0</xyz></axis></joint>
      {}</model></sdf>"""
    merge = '<include merge="true"><uri>tool.sdf</uri><pose>0.5 0 1 0 0.7 0</pose></include>'
    (folder / "merged.sdf").write_text(top.format(merge))
    parts = inner[inner.index("<link") : inner.index("</model>")]
    parts = parts.replace('<link name="body">', '<link name="body"><pose relative_to="here"/>')
    parts = parts.replace('"jaw"><pose>', '"jaw"><pose relative_to="here">').replace("__model__", "here")
    here = '<frame name="here"><pose>0.5 0 1 0 0.7 0</pose></frame>'
    (folder / "written.sdf").write_text(top.format(here + parts))
    merged, written = (pc.load(folder / f"{name}.sdf") for name in ("merged", "written"))
    assert merged.joints == written.joints == ("hinge", "slide")
    for q in np.random.default_rng(3).uniform(-1, 1, (3, 2)):
        for one, two in zip(matrices(merged, q), matrices(written, q), strict=True):
            np.testing.assert_allclose(one, two, atol=1e-12)
        np.testing.assert_allclose(
            poses(merged, q)["grip"].homogeneous, poses(written, q)["grip"].homogeneous, atol=1e-12
        )
    (folder / "tool.sdf").write_text(inner.replace('version="1.9"', 'version="1.6"'))
    for one, two in zip(matrices(pc.load(folder / "merged.sdf"), q), matrices(written, q), strict=True):
        np.testing.assert_allclose(one, two, atol=1e-12)
