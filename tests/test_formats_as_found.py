"""What public files have that their own programs read: it is read here, or refused with a cure that works."""

from __future__ import annotations

import ast
import logging
import re
import subprocess
import sys

import numpy as np
import pinocchio as pin
import pytest
from helpers.urdf_texts import CHAIN, A, B, joint

import pinconsist as pc

POINT = '<link name="d"><inertial><mass value="2"/></inertial></link>' + joint("l", "c", "d")
MASS = '<inertial pos="0 0 -1" mass="1" diaginertia="1 1 1"/>'
BODY = f'<body name="{{}}"><joint name="{{}}_hinge" axis="0 1 0"/>{MASS}{{}}</body>'


def urdf(folder, text, name="r.urdf"):
    path = folder / name
    path.write_text(f'<robot name="r">{text}</robot>')
    return path


def test_a_mass_without_inertia_is_a_point(tmp_path):
    with pytest.warns(UserWarning, match="link 'd': inertial: <inertia> is missing, and it is a point of 2 kg"):
        model = pc.load(urdf(tmp_path, CHAIN + POINT)).model
    assert model.inertias[model.getJointId("l")].mass == 2.0
    assert not model.inertias[model.getJointId("l")].inertia.any()


def test_what_is_not_joined_to_the_world_floats(tmp_path):
    with pytest.warns(UserWarning, match="the link 'a' is not joined to the link 'world', and floats"):
        mech = pc.load(urdf(tmp_path, '<link name="world"/>' + A + B + joint()))
    assert mech.joints == ("root_joint", "j") and mech.nv == 7


def test_a_reduction_that_is_no_number_is_told(tmp_path):
    motor = """<transmission name="t"><type>SimpleTransmission</type><joint name="j"/>
      <actuator name="m"><mechanicalReduction>reduction</mechanicalReduction></actuator></transmission>"""
    with pytest.warns(UserWarning, match="it exerts no force here: .*mechanicalReduction 'reduction' is no number"):
        assert not pc.load(urdf(tmp_path, CHAIN + motor)).forces


def test_a_part_of_a_xacro_robot_says_what_to_load(tmp_path):
    pytest.importorskip("xacro")
    head = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    macro = f'{head}<xacro:macro name="arm" params="n"><link name="${{n}}"/></xacro:macro></robot>'
    (tmp_path / "arm.xacro").write_text(macro)
    robot = f'{head}<xacro:include filename="arm.xacro"/>{CHAIN}</robot>'
    (tmp_path / "robot.xacro").write_text(robot)
    with pytest.raises(pc.FormatError, match=r"it has only macros \(arm\); load robot.xacro, which includes it"):
        pc.load(tmp_path / "arm.xacro")
    assert pc.load(tmp_path / "robot.xacro").nv == 2
    (tmp_path / "sub").mkdir()
    inner = tmp_path / "sub" / "robot.xacro"
    inner.write_text(robot.replace("arm.xacro", "../arm.xacro").replace("<xacro:include", "<xacro:include", 1))
    assert pc.load(inner, package_dirs=[tmp_path]).nv == 2


@pytest.mark.parametrize("mesh", ["/somewhere/x.stl", "../x.stl", "package:///etc/x.stl"])
def test_a_shape_that_is_elsewhere_is_only_not_shown(tmp_path, caplog, mesh):
    links = ""
    for name in "ab":
        links += (
            f'<link name="{name}"><inertial><mass>1</mass></inertial><visual name="v"><geometry><mesh><uri>{mesh}</uri>'
        )
        links += "</mesh></geometry></visual></link>"
    text = (
        f'<sdf version="1.7"><model name="m">{links}<joint name="j" type="revolute"><parent>a</parent><child>b</child>'
    )
    (tmp_path / "m.sdf").write_text(text + "<axis><xyz>0 0 1</xyz></axis></joint></model></sdf>")
    caplog.set_level(logging.WARNING, "pinconsist")
    assert pc.load(tmp_path / "m.sdf").nv == 1
    assert "left out" in caplog.text and "outside the folder of the scene" in caplog.text


def mjcf(folder, text, name="m.xml"):
    path = folder / name
    path.parent.mkdir(exist_ok=True)
    path.write_text(f"<mujoco>{text}</mujoco>")
    return path


def test_includes_and_meshes_from_folders_that_were_named(tmp_path):
    pytest.importorskip("mujoco")
    home = tmp_path / "a" / "robots" / "arm"  # deep enough that the folder above may be proposed
    home.mkdir(parents=True)
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    (tmp_path / "a" / "robots" / "t.obj").write_text(corners)
    mjcf(home.parent / "scene", '<asset><mesh name="t" file="../t.obj"/></asset>', "s.xml")
    world = '<worldbody><body name="b"><joint name="h"/><geom type="mesh" mesh="t" density="6"/></body></worldbody>'
    path = mjcf(home, f'<include file="../scene/s.xml"/>{world}')
    with pytest.raises(pc.FormatError, match=r"outside the folder of the scene; .*package_dirs=\[.*robots'\]"):
        pc.load(path)
    mass = pc.load(path, package_dirs=[home.parent]).model.inertias[1].mass
    np.testing.assert_allclose(mass, 1.0, rtol=1e-12)  # a sixth of a cube
    path = mjcf(home, f'<asset><mesh name="t" file="../t.obj"/></asset>{world}')
    with pytest.raises(pc.FormatError, match=r"its inertia depends on meshes .*package_dirs=\[.*robots'\]"):
        pc.load(path)


def test_elements_of_mjcf_may_be_left_out(tmp_path):
    pytest.importorskip("mujoco")
    flex = """<flexcomp name="cloth" type="grid" count="3 3 1" spacing="1 1 1" mass="1" radius="0.01"/>"""
    site = '<site name="s{0}"/><site name="t{0}" pos="{0} 0 1"/>'
    bodies = BODY.format("a", "a", BODY.format("b", "b", site.format(1)) + site.format(0))
    rope = """<tendon><spatial name="rope" stiffness="3"><site site="s0"/><site site="t1"/><site site="s1"/></spatial>
      </tendon>      <actuator><motor tendon="rope"/></actuator>"""
    path = mjcf(tmp_path, f"<worldbody>{bodies}{flex}</worldbody>{rope}")
    for cure in ("flexcomp", "rope"):
        with pytest.raises(pc.FormatError, match=rf"ignore=\['{cure}'\] loads the scene without"):
            pc.load(path, ignore=() if cure == "flexcomp" else ["flexcomp"])
    mech = pc.load(path, ignore=["flexcomp", "rope"])
    assert mech.nv == 2 and not mech.forces


def test_an_equality_of_bodies_that_do_not_move_is_told(tmp_path):
    pytest.importorskip("mujoco")
    fixed = "<body name='x'><geom size='1' mass='1'/></body><body name='y'><geom size='1' mass='1'/></body>"
    path = mjcf(
        tmp_path,
        f"<worldbody>{fixed}{BODY.format(*'aa', '')}</worldbody><equality><weld body1='x' body2='y'/></equality>",
    )
    with pytest.warns(UserWarning, match="equality 'weld1': left out, its bodies do not move"):
        assert not pc.load(path).loops


LINK = """<link name="{}"><inertial><mass>{}</mass><inertia><ixx>1</ixx><iyy>1</iyy><izz>1</izz></inertia></inertial>
</link>"""
AXIS = """<joint name="j" type="revolute"><parent>{}</parent><child>b</child><axis><xyz>0 1 0</xyz>
<dynamics><damping>{}</damping></dynamics></axis></joint>"""


def sdf(folder, text, version="1.5", name="m.sdf"):
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f'<sdf version="{version}"><model name="m">{text}</model></sdf>')
    return path


def test_a_link_world_of_an_old_sdf_is_the_ground(tmp_path):
    plain = pc.load(sdf(tmp_path, LINK.format("b", 1) + AXIS.format("world", 0)))
    text = '<link name="world"/>' + LINK.format("b", 1) + AXIS.format("world", 0)
    mech = pc.load(sdf(tmp_path, text))
    assert mech.joints == plain.joints == ("j",)
    assert "1 link 'world', which is the ground" in mech.ignored
    with pytest.raises(pc.FormatError, match="link 'world': the name is reserved"):
        pc.load(sdf(tmp_path, text, "1.7"))


def test_an_empty_number_is_the_default_of_sdf_unless_it_is_needed(tmp_path):
    mech = pc.load(sdf(tmp_path, LINK.format("a", "") + LINK.format("b", 3) + AXIS.format("a", "")))
    assert mech.model.inertias[1].mass == 3.0 and not mech.model.damping.any()
    empty = (LINK.format("a", 1) + LINK.format("b", 1)).replace("<iyy>1", "<iyy>")
    with pytest.raises(pc.FormatError, match="iyy: '' is not a finite number"):
        pc.load(sdf(tmp_path, empty + AXIS.format("a", 1)))


def test_a_prefix_of_an_attribute_need_not_be_declared(tmp_path):
    surface = """<collision name="c"><geometry><sphere><radius>1</radius></sphere></geometry><surface><friction><ode>
    <fdir1 gz:expressed_in="b">1 0 0</fdir1></ode></friction></surface></collision></link>"""
    text = LINK.format("b", 1).replace("</link>", surface) + AXIS.format("world", 1)
    assert pc.load(sdf(tmp_path, text)).nv == 1


def test_a_package_is_found_by_the_name_in_its_package_xml(tmp_path):
    home = tmp_path / "checkout"
    arm = sdf(home / "models", LINK.format("b", 1) + AXIS.format("world", 1), name="arm.sdf")
    (home / "package.xml").write_text("<package><name>robots</name></package>")
    given = "directives:\n- add_model: {name: arm, file: package://robots/models/arm.sdf}\n"
    places = tmp_path / "elsewhere", home / "scenes"
    for place in places:
        place.mkdir()
        (place / "scene.dmd.yaml").write_text(given)
    assert arm.is_file()
    with pytest.raises(pc.FormatError, match="there is no such model beside the file"):
        pc.load(places[0] / "scene.dmd.yaml")
    for place, folders in ((places[1], []), (places[0], [home]), (places[0], [tmp_path])):
        assert pc.load(place / "scene.dmd.yaml", package_dirs=folders).nv == 1


def test_a_xacro_argument_that_is_missing_is_named_without_quotes(tmp_path):
    pytest.importorskip("xacro")
    path = tmp_path / "r.xacro"
    text = CHAIN.replace('"a"', '"${n}_a"')
    head = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:property name="n" value="$(arg '
    for name in ("n", "'n'"):
        path.write_text(f'{head}{name})"/>{text}</robot>')
        with pytest.raises(pc.FormatError, match=r"pass it: args={'n': …}"):
            pc.load(path)
    path.write_text(f'{head}n)"/>{text}</robot>')
    assert pc.load(path, args={"n": "x"}).nv == 2


def test_what_tinyxml_skips_is_skipped(tmp_path):
    pytest.importorskip("mujoco")
    text = f"<worldbody>{BODY.format('a', 'a', '')}</worldbody> <!-\\- not a comment -\\->"
    assert pc.load(mjcf(tmp_path, text)).nv == 1


def test_a_tendon_and_an_equality_of_one_name_are_two(tmp_path):
    pytest.importorskip("mujoco")
    bodies = BODY.format("a", "a", BODY.format("b", "b", ""))
    tendon = """<tendon><fixed name="t" frictionloss="0.1"><joint joint="a_hinge" coef="1"/>
      <joint joint="b_hinge" coef="-1"/></fixed></tendon><equality><tendon name="t" tendon1="t"/></equality>"""
    mech = pc.load(mjcf(tmp_path, f"<worldbody>{bodies}</worldbody>{tendon}"))
    assert [loop.name for loop in mech.loops] == ["t", "t (2)"]
    assert pc.assemble(mech).mobility == 1


def test_a_process_with_a_limit_of_its_own_expands_xacro(tmp_path):
    resource = pytest.importorskip("resource")
    pytest.importorskip("xacro")
    path = tmp_path / "r.xacro"
    path.write_text(f'<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">{CHAIN}</robot>')
    command = "import sys, pinconsist as pc; sys.exit(pc.load(sys.argv[1]).nv != 2)"
    limits = (resource.RLIMIT_CPU, (15, 15))  # less than what the reader allows
    subprocess.run(
        [sys.executable, "-c", command, str(path)], check=True, preexec_fn=lambda: resource.setrlimit(*limits)
    )


BODY_FILE = """format: ChoreonoidBody
angleUnit: degree
links:
  - {{name: base, mass: 1, inertia: [1, 0, 0, 0, 1, 0, 0, 0, 1], jointType: free}}
  - {{name: arm, parent: base, jointType: revolute, jointAxis: Y, {arm}, mass: 1, inertia: [1, 0, 0, 0, 1, 0, 0, 0, 1]}}
  - {{name: belt, parent: base, jointType: {track}, jointAxis: Y, mass: 1, inertia: [1, 0, 0, 0, 1, 0, 0, 0, 1]}}
"""


@pytest.mark.parametrize("track", ["pseudo_continuous_track", "pseudoContinuousTrack", "fixed"])
def test_a_track_of_choreonoid_is_fixed(tmp_path, track):
    """As Link::isFixedJoint says there."""
    path = tmp_path / "r.body"
    path.write_text(BODY_FILE.format(track=track, arm="jointAngle: 30, jointRange: 60, joint_axis_inertia: 0.3"))
    mech = pc.load(path)
    assert mech.joints == ("root_joint", "arm") or mech.nv == 7
    assert any("track" in each for each in mech.ignored) == (track != "fixed")
    q = mech.model.idx_qs[mech.model.getJointId("arm")]
    np.testing.assert_allclose(mech.guess[q], np.pi / 6, rtol=1e-15)
    np.testing.assert_allclose(mech.model.upperPositionLimit[q], np.pi / 3, rtol=1e-15)
    assert mech.model.armature[-1] == 0.3 and mech.model.inertias[1].mass == 2.0


def test_segments_of_openhrp_may_be_in_transforms(tmp_path):
    segment = """DEF S Segment { mass 2 centerOfMass 0.1 0 0 momentsOfInertia [1 0 0 0 2 0 0 0 3] }"""
    turned = (
        "Transform { translation 0 0.5 0 rotation 0 0 1 1.5707963267948966 children [ Group { children [ %s ] } ] }"
    )
    text = """#VRML V2.0 utf8
    DEF R Humanoid { humanoidBody [ DEF BASE Joint { jointType "fixed" children [
      DEF J Joint { jointType "rotate" jointAxis 0 1 0 gearRatio 10 rotorInertia 1 equivalentInertia %s
        children [ %s ] }
    ] } ] }"""
    path = tmp_path / "r.wrl"
    path.write_text(text % ("0.25", turned % segment))
    model = pc.load(path).model
    inertia = model.inertias[1]
    np.testing.assert_allclose(inertia.lever, [0, 0.6, 0], atol=1e-15)
    np.testing.assert_allclose(inertia.inertia, np.diag([2.0, 1.0, 3.0]), atol=1e-15)
    assert model.armature[0] == 0.25
    path.write_text(text % ("0", turned % 'DEF K Joint { jointType "rotate" }'))
    with pytest.raises(pc.FormatError, match="link 'J': it is in a Transform"):
        pc.load(path)


def test_a_spherical_joint_of_a_urdf_is_a_ball(tmp_path):
    """MuJoCo and Bullet read this type; MuJoCo is asked what it is."""
    mujoco = pytest.importorskip("mujoco")
    text = A + B + joint(kind="spherical", inside='<origin xyz="1 0 0" rpy="0.3 0 0"/><axis xyz="1 0 0"/>')
    mech = pc.load(urdf(tmp_path, text))
    theirs = mujoco.MjModel.from_xml_path(str(urdf(tmp_path, text)))
    assert (mech.nv, mech.model.nq) == (theirs.nv, theirs.nq) == (3, 4)
    np.testing.assert_allclose(mech.model.jointPlacements[1].translation, [1, 0, 0])


def test_all_unknown_macros_of_a_xacro_are_named_at_once(tmp_path):
    pytest.importorskip("xacro")
    path = tmp_path / "r.xacro"
    calls = '<xacro:macro name="own" params="n"><link name="${n}"/></xacro:macro><xacro:camera x="1"/><xacro:lidar/>'
    path.write_text(f'<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">{CHAIN}{calls}</robot>')
    with pytest.raises(pc.FormatError, match="unknown macro") as caught:
        pc.load(path)
    cure = ast.literal_eval(re.search(r"ignore=(\[.*?\])", str(caught.value))[1])
    assert cure == ["xacro:camera", "xacro:lidar"]
    assert pc.load(path, ignore=cure).nv == 2


def test_packages_are_found_below_a_folder_that_is_named(tmp_path):
    pytest.importorskip("xacro")
    home = tmp_path / "src" / "robots" / "arms" / "arm_description"
    home.mkdir(parents=True)
    (home / "package.xml").write_text("<package><name>arm</name></package>")
    head = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    (home / "links.xacro").write_text(f"{head}{CHAIN}</robot>")
    (tmp_path / "cell").mkdir()
    path = tmp_path / "cell" / "r.xacro"
    path.write_text(f'{head}<xacro:include filename="$(find arm)/links.xacro"/></robot>')
    with pytest.raises(pc.FormatError, match=r"package_dirs=\[\"…/arm\"\]"):
        pc.load(path)
    assert pc.load(path, package_dirs=[tmp_path / "src"]).nv == 2


def test_models_of_an_old_sdf_may_have_one_name(tmp_path):
    model = f'<model name="m">{LINK.format("b", 1)}{AXIS.format("world", 0)}</model>'
    path = tmp_path / "m.sdf"
    path.write_text(f'<sdf version="1.6"><world name="w">{model}{model}</world></sdf>')
    assert pc.load(path).joints == ("m::j", "m (2)::j")
    path.write_text(f'<sdf version="1.7"><world name="w">{model}{model}</world></sdf>')
    with pytest.raises(pc.FormatError, match="model 'm' has the same name"):
        pc.load(path)


@pytest.mark.parametrize(("version", "flag", "of_model"), [("1.4", "", True), ("1.6", "1", True), ("1.6", "0", False)])
def test_an_old_model_is_merged_with_its_axes(tmp_path, version, flag, of_model):
    """An axis in the frame of its model, or in that of its joint, which is turned."""
    axis = f"<axis><xyz>0 1 0</xyz>{f'<use_parent_model_frame>{flag}</use_parent_model_frame>' if flag else ''}</axis>"
    turned = '<joint name="b" type="revolute"><pose>0 0 0 1.2 0 0</pose><parent>a</parent><child>b</child>'
    links = LINK.format("a", 1) + LINK.format("b", 1).replace("<inertial>", "<pose>1 0 0 0 0 0.5</pose><inertial>")
    (tmp_path / "arm").mkdir()
    sdf(tmp_path / "arm", f"{links}{turned}{axis}</joint>", version, "model.sdf")
    include = '<include merge="true"><uri>arm</uri><pose>0 0 1 0.4 0 0</pose></include>'
    base = f"{LINK.format('base', 1)}<joint name='mount' type='fixed'><parent>base</parent><child>a</child></joint>"
    mech = pc.load(sdf(tmp_path, base + include, "1.9"))
    assert mech.joints == ("b_joint",)
    about_x, about_z = (pin.AngleAxis(*each).toRotationMatrix() for each in ((1.2, np.eye(3)[0]), (0.5, np.eye(3)[2])))
    wanted = np.eye(3)[1] if of_model else about_z @ about_x @ np.eye(3)[1]
    wanted = pin.AngleAxis(0.4, np.eye(3)[0]).toRotationMatrix() @ wanted
    data = mech.model.createData()
    pin.computeJointJacobians(mech.model, data, pin.neutral(mech.model))
    found = pin.getJointJacobian(mech.model, data, 1, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED).reshape(6)[3:]
    np.testing.assert_allclose(found, wanted, atol=1e-12)


def test_all_tendons_that_are_not_supported_are_named_at_once(tmp_path):
    pytest.importorskip("mujoco")
    site = '<site name="s{0}"/><site name="t{0}" pos="{0} 0 1"/>'
    bodies = BODY.format("a", "a", BODY.format("b", "b", site.format(1)) + site.format(0))
    path_of = '<site site="s0"/><site site="t1"/><site site="s1"/></spatial>'
    tendons = f"""<tendon><spatial name="one" stiffness="3">{path_of}<spatial name="two" damping="3">{path_of}
      <spatial name="free">{path_of}<spatial name="three" armature="1">{path_of}</tendon>"""
    path = mjcf(tmp_path, f"<worldbody>{bodies}</worldbody>{tendons}")
    with pytest.raises(pc.FormatError, match=r"ignore=\['one', 'two', 'three'\] loads"):
        pc.load(path)
    assert pc.load(path, ignore=["one", "two", "three"]).nv == 2


def test_a_sensor_of_what_is_not_there_is_no_error(tmp_path):
    pytest.importorskip("mujoco")
    sensor = '<sensor><touch name="s" site="nowhere"/></sensor>'
    assert pc.load(mjcf(tmp_path, f"<worldbody>{BODY.format('a', 'a', '')}</worldbody>{sensor}")).nv == 1


def test_what_follows_the_end_of_a_document_is_skipped(tmp_path):
    path = urdf(tmp_path, CHAIN)
    path.write_bytes(path.read_bytes() + b"\r\n\0")
    assert pc.load(path).nv == 2


@pytest.mark.parametrize("compiler", ["", 'meshdir="d"', 'meshdir="x"/><compiler assetdir="d"'])
@pytest.mark.parametrize("there", [("", "d", "parts"), ("parts",)])
def test_meshes_of_a_file_that_is_included_are_beside_it_if_not_beside_the_scene(tmp_path, compiler, there):
    """Where MuJoCo finds them, which is asked."""
    mujoco = pytest.importorskip("mujoco")
    for size, folder in enumerate(there, start=2):
        (tmp_path / folder / "meshes").mkdir(parents=True)
        corners = f"v 0 0 0\nv {size} 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
        (tmp_path / folder / "meshes" / "t.obj").write_text(corners)
    mjcf(tmp_path / "parts", '<asset><mesh name="t" file="meshes/t.obj"/></asset>', "parts.xml")
    world = '<worldbody><body name="b"><joint name="h"/><geom type="mesh" mesh="t" density="6"/></body></worldbody>'
    path = mjcf(tmp_path, f'<compiler {compiler}/><include file="parts/parts.xml"/>{world}')
    mass = pc.load(path).model.inertias[1].mass
    np.testing.assert_allclose(mass, mujoco.MjModel.from_xml_path(str(path)).body_mass[1], rtol=1e-12)


def test_attributes_need_no_space_between_them(tmp_path):
    path = urdf(tmp_path, CHAIN)
    path.write_text(path.read_text().replace('" type=', '"type='))
    assert pc.load(path).nv == 2
