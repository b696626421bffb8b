"""Reactions against weights, hand calculations and power balances: sign, frame and unit of every kind."""

import pickle

import numpy as np
import pinocchio as pin
import pytest
from helpers.held_bodies import JOINTS, anchor, as_loop, own_fields
from helpers.loops import stayed_lid
from helpers.scenes import car_axis
from scipy.interpolate import CubicSpline

import pinconsist as pc
from pinconsist.mechanism.reactions import undetermined

G, MASS = 9.81, 1.7
RPY1, XYZ1 = (0.5, -0.4, 1.1), (0.2, 0.3, 2.0)  # anchor 1 in the ground: oblique
XYZ2, RPY2 = (0.1, -0.2, 0.15), (-0.7, 0.2, 0.4)  # anchor 2 in the body: oblique
X, Y, Z = np.eye(3)
CENTRES = {  # of mass from anchor 2, in world axes, such that the body hangs or stands at rest
    "point": -0.3 * Z,
    "frame": np.array([0.2, -0.1, 0.3]),
    "hinge": 0.25 * X - 0.3 * Z,  # hinge axis along x
    "distance": -0.3 * Z,
    "slider": np.array([0.2, -0.1, 0.3]),  # along x
    "cylinder": 0.25 * X - 0.3 * Z,  # along x
    "plane": np.array([0.2, -0.1, 0.3]),  # normal z
    "universal": 0.25 * X - 0.3 * Z,  # of the ground x, of the body z
}
SLID = {"slider": 0.6 * X, "cylinder": -0.4 * X, "plane": 0.3 * X + 0.2 * Y, "distance": -0.9 * Z}
WORLD_AXIS = {"plane": Z}


def hanging(kind, centre):
    """(mechanism, q): a body at rest, held to the ground by one loop; all frames oblique."""
    model = pin.Model()
    place1, place2 = anchor(XYZ1, RPY1), anchor(XYZ2, RPY2)
    at_anchor = pin.SE3(np.eye(3), place1.translation + SLID.get(kind, np.zeros(3)))
    at_anchor.rotation = place1.rotation
    pose = at_anchor * place2.inverse()
    com = pose.actInv(at_anchor.translation + centre)
    free = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    model.appendBodyToJoint(free, pin.Inertia(MASS, com, np.diag([0.1, 0.2, 0.15])), pin.SE3.Identity())
    model.addFrame(pin.Frame("end", free, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    axes = (at_anchor.rotation.T @ each for each in (WORLD_AXIS.get(kind, X), Z))
    loop = pc.Loop("held", kind, "universe", "end", XYZ1, RPY1, XYZ2, RPY2, **own_fields(kind, *axes, 0.9))
    return pc.Mechanism(model, [loop]), pin.SE3ToXYZQUAT(pose)


@pytest.mark.parametrize("kind", CENTRES)
def test_a_loop_carries_the_weight_of_its_body(kind):
    """force = m g upwards, moment about anchor 2 = -c × m g; it stays at rest."""
    centre = CENTRES[kind]
    mech, q = hanging(kind, centre)
    sol = pc.simulate(mech, (0.0, 0.1), q, rtol=1e-8, atol=1e-8)
    assert sol.success and np.abs(sol.v).max() < 1e-9
    reaction = sol.reaction("held")
    np.testing.assert_allclose(reaction.force, [[0, 0, MASS * G]] * len(sol.t), atol=1e-7)
    np.testing.assert_allclose(reaction.moment, [-np.cross(centre, [0, 0, -MASS * G])] * len(sol.t), atol=1e-7)
    assert reaction.torque is None and (reaction.loop, reaction.kind) == ("held", kind)
    turn = anchor(XYZ1, RPY1).rotation
    local = sol.reaction("held", axes="anchor")
    np.testing.assert_allclose(local.force @ turn.T, reaction.force, atol=1e-12)
    np.testing.assert_allclose(local.moment @ turn.T, reaction.moment, atol=1e-12)


@pytest.mark.parametrize("kind", CENTRES)
def test_multipliers_are_what_the_table_says(kind):
    """λ by hand from force and moment, in the axes of anchor 1, with u1, u2 found anew."""
    centre = CENTRES[kind]
    mech, q = hanging(kind, centre)
    sol = pc.simulate(mech, (0.0, 0.01), q)
    turn = anchor(XYZ1, RPY1).rotation.T
    force, moment = turn @ [0, 0, MASS * G], turn @ -np.cross(centre, [0, 0, -MASS * G])
    e, axis2 = turn @ WORLD_AXIS.get(kind, X), turn @ Z
    u1 = np.cross(e, np.eye(3)[np.argmin(np.abs(e))])
    u1 /= np.linalg.norm(u1)
    across = np.array([u1, np.cross(e, u1)])
    expected = {
        "point": [force],
        "frame": [force, moment],
        "hinge": [force, across @ moment],
        "distance": [[-MASS * G]],  # it pulls
        "slider": [across @ force, moment],
        "cylinder": [across @ force, across @ moment],
        "plane": [[e @ force], across @ moment],
        "universal": [force, [np.cross(axis2, e) @ moment]],
    }[kind]
    np.testing.assert_allclose(sol.lam[-1], np.concatenate(expected), atol=1e-7)


def test_body_1_takes_the_opposite():
    """The same closure written the other way round."""
    mech, q = hanging("cylinder", CENTRES["cylinder"])
    (loop,) = mech.loops
    turned = pc.Loop("held", "cylinder", "end", "universe", XYZ2, RPY2, XYZ1, RPY1, axis=loop.axis)
    one, other = (pc.simulate(each, (0.0, 0.01), q).reaction("held") for each in (mech, mech.with_loops(turned)))
    np.testing.assert_allclose(other.force, -one.force, atol=1e-6)
    lever = SLID["cylinder"]  # from anchor 1 to anchor 2: the moment is now taken about the other point
    np.testing.assert_allclose(other.moment, -one.moment - np.cross(lever, one.force), atol=1e-6)


def rods(*names, length=1.0, mass=1.0):
    """A chain of uniform rods on hinges about y; the ends are frames tip0, tip1, …."""
    model, last = pin.Model(), 0
    for i, name in enumerate(names):
        place = pin.SE3(np.eye(3), np.array([length if i else 0.0, 0, 0]))
        last = model.addJoint(last, pin.JointModelRY(), place, name)
        inertia = mass * length**2 / 12 * np.diag([0, 1, 1])
        model.appendBodyToJoint(last, pin.Inertia(mass, np.array([length / 2, 0, 0]), inertia), pin.SE3.Identity())
        model.addFrame(pin.Frame(f"tip{i}", last, 0, pin.SE3(np.eye(3), length * X), pin.FrameType.OP_FRAME))
    return model


def test_two_rods_hanging_between_two_pins():
    """Each pin carries one weight; moments about the wall pin of one rod give H = m g cos φ / (2 sin φ)."""
    span, phi = 1.6, np.arccos(0.8)
    loop = pc.Loop("pin", "hinge", "tip1", "universe", xyz2=(span, 0, 0), axis=(0, 1, 0))
    mech = pc.Mechanism(rods("left", "right"), [loop])
    assembly = pc.assemble(mech, {"left": 0.7, "right": -1.3})
    assert assembly.mobility == 0 and assembly.q[0] == pytest.approx(phi, abs=1e-10)
    sol = pc.simulate(mech, (0.0, 0.1), {"left": 0.7, "right": -1.3})
    horizontal = G * np.cos(phi) / (2 * np.sin(phi))
    reaction = sol.reaction("pin")  # on the ground: the rods pull it inwards and down
    np.testing.assert_allclose(reaction.force, [[-horizontal, 0, -G]] * len(sol.t), atol=1e-9)
    np.testing.assert_allclose(reaction.moment, 0, atol=1e-9)


def test_three_rods_hanging_between_two_pins():
    """Symmetric: the middle rod is level, its ends carry half its weight; the outer pins carry 3/2 m g each."""
    span, phi = 2.2, np.arccos(0.6)
    loop = pc.Loop("pin", "point", "universe", "tip2", xyz1=(span, 0, 0))
    mech = pc.Mechanism(rods("left", "middle", "right"), [loop])
    sol = pc.simulate(mech, (0.0, 0.1), {"left": phi, "middle": -phi, "right": -phi}, rtol=1e-9, atol=1e-9)
    assert np.abs(sol.v).max() < 1e-9
    # moments about the outer pin of a side rod: H sin φ = (m g / 2) cos φ + (m g / 2) cos φ
    horizontal = G * np.cos(phi) / np.sin(phi)
    np.testing.assert_allclose(sol.reaction("pin").force, [[horizontal, 0, 1.5 * G]] * len(sol.t), atol=1e-7)


@pytest.mark.parametrize("kind", JOINTS)
def test_joint_forces_are_the_virtual_work_of_force_and_moment(kind):
    """Jᵀλ against the wrench taken to the joints by Pinocchio's frame Jacobians, in motion."""
    mech, rng = as_loop(kind), np.random.default_rng(2)
    start = pc.assemble(mech, pin.integrate(mech.model, pin.neutral(mech.model), rng.uniform(-1, 1, mech.nv)))
    sol = pc.simulate(mech, (0.0, 0.02), start.q, rng.normal(size=mech.nv))
    reaction, (loop,) = sol.reaction("held"), mech.loops
    rows = zip(sol.q, reaction.force, reaction.moment, reaction.joint_forces, strict=True)
    for q, force, moment, expected in rows:
        data = mech.model.createData()
        pin.computeJointJacobians(mech.model, data, q)
        pin.framesForwardKinematics(mech.model, data, q)
        at2 = (data.oMf[mech.model.getFrameId("body_end")] * loop.placement2).translation
        total = np.zeros(mech.nv)
        for sign, frame in ((1, "body_end"), (-1, "arm_end")):  # both at the place of anchor 2
            i = mech.model.getFrameId(frame)
            J = pin.getFrameJacobian(mech.model, data, i, pin.LOCAL_WORLD_ALIGNED)
            arm = at2 - data.oMf[i].translation
            total += sign * (J[:3].T @ force + J[3:].T @ (moment + np.cross(arm, force)))
        np.testing.assert_allclose(expected, total, atol=1e-9 * (1 + np.abs(expected).max()))


def swinging(t):
    return -1.0 + 4.0 * t + 0.5 * np.sin(7.0 * t)


def swinging_rate(t):
    return 4.0 + 3.5 * np.cos(7.0 * t)


def swinging_acceleration(t):
    return -24.5 * np.sin(7.0 * t)


def driven():
    mech = pc.load("slider_crank")
    return mech.add_loops(pc.Drive("motor", "crank", swinging, swinging_rate, swinging_acceleration))


def test_motor_torque_times_speed_is_what_the_energy_gains():
    mech = driven()
    sol = pc.simulate(mech, (0.0, 1.0), t_eval=np.linspace(0, 1, 401), rtol=1e-10, atol=1e-10)
    energy = np.array([mechanical_energy(mech.model, q, v) for q, v in zip(sol.q, sol.v, strict=True)])
    power = sol.reaction("motor").torque * swinging_rate(sol.t)
    gained = CubicSpline(sol.t, energy).derivative()(sol.t)
    inner = slice(5, -5)  # a cubic spline through 401 points: (1/400)³ of a third derivative
    np.testing.assert_allclose(power[inner], gained[inner], atol=1e-4 * np.abs(power).max())
    assert np.abs(power).max() > 1.0
    work = CubicSpline(sol.t, power).integrate(0.0, 1.0)
    assert work == pytest.approx(energy[-1] - energy[0], abs=1e-5 * np.ptp(energy))


def mechanical_energy(model, q, v):
    data = model.createData()
    return pin.computeKineticEnergy(model, data, q, v) + pin.computePotentialEnergy(model, data, q)


def test_gear_pair_holds_a_torque_by_its_ratio():
    """A locked pinion (driven to stand still) against a torque on the wheel: -ratio of it reaches the pinion."""
    model = pin.Model()
    for name in ("pinion", "wheel"):
        index = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(index, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    loops = [pc.Coupling("gear", "pinion", "wheel", -2.5), pc.Drive("brake", "pinion", _still, _still, _still)]
    sol = pc.simulate(pc.Mechanism(model, loops, [{"wheel": 10.0}]), (0.0, 0.1))
    # the wheel stands: 10 + 2.5 gear = 0; the pinion stands: gear + brake = 0
    np.testing.assert_allclose(sol.reaction("gear").torque, -4.0, atol=1e-9)
    np.testing.assert_allclose(sol.reaction("brake").torque, 4.0, atol=1e-9)
    np.testing.assert_allclose(sol.reaction("gear").joint_forces, [[-4.0, -10.0]] * len(sol.t), atol=1e-9)


def _still(t):
    return 0.0


def test_redundant_rows_share_the_load_at_least_norm():
    """A lid on two hinges along one line: ten rows of rank five; each carries half the weight."""
    model = pin.Model()
    free = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "lid")
    model.appendBodyToJoint(free, pin.Inertia(MASS, -0.4 * Z, np.diag([0.1, 0.2, 0.15])), pin.SE3.Identity())
    model.addFrame(pin.Frame("lid_end", free, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    loops = [
        pc.Loop(name, "hinge", "universe", "lid_end", xyz1=(x, 0, 0), xyz2=(x, 0, 0), axis=(1, 0, 0))
        for name, x in (("left", -0.5), ("right", 0.5))
    ]
    mech = pc.Mechanism(model, loops)
    assembly = pc.assemble(mech)
    assert (assembly.rows, assembly.rank, assembly.mobility) == (10, 5, 1)
    sol = pc.simulate(mech, (0.0, 0.05))
    for name in ("left", "right"):
        np.testing.assert_allclose(sol.reaction(name).force, [[0, 0, MASS * G / 2]] * len(sol.t), atol=1e-8)
        np.testing.assert_allclose(sol.reaction(name).moment, 0, atol=1e-8)


@pytest.mark.parametrize(("lever", "known"), [(1e-3, True), (1e-6, False)])
def test_forces_that_only_rounded_numbers_determine_are_told(lever, known):
    """The stay's tension is the weight's moment about the balls' line over the lever: of 1 μm it means nothing."""
    sol = pc.simulate(stayed_lid(lever), (0.0, 0.01))
    stay, concerns = sol.reaction("stay"), " ".join(sol.check().concerns)
    assert set(sol.check(error=False).undetermined) == (set() if known else {"ball-0.5", "ball0.5", "stay"})
    assert ("stay are not determined: their rows depend on others to 5e-07;" in concerns) is not known
    assert str(stay).endswith("not determined: its rows depend on others to 5e-07") is not known
    assert stay.dependence is None if known else stay.dependence == pytest.approx(4.7e-7, rel=0.01)


def test_a_dead_centre_that_is_passed_leaves_forces_as_they_are():
    mech = pc.load("slider_crank")
    q = np.array([pc.assemble(mech, {"crank": angle}).q for angle in (1e-6, 1.0)])
    mech = mech.add_loops(pc.Drive("press", "piston", lambda t: 1.0))
    assert "press" in undetermined(mech, np.zeros(1), q[:1])
    assert undetermined(mech, np.zeros(2), q) == undetermined(mech, np.zeros(1), q[1:]) == {}


def test_of_cassie_the_shins_are_not_determined_and_nothing_else():
    """Without them the robot carries the same forces."""
    try:
        mech = pc.load("cassie")
    except pc.MissingExtraError as error:
        pytest.skip(str(error))
    shins = {f"{side}-shin-spring-joint" for side in ("left", "right")}
    sol, without = (pc.simulate(each, (0.0, 0.05)) for each in (mech, mech.reduced()))
    assert {loop.name for loop in mech.loops if sol.reaction(loop.name).dependence} == shins
    for name in {loop.name for loop in mech.anchored_loops} - shins:
        force, same = sol.reaction(name).force[0], without.reaction(name).force[0]
        np.testing.assert_allclose(force, same, atol=1e-3 * np.linalg.norm(same))


def test_reading_a_solution_back(tmp_path):
    mech, q = hanging("slider", CENTRES["slider"])
    sol = pc.simulate(mech, (0.0, 0.01), q)
    expected = sol.reaction("held")
    for read in (pc.Solution.load(sol.save(tmp_path / "run")), pickle.loads(pickle.dumps(sol))):
        with pytest.raises(pc.InputError, match=r"needs its mechanism here: sol.reaction\(…, mechanism\)"):
            read.reaction("held")
        np.testing.assert_array_equal(read.reaction("held", mech).force, expected.force)
    copy = pickle.loads(pickle.dumps(expected))
    np.testing.assert_array_equal(copy.moment, expected.moment)
    assert str(expected).startswith("slider 'held': force [N] up to 16.68, moment [N·m] up to ")
    with pytest.raises(ValueError, match="read-only"):
        expected.force[0, 0] = 1.0


def test_bad_questions_are_answered():
    mech = driven()
    sol = pc.simulate(mech, (0.0, 0.01))
    with pytest.raises(pc.InputError, match="no loop or joint 'moter'; similar: motor"):
        sol.reaction("moter")
    with pytest.raises(pc.InputError, match=r"no loop or joint 'q'; the loops are .*motor"):
        sol.reaction("q")
    with pytest.raises(pc.InputError, match="axes='body' is not one of 'world', 'anchor'"):
        sol.reaction("motor", axes="body")
    with pytest.raises(pc.InputError, match=r"3 position numbers, 3 .* \d multipliers, mechanism 'slider_crank' has"):
        sol.reaction(mech.loops[0].name, pc.load("slider_crank"))
    with pytest.raises(pc.InputError, match="a general problem has no loops"):
        pc.integrate(*_general()).reaction("R")


def _general():
    problem, p0, v0 = car_axis()
    return problem, (0.0, 0.01), p0, v0


def test_a_reaction_without_rows_prints():
    sol = pc.simulate(pc.load("four_bar"), (0.0, 0.01), t_eval=[])
    assert str(sol.reaction("coupler_rocker")).startswith("hinge 'coupler_rocker': force [N] up to 0")
