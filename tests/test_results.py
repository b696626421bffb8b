"""Results by name, configurations by name, tables, and what is shown of mechanisms and solutions."""

import csv
import re
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from helpers.bodies import mixed_tree

import pinconsist as pc
from pinconsist.cli.scene import joint_values
from pinconsist.mechanism.names import position_names, position_units, velocity_names, velocity_units


@pytest.fixture(scope="module")
def four_bar():
    return pc.load("four_bar")


@pytest.fixture(scope="module")
def sol(four_bar):
    forces = [pc.Servo("crank", 0.5, 10.0, 1.0), pc.JointSpring("rocker", 3.0), pc.JointTorque({"coupler": 0.25})]
    return pc.simulate(four_bar, (0.0, 0.3), forces=forces)


def test_positions_and_velocities_are_the_columns(four_bar, sol):
    for i, joint in enumerate(four_bar.joints):
        np.testing.assert_array_equal(sol.position(joint), sol.q[:, i])
        np.testing.assert_array_equal(sol.velocity(joint), sol.v[:, i])


def test_accelerations_solve_the_equations_of_motion(four_bar, sol):
    model, data = four_bar.model, four_bar.model.createData()
    a = sol.acceleration()
    loop = sol.reaction("coupler_rocker").joint_forces
    for i in (0, 5, len(sol.t) - 1):
        q, v = sol.q[i], sol.v[i]
        tau = np.array([10.0 * (0.5 - q[0]) - v[0], 0.25, -3.0 * q[2]])
        miss = pin.rnea(model, data, q, v, a[i]) - tau - loop[i]
        assert np.abs(miss).max() < (1e-9 if i == 0 else 1e-3)  # lam has the accuracy of the run
    np.testing.assert_array_equal(sol.acceleration("coupler"), a[:, 1])


@pytest.mark.parametrize("axis", [0, 2])
def test_a_frame_moves_as_its_positions_say(four_bar, sol, axis):
    frame, h = sol.frame("rocker"), 1e-5
    a, model, data = sol.acceleration(), four_bar.model, four_bar.model.createData()
    number = model.getFrameId("rocker")
    for i in (3, len(sol.t) // 2):
        places, turns = [], []
        for s in (-h, 0.0, h):
            pin.framesForwardKinematics(model, data, sol.q[i] + s * sol.v[i] + s**2 / 2 * a[i])
            places.append(data.oMf[number].translation[axis])
            turns.append(data.oMf[number].rotation.copy())
        assert places[1] == pytest.approx(frame.position[i, axis])
        np.testing.assert_allclose(turns[1], frame.rotation[i])
        assert (places[2] - places[0]) / (2 * h) == pytest.approx(frame.velocity[i, axis], abs=1e-7)
        bend = (places[2] - 2 * places[1] + places[0]) / h**2
        assert bend == pytest.approx(frame.acceleration[i, axis], rel=1e-4, abs=1e-3)
        spin = pin.log3(turns[0].T @ turns[2]) / (2 * h)
        np.testing.assert_allclose(turns[1] @ spin, frame.angular_velocity[i], atol=1e-6)
    assert frame.angular_acceleration.shape == (len(sol.t), 3)


def test_torques_follow_their_laws_and_powers_add_up(sol):
    servo = 10.0 * (0.5 - sol.position("crank")) - sol.velocity("crank")
    np.testing.assert_allclose(sol.torque("servo crank"), servo, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(sol.torque("servo"), servo, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(sol.torque("rocker"), -3.0 * sol.position("rocker"), rtol=1e-12)
    np.testing.assert_allclose(sol.torque("torque coupler"), 0.25)
    np.testing.assert_allclose(sol.power("servo"), servo * sol.velocity("crank"), rtol=1e-12, atol=1e-12)
    joints = sum(sol.power(joint) for joint in ("crank", "coupler", "rocker"))
    forces = sum(sol.power(label) for label in ("servo", "spring", "torque coupler"))
    np.testing.assert_allclose(joints, forces, atol=1e-12)


def test_what_a_drive_gave():
    mech = pc.load("crank_rocker")
    mech = mech.add_loops(pc.Drive("motor", "crank", pc.Motion(speed=2.0)))
    sol = pc.simulate(mech, (0.0, 0.2))
    np.testing.assert_array_equal(sol.torque("motor"), sol.reaction("motor").torque)
    np.testing.assert_allclose(sol.torque("crank"), sol.torque("motor"))
    np.testing.assert_allclose(sol.power("motor"), sol.energy().power["motor"], atol=1e-9)
    assert np.abs(sol.acceleration("crank")).max() < 1e-8


def test_names_of_everything(sol):
    assert sol["crank"].torque.shape == sol.t.shape
    assert sol["coupler_rocker"].kind == "hinge"
    assert not sol["crank"].position.flags.writeable
    for call, name, message in (
        (sol.position, "crnk", "joints are crank"),
        (sol.torque, "serv", "similar: servo"),
        (sol.frame, "crnk", "similar: crank"),
        (sol.__getitem__, "crnk", "similar: crank"),
        (sol.velocity, "crank[1]", "no joint"),
    ):
        with pytest.raises(pc.InputError, match=message.replace("no joint", "numbers")):
            call(name)


def test_a_solution_of_a_file_needs_its_mechanism(four_bar, sol, tmp_path):
    read = pc.Solution.load(sol.save(tmp_path / "run.npz"))
    with pytest.raises(pc.InputError, match=r"sol.position\(…, mechanism\)"):
        read.position("crank")
    with pytest.raises(pc.InputError, match=r"has no mechanism: use sol.position\('crank', mechanism\)"):
        read["crank"]
    np.testing.assert_array_equal(read.position("crank", four_bar), sol.position("crank"))
    assert repr(read).startswith("Solution of four_bar")


def test_joints_of_several_numbers():
    model = mixed_tree()
    names, units = position_names(model), position_units(model)
    assert len(names) == len(units) == model.nq
    assert len(velocity_names(model)) == len(velocity_units(model)) == model.nv
    mech = pc.Mechanism(model)
    sol = pc.simulate(mech, (0.0, 0.05))
    for i, joint in enumerate(mech.joints, start=1):
        if model.nvs[i] == 1:
            assert sol.position(joint).shape == sol.t.shape
            continue
        assert sol.position(joint).shape == (len(sol.t), model.nqs[i])
        np.testing.assert_array_equal(sol.velocity(f"{joint}[1]"), sol.velocity(joint)[:, 1])
        turning = {"Spherical": (["rad"] * 3, [""] * 4), "FreeFlyer": (["m"] * 3 + ["rad"] * 3, ["m"] * 3 + [""] * 4)}
        kind = model.joints[i].shortname().removeprefix("JointModel")
        if kind in turning:
            at, to = model.idx_vs[i], model.idx_qs[i]
            assert velocity_units(model)[at : at + model.nvs[i]] == turning[kind][0]
            assert units[to : to + model.nqs[i]] == turning[kind][1]


def test_an_angle_of_cosine_and_sine_goes_on():
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRUBX(), pin.SE3.Identity(), "wheel")
    model.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Identity())
    sol = pc.simulate(pc.Mechanism(model).with_gravity((0, 0, 0)), (0.0, 2.0), v0={"wheel": 9.0})
    np.testing.assert_allclose(sol.position("wheel"), 9.0 * sol.t, atol=1e-5)


POSE = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.2, 0.5), np.array([1.0, 2.0, 3.0]))


@pytest.mark.parametrize(
    "given",
    [
        [1, 2, 3, POSE.rotation],
        [1, 2, 3, 0.3, -0.2, 0.5],
        POSE,
        POSE.homogeneous,
        pin.SE3ToXYZQUAT(POSE),
        [1, 2, 3, POSE.rotation.tolist()],
    ],
)
def test_a_free_flyer_from_a_pose(given):
    model = pin.Model()
    model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    model.addJoint(1, pin.JointModelSpherical(), pin.SE3.Identity(), "ball")
    model.addJoint(2, pin.JointModelPlanar(), pin.SE3.Identity(), "cart")
    q = pc.Mechanism(model).q(base=given, ball=[0.3, -0.2, 0.5], cart=[1.0, 2.0, np.pi / 2])
    np.testing.assert_allclose(q[:7], pin.SE3ToXYZQUAT(POSE), atol=1e-15)
    np.testing.assert_allclose(q[7:11], pin.SE3ToXYZQUAT(POSE)[3:], atol=1e-15)
    np.testing.assert_allclose(q[11:], [1.0, 2.0, 0.0, 1.0], atol=1e-15)


@pytest.mark.parametrize(
    ("given", "message"),
    [([1, 2], "a pin.SE3, got 2"), ([1, 2, 3, 2 * np.eye(3)], "not a rotation"), ([1, 2, 3, "R"], "numbers")],
)
def test_no_pose(given, message):
    model = pin.Model()
    model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    with pytest.raises(pc.InputError, match=message):
        pc.Mechanism(model).q(base=given)


def test_a_configuration_by_names_keeps_the_guess(four_bar):
    q = four_bar.q({"rocker": 0.1}, crank=0.3)
    np.testing.assert_array_equal(q, [0.3, four_bar.guess[1], 0.1])


def test_tables(four_bar, sol, tmp_path):
    with open(sol.to_csv(tmp_path / "run.csv"), encoding="utf-8") as file:
        heads, *rows = csv.reader(file)
    assert heads[:3] == ["t [s]", "q.crank [rad]", "q.coupler [rad]"]
    assert heads[7] == "a.crank [rad/s²]"
    assert heads[-1] == "lam.coupler_rocker.tilt2 [N·m]"
    table = np.array(rows, float)
    np.testing.assert_array_equal(table[:, 1:4], sol.q)  # all digits
    np.testing.assert_array_equal(table[:, -5:], sol.lam)
    pandas = pytest.importorskip("pandas")
    frame = sol.to_dataframe()
    assert isinstance(frame, pandas.DataFrame) and frame.attrs["units"]["v.crank"] == "rad/s"
    np.testing.assert_array_equal(frame["v.rocker"], sol.velocity("rocker"))


@pytest.mark.parametrize("method", ["to_csv", "to_dataframe"])
def test_the_table_of_a_solution_that_was_read_names_what_was_called(sol, tmp_path, method):
    read = pc.Solution.load(sol.save(tmp_path / "run.npz"))
    given = [tmp_path / "run.csv"] if method == "to_csv" else []
    with pytest.raises(pc.InputError, match=rf"sol\.{method}\("):
        getattr(read, method)(*given)


def test_the_table_of_a_problem_without_joints(tmp_path):
    problem = pc.HessenbergProblem(
        U=lambda t, p, v: v,
        F=lambda t, p, v: np.array([0.0, -9.81]),
        G=lambda t, p, v: p[:, None],
        R=lambda t, p: np.array([(p @ p - 1.0) / 2]),
    )
    sol = pc.integrate(problem, (0.0, 0.02), [1.0, 0.0], [0.0, 0.0])
    heads = sol.to_csv(tmp_path / "run.csv").read_text(encoding="utf-8").splitlines()[0]
    assert heads == "t [s],q[0],q[1],v[0],v[1],lam[0]"
    with pytest.raises(pc.InputError, match="no loops and joints"):
        sol.position("crank")


def test_what_is_shown(four_bar, sol):
    assert repr(four_bar).splitlines()[0] == "four_bar: 3 joints (nq 3, nv 3), 1 loop (5 rows)"
    assert "crank" in repr(sol) and len(repr(sol).splitlines()) < 10
    assert "<td>rocker</td>" in four_bar._repr_html_()
    bundle = sol._repr_mimebundle_()
    assert bundle["text/plain"] == repr(sol)
    assert "iframe" in bundle["text/html"] and "image/png" in bundle["text/html"]
    long = pc.load("chain_60")
    assert "(60)" in repr(long) and max(map(len, repr(long).splitlines())) < 120


def test_angles_in_degrees():
    values = joint_values(["knee=30deg", "hip=-90 deg,0.5"], "--at")
    assert values == {"knee": [pytest.approx(np.pi / 6)], "hip": [pytest.approx(-np.pi / 2), 0.5]}


def test_a_notebook_draws_a_mechanism(four_bar):
    """A planar one in its plane: joints are as far apart as in the scene, in one scale."""
    picture = ElementTree.fromstring(re.search(r"<svg.*</svg>", four_bar._repr_html_())[0])
    named = {each[0].text: each for each in picture if len(each)}
    assert tuple(named) == four_bar.joints and len(picture.findall("{*}circle")) == 3 + 2  # and two anchors
    drawn = np.array([[float(each.get(key)) for key in ("cx", "cy")] for each in named.values()])
    data = four_bar.model.createData()
    pin.forwardKinematics(four_bar.model, data, four_bar.guess)
    places = np.array([pose.translation for pose in list(data.oMi)[1:]])
    sizes = [np.linalg.norm(each - np.roll(each, 1, axis=0), axis=1) for each in (drawn, places)]
    np.testing.assert_allclose(sizes[0] / sizes[1], sizes[0][0] / sizes[1][0], rtol=0.01)
    for name in ("stewart_platform", "planar_pendulum"):
        assert "<line" in pc.load(name)._repr_html_()


def test_a_helical_joint_is_measured_in_radians():
    model = pin.Model()
    model.addJoint(0, pin.JointModelHelicalUnaligned(np.array([0.6, 0, 0.8]), 0.2), pin.SE3.Identity(), "screw")
    assert velocity_units(model) == position_units(model) == ["rad"]


def test_forces_of_one_joint_have_one_torque_each():
    """However the joint is given; a force on a body that is called as a joint is not one of that joint."""
    forces = [
        pc.JointDamping({"crank": 0.1}),
        pc.JointTorque({"crank": 0.3}),
        pc.Sampled(0.01, lambda t, q, v: -0.1 * v[:1], joints="crank"),
        pc.Wrench("coupler", (0.0, 0.0, -2.0)),
    ]
    sol = pc.simulate(pc.load("four_bar"), (0.0, 0.05), forces=forces)
    np.testing.assert_allclose(sol.torque("damping crank"), -0.1 * sol.velocity("crank"), rtol=1e-12)
    assert (sol.torque("torque crank") == 0.3).all()
    assert sol.torque("sampled crank").shape == sol.t.shape
    assert sol.torque("wrench coupler").shape == sol.v.shape
    rod = pc.simulate(pc.load("planar_pendulum"), (0.0, 0.05), forces=pc.JointDamping((0.1,)))
    assert rod.torque("damping").shape == rod.v.shape
