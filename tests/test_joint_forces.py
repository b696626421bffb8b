"""What joints of the tree transmit: Newton and Euler for each link by hand, MuJoCo, weights; loads that loops share."""

import pickle

import numpy as np
import pinocchio as pin
import pytest

import pinconsist as pc

G = 9.81
X, Y, Z = np.eye(3)


class Builder:
    """A tree of links with random masses, centres of mass off their axes, and full inertias."""

    def __init__(self, seed):
        self.model, self.rng = pin.Model(), np.random.default_rng(seed)

    def link(self, name, parent, joint, place=(0, 0, 0), mass=1.0):
        parent = self.model.getJointId(parent) if parent else 0
        index = self.model.addJoint(parent, joint, pin.SE3(np.eye(3), np.array(place, float)), name)
        root = self.rng.normal(size=(3, 3)) * 0.2
        inertia = pin.Inertia(mass, self.rng.uniform(-0.2, 0.2, 3), mass * (root @ root.T + 0.02 * np.eye(3)))
        self.model.appendBodyToJoint(index, inertia, pin.SE3.Identity())
        self.model.addFrame(pin.Frame(f"{name}_link", index, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
        return name

    def cylinder(self, name, parent, place):
        self.link(f"{name}_barrel", parent, pin.JointModelRY(), place, 12)
        self.link(f"{name}_rod", f"{name}_barrel", pin.JointModelPX(), mass=7)


def excavator():
    """Boom, stick and bucket with a cylinder each, the bucket's by rocker and link; the parts are not in one plane."""
    make = Builder(1)
    make.link("boom", None, pin.JointModelRY(), (0, 0, 0.5), 200)
    make.link("stick", "boom", pin.JointModelRY(), (3, 0.1, 0), 90)
    make.link("bucket", "stick", pin.JointModelRY(), (2, 0, 0), 60)
    make.link("rocker", "stick", pin.JointModelRY(), (1.7, 0.05, 0), 8)
    make.link("tie", "rocker", pin.JointModelRY(), (0, 0, 0.4), 5)
    make.cylinder("k", "stick", (0.2, 0, 0.5))
    make.cylinder("s", "boom", (1.2, 0, 0.6))
    make.cylinder("b", None, (0.5, 0, 0))
    loops = [
        pc.Loop("b_pin", "hinge", "b_rod_link", "boom_link", xyz2=(1.5, 0, 0.3), axis=(0, 1, 0)),
        pc.Loop("s_pin", "point", "s_rod_link", "stick_link", xyz2=(-0.5, -0.1, 0.2)),
        pc.Loop("k_pin", "point", "k_rod_link", "rocker_link", xyz2=(0, -0.05, 0.4)),
        pc.Loop(
            "tie_pin", "hinge", "tie_link", "bucket_link", xyz1=(0.35, 0.0, 0), xyz2=(0, 0.05, 0.35), axis=(0, 1, 0)
        ),
    ]
    forces = [
        pc.JointDamping({"boom": 3.0, "b_rod": 800.0}),
        {"b_rod": 9000.0, "s_rod": -2000.0, "k_rod": 500.0},
        pc.SpringDamper("bucket_link", "boom_link", 900.0, 1.0, 40.0, xyz1=(0.3, 0.2, -0.1), xyz2=(0.2, 0.1, 0.5)),
        pc.Wrench("bucket_link", (300.0, -50.0, 700.0), (5.0, 20.0, -8.0), axes="local", xyz=(0.6, 0.1, -0.3)),
    ]
    guess = {"boom": -0.5, "stick": 1.1, "bucket": 0.7, "b_barrel": -1.0, "b_rod": 1.0, "s_rod": 1.6, "k_rod": 1.5}
    return pc.Mechanism(make.model, loops, forces, "excavator", guess)


def ankle():
    """A universal joint of two hinges, moved by two motors through pushrods with ball joints; on a floating shank."""
    make = Builder(2)
    make.link("shank", None, pin.JointModelFreeFlyer(), mass=4)
    make.link("pitch", "shank", pin.JointModelRY(), (0, 0, -0.3), 0.3)
    make.link("roll", "pitch", pin.JointModelRX(), mass=1.1)
    loops = []
    for side, y in (("l", 0.05), ("r", -0.05)):
        make.link(f"{side}_crank", "shank", pin.JointModelRY(), (0, y, -0.05), 0.2)
        make.link(f"{side}_rod", f"{side}_crank", pin.JointModelSpherical(), (0.06, 0, 0), 0.15)
        heel = (0.06, y, 0.0)
        loops.append(pc.Loop(f"{side}_ball", "point", f"{side}_rod_link", "roll_link", xyz1=(0, 0, -0.25), xyz2=heel))
    forces = [{"l_crank": 2.0, "r_crank": -1.0}, pc.Wrench("roll_link", (3.0, -4.0, 60.0), xyz=(0.05, 0, -0.05))]
    return pc.Mechanism(make.model, loops, forces, "ankle")


def stewart():
    return pc.load("stewart_platform")


def bricard():
    return pc.load("bricard")


MACHINES = (excavator, ankle, stewart, bricard)


def newton_euler(mech, sol, i):
    """What is missing to the balance of each link, [force, moment about the centre of mass], (njoints - 1, 2, 3).

    Only poses and motions of single bodies come from Pinocchio; forces are those of the solution, by their names.
    """
    model, data = mech.model, mech.model.createData()
    pin.forwardKinematics(model, data, sol.q[i], sol.v[i], sol.acceleration()[i])
    pin.updateFramePlacements(model, data)
    left, largest = np.zeros((model.njoints, 2, 3)), 0.0
    centres = [data.oMi[k].act(model.inertias[k].lever) for k in range(model.njoints)]

    def act(body, point, force, moment=(0.0, 0.0, 0.0)):
        left[body] += force, moment + np.cross(point - centres[body], force)
        return np.abs(force).max()

    for k in range(1, model.njoints):
        inertia, at = model.inertias[k], pin.SE3(np.eye(3), model.inertias[k].lever)
        linear = pin.getFrameClassicalAcceleration(model, data, k, at, pin.LOCAL_WORLD_ALIGNED).linear
        R = data.oMi[k].rotation
        spin, spin_rate, about = R @ data.v[k].angular, R @ data.a[k].angular, R @ inertia.inertia @ R.T
        left[k, 0] -= inertia.mass * (linear - model.gravity.linear)
        left[k, 1] -= about @ spin_rate + np.cross(spin, about @ spin)
        found = sol.joint_force(model.names[k])
        largest = max(largest, act(k, data.oMi[k].translation, found.force[i], found.moment[i]))
        act(model.parents[k], data.oMi[k].translation, -found.force[i], -found.moment[i])
    for loop in mech.anchored_loops:
        found = sol.reaction(loop.name)
        frames = [model.frames[model.getFrameId(name)] for name in (loop.frame1, loop.frame2)]
        point = (data.oMf[model.getFrameId(loop.frame2)] * loop.placement2).translation
        act(frames[1].parentJoint, point, found.force[i], found.moment[i])
        act(frames[0].parentJoint, point, -found.force[i], -found.moment[i])
    for force in mech.forces:
        if isinstance(force, pc.SpringDamper):
            ends = [data.oMf[model.getFrameId(f)] for f in (force.frame1, force.frame2)]
            a, b = ends[0].act(np.array(force.xyz1)), ends[1].act(np.array(force.xyz2))
            pull = sol.force(force.label).force[i] * (b - a) / np.linalg.norm(b - a)
            act(model.frames[model.getFrameId(force.frame1)].parentJoint, a, pull)
            act(model.frames[model.getFrameId(force.frame2)].parentJoint, b, -pull)
        elif isinstance(force, pc.Wrench):
            pose = data.oMf[model.getFrameId(force.frame)]
            turn = pose.rotation if force.axes == "local" else np.eye(3)
            body = model.frames[model.getFrameId(force.frame)].parentJoint
            act(body, pose.act(np.array(force.xyz)), turn @ force.force, turn @ force.moment)
    return left[1:], largest


@pytest.mark.parametrize("machine", MACHINES, ids=lambda each: each.__name__)
def test_every_link_is_in_balance(machine):
    mech = machine()
    sol = pc.simulate(mech, (0.0, 0.3), t_eval=np.linspace(0.0, 0.3, 4))
    assert sol.success and np.abs(sol.v[-1]).max() > 0.01
    for i in range(len(sol.t)):
        left, largest = newton_euler(mech, sol, i)
        assert np.abs(left).max() < 1e-9 * largest


JOINTS = {
    "RX": pin.JointModelRX(),
    "RUBZ": pin.JointModelRUBZ(),
    "oblique": pin.JointModelRevoluteUnaligned(np.array([0.6, 0.0, 0.8])),
    "PY": pin.JointModelPY(),
    "slide": pin.JointModelPrismaticUnaligned(np.array([0.0, 0.6, 0.8])),
    "ball": pin.JointModelSpherical(),
    "euler": pin.JointModelSphericalZYX(),
    "translation": pin.JointModelTranslation(),
    "planar": pin.JointModelPlanar(),
    "free": pin.JointModelFreeFlyer(),
    "universal": pin.JointModelUniversal(X, Y),
    "helical": pin.JointModelHZ(0.1),
}


def composite():
    joint = pin.JointModelComposite()
    joint.addJoint(pin.JointModelRX(), pin.SE3.Identity())
    joint.addJoint(pin.JointModelPZ(), pin.SE3(np.eye(3), 0.3 * Y))
    return joint


@pytest.mark.parametrize("kind", [*JOINTS, "composite"])
def test_a_joint_of_any_type_balances_its_links_and_carries_its_torques_along_its_free_axes(kind):
    make = Builder(3)
    make.link("arm", None, pin.JointModelRY(), (0.1, 0.2, 0.3))
    make.link("held", "arm", JOINTS.get(kind) or composite(), (0.4, -0.1, 0.2))
    make.link("hand", "held", pin.JointModelRX(), (0.0, 0.3, 0.1))
    count = make.model.nvs[2]
    forces = [{"arm": 1.5}, {"held": 1.0 if count == 1 else tuple(np.arange(1.0, 1 + count))}]
    forces += [pc.Wrench("hand_link", (1.0, -2.0, 3.0), (0.1, 0.2, 0.3), xyz=(0.1, 0.0, 0.2))]
    mech = pc.Mechanism(make.model, forces=forces)
    v0 = np.random.default_rng(4).normal(size=mech.nv)
    sol = pc.simulate(mech, (0.0, 0.2), v0=v0, t_eval=[0.0, 0.1, 0.2])
    found = sol.joint_force("held", axes="joint")
    for i in range(len(sol.t)):
        left, largest = newton_euler(mech, sol, i)
        assert np.abs(left).max() < 1e-9 * largest
        data = mech.model.createData()
        pin.forwardKinematics(mech.model, data, sol.q[i])
        free = data.joints[2].S  # twist of the child per velocity of the joint, in its axes
        carried = free.reshape(6, -1).T @ np.concatenate((found.force[i], found.moment[i]))
        np.testing.assert_allclose(carried, np.arange(1.0, 1 + count), atol=1e-9 * largest)


HANGING = {"x": (0, 0, 0), "y": (0.3, -1.2, 0.5)}  # roll, pitch, yaw of the joint in the ground


@pytest.mark.parametrize("rpy", HANGING.values(), ids=HANGING)
def test_a_hanging_weight(rpy):
    """The child is pulled up by its weight; the moment about the joint is that of the weight, turned round."""
    model, turn, centre = pin.Model(), pin.rpy.rpyToMatrix(*rpy), np.array([0.2, -0.1, -0.4])
    index = model.addJoint(0, pin.JointModelPX(), pin.SE3(turn, np.array([1.0, 2.0, 3.0])), "rail")
    model.appendBodyToJoint(index, pin.Inertia(2.0, centre, np.eye(3)), pin.SE3.Identity())
    weight = -2.0 * G * Z
    held = float(-(turn.T @ weight)[0])
    mech = pc.Mechanism(model, forces=[{"rail": held}])
    for result in (pc.simulate(mech, (0.0, 0.2)), pc.simulate(mech, (0.2, 0.0)), pc.equilibrium(mech)):
        found = result.joint_force("rail")
        np.testing.assert_allclose(found.force, [-weight] * len(found.t), atol=1e-12)
        np.testing.assert_allclose(found.moment, [-np.cross(turn @ centre, weight)] * len(found.t), atol=1e-12)
        local = result.joint_force("rail", axes="joint")
        np.testing.assert_allclose(local.force @ turn.T, found.force, atol=1e-12)
        np.testing.assert_allclose(local.moment @ turn.T, found.moment, atol=1e-12)
        np.testing.assert_allclose(local.force[:, 0], held, atol=1e-12)
        np.testing.assert_array_equal(result.reaction("rail").force, found.force)
    assert (
        str(found) == "joint 'rail' of the tree, on its child: force [N] up to 19.62, moment [N·m] up to 4.387"
        or rpy[0]
    )


MJCF = """
<mujoco>
  <option gravity="0.5 -1 -9.81"/>
  <worldbody>
    <body name="base" pos="0 0 1" euler="10 20 30">
      <freejoint name="base"/>
      <inertial pos="0.02 0.01 0.03" mass="5" fullinertia="0.1 0.2 0.15 0.01 0.02 -0.01"/>
      <body name="hip" pos="0.1 0.2 -0.1" euler="40 0 10">
        <joint name="hip" type="hinge" axis="1 2 0.5" damping="0.3" armature="0.02"/>
        <inertial pos="0.1 0 -0.2" mass="1.5" fullinertia="0.03 0.02 0.025 0.001 0 0.002"/>
        <body name="slide" pos="0 0 -0.3">
          <joint name="slide" type="slide" axis="0 0.2 1" stiffness="30"/>
          <inertial pos="0 0.1 0" mass="0.7" diaginertia="0.01 0.02 0.03"/>
          <body name="foot" pos="0 0 -0.2">
            <joint name="foot" type="ball"/>
            <inertial pos="0.05 0.02 -0.1" mass="0.4" diaginertia="0.003 0.002 0.001"/>
          </body>
        </body>
      </body>
      <body name="arm" pos="-0.1 0 0.3" euler="0 90 0">
        <joint name="arm" type="hinge" axis="0 1 0"/>
        <inertial pos="0.3 0 0" mass="0.9" diaginertia="0.01 0.05 0.05"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def test_mujoco_has_the_same_forces(tmp_path):
    """``cfrc_int``: torque and force of each body's joint on it, about the centre of mass of its tree."""
    mujoco = pytest.importorskip("mujoco")
    (tmp_path / "tree.xml").write_text(MJCF)
    mech = pc.load(tmp_path / "tree.xml")
    v0 = np.random.default_rng(5).normal(size=mech.nv)
    sol = pc.simulate(mech, (0.0, 0.3), v0=v0, forces=[{"arm": 2.0}], t_eval=[0.0, 0.3])
    model = mujoco.MjModel.from_xml_string(MJCF)
    data, a = mujoco.MjData(model), sol.acceleration()
    for i in range(len(sol.t)):
        placed(model, data, mech, sol.q[i], sol.v[i], a[i])
        for joint in mech.joints:
            body = model.body(joint).id
            torque, force = data.cfrc_int[body].reshape(2, 3)
            about = data.xpos[body] - data.subtree_com[model.body_rootid[body]]
            found = sol.joint_force(joint)
            size = 5.0 * G
            np.testing.assert_allclose(found.force[i], force, atol=1e-9 * size)
            np.testing.assert_allclose(found.moment[i], torque - np.cross(about, force), atol=1e-9 * size)
        assert np.abs(sol.joint_force("base").force).max() < 1e-9 < np.abs(sol.joint_force("arm").force).max()


def placed(model, data, mech, q, v, a):
    """MuJoCo's inverse dynamics at a state of Pinocchio's, whose free joint has its velocities in local axes."""
    import mujoco

    names, linear = mech.model, {}
    for joint in mech.joints:
        index = mech.joint_index(joint)
        at, to = names.idx_qs[index], model.joint(joint).qposadr[0]
        values = q[at : at + names.nqs[index]].copy()
        if len(values) in (4, 7):  # w first
            values[-4:] = values[[-1, -4, -3, -2]]
        data.qpos[to : to + len(values)] = values
        columns, to = mech.columns(joint), model.joint(joint).dofadr[0]
        rates, second = v[columns].copy(), a[columns].copy()
        if len(rates) == 6:
            R = pin.Quaternion(q[at + 3 : at + 7]).matrix()
            second[:3] = R @ (a[columns][:3] + np.cross(rates[3:], rates[:3]))
            rates[:3] = R @ rates[:3]
        data.qvel[to : to + len(rates)], linear[joint] = rates, (to, second)
    mujoco.mj_forward(model, data)
    for to, second in linear.values():
        data.qacc[to : to + len(second)] = second
    mujoco.mj_rnePostConstraint(model, data)


DOOR, HIGH, WIDE = 30.0, 1.8, 0.4  # kg; m from the lower to the upper hinge, and from their line to the centre of mass


def door_with_tree_hinge():
    """A door on two hinges along z, the upper one in the tree, the lower one a loop: all its rows are redundant."""
    model = pin.Model()
    index = model.addJoint(0, pin.JointModelRZ(), pin.SE3(np.eye(3), 2.0 * Z), "upper")
    inertia = pin.Inertia(DOOR, np.array([WIDE, 0, -0.9]), np.diag([9.0, 11.0, 3.0]))
    model.appendBodyToJoint(index, inertia, pin.SE3.Identity())
    model.addFrame(pin.Frame("door", index, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    below = {"xyz1": (0, 0, 2.0 - HIGH), "xyz2": (0, 0, -HIGH), "axis": (0, 0, 1)}
    return pc.Mechanism(model, [pc.Loop("lower", "hinge", "universe", "door", **below)], name="door")


def door_on_points(*kinds):
    """A free door on two balls along z, as loops of these kinds and names."""
    model = pin.Model()
    index = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "door")
    inertia = pin.Inertia(DOOR, np.array([WIDE, 0, 1.1]), np.diag([9.0, 11.0, 3.0]))
    model.appendBodyToJoint(index, inertia, pin.SE3.Identity())
    model.addFrame(pin.Frame("panel", index, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    ends = {"upper": (0, 0, 2.0), "lower": (0, 0, 2.0 - HIGH)}
    return pc.Mechanism(model, [pc.Loop(name, "point", "universe", "panel", at, xyz2=at) for name, at in ends.items()])


ALL = ("force x", "force y", "force z", "moment x", "moment y")


def test_a_door_on_two_hinges_says_that_its_hinges_are_not_unique():
    """At rest: m g on both together; the couple H of the hinges holds m g WIDE = H HIGH."""
    mech = door_with_tree_hinge()
    sol = pc.simulate(mech, (0.0, 0.3))
    lower, upper = sol.reaction("lower"), sol.joint_force("upper")
    for found, other, place in ((lower, "upper", 2.0 - HIGH), (upper, "lower", 2.0)):
        assert found.not_unique == ALL and found.shared_with == (other,)
        assert f"how it shares its load with {other}: see resultant_force, or pass a compliance=" in str(found)
        np.testing.assert_allclose(found.resultant_force, [DOOR * G * Z] * len(sol.t), atol=1e-9)
        moment = -np.cross([WIDE, 0, 1.1 - place], -DOOR * G * Z)  # about the hinge
        np.testing.assert_allclose(found.resultant_moment, [moment] * len(sol.t), atol=1e-9)
    certificate = sol.check()
    loaded = ("force x", "force z", "moment y")  # at rest nothing pushes along the hinges' y
    assert certificate.not_unique == {"lower": loaded, "upper": loaded}
    assert "ok; not unique: forces of lower, upper" in certificate.verdict and certificate.ok
    assert "not unique" in "".join(str(certificate).splitlines()[1:])
    balls = {"compliance": {"upper": (1e-8, 1e3), "lower": (1e-8, 1e3)}}  # so soft for moments that they carry none
    lower, upper = sol.reaction("lower", **balls), sol.joint_force("upper", **balls)
    couple = DOOR * G * WIDE / HIGH
    np.testing.assert_allclose(lower.force[-1], [couple, 0, DOOR * G / 2], atol=1e-6)
    np.testing.assert_allclose(upper.force[-1], [-couple, 0, DOOR * G / 2], atol=1e-6)
    assert lower.not_unique == upper.not_unique == lower.shared_with == ()
    turned = sol.reaction("lower", axes="anchor", **balls).force  # the anchor of the ground does not turn
    np.testing.assert_allclose(turned, lower.force, atol=1e-12)


def test_the_distribution_does_not_depend_on_where_the_tree_is_cut_if_compliances_are_given():
    soft = {"upper": (3e-8, 2e-6), "lower": (1e-8, 5e-6)}
    tree, free = door_with_tree_hinge(), door_on_points()
    hinges = [
        pc.Loop(each.name, "hinge", *("universe", "panel"), each.xyz1, xyz2=each.xyz2, axis=(0, 0, 1))
        for each in free.loops
    ]
    free = free.with_loops(*hinges)
    one = pc.simulate(tree, (0.0, 0.4), v0={"upper": 2.0}, t_eval=[0.4])
    two = pc.simulate(free, (0.0, 0.4), v0={"door": (0, 0, 0, 0, 0, 2.0)}, t_eval=[0.4])
    assert np.abs(one.reaction("lower").force - two.reaction("lower").force).max() > 1.0  # without
    for name in soft:
        here, there = (each.reaction(name, compliance=soft) for each in (one, two))
        assert here.not_unique == there.not_unique == ()
        np.testing.assert_allclose(here.force, there.force, atol=1e-5)
        np.testing.assert_allclose(here.moment, there.moment, atol=1e-5)


def test_stiff_springs_tend_to_the_forces_of_compliances():
    """A door on two balls, and on two springs of no length: the difference is halved when they are twice as stiff."""
    mech, apart = door_on_points(), []
    rigid = pc.equilibrium(mech)
    soft = {"upper": 1.0, "lower": 0.4}  # only their ratio matters
    expected = {name: rigid.reaction(name, compliance=soft).force[0] for name in soft}
    assert expected["lower"][2] == pytest.approx(DOOR * G / 1.4, rel=1e-9)
    assert rigid.reaction("lower").force[0][2] == pytest.approx(DOOR * G / 2, rel=1e-9)
    for scale in (1e-6, 0.5e-6):
        springs = [
            pc.SpringDamper("universe", "panel", 1.0 / (scale * soft[loop.name]), xyz1=loop.xyz1, xyz2=loop.xyz2)
            for loop in mech.loops
        ]
        hanging = pc.Mechanism(mech.model, forces=springs)
        q = pc.equilibrium(hanging, rigid.q).q
        pose = pin.XYZQUATToSE3(q)
        moved = {loop.name: pose.act(np.array(loop.xyz2)) - np.array(loop.xyz1) for loop in mech.loops}
        forces = {name: -moved[name] / (scale * soft[name]) for name in soft}
        apart.append(max(np.abs(forces[name] - expected[name]).max() for name in soft))
    assert apart[0] < 0.05 and apart[0] / apart[1] == pytest.approx(2.0, rel=0.05)


def test_in_motion_damped_springs_follow_the_forces_of_compliances():
    """A swinging door on two springs, a hundred times as stiff as its weight needs for a tenth of a millimetre."""
    mech, soft = door_on_points(), {"upper": 1e-8, "lower": 4e-9}
    v0 = {"door": (0, 0, 0, 0, 0, 2.0)}
    rigid = pc.simulate(mech, (0.0, 0.5), v0=v0, t_eval=[0.5])
    q0 = pc.equilibrium(mech).q
    springs = [
        pc.SpringDamper(
            "universe", "panel", 1.0 / soft[each.name], 0.0, 2e4 / soft[each.name] / 1e8, each.xyz1, each.xyz2
        )
        for each in mech.loops
    ]
    hanging = pc.Mechanism(mech.model, forces=springs)
    q0 = pc.equilibrium(hanging, q0).q
    sol = pc.simulate(hanging, (0.0, 0.5), q0, v0, method="Radau", t_eval=[0.5])
    for name, spring in zip(soft, springs, strict=True):
        pose = pin.XYZQUATToSE3(sol.q[0])
        pull = -(pose.act(np.array(spring.xyz2)) - np.array(spring.xyz1)) * spring.stiffness
        np.testing.assert_allclose(pull, rigid.reaction(name, compliance=soft).force[0], atol=0.01 * DOOR * G)


HALF, ANGLE, BROAD, BAR, LOAD, AHEAD = 1.2, 0.5, 0.4, 15.0, 80.0, 0.7  # m, rad, m, kg, kg, m


def scissor_lift(aside=0.0):
    """Two bars with a pin at each side, the right one a loop; a platform on them, its centre of mass `aside`."""
    model = pin.Model()
    bar = pin.Inertia(BAR, np.array([HALF, 0, 0]), np.diag([0.5, 8.0, 8.0]))
    one = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "one")
    two = model.addJoint(one, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([HALF, -BROAD, 0])), "left")
    top = model.addJoint(two, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([-HALF, BROAD, 0])), "platform")
    shoe = model.addJoint(top, pin.JointModelPX(), pin.SE3.Identity(), "shoe")
    foot = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "foot")
    across = pin.Inertia(BAR, np.array([0, BROAD, 0]), np.diag([0.5, 8.0, 8.0]))
    load = pin.Inertia(LOAD, np.array([AHEAD, aside, 0.1]), 10.0 * np.eye(3))
    bodies = {"bar1": (one, bar), "bar2": (two, across), "deck": (top, load)}
    bodies |= {"shoe": (shoe, pin.Inertia.Zero()), "foot": (foot, pin.Inertia.Zero())}
    for name, (joint, inertia) in bodies.items():
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
        model.addFrame(pin.Frame(name, joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    loops = [
        pc.Loop("right", "hinge", "bar1", "bar2", (HALF, BROAD, 0), xyz2=(0, 2 * BROAD, 0), axis=(0, 1, 0)),
        pc.Loop("rest", "hinge", "shoe", "bar1", xyz2=(2 * HALF, 0, 0), axis=(0, 1, 0)),
        pc.Loop("floor", "hinge", "foot", "bar2", xyz2=(HALF, BROAD, 0), axis=(0, 1, 0)),
        pc.Drive("jack", "one", lambda t: -ANGLE),
    ]
    guess = {"one": -ANGLE, "left": 2 * ANGLE, "platform": -ANGLE, "shoe": 2.0, "foot": 2.0}
    return pc.Mechanism(model, loops, name="scissor lift", guess=guess)


def test_the_two_sides_of_a_scissor_lift_share_a_load_that_is_known_in_sum():
    """Bar 2 by hand: the deck presses V on its upper end, and pins together hold its weight and 2 V."""
    deck = LOAD * G * (1.0 - AHEAD / (2 * HALF * np.cos(ANGLE)))
    total = BAR * G + 2 * deck
    for result in (pc.simulate(scissor_lift(), (0.0, 0.1)), pc.inverse_dynamics(scissor_lift(), [0.0])):
        left, right = result.joint_force("left"), result.reaction("right")
        assert left.shared_with and right.shared_with and {"force z"} < set(right.not_unique)
        assert set(left.resultant_of) == set(right.resultant_of) == {"left", "right"}
        np.testing.assert_allclose(left.resultant_force[-1], [0, 0, total], atol=1e-6)
        assert np.isnan(left.resultant_moment[-1][0])  # bars, deck and feet can press sideways, too
        np.testing.assert_allclose(left.force[-1] + right.force[-1], [0, 0, total], atol=1e-6)
        same = {"compliance": {"left": 1e-8, "right": 1e-8}}
        for found in (result.joint_force("left", **same), result.reaction("right", **same)):
            assert found.force[-1][2] == pytest.approx(total / 2, rel=1e-6)
        np.testing.assert_allclose(result.joint_force("platform").force[-1][2], deck, rtol=1e-6)
        assert "force x" not in result.joint_force("platform").not_unique


def test_of_a_planar_mechanism_only_what_is_across_its_plane_is_not_unique():
    mech = pc.load("four_bar")
    sol = pc.simulate(mech, (0.0, 0.2))
    for found in (sol.reaction("coupler_rocker"), *(sol.joint_force(joint) for joint in mech.joints)):
        assert found.not_unique == ("force y", "moment x", "moment z")
        assert found.shared_with == () and found.resultant_force is None
    certificate = sol.check(error=False)
    assert certificate.not_unique == {} and "unique" not in str(certificate)
    aside = pc.simulate(mech.with_gravity((0, 3, -9)), (0.0, 0.2)).check(error=False)
    assert set(aside.not_unique) == {"crank", "coupler", "rocker", "coupler_rocker"}


def test_independent_loops_are_unique():
    sol = pc.simulate(pc.load("stewart_platform"), (0.0, 0.1))
    assert all(sol.reaction(loop.name).not_unique == () for loop in sol.system.mechanism.loops)
    loop = sol.system.mechanism.loops[0].name
    np.testing.assert_array_equal(sol.reaction(loop, compliance={loop: 1.0}).force, sol.reaction(loop).force)


def elements():
    """A crank with one element of each kind."""
    make = Builder(6)
    make.link("crank", None, pin.JointModelRY(), (0.1, 0.2, 0.3))
    make.link("rod", "crank", pin.JointModelPX(), (0.4, -0.1, 0.2))
    forces = [
        pc.SpringDamper("crank_link", "universe", 80.0, 0.3, 2.0, (0.3, 0.0, 0.1), (1.0, 0.2, 0.4)),
        pc.Wrench("rod_link", (1.0, 2.0, -3.0), (0.1, 0.2, 0.3), axes="local"),
        pc.Actuator("motor", "crank", gain=(2.0, 0.0, 0.0), bias=(0.0, -3.0, -0.1), gear=4.0, control=0.2),
        pc.JointSpring("rod", 50.0, 0.1),
        pc.Piecewise(pc.SpringDamper("rod_link", "universe", 20.0, xyz2=(0, 1, 0)), times=[0.05]),
        lambda t, q, v: -0.1 * v,
    ]
    return pc.Mechanism(make.model, forces=forces)


def test_forces_of_elements_by_their_labels():
    mech = elements()
    sol = pc.simulate(mech, (0.0, 0.3), t_eval=np.linspace(0.0, 0.3, 7))
    spring, crank = sol.force("crank_link"), sol.frame("crank_link")
    ends = crank.position + crank.rotation @ np.array([0.3, 0.0, 0.1]) - [1.0, 0.2, 0.4]
    np.testing.assert_allclose(spring.length, np.linalg.norm(ends, axis=1), rtol=1e-12)
    rate = np.einsum(
        "ni,ni->n", ends, crank.velocity + np.cross(crank.angular_velocity, crank.rotation @ [0.3, 0, 0.1])
    )
    np.testing.assert_allclose(spring.speed, rate / spring.length, atol=1e-12)
    np.testing.assert_allclose(spring.force, 80.0 * (spring.length - 0.3) + 2.0 * spring.speed, atol=1e-12)
    np.testing.assert_allclose((spring.torque * sol.v).sum(axis=1), -spring.force * spring.speed, atol=1e-12)
    wrench = sol.force("wrench rod_link")
    np.testing.assert_allclose(wrench.force, sol.frame("rod_link").rotation @ [1.0, 2.0, -3.0], atol=1e-12)
    np.testing.assert_allclose(wrench.moment, sol.frame("rod_link").rotation @ [0.1, 0.2, 0.3], atol=1e-12)
    motor, angle = sol.force("motor"), sol.position("crank")
    np.testing.assert_allclose(motor.length, 4.0 * angle, atol=1e-12)
    np.testing.assert_allclose(motor.force, 0.4 - 12.0 * angle - 0.4 * sol.velocity("crank"), atol=1e-12)
    np.testing.assert_allclose(motor.torque, 4.0 * motor.force, atol=1e-12)
    joint = sol.force("spring rod")
    assert joint.force is joint.length is joint.moment is None
    np.testing.assert_allclose(joint.torque, -50.0 * (sol.position("rod") - 0.1), atol=1e-12)
    assert str(spring).startswith("spring crank_link: force [N] up to ") and "torque" in str(joint)
    assert sol.force("spring rod_link").force.shape == (7,) and sol.force(
        "torque elements.<locals>.<lambda>"
    ).torque.shape == (7, 2)


def test_every_link_of_a_chain_with_all_elements_is_in_balance():
    mech = elements()
    sol = pc.simulate(mech, (0.0, 0.3), t_eval=[0.0, 0.02, 0.2])
    spring = mech.forces[4].force  # it has no direct record in the balance: by its force element
    for i in range(len(sol.t)):
        left, largest = newton_euler(mech, sol, i)
        place = sol.frame("rod_link").position[i]
        pull = sol.force(spring.label).force[i] * (np.array(spring.xyz2) - place) / sol.force(spring.label).length[i]
        centre = place + sol.frame("rod_link").rotation[i] @ mech.model.inertias[2].lever
        left[1] += pull, np.cross(place - centre, pull)
        assert np.abs(left).max() < 1e-9 * largest


def test_columns_of_forces_are_added_on_request(tmp_path):
    sol = pc.simulate(elements(), (0.0, 0.1), t_eval=[0.0, 0.1])
    plain, more = (tmp_path / f"{name}.csv" for name in ("plain", "more"))
    sol.to_csv(plain)
    sol.to_csv(more, forces=["crank", "spring crank_link", "motor", "spring rod", "wrench rod_link"])
    names, added = (path.read_text().splitlines()[0].split(",") for path in (plain, more))
    assert added[: len(names)] == names and added[len(names) :] == [
        *(f"force.crank.{axis} [N]" for axis in "xyz"), *(f"moment.crank.{axis} [N·m]" for axis in "xyz"),
        "force.spring crank_link [N]", "length.spring crank_link [m]", "speed.spring crank_link [m/s]",
        "force.motor [N·m]", "length.motor [rad]", "speed.motor [rad/s]", "torque.spring rod [N]",
        *(f"force.wrench rod_link.{axis} [N]" for axis in "xyz"),
        *(f"moment.wrench rod_link.{axis} [N·m]" for axis in "xyz"),
    ]  # fmt: skip
    values = np.genfromtxt(more, delimiter=",", skip_header=1)
    np.testing.assert_array_equal(values[:, len(names)], sol.joint_force("crank").force[:, 0])
    door = pc.simulate(door_with_tree_hinge(), (0.0, 0.1))
    door.to_csv(more, forces="upper")
    names = more.read_text().splitlines()[0].split(",")
    assert "lam.lower.z [N; not unique]" in names and "force.upper.z [N; not unique]" in names
    assert "lam.lower.y [N]" in names and "moment.upper.z [N·m]" in names


def test_questions_about_forces_are_answered(tmp_path):
    sol = pc.simulate(pc.load("four_bar"), (0.0, 0.1), forces=[{"crank": 1.0}])
    assert str(sol.reaction("rocker")).startswith("joint 'rocker' of the tree, on its child: force [N] up to ")
    for method, name, why in (
        ("force", "crankk", "no force 'crankk'; similar: torque crank; the forces are torque crank"),
        ("force", "rocker", r"'rocker' is a joint of the tree, not a force: use sol.joint_force\('rocker'\)"),
        ("force", "coupler_rocker", r"is a hinge, not a force: use sol.reaction\('coupler_rocker'\)"),
        ("joint_force", "coupler_rocker", r"is a loop, not a joint of the tree: use sol.reaction\('coupler_rocker'\)"),
        ("joint_force", "rockker", "no joint 'rockker'"),
    ):
        with pytest.raises(pc.InputError, match=why):
            getattr(sol, method)(name)
    with pytest.raises(pc.InputError, match="joint_force: axes='anchor' is not one of 'world', 'joint'"):
        sol.joint_force("rocker", axes="anchor")
    for wrong, why in (({}, "needs a mapping"), ({"pin": 1.0}, "no loop or joint"), ({"rocker": -1.0}, "at least 0")):
        with pytest.raises(pc.InputError, match=why):
            sol.reaction("coupler_rocker", compliance=wrong)
    read = pc.Solution.load(sol.save(tmp_path / "run"))
    with pytest.raises(pc.InputError, match=r"sol.joint_force\(…, mechanism\)"):
        read.joint_force("rocker")
    with pytest.raises(pc.InputError, match="the run had 1 forces besides the model's own, but this mechanism has 0"):
        read.joint_force("rocker", pc.load("four_bar"))
    again = read.joint_force("rocker", sol.system.mechanism)
    np.testing.assert_array_equal(again.force, sol.joint_force("rocker").force)


def test_fixed_joints_are_named(tmp_path):
    link = '<link name="{}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    joint = '<joint name="{}" type="{}"><parent link="{}"/><child link="{}"/></joint>'
    parts = [link.format(name) + "</inertial></link>" for name in "abc"]
    parts += [joint.format("pin", "continuous", "a", "b"), joint.format("weld", "fixed", "b", "c")]
    (tmp_path / "two.urdf").write_text(f'<robot name="two">{"".join(parts)}</robot>')
    sol = pc.simulate(pc.load(tmp_path / "two.urdf"), (0.0, 0.1))
    for method in (sol.joint_force, sol.reaction):
        with pytest.raises(pc.InputError, match="'weld' is fixed: what it joins is one body with that of joint 'pin'"):
            method("weld")
    assert np.abs(sol.joint_force("pin").force[:, 2] - 2.0 * G).max() < 1e-9


def test_motor_torques_have_the_forces_of_their_frames():
    act = pc.Actuation(pc.load("four_bar"), ["crank"])
    found = act.torques(forces={"coupler": (0.0, 0.0, -50.0)})
    total = sum(found.joint_force(joint).force[0] for joint in ("crank", "rocker"))
    weight = sum(inertia.mass for inertia in act.mechanism.model.inertias) * G
    np.testing.assert_allclose(total, [0, 0, weight + 50.0], atol=1e-9)
    np.testing.assert_allclose(found.joint_force("crank").moment[0][1], found.torques["crank"], atol=1e-9)


def pendulum():
    model = pin.Model()
    index = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "pin")
    model.appendBodyToJoint(index, pin.Inertia(2.0, np.array([0, 0, -0.7]), 0.05 * np.eye(3)), pin.SE3.Identity())
    return pc.Mechanism(model)


@pytest.mark.parametrize("span", [(0.0, 2.5), (2.5, 0.0)])
@pytest.mark.parametrize("dense", [False, True])
@pytest.mark.parametrize("method", ["BDF", "Radau"])
def test_the_peak_of_a_pin_is_between_the_rows(method, dense, span):
    """A pendulum pulls most at its lowest point: m g + m l ω², with m g l (1 - cos) = I ω² / 2."""
    start, how = 1.2, {"method": method, "dense_output": dense, "rtol": 1e-9, "atol": 1e-11}
    sol = pc.simulate(pendulum(), span, {"pin": start}, **how)
    found = sol.joint_force("pin")
    speed = 2.0 * 2.0 * G * 0.7 * (1.0 - np.cos(start)) / (0.05 + 2.0 * 0.7**2)
    largest = 2.0 * G + 2.0 * 0.7 * speed
    peak = found.peak()
    good = 1e-7
    assert peak.value == pytest.approx(largest, rel=good) and peak.between and peak.of == "force"
    assert found.peak("force z").value == pytest.approx(largest, rel=good)
    through = np.argmin(np.abs(sol.t - peak.t))
    assert abs(sol.position("pin")[through]) < 0.5
    if method == "Radau":
        rows = pickle.loads(pickle.dumps(found)).peak()
        assert not rows.between and rows.value < largest * (1.0 - 10.0 * good)
        assert str(rows).endswith("s, of the rows") and str(peak).startswith("largest force: ")
    few = pc.simulate(pendulum(), span, {"pin": start}, t_eval=np.linspace(*span, 9), **how)
    assert few.joint_force("pin").peak().value == pytest.approx(largest, rel=good)


def test_peaks_of_loops_and_elements():
    """Against the rows of a finer run, which are below the peak by the square of half their distance."""
    mech = pc.load("four_bar").add_forces(
        pc.SpringDamper("rocker", "universe", 30.0, 0.1, 1.0, (0.1, 0, 0.2), (0, 0, 2))
    )
    sol = pc.simulate(mech, (0.0, 1.0), v0={"crank": 4.0}, dense_output=True, method="Radau", rtol=1e-8)
    t = np.linspace(0.0, 1.0, 2001)
    fine = pc.simulate(mech, (0.0, 1.0), v0={"crank": 4.0}, t_eval=t, method="Radau", rtol=1e-10, atol=1e-12)
    loop, spring = mech.loops[0].name, mech.forces[0].label
    for found, other in ((sol.reaction(loop), fine.reaction(loop)), (sol.force(spring), fine.force(spring))):
        for of in ("force", "force x") if found.force.ndim == 2 else ("force", "length", "speed"):
            peak, rows = found.peak(of), other.peak(of)
            assert peak.value == pytest.approx(rows.value, rel=2e-5) and abs(peak.value) > abs(rows.value) * (1 - 1e-6)
            assert peak.t == pytest.approx(rows.t, abs=1e-3)
    with pytest.raises(pc.InputError, match="no peak of 'forse': choose from force, moment, or a component"):
        sol.reaction(loop).peak("forse")
    with pytest.raises(pc.InputError, match="no peak of 'force x': choose from force, torque, length, speed"):
        sol.force(spring).peak("force x")
    with pytest.raises(pc.InputError, match="no peak of 'force': the result has no rows"):
        pc.simulate(mech, (0.0, 0.1), t_eval=[]).reaction(loop).peak()
    door = pc.simulate(door_with_tree_hinge(), (0.0, 0.5), v0={"upper": 3.0})
    same = {"compliance": {"lower": 1e-8, "upper": 1e-8}}
    assert door.reaction("lower", **same).peak("force z").value == pytest.approx(DOOR * G / 2, rel=1e-9)
    assert pc.equilibrium(pendulum()).joint_force("pin").peak().value == pytest.approx(2.0 * G)


def in_free_bodies(mech, q):
    """The same mechanism of free bodies, with a hinge loop for each joint of its tree, which has hinges only."""
    model, data, free, guess = mech.model, mech.model.createData(), pin.Model(), {}
    pin.forwardKinematics(model, data, q)
    free.gravity = model.gravity
    bodies = ["universe", *(f"free {name}" for name in mech.joints)]
    for body, inertia, pose in list(zip(bodies, model.inertias, data.oMi, strict=True))[1:]:
        index = free.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), body)
        free.appendBodyToJoint(index, inertia, pin.SE3.Identity())
        guess[body] = pose
    ends = []
    for joint in range(1, model.njoints):
        axis = tuple(data.joints[joint].S.reshape(6)[3:])
        here = model.parents[joint], model.jointPlacements[joint], joint, pin.SE3.Identity()
        ends.append((model.names[joint], axis, *here))
    for loop in mech.loops:
        frames = [model.frames[model.getFrameId(name)] for name in (loop.frame1, loop.frame2)]
        places = [frame.placement * own for frame, own in zip(frames, (loop.placement1, loop.placement2), strict=True)]
        ends.append((loop.name, loop.axis, frames[0].parentJoint, places[0], frames[1].parentJoint, places[1]))
    loops = []
    for name, axis, body1, place1, body2, place2 in ends:
        anchors = {}
        for end, place in (1, place1), (2, place2):
            anchors |= {f"xyz{end}": tuple(place.translation), f"rpy{end}": tuple(pin.rpy.matrixToRpy(place.rotation))}
        loops.append(pc.Loop(name, "hinge", bodies[body1], bodies[body2], axis=axis, **anchors))
    return pc.Mechanism(free, loops, guess=guess)


@pytest.mark.parametrize(("scene", "gravity"), [("bricard", (0, -9.81, 0)), ("four_bar", (0, 3, -9))])
def test_unique_forces_do_not_depend_on_the_tree(scene, gravity):
    """In free bodies all joints are loops: what is called unique is the same, the rest with compliances only."""
    scene = pc.load(scene)
    tree = pc.Mechanism(scene.model, scene.loops, guess=scene.guess).with_gravity(gravity)
    free = in_free_bodies(tree, pc.assemble(tree).q)
    one, two = (pc.simulate(mech, (0.0, 0.05), t_eval=[0.0, 0.05], rtol=1e-9, atol=1e-11) for mech in (tree, free))
    names = [*tree.joints, *(loop.name for loop in tree.loops)]
    soft = {name: (1e-8 * (1 + k), 1e-7 / (1 + k)) for k, name in enumerate(names)}
    ways = [f"{what} {axis}" for what in ("force", "moment") for axis in "xyz"]
    most = 0.0
    for name in names:
        here, there = one.reaction(name), two.reaction(name)
        assert here.not_unique == there.not_unique and here.shared_with
        apart = np.hstack((here.force - there.force, here.moment - there.moment))
        unique = np.array([way not in here.not_unique for way in ways])
        assert np.abs(apart[:, unique]).max(initial=0.0) < 1e-8
        most = max(most, np.abs(apart[:, ~unique]).max())
        here, there = (each.reaction(name, compliance=soft) for each in (one, two))
        assert here.not_unique == there.not_unique == ()
        np.testing.assert_allclose(here.force, there.force, atol=1e-8)
        np.testing.assert_allclose(here.moment, there.moment, atol=1e-8)
    assert most > 0.5
