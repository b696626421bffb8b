"""Joints that turn on SO(2), SO(3), SE(2), SE(3): orders of the method, normalised positions, charts that end."""

from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from helpers import scenes
from helpers.bodies import mixed_tree, random_state

import pinconsist as pc
from pinconsist.engine import charts
from pinconsist.mechanism.system import MechanismSystem


def puck():
    """A planar joint with an arm, held by two rods to the ground."""
    model = pin.Model()
    model.gravity.linear = np.array([0, -9.81, 0])
    body = scenes.add_body(model, 0, pin.JointModelPlanar(), scenes.at(0, 0), "puck", 2.0, (0.2, 0.1, 0), 0.3)
    arm = scenes.add_body(model, body, pin.JointModelRZ(), scenes.at(0.5, 0), "arm", 1.0, (0.4, 0, 0), 0.1)
    scenes.add_point(model, arm, "tip", 0.8, 0)
    scenes.add_point(model, body, "rim", 0, 0.4)
    loops = [
        pc.Loop("tip", "distance", "universe", "tip", xyz1=(1.0, 0.8, 0), length=1.2),
        pc.Loop("rim", "distance", "universe", "rim", xyz1=(-0.4, 0.7, 0), length=0.9),
    ]
    return pc.Mechanism(model, loops, name="puck")


def free_body(joint=pin.JointModelSpherical, inertia=(1.0, 2.0, 3.0)):
    model = pin.Model()
    model.gravity.setZero()
    scenes.add_body(model, 0, joint(), scenes.at(0, 0), "body", 1.0, (0, 0, 0), np.diag(inertia))
    return pc.Mechanism(model, name="free_body")


SCENES = {  # mechanism, v0, T
    "spherical_chain": (scenes.spherical_chain, np.array([0.5, -1.0, 0.3, 1.0, 0.4, -0.6]), 0.4),
    "floating_four_bar": (
        lambda: scenes.four_bar(floating=True),
        {"ground": (0.3, 0, 0.2, 1.0, 2.0, -1.0), "crank": 3.0},
        0.3,
    ),
    "heavy_top": (scenes.heavy_top, np.array([0, 0, 0, 0, 150, -4.61538]), 0.02),
    "puck": (puck, np.array([0.5, 0.3, 2.0, -1.0]), 0.4),
    "unbounded_four_bar": (lambda: scenes.four_bar(pin.JointModelRUBY), {"crank": -2.0}, 0.4),
}
# steps over T at which order k is asymptotic and still above the rounding floor of the multipliers
STEPS = {1: 800, 2: 400, 3: 400, 4: 200, 5: 100}


def errors(name, k, steps, times, reference, start):
    """Root mean squares over `times` of the errors in position, velocity and Jᵀλ."""
    build, _, T = SCENES[name]
    sol = pc.integrate(build(), (0.0, T), start.q, start.v, step=T / steps, order=k, method="BDF")
    assert sol.success, sol.message
    rows = np.rint(times * steps / T).astype(int)
    np.testing.assert_allclose(sol.t[rows], times, atol=1e-13)
    model, loop_rows = sol.system.model, sol.system.loop_rows
    parts = [
        [pin.difference(model, a, b) for a, b in zip(sol.q[rows], reference.q, strict=True)],
        sol.v[rows] - reference.v,
        [loop_rows(q)[1].T @ d for q, d in zip(reference.q, sol.lam[rows] - reference.lam, strict=True)],
    ]
    return [np.sqrt(np.mean(np.square(part))) for part in parts]


@cache
def answer(name):
    """Times, states there, and the start."""
    build, v0, T = SCENES[name]
    start, times = pc.assemble(build(), None, v0), np.linspace(0.0, T, 21)[1:]
    return times, pc.paper.reference_solution(build(), 0.0, start.q, start.v, times), start


@pytest.mark.parametrize("k", [1, 2, 4, 3, 5])
@pytest.mark.parametrize("name", SCENES)
def test_order_in_positions_velocities_and_multipliers(name, k):
    """Halving a fixed step divides all three errors by 2ᵏ; the answer is scipy's DOP853 on the index-1 equations."""
    coarse, fine = (errors(name, k, n, *answer(name)) for n in (STEPS[k], 2 * STEPS[k]))
    assert np.log2(np.divide(coarse, fine)) == pytest.approx([k, k, k], abs=0.3)


@pytest.mark.parametrize("options", [{"rtol": 1e-8, "atol": 1e-8}, {"step": 0.002}])
def test_unbounded_revolutes_move_as_plain_ones(options):
    """(cos, sin) pairs and angles: the same mechanism in two kinds of coordinates."""
    plain, unbounded = (
        pc.simulate(scenes.four_bar(turn), (0.0, 1.0), v0={"crank": -2.0}, **options, method="BDF")
        for turn in (pin.JointModelRY, pin.JointModelRUBY)
    )
    assert unbounded.q.shape[1] == 2 * plain.q.shape[1]
    for i in range(3):
        angle = np.arctan2(unbounded.q[-1, 2 * i + 1], unbounded.q[-1, 2 * i])
        assert abs(np.angle(np.exp(1j * (angle - plain.q[-1, i])))) < 2e-7
    np.testing.assert_allclose(unbounded.v[-1], plain.v[-1], atol=1e-6)
    np.testing.assert_allclose(unbounded.lam[-1], plain.lam[-1], atol=1e-5 * np.abs(plain.lam).max())


def test_an_unbounded_pendulum_repeats_the_plain_one_step_by_step():
    """With fixed steps and no loops the two agree to rounding: the same formula in shifted coordinates."""
    runs = []
    for turn in (pin.JointModelRY, pin.JointModelRUBY):
        model = pin.Model()
        scenes.rod(model, 0, turn(), scenes.at(0, 0), "arm", 1.0)
        runs.append(pc.simulate(pc.Mechanism(model), (0.0, 2.0), v0={"arm": 7.0}, step=0.005, method="BDF"))
    plain, unbounded = runs
    assert np.ptp(plain.q) > 4 * np.pi  # it goes round
    np.testing.assert_allclose(unbounded.v, plain.v, atol=1e-10)
    np.testing.assert_allclose(unbounded.q, np.column_stack((np.cos(plain.q), np.sin(plain.q))), atol=1e-10)


@pytest.mark.parametrize("name", SCENES)
def test_positions_stay_normalised(name):
    build, v0, T = SCENES[name]
    sol = pc.simulate(build(), (0.0, 5 * T), v0=v0, rtol=1e-4, dense_output=True, method="BDF")
    assert sol.success
    for q in (*sol.q, *sol.sol(np.linspace(0.0, 5 * T, 101))[0]):
        np.testing.assert_allclose(pin.normalize(sol.system.model, q), q, atol=4e-15)


def test_vector_like_scenes_never_use_charts(monkeypatch):
    calls = []
    for name in ("integrate", "difference"):
        method = getattr(MechanismSystem, name)
        monkeypatch.setattr(
            MechanismSystem,
            name,
            lambda self, *args, method=method, name=name: calls.append(name) or method(self, *args),
        )
        mech = scenes.four_bar()
    start = pc.assemble(mech, None, {"crank": -2.0})
    calls.clear()
    event = pc.Event(lambda t, q, v, lam: q[0] + 2.0)
    for options in ({}, {"step": 0.01}):
        sol = pc.integrate(
            mech,
            (0.0, 0.5),
            start.q,
            start.v,
            dense_output=True,
            t_eval=np.linspace(0, 0.5, 7),
            events=event,
            **options,
            method="BDF",
        )
        sol.sol(0.3)
    assert set(calls) <= {"integrate"} and len(calls) < 40  # projections of the start's few rows move a position
    calls.clear()
    pc.integrate(mech, (0.0, 0.5), start.q, start.v, max_step=1e-3, method="BDF")
    assert len(calls) < 40  # however many steps there are


# --- charts end at half a turn


def test_turning_coordinates_of_every_kind_of_joint():
    """hinge, slide, ball, float, turn (unbounded), glide: one row for each joint that turns in a chart."""
    model = mixed_tree()
    expected = np.zeros((4, 15))
    for row, columns in enumerate(([2, 3, 4], [8, 9, 10], [11], [14])):
        expected[row, columns] = 1.0
    for q in (pin.neutral(model), random_state(model, np.random.default_rng(3))[0]):
        system = MechanismSystem(pc.Mechanism(model), q)
        np.testing.assert_array_equal(charts.turning_coordinates(system, q), expected)


def spin(joint, spin0, **options):
    mech = free_body(joint)
    v0 = np.concatenate((np.zeros(mech.nv - 3), spin0))
    sol = pc.simulate(mech, (0.0, 1.0), v0=v0, **options, method="BDF")
    assert sol.status == 0, sol.message
    return sol


def momentum_and_energy_drift(sol, inertia=(1.0, 2.0, 3.0)):
    """Largest relative changes of the angular momentum in world axes and of the energy."""
    spin = sol.v[:, -3:]
    turned = [pin.Quaternion(q[-4:]).toRotationMatrix() @ (inertia * w) for q, w in zip(sol.q, spin, strict=True)]
    energy = (inertia * spin**2).sum(axis=1) / 2
    size = np.linalg.norm(turned[0])
    return np.abs(np.array(turned) - turned[0]).max() / size, np.abs(energy / energy[0] - 1.0).max()


@pytest.mark.parametrize("tol", [1e-2, 1e-3, 1e-6])
@pytest.mark.parametrize("joint", [pin.JointModelSpherical, pin.JointModelFreeFlyer])
@pytest.mark.parametrize("spin0", [(200.0, 3.0, 5.0), (3.0, 200.0, 3.0), (115.0, 115.0, 115.0)])
def test_a_body_at_200_rad_s(joint, spin0, tol):
    """Torque-free asymmetric top: momentum and energy stay at any tolerance, because no chart spans half a turn."""
    sol = spin(joint, spin0, rtol=tol, atol=tol)
    drift, energy = momentum_and_energy_drift(sol)
    assert max(drift, energy) < {1e-2: 0.15, 1e-3: 0.06, 1e-6: 1e-3}[tol]
    turn = np.abs(sol.h) * (sol.order + 2) * np.linalg.norm(sol.v[1:, -3:], axis=1)
    assert turn[sol.order > 0].max() < 2.9 < np.pi


def test_a_fixed_step_that_would_wrap_is_refused_with_a_number():
    with pytest.raises(pc.PinconsistError, match=r"turns so fast.*use step <= 0\.00179") as caught:
        pc.simulate(free_body(), (0.0, 0.1), v0=(200.0, 3.0, 5.0), step=2e-3, method="BDF")
    limit = float(str(caught.value).split("<= ")[1].split(" s")[0])
    sol = pc.simulate(free_body(), (0.0, 0.1), v0=(200.0, 3.0, 5.0), step=0.95 * limit, method="BDF")
    assert sol.success and momentum_and_energy_drift(sol)[0] < 1e-3


def test_a_body_that_spins_up_stops_a_fixed_step_before_it_wraps():
    """Accelerated at 100 rad/s²: 2.5 rad in 7 steps of 0.01 s are reached at 35.7 rad/s."""
    mech = free_body(inertia=(1.0, 1.0, 1.0))
    sol = pc.simulate(mech, (0.0, 1.0), forces=[np.array([100.0, 0, 0])], step=0.01, method="BDF")
    assert (sol.success, sol.status) == (False, -1) and "turns so fast" in sol.message and "step <=" in sol.message
    assert sol.v[-1, 0] == pytest.approx(2.5 / 7 / 0.01, abs=1.5) and sol.t[-1] == pytest.approx(0.36, abs=0.015)
    np.testing.assert_allclose(sol.v[:, 0], 100.0 * sol.t, rtol=1e-10)  # what was reached is right
    adaptive = pc.simulate(mech, (0.0, 1.0), forces=[np.array([100.0, 0, 0])], method="BDF")
    assert adaptive.success and adaptive.v[-1, 0] == pytest.approx(100.0)
    turned = pin.Quaternion(adaptive.q[-1]).toRotationMatrix()
    np.testing.assert_allclose(turned, pin.exp3(np.array([50.0, 0, 0])), atol=1e-4)


def test_only_turning_counts():
    """A body flying at 1 km/s without spin takes the longest steps."""
    mech = free_body(pin.JointModelFreeFlyer)
    sol = pc.simulate(mech, (0.0, 10.0), v0=(1000.0, 200.0, 0, 0, 0, 0), step=1.0, method="BDF")
    np.testing.assert_allclose(sol.q[-1, :3], (1e4, 2e3, 0), rtol=1e-12)
    assert pc.simulate(mech, (0.0, 10.0), v0=(1000.0, 0, 0, 0, 0, 0.1), method="BDF").success


def test_differences_of_planar_joints_are_good_to_rounding():
    """pin.difference alone is off by 5e-13 for angles of 1e-4 to 1e-3 rad, which puts a floor under λ."""
    system = MechanismSystem(free_body(pin.JointModelPlanar), np.array([0.0, 0.0, 1.0, 0.0]))
    p = np.array([0.3, -0.2, np.cos(0.4), np.sin(0.4)])
    for angle in (1e-5, 1e-4, 1e-3, 1e-2):
        xi = np.array([0.5, -0.7, 1.0]) * angle
        np.testing.assert_allclose(system.difference(p, system.integrate(p, xi)), xi, atol=3e-16)


@pytest.mark.parametrize("joint", [pin.JointModelRUBZ(), pin.JointModelSpherical()])
@pytest.mark.parametrize("tol", [1e-4, 1e-8])
def test_a_wheel_spun_up_from_rest_stays_within_its_charts(joint, tol):
    """Angle t²/2 by a constant torque: error control alone would take steps of several turns."""
    model = pin.Model()
    scenes.add_body(model, 0, joint, scenes.at(0, 0), "wheel", 1.0, (0, 0, 0), np.diag([0.3, 0.4, 0.2]))
    torque = np.zeros(model.nv)
    torque[-1] = 0.2
    sol = pc.simulate(pc.Mechanism(model, forces=[torque]), (0.0, 5.0), rtol=tol, atol=tol, method="BDF")
    assert sol.success and sol.nsteps < 100 and sum(sol.rejected.values()) == 0
    angles = sol.t**2 / 2
    found = pin.integrate(model, pin.neutral(model), angles[-1] * (torque > 0))
    np.testing.assert_allclose(np.abs(found @ sol.q[-1]), 1.0, atol=1e-12)  # a quaternion and its opposite are one
    np.testing.assert_allclose(sol.v[:, -1], sol.t, atol=1e-12)


@pytest.mark.parametrize("order", [5, 9, 13])
def test_a_fixed_step_in_which_a_body_turns_too_far_ends_the_run(order):
    """The compiled method tried it for ever."""
    top = scenes.heavy_top()
    v0 = 10.0 * np.linspace(1.0, 0.3, top.nv)
    sol = pc.simulate(top, (0.0, 0.6), v0=v0, method="Radau", step=0.3, order=order)
    assert not sol.success and sol.t[-1] == 0.0, sol.message
