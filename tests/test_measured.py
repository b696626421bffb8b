"""Certificates, energies and reactions: compiled at all rows at once, the same as row by row; and no false alarms."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
from helpers.bodies import mixed_tree, random_state
from helpers.forces import FORCES
from helpers.loops import KINDS, PAIRS, loop_open_by
from helpers.measured import energies_of, powers_of, reaction_of_the_loop
from scipy.interpolate import CubicSpline

import pinconsist as pc
from pinconsist.engine.systems import compiled_system as twin_of
from pinconsist.mechanism import rows
from pinconsist.mechanism.energy import energy_of, integrals
from pinconsist.mechanism.names import beyond_limits
from pinconsist.mechanism.reactions import reactions
from pinconsist.mechanism.rows import Workspace
from pinconsist.mechanism.system import MechanismSystem
from pinconsist.run import accuracy
from pinconsist.run.accuracy import measured


def states_of(model, count=4):
    rng = np.random.default_rng(5)
    return [np.array(column) for column in zip(*(random_state(model, rng) for _ in range(count)), strict=True)]


@pytest.mark.parametrize("axes", ["world", "anchor"])
@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
@pytest.mark.parametrize("kind", KINDS)
def test_reactions_of_every_loop_kind(kind, pair, axes):
    model, rng = mixed_tree(), np.random.default_rng(2)
    q, _ = random_state(model, rng)
    mech = pc.Mechanism(model, [loop_open_by(model, q, kind, *pair, pin.SE3.Identity())])
    name, t, lam = mech.loops[0].name, np.zeros(1), rng.standard_normal((1, mech.nc))
    (found,) = reactions(mech, [name], t, q[None], lam, axes)
    expected = reaction_of_the_loop(mech, q, lam[0], axes)
    for part, value in zip(("force", "moment", "joint_forces"), expected, strict=True):
        np.testing.assert_allclose(getattr(found, part)[0], value, atol=1e-11)


@pytest.mark.parametrize("name", FORCES)
def test_powers_and_stored_energy_of_every_force(name):
    mech = pc.Mechanism(mixed_tree(), forces=[FORCES[name]])
    q, v = states_of(mech.model)
    run = SimpleNamespace(
        t=np.linspace(0.0, 1.0, len(q)), q=q, v=v, lam=np.zeros((len(q), 0)), contacts=None, _changes=()
    )
    found = energy_of(run, mech)
    elastic = np.zeros(len(q))
    for label, power in found.power.items():
        values = np.array([powers_of(mech, *state)[label] for state in zip(run.t, q, v, strict=True)])
        np.testing.assert_allclose(power, values[:, 0], rtol=1e-9, atol=1e-9 * (1 + np.abs(power).max()))
        elastic += values[:, 1]
    kinetic, potential = np.array([energies_of(mech.model, *state) for state in zip(q, v, strict=True)]).T
    for values, expected in ((found.kinetic, kinetic), (found.potential, potential), (found.elastic, elastic)):
        np.testing.assert_allclose(values, expected, rtol=1e-12, atol=1e-11)


def test_kinetic_energy_includes_the_rotors_of_all_joints():
    """Pinocchio's computeKineticEnergy leaves out the rotors of revolute and helical joints about any axis."""
    model, axis = pin.Model(), np.array([0.6, 0.0, 0.8])
    kinds = pin.JointModelRevoluteUnaligned(axis), pin.JointModelHelicalUnaligned(axis, 0.1), pin.JointModelSpherical()
    for joint in kinds:
        last = model.addJoint(model.njoints - 1, joint, pin.SE3.Random(), joint.shortname())
        model.appendBodyToJoint(last, pin.Inertia.Random(), pin.SE3.Random())
    model.armature = np.linspace(0.1, 0.5, model.nv)
    q, v = states_of(model)
    run = SimpleNamespace(t=np.arange(float(len(q))), q=q, v=v, lam=np.zeros((len(q), 0)), contacts=None, _changes=())
    found = energy_of(run, pc.Mechanism(model)).kinetic
    for kinetic, position, rate in zip(found, q, v, strict=True):
        half = np.triu(pin.crba(model, model.createData(), position))
        M = half + np.triu(half, 1).T
        assert kinetic == pytest.approx(0.5 * rate @ M @ rate)


@pytest.mark.parametrize("away", [0.0, 1e5])
@pytest.mark.parametrize("without_mass", ["", "ball"])
def test_exact_forces_of_all_joints_far_away_and_of_bodies_without_mass(monkeypatch, without_mass, away):
    model, rounding = mixed_tree(), 1e-13 * (1.0 + away)
    for i in range(1, model.njoints):
        if not model.parents[i]:
            model.jointPlacements[i].translation += away
        if model.names[i] == without_mass:
            model.inertias[i] = pin.Inertia.Zero()
    model.armature = np.linspace(0.0, 0.1, model.nv)[::-1] * (not without_mass)
    q, v = states_of(model, 1)
    pairs = {"frame": ("arm", "wheel"), "hinge": ("universe", "puck")}
    loops = [loop_open_by(model, q[0], kind, *pair, pin.SE3.Identity()) for kind, pair in pairs.items()]
    system = MechanismSystem(pc.Mechanism(model, loops), q[0])
    states = np.zeros(1), q, v, np.random.default_rng(2).standard_normal((1, system.rows.nc))
    found = measured(system, states, Workspace(model))
    monkeypatch.setattr(accuracy, "_compiled", lambda *args: None)
    expected = measured(system, states, Workspace(model))
    for one, other in zip(found[:4], expected[:4], strict=True):
        np.testing.assert_allclose(one, other, atol=rounding * max(1.0, np.abs(other).max()))
    assert found[5] == pytest.approx(expected[5], rel=1e-12 + np.finfo(float).eps * away)
    M = twin_of(system).dynamics(0.0, q[0], v[0])[0]
    np.testing.assert_allclose(M, system.mass_matrix(q[0]), atol=rounding)


@pytest.mark.parametrize("name", ["four_bar", "bricard", "flyball_governor", "stewart_platform", "andrews", "chain_64"])
def test_certificates_of_scenes(monkeypatch, name):
    mech = pc.load(name)
    sol = pc.simulate(mech, (0.0, 0.02 * mech.duration))
    fast = sol.check()
    monkeypatch.setattr(accuracy, "_compiled", lambda *args: None)
    slow = sol.check()
    assert fast.position == pytest.approx(slow.position, rel=1e-3, abs=1e-14)
    assert fast.velocity == pytest.approx(slow.velocity, rel=1e-6, abs=1e-12)
    assert fast.force == pytest.approx(slow.force, rel=1e-4, abs=1e-10)
    assert fast.force_first == pytest.approx(slow.force_first, rel=1e-4, abs=1e-10)
    assert fast.energy_error == pytest.approx(slow.energy_error, rel=1e-4, abs=1e-10)
    np.testing.assert_allclose(fast.energy, slow.energy, rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("forces", [[], [pc.Torque(lambda t, q, v: -0.1 * v)]], ids=["compiled", "Python"])
def test_rows_are_shared_between_threads(monkeypatch, forces):
    """The same to the last bit, however many threads there are, and with forces that Python evaluates."""
    sol, found = pc.simulate(pc.load("four_bar"), (0.0, 0.5), forces=forces), []
    monkeypatch.setattr(accuracy, "processors", lambda: 3)
    for rows_of_a_thread in (len(sol.t) + 1, 10):
        monkeypatch.setattr(accuracy, "A_THREAD", rows_of_a_thread)
        found.append(sol.check(error=False))
    assert found[0] == found[1] and found[0].force > 0.0
    np.testing.assert_array_equal(found[0].energy, found[1].energy)


def test_python_evaluates_a_few_rows_however_many_there_are(monkeypatch):
    sol = pc.simulate(pc.load("four_bar"), (0.0, 2.0), method="BDF")
    calls, evaluate = [], rows.LoopRows._at
    monkeypatch.setattr(rows.LoopRows, "_at", lambda *args: calls.append(1) or evaluate(*args))
    assert sol.check(error=False).position < 1e-12 and np.abs(sol.reaction("coupler_rocker").force).max() > 1.0
    assert len(sol.t) > 200 and len(calls) < 20


def test_drives_and_moving_constraints_are_in_the_balance():
    mech = pc.load("four_bar").with_loops(
        *pc.load("four_bar").loops, pc.Drive("motor", "crank", pc.Motion(speed=2.0, amplitude=0.3, frequency=1.0))
    )
    sol = pc.simulate(mech, (0.0, 0.5), v0={"crank": 2.0 + 0.6 * np.pi})
    assert sol.check(error=False).energy_error < 1e-4 and np.abs(sol.energy().work["motor"]).max() > 0.1


def test_a_chain_of_bodies_in_free_fall_has_forces_that_are_right():
    """Nothing holds it, and its constraint forces are rounding: they count beside the weights."""
    model = pin.Model()
    base = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(base, pin.Inertia.Random(), pin.SE3.Identity())
    legs = [
        model.addJoint(base, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([x, 0, 0])), f"leg{x}") for x in (0, 1)
    ]
    for leg in legs:
        model.appendBodyToJoint(leg, pin.Inertia(1.0, np.array([0, 0, -0.5]), np.eye(3) / 12), pin.SE3.Identity())
        model.addFrame(
            pin.Frame(f"foot{leg}", leg, 0, pin.SE3(np.eye(3), np.array([0, 0, -1.0])), pin.FrameType.OP_FRAME)
        )
    bar = pc.Loop("bar", "distance", f"foot{legs[0]}", f"foot{legs[1]}", length=1.0)
    sol = pc.simulate(pc.Mechanism(model, [bar]), (0.0, 0.5))
    certificate = sol.check()
    assert np.abs(sol.lam).max() < 1e-8 and certificate.force < 1e-8 and not certificate.concerns


@pytest.mark.parametrize("amplitude", [1e-4, 1e-5])
def test_a_loaded_spring_that_hardly_moves_is_no_alarm(amplitude):
    """0.3 J are stored, and the mass swings about its rest with next to no kinetic energy."""
    model = pin.Model()
    model.gravity.linear = np.array([0, 0, -9.81])
    joint = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "slide")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    stiffness = 9.81**2 / 0.6
    mech = pc.Mechanism(model, forces=[pc.JointSpring("slide", stiffness, rest=0.0)])
    sol = pc.simulate(mech, (0.0, 1.0), q0=[-9.81 / stiffness + amplitude], rtol=1e-4, atol=1e-4)
    energy = sol.energy()
    assert energy.elastic.min() > 0.29 and energy.kinetic.max() < 1e-5
    assert not sol.check().concerns


@pytest.mark.parametrize("backwards", [False, True])
def test_work_is_the_integral_of_the_spline_through_the_powers_between_events(backwards):
    t = np.sort(np.random.default_rng(3).uniform(0.0, 2.0, 40))
    t[17:20] = t[17]  # two events at one time
    t[23] = t[22]  # pieces of four, two and three rows
    t[25] = t[24]
    t[28] = t[27]
    t, powers = (2.0 - t if backwards else t), np.column_stack((np.cos(3.0 * t), t**2))
    found, start = integrals(t, powers), np.zeros(2)
    for part in (slice(*ends) for ends in pairwise((0, 18, 19, 23, 25, 28, 40))):
        expected = start[None]
        if part.stop - part.start > 1:
            sign = -1.0 if backwards else 1.0
            integral = CubicSpline(sign * t[part], sign * powers[part]).antiderivative()
            expected = start + integral(sign * t[part])
        np.testing.assert_allclose(found[part], expected, atol=1e-13)
        start = expected[-1]


@pytest.mark.parametrize("start", [0.3, 0.3 + 2.0 * np.pi])
def test_limits_count_the_turns_that_a_joint_makes(start):
    model = pin.Model()
    inertia = pin.Inertia.FromSphere(1.0, 0.1)
    for name, limits in {"free": (-np.inf, np.inf), "wide": (-10.0, 10.0), "slide": (-1.0, 1.0)}.items():
        kind = pin.JointModelPZ() if name == "slide" else pin.JointModelRZ()
        low, high = (np.array([each]) for each in limits)
        joint = model.addJoint(model.njoints - 1, kind, pin.SE3.Identity(), name, *(np.ones(1),) * 2, low, high)
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    mech, t = pc.Mechanism(model), np.array([0.0, 1.0, 2.0])
    q = np.array([[50.0, start + 2.0 * np.pi, 0.5], [90.0, 9.5, 1.0], [0.0, -9.5, 1.0 + 1e-8]])
    found = {each.joint: each for each in beyond_limits(mech, t, q)}
    turns = 2.0 * np.pi * np.round(q[0, 1] / (2.0 * np.pi))  # by which the joint starts away
    assert found.keys() == {"wide", "slide"} and found["slide"].t == 2.0
    assert found["wide"].value == pytest.approx(-9.5 - turns) and found["wide"].t == 2.0
