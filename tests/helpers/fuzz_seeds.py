"""Valid files with nearly all supported elements, which the fuzz test mutates."""

from helpers import sdf_texts
from helpers.urdf_texts import BAR, joint

BOX = """<visual><origin xyz="0 0 1" rpy="1 0 0"/><geometry><box size="1 2 3"/></geometry><material name="m"/></visual>
<collision><geometry><mesh filename="x.stl" scale="1 1 1"/></geometry></collision>"""
BALL = '<visual><geometry><sphere radius="1"/></geometry></visual>'


def link(name, shape=""):
    return f'<link name="{name}">{BAR}{shape}</link>'


LIMITED = """<origin xyz="1 0 0" rpy="0.1 0.2 0.3"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="10" velocity="5"/><dynamics damping="0.1" friction="0.2"/>"""
TREE = (
    '<robot name="r"><material name="m"><color rgba="1 0 0 1"/></material>'
    + link("a", BOX)
    + "".join(map(link, "bdefgh"))
    + link("c", BALL)
    + '<link name="closing_k_1"/>'
    + joint("j", "a", "b", "revolute", LIMITED)
    + joint("k", "b", "c", "continuous", '<axis xyz="0 1 1"/>{mimic}')
    + joint("l", "a", "d", "prismatic", '<origin xyz="0 1 0"/><axis xyz="1 0 0"/>')
    + joint("m", "d", "e", "fixed", '<origin xyz="0 1 0"/>')
    + joint("n", "a", "f", "planar", '<axis xyz="0 0 1"/>')
    + joint("o", "c", "closing_k_1", "fixed", "")
    + joint("p", "a", "g", "floating", "")
    + joint("q", "a", "h", "floating", "")
    + '{closure}<transmission name="t"/></robot>'
)
URDF = TREE.format(
    mimic='<mimic joint="j" multiplier="2" offset="0.1"/>',
    closure="""<loop_joint name="s" type="revolute"><link1 link="c" xyz="1 0 0" rpy="0 0 0"/>
    <link2 link="g" xyz="0 0 1"/><axis xyz="0 1 0"/></loop_joint>
    <loop_joint name="t" type="prismatic"><link1 link="e"/><link2 link="h" rpy="0 0 1"/></loop_joint>""",
)
PLAIN_URDF = TREE.format(mimic="", closure="")

LOOP_FILE = """
description: everything a loop file can hold
joints:
  j: {armature: 0.1, damping: 0.2, friction: 0.3}
  k: {damping: 1, friction: 2}
  l: {type: translation, armature: [1, 2, 3]}
gravity: [0, 0, -9.81]
joint_order: [j, k, l, n, p, q]
loops:
  - {name: point, kind: point, frame1: e, frame2: c, xyz1: [1, 2, 3], rpy2: [0.1, 0.2, 0.3]}
  - {name: hinge, kind: hinge, frame1: g, frame2: b, axis: [0, 1, 0]}
  - {name: rod, kind: distance, frame1: f, length: 1.5}
  - {name: cross, kind: universal, frame1: h, frame2: f, axis: [1, 0, 0], axis2: [0, 1, 0]}
  - {name: gear, kind: coupling, joint: j, other: k, ratio: 0.5, offset: 0.1, higher: [0.1, 0.2]}
  - {name: motor, kind: drive, joint: j, curve: {law: step5, times: [0, 0.5, 1], values: [0.1, 0.2, 0]}}
forces:
  - {kind: damping, coefficients: {j: 0.1, n: [0.1, 0.2, 0.3]}}
  - {kind: friction, coefficients: {j: 0.5}, width: 0.01}
  - {kind: spring, joint: j, stiffness: 20.0, rest: 0.3}
  - {kind: spring-damper, frame1: e, stiffness: 500.0, length: 0.4, damping: 2.0, xyz2: [0, 0, 1]}
  - {kind: torque, torques: {j: {amplitude: 3.0, frequency: 0.5}}}
  - {kind: servo, joint: j, target: {start: 0.1, speed: 2.0}, stiffness: 100.0, damping: 5.0}
  - {kind: servo, joint: j, target: {law: table, times: [0, 1], values: [0, 1]}, stiffness: 100.0}
  - {kind: wrench, frame: e, force: [0, 0, -10], moment: [1, 2, 3], axes: local, xyz: [1, 0, 0]}
guess: {j: 0.1, p: [0, 0, 0, 0, 0, 0, 1]}
actuated: [j]
"""

ROBOT_YAML = """
closed_loop: [[g, c], [h, f]]
type: [6d, 3D]
name_mot: [j]
joint_name: [j, k, l]
joint_type: [SPHERICAL, UJOINT_XY, FIXED]
"""

_AXIS = """<axis><xyz expressed_in="a">0 1 0</xyz><limit><lower>-1</lower><upper>1</upper></limit>
<dynamics><damping>0.1</damping><friction>0.2</friction><spring_stiffness>1</spring_stiffness></dynamics></axis>"""
SDF = (
    '<sdf version="1.9"><model name="m" canonical_link="a">'
    + "".join(sdf_texts.link(name, f"{i} 0 0 0.1 0 0") for i, name in enumerate("abcdefg"))
    + '<link name="h"><pose relative_to="a">0 1 0 0 0 0</pose></link>'
    + '<frame name="i" attached_to="b"><pose relative_to="b">0 0 1 0 0 0</pose></frame>'
    + sdf_texts.joint("w", "world", "a", "fixed", "")
    + sdf_texts.joint("j", "a", "b", "revolute", '<pose relative_to="i">0 0 0 0 0 0</pose>' + _AXIS)
    + sdf_texts.joint("k", "b", "c", "continuous", "<axis><xyz>0 1 0</xyz></axis>")
    + sdf_texts.joint("l", "a", "d", "prismatic")
    + sdf_texts.joint("m", "a", "e", "ball", "")
    + sdf_texts.joint("n", "e", "f", "universal", sdf_texts.axis("1 0 0") + sdf_texts.axis("0 1 0", tag="axis2"))
    + sdf_texts.joint("o", "a", "g", "screw", "<axis><xyz>0 0 1</xyz></axis><thread_pitch>2</thread_pitch>")
    + sdf_texts.joint("p", "c", "d", "ball", "")
    + sdf_texts.joint("q", "a", "h", "revolute")
    + "</model></sdf>"
)

_ROD = '<geom type="capsule" size="0.05" fromto="0 0 0 0.5 0.1 0.2"/>'
_INERTIAL = '<inertial pos="0.1 0.2 -0.3" euler="10 20 30" mass="2" diaginertia="0.1 0.2 0.25"/>'
MJCF = f"""<mujoco model="m"><compiler angle="degree" autolimits="true"/><option gravity="0 0 -9.81"/>
<default><joint damping="0.1"/><geom density="500"/><default class="c"><joint armature="0.1"/></default></default>
<worldbody><site name="w" pos="1 1 1"/>
<body name="a" pos="0 0 1" childclass="c"><joint name="j" axis="0 1 0" ref="20" range="-90 90"/>{_ROD}
<site name="s" pos="0.5 0 0" quat="1 2 3 4"/>
<body name="b" pos="0.5 0 0" euler="10 20 30"><joint name="k" type="hinge" axis="0 1 0" stiffness="2"/>{_INERTIAL}
<body name="c" axisangle="1 0 0 20"><joint name="l" type="slide" axis="1 0 0" frictionloss="0.2"/>
<geom type="box" size="0.1 0.2 0.3" mass="3"/></body></body></body>
<body name="d" xyaxes="1 2 3 0 1 0.5"><joint name="m" type="ball" pos="0.1 0.2 0.3"/>{_ROD}</body>
<body name="e" pos="2 0 0"><freejoint name="n"/><geom type="sphere" size="0.1"/></body>
<frame pos="1 2 3"><body name="f" zaxis="1 2 3"><joint name="o"/>{_ROD}</body></frame></worldbody>
<equality><connect name="q" body1="b" body2="d" anchor="0.1 0 0"/><weld name="r" site1="s" site2="w" active="false"/>
<weld name="t" body1="e" body2="c"/><joint name="u" joint1="o" joint2="j" polycoef="0.1 0.5 0 0 0"/></equality>
<actuator><motor name="v" joint="j"/></actuator>
<keyframe><key qpos="0 0 0 1 0 0 0 2 0 0 1 0 0 0 0"/></keyframe></mujoco>"""

XACRO = URDF.replace(
    '<robot name="r">',
    """<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="r"><xacro:arg name="side" default="1.0"/>
    <xacro:property name="size" value="${2 * pi}"/><xacro:macro name="tool" params="name at:=${size} *block">
    <link name="${name}"><xacro:insert_block name="block"/></link></xacro:macro>
    <xacro:tool name="t1" at="$(arg side)"><inertial><mass value="${at + 1.0 if at else 2}"/>
    <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></xacro:tool>
    <joint name="tj" type="continuous"><parent link="a"/><child link="t1"/><axis xyz="0 ${cos(0)} 0"/></joint>
    <xacro:if value="${size > 7}"><link name="never"/></xacro:if>""",
).replace("${at + 1.0 if at else 2}", "${size + 1.0 if size else 2}")

LOOP_LIST = """
ball_loops: [{name: rod, parent: h, child: c, parent_xyz: [0, 0, 1], child_xyz: [0.1, 0, 0]}]
pin_loops: [{name: pin, parent: g, child: b, parent_xyz: [0, 0, 1], child_xyz: [0, 0, 0], axis: [0, ±1, 0]}]
ball_upgrades: [j]
ball_limit_deg: 30
actuated_joints: [k]
"""
CLOSURES = """
independent: [j]
closures:
  - {name: one, parent: e, child: c, point: [0.1, 0.2, 0.3], axis: y}
  - {parent: g, child: b, point: [0.1, 0.2, 0.3]}
"""
CLOSING_JOINTS = """
closing_joints:
  - {name: one, parent: g, child: b, type: revolute, origin_xyz_m: [0, 0, 1],
     origin_rpy_rad: [0, 0.1, 0], axis: [0, 1, 0]}
  - {parent: h, child: f, type: fixed, limits: {lower: -1, upper: 1}}
"""

_USD_BODY = """def Xform "{name}" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"]) {{
  double3 xformOp:translate = ({x}, 0, 0)
  quatd xformOp:orient = (1, 0, 0, 0)
  uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:orient"]
  float physics:mass = {mass}
  point3f physics:centerOfMass = (0.1, 0.2, 0)
  float3 physics:diagonalInertia = (0.1, 0.2, 0.25)
  def Cube "shape" (prepend apiSchemas = ["PhysicsCollisionAPI"]) {{
    double size = 0.5
  }}
}}
"""
_USD_JOINTS = """def PhysicsRevoluteJoint "j" (prepend apiSchemas = ["PhysicsDriveAPI:angular"]) { 
  rel physics:body1 = </a>
  uniform token physics:axis = "Y"
  float physics:lowerLimit = -90
  float drive:angular:physics:stiffness = 2
  float drive:angular:physics:damping = 0.5
  float physxJoint:armature = 0.1
}
def PhysicsPrismaticJoint "k" { rel physics:body0 = </a>
  rel physics:body1 = </b>
  uniform token physics:axis = "X"
  point3f physics:localPos0 = (1, 0, 0)
}
def PhysicsJoint "l" (prepend apiSchemas = ["PhysicsLimitAPI:transX", "PhysicsLimitAPI:transY"]) { 
  rel physics:body0 = </b>
  rel physics:body1 = </c>
  float limit:transX:physics:low = 1
  float limit:transX:physics:high = -1
  float limit:transY:physics:low = -1
  float limit:transY:physics:high = 1
}
def PhysicsSphericalJoint "m" { rel physics:body0 = </c>
  rel physics:body1 = </a>
  point3f physics:localPos0 = (0, 0, 0)
  point3f physics:localPos1 = (2, 0, 0)
  bool physics:excludeFromArticulation = 1
}
def PhysicsDistanceJoint "n" { rel physics:body0 = </c>
  float physics:minDistance = 2
  float physics:maxDistance = 2
}
"""
USD = '#usda 1.0\n( metersPerUnit = 1\n upAxis = "Z" )\n' + _USD_JOINTS
USD += "".join(_USD_BODY.format(name=name, x=x, mass=x + 1) for x, name in enumerate("abc"))

_WEBOTS_PHYSICS = """physics Physics { density -1 mass 2 centerOfMass [ 0.2 0 0 ]
  inertiaMatrix [ 0.01 0.02 0.03 0.001 0.002 0.003 ] }"""
_SHAPE = "Shape { geometry Box { size 0.1 0.2 0.3 } }"
WEBOTS = f"""#VRML_SIM R2023b utf8
WorldInfo {{ gravity 9.81 }}
Robot {{ name "r" children [
  HingeJoint {{ jointParameters HingeJointParameters {{ axis 0 1 0 anchor 0 0 0 position 0.3 springConstant 2 }}
    device [ RotationalMotor {{ name "j" maxTorque 5 }} ]
    endPoint Solid {{ translation 0 0 0 rotation 0 1 0 0.5 name "a" boundingObject {_SHAPE} {_WEBOTS_PHYSICS} children [
      {_SHAPE}
      SliderJoint {{ jointParameters JointParameters {{ axis 1 0 0 position 0.1 dampingConstant 1 }}
        endPoint Solid {{ translation 1 0 0 name "b" boundingObject USE_BOX {_WEBOTS_PHYSICS} children [
          BallJoint {{ jointParameters BallJointParameters {{ anchor 0 0 0 }}
            endPoint SolidReference {{ solidName "c" }} }} ] }} }} ] }} }}
  Hinge2Joint {{ jointParameters HingeJointParameters {{ axis 0 1 0 anchor 1 0 0 }}
    jointParameters2 JointParameters {{ axis 1 0 0 position 0.2 }}
    endPoint Solid {{ translation 1 0 0 rotation 1 0 0 0.1 name "c" {_WEBOTS_PHYSICS} }} }} ] }}
""".replace("USE_BOX", "Capsule { height 0.2 radius 0.1 }")

BODY = """format: ChoreonoidBody
formatVersion: 1.0
angleUnit: degree
name: r
links:
  - {name: base, jointType: fixed, mass: 1, inertia: [1, 0, 0, 0, 1, 0, 0, 0, 1]}
  - name: a
    parent: base
    translation: [0, 0, 1]
    rotation: [1, 0, 0, 30]
    jointType: revolute
    jointId: 0
    jointAxis: [0, 1, 0]
    jointRange: [-90, 90]
    rotorInertia: 0.1
    gearRatio: 2
    elements:
      - {type: RigidBody, mass: 1, centerOfMass: [0, 0, 0.5], inertia: [1, 0, 0, 1, 0, 1], translation: [0, 0, 0.1]}
      - type: Transform
        translation: [0, 0, 1]
        elements: {Shape: {geometry: {type: Box, size: [1, 1, 1]}}}
  - {name: b, parent: a, translation: [1, 0, 0], joint_type: revolute, joint_axis: -X, mass: 1, inertia: [1, 0, 0, 0, 1,
     0, 0, 0, 1]}
  - {name: c, parent: base, translation: [1, 0, 0], jointType: prismatic, jointAxis: Z, mass: 1,
     inertia: [1, 0, 0, 1, 0, 1]}
extraJoints:
  - {link1Name: b, link2Name: c, jointType: ball, link1LocalPos: [0, 0, 0.5], link2LocalPos: [0.1, 0, 1]}
"""
AMBF = """bodies: [BODY base, BODY a, BODY b]
joints: [JOINT j, JOINT k, JOINT tip]
gravity: {x: 0, y: 0, z: -9.81}
high resolution path: meshes/
BODY base: {name: base, mass: 0.0}
BODY a:
  name: a
  mass: 1.5
  location: {position: {x: 0, y: 0, z: 1}, orientation: {r: 0.1, p: 0.2, y: 0.3}}
  inertial offset: {position: {x: 0.5, y: 0, z: 0}, orientation: {r: 0, p: 0, y: 0}}
  inertia: {ix: 0.1, iy: 0.2, iz: 0.2}
BODY b:
  name: b
  mass: 1.0
  mesh: b.stl
  scale: 1.0
  location: {position: {x: 1, y: 0, z: 1}, orientation: {r: 0, p: 0, y: 0}}
  collision shape: Cylinder
  collision geometry: {radius: 0.1, height: 0.5, axis: x}
JOINT j: {name: j, parent: BODY base, child: BODY a, type: revolute, parent axis: {x: 0, y: 1, z: 0},
  child axis: {x: 0, y: 1, z: 0.1}, parent pivot: {x: 0, y: 0, z: 1}, child pivot: {x: 0, y: 0, z: 0}, offset: 0.3,
  joint limits: {low: -1, high: 1}, damping: 0.1}
JOINT k: {name: k, parent: BODY a, child: BODY b, type: linear spring, parent axis: {x: 1, y: 0, z: 0},
  child axis: {x: 1, y: 0, z: 0}, parent pivot: {x: 1, y: 0, z: 0}, child pivot: {x: 0, y: 0, z: 0}, stiffness: 20}
JOINT tip: {name: tip, parent: BODY base, child: BODY b, type: p2p, parent pivot: {x: 1, y: 0, z: 1},
  child pivot: {x: 0, y: 0, z: 0}, detached: true}
"""
DIRECTIVES = """directives:
- add_model: {name: left, file: arm.sdf, default_joint_positions: {j: [0.3]}}
- add_weld: {parent: world, child: "left::a", X_PC: {translation: [1, 0, 0], rotation: !Rpy {deg: [0, 0, 90]}}}
- add_model: {name: right, file: arm.sdf, default_free_body_pose: {a: {translation: [0, 1, 0]}}}
- add_frame: {name: mount, X_PF: {base_frame: "left::b", rotation: !AngleAxis {axis: [1, 0, 0], angle_deg: 30}}}
- add_collision_filter_group: {name: g, members: ["left::a"]}
"""
WRL = """#VRML V2.0 utf8
PROTO Joint [ exposedField SFVec3f translation 0 0 0 exposedField SFString jointType "" ] {
  Transform { translation IS translation } }
PROTO ExtraJoint [ exposedField SFString link1Name "" ] { }
DEF r Humanoid { version "1" humanoidBody [
  DEF base Joint { jointType "fixed" children [
    DEF a Joint { jointType "rotate" jointAxis "Y" jointId 0 translation 0 0 1 rotation 1 0 0 0.5 llimit [ -1 ]
      ulimit [ 1 ] rotorInertia 0.1 gearRatio 2
      children [ Segment { mass 1 centerOfMass 0 0 0.5 momentsOfInertia [ 1 0 0 0 1 0 0 0 1 ] }
      DEF b Joint { jointType "rotate" jointAxis 1 0 0 translation 1 0 0
        children Segment { mass 1 momentsOfInertia [ 1 0 0 0 1 0 0 0 1 ] } } ] }
    DEF c Joint { jointType "slide" jointAxis 0 0 1 translation 1 0 0
      children Segment { mass 1 momentsOfInertia [ 1 0 0 0 1 0 0 0 1 ] } } ] } ] joints [ USE a USE b ] }
DEF tip ExtraJoint { link1Name "b" link2Name "c" jointType "xyz" link1LocalPos 0 0 0.5 link2LocalPos 0.1 0 1 }
"""
PROTO = (
    WEBOTS.partition("\n")[0]
    + """
PROTO scene [ field SFVec3f translation 0 0 0 field SFString{"r", "s"} name "r" field MFNode children [] ] {
  Robot { translation IS translation name IS name children [
"""
    + WEBOTS[WEBOTS.index("Robot {") :].partition("children [")[2].rpartition("]")[0]
    + """ ] } }
"""
)
