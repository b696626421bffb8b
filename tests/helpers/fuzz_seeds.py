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
  - {name: motor, kind: drive, joint: j, start: 0.1, speed: 1, amplitude: 0.2, frequency: 2, phase: 0.3}
forces:
  - {kind: damping, coefficients: {j: 0.1, n: [0.1, 0.2, 0.3]}}
  - {kind: friction, coefficients: {j: 0.5}, width: 0.01}
  - {kind: spring, joint: j, stiffness: 20.0, rest: 0.3}
  - {kind: spring-damper, frame1: e, stiffness: 500.0, length: 0.4, damping: 2.0, xyz2: [0, 0, 1]}
  - {kind: torque, torques: {j: {amplitude: 3.0, frequency: 0.5}}}
  - {kind: servo, joint: j, target: {start: 0.1, speed: 2.0}, stiffness: 100.0, damping: 5.0}
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
