"""Planar and continuous joints: exponential and logarithm to rounding; loops that stay closed; published answers."""

import numpy as np
import pinocchio as pin
import pytest

import pinconsist as pc
from pinconsist.mechanism.lie import PlaneTurns, difference, integrate
from pinconsist.mechanism.system import MechanismSystem


def planar_model(bodies=1):
    model = pin.Model()
    model.gravity.linear = np.array([0.0, -9.81, 0.0])
    for i in range(bodies):
        joint = model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), f"plane{i}")
        inertia = pin.Inertia(1.0 + i, np.array([0.2, 0.05, 0.0]), np.diag([0.02, 0.03, 0.04]))
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
        model.addFrame(pin.Frame(f"plate{i}", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    return model


@pytest.mark.parametrize("turn", [0.0, *10.0 ** np.arange(-12.0, 0.5, 0.25), 3.1])
def test_the_logarithm_undoes_the_exponential(turn):
    """To a few spacings of the numbers, at every turn; Pinocchio's own are not."""
    model, rng = planar_model(2), np.random.default_rng(0)
    joints = PlaneTurns(model)
    for _ in range(50):
        q = pin.randomConfiguration(model, -np.ones(8), np.ones(8))
        xi = rng.normal(size=6)
        xi[[2, 5]] = turn * rng.choice((-1.0, 1.0), 2)
        there, back = np.empty(8), np.empty(6)
        joints.integrate(q, xi, there)
        joints.difference(q, there, back)
        np.testing.assert_allclose(back, xi, rtol=0, atol=1e-14)
        np.testing.assert_allclose(np.hypot(there[2::4], there[3::4]), 1.0, rtol=0, atol=4e-16)
        if turn > 0.1:  # where Pinocchio's formulas are good
            np.testing.assert_allclose(there, pin.integrate(model, q, xi), rtol=0, atol=1e-13)


@pytest.mark.parametrize("turn", [0.0, *10.0 ** np.arange(-12.0, 0.5, 0.5), 3.1])
def test_small_turns_of_continuous_joints_are_not_lost(turn):
    """Pinocchio's logarithm is zero at turns of 1e-8 if the cosine is rounded above 1: a run stopped at one."""
    model, rng = pin.Model(), np.random.default_rng(0)
    for kind in (pin.JointModelRUBX(), pin.JointModelRUBZ()):
        model.addJoint(0, kind, pin.SE3.Identity(), kind.shortname())
    system = MechanismSystem(pc.Mechanism(model), pin.neutral(model))
    for angles in rng.uniform(-np.pi, np.pi, (200, 2)):
        q = np.ravel([np.cos(angles), np.sin(angles)], order="F")
        xi = turn * rng.choice((-1.0, 1.0), 2)
        np.testing.assert_allclose(system.difference(q, system.integrate(q, xi)), xi, rtol=0, atol=2e-15)


def random_scene(seed):
    """Two plates held to the ground and to each other by points, so that one or two motions are left."""
    rng = np.random.default_rng(seed)
    loops = [
        pc.Loop("ground", "point", "universe", "plate0", xyz2=(*rng.uniform(-0.3, 0.3, 2), 0.0)),
        pc.Loop("between", "point", "plate0", "plate1", xyz1=(0.5, 0.1, 0.0), xyz2=(*rng.uniform(-0.3, 0.3, 2), 0.0)),
    ]
    return pc.Mechanism(planar_model(2), loops, [pc.JointDamping({"plane1": 0.01})] if seed % 2 else [])


@pytest.mark.parametrize("seed", range(6))
def test_random_planar_scenes_run_and_stay_closed(seed):
    for tol in (1e-4, 1e-7):
        sol = pc.simulate(random_scene(seed), (0.0, 1.0), rtol=tol, atol=tol)
        assert sol.success, sol.message
        assert sol.check(error=False).position < 1e-12


def sliders_and_hinges():
    """The same plates on prismatic and revolute joints, which need no chart."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, -9.81, 0.0])
    for i in range(2):
        joint = 0
        for axis, kind in zip("xyz", (pin.JointModelPX(), pin.JointModelPY(), pin.JointModelRZ()), strict=True):
            joint = model.addJoint(joint, kind, pin.SE3.Identity(), f"{axis}{i}")
        inertia = pin.Inertia(1.0 + i, np.array([0.2, 0.05, 0.0]), np.diag([0.02, 0.03, 0.04]))
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
        model.addFrame(pin.Frame(f"plate{i}", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    return model


def test_a_planar_joint_moves_as_two_sliders_and_a_hinge():
    planar = random_scene(0)
    single = pc.Mechanism(sliders_and_hinges(), planar.loops)
    options = {"rtol": 1e-10, "atol": 1e-10, "t_eval": [0.0, 0.3, 0.6]}
    ours = pc.simulate(planar, (0.0, 0.6), **options)
    start = [ours.q[0, 0], ours.q[0, 1], np.arctan2(ours.q[0, 3], ours.q[0, 2])]
    start += [ours.q[0, 4], ours.q[0, 5], np.arctan2(ours.q[0, 7], ours.q[0, 6])]
    theirs = pc.simulate(single, (0.0, 0.6), start, **options)
    angles = np.arctan2(ours.q[:, [3, 7]], ours.q[:, [2, 6]])
    np.testing.assert_allclose(np.sin(angles - theirs.q[:, [2, 5]]), 0.0, atol=1e-7)
    np.testing.assert_allclose(ours.q[:, [0, 1, 4, 5]], theirs.q[:, [0, 1, 3, 4]], atol=1e-7)


@pytest.mark.parametrize("turn", 10.0 ** np.arange(-15.0, -6.0))
def test_a_plate_that_hardly_turns_goes_to_the_nearest_point_of_a_rail(turn):
    """The foot of the perpendicular, whatever the turn; Pinocchio's exponential is wrong by up to 1e-2 there."""
    rail = {"axis": (0.6, 0.8, 0.0), "xyz1": (0.3, -0.2, 0.0), "rpy1": (0.0, 0.0, turn)}
    q = pc.assemble(pc.Mechanism(planar_model(), [pc.Loop("rail", "slider", "universe", "plate0", **rail)])).q
    along = np.array([0.6 - 0.8 * turn, 0.8 + 0.6 * turn])
    foot = np.array([0.3, -0.2]) - (0.3 * along[0] - 0.2 * along[1]) * along
    np.testing.assert_allclose(q[:2], foot, rtol=0, atol=turn + 1e-13)
    np.testing.assert_allclose(q[3], turn, rtol=0, atol=1e-15)


@pytest.mark.parametrize("turn", 10.0 ** np.arange(-16.0, 0.0, 2.0))
def test_planar_joints_inside_composite_ones(turn):
    """They move as the same joints one after another."""
    whole, single = pin.Model(), pin.Model()
    both, place = pin.JointModelComposite(pin.JointModelRX()), pin.SE3.Random()
    both.addJoint(pin.JointModelPlanar(), place)
    both.addJoint(pin.JointModelRUBZ(), place)
    whole.addJoint(0, both, pin.SE3.Identity(), "all")
    for i, joint in enumerate((pin.JointModelRX(), pin.JointModelPlanar(), pin.JointModelRUBZ())):
        single.addJoint(i, joint, pin.SE3.Identity(), f"joint{i}")
    q, xi = pin.neutral(single), np.array([0.3, 0.7, -0.4, turn, -turn])
    there = integrate(whole, q, xi)
    np.testing.assert_allclose(there, integrate(single, q, xi), rtol=0, atol=1e-16)
    np.testing.assert_allclose(difference(whole, q, there), xi, rtol=1e-14, atol=0)
    np.testing.assert_allclose(there[1:3], [0.7 + 0.2 * turn, -0.4 + 0.35 * turn], rtol=0, atol=0.2 * turn**2 + 3e-16)
