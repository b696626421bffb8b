"""What SDF files, USD stages and Webots worlds say beyond a tree, and masses of solids."""

import re

import numpy as np
import pinocchio as pin
import pytest
from helpers.warned import told

import pinconsist as pc
from pinconsist.formats import solids
from pinconsist.mechanism.joint_constraints import Coupling

INERTIAL = """<inertial><pose>0.2 0 0 0 0 0</pose><mass>1</mass><inertia><ixx>0.01</ixx><iyy>0.02</iyy><izz>0.02</izz>
</inertia></inertial>"""


def link(name, pose="0 0 0 0 0 0", inside=""):
    return f'<link name="{name}"><pose>{pose}</pose>{INERTIAL}{inside}</link>'


def joint(name, parent, child, kind="revolute", inside="<axis><xyz>0 1 0</xyz></axis>"):
    return f'<joint name="{name}" type="{kind}"><parent>{parent}</parent><child>{child}</child>{inside}</joint>'


OPEN = (
    link("crank", "0 0 0 0 -1.1 0")
    + link("rocker", "0.6 0 0 0 -1.4 0")
    + joint("j1", "world", "crank")
    + joint("j3", "world", "rocker")
)


@pytest.fixture
def sdf(tmp_path):
    def written(text, name="probe.sdf", world=False, folder=""):
        path = tmp_path / folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        inner = text if world else f'<model name="probe">{text}</model>'
        wrapped = f'<world name="w"><gravity>0 0 -9.81</gravity>{inner}</world>' if world else inner
        path.write_text(f'<sdf version="1.9" xmlns:drake="http://drake.mit.edu">{wrapped}</sdf>')
        return path

    return written


def gap(mech, loop):
    model, data = mech.model, mech.model.createData()
    pin.framesForwardKinematics(model, data, mech.guess)
    poses = {frame.name: data.oMf[i] for i, frame in enumerate(model.frames)}
    one, two = (poses[getattr(loop, f"frame{i}")] * getattr(loop, f"placement{i}") for i in (1, 2))
    return np.abs(one.actInv(two).homogeneous - np.eye(4)).max()


# SDF -----------------------------------------------------------------------------------------------------------------


def test_a_detachable_joint_of_a_model(sdf):
    plugin = """<plugin filename="gz-sim-detachable-joint-system" name="gz::sim::systems::DetachableJoint">
    <parent_link>crank</parent_link><child_model>probe</child_model><child_link>rocker</child_link></plugin>"""
    mech = pc.load(sdf(OPEN + plugin))
    (loop,) = mech.loops
    assert (loop.kind, loop.frame1, loop.frame2) == ("frame", "crank", "rocker") and gap(mech, loop) < 1e-12


def test_a_detachable_joint_to_another_model_of_the_file(sdf):
    models = f'<model name="arm">{OPEN}%s</model><model name="box">{link("lid", "1 0 0 0 0.4 0")}</model>'
    plugin = """<plugin filename="x" name="gz::sim::systems::DetachableJoint"><parent_link>crank</parent_link>
    <child_model>box</child_model><child_link>lid</child_link></plugin>"""
    mech = pc.load(sdf(models % plugin, world=True), free_flyer=True)
    (loop,) = mech.loops
    assert (loop.frame1, loop.frame2) == ("arm::crank", "box::lid") and gap(mech, loop) < 1e-12
    missing = pc.load(sdf(models % plugin.replace(">box<", ">cup<").replace(">lid<", ">edge<"), world=True))
    assert missing.loops == () and any("the model 'cup'" in each for each in missing.ignored)


def test_attached_links_of_a_model(sdf):
    """The plugin of gz_attach_links: a weld where the links are, here with a helper link on a hinge of its own."""
    text = OPEN + link("helper", "0.6 0 0 0 -1.4 0") + joint("j4", "crank", "helper")
    plugin = """<plugin filename="libattach-links.so" name="gz::sim::systems::AttachLinks"><parent>helper</parent>
    <child>rocker</child></plugin>"""
    mech = pc.load(sdf(text + plugin))
    (loop,) = mech.loops
    assert (loop.kind, loop.frame1, loop.frame2) == ("frame", "helper", "rocker") and gap(mech, loop) < 1e-12
    assert not mech.ignored
    with pytest.raises(pc.FormatError, match="plugin AttachLinks: parent and child are the same link 'helper'"):
        pc.load(sdf(text + plugin.replace("rocker", "helper")))


def test_empty_limits_are_defaults(sdf):
    """As in libsdformat; exporters write them."""
    limits = "<limit><lower/><upper></upper><effort/></limit>"
    axis = f"<axis><xyz>0 1 0</xyz>{limits}</axis>"
    mech = pc.load(sdf(link("a", inside="<gravity/>") + joint("j", "world", "a", inside=axis)))
    assert np.isinf(mech.model.upperPositionLimit).all() and np.isinf(mech.model.upperEffortLimit).all()


def test_a_missing_axis_is_the_default_of_sdf(sdf, recwarn):
    mech = pc.load(sdf(link("a") + joint("j", "world", "a", inside="")))
    assert "joint 'j': axis: the element is missing, and the axis is z" in told(recwarn)
    data = mech.model.createData()
    pin.computeJointJacobians(mech.model, data, pin.neutral(mech.model))
    column = pin.getJointJacobian(mech.model, data, 1, pin.WORLD).ravel()
    np.testing.assert_allclose(column, [0, 0, 0, 0, 0, 1], atol=1e-12)


@pytest.mark.parametrize("version", ["1.2", "1.3"])
def test_old_versions_are_read_as_1_4(sdf, tmp_path, version):
    """Axes are in the frame of the model, and a joint may be called world."""
    text = link("a", "0 0 1 0.7 0 0") + joint("world", "world", "a")
    path = sdf(text, world=False)
    mechs = []
    for each in (version, "1.4"):
        path.write_text(re.sub('version="1.."', f'version="{each}"', path.read_text()))
        mechs.append(pc.load(path))
    assert mechs[0].joints == ("world_joint",)
    (one, two) = (mech.model.jointPlacements[1] for mech in mechs)
    np.testing.assert_allclose(one.homogeneous, two.homogeneous, atol=1e-15)
    with pytest.raises(pc.FormatError, match="joint 'world': the name is reserved"):
        pc.load(sdf(text))


def test_constraints_of_drake_in_a_model(sdf):
    ends = """<drake:ball_constraint_body_A>crank</drake:ball_constraint_body_A>
    <drake:ball_constraint_p_AP>0.5 0 0</drake:ball_constraint_p_AP>
    <drake:ball_constraint_body_B>rocker</drake:ball_constraint_body_B>
    <drake:ball_constraint_p_BQ>0.4 0 0.1</drake:ball_constraint_p_BQ>"""
    mech = pc.load(sdf(OPEN + f"<drake:ball_constraint>{ends}</drake:ball_constraint>"))
    (loop,) = mech.loops
    assert (loop.kind, loop.frame1, loop.xyz1, loop.xyz2) == ("point", "crank", (0.5, 0.0, 0.0), (0.4, 0.0, 0.1))
    mimic = '<drake:mimic joint="j1" multiplier="-2" offset="0.1"/>'
    text = OPEN.replace("</axis></joint>", f"</axis>{mimic}</joint>", 2).replace(mimic, "", 1)
    assert pc.load(sdf(text)).loops == (Coupling("j3 mimic", "j3", "j1", -2.0, 0.1),)


@pytest.mark.parametrize(("kind", "nv"), [("planar", 3), ("ball", 3), ("universal", 2), ("screw", 1)])
def test_joints_of_drake_in_a_model(sdf, kind, nv):
    text = f"""{link("puck", "0 0 1 0 0 0")}<drake:joint name="own" type="{kind}"><drake:parent>world</drake:parent>
    <drake:child>puck</drake:child></drake:joint>"""
    assert pc.load(sdf(OPEN + text)).nv == 2 + nv


def test_gravity_acts_on_some_links_only(sdf):
    """Of two equal pendulums, the one without gravity stays; the other one does not."""
    off = OPEN.replace(link("rocker", "0.6 0 0 0 -1.4 0"), link("rocker", "0.6 0 0 0 -1.4 0", "<gravity>0</gravity>"))
    mech = pc.load(sdf(off))
    sol = pc.simulate(mech, (0.0, 0.3), rtol=1e-9, atol=1e-11)
    assert np.abs(sol.q[:, 1]).max() < 1e-10 and abs(sol.q[-1, 0]) > 0.1
    assert mech.model.gravity.linear[2] < -9.0


def test_a_model_is_included_with_its_name_and_pose(sdf, tmp_path):
    sdf(OPEN, "model.sdf", folder="models/arm")
    (tmp_path / "models" / "arm" / "model.config").write_text("<model><sdf version='1.9'>model.sdf</sdf></model>")
    text = """<include><uri>model://arm</uri><name>left</name><pose>0 1 0 0 0 0</pose></include>
    <include><uri>model://arm</uri><name>right</name></include><include><uri>model://ground_plane</uri></include>
    <include><uri>model://sun</uri></include>"""
    mech = pc.load(sdf(text, "two.world", world=True, folder="worlds"), package_dirs=[tmp_path / "models"])
    assert set(mech.joints) == {f"{side}::j{i}" for side in ("left", "right") for i in (1, 3)}
    data = mech.model.createData()
    pin.framesForwardKinematics(mech.model, data, pin.neutral(mech.model))
    np.testing.assert_allclose(data.oMf[mech.model.getFrameId("left::rocker")].translation, [0.6, 1.0, 0.0], atol=1e-12)
    assert "1 floor" in mech.ignored
    sdf(text, "two.world", world=True)  # models/ beside the file
    assert pc.load(tmp_path / "two.world").joints == mech.joints


def test_an_included_model_keeps_the_meaning_of_its_version(sdf, tmp_path):
    """Before 1.5 axes are in the frame of the model, and later in that of the joint."""
    turned = joint("j", "a", "b", inside="<pose>0 0 0 1.570796326794897 0 0</pose><axis><xyz>0 1 0</xyz></axis>")
    path = sdf(f"{link('a')}{link('b')}{turned}{joint('f', 'world', 'a', 'fixed', '')}", "model.sdf", folder="old")
    text = '<include><uri>model://old</uri></include><model name="other"><link name="x"/></model>'
    found = []
    for version in ("1.4", "1.9"):
        path.write_text(re.sub('version="1.."', f'version="{version}"', path.read_text()))
        mech = pc.load(sdf(text, "w.world", world=True))
        data = mech.model.createData()
        pin.computeJointJacobians(mech.model, data, pin.neutral(mech.model))
        found.append(np.ravel(pin.getJointJacobian(mech.model, data, 1, pin.LOCAL_WORLD_ALIGNED))[3:])
    np.testing.assert_allclose(found, [[0, 1, 0], [0, 0, 1]], atol=1e-9)


def test_a_model_that_includes_itself_is_refused(sdf):
    sdf("<include><uri>model://loop</uri></include>" + link("a"), "model.sdf", folder="loop")
    with pytest.raises(pc.FormatError, match="nested more than 20 deep"):
        pc.load(sdf("<include><uri>model://loop</uri></include>", "w.world", world=True))


def test_an_include_is_left_out_when_this_is_asked(sdf):
    text = OPEN + "<include><uri>https://fuel.gazebosim.org/1.0/x/models/chair</uri></include>"
    with pytest.raises(pc.FormatError, match="nothing is downloaded"):
        pc.load(sdf(text))
    mech = pc.load(sdf(text), ignore=["chair"])
    assert "1 include of 'chair' (left out)" in mech.ignored


def test_inertias_are_computed_from_shapes(sdf, tmp_path):
    """auto="true": a box and a sphere on a stick, by the formulas."""
    shapes = """<collision name="a"><density>500</density><geometry><box><size>0.1 0.2 0.3</size></box></geometry>
    </collision><collision name="b"><pose>0 0 1 0 0 0</pose><geometry><sphere><radius>0.1</radius></sphere></geometry>
    </collision>"""
    arm = f'<link name="arm">{shapes}<inertial auto="true"/></link>' + joint("j", "world", "arm")
    mech = pc.load(sdf(arm))
    box, ball = 500 * 0.1 * 0.2 * 0.3, 1000 * 4 / 3 * np.pi * 0.1**3
    assert mech.model.inertias[1].mass == pytest.approx(box + ball)
    assert mech.model.inertias[1].lever[2] == pytest.approx(ball / (box + ball))
    about_y = box / 12 * (0.1**2 + 0.3**2) + ball * (0.4 * 0.1**2 + 1.0)
    whole = mech.model.inertias[1]
    assert whole.inertia[1, 1] + whole.mass * whole.lever[2] ** 2 == pytest.approx(about_y)


# Solids --------------------------------------------------------------------------------------------------------------


def meshed(surface, n=60):
    """Points and triangles of a surface (u, v) → (x, y, z) over two angles."""
    u, v = np.linspace(0, 2 * np.pi, n + 1), np.linspace(0, np.pi, n + 1)
    points = np.array([surface(a, b) for a in u for b in v])
    index = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    one = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:]], axis=-1).reshape(-1, 3)
    two = np.stack([index[:-1, :-1], index[1:, 1:], index[:-1, 1:]], axis=-1).reshape(-1, 3)
    return points, np.concatenate([one, two])


def sphere(u, v):
    return np.sin(v) * np.cos(u), np.sin(v) * np.sin(u), np.cos(v)


def same(one, two, rtol=1e-12):
    np.testing.assert_allclose(one.toDynamicParameters(), two.toDynamicParameters(), rtol=rtol, atol=rtol * one.mass)


def test_the_solid_of_a_mesh_tends_to_that_of_its_surface():
    errors = []
    for n in (30, 60):
        found = solids.mesh(*meshed(sphere, n))
        errors.append(abs(found.mass / solids.ellipsoid(1, 1, 1).mass - 1))
    assert 3.8 < errors[0] / errors[1] < 4.2 and errors[1] < 1e-2


def test_a_mesh_of_a_box_is_that_box_wherever_it_is():
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 2) for z in (0, 3)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [triangle for a, b, c, d in quads for triangle in ((a, b, c), (a, c, d))]
    moved = pin.SE3(np.eye(3), np.array([0.5, 1.0, 1.5])).act(solids.box(1, 2, 3))
    same(solids.mesh(corners, triangles), moved)
    same(solids.mesh(corners, [triangle[::-1] for triangle in triangles]), moved)


def test_solids_of_one_another():
    """A capsule is a cylinder and a sphere when it is short, an ellipsoid a stretched sphere."""
    stretch = np.diag([2.0, 3.0, 4.0, 1.0])
    same(solids.moved(solids.ellipsoid(1, 1, 1), stretch), solids.ellipsoid(2, 3, 4))
    same(solids.capsule(0.3, 1e-12), solids.ellipsoid(0.3, 0.3, 0.3), 1e-9)
    cone = solids.cone(0.3, 0.8)
    assert cone.mass == pytest.approx(solids.cylinder(0.3, 0.8).mass / 3) and cone.lever[2] == pytest.approx(-0.2)
    long, radius = 50.0, 0.01
    across = solids.capsule(radius, long).inertia[0, 0]
    assert across == pytest.approx(np.pi * radius**2 * long**3 / 12, rel=2e-3)


# USD -----------------------------------------------------------------------------------------------------------------

needs_usd = pytest.mark.skipif(
    __import__("importlib.util").util.find_spec("pxr") is None, reason="the package usd-core is not installed"
)
MASS = """float physics:mass = 2
        point3f physics:centerOfMass = (0.2, 0, 0)
        float3 physics:diagonalInertia = (0.01, 0.02, 0.03)
"""


def prim(name, translate=(0, 0, 0), turn=(0, 0, 0), inside=MASS, kind="Xform", more=""):
    return f"""def {kind} "{name}" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"{more}]) {{
        double3 xformOp:translate = {translate}
        double3 xformOp:rotateXYZ = {turn}
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ"]
        {inside}
    }}
"""


def usd_joint(name, kind, body0="", body1="", inside="", apis=""):
    ends = "".join(f"rel physics:body{i} = </{body}>\n" for i, body in enumerate((body0, body1)) if body)
    apis = f"(prepend apiSchemas = [{apis}])" if apis else ""
    return f'def Physics{kind} "{name}" {apis} {{\n{ends}{inside}\n}}\n'


@pytest.fixture
def usd(tmp_path):
    def written(text, units='metersPerUnit = 1\n upAxis = "Z"', name="probe.usda"):
        path = tmp_path / name
        path.write_text(f"#usda 1.0\n(\n {units}\n)\n{text}")
        return path

    return written


Y = 'uniform token physics:axis = "Y"\n'


def in_both(usd, inside, apis, kind="RevoluteJoint", scene=""):
    """The mechanism of two hinges, the second of which has the attributes."""
    text = prim("a") + prim("b", (1, 0, 0)) + scene + usd_joint("first", "RevoluteJoint", "", "a", Y)
    place = Y + "point3f physics:localPos0 = (1, 0, 0)\n"
    return pc.load(usd(text + usd_joint("second", kind, "a", "b", place + inside, apis)))


@needs_usd
@pytest.mark.parametrize("angle", ["degree", "radian"])
def test_what_acts_in_joints_of_mujocos_usd(usd, angle):
    """The spring is unloaded at springref - ref, as in MuJoCo; angles are in the unit of the scene."""
    scene = f'def PhysicsScene "s" {{\nuniform token mjc:compiler:angle = "{angle}"\n}}\n'
    values = {"stiffness": 3, "springref": 0.5, "ref": 0.2, "armature": 0.1, "damping": 0.7, "frictionloss": 0.05}
    inside = "".join(f"uniform double mjc:{key} = {value}\n" for key, value in values.items())
    mech = in_both(usd, inside, '"MjcJointAPI"', scene=scene)
    (spring,) = mech.forces
    assert (spring.joint, spring.stiffness) == ("second", 3.0)
    np.testing.assert_allclose(spring.rest, 0.3 * (np.pi / 180 if angle == "degree" else 1.0), rtol=1e-12)
    found = [each[1] for each in (mech.model.armature, mech.model.damping, mech.model.upperDryFrictionLimit)]
    np.testing.assert_allclose(found, [0.1, 0.7, 0.05])


@needs_usd
@pytest.mark.parametrize("kind", ["RevoluteJoint", "SphericalJoint", "Joint"])
def test_what_acts_in_joints_of_newtons_usd(usd, kind):
    """Per degree where it damps a turn, and on all velocities of a joint."""
    values = {"armature": 0.1, "damping": 0.7, "friction": 0.05}
    inside = "".join(f"uniform float newton:{key} = {value}\n" for key, value in values.items())
    mech = in_both(usd, inside, '"NewtonJointAPI"', kind)
    free = {"RevoluteJoint": 1, "SphericalJoint": 3, "Joint": 6}[kind]
    assert mech.nv == 1 + free
    slides = 3 if kind == "Joint" else 0
    per_rad = [0.7] * slides + [0.7 * 180 / np.pi] * (free - slides)
    np.testing.assert_allclose(mech.model.damping[1:], per_rad, rtol=1e-12)
    np.testing.assert_allclose(mech.model.armature[1:], 0.1)
    np.testing.assert_allclose(mech.model.upperDryFrictionLimit[1:], 0.05)


@needs_usd
def test_joints_of_mujoco_on_one_body_follow_each_other(usd):
    """A slide, and then a hinge beside it, as MuJoCo has them; without its schema both hold the body."""
    mujoco = pytest.importorskip("mujoco")
    at = "point3f physics:localPos{} = ({}, 0, 0)\n"
    slide = 'uniform token physics:axis = "Z"\n' + at.format(0, 1)
    hinge = Y + at.format(0, 1.5) + at.format(1, 0.5)
    text, joints = prim("a", (1, 0, 0)), (("s", "PrismaticJoint", slide), ("h", "RevoluteJoint", hinge))
    written = [
        pc.load(usd(text + "".join(usd_joint(n, kind, "", "a", inside, apis) for n, kind, inside in joints)))
        for apis in ('"MjcJointAPI"', "")
    ]
    assert [pc.assemble(mech).mobility for mech in written] == [2, 0]
    model = mujoco.MjModel.from_xml_string("""<mujoco><worldbody><body pos="1 0 0">
      <joint type="slide" axis="0 0 1"/><joint pos="0.5 0 0" axis="0 1 0"/>
      <inertial pos="0.2 0 0" mass="2" diaginertia="0.01 0.02 0.03"/></body></worldbody></mujoco>""")
    data = mujoco.MjData(model)
    data.qpos, data.qvel = q, v = np.array([0.3, 0.7]), np.array([-0.4, 1.1])
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(pc.forward_dynamics(written[0], q, v).a, data.qacc, rtol=1e-9)


@needs_usd
def test_the_offset_of_newtons_mimic_is_in_degrees(usd):
    values = "float newton:mimicCoef0 = 30\nfloat newton:mimicCoef1 = -2\nrel newton:mimicJoint = </first>\n"
    (coupling,) = in_both(usd, values, '"NewtonMimicAPI"').loops
    assert (coupling.joint, coupling.other, coupling.ratio) == ("second", "first", -2.0)
    np.testing.assert_allclose(coupling.offset, np.pi / 6, rtol=1e-12)
    powers = values + "double mjc:coef2 = 0.5\n"
    (coupling,) = in_both(usd, powers, '"MjcEqualityJointAPI", "NewtonMimicAPI"').loops
    assert coupling.higher == (0.5, 0.0, 0.0)
    off = in_both(usd, values + "bool newton:mimicEnabled = false", '"NewtonMimicAPI"')
    assert not off.loops and "1 disabled mimic" in off.ignored


@needs_usd
def test_the_bodies_and_joints_of_a_stage(usd):
    """In centimetres and grams, with an angle in degrees; the second joint is at 30° in the file."""
    units = 'metersPerUnit = 0.01\n kilogramsPerUnit = 0.001\n upAxis = "Y"'
    text = prim("crank") + prim("coupler", (20, 0, 0), (0, 0, 30))
    limits = "float physics:lowerLimit = -90\nfloat physics:upperLimit = 45"
    text += usd_joint("j1", "RevoluteJoint", "", "crank", limits)
    place = "point3f physics:localPos0 = (20, 0, 0)\n" + 'uniform token physics:axis = "Z"'
    text += usd_joint("j2", "RevoluteJoint", "crank", "coupler", place)
    mech = pc.load(usd(text, units))
    model = mech.model
    assert mech.joints == ("j1", "j2") and "limits of 1 joint (watched, not enforced)" in mech.ignored
    np.testing.assert_allclose(mech.guess, [0.0, np.pi / 6], atol=1e-12)
    np.testing.assert_allclose(model.gravity.linear, [0, -9.81, 0])
    np.testing.assert_allclose([model.lowerPositionLimit[0], model.upperPositionLimit[0]], [-np.pi / 2, np.pi / 4])
    assert model.inertias[1].mass == pytest.approx(0.002) and model.inertias[1].lever[0] == pytest.approx(0.002)
    np.testing.assert_allclose(np.diag(model.inertias[1].inertia), np.array([0.01, 0.02, 0.03]) * 1e-7)
    data = model.createData()
    pin.framesForwardKinematics(model, data, mech.guess)
    np.testing.assert_allclose(data.oMf[model.getFrameId("coupler")].translation, [0.2, 0, 0], atol=1e-12)


LOCKED = "float limit:{0}:physics:low = 1\nfloat limit:{0}:physics:high = -1\n"


def generic(free):
    """A D6 joint with these free directions."""
    locked = [each for each in ("transX", "transY", "transZ", "rotX", "rotY", "rotZ") if each not in free]
    apis = ", ".join(f'"PhysicsLimitAPI:{each}"' for each in locked)
    return apis, "".join(LOCKED.format(each) for each in locked)


D6 = {
    "hinge": ("rotX",),
    "slider": ("transX",),
    "cylinder": ("transZ", "rotZ"),
    "universal": ("rotX", "rotY"),
    "point": ("rotX", "rotY", "rotZ"),
    "plane": ("transX", "transY", "rotZ"),
    "frame": (),
}


@needs_usd
@pytest.mark.parametrize("kind", D6)
def test_generic_joints_in_the_tree_and_as_loops_allow_the_same_motion(usd, kind):
    apis, limits = generic(D6[kind])
    place = "point3f physics:localPos0 = (0.1, 0.2, 0.3)\npoint3f physics:localPos1 = (0.1, 0.2, 0.3)\n"
    once = prim("a") + prim("b") + usd_joint("j", "RevoluteJoint", "", "a", Y)
    tree = pc.load(usd(once + usd_joint("g", "Joint", "a", "b", place + limits, apis)))
    assert tree.nv == 1 + len(D6[kind]) and tree.loops == ()
    free = usd_joint("f", "Joint", "a", "b")  # a body on six directions, which the loop then locks
    cut = usd_joint("g", "Joint", "a", "b", place + limits + "bool physics:excludeFromArticulation = 1\n", apis)
    loop = pc.load(usd(once + free + cut))
    (closed,) = loop.loops
    assert closed.kind == kind and loop.nv == 7
    assert pc.assemble(loop).mobility == tree.nv


@needs_usd
def test_a_universal_is_that_of_the_tree(usd):
    """A loop of a universal holds its body where the tree's universal has it, turned about both axes."""
    apis, limits = generic(("rotX", "rotY"))
    once = prim("a") + prim("b") + usd_joint("j", "RevoluteJoint", "", "a", Y)
    tree = pc.load(usd(once + usd_joint("g", "Joint", "a", "b", limits, apis)))
    q = tree.configuration({"g_rotY": 0.5, "g_rotX": -0.7})
    data = tree.model.createData()
    pin.framesForwardKinematics(tree.model, data, q)
    pose = data.oMf[tree.model.getFrameId("b")]
    cut = usd_joint("g", "Joint", "a", "b", limits + "bool physics:excludeFromArticulation = 1\n", apis)
    loop = pc.load(usd(once + usd_joint("f", "Joint", "a", "b") + cut))
    q = loop.guess.copy()
    turn = pin.Quaternion(pose.rotation).coeffs()
    q[loop.model.idx_qs[loop.model.getJointId("f_rot")] :][:4] = turn
    from pinconsist.mechanism.rows import LoopRows

    gaps, _ = LoopRows(loop.model, loop.loops).at(q)
    assert np.abs(gaps).max() < 1e-12


@needs_usd
def test_a_free_stage_floats_and_a_fixed_one_does_not(usd):
    text = prim("a", (0, 0, 1), (0, 0, 40)) + prim("b") + usd_joint("j", "RevoluteJoint", "a", "b", Y)
    mech = pc.load(usd(text))
    assert mech.joints[0] == "root_joint" and mech.nv == 7
    np.testing.assert_allclose(mech.guess[:3], [0, 0, 1])
    fixed = pc.load(usd(text + usd_joint("f", "FixedJoint", "", "a", "point3f physics:localPos0 = (0, 0, 1)")))
    assert fixed.joints == ("j",)
    kinematic = prim("a", inside=MASS + "bool physics:kinematicEnabled = 1")
    held = pc.load(usd(kinematic + prim("b") + usd_joint("j", "RevoluteJoint", "a", "b", Y)))
    assert held.joints == ("j",)
    with pytest.raises(pc.InputError, match="free_flyer= is not for USD files"):
        pc.load(usd(text), free_flyer=True)


@needs_usd
def test_drives_are_actuators_in_radians(usd):
    drive = """float drive:angular:physics:stiffness = 2
    float drive:angular:physics:damping = 0.5
    float drive:angular:physics:targetPosition = 90
    float drive:angular:physics:targetVelocity = 10
    float drive:angular:physics:maxForce = 7
    float physxJoint:armature = 0.25
"""
    text = prim("a") + usd_joint("j", "RevoluteJoint", "", "a", Y + drive, '"PhysicsDriveAPI:angular"')
    mech = pc.load(usd(text))
    (motor,) = mech.forces
    k, d = 2 * 180 / np.pi, 0.5 * 180 / np.pi
    assert motor.gain[0] == pytest.approx(k) and motor.control == pytest.approx(np.pi / 2)
    np.testing.assert_allclose(motor.bias, [d * np.radians(10), -k, -d])
    assert motor.force_range == (-7.0, 7.0) and mech.model.armature[0] == 0.25 and mech.actuated == ("j",)


@needs_usd
def test_mimic_joints_and_gears(usd):
    mimic = """rel physxMimicJoint:rotY:referenceJoint = </j1>
    float physxMimicJoint:rotY:gearing = 2
    float physxMimicJoint:rotY:offset = 10
"""
    bodies = prim("a") + prim("b") + usd_joint("j1", "RevoluteJoint", "", "a", Y)
    text = bodies + usd_joint("j2", "RevoluteJoint", "", "b", Y + mimic, '"PhysxMimicJointAPI:rotY"')
    assert pc.load(usd(text)).loops == (Coupling("j2 mimic", "j2", "j1", -2.0, -np.radians(10)),)
    gear = 'def PhysxPhysicsGearJoint "g" {\n rel physics:hinge0 = </j1>\n rel physics:hinge1 = </j2>\n'
    gear += " float physics:gearRatio = 3\n}\n"
    assert pc.load(usd(bodies + usd_joint("j2", "RevoluteJoint", "", "b", Y) + gear)).loops == (
        Coupling("g", "j2", "j1", -3.0),
    )


@needs_usd
def test_masses_of_collision_shapes_with_scales(usd):
    """A scaled cube, of the density of the body; what a mass says of it is kept."""
    cube = 'def Cube "c" (prepend apiSchemas = ["PhysicsCollisionAPI"]) {\n double size = 2\n'
    cube += ' double3 xformOp:scale = (1, 2, 3)\n uniform token[] xformOpOrder = ["xformOp:scale"]\n}\n'
    text = prim("a", inside="float physics:density = 10\n" + cube) + usd_joint("j", "RevoluteJoint", "", "a", Y)
    mech = pc.load(usd(text))
    expected = solids.scaled(solids.box(2, 4, 6), 10)
    same(mech.model.inertias[1], expected)
    mech = pc.load(usd(text.replace("physics:density = 10", "physics:mass = 5")))
    same(mech.model.inertias[1], solids.scaled(expected, 5 / expected.mass))
    water = pc.load(usd(text.replace("float physics:density = 10", "")))
    assert water.model.inertias[1].mass == pytest.approx(48 * 1000)


@needs_usd
def test_layers_are_composed_from_the_folder_only(usd, tmp_path):
    (tmp_path / "scene").mkdir()
    usd(prim("arm"), 'metersPerUnit = 1\n upAxis = "Z"\n defaultPrim = "arm"', "part.usda")
    inside = usd(prim("arm"), 'metersPerUnit = 1\n upAxis = "Z"\n defaultPrim = "arm"', "scene/part.usda")
    assert inside.is_file()
    for place, works in (("./part.usda", True), ("../part.usda", False), (f"{tmp_path}/part.usda", False)):
        text = f'def "a" (prepend references = @{place}@) {{\n}}\n' + usd_joint("j", "RevoluteJoint", "", "a", Y)
        path = usd(text, name="scene/main.usda")
        if works:
            assert pc.load(path).joints == ("j",)
            continue
        with pytest.raises(pc.FormatError, match=r"outside the folder of the scene.*package_dirs="):
            pc.load(path)
        assert pc.load(path, package_dirs=[tmp_path]).joints == ("j",)
    for place, said in (("http://x.org/a.usd", "nothing is downloaded"), ("./none.usda", "there is no such file")):
        with pytest.raises(pc.FormatError, match=said):
            pc.load(usd(f'def "a" (prepend references = @{place}@) {{\n}}\n', name="scene/main.usda"))


BAD_USD = {
    "no stage": ("def Xform {", "usd-core cannot read it"),
    "no body": ('def Xform "a" {\n}\n', "no rigid body"),
    "to itself": (prim("a") + usd_joint("j", "RevoluteJoint", "a", "a", Y), "connects the body 'a' to itself"),
    "to nothing": (prim("a") + usd_joint("j", "RevoluteJoint", "b", "a", Y), "body0 is /b, which does not exist"),
    "rack": (prim("a") + 'def PhysxPhysicsRackAndPinionJoint "r" {\n}\n', "type PhysxPhysicsRackAndPinionJoint"),
    "quaternion": (
        prim("a") + usd_joint("j", "RevoluteJoint", "", "a", "quatf physics:localRot0 = (0, 0, 0, 0)"),
        "a quaternion is zero",
    ),
}


@needs_usd
@pytest.mark.parametrize(("text", "told"), BAD_USD.values(), ids=BAD_USD)
def test_bad_stages_are_named(usd, text, told):
    path = usd(text)
    with pytest.raises(pc.FormatError, match=told) as caught:
        pc.load(path)
    assert caught.value.path == str(path)


# Webots --------------------------------------------------------------------------------------------------------------

PHYSICS = """physics Physics { density -1 mass 2 centerOfMass [ 0.2 0 0 ]
  inertiaMatrix [ 0.01 0.02 0.03 0.001 0.002 0.003 ] }"""


def solid(name, translation="0 0 0", rotation="0 0 1 0", inside="", physics=PHYSICS):
    place = f"translation {translation} rotation {rotation}"
    return f'Solid {{ {place} name "{name}" children [ {inside} ] {physics} }}'


def hinge(end, parameters="", device="", kind="HingeJoint"):
    return f"{kind} {{ jointParameters {kind}Parameters {{ {parameters} }} device [ {device} ] endPoint {end} }}"


@pytest.fixture
def webots(tmp_path):
    def written(text, head="#VRML_SIM R2023b utf8", info="WorldInfo { gravity 9.81 }"):
        path = tmp_path / "probe.wbt"
        path.write_text(f"{head}\n{info}\n{text}\n")
        return path

    return written


def test_a_hinge_of_webots_stands_at_its_position(webots):
    """The child is in the parent where the joint is at `position`; the anchor is in the parent."""
    end = solid("arm", "0.1 0 0.3", "0 1 0 0.4")
    motor = 'RotationalMotor { name "m" maxTorque 5 } PositionSensor { name "s" }'
    parameters = "axis 0 2 0 anchor 0.1 0 0.2 position 0.5 minStop -1 maxStop 2 springConstant 7 dampingConstant 0.3"
    mech = pc.load(webots(f'Robot {{ children [ {hinge(end, parameters, motor)} ] name "r" }}'))
    assert mech.joints == ("m",) and mech.guess[0] == 0.5 and mech.actuated == ("m",)
    assert mech.model.damping[0] == 0.3 and mech.forces[0] == pc.JointSpring("m", 7.0)
    assert mech.forces[1].force_range == (-5.0, 5.0)
    model, data = mech.model, mech.model.createData()
    pin.framesForwardKinematics(model, data, mech.guess)
    pose = data.oMf[model.getFrameId("arm")].copy()
    np.testing.assert_allclose(pose.translation, [0.1, 0.0, 0.3], atol=1e-12)
    np.testing.assert_allclose(pose.rotation, pin.rpy.rpyToMatrix(0, 0.4, 0), atol=1e-12)
    pin.framesForwardKinematics(model, data, mech.guess + 0.1)
    moved = data.oMf[model.getFrameId("arm")]
    about = np.array([0.1, 0.0, 0.2])
    np.testing.assert_allclose(
        moved.translation - about, pin.rpy.rpyToMatrix(0, 0.1, 0) @ (pose.translation - about), atol=1e-12
    )
    moments = np.array([[0.01, 0.001, 0.002], [0.001, 0.02, 0.003], [0.002, 0.003, 0.03]])
    frame = model.frames[model.getFrameId("arm")]
    same(frame.placement.actInv(model.inertias[frame.parentJoint]), pin.Inertia(2.0, np.array([0.2, 0, 0]), moments))


def test_a_solid_reference_closes_a_loop(webots):
    tip = hinge('SolidReference { solidName "rocker" }', "axis 0 1 0 anchor 0.4 0 0")
    coupler = solid("coupler", "0.3 0 0", "0 1 0 0.6", tip)
    crank = solid("crank", "0 0 0", "0 1 0 -1", hinge(coupler, "axis 0 1 0 anchor 0.3 0 0"))
    text = f"""Robot {{ children [ {hinge(crank, "axis 0 1 0")}
      {hinge(solid("rocker", "0.6 0 0", "0 1 0 -1.3"), "axis 0 1 0 anchor 0.6 0 0")} ] name "r" }}"""
    mech = pc.load(webots(text))
    (loop,) = mech.loops
    assert (loop.kind, loop.frame1, loop.frame2, mech.nv) == ("hinge", "coupler", "rocker", 3)
    assert loop.xyz1 == pytest.approx((0.4, 0, 0)) and gap(mech, loop) < 1e-12
    ball = hinge('SolidReference { solidName "<static environment>" }', "anchor 0.1 0 0", kind="BallJoint")
    (loop,) = pc.load(webots(f"Robot {{ children [ {hinge(solid('a', inside=ball))} ] }}")).loops
    assert (loop.kind, loop.frame2) == ("point", "universe")


def test_a_robot_with_physics_floats_and_solids_without_joints_are_one_body(webots):
    inner = solid("tool", "0 0 1")
    text = f'Robot {{ translation 1 2 3 children [ {inner} {hinge(solid("arm"))} ] name "r" {PHYSICS} }}'
    mech = pc.load(webots(text))
    assert mech.nv == 7 and mech.model.inertias[1].mass == pytest.approx(4.0)
    np.testing.assert_allclose(mech.guess[:3], [1, 2, 3])
    np.testing.assert_allclose(mech.model.gravity.linear, [0, 0, -9.81])
    old = pc.load(webots(text, "#VRML_SIM R2021a utf8", "WorldInfo { gravity 3 }"))
    np.testing.assert_allclose(old.model.gravity.linear, [0, -3, 0])


def test_hinge2_and_slider_at_their_positions(webots):
    text = f"""Hinge2Joint {{ jointParameters HingeJointParameters {{ axis 1 0 0 position 0.3 }}
      jointParameters2 JointParameters {{ axis 0 0 1 position -0.2 }}
      endPoint {solid("a", "0 0 0.4", "0 1 0 0.7")} }}"""
    mech = pc.load(webots(f"Robot {{ children [ {text} ] }}"))
    np.testing.assert_allclose(sorted(mech.guess), [-0.2, 0.3])
    data = mech.model.createData()
    pin.framesForwardKinematics(mech.model, data, mech.guess)
    pose = data.oMf[mech.model.getFrameId("a")]
    np.testing.assert_allclose(pose.translation, [0, 0, 0.4], atol=1e-12)
    slider = hinge(solid("b", "0 0 0.4"), "axis 0 0 2 position 0.1", kind="SliderJoint")
    mech = pc.load(webots(f"Robot {{ children [ {slider} ] }}"))
    pin.framesForwardKinematics(mech.model, data := mech.model.createData(), np.zeros(1))
    np.testing.assert_allclose(data.oMf[mech.model.getFrameId("b")].translation, [0, 0, 0.3], atol=1e-12)


def test_masses_of_bounding_objects(webots):
    bounds = "boundingObject Pose { translation 0 0 1 children [ Box { size 0.1 0.2 0.3 } ] }"
    bounds += " physics Physics { density 500 }"
    mech = pc.load(webots(f"Robot {{ children [ {hinge(solid('a', physics=bounds))} ] }}"))
    expected = pin.SE3(np.eye(3), np.array([0, 0, 1.0])).act(solids.scaled(solids.box(0.1, 0.2, 0.3), 500))
    same(mech.model.inertias[1], expected)


def test_used_nodes_and_unknown_protos(webots):
    text = f"DEF A {solid('a', '0 0 1')} Robot {{ children [ {hinge('USE A')} ] }} Floor {{ size 1 1 }} Table {{ }}"
    mech = pc.load(webots(text))
    assert {"1 PROTO Floor", "1 PROTO Table"} <= set(mech.ignored)


A, TO_B = "a", hinge('SolidReference { solidName "b" }')
BAD_WEBOTS = {
    "head": ("", "the first line of a Webots world"),
    "no body": ("Shape { }", "no Solid with Physics"),
    "end": ("Robot { children [ ", "the file ends within a node"),
    "reference": (f"Robot {{ children [ {hinge(solid(A, inside=TO_B))} ] }}",
                  "there is no Solid 'b'"),
    "numbers": (f'Robot {{ children [ {hinge(solid("a", "0 0"))} ] }}', "translation: .* is not 3 finite numbers"),
    "zero axis": (f'Robot {{ children [ {hinge(solid("a"), "axis 0 0 0")} ] }}', "the axis is the zero vector"),
    "use": ("USE X", "USE X: there is no such DEF"),
    "track": ("Robot { children [ Track { } ] }", "the node Track is not supported"),
    "a proto with bodies": (f'Leg {{ slot [ {solid("a")} ] }}', "the node Leg is not supported.*ignore="),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD_WEBOTS)
def test_bad_worlds_are_named(webots, case):
    text, told = BAD_WEBOTS[case]
    path = webots(text, **({"head": "VRML"} if case == "head" else {}))
    with pytest.raises(pc.FormatError, match=told) as caught:
        pc.load(path)
    assert caught.value.path == str(path)
