"""Actuation: from motors to all joints, and the dynamics that motors feel."""

import copy
import pickle
import warnings
from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from helpers import actuated

import pinconsist as pc
from pinconsist.mechanism.lie import difference
from pinconsist.mechanism.names import velocity_names
from pinconsist.mechanism.parameters import parameter
from pinconsist.mechanism.system import MechanismSystem
from pinconsist.paper.index1 import acceleration

ROBOTS = Path(__file__).resolve().parents[2] / "shared" / "robots"
CASSIE = tuple(f"{side}-{joint}-op" for side in ("left", "right") for joint in ("roll", "yaw", "pitch", "knee", "foot"))
WITH_CARE = ("stewart_platform", "boom", "kangaroo_like", "cassie")
OWN = ("four_bar", "five_bar", "stewart_platform", "delta_robot", "slider_crank")


@cache
def actuation(name):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if name in ("ankle", "boom"):
            return pc.Actuation(getattr(actuated, name)())
        if name in actuated.FREE:
            return pc.Actuation(actuated.held(name))
        if name in OWN:
            return pc.Actuation(pc.load(name))
        if name == "cassie":
            mech = pc.load("cassie", closure="point")  # as hinges its loops hold the knees
            springs = [joint for joint in mech.joints if joint.endswith("spring-joint")]
            return pc.Actuation(mech.lock(springs, pc.assemble(mech).q), CASSIE)
        mech = pc.load(ROBOTS / name)
        if name == "kangaroo_like":
            return pc.Actuation(mech.reanchored(), mech.actuated[:4])  # the loops hold the other two
        return pc.Actuation(mech)


def scenes():
    yield from (*OWN, "ankle", "boom", "cassie", *actuated.FREE)
    for name in ("5bar_linkage_iso6d", "digit_like", "cassie_like", "kangaroo_like"):
        absent = not (ROBOTS / name).is_dir()
        yield pytest.param(name, marks=pytest.mark.skipif(absent, reason="the robots' files are not here"))


def moved(act, rng, far=0.05):
    """A configuration near that of the guess, reached by the motors."""
    with_care = far * (0.1 if act.mechanism.name in WITH_CARE else 1.0)
    start = act.q
    q, ok = act.closure(act.positions() + rng.uniform(-with_care, with_care, len(act.motors)))
    act.q = start
    assert ok, act.message
    return q


def compare_with_a_run(act):
    """Motors that are driven: all joints move as in the index-3 solution. What stays free does so in the run, too."""
    rng, span, mech, model = np.random.default_rng(7), 0.004, act.mechanism, act.mechanism.model
    far = 0.1 if mech.name in WITH_CARE else 1.0
    start, rates = act.positions(), far * rng.uniform(-1.0, 1.0, len(act.motors))
    curves = [pc.Motion(at, rate, 0.01 * rate, 3.0) for at, rate in zip(start, rates, strict=True)]
    drives = [pc.Drive(f"by {motor}", motor, curve) for motor, curve in zip(act.motors, curves, strict=True)]
    for joint in act.free:
        if joint in mech.joints:
            held = pc.Motion(act.q[model.idx_qs[mech.joint_index(joint)]])
            drives.append(pc.Drive(f"still {joint}", joint, held))
    spin = [mech.columns(joint.partition("[")[0]) for joint in act.free if joint not in mech.joints]
    seen = np.setdiff1d(np.arange(mech.nv), np.concatenate([np.arange(mech.nv)[part] for part in spin] or [[]]))
    sol = pc.simulate(mech.add_loops(*drives), (0.0, span), q0=act.q, rtol=1e-10, atol=1e-12)
    q, ok = act.closure([curve(span) for curve in curves], q=act.q)
    assert ok, act.message
    np.testing.assert_allclose(pin.difference(model, q, sol.q[-1])[seen], 0.0, atol=1e-10)
    v, a = ([getattr(curve, part)(span) for curve in curves] for part in ("rate", "acceleration"))
    for mine, runs in (act.velocity(q, v), sol.v[-1]), (act.acceleration(q, v, a), sol.acceleration()[-1]):
        np.testing.assert_allclose(mine[seen], runs[seen], atol=1e-10 * max(1.0, np.abs(runs).max()))
    act.closure(start)


@pytest.mark.parametrize("name", list(scenes()))
def test_the_reduced_dynamics_are_those_of_all_joints(name):
    """Closure, velocities and accelerations are those of the KKT system and of a run of the whole mechanism."""
    act, rng = actuation(name), np.random.default_rng(3)
    q, m = moved(act, rng), len(act.motors)
    v_a, tau = rng.standard_normal((2, m))
    v, full = act.velocity(q, v_a), np.zeros(act.mechanism.nv)
    columns = [act.mechanism.columns(motor).start for motor in act.motors]
    full[columns] = tau
    solver_rows = MechanismSystem(act.mechanism, q)
    phi, J = solver_rows.loop_rows(q)
    assert np.abs(phi).max() < 1e-12
    assert np.abs(J @ v).max() < 1e-10 * np.abs(v).max()
    np.testing.assert_allclose(v[columns], v_a, atol=1e-12)
    system = MechanismSystem(act.mechanism.add_forces(full), q)
    a, _ = acceleration(system, 0.0, q, v)
    size = np.abs(a).max()
    a_a = act.forward(q, v_a, tau)
    np.testing.assert_allclose(a_a, a[columns], atol=1e-10 * size)
    np.testing.assert_allclose(
        act.mass_matrix(q) @ a_a + act.bias(q, v_a), tau, atol=1e-9 * np.abs(act.bias(q, v_a)).max()
    )
    if not act.free:
        np.testing.assert_allclose(act.acceleration(q, v_a, a_a), a, atol=1e-10 * size)
        np.testing.assert_allclose(act.jacobian_rate(q, v_a), a - act.jacobian(q) @ a_a, atol=1e-9 * size)
    compare_with_a_run(act)


@pytest.mark.parametrize("name", ["four_bar", "five_bar", "delta_robot", "boom"])
def test_torques_and_reactions_are_those_of_inverse_dynamics(name):
    act, rng = actuation(name), np.random.default_rng(5)
    start, motions = act.positions(), rng.uniform(-0.5, 0.5, (len(act.motors), 2)) * (0.1 if name == "boom" else 1.0)
    drives = [
        pc.Drive(f"motor {motor}", motor, pc.Motion(start=at, speed=speed, amplitude=size, frequency=0.7))
        for motor, at, (speed, size) in zip(act.motors, start, motions, strict=True)
    ]
    mech = act.mechanism.add_loops(*drives)
    given = pc.inverse_dynamics(mech, [0.0, 0.1, 0.2])
    for i, t in enumerate(given.t):
        q, ok = act.closure([drive.curve(t) for drive in drives])
        assert ok
        np.testing.assert_allclose(q, given.q[i], atol=1e-11)
        v, a = ([getattr(drive.curve, part)(t) for drive in drives] for part in ("rate", "acceleration"))
        np.testing.assert_allclose(act.velocity(q, v), given.v[i], atol=1e-10)
        np.testing.assert_allclose(act.acceleration(q, v, a), given.a[i], atol=1e-10)
        found = act.torques(q, v, a, t=t)
        size = max(np.abs(given.torques[drive.name]).max() for drive in drives)
        for motor, drive in zip(act.motors, drives, strict=True):
            assert found.torques[motor] == pytest.approx(given.torques[drive.name][i], abs=1e-10 * size)
        for loop in act.mechanism.anchored_loops:
            np.testing.assert_allclose(
                found.reaction(loop.name).force[0], given.reaction(loop.name).force[i], atol=1e-8 * size
            )
    act.closure(start)


def test_a_run_of_the_whole_mechanism_is_the_closure_of_its_motors():
    act = actuation("five_bar")
    mech = act.mechanism.add_loops(
        pc.Drive("a", "left_crank", pc.Motion(start=-2.2, amplitude=0.4, frequency=1.0)),
        pc.Drive("b", "right_crank", pc.Motion(start=-2.2 + 1.2584073464102067, amplitude=-0.3, frequency=0.6)),
    )
    sol = pc.simulate(mech, (0.0, 0.3))
    q, ok = act.closure(sol.q[:, [0, 2]])
    assert ok.all()
    np.testing.assert_allclose(q, sol.q, atol=1e-10)
    for i in (5, len(sol.t) - 1):
        np.testing.assert_allclose(act.velocity(sol.q[i], sol.v[i, [0, 2]]), sol.v[i], atol=1e-10)
    act.closure([-2.2, -2.2 + 1.2584073464102067])


def test_an_ankle_of_two_rods_in_closed_form():
    act, rng = actuation("ankle"), np.random.default_rng(0)
    for pitch, roll in rng.uniform(-0.4, 0.4, (20, 2)):
        q, ok = act.closure(actuated.ankle_motors(pitch, roll))
        assert ok
        np.testing.assert_allclose(q[:2], (pitch, roll), atol=1e-10)
        h = 1e-4  # the map from foot to motors by differences, and its inverse
        around = [[actuated.ankle_motors(pitch + a, roll + b) for a, b in ((s * h, 0), (0, s * h))] for s in (-1, 1)]
        slope = (np.array(around[1]) - np.array(around[0])).T / (2 * h)
        np.testing.assert_allclose(act.jacobian()[:2] @ slope, np.eye(2), atol=1e-6)
        M = np.linalg.inv(slope).T @ foot_inertia(act, q) @ np.linalg.inv(slope)
        np.testing.assert_allclose(act.mass_matrix(), M + 0.0101 * np.eye(2) + motor_offset(), rtol=1e-5)
    act.closure(actuated.ankle_motors(0.0, 0.0))


def foot_inertia(act, q):
    return pin.crba(act.mechanism.model, act.mechanism.model.createData(), q)[:2, :2]


def motor_offset():
    """The horns: 0.05 kg at half the horn, 1e-5 kg·m² about it, less what stands in the test."""
    return (0.05 * (actuated.HORN / 2) ** 2 + 1e-5 - 1e-4) * np.eye(2)


def test_a_boom_on_a_cylinder_in_closed_form():
    act = actuation("boom")
    start = act.positions()
    for length in np.linspace(0.35, 1.1, 16):
        q, ok = act.closure({"cylinder": length})
        assert ok
        angle = actuated.boom_angle(length)
        assert q[0] == pytest.approx(angle, abs=1e-12)
        lever = actuated.FOOT * actuated.TOP * np.cos(angle) / length  # dl/d(-angle): the area of the triangle
        assert act.jacobian()[0, 0] == pytest.approx(-1.0 / lever, rel=1e-10)
    ends = act.limits()[0]
    assert ends.lower == pytest.approx(actuated.TOP - actuated.FOOT, abs=1e-6)
    assert ends.upper == pytest.approx(actuated.TOP + actuated.FOOT, abs=1e-6)
    assert ends.lower_by == ends.upper_by == "singular" and "boom" in ends.upper_moves
    act.closure(start)


@pytest.mark.parametrize("seed", [0, 1])
def test_random_walks_stay_in_their_mode_of_assembly(seed):
    """The tip stays on its side; goals beyond the singular curve are refused, those short of it are reached."""
    act, rng = pc.Actuation(actuated.five_bar()), np.random.default_rng(seed)
    blocked = 0
    for _ in range(250):
        goal = act.positions() + rng.normal(0.0, 0.4, 2)
        ends = actuated.elbows(*goal)
        q, ok = act.closure(goal)
        assert actuated.five_bar_side(q) > 0.0
        if ok:
            apart = q - actuated.five_bar_configuration(*goal)
            assert np.abs(np.remainder(apart + np.pi, 2 * np.pi) - np.pi).max() < 1e-9
        blocked += not ok
        assert not ok or np.linalg.norm(ends[1] - ends[0]) < 2 * actuated.DISTAL
    assert 3 < blocked < 230
    assert act.condition() < 1.0


@pytest.mark.parametrize("name", ["four_bar", "five_bar", "delta_robot", "ankle", "boom"])
def test_short_ways_and_none_at_all_are_not_blocked(name):
    """Motors that stand where they should, or nearly, as those of a controller at rest."""
    act, rng = actuation(name), np.random.default_rng(2)
    chosen, start = act._chosen, act.q
    for _ in range(5):
        q = moved(act, rng)
        for way in (0.0, 1e-16, 1e-12, 1e-9, 5e-9, -1e-12, -5e-9):
            found, ok = act.closure(act.positions(q) + way, q=q)
            assert ok, (way, act.message)
            np.testing.assert_allclose(pin.difference(act.mechanism.model, q, found), 0.0, atol=1e-6)
            assert chosen.follower.follow(q, np.full(len(chosen.columns), way))[1] == 1.0
    act.q = start


def test_what_blocks_the_way_is_said():
    act = pc.Actuation(actuated.five_bar())
    q, ok = act.closure([-3.6, 0.3])
    assert not ok and "singular configuration" in act.message and "left_distal, right_distal can move" in act.message
    ends = actuated.elbows(*q[[0, 2]])
    assert np.linalg.norm(ends[1] - ends[0]) == pytest.approx(2 * actuated.DISTAL, abs=1e-5)
    assert act.condition() < 1e-2
    assert act.closure([-2.0, -1.2])[1] and act.message == ""  # and back
    np.testing.assert_allclose(act.q, actuated.five_bar_configuration(-2.0, -1.2), atol=1e-9)


def test_limits_of_joints_and_dead_centres():
    mech = pc.load("crank_rocker")  # 0.25, 0.70, 0.60 m on 0.80 m
    act = pc.Actuation(mech)
    (whole,) = act.limits()
    assert whole.lower == -np.inf and whole.upper == np.inf and whole.upper_by == "nothing"
    coupler = mech.model.idx_qs[mech.joint_index("coupler")]
    model = mech.model.copy()
    model.upperPositionLimit[coupler], model.lowerPositionLimit[coupler] = -0.7, -4.0
    (limited,) = pc.Actuation(pc.Mechanism(model, mech.loops, guess=mech.guess, actuated=("crank",))).limits()
    assert limited.upper_by == limited.lower_by == "coupler"
    ends = [act.closure([end])[0][coupler] for end in (limited.lower, limited.upper)]
    assert ends == pytest.approx([-0.7, -0.7], abs=1e-8) or sorted(ends) == pytest.approx([-4.0, -0.7], abs=1e-8)
    (rocker,) = pc.Actuation(mech, ["rocker"], {"crank": 0.5}).limits()  # against the coupler: at its ends the crank
    ends = [np.pi - np.arccos((0.85 - far**2) / 0.84) for far in (1.05, 0.55)]  # lies along the ground
    assert (rocker.lower, rocker.upper) == pytest.approx(ends, abs=1e-6)
    assert rocker.lower_by == rocker.upper_by == "singular" and "crank" in rocker.upper_moves
    assert rocker.upper_condition < 1e-3


def test_more_motors_than_motions_share_the_load():
    mech = pc.load("four_bar")
    one, two = pc.Actuation(mech), pc.Actuation(mech, ["crank", "rocker"])
    assert "1 more than needed" in repr(two)
    q = one.q
    single = one.torques(q, [1.0], [2.0])
    shared = two.torques(q, single.v, single.a)
    ratio = one.jacobian(q)[2, 0]
    assert shared.tau @ [1.0, ratio] == pytest.approx(single.tau[0])  # the same work
    np.testing.assert_allclose(shared.tau, single.tau[0] * np.array([1.0, ratio]) / (1.0 + ratio**2), atol=1e-12)
    a = two.forward(q, [1.0, ratio], shared.tau)
    np.testing.assert_allclose(a, one.acceleration(q, [1.0], [2.0])[[0, 2]], atol=1e-10)
    M, h = two.mass_matrix(q), two.bias(q, [1.0, ratio])
    np.testing.assert_allclose(M @ a + h, shared.tau, atol=1e-10)
    goal = one.closure({"crank": -0.9})[0]
    assert two.closure({"crank": -0.9, "rocker": goal[2]})[1]
    assert not two.closure({"crank": -0.8, "rocker": goal[2]})[1]
    assert "contradict each other: rocker" in two.message


def test_fewer_motors_than_motions_say_what_stays_free():
    mech = pc.load("five_bar")
    with pytest.warns(UserWarning, match="1 motor leaves 1 of 2 motions free, those of .*these are held"):
        act = pc.Actuation(mech, ["left_crank"])
    assert len(act.free) == 1
    q, ok = act.closure({"left_crank": -2.0})
    assert ok and q[mech.columns(act.free[0])] == pytest.approx(act.mechanism.guess[mech.columns(act.free[0])])
    a = act.forward(q, [0.3], [1.0])  # the free motion follows without torque
    both = pc.Actuation(mech, ["left_crank", act.free[0]], q)
    v = act.velocity(q, [0.3])[[mech.columns(name).start for name in both.motors]]
    np.testing.assert_allclose(both.forward(q, v, [1.0, 0.0])[0], a[0], rtol=1e-10)
    follows = act.torques(q, [0.3], a)
    np.testing.assert_allclose(follows.tau, [1.0], atol=1e-10)
    with pytest.raises(pc.SingularSystemError, match=r"cannot produce this motion.*free motions of"):
        act.torques(q, [0.3], np.zeros(4))


def test_motors_that_cannot_move_are_named():
    q = pc.assemble(pc.load("slider_crank"), {"crank": 0.0}).q
    slide = next(joint for joint in pc.load("slider_crank").joints if "slid" in joint or "piston" in joint)
    with pytest.raises(pc.SingularSystemError, match=rf"the loops do not let these motors move: {slide}"):
        pc.Actuation(pc.load("slider_crank"), [slide], q)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda mech: pc.Actuation(mech, []), "no motors"),
        (lambda mech: pc.Actuation(mech, ["crnk"]), "no joint 'crnk'"),
        (lambda mech: pc.Actuation(mech, ["crank", "crank"]), "named twice"),
        (lambda mech: pc.Actuation(mech).closure({"rocker": 1.0}), "'rocker' is not a motor; the motors are crank"),
        (lambda mech: pc.Actuation(mech).closure([1.0, 2.0]), "1 columns, got shape"),
        (lambda mech: pc.Actuation(mech).closure([1.0], q=np.zeros(3)), "open by"),
        (lambda mech: pc.Actuation(mech).jacobian(np.full(3, np.nan)), "q has a number that is not finite"),
        (
            lambda mech: pc.Actuation(mech, ["crank", "rocker"]).closure({"crank": [0.1, 0.2], "rocker": [1.0] * 3}),
            "of a batch must have the same length",
        ),
        (lambda mech: pc.Actuation(mech).velocity(None, [1.0, 2.0]), r"shape \(1,\), for crank, or \(3,\)"),
        (lambda mech: pc.Actuation(mech).torques(forces={"crank": [1.0]}), "three or six numbers"),
        (lambda mech: pc.Actuation(mech).frame("tip"), "no frame 'tip'"),
        (lambda mech: pc.Actuation(mech).table({"crank": [1.0]}, "a.xls"), "npz or .csv"),
        (lambda mech: pc.Actuation(mech).table({"rocker": [1.0]}), "'rocker' is not a motor; the motors are crank"),
        (lambda mech: pc.Actuation(mech).table({}), "a mapping of motors to positions"),
        (lambda mech: pc.Actuation(mech).table({"crank": [[1.0, 2.0]]}), "must be one-dimensional"),
        (lambda mech: pc.Actuation(mech).torques(forces=[1.0, 2.0, 3.0]), "a mapping of frames to forces"),
    ],
)
def test_wrong_arguments(call, message):
    with pytest.raises(pc.InputError, match=message):
        call(pc.load("four_bar"))


def test_batches_and_names():
    act = actuation("five_bar")
    left = np.linspace(-2.2, -1.9, 5)
    q, ok = act.closure({"left_crank": left})
    assert q.shape == (5, 4) and ok.all()
    np.testing.assert_allclose(q[:, 0], left)
    one, good = act.closure({"left_crank": -2.2})
    assert good is True and one.shape == (4,)
    assert actuation("five_bar").positions() == pytest.approx([-2.2, -2.2 + 1.2584073464102067])


def test_a_configuration_that_is_open_is_no_answer():
    act = pc.Actuation(pc.load("four_bar"))
    q, _ = act.closure({"crank": -0.9})
    for call in (act.jacobian, act.mass_matrix, act.gravity, act.limits, act.condition, act.torques):
        with pytest.raises(pc.InputError, match="q is open by"):
            call({"crank": 0.2})  # the others are where they were
    with pytest.raises(pc.InputError, match="q is open by"):
        act.closure({"crank": -0.8}, q=q + 0.1)
    np.testing.assert_array_equal(act.q, q)
    q += 0.1  # the caller's own
    assert act.closure({"crank": -0.8})[1]


def test_frames_forces_and_back():
    act = actuation("ankle")
    sole, start = act.frame("sole"), act.q
    act.closure(actuated.ankle_motors(0.1, -0.2))
    J, h = sole.jacobian(), 1e-5
    base, middle, around = act.positions(), act.q, []
    for sign in (-1.0, 1.0):
        act.closure(base + sign * np.array([h, 0.0]), q=middle)
        around.append(sole.pose())
    act.closure(base, q=middle)
    np.testing.assert_allclose((around[1].translation - around[0].translation) / (2 * h), J[:3, 0], atol=1e-8)
    spin = sole.pose().rotation @ pin.log3(around[0].rotation.T @ around[1].rotation) / (2 * h)
    np.testing.assert_allclose(spin, J[3:, 0], atol=1e-8)
    tau = sole.torques([10.0, -5.0, 2.0])
    np.testing.assert_allclose(sole.torques(sole.force(tau)), tau, atol=1e-10)
    np.testing.assert_allclose(sole.force(J.T @ np.ones(6), moment=True) @ J, J.T @ np.ones(6), atol=1e-10)
    weight = act.torques().tau
    pushed = act.torques(forces={"sole": [0.0, 0.0, 100.0]}).tau  # the ground pushes the sole up
    np.testing.assert_allclose(weight - pushed, sole.torques([0.0, 0.0, 100.0]), atol=1e-9)
    np.testing.assert_allclose(weight, act.gravity(), atol=1e-12)
    act.q = start


def test_springs_are_in_the_bias_not_in_the_weight():
    act = actuation("boom")
    sprung = pc.Actuation(act.mechanism.add_forces(pc.JointSpring("boom", 50.0, 0.4)))
    torque = 50.0 * (sprung.q[0] - 0.4)
    np.testing.assert_allclose(sprung.bias() - act.bias(), torque * sprung.jacobian()[0], rtol=1e-10)
    np.testing.assert_allclose(sprung.gravity(), act.gravity())


def test_a_floating_robot_has_its_base_among_the_motors():
    model = pin.Model()
    base = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(base, pin.Inertia(3.0, np.array([0.1, 0, 0]), np.eye(3)), pin.SE3.Identity())
    inner = actuated.ankle()
    for i in range(1, inner.model.njoints):
        parent = base if inner.model.parents[i] == 0 else inner.model.parents[i] + 1
        model.addJoint(parent, inner.model.joints[i], inner.model.jointPlacements[i], inner.model.names[i])
        model.appendBodyToJoint(i + 1, inner.model.inertias[i], pin.SE3.Identity())
    for frame in inner.model.frames:
        if frame.name.endswith(("horn", "heel")):
            model.addFrame(pin.Frame(frame.name, frame.parentJoint + 1, 0, frame.placement, pin.FrameType.OP_FRAME))
    guess = dict(zip(("left", "right"), actuated.ankle_motors(0.0, 0.0), strict=True))
    act = pc.Actuation(pc.Mechanism(model, inner.loops, guess=guess), ["base", "left", "right"])
    assert act.motors[:2] == ("base[0]", "base[1]") and len(act.motors) == act.mobility == 8 and not act.free
    R = pin.rpy.rpyToMatrix(0.3, 0.2, 0.1)
    goal = dict(zip(("left", "right"), actuated.ankle_motors(0.1, -0.05), strict=True))
    with pytest.raises(pc.InputError, match="several degrees of freedom"):
        act.closure(np.zeros(8))
    q, ok = act.closure({"base": [1.0, 2.0, 3.0, R], **goal})
    assert ok
    np.testing.assert_allclose(q[7:9], [0.1, -0.05], atol=1e-10)
    np.testing.assert_allclose(pin.Quaternion(q[3:7]).toRotationMatrix(), R, atol=1e-12)


def test_tables(tmp_path):
    act = pc.Actuation(actuated.five_bar())
    grid = {"left_crank": np.linspace(-2.2, -1.8, 3), "right_crank": np.linspace(-1.2, 1.5, 4)}
    found = act.table(grid, tmp_path / "map.npz")
    assert found["ok"].reshape(3, 4)[:, 0].all() and not found["ok"].all()
    for (left, right), q, ok, J in zip(*(found[key] for key in ("positions", "q", "ok", "jacobian")), strict=True):
        if ok:
            np.testing.assert_allclose(q, actuated.five_bar_configuration(left, right), atol=1e-9)
        assert J.any() == ok
    np.testing.assert_allclose(found["positions"][:4, 0], -2.2)
    with np.load(tmp_path / "map.npz") as stored:
        np.testing.assert_array_equal(stored["q"], found["q"])
        assert list(stored["motors"]) == ["left_crank", "right_crank"]
    act.table(grid, tmp_path / "map.csv")
    heads = (tmp_path / "map.csv").read_text(encoding="utf-8").splitlines()[0]
    assert heads.startswith("left_crank [rad],right_crank [rad],q.left_crank [rad]") and heads.endswith("ok,condition")


def test_drives_of_motors_are_left_out_and_others_refused():
    mech = pc.load("five_bar")
    drive = pc.Drive("a", "left_crank", pc.Motion(start=-2.2, speed=1.0))
    driven = mech.add_loops(drive)
    assert pc.Actuation(driven).mobility == 2
    with pytest.raises(pc.InputError, match="'a' depends on time"):
        pc.Actuation(driven, ["right_crank"])
    still = mech.add_loops(pc.Drive("a", "left_crank", pc.Motion(start=-2.2)))
    assert pc.Actuation(still, ["right_crank"]).mobility == 1


@pytest.mark.filterwarnings("ignore:.*motions free")
@pytest.mark.parametrize("seed", range(5))
def test_held_joints_stay_where_they_are(seed):
    """Other free joints were chosen on the way, and these then moved. A copy goes the same way."""
    mech = pc.load("stewart_platform")
    act = pc.Actuation(mech, [mech.joints[0]])
    start, goal = act.q.copy(), act.positions() + np.random.default_rng(seed).uniform(-2.0, 2.0, 1)
    names = list(velocity_names(mech.model))
    held = [names.index(name) for name in act.free]
    twins = pickle.loads(pickle.dumps(act)), copy.deepcopy(act)
    q, ok = act.closure(goal)
    np.testing.assert_allclose(difference(mech.model, start, q)[held], 0.0, rtol=0, atol=1e-12)
    for twin in twins:
        np.testing.assert_array_equal(twin.closure(goal)[0], q)
    if ok:
        np.testing.assert_allclose(act.closure(twins[0].positions(start))[0], start, rtol=0, atol=1e-10)


@pytest.mark.parametrize("name", ["delta_robot", "five_bar", "stewart_platform"])
def test_derivatives_of_the_closure_by_parameters(name):
    """Against differences of closures of other mechanisms, with the same positions of the motors."""
    mech = pc.load(name)
    act, loop = pc.Actuation(mech), mech.loops[0]
    names = [f"anchor:{loop.name}.xyz1[0]", f"{loop.name}.xyz2[2]"]
    goals = act.positions() + np.linspace(-0.05, 0.06, 3 * len(act.motors)).reshape(3, -1)
    q, ok = act.closure(goals)
    assert ok.all()
    found = act.derivatives(names, q)
    assert found.shape == (3, mech.nv, 2)
    np.testing.assert_array_equal(act.derivatives(names, q[1]), found[1])
    for i, each in enumerate(names):
        value, step, sides = parameter(mech, each).value, 1e-4, []
        for m in (1, -1, 2, -2):
            other = pc.Actuation(mech.with_parameters({each: value + m * step})).closure(goals)[0]
            sides.append([difference(mech.model, *pair) for pair in zip(q, other, strict=True)])
        plus, minus, far, back = map(np.array, sides)
        exact = (8.0 * (plus - minus) - (far - back)) / (12.0 * step)
        np.testing.assert_allclose(found[:, :, i], exact, rtol=0, atol=1e-6 * (1.0 + np.abs(exact).max()))


def test_lengths_of_redundant_loops_have_no_derivatives_of_the_closure():
    mech = pc.load("bricard")
    act = pc.Actuation(mech, motors=[mech.joints[0]])
    with pytest.raises(pc.InputError, match="cannot vary alone"):
        act.derivatives(["anchor:hinge5.xyz2[0]"])
    with pytest.raises(pc.InputError, match="no number"):
        act.derivatives(["anchor:hinge5.xyz7[0]"])
