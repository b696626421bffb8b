"""Forces: exact derivatives, motions in closed form, and what is refused."""

import dataclasses
import gc
import pickle
import re
import weakref

import numpy as np
import pinocchio as pin
import pytest
from helpers.bodies import differences, frame_pose, mixed_tree, random_state
from helpers.forces import FORCES, law, law_gradient
from helpers.laws import torque_by_hand
from helpers.scenes import slider
from scipy.interpolate import CubicSpline

import pinconsist as pc
from pinconsist.mechanism.forces import as_force, bound_forces, model_forces
from pinconsist.mechanism.system import MechanismSystem

nan = float("nan")


def bound(model, force):
    (only,) = bound_forces(model, [as_force(force)]).values()
    return only


# Derivatives and power ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", FORCES)
def test_derivatives(name):
    """Against finite differences on a tree with every kind of joint, at random states."""
    model, rng, t = mixed_tree(), np.random.default_rng(1), 0.3
    force = bound(model, FORCES[name])
    for speed in (0.0, 1.0, 10.0):
        q, v = random_state(model, rng, speed)
        zero = np.zeros((model.nv, model.nv))
        by_q, by_v = (zero if part is None else part for part in force.derivatives(t, q, v))
        size = 1 + np.abs(force.torque(t, q, v)).max()
        expected = differences(lambda x, q=q: force.torque(t, q, x), v)
        np.testing.assert_allclose(by_v, expected, atol=1e-6 * size)
        if name == "law":
            assert not by_q.any()  # left out of Newton's matrix, as documented
        else:
            at = lambda x, q=q, v=v: force.torque(t, pin.integrate(model, q, x), v)  # noqa: E731
            np.testing.assert_allclose(by_q, differences(at, np.zeros(model.nv)), atol=1e-9 * size)


def test_a_given_gradient_is_taken():
    t, q, v = 0.3, np.array([0.2, -1.0, 0.5]), np.array([0.4, -1.0, 30.0])
    by_q, by_v = pc.Torque(law, law_gradient).derivatives(t, q, v)
    np.testing.assert_allclose(by_q, differences(lambda x: law(t, x, v), q), atol=1e-8 * np.abs(by_q).max())
    np.testing.assert_allclose(by_v, differences(lambda x: law(t, q, x), v), atol=1e-8 * np.abs(by_v).max())


def test_friction_of_fast_joints_is_finite():
    force = bound(pc.load("four_bar").model, pc.JointFriction([0.5, 0.0, 3.0]))
    with np.errstate(all="raise"):
        by_v = force.derivatives(0.0, np.zeros(3), np.array([1e9, 1.0, -1e300]))[1]
    assert np.abs(by_v).max() < 1e-200


@pytest.mark.parametrize("axes", ["world", "local"])
def test_wrench_has_the_power_of_its_force_and_moment(axes):
    """τ·v = f·v_point + m·ω, the velocities from differences of the frame's pose."""
    model, rng, h = mixed_tree(), np.random.default_rng(2), 1e-4
    f, m, xyz = rng.normal(size=(3, 3))
    for frame in ("arm", "raft", "wheel", "puck"):
        q, v = random_state(model, rng)
        before, here, after = (frame_pose(model, pin.integrate(model, q, s * h * v), frame) for s in (-1, 0, 1))
        speed = (after.act(xyz) - before.act(xyz)) / (2 * h)
        spin = pin.log3(after.rotation @ before.rotation.T) / (2 * h)
        R = here.rotation if axes == "local" else np.eye(3)
        tau = bound(model, pc.Wrench(frame, f, m, axes, xyz)).torque(0.0, q, v)
        assert tau @ v == pytest.approx((R @ f) @ speed + (R @ m) @ spin, abs=1e-6)


@pytest.mark.parametrize(
    "name", ["hinge spring", "spring of an unbounded hinge", "spring", "spring to the ground", "bushing"]
)
def test_springs_are_the_gradient_of_what_they_store(name):
    model, rng = mixed_tree(), np.random.default_rng(3)
    spring = bound(model, FORCES[name])
    q, _ = random_state(model, rng)
    rest = np.zeros(model.nv)
    gradient = differences(lambda x: np.array([spring.stored(pin.integrate(model, q, x), rest)[0]]), rest)[0]
    np.testing.assert_allclose(spring.torque(0.0, q, rest), -gradient, atol=1e-8)
    v = rng.normal(size=model.nv)
    assert spring.stored(q, v)[1] == pytest.approx(gradient @ v)


# Motions in closed form -----------------------------------------------------------------------------------------------


def rotor(joint=None, inertia=2.0):
    """A wheel on a hinge, no gravity."""
    model = pin.Model()
    hinge = model.addJoint(0, joint or pin.JointModelRZ(), pin.SE3.Identity(), "hinge")
    model.appendBodyToJoint(hinge, pin.Inertia(1.0, np.zeros(3), np.eye(3) * inertia), pin.SE3.Identity())
    model.gravity.setZero()
    return pc.Mechanism(model, name="rotor")


def raft(inertia=(1.0, 1.0, 1.0), mass=3.0):
    """One free body, no gravity."""
    model = pin.Model()
    model.gravity.setZero()
    free = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "free")
    model.appendBodyToJoint(free, pin.Inertia(mass, np.zeros(3), np.diag(inertia)), pin.SE3.Identity())
    model.addFrame(pin.Frame("body", free, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    return pc.Mechanism(model, name="raft")


TIGHT = {"rtol": 1e-9, "atol": 1e-11}


def test_damped_oscillator():
    m, k, d, rest, x0, v0 = 2.0, 50.0, 3.0, 0.4, 1.0, -0.5
    forces = [pc.JointSpring("slide", k, rest), pc.JointDamping({"slide": d})]
    sol = pc.simulate(slider(m), (0.0, 3.0), {"slide": x0}, {"slide": v0}, forces=forces, **TIGHT)
    decay = d / (2 * m)
    w = np.sqrt(k / m - decay**2)
    a, b = x0 - rest, (v0 + decay * (x0 - rest)) / w
    expected = rest + np.exp(-decay * sol.t) * (a * np.cos(w * sol.t) + b * np.sin(w * sol.t))
    np.testing.assert_allclose(sol.q[:, 0], expected, atol=1e-7)


def test_mass_on_a_point_to_point_spring():
    """Hung from 3 m above: sag m g / k, period 2π √(m/k)."""
    m, k, g, length = 2.0, 200.0, 9.81, 1.5
    spring = pc.SpringDamper("universe", "block", k, length, xyz1=(0.0, 0.0, 3.0))
    rest = 3.0 - length - m * g / k
    sol = pc.simulate(slider(m, g), (0.0, 2.0), {"slide": rest + 0.1}, forces=[spring], **TIGHT)
    np.testing.assert_allclose(sol.q[:, 0], rest + 0.1 * np.cos(np.sqrt(k / m) * sol.t), atol=1e-8)


def test_coulomb_friction_stops_a_block():
    """m v' = -f tanh(v/w) has sinh(v/w) = sinh(v0/w) exp(-f t/(m w)); the block stops after m v0/f = 1 s."""
    m, f, w, v0 = 2.0, 6.0, 0.01, 3.0
    friction = pc.JointFriction({"slide": f}, width=w)
    sol = pc.simulate(slider(m), (0.0, 1.5), v0={"slide": v0}, forces=[friction], **TIGHT)
    log_sinh = v0 / w - np.log(2.0) - f * sol.t / (m * w)  # sinh(300) = exp(300)/2 to rounding
    with np.errstate(over="ignore"):
        expected = w * np.where(log_sinh > 20, log_sinh + np.log(2.0), np.arcsinh(np.exp(log_sinh)))
    np.testing.assert_allclose(sol.v[:, 0], expected, atol=1e-6)
    assert np.interp(1.0, sol.t, sol.v[:, 0]) < 2 * w and sol.v[-1, 0] < 1e-12
    assert sol.q[-1, 0] == pytest.approx(v0**2 * m / (2 * f), rel=1e-4)


URDF = """<robot name="r"><link name="base"/><link name="block"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="slide" type="prismatic">
<parent link="base"/><child link="block"/><axis xyz="1 0 0"/><limit lower="-9" upper="9" effort="99" velocity="99"/>
<dynamics friction="10"/></joint></robot>"""
SDF = """<sdf version="1.8"><model name="r">
<link name="base"/><link name="block"><inertial><mass>1</mass></inertial></link>
<joint name="fixed" type="fixed"><parent>world</parent><child>base</child></joint><joint name="slide" type="prismatic">
<parent>base</parent><child>block</child><axis><xyz>1 0 0</xyz><dynamics><friction>10</friction></dynamics></axis>
</joint></model></sdf>"""
MJCF = """<mujoco model="r"><worldbody><body name="block">
<joint name="slide" type="slide" axis="1 0 0" frictionloss="10"/>
<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize("method", ["BDF", "Radau"])
@pytest.mark.parametrize(("suffix", "text"), [("urdf", URDF), ("sdf", SDF), ("xml", MJCF), ("", "")])
def test_a_block_held_by_friction_creeps_little(suffix, text, method, tmp_path):
    """At 80 % of its friction v = w artanh(0.8), so that ten seconds take it 10 w artanh(0.8) = 0.11 mm."""
    if text:
        (path := tmp_path / f"r.{suffix}").write_text(text)
        mech = pc.load(path)
    else:
        mech = slider(1.0).add_forces(pc.JointFriction({"slide": 10.0}))
    sol = pc.simulate(mech, (0.0, 10.0), forces=[{"slide": 8.0}], method=method)
    assert sol.success and sol.v[-1, 0] == pytest.approx(1e-5 * np.arctanh(0.8), rel=1e-2)
    assert 1.0e-4 < sol.q[-1, 0] < 1.2e-4


@pytest.mark.parametrize("width", [1e-5, 1e-6])
def test_radau_resolves_friction_below_its_tolerances(width):
    """A block that friction stops and holds at 80 %: Radau ended, or took 446 to 20,000 steps, now 28 and 30."""
    mech = slider(1.0).add_forces(pc.JointFriction({"slide": 10.0}, width))
    sol = pc.simulate(
        mech, (0.0, 10.0), v0={"slide": 1.0}, forces=[{"slide": 8.0}], rtol=1e-3, atol=1e-6, method="Radau",
        max_steps=200,
    )  # fmt: skip
    assert sol.success and sol.v[-1, 0] == pytest.approx(width * np.arctanh(0.8), rel=1e-2)
    assert sol.q[-1, 0] == pytest.approx(0.5 / 2.0, abs=1e-3 + 20 * width)


@pytest.mark.parametrize("method", ["BDF", "Radau"])
@pytest.mark.parametrize("tol", [1e-3, 1e-6])
def test_the_default_width_of_friction_costs_few_steps(method, tol):
    """Cranks that friction brings to rest."""
    mech, joints = pc.load("five_bar"), ("left_crank", "left_distal", "right_crank", "right_distal")

    def steps(width):
        friction = pc.JointFriction(dict.fromkeys(joints, 0.3), *width)
        return pc.simulate(
            mech, (0.0, 3.0), forces=[friction], method=method, rtol=tol, atol=tol, max_steps=5000
        ).nsteps

    assert steps(()) <= 3 * steps((1e-2,))


def test_a_servo_follows_a_ramp_with_the_lag_of_the_damping_it_fights():
    k, c, speed = 40.0, 2.0, 1.5
    target = pc.Motion(start=0.3, speed=speed)
    forces = [pc.Servo("hinge", target, k, 12.0), pc.JointDamping({"hinge": c})]
    sol = pc.simulate(rotor(), (0.0, 8.0), forces=forces, **TIGHT)
    assert target(8.0) - sol.q[-1, 0] == pytest.approx(c * speed / k, rel=1e-6)
    assert sol.v[-1, 0] == pytest.approx(speed, rel=1e-6)


@pytest.mark.parametrize("rate", [None, lambda t: 3.0 * np.cos(3.0 * t)])
def test_a_servo_follows_a_curve_as_a_driven_oscillator(rate):
    """I e'' + d e' + k e = I θ_d'' with e = θ_d - θ: amplitude and phase of the steady state."""
    inertia, k, d, w = 2.0, 60.0, 15.0, 3.0
    servo = pc.Servo("hinge", lambda t: np.sin(w * t), k, d, rate)
    sol = pc.simulate(rotor(), (0.0, 6.0), forces=[servo], **TIGHT)
    e = -inertia * w**2 / (k - inertia * w**2 + 1j * d * w)  # complex amplitude of e against sin
    steady = sol.t > 5.0  # the transient has decayed by exp(-15/4 · 5) = 7e-9
    expected = np.sin(w * sol.t) - np.imag(e * np.exp(1j * w * sol.t))
    np.testing.assert_allclose(sol.q[steady, 0], expected[steady], atol=1e-6)


def test_a_servo_sags_under_a_constant_load():
    servo, load = pc.Servo("slide", 0.5, 400.0, 60.0), pc.JointTorque({"slide": 10.0})
    sol = pc.simulate(slider(2.0, 9.81), (0.0, 4.0), forces=[servo, load], **TIGHT)
    assert sol.q[-1, 0] == pytest.approx(0.5 + (10.0 - 2.0 * 9.81) / 400.0, abs=1e-8)


def test_unbounded_joints_take_springs_and_servos_the_shorter_way_round():
    for force in (pc.JointSpring("hinge", 8.0, 0.3), pc.Servo("hinge", 0.3, 8.0)):
        plain = pc.simulate(rotor(), (0.0, 1.0), {"hinge": 2.0}, forces=[force], **TIGHT)
        unbounded = pc.simulate(rotor(pin.JointModelRUBZ()), (0.0, 1.0), {"hinge": 2.0}, forces=[force], **TIGHT)
        np.testing.assert_allclose(np.arctan2(*unbounded.q[-1, ::-1]), plain.q[-1, 0], atol=1e-8)
        wound = bound(rotor(pin.JointModelRUBZ()).model, force)
        for angle, deflection in ((4.0, 3.7 - 2 * np.pi), (-3.0, 2 * np.pi - 3.3)):
            q = np.array([np.cos(angle), np.sin(angle)])
            assert wound.torque(0.0, q, np.zeros(1))[0] == pytest.approx(-8.0 * deflection)


@pytest.mark.parametrize(
    ("torque", "impulse"),
    [
        (2.0, 2.0 * 1.5),
        (lambda t: 3 * t**2, 1.5**3),
        (pc.Motion(1.0, 2.0, 0.5, 0.25), 1.5 + 1.5**2 + (1 - np.cos(0.75 * np.pi)) / np.pi),
    ],
)
def test_torques_by_name(torque, impulse):
    sol = pc.simulate(rotor(), (0.0, 1.5), forces=[{"hinge": torque}], **TIGHT)
    assert sol.v[-1, 0] == pytest.approx(impulse / 2.0, rel=1e-8)


def test_a_world_force_on_a_free_body_gives_its_momentum_and_its_torque_the_spin():
    """Force and moment of constant direction, off the centre of mass, on a tumbling body."""
    mech, f, m, xyz = raft((0.4, 0.7, 0.9)), np.array([1.0, -2.0, 0.5]), np.array([0.2, 0.1, -0.3]), (0.3, 0.2, -0.1)
    v0 = [0.1, 0.2, -0.1, 0.4, 0.5, -0.2]
    sol = pc.simulate(mech, (0.0, 2.0), v0=v0, forces=[pc.Wrench("body", f, m, xyz=xyz)], max_step=0.01, **TIGHT)
    momenta, arms = [], []
    for q, v in zip(sol.q, sol.v, strict=True):
        data = mech.model.createData()
        momentum = pin.computeCentroidalMomentum(mech.model, data, q, v)
        momenta.append((momentum.linear, momentum.angular))
        arms.append(data.oMi[1].rotation @ xyz)
    linear, angular = np.array(momenta).transpose(1, 0, 2)
    np.testing.assert_allclose(linear - linear[0], np.outer(sol.t, f), atol=1e-7)
    swept = CubicSpline(sol.t, np.cross(arms, f) + m).antiderivative()
    np.testing.assert_allclose(angular - angular[0], swept(sol.t), atol=1e-6)


def test_a_local_force_turns_with_its_body():
    """A ball that spins at ω about z: a force along its own x makes momentum F/ω (sin ωt, 1 - cos ωt)."""
    w, F = 3.0, 2.0
    v0 = [0.0, 0.0, 0.0, 0.0, 0.0, w]
    for axes, expected in [
        ("local", lambda t: F / w * np.array([np.sin(w * t), 1 - np.cos(w * t), 0 * t])),
        ("world", lambda t: F * np.array([t, 0 * t, 0 * t])),
    ]:
        sol = pc.simulate(raft(), (0.0, 2.0), v0=v0, forces=[pc.Wrench("body", (F, 0, 0), axes=axes)], **TIGHT)
        world = np.array([pin.XYZQUATToSE3(q).rotation @ v[:3] for q, v in zip(sol.q, sol.v, strict=True)])
        np.testing.assert_allclose(3.0 * world, expected(sol.t).T, atol=1e-6)


def test_a_wrench_of_time():
    sol = pc.simulate(raft(), (0.0, 2.0), forces=[pc.Wrench("body", lambda t: (0, 6 * t, 0))], **TIGHT)
    np.testing.assert_allclose(sol.q[:, 1], sol.t**3 / 3.0, atol=1e-7)


# Springs where they are stiff, or of no length ------------------------------------------------------------------------


def bead(damping):
    """A bead of 1 kg on a string along x, drawn tight between x = ±1 m: across it only the tension holds."""
    model = pin.Model()
    x = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "x")
    z = model.addJoint(x, pin.JointModelPZ(), pin.SE3.Identity(), "z")
    model.appendBodyToJoint(z, pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
    model.addFrame(pin.Frame("bead", z, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    strings = [pc.SpringDamper("bead", "universe", 1e6, 0.5, 500.0, xyz2=(end, 0, 0)) for end in (-1, 1)]
    return pc.Mechanism(model, [], [*strings, pc.JointDamping({"z": damping})], name="string", guess={"z": 0.05})


def test_tension_across_a_string_is_in_newtons_matrix():
    """T/l = 5e5 N/m; without it in the matrix the run needs 40 times the evaluations, and every second step fails."""
    sol = pc.simulate(bead(2000.0), (0.0, 2.0), method="BDF")
    assert sol.success and sol.rejected["newton"] == 0 and sol.nfev < 2.2 * sol.nsteps < 600
    assert sol.q[-1, 1] == pytest.approx(-9.81 / 1e6, rel=1e-3)  # sag g / (2 T/l)


def test_coinciding_points_pull_nothing():
    """Within 1e-9 m the direction fades; without a length the force is k r all the way."""
    model, v = slider().model, np.array([0.7])
    for length in (0.0, 0.3):
        spring = bound(model, pc.SpringDamper("universe", "block", 100.0, length, 2.0))
        for z, rest in ((0.0, 0.0), (1e-3, 1.0), (-1e-3, -1.0)):
            force = spring.torque(0.0, np.array([z]), 0 * v)[0]
            assert force == pytest.approx(-100.0 * (z - length * rest), rel=1e-9, abs=1e-12)
        for z in (0.0, 1e-12, 1e-9, -1e-6):
            values = [spring.torque(0.0, np.array([z]), v), *spring.derivatives(0.0, np.array([z]), v)]
            assert all(np.isfinite(value).all() for value in values)
    sol = pc.simulate(slider(1.0), (0.0, 2.0), {"slide": 0.5}, forces=[pc.SpringDamper("universe", "block", 100.0)])
    np.testing.assert_allclose(sol.q[:, 0], 0.5 * np.cos(10.0 * sol.t), atol=2e-4)  # straight through the middle


# Records --------------------------------------------------------------------------------------------------------------


def test_records_are_plain_frozen_and_picklable():
    for name, force in FORCES.items():
        if name not in ("wrench of time",):  # holds a lambda
            copy = pickle.loads(pickle.dumps(force))
            assert type(copy) is type(force) and (name == "law" or copy == force), name
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(force, dataclasses.fields(force)[0].name, 1.0)
    given = {"hinge": np.float64(0.4)}
    damping = pc.JointDamping(given)
    given["hinge"] = 9.0
    assert damping.coefficients == {"hinge": 0.4} and type(damping.coefficients["hinge"]) is float
    assert pc.JointTorque(np.array([1, 2])).torques == (1.0, 2.0)
    assert pc.Servo("hinge", pc.Motion(speed=2.0), 1.0) == pc.Servo("hinge", pc.Motion(0, 2), 1)
    assert pc.Wrench("a", force=np.ones(3)).force == (1.0, 1.0, 1.0)


def test_mappings_and_arrays_become_torques():
    assert as_force({"hinge": 2}) == pc.JointTorque({"hinge": 2.0})
    assert as_force([1.0, 2.0]) == pc.JointTorque((1.0, 2.0))
    assert as_force(law) == pc.Torque(law) or as_force(law).function is law
    assert pc.load("four_bar").add_forces({"crank": 2.0}).forces == (pc.JointTorque({"crank": 2.0}),)


def test_one_number_is_the_damping_of_each_velocity_of_a_joint():
    v = np.arange(1.0, 16.0)
    one, each = ({"ball": 2.0}, {"ball": (2.0, 2.0, 2.0)})
    model = mixed_tree()
    for record in (pc.JointDamping, pc.JointFriction):
        torques = [bound(model, record(given)).torque(0.0, pin.neutral(model), v) for given in (one, each)]
        np.testing.assert_array_equal(*torques)
        assert np.count_nonzero(torques[0]) == 3


def test_the_models_own_damping_and_friction_are_forces():
    model = mixed_tree()
    assert model_forces(model) == ()
    model.damping[2], model.upperDryFrictionLimit[3] = 0.5, 0.25
    damping, friction = model_forces(model)
    assert damping.coefficients[2] == 0.5 and friction.coefficients[3] == 0.25
    model.damping[2] = 9.0
    assert damping.coefficients[2] == 0.5  # a copy
    model.damping[2] = -1.0
    with pytest.raises(pc.InputError, match="JointDamping must be at least 0, got -1"):
        pc.Mechanism(model)


def test_labels_are_different_and_say_what_acts():
    model = mixed_tree()
    model.damping[:] = 0.1
    forces = [*FORCES.values(), FORCES["servo"], as_force({"hinge": 1.0})]
    labels = list(bound_forces(model, forces))
    assert len(set(labels)) == len(forces) + 1
    assert {
        "damping", "damping 2", "friction slide, turn, ball", "spring hinge", "spring arm-raft", "servo hinge",
        "servo hinge 2", "spring universe-wheel", "torque hinge, ball", "torque hinge", "wrench wheel", "torque law",
    } <= set(labels)  # fmt: skip


# What is refused ------------------------------------------------------------------------------------------------------

FREE = mixed_tree()
BAD = {
    "damping": (lambda: pc.JointDamping({"hinge": -1.0}), "JointDamping of joint 'hinge' must be at least 0, got -1"),
    "damping text": (lambda: pc.JointDamping("much"), "JointDamping must be a sequence of numbers, got 'much'"),
    "damping number": (lambda: pc.JointDamping(0.1), "JointDamping must be a sequence of numbers, got 0.1"),
    "damping ragged": (lambda: pc.JointDamping([[1.0], [1.0, 2.0]]), "must be a sequence of numbers"),
    "damping name": (lambda: pc.JointDamping({3: 1.0}), "JointDamping: a joint must be a name, got 3"),
    "damping NaN": (lambda: pc.JointDamping({"hinge": nan}), "of joint 'hinge' has a number that is not finite"),
    "damping function": (lambda: pc.JointDamping({"hinge": np.sin}), "of joint 'hinge' must be a number"),
    "friction": (lambda: pc.JointFriction([-1.0]), "JointFriction must be at least 0, got -1"),
    "friction width": (lambda: pc.JointFriction([1.0], 0.0), "JointFriction: width must be greater than 0, got 0"),
    "friction width text": (lambda: pc.JointFriction([1.0], "wide"), "width must be a number, got 'wide'"),
    "spring joint": (lambda: pc.JointSpring(3, 1.0), "JointSpring: joint must be a name, got 3"),
    "spring stiffness": (lambda: pc.JointSpring("j", None), "joint spring 'j': stiffness must be a number, got None"),
    "spring rest": (lambda: pc.JointSpring("j", 1.0, [1]), r"spring 'j': rest must be a number, two, .* got \[1\]"),
    "frame": (lambda: pc.SpringDamper(None), "SpringDamper: frame1 must be a name, got None"),
    "frame 2": (lambda: pc.SpringDamper("a", ""), "SpringDamper: frame2 must be a name, got ''"),
    "stiffness": (lambda: pc.SpringDamper("a", stiffness="k"), "spring between 'a' and 'universe': stiffness must be"),
    "length": (lambda: pc.SpringDamper("a", length=-0.1), "length must be at least 0, got -0.1"),
    "spring damping": (lambda: pc.SpringDamper("a", damping=-2), "damping must be at least 0, got -2"),
    "xyz1": (lambda: pc.SpringDamper("a", xyz1=(1, 2)), r"xyz1 needs three numbers, got \(1, 2\)"),
    "xyz2": (lambda: pc.SpringDamper("a", xyz2=(1, 2, nan)), "xyz2 has a number that is not finite"),
    "torque": (lambda: pc.JointTorque({"hinge": "2"}), "JointTorque of joint 'hinge' must be a number, got '2'"),
    "torque complex": (lambda: pc.JointTorque([1j]), "JointTorque must be a number, got 1j"),
    "servo joint": (lambda: pc.Servo(None, 0.0, 1.0), "Servo: joint must be a name, got None"),
    "servo target": (lambda: pc.Servo("j", "up", 1.0), "servo 'j': target must be a number, got 'up'"),
    "servo stiffness": (lambda: pc.Servo("j", 0.0, -1.0), "servo 'j': stiffness must be at least 0, got -1"),
    "servo damping": (lambda: pc.Servo("j", 0.0, 1.0, nan), "servo 'j': damping has a number that is not finite"),
    "servo rate": (lambda: pc.Servo("j", np.sin, 1.0, 1.0, 2.0), "servo 'j': rate must be a function of time, got 2"),
    "rate alone": (lambda: pc.Servo("j", 1.0, 1.0, 1.0, np.cos), "a rate requires a target that is a function"),
    "wrench frame": (lambda: pc.Wrench(1), "Wrench: frame must be a name, got 1"),
    "wrench force": (lambda: pc.Wrench("a", (1, 2)), r"wrench on 'a': force needs three numbers, got \(1, 2\)"),
    "wrench moment": (lambda: pc.Wrench("a", moment=5.0), "wrench on 'a': moment must be a sequence of numbers, got 5"),
    "wrench axes": (lambda: pc.Wrench("a", axes="body"), "wrench on 'a': axes must be 'world' or 'local', got 'body'"),
    "wrench xyz": (lambda: pc.Wrench("a", xyz="000"), "wrench on 'a': xyz must be a sequence of numbers, got '000'"),
    "law": (lambda: pc.Torque(2.0), "Torque: function must be a function of .t, q, v., got 2.0"),
    "gradient": (lambda: pc.Torque(law, 3), "Torque: gradient must be a function"),
    "motion": (lambda: pc.Motion(speed="fast"), "motion: speed must be a number, got 'fast'"),
    "motion True": (lambda: pc.Motion(phase=True), "motion: phase must be a number, got True"),
    "matrix": (lambda: as_force(np.eye(2)), "a force must be a Force, a mapping joint → torque"),
    "half a force": (lambda: as_force(type("Half", (), {"torque": law})()), "a force must be a Force"),
    "no joint": (lambda: bound(FREE, pc.JointSpring("hinges", 1.0)), "joint spring 'hinges': the model has no joint"),
    "joint near": (lambda: bound(FREE, {"hnge": 1.0}), "JointTorque: the model has no joint 'hnge'; similar: hinge"),
    "damped joint": (lambda: bound(FREE, pc.JointDamping({"x": 1.0})), "JointDamping: the model has no joint 'x'"),
    "servo no joint": (lambda: bound(FREE, pc.Servo("x", 0.0, 1.0)), "servo 'x': the model has no joint 'x'"),
    "spring on a ball": (lambda: bound(FREE, pc.JointSpring("ball", 1.0, 0.3)), "rest needs 4 numbers"),
    "spring of a long share": (lambda: bound(FREE, pc.JointSpring({"ball": 1.0}, 1.0)), "3 degrees of freedom"),
    "spring upside down": (lambda: pc.JointSpring("j", 1.0, (2, 1)), "the lower one is first"),
    "spring of nothing": (lambda: pc.JointSpring({}, 1.0), "needs a joint"),
    "servo on a raft": (lambda: bound(FREE, pc.Servo("float", 0.0, 1.0)), "'float' has 6 degrees of freedom"),
    "torque size": (lambda: bound(FREE, {"ball": 1.0}), r"JointTorque: joint 'ball' needs 3 number\(s\), got 1"),
    "damping size": (lambda: bound(FREE, pc.JointDamping({"ball": (1, 2)})), r"'ball' needs 3 number\(s\), got 2"),
    "torques": (lambda: bound(FREE, np.ones(3)), r"JointTorque needs 15 numbers.*shape \(3,\)"),
    "no frame": (lambda: bound(FREE, pc.Wrench("arms")), "'arms': the model has no frame 'arms'; similar: arm"),
    "ground": (lambda: bound(FREE, pc.Wrench("universe")), "wrench on 'universe': the frame belongs to the ground"),
    "spring frame": (lambda: bound(FREE, pc.SpringDamper("arm", "leg")), "spring between 'arm' and 'leg': .* no frame"),
    "spring on a body": (lambda: bound(FREE, pc.SpringDamper("raft", "raft")), "connects a body to itself"),
    "ground to ground": (lambda: bound(FREE, pc.SpringDamper("universe")), "connects a body to itself"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_named(case):
    call, message = BAD[case]
    with pytest.raises(pc.InputError, match=message):
        call()


def test_a_mechanism_checks_its_forces():
    with pytest.raises(pc.InputError, match="servo 'crnk': the model has no joint 'crnk'"):
        pc.load("four_bar").add_forces(pc.Servo("crnk", 0.0, 1.0))


def one_by_zero(t):
    return 1 / 0


FAILING = {
    "torque": (pc.JointTorque({"slide": one_by_zero}), "the torque of joint 'slide' raised ZeroDivisionError"),
    "target": (pc.Servo("slide", one_by_zero, 1.0), "the target of servo 'slide' raised ZeroDivisionError"),
    "rate": (pc.Servo("slide", np.sin, 1.0, 1.0, one_by_zero), "the rate of servo 'slide' raised ZeroDivisionError"),
    "force": (pc.Wrench("block", one_by_zero), "the force of the wrench on 'block' raised ZeroDivisionError"),
    "moment": (pc.Wrench("block", moment=lambda: 0), "the moment of the wrench on 'block' raised TypeError"),
    "gradient": (pc.Torque(lambda t, q, v: -9 * v, lambda t, q, v: {}[1]), "the gradient .* raised KeyError"),
}


@pytest.mark.parametrize("case", FAILING)
def test_exceptions_of_users_functions_are_told(case):
    force, message = FAILING[case]
    with pytest.raises(pc.UserFunctionError, match=message + ".*t = 0") as caught:
        pc.simulate(slider(), (0.0, 1.0), v0={"slide": 1.0}, forces=[force], step=0.1, order=1, method="BDF")
    assert caught.value.__cause__ is not None


WRONG = {
    "torque shape": (pc.JointTorque({"slide": lambda t: [1, 2]}), r"shape \(2,\) at t = 0; it must return one number"),
    "torque None": (
        pc.JointTorque({"slide": lambda t: None}),
        "the torque of joint 'slide' did not return real numbers at t = 0",
    ),
    "target text": (pc.Servo("slide", lambda t: "up", 1.0), "the target of servo 'slide' did not return real numbers"),
    "force shape": (pc.Wrench("block", lambda t: 1.0), r"returned shape \(\) at t = 0; it must return \(3,\)"),
    "complex moment": (
        pc.Wrench("block", moment=lambda t: [0, 0, 1j]),
        "did not return real numbers at t = 0: complex",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_users_functions_return_is_checked(case):
    force, message = WRONG[case]
    with pytest.raises(pc.InputError, match=message):
        pc.simulate(slider(), (0.0, 1.0), forces=[force])


ENDS = {  # the crank of the four-bar falls from -1 rad and passes -0.7 rad at t = 0.32 s
    "torque": ({"crank": lambda t: nan if t > 0.32 else 0.0}, "'torque crank' at t = 0.3"),
    "law": (lambda t, q, v: np.sqrt(-0.7 - q[0]) * np.zeros(3), "'torque .*' at t = 0.3"),
    "wrench": (
        pc.Wrench("coupler_tip", lambda t: (0, 0, np.inf if t > 0.32 else 0.0)),
        "'wrench coupler_tip' at t = 0.3",
    ),
}


@pytest.mark.filterwarnings("ignore:invalid value encountered")
@pytest.mark.parametrize("step", [0.01, None])
@pytest.mark.parametrize("case", ENDS)
def test_a_force_that_is_not_finite_is_named(case, step):
    force, name = ENDS[case]
    sol = pc.simulate(pc.load("four_bar"), (0.0, 0.5), forces=[force], step=step, method="BDF")
    assert not sol.success and 0.3 <= sol.t[-1] <= 0.33 and np.isfinite(sol.q).all()
    assert re.search(f"not finite .{name}", sol.message), sol.message


def test_a_force_that_is_not_finite_at_the_start_is_named():
    with pytest.raises(pc.PinconsistError, match=r"not finite at t = 0 .'torque slide' at t = 0"):
        pc.simulate(slider(), (0.0, 0.5), forces=[{"slide": lambda t: nan}])


def test_one_force_may_stand_for_itself():
    mech = pc.load("four_bar")
    alone = pc.simulate(mech, (0.0, 0.5), forces={"crank": 2.0}, step=0.01)
    listed = pc.simulate(mech, (0.0, 0.5), forces=[{"crank": 2.0}], step=0.01)
    np.testing.assert_array_equal(alone.q, listed.q)


def test_a_class_is_no_force():
    with pytest.raises(pc.InputError, match=r"not the class Wrench: pass Wrench\(…\)"):
        pc.load("four_bar").add_forces(pc.Wrench)


def test_a_gradient_may_be_lists():
    law = pc.Torque(lambda t, q, v: -0.1 * v, lambda t, q, v: (None, (-0.1 * np.eye(3)).tolist()))
    plain = pc.Torque(lambda t, q, v: -0.1 * v, lambda t, q, v: (None, -0.1 * np.eye(3)))
    one, other = (pc.simulate(pc.load("four_bar"), (0.0, 0.1), forces=[force]) for force in (law, plain))
    np.testing.assert_array_equal(one.q, other.q)


def test_a_bushing_is_that_of_drake_in_closed_form():
    """Turned about one axis, by angles of half a turn: the force acts in the axes halfway between the frames."""
    model = pin.Model()
    slide = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    turn = model.addJoint(slide, pin.JointModelRZ(), pin.SE3.Identity(), "turn")
    model.addFrame(pin.Frame("end", turn, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    x, angle, k = 0.7, 1.2, (11.0, 5.0, 3.0, 2.0, 7.0, 13.0)
    force = bound(model, pc.Bushing("universe", "end", k))
    along, across = x * np.cos(angle / 2), -x * np.sin(angle / 2)  # in the axes halfway
    energy, _ = force.stored(np.array([x, angle]), np.zeros(2))
    assert energy == pytest.approx(0.5 * (k[0] * along**2 + k[1] * across**2 + k[5] * angle**2))
    tau = force.torque(0.0, np.array([x, angle]), np.zeros(2))
    assert tau[0] == pytest.approx(-(k[0] * np.cos(angle / 2) ** 2 + k[1] * np.sin(angle / 2) ** 2) * x)
    assert tau[1] == pytest.approx(-k[5] * angle + 0.5 * (k[0] - k[1]) * x**2 * np.sin(angle / 2) * np.cos(angle / 2))


@pytest.mark.parametrize(
    ("fields", "told"),
    [
        ({"stiffness": (1, 2, 3)}, "needs six numbers"),
        ({"damping": (-1,) * 6}, "damping"),
        ({"frame2": "arm"}, "itself"),
    ],
)
def test_bushings_that_cannot_be(fields, told):
    with pytest.raises(pc.InputError, match=told):
        bound(mixed_tree(), pc.Bushing("arm", **fields))


TIMED = {  # laws that the engine has, with functions of time that it asks
    "torque": lambda: pc.JointTorque({"crank": lambda t: 0.3 * np.sin(7.0 * t)}),
    "servo": lambda: pc.Servo("crank", lambda t: 0.2 * np.sin(3.0 * t), 20.0, 2.0),
    "wrench": lambda: pc.Wrench("coupler", lambda t: (0.0, 3.0 * np.sin(5.0 * t), 0.0), axes="local"),
    "actuator": lambda: pc.Actuator("motor", "crank", control=lambda t: np.sin(4.0 * t)),
}


@pytest.mark.parametrize("method", ["Radau", "BDF"])
@pytest.mark.parametrize("name", TIMED)
def test_functions_of_time_act_as_in_a_law_of_the_users_own(name, method):
    """The same torques by a function f(t, q, v), which is written with Pinocchio."""
    mech, force = pc.load("four_bar"), TIMED[name]()
    same = pc.Torque(lambda t, q, v: torque_by_hand(force, mech.model, t, q, v))
    one, other = (pc.simulate(mech, (0.0, 0.5), forces=[each], method=method, rtol=1e-7) for each in (force, same))
    np.testing.assert_allclose(one.q[-1], other.q[-1], atol=1e-5)
    np.testing.assert_allclose(one.lam[-1], other.lam[-1], atol=1e-4 * np.abs(one.lam).max())
    assert one.check().ok


@pytest.mark.parametrize("name", TIMED)
def test_a_system_is_let_go_although_the_engine_holds_its_functions(name):
    mech = pc.load("four_bar").add_forces(TIMED[name]())
    system = MechanismSystem(mech, mech.guess)
    system.torque(0.1, mech.guess, np.zeros(3))
    held = weakref.ref(system), *(weakref.ref(force) for force in system.forces.values())
    assert system.compiled.calls_python
    del system
    gc.collect()
    assert not any(each() for each in held)
