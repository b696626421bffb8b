"""Joints locked where they stand, and mechanisms reduced to what moves: the same motion as before, with less."""

import logging
import pickle
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from helpers.bodies import loop_rows, mixed_tree, random_state
from helpers.scenes import add_body, add_point, at

import pinconsist as pc
from pinconsist.mechanism.custom import Constraint
from pinconsist.mechanism.joint_constraints import Coupling
from pinconsist.mechanism.system import MechanismSystem

ROBOTS = Path(__file__).resolve().parents[2] / "shared" / "robots"


def left(mech, names):
    """Indices in q and v of the joints that are not named."""
    model = mech.model
    kept = [i for i in range(1, model.njoints) if model.names[i] not in names]
    return (
        [k for i in kept for k in range(model.idx_qs[i], model.idx_qs[i] + model.nqs[i])],
        [k for i in kept for k in range(model.idx_vs[i], model.idx_vs[i] + model.nvs[i])],
    )


# The tree -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("names", [("hinge",), ("slide", "float"), ("ball", "turn", "glide"), ("float", "glide")])
def test_locked_tree_is_the_tree_with_these_joints_at_rest(names):
    model = mixed_tree()
    rng = np.random.default_rng(1)
    model.damping, model.armature, model.upperDryFrictionLimit = rng.uniform(1, 2, (3, model.nv))
    mech = pc.Mechanism(model).with_gravity([1, 2, 3])
    q, v = random_state(model, rng)
    a = rng.normal(size=model.nv)
    qi, vi = left(mech, names)
    small = mech.lock(names, q)
    assert small.joints == tuple(joint for joint in mech.joints if joint not in names)
    np.testing.assert_allclose(small.guess, q[qi], atol=1e-15)
    rest = np.setdiff1d(np.arange(model.nv), vi)
    v[rest] = a[rest] = 0
    whole, part = mech.model, small.model
    torque = pin.rnea(whole, whole.createData(), q, v, a)[vi]
    np.testing.assert_allclose(pin.rnea(part, part.createData(), q[qi], v[vi], a[vi]), torque, atol=1e-12)
    for key in ("damping", "armature", "upperDryFrictionLimit"):
        np.testing.assert_array_equal(getattr(part, key), getattr(whole, key)[vi])
    data, small_data = whole.createData(), part.createData()
    pin.framesForwardKinematics(whole, data, q)
    pin.framesForwardKinematics(part, small_data, q[qi])
    assert [frame.name for frame in part.frames] == [frame.name for frame in whole.frames]
    for one, other in zip(data.oMf, small_data.oMf, strict=True):
        np.testing.assert_allclose(one.homogeneous, other.homogeneous, atol=1e-13)


def test_as_pinocchios_own_reduction():
    mech = pc.load("five_bar")
    model, q = mech.model, mech.guess + 0.2
    theirs = pin.buildReducedModel(model, [model.getJointId("left_distal")], q)
    ours = mech.with_loops().lock("left_distal", q).model
    np.testing.assert_allclose(
        np.array([inertia.toDynamicParameters() for inertia in ours.inertias]),
        np.array([inertia.toDynamicParameters() for inertia in theirs.inertias]),
        atol=1e-15,
    )
    q = np.array([0.3, -0.2, 0.1])
    for one, other in ((ours, theirs), (theirs, ours)):
        np.testing.assert_allclose(
            pin.crba(one, one.createData(), q), pin.crba(other, other.createData(), q), atol=1e-15
        )


def test_shapes_stay_on_their_bodies():
    mech = pc.load("four_bar").with_loops()
    shapes = [
        pin.buildGeomFromUrdfString(each.model, mech.geometry.urdf, pin.GeometryType.VISUAL)
        for each in (mech, mech.lock("coupler", {"coupler": 0.7}))
    ]
    poses = []
    for each, geometry in zip((mech, mech.lock("coupler", {"coupler": 0.7})), shapes, strict=True):
        data, geometry_data = each.model.createData(), geometry.createData()
        q = each.configuration({"crank": 0.2, "rocker": 0.4} | ({"coupler": 0.7} if each is mech else {}))
        pin.updateGeometryPlacements(each.model, data, geometry, geometry_data, q)
        poses.append({o.name: p.homogeneous for o, p in zip(geometry.geometryObjects, geometry_data.oMg, strict=True)})
    assert poses[0].keys() == poses[1].keys() and len(poses[0]) > 5
    for name, pose in poses[0].items():
        np.testing.assert_allclose(pose, poses[1][name], atol=1e-14)


# Loops ----------------------------------------------------------------------------------------------------------------


def test_locked_crank_of_a_four_bar_stops_it():
    mech = pc.load("four_bar").lock("crank")
    assert (mech.joints, mech.actuated) == (("coupler", "rocker"), ())
    sol = pc.simulate(mech, (0.0, 1.0))
    assert sol.success and np.abs(sol.q - sol.q[0]).max() < 1e-12 and np.abs(sol.v).max() < 1e-12


def test_locked_crank_of_a_five_bar_moves_as_one_that_is_held():
    """Locked, or held by a drive at rest: two ways to the same motion."""
    mech = pc.load("five_bar")
    q = mech.guess
    held = mech.add_loops(pc.Drive("hold", "left_crank", pc.Motion(q[0])))
    locked = mech.lock(["left_crank"])
    sols = [pc.simulate(each, (0.0, 0.4), rtol=1e-9, atol=1e-11) for each in (held, locked)]
    assert all(sol.success for sol in sols) and np.abs(sols[1].v).max() > 1.0
    qi, vi = left(mech, ["left_crank"])
    np.testing.assert_allclose(sols[1].q[-1], sols[0].q[-1][qi], atol=1e-6)
    np.testing.assert_allclose(sols[1].v[-1], sols[0].v[-1][vi], atol=1e-5)


def test_a_loop_within_one_body_goes_if_it_is_closed():
    mech = pc.load("four_bar")
    with pytest.raises(pc.InputError, match="nothing can move"):
        mech.lock(mech.joints)
    five = pc.load("five_bar")
    extra = five.add_loops(pc.Loop("strut", "distance", "left_tip", "universe", length=1.0))
    reach = np.linalg.norm(tip_of(extra, extra.guess))
    with pytest.raises(pc.InputError, match=r"loop 'strut' would stay open by .*assemble"):
        extra.lock(["left_crank", "left_distal"])
    fits = five.add_loops(pc.Loop("strut", "distance", "left_tip", "universe", length=reach))
    assert [loop.name for loop in fits.lock(["left_crank", "left_distal"]).loops] == ["tip"]


def tip_of(mech, q):
    data = mech.model.createData()
    pin.framesForwardKinematics(mech.model, data, q)
    return data.oMf[mech.model.getFrameId("left_tip")].translation


def test_couplings_and_drives_of_locked_joints():
    five = pc.load("five_bar").with_loops()
    gear = Coupling("gear", "left_crank", "right_crank", -1.0, five.guess[0] + five.guess[2])
    mech = five.with_loops(gear)
    with pytest.raises(pc.InputError, match=r"'left_crank' cannot be locked alone: coupling 'gear' would also hold"):
        mech.lock("left_crank")
    with pytest.raises(pc.InputError, match=r"'right_crank' cannot be locked alone.*would also hold 'left_crank'"):
        mech.lock("right_crank")
    assert mech.lock(["left_crank", "right_crank"]).loops == ()
    assert mech.lock("left_distal").loops == (gear,)
    with pytest.raises(pc.InputError, match="loop 'gear' would stay open by 1 "):
        mech.lock(["left_crank", "right_crank"], mech.guess + np.array([1, 0, 0, 0]))
    driven = five.with_loops(pc.Drive("motor", "left_crank", np.sin))
    with pytest.raises(pc.InputError, match="drive 'motor' moves it; remove the drive"):
        driven.lock("left_crank")
    assert driven.lock("right_crank").loops == driven.loops


def test_own_constraints_see_the_whole_configuration():
    five = pc.load("five_bar").with_loops()

    def phi(t, q):
        return np.array([q @ [1, 2, 3, 4] - t, np.sin(q[0]) * q[3]])

    def jacobian(t, q):
        return np.array([[1, 2, 3, 4], [np.cos(q[0]) * q[3], 0, 0, np.sin(q[0])]], float)

    mech = five.with_loops(Constraint("own", phi, 2, jacobian, lambda t, q: np.array([-1.0, 0.0])))
    small = mech.lock(["left_distal", "right_crank"])
    rng = np.random.default_rng(0)
    q = mech.guess.copy()
    q[[0, 3]] = rng.normal(size=2)
    whole, part = (loop_rows(m, x, 0.25) for m, x in ((mech, q), (small, q[[0, 3]])))
    np.testing.assert_allclose(part[0], whole[0], atol=1e-14)
    np.testing.assert_allclose(part[1], whole[1][:, [0, 3]], atol=1e-14)


# Forces ---------------------------------------------------------------------------------------------------------------


def user_torque(t, q, v):
    return np.array([q @ v, q[0] * v[3], t * q[1], v[1] + q[2]])


def user_gradient(t, q, v):
    by_q, by_v = np.zeros((2, 4, 4))
    by_q[0], by_v[0] = v, q
    by_q[1, 0], by_v[1, 3], by_q[2, 1], by_v[3, 1], by_q[3, 2] = v[3], q[0], t, 1, 1
    return by_q, by_v


FORCES = {
    "damping by name": pc.JointDamping({"left_crank": 1.0, "left_distal": 2.0}),
    "damping of all": pc.JointDamping([1.0, 2.0, 3.0, 4.0]),
    "friction": pc.JointFriction({"left_distal": 2.0, "right_distal": 3.0}),
    "torques": {"left_crank": 1.0, "right_crank": 2.0, "right_distal": np.cos},
    "torques of all": [1.0, 2.0, 3.0, 4.0],
    "spring": pc.JointSpring("right_distal", 3.0, 0.1),
    "servo": pc.Servo("left_distal", np.sin, 3.0, 0.5),
    "spring damper": pc.SpringDamper("left_tip", "universe", 5.0, 0.1, 0.2),
    "wrench": pc.Wrench("right_tip", (1.0, 2.0, 3.0), (0.1, 0.2, 0.3)),
    "function": user_torque,
    "function with gradient": pc.Torque(user_torque, user_gradient),
}


@pytest.mark.parametrize("force", FORCES.values(), ids=FORCES)
def test_forces_act_on_what_is_left_as_before(force):
    five = pc.load("five_bar").with_loops().add_forces(force)
    small = pickle.loads(pickle.dumps(five.lock(["left_crank", "right_crank"])))
    q, v = five.guess.copy(), np.zeros(4)
    q[[1, 3]], v[[1, 3]] = np.random.default_rng(0).normal(size=(2, 2))
    whole, part = MechanismSystem(five, q), MechanismSystem(small, q[[1, 3]])
    torque = whole.torque(0.3, q, v)
    np.testing.assert_allclose(part.torque(0.3, q[[1, 3]], v[[1, 3]]), torque[[1, 3]], atol=1e-15)
    assert np.any(torque[[1, 3]])
    if force is FORCES["function with gradient"]:
        for by_whole, by_part in zip(
            user_gradient(0.3, q, v), small.forces[0].derivatives(0.3, q[[1, 3]], v[[1, 3]]), strict=True
        ):
            np.testing.assert_array_equal(by_part, by_whole[np.ix_([1, 3], [1, 3])])


@pytest.mark.parametrize(
    "force",
    [
        pc.JointDamping({"left_crank": 1.0}),
        {"left_crank": 1.0},
        pc.JointSpring("left_crank", 3.0),
        pc.Servo("left_crank", 1.0, 3.0),
        pc.SpringDamper("left_tip", "universe", 5.0, 0.1),
        pc.Wrench("left_tip", (1.0, 0.0, 0.0)),
    ],
)
def test_forces_with_nothing_left_to_move_go(force):
    five = pc.load("five_bar").with_loops().add_forces(force)
    assert five.lock(["left_crank", "left_distal"]).forces == ()


def test_wrong_names_to_lock():
    with pytest.raises(pc.InputError, match="no joint 'krank'"):
        pc.load("four_bar").lock("krank")
    with pytest.raises(pc.InputError, match="needs the name of one joint or of several, got 3"):
        pc.load("four_bar").lock(3)
    with pytest.raises(pc.InputError, match="needs shape"):
        pc.load("four_bar").lock("crank", [1.0])


# Reduced --------------------------------------------------------------------------------------------------------------


def three_cranks():
    """A rigid coupler of 2 m on three equal cranks: any one of the three can be left out."""
    model, turn = pin.Model(), pin.JointModelRZ()
    model.gravity.linear = np.array([0, -9.81, 0])
    first = add_body(model, 0, turn, at(0, 0), "crank0", 1.0, (0, 0.5, 0), 1 / 12)
    coupler = add_body(model, first, turn, at(0, 1), "coupler", 2.0, (1, 0, 0), 8 / 12)
    loops = []
    for i in (1, 2):
        crank = add_body(model, 0, turn, at(i, 0), f"crank{i}", 1.0, (0, 0.5, 0), 1 / 12)
        add_point(model, crank, f"C{i}", 0, 1)
        add_point(model, coupler, f"B{i}", i, 0)
        loops.append(pc.Loop(f"B{i}", "hinge", f"B{i}", f"C{i}", axis=(0, 0, 1)))
    return pc.Mechanism(model, loops, name="three_cranks")


def same_motion(mech, small, t_end, atol, **state):
    sols = [pc.simulate(each, (0.0, t_end), **state, rtol=1e-9, atol=1e-11) for each in (mech, small)]
    assert all(sol.success for sol in sols)
    columns = [mech.joints.index(joint) for joint in small.joints]
    np.testing.assert_allclose(sols[1].q[-1], sols[0].q[-1][columns], atol=atol)
    return sols


def test_turning_rows_of_a_planar_hinge_leave():
    mech = pc.load("four_bar")
    small = mech.reduced()
    assert [(loop.name, loop.kind) for loop in small.loops] == [("coupler_rocker", "point")]
    same_motion(mech, small, 1.0, 1e-6)


def test_a_redundant_loop_leaves(caplog):
    mech = three_cranks()
    with caplog.at_level(logging.INFO, logger="pinconsist"):
        small = mech.reduced({"crank0": -0.3})
    assert [loop.name for loop in small.loops] == ["B1", "B2"]  # the coupler needs both: each alone leaves it turning
    assert {loop.kind for loop in small.loops} == {"point"}
    again = mech.add_loops(pc.Loop("twice", "point", "B2", "C2"))
    with caplog.at_level(logging.INFO, logger="pinconsist"):
        assert [loop.name for loop in again.reduced({"crank0": -0.3}).loops] == ["B1", "B2"]
    assert "loop 'twice' follows from the others and is dropped" in caplog.text
    same_motion(mech, small, 1.0, 1e-6, q0={"crank0": -0.3})


def test_still_joints_are_locked():
    """A bracket of two bars pinned to the ground at both ends stands still; a pendulum hangs on it."""
    model, turn = pin.Model(), pin.JointModelRZ()
    model.gravity.linear = np.array([0, -9.81, 0])
    bar = add_body(model, 0, turn, at(0, 0), "bar", 1.0, (0.5, 0, 0), 1 / 12)
    stay = add_body(model, bar, turn, at(1, 0), "stay", 1.0, (0.5, 0, 0), 1 / 12)
    add_point(model, stay, "foot", 1, 0)
    add_body(model, stay, turn, at(0.5, 0), "pendulum", 1.0, (0.5, 0, 0), 1 / 12)
    loop = pc.Loop("pin", "hinge", "foot", "universe", xyz2=(1.2, 0, 0), axis=(0, 0, 1))
    mech = pc.Mechanism(model, [loop], guess={"bar": 1.0, "stay": -2.0, "pendulum": 0.3})
    small = mech.reduced()
    assert small.joints == ("pendulum",) and small.loops == ()
    sols = same_motion(mech, small, 1.0, 1e-6)
    assert np.abs(sols[0].v[:, 2]).max() > 1.0
    with pytest.raises(pc.InputError, match="leave no motion, so"):
        mech.lock("pendulum").reduced()


def test_a_tree_is_reduced_to_itself():
    tree = pc.load("double_pendulum")
    assert tree.reduced({"upper": 0.3}).joints == tree.joints
    np.testing.assert_array_equal(tree.reduced({"upper": 0.3}).guess, [0.3, tree.guess[1]])


def test_drives_and_couplings_stay():
    mech = pc.load("four_bar")
    mech = mech.add_loops(pc.Drive("motor", "crank", pc.Motion(-1.0, speed=2.0)))
    small = mech.reduced()
    assert small.joints == mech.joints and [loop.kind for loop in small.loops] == ["point", "drive"]
    same_motion(mech, small, 1.0, 1e-6)


@pytest.mark.skipif(not ROBOTS.is_dir(), reason="the public robots are not beside the repository")
def test_a_real_robot_with_joints_that_cannot_move():
    mech = pc.load(ROBOTS / "5bar_linkage_iso6d")
    small = mech.reduced()
    assert (mech.nv, small.nv) == (8, 5)
    assert pc.assemble(small).mobility == pc.assemble(mech).mobility == 2
    start = pc.assemble(mech).q
    columns = [mech.joints.index(joint) for joint in small.joints]
    sols = [
        pc.simulate(each, (0.0, 0.2), q, rtol=1e-8, atol=1e-10) for each, q in ((mech, start), (small, start[columns]))
    ]
    np.testing.assert_allclose(sols[1].q[-1], sols[0].q[-1][columns], atol=1e-5)
