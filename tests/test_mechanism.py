"""Closed mechanisms against answers derived by hand and integrated by scipy in one coordinate."""

import pickle

import numpy as np
import pinocchio as pin
import pytest
from helpers.zoo import FourBar, G, SliderCrank, reduced_solution

import pinconsist as pc
from pinconsist.mechanism.system import MechanismSystem

TIMES = np.linspace(0.0, 1.0, 6)


def joint_forces(sol):
    """Jᵀλ of each row."""
    return np.array([sol.system.loop_rows(q)[1].T @ lam for q, lam in zip(sol.q, sol.lam, strict=True)])


def linkage_of(name):
    mech = pc.load(name)
    if name == "four_bar":
        return mech, FourBar()
    return mech, SliderCrank([mech.model.inertias[i].mass for i in (1, 2, 3)])


@pytest.mark.parametrize("name", ["four_bar", "slider_crank"])
def test_against_reduced_coordinate(name):
    """q, v and Jᵀλ at fixed BDF-5 steps, against scipy in the crank angle alone (rtol 1e-12)."""
    mech, linkage = linkage_of(name)
    start = pc.assemble(mech)
    q, v, forces = reduced_solution(linkage, start.q, 0.0, TIMES)
    errors = []
    for h in (1 / 400, 1 / 800):
        sol = pc.simulate(mech, (0.0, 1.0), step=h, order=5, method="BDF")
        rows = np.searchsorted(sol.t, TIMES - 1e-9)
        found = (sol.q[rows], sol.v[rows], joint_forces(sol)[rows])
        errors.append([np.abs(a - b).max() for a, b in zip(found, (q, v, forces), strict=True)])
    assert errors[1][0] < 5e-8 and errors[1][1] < 2e-6 and errors[1][2] < 1e-6 * np.abs(forces).max()
    assert (np.log2(np.divide(*errors)) > 4.3).all(), errors


@pytest.mark.parametrize("name", ["four_bar", "slider_crank"])
def test_every_multiplier_is_right_not_only_the_later_ones(name):
    mech, linkage = linkage_of(name)
    forces = reduced_solution(linkage, pc.assemble(mech).q, 0.0, np.linspace(0.0, 0.5, 201))[2]
    sol = pc.simulate(mech, (0.0, 0.5), step=1 / 400, order=3, method="BDF")
    error = np.abs(joint_forces(sol) - forces).max(axis=1)
    assert error[:5].max() < 2 * error.max() and error.max() < 1e-3 * np.abs(forces).max()


def test_planar_closures_of_every_kind_give_the_same_motion():
    """Point (3 rows), hinge (5) and frame (6): out-of-plane rows leave the system, the motion is the same.

    A frame closure would also fix the rocker's tip against turning, so it closes a fourth, massless link.
    """
    mech = pc.load("four_bar")
    (hinge,) = mech.loops
    runs = {}
    for kind in ("point", "hinge"):
        variant = mech.with_loops(
            pc.Loop("tip", kind, hinge.frame1, hinge.frame2, axis=hinge.axis if kind == "hinge" else None)
        )
        runs[kind] = pc.simulate(variant, (0.0, 1.0), step=0.01, order=3, method="BDF")
        assert runs[kind].lam.shape[1] == variant.nc
    np.testing.assert_allclose(runs["hinge"].q, runs["point"].q, atol=1e-12)
    np.testing.assert_allclose(runs["hinge"].lam[:, :3], runs["point"].lam, atol=1e-8)
    assert not runs["hinge"].lam[:, [1, 3, 4]].any()  # y and the tilts carry nothing in the plane


def test_with_replaces_and_add_adds():
    mech = pc.load("four_bar")
    drive, push = pc.Drive("motor", "crank", np.sin), pc.JointTorque({"crank": 1.0})
    damped = mech.with_forces(pc.JointDamping({"crank": 0.5}))
    assert mech.add_loops(drive).loops == (*mech.loops, drive)
    assert mech.with_loops(drive).loops == (drive,)
    assert damped.add_forces(push).forces == (*damped.forces, push)
    assert damped.with_forces(push).forces == (push,)
    assert mech.add_loops(drive).with_loops(*mech.loops).loops == mech.loops
    assert damped.with_forces().forces == ()
    with pytest.raises(pc.InputError, match="two loops are named"):
        mech.add_loops(*mech.loops)


def planar_bars(with_pin_link):
    """The four-bar as a pin.Model; with a massless link hinged to the coupler's tip, for a frame closure."""
    model, at = pin.Model(), lambda x: pin.SE3(np.eye(3), np.array([x, 0.0, 0.0]))

    def bar(parent, name, x, length, mass):
        joint = model.addJoint(parent, pin.JointModelRY(), at(x), name)
        inertia = np.diag([1e-3, mass * length**2 / 12, mass * length**2 / 12])
        model.appendBodyToJoint(joint, pin.Inertia(mass, np.array([length / 2, 0, 0]), inertia), pin.SE3.Identity())
        return joint

    crank = bar(0, "crank", 0.0, 1.0, 1.0)
    last = coupler = bar(crank, "coupler", 1.0, 2.0, 2.0)
    if with_pin_link:
        last = model.addJoint(coupler, pin.JointModelRY(), at(2.0), "pin")
        model.addFrame(pin.Frame("tip1", last, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    else:
        model.addFrame(pin.Frame("tip1", coupler, 0, at(2.0), pin.FrameType.OP_FRAME))
    rocker = bar(0, "rocker", 2.2, 1.5, 1.5)
    model.addFrame(pin.Frame("tip2", rocker, 0, at(1.5), pin.FrameType.OP_FRAME))
    kind = "frame" if with_pin_link else "point"
    guess = {"crank": -1.0, "coupler": 0.7, "rocker": -1.4}
    return pc.Mechanism(model, [pc.Loop("tip", kind, "tip1", "tip2")], guess=guess)


def test_frame_closure_with_a_massless_pin_link_is_the_hinge():
    """Six rows of rank three, one link without mass: the same four-bar."""
    plain = pc.simulate(planar_bars(False), (0.0, 0.3), {"crank": -1.0}, step=0.005, order=3, method="BDF")
    framed = pc.simulate(planar_bars(True), (0.0, 0.3), {"crank": -1.0}, step=0.005, order=3, method="BDF")
    np.testing.assert_allclose(framed.q[:, [0, 1, 3]], plain.q, atol=1e-11)
    np.testing.assert_allclose(framed.lam[:, [0, 2]], turned(framed, plain), atol=1e-7)
    np.testing.assert_allclose(framed.lam[:, [1, 3, 4, 5]], 0.0, atol=1e-8)  # a free pin transmits no moment


def turned(framed, plain):
    """The point closure's forces (axes of the coupler) in the axes of the pin link, x and z."""
    forces = []
    for q, lam in zip(framed.q, plain.lam, strict=True):
        turn = pin.utils.rotate("y", -q[2])
        forces.append((turn @ lam)[[0, 2]])
    return np.array(forces)


PERIOD = 2.3678419475762373


def rod():
    """A pendulum in Cartesian coordinates held by a rod, released level: the A01 benchmark, L = 1 m, g = 9.81 m/s²."""
    model = pin.Model()
    x = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "x")
    z = model.addJoint(x, pin.JointModelPZ(), pin.SE3.Identity(), "z")
    model.appendBodyToJoint(z, pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
    model.addFrame(pin.Frame("bob", z, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    return pc.Mechanism(model, [pc.Loop("rod", "distance", "universe", "bob", length=1.0)], guess={"x": -1.0})


def test_distance_closure_is_the_massless_rod():
    sol = pc.simulate(rod(), (0.0, PERIOD), step=PERIOD / 1000, order=5, method="BDF")
    np.testing.assert_allclose(sol.q[-1], [-1.0, 0.0], atol=1e-6)
    bottom = np.argmin(sol.q[:, 1])
    assert sol.lam[bottom, 0] == pytest.approx(-3 * G, rel=1e-4)  # m g + m v²/L with v² = 2 g L, pulling


@pytest.mark.parametrize("count", [942, 1000, 1054, 1138, 1208, 1278])
def test_turning_points_are_passed_at_rounding(count):
    """Velocities of 1e-9 m/s are differences of larger ones, and known as well as those."""
    sol = pc.simulate(rod(), (0.0, PERIOD), step=PERIOD / count, order=5, method="BDF")
    assert sol.success, sol.message
    np.testing.assert_allclose(sol.q[-1], [-1.0, 0.0], atol=1e-6)


def test_hanging_weight_shows_sign_frame_and_unit_of_the_multipliers():
    """A 2 kg body hangs from a frame closure whose anchor 1 is on the ground, turned by 90° about y."""
    model = pin.Model()
    free = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "free")
    model.appendBodyToJoint(free, pin.Inertia(2.0, np.array([0.3, 0, 0]), np.eye(3)), pin.SE3.Identity())
    model.addFrame(pin.Frame("body", free, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    turn = (0.0, np.pi / 2, 0.0)
    loop = pc.Loop("weld", "frame", "universe", "body", rpy1=turn, rpy2=turn)
    sol = pc.simulate(pc.Mechanism(model, [loop]), (0.0, 0.1), step=0.01, order=2, method="BDF")
    # world up is -x of the turned anchor; gravity's moment 2 g 0.3 about +y of the world (and of the anchor) is held
    force, moment = sol.lam[-1, :3], sol.lam[-1, 3:]
    np.testing.assert_allclose(force, [-2 * G, 0, 0], atol=1e-9)
    np.testing.assert_allclose(moment, [0, -2 * G * 0.3, 0], atol=1e-9)
    swapped = pc.Loop("weld", "frame", "body", "universe", rpy1=turn, rpy2=turn)
    other = pc.simulate(pc.Mechanism(model, [swapped]), (0.0, 0.1), step=0.01, order=2, method="BDF")
    np.testing.assert_allclose(other.lam[-1], -sol.lam[-1], atol=1e-9)  # λ acts on body 2: now on the ground


def test_joint_damping_and_friction_of_the_model_act():
    """One hinge without gravity: damping decays exponentially, dry friction stops at v0 I / f."""
    model = pin.Model()
    hinge = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "hinge")
    model.appendBodyToJoint(hinge, pin.Inertia(1.0, np.zeros(3), np.eye(3) * 2.0), pin.SE3.Identity())
    model.gravity.setZero()
    model.damping[:] = 0.5
    damped = pc.simulate(pc.Mechanism(model), (0.0, 2.0), v0={"hinge": 3.0}, step=0.01, order=5, method="BDF")
    np.testing.assert_allclose(damped.v[:, 0], 3.0 * np.exp(-0.25 * damped.t), rtol=1e-8)
    model.damping[:] = 0.0
    model.upperDryFrictionLimit[:] = 1.5
    sol = pc.simulate(pc.Mechanism(model), (0.0, 5.0), v0={"hinge": 3.0}, t_eval=[0.0, 1.0, 5.0])
    assert sol.v[1, 0] == pytest.approx(3.0 - 0.75, rel=1e-5)  # sliding
    assert abs(sol.v[-1, 0]) < 1e-6  # stopped after v0 I / f = 4 s


@pytest.mark.parametrize("torque", [np.array([2.0]), lambda t, q, v: [2.0], pc.JointTorque({"hinge": 2.0})])
def test_torques_act(torque):
    model = pin.Model()
    hinge = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "hinge")
    model.appendBodyToJoint(hinge, pin.Inertia(1.0, np.zeros(3), np.eye(3) * 4.0), pin.SE3.Identity())
    forces = torque if callable(torque) else [torque]
    sol = pc.simulate(pc.Mechanism(model), (0.0, 2.0), step=0.1, order=2, forces=forces, method="BDF")
    assert sol.q[-1, 0] == pytest.approx(0.5 * 0.5 * 4.0)


def test_a_tree_without_loops_simply_runs():
    """The double pendulum against scipy's DOP853 on Pinocchio's forward dynamics."""
    from scipy.integrate import solve_ivp

    mech = pc.load("double_pendulum")
    q0 = pc.assemble(mech).q
    sol = pc.simulate(mech, (0.0, 1.0), step=0.0025, order=5, method="BDF")
    assert sol.lam.shape == (len(sol.t), 0)
    data, n = mech.model.createData(), mech.nv
    run = solve_ivp(
        lambda t, y: np.concatenate((y[n:], pin.aba(mech.model, data, y[:n], y[n:], np.zeros(n)))),
        (0.0, 1.0), np.concatenate((q0, np.zeros(n))), "DOP853", rtol=1e-12, atol=1e-12,
    )  # fmt: skip
    np.testing.assert_allclose(np.concatenate((sol.q[-1], sol.v[-1])), run.y[:, -1], atol=1e-8)


def test_mechanism_is_immutable_and_picklable():
    mech = pc.load("four_bar")
    with pytest.raises(AttributeError):
        mech.name = "other"
    model = mech.model.copy()
    copy = pickle.loads(pickle.dumps(mech))
    assert copy.model == model and copy.loops == mech.loops and copy.joints == mech.joints
    runs = [pc.simulate(each, (0.0, 0.1), step=0.01) for each in (mech, copy)]
    np.testing.assert_array_equal(runs[0].q, runs[1].q)


def test_the_users_model_is_not_touched():
    model = pin.buildSampleModelManipulator()
    before = model.copy()
    pc.Mechanism(model).with_gravity([0, 0, -1.62]).with_armature({model.names[1]: 0.1})
    assert model == before


def test_joints_out_of_depth_first_order_are_refused():
    """Pinocchio's crba is silently wrong for such a model, which this test shows as well."""
    model = pin.Model()
    body = pin.Inertia(1.0, np.array([0.5, 0.0, 0.0]), np.eye(3))
    at = pin.SE3(np.eye(3), np.array([1.0, 0.0, 0.0]))
    a = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "a")
    b = model.addJoint(0, pin.JointModelRY(), at, "b")
    c = model.addJoint(a, pin.JointModelRZ(), at, "c")
    for joint in (a, b, c):
        model.appendBodyToJoint(joint, body, pin.SE3.Identity())
    data, q, zero = model.createData(), np.array([0.3, 0.4, 0.5]), np.zeros(3)
    M = np.array(pin.crba(model, data, q))
    bias = pin.rnea(model, data, q, zero, zero)
    columns = np.column_stack([pin.rnea(model, data, q, zero, unit) - bias for unit in np.eye(3)])
    assert np.abs(np.triu(M) - np.triu(columns)).max() > 1e-3
    with pytest.raises(pc.InputError, match=r"depth-first.*'c'.*'b'.*'a'"):
        pc.Mechanism(model)


def test_massless_motion_names_its_joints():
    model = pin.Model()
    a = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "heavy")
    model.appendBodyToJoint(a, pin.Inertia(1.0, np.array([0.5, 0, 0]), np.eye(3)), pin.SE3.Identity())
    model.addJoint(a, pin.JointModelRX(), pin.SE3.Identity(), "weightless")
    mech = pc.Mechanism(model)
    with pytest.raises(pc.SingularSystemError, match="weightless") as caught:
        pc.simulate(mech, (0.0, 1.0), step=0.1)
    assert caught.value.names == ("weightless",)
    assert pc.simulate(mech.with_armature({"weightless": 1e-3}), (0.0, 1.0), step=0.1).success


def test_kept_rows_are_as_many_as_the_rank():
    mech = pc.load("four_bar")
    system = MechanismSystem(mech, pc.assemble(mech).q)
    assert (system.nc, system.rows.nc) == (2, 5)


def test_a_start_at_a_singular_position_is_refused(monkeypatch):
    """A parallelogram with all bars in line: rank 1 here, 2 nearby. Were it not noticed, the run would say so."""
    mech, in_line = pc.load("n_four_bar_1"), np.array([np.pi / 2, -np.pi / 2, np.pi / 2])
    with pytest.raises(pc.SingularSystemError, match=r"singular configuration.*B1.*rank 1 here and 2 nearby") as caught:
        pc.simulate(mech, (0.0, 1.0), in_line)
    assert caught.value.names == ("B1",)
    monkeypatch.setattr("pinconsist.mechanism.system.RANK_DISTANCE", 0.0)
    sol = pc.simulate(mech, (0.0, 1.0), in_line)
    assert not sol.success and "are open by" in sol.message and "'B1'" in sol.message


def test_rows_that_always_depend_are_no_singular_position():
    """Bricard's loop has rank 4 of 5 in every closed configuration."""
    assert pc.simulate(pc.load("bricard"), (0.0, 0.1)).success


def test_pinocchios_mimic_joints_are_refused():
    model = pin.Model()
    for name in ("a", "b"):
        joint = model.addJoint(0 if name == "a" else 1, pin.JointModelRY(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3(np.eye(3), np.array([1.0, 0, 0])))
    mimic = pin.transformJointIntoMimic(model, 1, 2, 2.0, 0.1)
    with pytest.raises(pc.InputError, match=r"joint 'b' .* mimic joints.* Coupling"):
        pc.load(mimic)


def test_a_mechanism_is_not_loaded_again_without_its_loops():
    with pytest.raises(pc.InputError, match="'four_bar' is already a Mechanism"):
        pc.load(pc.load("four_bar"))


@pytest.mark.parametrize("dirs", [3, (3,)])
def test_package_dirs_are_folders(dirs):
    with pytest.raises(pc.InputError, match="package_dirs= needs folders"):
        pc.load("four_bar", package_dirs=dirs)


def _misplaced(model):
    place = model.jointPlacements[2]
    place.translation = np.array([np.nan, 0.0, 0.0])
    model.jointPlacements[2] = place


def _stretched(model):
    place = model.jointPlacements[2]
    place.rotation = 1.01 * np.eye(3)
    model.jointPlacements[2] = place


def _without_gravity(model):
    model.gravity.linear = np.array([0.0, 0.0, np.inf])


def _lightened(model):
    model.armature[1] = -1.0


@pytest.mark.parametrize(
    "spoil, message",
    [
        (_misplaced, "the placement of joint 'coupler' is not finite"),
        (_stretched, "the placement of joint 'coupler' .* its rotation matrix is not a rotation"),
        (_without_gravity, "the gravity of model .* is not finite"),
        (_lightened, "the armature of joint 'coupler' is negative"),
    ],
)
def test_models_with_impossible_numbers_are_refused(spoil, message):
    model = pc.load("four_bar").model.copy()
    spoil(model)
    with pytest.raises(pc.InputError, match=message):
        pc.Mechanism(model)


def test_a_mechanism_is_called_as_its_model():
    model = pc.load("four_bar").model.copy()
    model.name = "scissors"
    assert pc.Mechanism(model).name == "scissors" and pc.Mechanism(model, name="lift").name == "lift"
    model.name = ""
    assert pc.Mechanism(model).name == "mechanism"
