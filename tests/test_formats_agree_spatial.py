"""A Stewart platform and a parallel ankle written in every dialect that can say them: one motion."""

from __future__ import annotations

import warnings
from functools import partial

import numpy as np
import pinocchio as pin
import pytest
import yaml
from helpers.spatial_machines import X, Y, Z, ankle, at, stewart

import pinconsist as pc
from pinconsist.formats.saying import in_world, require_same_motion

MACHINES = {"stewart": stewart, "ankle": ankle}
SPAN = 0.25  # s


def say(*values):
    return " ".join(repr(float(value)) for value in values)


def rpy(place):
    return say(*pin.rpy.matrixToRpy(place.rotation))


def wxyz(place):
    x, y, z, w = pin.Quaternion(place.rotation).coeffs().tolist()
    return w, x, y, z


def inertial(part):
    xx, yy, zz = part.moments
    return (
        f'<inertial><origin xyz="{say(*part.com)}"/><mass value="{part.mass}"/>'
        f'<inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"/></inertial>'
    )


def joint(name, kind, parent, child, place, axis=X, more=""):
    turns = "" if kind in ("fixed", "floating") else f'<axis xyz="{say(*axis)}"/>{more}'
    return (
        f'<joint name="{name}" type="{kind}"><origin xyz="{say(*place.translation)}" rpy="{rpy(place)}"/>'
        f'<parent link="{parent or "base"}"/><child link="{child}"/>{turns}</joint>'
    )


def urdf(machine, extra=""):
    """The tree as URDF."""
    text = '<link name="base"/>'
    for part in machine.parts:
        kind = "continuous" if part.kind == "revolute" else part.kind
        damping = f'<dynamics damping="{part.damping}"/>' if part.damping else ""
        text += f'<link name="{part.name}">{inertial(part)}</link>'
        text += joint(part.joint, kind, part.parent, part.name, part.place, part.axis, damping)
    return f'<robot name="{machine.name}" xmlns:drake="http://drake.mit.edu">{text}{extra}</robot>'


def saved(folder, name, text, **options):
    (folder / name).write_text(text)
    return pc.load(folder / name, **options)


def with_elements(machine, folder, write):
    """A URDF with an element for each ball."""
    return saved(folder, f"{machine.name}.urdf", urdf(machine, "".join(map(write, machine.balls))))


def loop_file(machine, folder):
    loops = [
        {"name": ball.name, "kind": "point", "frame1": ball.body1, "xyz1": list(ball.xyz1),
         "frame2": ball.body2, "xyz2": list(ball.xyz2)} for ball in machine.balls
    ]  # fmt: skip
    (folder / f"{machine.name}.yaml").write_text(yaml.safe_dump({"loops": loops}))
    return saved(folder, f"{machine.name}.urdf", urdf(machine))


def frames(names):
    """Links without inertia at both ends of each ball, whose names close the loop."""

    def write(ball):
        text = ""
        for body, xyz, name in zip((ball.body1, ball.body2), (ball.xyz1, ball.xyz2), names, strict=True):
            link = name.format(ball.name)
            text += f'<link name="{link}"/>' + joint(f"{link}_mount", "fixed", body, link, at(xyz))
        return text

    return partial(with_elements, write=write)


def loop_joint(ball):
    return (
        f'<loop_joint name="{ball.name}" type="spherical"><link1 link="{ball.body1}" xyz="{say(*ball.xyz1)}"/>'
        f'<link2 link="{ball.body2}" xyz="{say(*ball.xyz2)}"/></loop_joint>'
    )


def urdf_plus(ball):
    return (
        f'<loop name="{ball.name}" type="spherical"><predecessor link="{ball.body1}"><origin xyz="{say(*ball.xyz1)}"/>'
        f'</predecessor><successor link="{ball.body2}"><origin xyz="{say(*ball.xyz2)}"/></successor></loop>'
    )


def constraint(ball):
    return (
        f'<constraint name="{ball.name}" type="spherical_joint"><parent link="{ball.body1}"/>'
        f'<parent_origin xyz="{say(*ball.xyz1)}" rpy="0 0 0"/><child link="{ball.body2}"/>'
        f'<child_origin xyz="{say(*ball.xyz2)}" rpy="0 0 0"/></constraint>'
    )


def turning(ball):
    """Two links without inertia that turn at the end of the first body, and the frame of the second one on it."""
    first, second = f"{ball.name}_a", f"{ball.name}_b"
    text = f'<link name="{first}"/>' + joint(f"{first}_turn", "continuous", ball.body1, first, at(ball.xyz1), X)
    text += f'<link name="{second}"/>' + joint(f"{second}_turn", "continuous", first, second, at((0, 0, 0)), Y)
    mount = f"{ball.name}_socket"
    return text, second, f'<link name="{mount}"/>' + joint(f"{mount}_fix", "fixed", ball.body2, mount, at(ball.xyz2))


def gazebo_joint(ball):
    return (
        f'<gazebo><joint name="{ball.name}" type="ball"><parent>{ball.body1}</parent><child>{ball.body2}</child>'
        f"<pose>{say(*ball.xyz2)} 0 0 0</pose></joint></gazebo>"
    )


def detachable(ball, model):
    """Three turning links without inertia, of which the last is welded to the second body."""
    text, link, _ = turning(ball)
    end = f"{ball.name}_c"
    text += f'<link name="{end}"/>' + joint(f"{end}_turn", "continuous", link, end, at((0, 0, 0)), Z)
    return text + (
        f'<gazebo><plugin filename="gz-sim-detachable-joint-system" name="gz::sim::systems::DetachableJoint">'
        f"<parent_link>{end}</parent_link><child_model>{model}</child_model><child_link>{ball.body2}</child_link>"
        f"</plugin></gazebo>"
    )


def drake(ball):
    ends = {"body_A": f'name="{ball.body1}"', "body_B": f'name="{ball.body2}"'}
    ends |= {"p_AP": f'value="{say(*ball.xyz1)}"', "p_BQ": f'value="{say(*ball.xyz2)}"'}
    inside = "".join(f"<drake:ball_constraint_{tag} {value}/>" for tag, value in ends.items())
    return f"<drake:ball_constraint>{inside}</drake:ball_constraint>"


def connect(ball):
    return f'<connect name="{ball.name}" body1="{ball.body1}" body2="{ball.body2}" anchor="{say(*ball.xyz1)}"/>'


def mujoco_in_urdf(machine, folder):
    inside = "".join(map(connect, machine.balls))
    return saved(folder, "m.urdf", urdf(machine, f"<mujoco><equality>{inside}</equality></mujoco>"))


def loop_closures(machine, folder):
    balls = [
        {"name": ball.name, "parent": ball.body1, "child": ball.body2, "parent_xyz": list(ball.xyz1),
         "child_xyz": list(ball.xyz2)} for ball in machine.balls
    ]  # fmt: skip
    (folder / "loop_closures.yaml").write_text(yaml.safe_dump({"ball_loops": balls}))
    return saved(folder, "m.urdf", urdf(machine))


def closures(machine, folder):
    """One point for each loop, in the axes of the root."""
    points = [
        {"link_a": ball.body1, "link_b": ball.body2, "point": (machine.pose(ball.body1) * np.array(ball.xyz1)).tolist()}
        for ball in machine.balls
    ]
    (folder / "loop_closures.yaml").write_text(yaml.safe_dump({"closures": points}))
    return saved(folder, "m.urdf", urdf(machine))


def closing_joints(machine, folder):
    """A hinge between the second of two turning links and a socket, as exporters without balls write it."""
    text, joints = "", []
    for ball in machine.balls:
        links, last, socket = turning(ball)
        text += links + socket
        joints.append({"name": ball.name, "type": "continuous", "parent": last, "child": f"{ball.name}_socket",
                       "origin_xyz_m": [0, 0, 0], "origin_rpy_rad": [0, 0, 0], "axis": [0, 0, 1]})  # fmt: skip
    (folder / "robot_data.yaml").write_text(yaml.safe_dump({"closing_joints": joints}))
    return saved(folder, "m.urdf", urdf(machine, text))


def true_loops(machine, folder):
    """Links that are the children of two joints; the sockets are turned as the links of the first body are."""
    text = ""
    for ball in machine.balls:
        links, last, _ = turning(ball)
        turn = machine.pose(ball.body2).inverse() * machine.pose(ball.body1)
        socket = at(ball.xyz2, turn.rotation)
        text += links + f'<link name="{ball.name}_socket"/>'
        text += joint(f"{ball.name}_fix", "fixed", ball.body2, f"{ball.name}_socket", socket)
        text += joint(f"{ball.name}_turn", "continuous", last, f"{ball.name}_socket", at((0, 0, 0)), Z)
    return saved(folder, "m.urdf", urdf(machine, text))


def xacro(machine, folder):
    pytest.importorskip("xacro")
    macro = '<xacro:macro name="ball" params="name one two *at1 *at2"><loop name="${name}" type="spherical">'
    macro += '<predecessor link="${one}"><xacro:insert_block name="at1"/></predecessor>'
    macro += '<successor link="${two}"><xacro:insert_block name="at2"/></successor></loop></xacro:macro>'
    for ball in machine.balls:
        at1, at2 = (f'<origin xyz="{say(*xyz)}"/>' for xyz in (ball.xyz1, ball.xyz2))
        macro += f'<xacro:ball name="{ball.name}" one="{ball.body1}" two="{ball.body2}">{at1}{at2}</xacro:ball>'
    text = urdf(machine, macro).replace("<robot", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"', 1)
    return saved(folder, "m.urdf.xacro", text)


def sdf_link(machine, part):
    place, (xx, yy, zz) = machine.pose(part.name), part.moments
    return f"""<link name="{part.name}"><pose>{say(*place.translation)} {rpy(place)}</pose><inertial>
      <pose>{say(*part.com)} 0 0 0</pose><mass>{part.mass}</mass><inertia><ixx>{xx}</ixx><iyy>{yy}</iyy><izz>{zz}</izz>
      <ixy>0</ixy><ixz>0</ixz><iyz>0</iyz></inertia></inertial></link>"""


def sdf(machine, folder, ball_of="joint"):
    text = "".join(sdf_link(machine, part) for part in machine.parts)
    for part in (each for each in machine.parts if each.kind != "floating"):
        text += f"""<joint name="{part.joint}" type="{part.kind}"><parent>{part.parent or "world"}</parent>
          <child>{part.name}</child><axis><xyz>{say(*part.axis)}</xyz><dynamics><damping>{part.damping}</damping>
          </dynamics></axis></joint>"""
    for ball in machine.balls:
        if ball_of == "joint":
            text += f"""<joint name="{ball.name}" type="ball"><pose>{say(*ball.xyz2)} 0 0 0</pose>
              <parent>{ball.body1}</parent><child>{ball.body2}</child></joint>"""
        else:
            text += f"""<drake:ball_constraint><drake:ball_constraint_body_A>{ball.body1}</drake:ball_constraint_body_A>
              <drake:ball_constraint_body_B>{ball.body2}</drake:ball_constraint_body_B>
              <drake:ball_constraint_p_AP>{say(*ball.xyz1)}</drake:ball_constraint_p_AP>
              <drake:ball_constraint_p_BQ>{say(*ball.xyz2)}</drake:ball_constraint_p_BQ></drake:ball_constraint>"""
    model = f'<model name="{machine.name}">{text}</model>'
    return saved(folder, "m.sdf", f'<sdf version="1.7" xmlns:drake="http://drake.mit.edu">{model}</sdf>')


def mjcf(machine, folder):
    def body(part):
        kinds = {"revolute": "hinge", "prismatic": "slide"}
        moves = f'<joint name="{part.joint}" type="{kinds.get(part.kind)}" axis="{say(*part.axis)}" '
        moves += f'damping="{part.damping}"/>'
        moves = f'<freejoint name="{part.joint}"/>' if part.kind == "floating" else moves
        inside = "".join(map(body, machine.children(part.name)))
        return f"""<body name="{part.name}" pos="{say(*part.place.translation)}" quat="{say(*wxyz(part.place))}">{moves}
          <inertial pos="{say(*part.com)}" mass="{part.mass}" diaginertia="{say(*part.moments)}"/>{inside}</body>"""

    bodies = "".join(map(body, machine.children("")))
    text = f'<mujoco><compiler angle="radian"/><option gravity="0 0 -9.81"/><worldbody>{bodies}</worldbody>'
    return saved(folder, "m.xml", f"{text}<equality>{''.join(map(connect, machine.balls))}</equality></mujoco>")


def usd(machine, folder, flagged=True):
    """Frames of joints are Xforms in double precision; balls are outside of the articulation, or not."""
    pytest.importorskip("pxr.Usd")
    inside = {part.name: "" for part in machine.parts} | {"": ""}
    joints = ""

    def xform(name, place):
        numbers = ", ".join(map(repr, map(float, place.translation))), ", ".join(map(repr, wxyz(place)))
        return f"""def Xform "{name}" {{ double3 xformOp:translate = ({numbers[0]})
          quatd xformOp:orient = ({numbers[1]})
          uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:orient"]\n"""

    def between(schema, name, ends, more=""):
        targets = ""
        for number, (body, place) in enumerate(ends):
            inside[body] += xform(f"{name}_{number}", place) + "}\n"
            targets += f"rel physics:body{number} = <{f'/{body}' if body else ''}/{name}_{number}>\n"
        applied = '(prepend apiSchemas = ["PhysicsDriveAPI:linear"]) ' if "drive" in more else ""
        return f'def {schema} "{name}" {applied}{{ {targets} {more} }}\n'

    for part in (each for each in machine.parts if each.kind != "floating"):
        schema = {"revolute": "PhysicsRevoluteJoint", "prismatic": "PhysicsPrismaticJoint"}[part.kind]
        axis = f'uniform token physics:axis = "{"XYZ"[(X, Y, Z).index(part.axis)]}"\n'
        drive = f"float drive:linear:physics:damping = {part.damping}\n" if part.damping else ""
        joints += between(schema, part.joint, ((part.parent, part.place), (part.name, at((0, 0, 0)))), axis + drive)
    for ball in machine.balls:
        flag = f"bool physics:excludeFromArticulation = {int(flagged)}\n"
        ends = (ball.body1, at(ball.xyz1)), (ball.body2, at(ball.xyz2))
        joints += between("PhysicsSphericalJoint", ball.name, ends, flag)
    prims = inside.pop("")
    for part in machine.parts:
        moments, com = ", ".join(map(repr, part.moments)), ", ".join(map(repr, part.com))
        head = xform(part.name, machine.pose(part.name)).replace(
            " {", ' (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"]) {', 1
        )
        prims += f"""{head} float physics:mass = {part.mass}
          point3f physics:centerOfMass = ({com})
          float3 physics:diagonalInertia = ({moments})
          {inside[part.name]} }}\n"""
    return saved(folder, "m.usda", f'#usda 1.0\n(\n metersPerUnit = 1\n upAxis = "Z"\n)\n{prims}{joints}')


def webots(machine, folder):
    """Balls refer to solids; a body that floats is the end point of the first ball."""
    floating = {part.name for part in machine.parts if part.kind == "floating"}

    def physics(part):
        return f"""physics Physics {{ density -1 mass {part.mass} centerOfMass [ {say(*part.com)} ]
          inertiaMatrix [ {say(*part.moments)} 0 0 0 ] }}"""

    def solid(part, place):
        turn = pin.AngleAxis(place.rotation)
        return f"""endPoint Solid {{ translation {say(*place.translation)} rotation {say(*turn.axis)} {turn.angle!r}
          name "{part.name}" children [ {"".join(children(part.name))} ] {physics(part)} }}"""

    def moving(part):
        slides = part.kind == "prismatic"
        axis = part.place.rotation @ np.array(part.axis)
        anchor = "" if slides else f"anchor {say(*part.place.translation)}"
        return f"""{"SliderJoint" if slides else "HingeJoint"} {{ jointParameters
          {"JointParameters" if slides else "HingeJointParameters"} {{ axis {say(*axis)} {anchor}
          dampingConstant {part.damping} }} device [ PositionSensor {{ name "{part.joint}" }} ]
          {solid(part, part.place)} }}"""

    def ball(one):
        end = f'endPoint SolidReference {{ solidName "{one.body2}" }}'
        if one.body2 in floating:
            floating.remove(one.body2)
            part = next(part for part in machine.parts if part.name == one.body2)
            end = solid(part, machine.pose(one.body1).inverse() * machine.pose(one.body2))
        return f"BallJoint {{ jointParameters BallJointParameters {{ anchor {say(*one.xyz1)} }} {end} }}"

    def children(name):
        yield from (moving(part) for part in machine.children(name) if part.kind != "floating")
        yield from (ball(one) for one in machine.balls if one.body1 == name)

    inside = "".join(children(""))
    text = f'#VRML_SIM R2023b utf8\nWorldInfo {{ gravity 9.81 }}\nRobot {{ children [ {inside} ] name "r" }}\n'
    return saved(folder, "m.wbt", text)


def in_code(machine, folder=None):
    model, joints = machine.model()
    balls = [
        pin.PointAnchorConstraintModel(model, joints[ball.body1], at(ball.xyz1), joints[ball.body2], at(ball.xyz2))
        for ball in machine.balls
    ]
    return pc.load(model, loops=balls)


def written(machine, folder, suffix):
    if suffix == ".usda":
        pytest.importorskip("pxr.Usd")
    return pc.load(pc.write(in_code(machine), folder / f"m{suffix}"))


WAYS = {
    way.__name__: way
    for way in (
        loop_file,
        mujoco_in_urdf,
        loop_closures,
        closures,
        closing_joints,
        true_loops,
        xacro,
        sdf,
        mjcf,
        usd,
        webots,
    )
}
WAYS |= {
    way.__name__: partial(with_elements, write=way) for way in (loop_joint, urdf_plus, constraint, gazebo_joint, drake)
}
WAYS |= {
    "closing_frames": frames(("closing_{}_1", "closing_{}_2")),
    "closedloop_frames": frames(("closedloop3D_{}_A", "closedloop3D_{}_B")),
    "detachable_joint": lambda machine, folder: with_elements(machine, folder, partial(detachable, model=machine.name)),
    "drake_in_sdf": partial(sdf, ball_of="drake"),
    "usd_without_flags": partial(usd, flagged=False),
}
WAYS |= {f"{suffix[1:]}_written": partial(written, suffix=suffix) for suffix in (".urdf", ".sdf", ".xml", ".usda")}


def motion(mech, joints):
    """Positions and velocities of joints, from rest at zero."""
    sol = pc.simulate(mech, (0.0, SPAN), method="Radau", rtol=1e-12, atol=1e-12, t_eval=np.linspace(0.0, SPAN, 6))
    assert sol.success
    columns = [(mech.model.idx_qs[i], mech.model.idx_vs[i]) for i in map(mech.model.getJointId, joints)]
    q, v = zip(*columns, strict=True)
    return sol.q[:, q], sol.v[:, v]


@pytest.fixture(scope="module")
def references():
    found = {}
    for name, build in MACHINES.items():
        machine = build()
        found[name] = motion(in_code(machine), machine.compared)
    return found


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("name", MACHINES)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_one_motion(tmp_path, references, name, way):
    machine = MACHINES[name]()
    for mine, theirs in zip(motion(WAYS[way](machine, tmp_path), machine.compared), references[name], strict=True):
        assert np.abs(theirs).max() > 0.05
        np.testing.assert_allclose(mine, theirs, rtol=0, atol=1e-9)


@pytest.mark.parametrize("suffix", [".urdf", ".sdf", ".xml", ".usda"])
@pytest.mark.parametrize("name", MACHINES)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_round_trips_have_the_same_accelerations(tmp_path, name, suffix):
    mech = in_code(MACHINES[name]())
    back = written(MACHINES[name](), tmp_path, suffix)
    require_same_motion(mech, back, None if suffix == ".urdf" else in_world(mech), tolerance=1e-12)


@pytest.mark.parametrize("name", MACHINES)
def test_mujoco_has_the_same_masses_and_closed_loops(tmp_path, name):
    mujoco = pytest.importorskip("mujoco")
    machine = MACHINES[name]()
    mech = in_code(machine)
    model = mujoco.MjModel.from_xml_path(str(pc.write(mech, tmp_path / "m.xml")))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    theirs = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(*((model, data, theirs) if mujoco.__version__ >= "3.4" else (model, theirs, data.qM)))
    ours = np.diag(pin.crba(mech.model, mech.model.createData(), mech.guess))
    np.testing.assert_allclose(np.diag(theirs)[: len(ours)], ours, rtol=1e-12)
    assert model.neq == len(machine.balls)
    assert np.abs(data.efc_pos[: 3 * model.neq]).max() < 1e-12


@pytest.mark.parametrize("name", MACHINES)
def test_usd_core_finds_all_bodies_and_joints(tmp_path, name):
    Usd = pytest.importorskip("pxr.Usd")
    physics = pytest.importorskip("pxr.UsdPhysics")
    machine = MACHINES[name]()
    stage = Usd.Stage.Open(str(pc.write(in_code(machine), tmp_path / "m.usda")))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        found = physics.LoadUsdPhysicsFromRange(stage, ["/"])
    counts = {str(kind).rpartition(".")[2]: len(list(prims[0])) for kind, prims in found.items()}
    assert counts["RigidBody"] == len(machine.parts)
    slides = sum(part.kind == "prismatic" for part in machine.parts)
    hinges = sum(part.kind == "revolute" for part in machine.parts)
    assert (counts.get("PrismaticJoint", 0), counts["RevoluteJoint"], counts["D6Joint"]) == (
        slides, hinges, len(machine.balls))  # fmt: skip


@pytest.mark.parametrize("name", MACHINES)
def test_urdfdom_reads_the_same_tree(tmp_path, name):
    mech = in_code(MACHINES[name]())
    model = pin.buildModelFromUrdf(str(pc.write(mech, tmp_path / "m.urdf")))
    q, ours = pin.neutral(model), pin.neutral(mech.model)
    assert sorted(model.names) == sorted(mech.model.names)
    data, own = model.createData(), mech.model.createData()
    pin.centerOfMass(model, data, q)
    pin.centerOfMass(mech.model, own, ours)
    np.testing.assert_allclose(data.com[0], own.com[0], atol=1e-12)
    np.testing.assert_allclose(
        pin.computeTotalMass(model), sum(part.mass for part in MACHINES[name]().parts), rtol=1e-14
    )
