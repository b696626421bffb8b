"""One four-bar written in every way that can be read: one trajectory."""

import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import pinconsist as pc

MODELS = Path(__file__).resolve().parents[1] / "models"
FOUR_BAR = (MODELS / "four_bar.urdf").read_text(encoding="utf-8")
GUESS = np.array([-1.0, 0.6742791460587038, -1.4133851241635729])  # crank, coupler, rocker: closed
LENGTHS = {"crank": 1.0, "coupler": 2.0, "rocker": 1.5}
ABOUT_Y = (GUESS[0], GUESS[0] + GUESS[1], GUESS[2])  # angle of each bar in the world


def loop_file(tmp_path):
    (tmp_path / "four_bar.urdf").write_text(FOUR_BAR)
    (tmp_path / "four_bar.yaml").write_bytes((MODELS / "four_bar.yaml").read_bytes())
    return pc.load(tmp_path / "four_bar.urdf")


def closing_frames(tmp_path):
    path = tmp_path / "four_bar.urdf"
    path.write_text(FOUR_BAR.replace('"coupler_tip"', '"closing_tip_1"').replace('"rocker_tip"', '"closing_tip_2"'))
    return pc.load(path)


def loop_joint(tmp_path):
    path = tmp_path / "four_bar.urdf"
    closure = """<loop_joint name="coupler_rocker" type="revolute">
      <link1 link="coupler_bar" xyz="2 0 0"/><link2 link="rocker_bar" xyz="1.5 0 0"/><axis xyz="0 1 0"/>
    </loop_joint></robot>"""
    path.write_text(FOUR_BAR.replace("</robot>", closure))
    return pc.load(path)


def bars():
    """(name, mass, length, x and z of its near end, angle about y), closed."""
    x = z = 0.0
    for name, angle in zip(LENGTHS, ABOUT_Y, strict=True):
        length = LENGTHS[name]
        if name == "rocker":
            x, z = 2.2, 0.0
        yield name, length, float(x), float(z), float(angle)
        x, z = x + length * np.cos(angle), z - length * np.sin(angle)


def inertia(mass, length):
    """(along, across) of the bars, as models/four_bar.urdf has them."""
    return mass * 0.04**2 / 2, mass * length**2 / 12


def sdf(tmp_path):
    """Links where they stand in the closed configuration, from which SDF counts angles; the last joint closes."""
    links = ""
    for name, length, x, z, angle in bars():
        along, across = inertia(length, length)
        links += f"""<link name="{name}_bar"><pose>{x!r} 0 {z!r} 0 {angle!r} 0</pose>
          <inertial><pose>{length / 2} 0 0 0 0 0</pose><mass>{length}</mass><inertia>
          <ixx>{along!r}</ixx><iyy>{across!r}</iyy><izz>{across!r}</izz><ixy>0</ixy><ixz>0</ixz><iyz>0</iyz>
          </inertia></inertial></link>"""
    joints = ""
    for name, parent, child in (
        ("crank", "world", "crank_bar"),
        ("coupler", "crank_bar", "coupler_bar"),
        ("rocker", "world", "rocker_bar"),
        ("tip", "coupler_bar", "rocker_bar"),
    ):
        place = "<pose>1.5 0 0 0 0 0</pose>" if name == "tip" else ""
        joints += f"""<joint name="{name}" type="revolute">{place}<parent>{parent}</parent><child>{child}</child>
          <axis><xyz>0 1 0</xyz></axis></joint>"""
    path = tmp_path / "four_bar.sdf"
    path.write_text(f'<sdf version="1.7"><model name="four_bar">{links}{joints}</model></sdf>')
    return pc.load(path)


def mjcf(tmp_path):
    """Bodies where they stand in the closed configuration, whose angles `ref` gives; the anchor is in the coupler."""
    text = {}
    for (name, length, x, z, _), own in zip(bars(), GUESS.tolist(), strict=True):
        along, across = inertia(length, length)
        x, z = (1.0, 0.0) if name == "coupler" else (x, z)
        text[name] = f"""<body name="{name}_bar" pos="{x!r} 0 {z!r}" euler="0 {own!r} 0">
          <joint name="{name}" type="hinge" axis="0 1 0" ref="{own!r}"/>
          <inertial pos="{length / 2} 0 0" mass="{length}" diaginertia="{along!r} {across!r} {across!r}"/>"""
    path = tmp_path / "four_bar.xml"
    path.write_text(
        f"""<mujoco model="four_bar"><compiler angle="radian"/><option gravity="0 0 -9.81"/><worldbody>
        {text["crank"]}{text["coupler"]}</body></body>{text["rocker"]}</body></worldbody>
        <equality><connect name="tip" body1="coupler_bar" body2="rocker_bar" anchor="2 0 0"/></equality></mujoco>"""
    )
    return pc.load(path)


def pinocchio_model(tmp_path):
    """Built in code, closed by Pinocchio's own constraint."""
    model, last = pin.Model(), {"crank": 0, "rocker": 0}
    for name, length in LENGTHS.items():
        along, across = inertia(length, length)
        start = {"crank": 0.0, "coupler": 1.0, "rocker": 2.2}[name]
        place = pin.SE3(np.eye(3), np.array([start, 0, 0]))
        joint = model.addJoint(last.get(name, last["crank"]), pin.JointModelRY(), place, name)
        last["crank"] = joint if name == "crank" else last["crank"]
        model.inertias[joint] = pin.Inertia(length, np.array([length / 2, 0, 0]), np.diag([along, across, across]))
    ends = [
        part for joint, length in ((2, 2.0), (3, 1.5)) for part in (joint, pin.SE3(np.eye(3), np.array([length, 0, 0])))
    ]
    return pc.load(model, loops=[pin.PointAnchorConstraintModel(model, *ends)])


def trajectory(mech, offset=0.0):
    """Angles and rates of crank, coupler and rocker over 1 s, from rest in the closed configuration."""
    order = [mech.joints.index(name) for name in LENGTHS]
    start = dict(zip(LENGTHS, (GUESS - offset).tolist(), strict=True))
    sol = pc.simulate(mech, (0.0, 1.0), start, step=1e-3, order=3)
    assert sol.success
    return sol.q[:, order] + offset, sol.v[:, order]


def urdf(text, closed=False, namespaces=""):
    """A file with `text` in the four-bar; if `closed`, its joints are at zero where the loop is closed."""

    def way(tmp_path):
        whole = FOUR_BAR.replace("</robot>", text + "</robot>").replace("<robot", f"<robot{namespaces}", 1)
        if closed:
            for name, own in zip(LENGTHS, GUESS.tolist(), strict=True):
                place = {"crank": "0 0 0", "coupler": "1 0 0", "rocker": "2.2 0 0"}[name]
                head, rest = whole.split(f'<joint name="{name}" type="continuous">')
                rest = rest.replace(f'<origin xyz="{place}"/>', "", 1) if name != "crank" else rest
                joint = f'<joint name="{name}" type="continuous"><origin xyz="{place}" rpy="0 {own!r} 0"/>'
                whole = head + joint + rest
        path = tmp_path / "four_bar.urdf"
        path.write_text(whole)
        return pc.load(path)

    return way


def beside(name, text, closed=False):
    def way(tmp_path):
        (tmp_path / name).write_text(text)
        return urdf("", closed)(tmp_path)

    return way


def joined(tag, ends, kind="revolute"):
    return f'<{tag} name="tip" type="{kind}">{ends}<axis xyz="0 1 0"/></{tag}>'


PIN = '<link name="pin"/>' + joined(
    "joint", '<parent link="coupler_bar"/><child link="pin"/><origin xyz="2 0 0"/>', "continuous"
)
DRAKE = "".join(
    f"<drake:ball_constraint_{tag}/>"
    for tag in (
        'body_A name="coupler_bar"',
        'body_B name="rocker_bar"',
        'p_AP value="2 0 0"',
        'p_BQ value="1.5 0 0"',
    )
)
DETACHABLE = """<plugin filename="gz-sim-detachable-joint-system" name="gz::sim::systems::DetachableJoint">
  <parent_link>pin</parent_link><child_model>four_bar</child_model><child_link>rocker_bar</child_link></plugin>"""
CLOSING = """closing_joints:
- {name: tip, type: revolute, parent: coupler_bar, child: rocker_bar, origin_xyz_m: [2, 0, 0],
   origin_rpy_rad: [0, 0, 0], axis: [0, 1, 0]}"""
PINS = """pin_loops:
- {name: tip, parent: coupler_bar, child: rocker_bar, parent_xyz: [2, 0, 0], child_xyz: [1.5, 0, 0], axis: [0, 1, 0]}"""
GAZEBO = """<gazebo><joint name="tip" type="revolute"><parent>coupler_bar</parent><child>rocker_bar</child>
  <pose>1.5 0 0 0 0 0</pose><axis><xyz>0 1 0</xyz></axis></joint></gazebo>"""
PEGASUS = """<gazebo><plugin name="tip" filename="libpegasus_gazebo_closed_loop_plugin.so"><joint>tip</joint>
  <child>rocker_bar</child><parent>coupler_bar</parent><position>1.5 0 0</position><rotation>0 0 0</rotation></plugin>
  </gazebo>"""
MUJOCO = '<equality><connect body1="coupler_bar" body2="rocker_bar" anchor="2 0 0"/></equality>'
SPOKEN = {
    "urdf_plus": urdf(
        joined(
            "loop",
            '<predecessor link="coupler_bar"><origin xyz="2 0 0"/></predecessor>'
            '<successor link="rocker_bar"><origin xyz="1.5 0 0"/></successor>',
            "continuous",
        )
    ),
    "constraint": urdf(
        joined(
            "constraint",
            '<parent link="coupler_bar"/><parent_origin xyz="2 0 0"/>'
            '<child link="rocker_bar"/><child_origin xyz="1.5 0 0"/>',
            "revolute_joint",
        )
    ),
    "true_loop": urdf(joined("joint", '<parent link="coupler_tip"/><child link="rocker_tip"/>', "continuous")),
    "gazebo_joint": urdf(GAZEBO, closed=True),
    "closed_loop_plugin": urdf(PEGASUS, closed=True),
    "detachable_joint": urdf(f"{PIN}<gazebo>{DETACHABLE}</gazebo>", closed=True),
    "drake": urdf(
        f"<drake:ball_constraint>{DRAKE}</drake:ball_constraint>", namespaces=' xmlns:drake="http://drake.mit.edu"'
    ),
    "mujoco_in_urdf": urdf(f"<mujoco>{MUJOCO}</mujoco>", closed=True),
    "closing_joints": beside("robot_data.yaml", CLOSING, closed=True),
    "loop_closures": beside("loop_closures.yaml", PINS),
}
CLOSED_AT_ZERO = {
    "sdf",
    "webots",
    "webots_proto",
    "choreonoid",
    "openhrp",
    "gazebo_joint",
    "closed_loop_plugin",
    "detachable_joint",
    "mujoco_in_urdf",
    "closing_joints",
    "sdf_written",
}


def xacro(tmp_path):
    pytest.importorskip("xacro")
    tip = """<xacro:macro name="pin" params="one two at:=${length}"><loop_joint name="tip" type="revolute">
      <link1 link="${one}" xyz="${2 * at} 0 0"/><link2 link="${two}" xyz="${3 * at / 2} 0 0"/><axis xyz="0 1 0"/>
      </loop_joint></xacro:macro><xacro:pin one="coupler_bar" two="rocker_bar"/></robot>"""
    start = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="four_bar"><xacro:arg name="length" default="7"/>'
    start += '<xacro:property name="length" value="$(arg length)"/>'
    path = tmp_path / "four_bar.urdf.xacro"
    path.write_text(FOUR_BAR.replace('<robot name="four_bar">', start).replace("</robot>", tip))
    return pc.load(path, args={"length": 1.0})


def usd(tmp_path):
    """Bodies where they stand in the closed configuration; the places of joints say at which angles they are."""
    pytest.importorskip("pxr.Usd")
    prims = ""
    for name, length, x, z, angle in bars():
        along, across = inertia(length, length)
        prims += f"""def Xform "{name}_bar" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"]) {{
          double3 xformOp:translate = ({x!r}, 0, {z!r})
          quatd xformOp:orient = ({float(np.cos(angle / 2))!r}, 0, {float(np.sin(angle / 2))!r}, 0)
          uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:orient"]
          float physics:mass = {length}
          point3f physics:centerOfMass = ({length / 2}, 0, 0)
          float3 physics:diagonalInertia = ({along!r}, {across!r}, {across!r})
        }}\n"""
    for name, one, two, place0, place1 in (
        ("crank", "", "crank_bar", 0, 0),
        ("coupler", "crank_bar", "coupler_bar", 1, 0),
        ("rocker", "", "rocker_bar", 2.2, 0),
        ("tip", "coupler_bar", "rocker_bar", 2, 1.5),
    ):
        first = f"rel physics:body0 = </{one}>" if one else ""
        prims += f"""def PhysicsRevoluteJoint "{name}" {{ {first}
          rel physics:body1 = </{two}>
          uniform token physics:axis = "Y"
          bool physics:excludeFromArticulation = {int(name == "tip")}
          point3f physics:localPos0 = ({place0}, 0, 0)
          point3f physics:localPos1 = ({place1}, 0, 0)
        }}\n"""
    path = tmp_path / "four_bar.usda"
    path.write_text(f'#usda 1.0\n(\n metersPerUnit = 1\n upAxis = "Z"\n)\n{prims}')
    return pc.load(path)


def webots(tmp_path):
    """Each solid stands in its parent as it does where the loop is closed."""

    def bar(name, place, inside=""):
        own, length = float(GUESS[list(LENGTHS).index(name)]), LENGTHS[name]
        along, across = inertia(length, length)
        return f"""HingeJoint {{ jointParameters HingeJointParameters {{ axis 0 1 0 anchor {place} 0 0 }}
          device [ PositionSensor {{ name "{name}" }} ]
          endPoint Solid {{ translation {place} 0 0 rotation 0 1 0 {own!r} name "{name}_bar" children [ {inside} ]
          physics Physics {{ density -1 mass {length} centerOfMass [ {length / 2} 0 0 ]
          inertiaMatrix [ {along!r} {across!r} {across!r} 0 0 0 ] }} }} }}"""

    tip = """HingeJoint { jointParameters HingeJointParameters { axis 0 1 0 anchor 2 0 0 }
      endPoint SolidReference { solidName "rocker_bar" } }"""
    path = tmp_path / "four_bar.wbt"
    bodies = bar("crank", 0, bar("coupler", 1, tip)) + bar("rocker", 2.2)
    path.write_text(
        f'#VRML_SIM R2023b utf8\nWorldInfo {{ gravity 9.81 }}\nRobot {{ children [ {bodies} ] name "r" }}\n'
    )
    return pc.load(path)


BAR_PROTO = """#VRML_SIM R2023b utf8
PROTO Bar [
  field SFVec3f translation 0 0 0
  field SFRotation rotation 0 1 0 0
  field SFString{"crank_bar", "coupler_bar", "rocker_bar"} name "crank_bar"
  field MFNode{HingeJoint{}} children []
  field SFFloat kilograms 1.0  # of the whole bar
  field MFVec3f middle [ 0.5 0 0 ]
  field MFVec3f moments [ 0 0 0 0 0 0 ]
]
{
  Solid { translation IS translation rotation IS rotation name IS name children IS children
    physics Physics { density -1 mass IS kilograms centerOfMass IS middle inertiaMatrix IS moments } }
}
"""


def webots_proto(tmp_path):
    """The bars are PROTO nodes, of a file beside the world's folder."""
    webots(tmp_path)
    (tmp_path / "worlds").mkdir()
    (tmp_path / "protos").mkdir()
    (tmp_path / "protos" / "Bar.proto").write_text(BAR_PROTO)
    text = (tmp_path / "four_bar.wbt").read_text().replace("endPoint Solid {", "endPoint Bar {")
    text = text.replace("physics Physics { density -1 mass", "kilograms").replace("centerOfMass", "middle")
    text = re.sub(r"inertiaMatrix (\[[^]]*\]) \}", r"moments \1", text)
    head, rest = text.split("\n", 1)
    (tmp_path / "worlds" / "four_bar.wbt").write_text(f'{head}\nEXTERNPROTO "../protos/Bar.proto"\n{rest}')
    return pc.load(tmp_path / "worlds" / "four_bar.wbt")


def choreonoid(tmp_path):
    """The links stand in their parents as they do where the loop is closed; an extra joint closes it."""
    links = ["  - {name: base, jointType: fixed}"]
    for (name, length, *_), own in zip(bars(), GUESS.tolist(), strict=True):
        along, across = inertia(length, length)
        parent, x = {"crank": ("base", 0.0), "coupler": ("crank", 1.0), "rocker": ("base", 2.2)}[name]
        links.append(f"""  - {{name: {name}, parent: {parent}, jointType: revolute, jointAxis: Y, jointId: 1,
      translation: [{x}, 0, 0], rotation: [0, 1, 0, {own!r}], mass: {length}, centerOfMass: [{length / 2}, 0, 0],
      inertia: [{along!r}, 0, 0, 0, {across!r}, 0, 0, 0, {across!r}]}}""")
    extra = """extraJoints:
  - {link1Name: coupler, link2Name: rocker, jointType: hinge, jointAxis: [0, 1, 0], link1LocalPos: [2, 0, 0],
     link2LocalPos: [1.5, 0, 0]}"""
    path = tmp_path / "four_bar.body"
    head = ["format: ChoreonoidBody", "angleUnit: radian", "name: four_bar", "links:"]
    path.write_text("\n".join([*head, *links, extra]) + "\n")
    return pc.load(path)


def ambf(tmp_path):
    """The bodies of AMBF stand where the loop is closed; a joint has an axis and a pivot in each of its bodies."""
    lines = ["bodies: [BODY ground, BODY crank_bar, BODY coupler_bar, BODY rocker_bar]"]
    lines += ["joints: [JOINT crank, JOINT coupler, JOINT rocker, JOINT tip]", "gravity: {x: 0, y: 0, z: -9.81}"]
    lines += ["BODY ground: {name: ground, mass: 0}"]
    for name, length, x, z, angle in bars():
        along, across = inertia(length, length)
        lines.append(f"""BODY {name}_bar: {{name: {name}_bar, mass: {length}, location: {{position: {{x: {x!r}, y: 0,
  z: {z!r}}}, orientation: {{r: 0, p: {angle!r}, y: 0}}}}, inertia: {{ix: {along!r}, iy: {across!r}, iz: {across!r}}},
  inertial offset: {{position: {{x: {length / 2}, y: 0, z: 0}}, orientation: {{r: 0, p: 0, y: 0}}}}}}""")
    for name, parent, child, x1, x2 in (
        ("crank", "ground", "crank_bar", 0, 0),
        ("coupler", "crank_bar", "coupler_bar", 1, 0),
        ("rocker", "ground", "rocker_bar", 2.2, 0),
        ("tip", "coupler_bar", "rocker_bar", 2, 1.5),
    ):
        lines.append(f"""JOINT {name}: {{name: {name}, parent: BODY {parent}, child: BODY {child}, type: revolute,
  parent axis: {{x: 0, y: 1, z: 0}}, child axis: {{x: 0, y: 1, z: 0}}, detached: {str(name == "tip").lower()},
  parent pivot: {{x: {x1}, y: 0, z: 0}}, child pivot: {{x: {x2}, y: 0, z: 0}}}}""")
    path = tmp_path / "four_bar.yaml"
    path.write_text("\n".join(lines) + "\n")
    return pc.load(path)


def openhrp(tmp_path):
    def bar(name, x, inside=""):
        own, length = float(GUESS[list(LENGTHS).index(name)]), LENGTHS[name]
        along, across = inertia(length, length)
        return f"""DEF {name} Joint {{ jointType "rotate" jointAxis 0 1 0 jointId 0 translation {x} 0 0
          rotation 0 1 0 {own!r} children [ DEF {name}_segment Segment {{ mass {length} centerOfMass {length / 2} 0 0
          momentsOfInertia [ {along!r} 0 0 0 {across!r} 0 0 0 {across!r} ] }} {inside} ] }}"""

    body = f"{bar('crank', 0.0, bar('coupler', 1.0))} {bar('rocker', 2.2)}"
    text = f"""#VRML V2.0 utf8
PROTO ExtraJoint [ exposedField SFString link1Name "" exposedField SFString jointType "xyz" ] {{ }}
DEF four_bar Humanoid {{ humanoidBody [ DEF base Joint {{ jointType "fixed" children [ {body} ] }} ]
  joints [ USE crank USE rocker ] }}
DEF tip ExtraJoint {{ link1Name "coupler" link2Name "rocker" link1LocalPos 2 0 0 link2LocalPos 1.5 0 0
  jointType "xyz" }}
"""
    (tmp_path / "four_bar.wrl").write_text(text)
    return pc.load(tmp_path / "four_bar.wrl")


def written(suffix):
    def way(tmp_path):
        if suffix == ".usda":
            pytest.importorskip("pxr.Usd")
        return pc.load(pc.write(pc.load("four_bar"), tmp_path / f"four_bar{suffix}"))

    return way


SPOKEN |= {f"{suffix}_written": written(f".{ending}") for suffix, ending in
           (("sdf", "sdf"), ("mjcf", "xml"), ("usd", "usda"))}  # fmt: skip
WAYS = {way.__name__: way for way in (loop_file, closing_frames, loop_joint, sdf, mjcf, pinocchio_model)}
WAYS |= {way.__name__: way for way in (xacro, usd, webots, webots_proto, choreonoid, ambf, openhrp)} | SPOKEN


@pytest.fixture(scope="module")
def reference():
    return trajectory(pc.load("four_bar"))


@pytest.mark.parametrize("written_back", [False, True])
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_one_trajectory(tmp_path, reference, way, written_back):
    q, v = reference
    assert np.abs(v).max() > 3.0
    mech = WAYS[way](tmp_path)
    if written_back:
        mech = pc.load(pc.write(mech, tmp_path / "written.urdf"))
    offset = GUESS if way in CLOSED_AT_ZERO else 0.0
    for mine, theirs in zip(trajectory(mech, offset), (q, v), strict=True):
        tolerance = 1e-7 if way == "usd" else 1e-9  # USD has inertias in single precision
        np.testing.assert_allclose(mine, theirs, rtol=0, atol=tolerance)
