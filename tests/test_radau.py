"""Radau IIA on the index-3 equations."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from helpers import scenes
from helpers.scenes import sliding_mass
from helpers.twin import with_switches
from helpers.zoo import scaled_bead
from scipy.integrate import solve_ivp

import pinconsist as pc
from benchmarks.chains.scenes import random_chain
from benchmarks.linkages import stiff_four_bar
from pinconsist.engine.radau_table import table
from pinconsist.mechanism.system import MechanismSystem
from pinconsist.run.accuracy import loop_forces

STEPS = {1: 1 / 80, 3: 1 / 40, 5: 1 / 10, 9: 1 / 4}  # order → step; half of it is still above rounding


@pytest.mark.parametrize("s", [1, 2, 3, 5, 7])
def test_tables_are_exact_up_to_their_order(s):
    formula = table(s)
    for k in range(2 * s + 1):
        error = abs(formula.A[-1] @ formula.c**k - 1.0 / (k + 1))
        assert error < 1e-14 if k <= 2 * s - 2 else error > 1e-9 or k > 2 * s - 1, k
    stage = [np.abs(formula.A @ formula.c**k - formula.c ** (k + 1) / (k + 1)).max() for k in range(s)]
    assert max(stage) < 1e-14


@pytest.mark.parametrize("order", STEPS)
@pytest.mark.parametrize("name", ["problem51", "problem52"])
def test_orders_of_positions_velocities_and_multipliers(name, order):
    problem = pc.paper.reference_problem(name)
    t0, errors = problem.t0, []
    for h in (STEPS[order], STEPS[order] / 2):
        run = pc.integrate(problem.system, (t0, t0 + 0.5), problem.p0, problem.v0, method="Radau", order=order, step=h)
        assert run.success
        ends = zip((run.q, run.v, run.lam), problem.exact(t0 + 0.5), strict=True)
        errors.append([np.abs(found[-1] - exact).max() for found, exact in ends])
    assert np.log2(np.divide(*errors)) == pytest.approx(order, abs=0.4)


@pytest.mark.parametrize(
    ("scene", "options", "method"),
    [
        ("four_bar", {}, "Radau"),
        ("chain_34", {}, "Radau"),
        ("chain_35", {}, "BDF"),
        ("chain_35", {"order": 5}, "Radau"),
        ("chain_35", {"step": 0.01}, "Radau"),
        ("four_bar", {"step": 0.01, "consistency": "initial"}, "BDF"),
    ],
)
def test_the_default_method(scene, options, method):
    assert pc.simulate(pc.load(scene), (0.0, 0.02), **options).method["method"] == method


def test_modes_of_bdf_are_refused():
    problem = pc.paper.reference_problem("problem51")
    for mode in ("initial", "exact"):
        with pytest.raises(pc.InputError, match="omit consistency"):
            pc.integrate(problem.system, (0, 1), problem.p0, problem.v0, method="Radau", step=0.1, consistency=mode)
    with pytest.raises(pc.InputError, match="one of 1, 3, 5, 9, 13"):
        pc.integrate(problem.system, (0, 1), problem.p0, problem.v0, method="Radau", order=4)


def test_backwards_in_time():
    mech = pc.load("four_bar")
    there = pc.simulate(mech, (0.0, 0.5), method="Radau", rtol=1e-8)
    back = pc.integrate(mech, (0.5, 0.0), there.q[-1], there.v[-1], method="Radau", rtol=1e-8)
    assert back.success and back.t[-1] == 0.0 and (back.h < 0).all()
    np.testing.assert_allclose(back.q[-1], there.q[0], atol=1e-7)


@pytest.mark.parametrize(("name", "order", "step"), [("andrews", 1, 1e-2), ("andrews", 5, 1e-2), ("chain_40", 9, 1e-3)])
def test_constraint_forces_that_turn_within_a_long_step(name, order, step):
    """Newton diverges without their derivative, here at rest; and in long chains it ends where rounding begins."""
    mech = pc.load(name)
    rest = pc.equilibrium(mech).q
    sol = pc.simulate(mech, (0.0, 8 * step), rest, step=step, method="Radau", order=order)
    assert sol.success, sol.message
    np.testing.assert_allclose(sol.q, np.broadcast_to(rest, sol.q.shape), atol=1e-9)
    np.testing.assert_allclose(sol.lam, np.broadcast_to(sol.lam[0], sol.lam.shape), atol=1e-7)


@pytest.mark.parametrize("name", ["chain_8", "bricard"])
def test_derivatives_of_the_constraint_forces_save_iterations(name):
    def run():
        return pc.simulate(pc.load(name), (0.0, 2.0), method="Radau", rtol=1e-7, atol=1e-7)

    known = run()
    with with_switches(row_derivatives=False):
        without = run()
    assert known.nfev < 0.85 * without.nfev and known.nsteps <= without.nsteps + 2
    np.testing.assert_allclose(known.q[-1], without.q[-1], atol=1e-6)


def test_a_mechanism_that_is_fully_driven():
    """Nothing is free: the motion is that of the drive, the torque that of the inverse dynamics."""
    mech = pc.load("slider_crank")
    motion = pc.Motion(0.1, 0.7, 0.3, 1.4, 0.2)
    crank = mech.joints[0]
    driven = pc.Mechanism(mech.model, [*mech.loops, pc.Drive("motor", crank, motion)], mech.forces)
    sol = pc.simulate(driven, (0.0, 1.0), method="Radau")
    slow = pc.simulate(driven, (0.0, 1.0), rtol=1e-9)
    assert sol.success
    np.testing.assert_allclose(sol.q[-1], slow.q[-1], atol=1e-8)
    np.testing.assert_allclose(sol.lam[-1], slow.lam[-1], atol=1e-6 * np.abs(slow.lam[-1]).max())


def test_a_constraint_that_moves():
    problem, p0, v0 = scenes.car_axis()
    sol = pc.integrate(problem, (0.0, 3.0), p0, v0, method="Radau", rtol=1e-5, atol=1e-6)
    for found, expected in zip((sol.q, sol.v, sol.lam), scenes.CAR_AXIS_END, strict=True):
        np.testing.assert_allclose(found[-1], expected, atol=5e-6)


def test_kinematics_that_depend_on_the_position():
    problem, exact = scaled_bead()
    p0, v0, _ = exact(0.0)
    sol = pc.integrate(problem, (0.0, 0.5), p0, v0, method="Radau", rtol=1e-8)
    p, v, lam = exact(0.5)
    np.testing.assert_allclose(sol.q[-1], p, atol=1e-8)
    np.testing.assert_allclose(sol.v[-1], v, atol=1e-8)
    np.testing.assert_allclose(sol.lam[-1], lam, atol=1e-7)


def test_impacts_that_come_faster_than_steps():
    """The tolerance would allow steps over several of them; none is missed."""
    impact = pc.Event(lambda t, q, v, lam: np.sin(52.0 * q[0]), apply=lambda t, q, v: 0.998 * v)
    options = {"v0": {"crank": 12.0}, "events": impact}
    sol = pc.simulate(pc.load("crank_rocker"), (0.0, 0.06), method="Radau", **options)
    times = sol.t_events[0]
    tight = pc.simulate(pc.load("crank_rocker"), (0.0, 0.06), rtol=1e-10, atol=1e-12, **options).t_events[0]
    assert len(times) == len(tight) > 8
    np.testing.assert_allclose(times, tight, atol=1e-8)


def test_dense_output_t_eval_and_callbacks():
    mech, t = pc.load("crank_rocker"), np.linspace(0.0, 0.3, 40)
    options = {"v0": {"crank": 12.0}}
    seen = []
    sol = pc.simulate(
        mech, (0.0, 0.3), method="Radau", dense_output=True, **options,
        callback=lambda t, q, v, lam: seen.append(t),
    )  # fmt: skip
    asked = pc.simulate(mech, (0.0, 0.3), method="Radau", t_eval=t, **options)
    exact = pc.simulate(mech, (0.0, 0.3), rtol=1e-11, atol=1e-13, t_eval=t, **options)
    assert seen == list(sol.t)
    for rows in (sol.sol(t), (asked.q, asked.v, asked.lam)):
        np.testing.assert_allclose(rows[0], exact.q, atol=1e-6)
        np.testing.assert_allclose(rows[1], exact.v, atol=1e-3)
        np.testing.assert_allclose(rows[2], exact.lam, atol=1e-3 * np.abs(exact.lam).max())


def test_between_steps_it_lies_on_both_constraints():
    mech, span = pc.load("slider_crank"), (0.0, 0.2)
    t, run = np.linspace(*span, 20), {"v0": {"crank": 20.0}, "method": "Radau"}
    sol = pc.simulate(mech, span, rtol=1e-6, atol=1e-6, t_eval=t, **run)
    exact = pc.simulate(mech, span, rtol=1e-11, atol=1e-12, t_eval=t, **run)
    system, largest = MechanismSystem(mech, mech.guess), np.abs(exact.v).max()
    for q, v in zip(sol.q, sol.v, strict=True):  # what is left is of the square of the polynomial's error
        phi, rho = system.constraint(0.0, q, v)
        assert np.abs(phi).max() < 1e-11 and np.abs(rho).max() < 1e-11 * largest
    assert np.abs(sol.v - exact.v).max() < 3e-6 * largest


def floating_four_bar():
    """A four-bar whose ground link is free."""
    model, links = pin.Model(), {}
    inertia = np.diag([0.2, 1.0, 1.1])
    ground = scenes.add_body(
        model, 0, pin.JointModelFreeFlyer(), scenes.at(0, 0), "ground", 3.0, (1.1, 0, 0.1), inertia
    )
    for name, on, x, length in (("crank", "", 0.0, 1.0), ("coupler", "crank", 1.0, 2.0), ("rocker", "", 2.2, 1.5)):
        inertia = np.diag([1e-3 * length, length**3 / 12, length**3 / 12])
        place, com = scenes.at(x, 0), (length / 2, 0, 0)
        links[name] = scenes.add_body(
            model, links.get(on, ground), pin.JointModelRY(), place, name, length, com, inertia
        )
        scenes.add_point(model, links[name], f"{name}_tip", length, 0)
    loop = pc.Loop("pin", "hinge", "coupler_tip", "rocker_tip", axis=(0, 1, 0))
    guess = {"crank": -1.0, "coupler": 0.6742791460587038, "rocker": -1.4133851241635729}
    return pc.Mechanism(model, [loop], name="four_bar", guess=guess)


def moving_scenes():
    """Name → (mechanism, q0, v0, span, steps of order 5): a planar loop, a quaternion, a loop on a free body."""
    spun = np.array([0.3, -0.2, 0.4, 0.5, -0.7, 0.6, 0.0, 0.0, 0.0])
    return {
        "crank_rocker": (pc.load("crank_rocker"), None, {"crank": 6.0}, 0.2, (0.02, 0.01)),
        "heavy_top": (scenes.heavy_top(), None, np.array([0, 0, 0, 0, 150, -4.61538]), 0.02, (2e-3, 1e-3)),
        "floating_four_bar": (floating_four_bar(), None, spun, 0.4, (0.1, 0.05)),
    }


@pytest.mark.parametrize("name", ["crank_rocker", "heavy_top", "floating_four_bar"])
def test_orders_on_mechanisms(name):
    mech, q0, v0, until, steps = moving_scenes()[name]
    start = pc.assemble(mech, q0, v0)
    exact, *runs = (
        pc.integrate(mech, (0.0, until), start.q, start.v, method="Radau", order=order, step=h)
        for order, h in ((9, steps[1] / 2), (5, steps[0]), (5, steps[1]))
    )
    errors = [
        [
            np.abs(pin.difference(mech.model, run.q[-1], exact.q[-1])).max(),
            np.abs(run.v[-1] - exact.v[-1]).max(),
            np.abs(run.lam[-1] - exact.lam[-1]).max(),
        ]
        for run in runs
    ]
    assert np.log2(np.divide(*errors)) == pytest.approx(5, abs=0.7)


@pytest.mark.parametrize("order", [5, 9, 13])
def test_the_tolerance_is_the_accuracy(order):
    mech, v0 = pc.load("four_bar"), None
    exact = pc.simulate(mech, (0.0, 0.5), None, v0, rtol=1e-11, atol=1e-13)
    for tol in (1e-4, 1e-7):
        sol = pc.simulate(mech, (0.0, 0.5), method="Radau", order=order, rtol=tol, atol=tol)
        assert np.abs(sol.q[-1] - exact.q[-1]).max() < 10.0 * tol


def test_the_projection_does_not_stir_stiff_forces():
    """A bushing of 1e7 N/m: v and λ were wrong by 40 tolerances for a moment, until the next step damped it."""
    mech, span, tol = stiff_four_bar(), (0.0, 1.0), 1e-8
    sol = pc.simulate(mech, span, v0={"crank": 12.0}, method="Radau", rtol=tol)
    exact = pc.simulate(mech, span, v0={"crank": 12.0}, rtol=1e-10, dense_output=True).sol(sol.t)
    for found, right, most in zip((sol.q, sol.v, sol.lam), exact, (1, 1, 5), strict=True):
        assert np.abs(found - right).max() < most * tol * np.abs(right).max()


def test_rows_between_steps_are_as_accurate_as_the_steps():
    """In long steps they were wrong by 45 tolerances; such steps are interpolated in halves, the run stays the same."""
    mech, span, tol = pc.load("andrews"), (0.0, 0.03), 1e-10
    given = {"method": "Radau", "rtol": tol, "atol": 0.01 * tol}
    exact = pc.simulate(mech, span, method="Radau", rtol=3e-13, atol=3e-15, max_step=1e-4, dense_output=True)
    plain, dense = pc.simulate(mech, span, **given), pc.simulate(mech, span, dense_output=True, **given)
    np.testing.assert_array_equal(plain.q, dense.q)
    assert plain.nfev < dense.nfev < 1.5 * plain.nfev
    parts = (plain.t[:-1, None] + np.diff(plain.t)[:, None] * [0.1, 0.3, 0.5, 0.7, 0.9]).ravel()
    for found, right in zip(dense.sol(parts), exact.sol(parts), strict=True):
        assert np.abs(found - right).max() < 10.0 * tol * np.abs(right).max()
    size = 1e-13 * np.abs(plain.v).max()
    np.testing.assert_allclose(dense.sol(plain.t)[1], plain.v, atol=size)
    for start, end in zip(plain.t[:-1], plain.t[1:], strict=True):  # the halves of a step meet
        middle = 0.5 * (start + end)
        before, after = dense.sol(np.array([np.nextafter(middle, start), np.nextafter(middle, end)]))[1]
        np.testing.assert_allclose(before, after, atol=2.0 * size)


def test_a_user_is_not_asked_about_a_stage_beyond_all_numbers():
    """A first step of 0.4 s led Newton to a position that is not finite; the constraint in Python was called there."""
    mech, q, v = random_chain(120250)
    sol = pc.simulate(mech, (0.0, 0.4), q, v, method="Radau", rtol=1e-5, atol=1e-7)
    assert sol.success, sol.message


def test_an_end_that_cannot_be_projected_is_a_failed_step():
    """The rows become dependent. One run ended by asking a user's constraint at NaN, one without trying again."""
    mech, q, v = random_chain(160002)
    sol = pc.simulate(mech, (0.0, 0.013), q, v, method="Radau", rtol=1e-3, atol=1e-3)
    assert not sol.success and "nearly dependent" in sol.message, sol.message


def test_the_default_changes_its_order():
    sol = pc.simulate(pc.load("crank_rocker"), (0.0, 0.3), v0={"crank": 12.0}, method="Radau", rtol=1e-8)
    assert sol.success and set(sol.order) == {9, 13}


@pytest.mark.parametrize("rtol", [1e-4, 1e-6])
def test_none_of_182_impacts_is_missed(rtol):
    """At looser tolerances steps are longest: three impacts could lie in one."""
    impact = pc.Event(lambda t, q, v, lam: np.sin(52.0 * q[0]), apply=lambda t, q, v: 0.998 * v)
    sol = pc.simulate(
        pc.load("crank_rocker"), (0.0, 1.0), v0={"crank": 12.0}, method="Radau", events=impact, rtol=rtol, atol=rtol
    )
    assert sol.success and len(sol.t_events[0]) == 182


def test_rows_that_are_nearly_dependent():
    """Of two loops of Cassie rounding leaves 1e-9 m: Newton, which moved along them again and again, diverged."""
    mech = pc.load("cassie")
    sol = pc.simulate(mech, (0.0, 0.03), method="Radau")
    other = pc.simulate(mech, (0.0, 0.03), method="BDF")
    assert sol.success and sol.nsteps < 0.2 * other.nsteps
    np.testing.assert_allclose(sol.q[-1], other.q[-1], atol=1e-6)
    np.testing.assert_allclose(sol.v[-1], other.v[-1], atol=1e-5)


@pytest.mark.parametrize("seed", [92126, 92055, 92044, 92143, 92082])
def test_friction_that_turns_within_a_step(seed):
    """Between two stages: of JointFriction, and of a user's |v| v. Errors were up to 190 times the tolerance."""
    mech, q, v = random_chain(seed)
    sol = pc.simulate(mech, (0.0, 0.4), q, v, rtol=1e-7, atol=1e-9, method="Radau")
    fine = pc.simulate(mech, (0.0, 0.4), q, v, rtol=1e-9, atol=1e-11, t_eval=sol.t)
    assert np.abs(sol.v - fine.v).max() < 3e-7 * np.abs(fine.v).max()


def stop(t, q, v):
    return -300.0 * np.maximum(q - q.mean() - 0.05, 0.0)


@pytest.mark.parametrize("force", [
    lambda t, q, v: -0.5 * np.tanh(v / 1e-3),
    pc.Piecewise(pc.JointFriction([0.5, 0.5, 0.5], 1e-3), times=[0.25]),
    stop,
], ids=["user's friction", "piecewise friction", "user's stop"])  # fmt: skip
def test_forces_that_bend_between_two_stages(force):
    """Errors were 40, 28 and 970 times the tolerance."""
    mech, options = pc.load("four_bar"), {"forces": [force]}
    sol = pc.simulate(mech, (0.0, 1.0), rtol=1e-7, atol=1e-7, method="Radau", **options)
    fine = pc.simulate(mech, (0.0, 1.0), rtol=1e-10, atol=1e-10, t_eval=sol.t, **options)
    assert np.abs(sol.v - fine.v).max() < 2e-6 * np.abs(fine.v).max()
    assert sol.nsteps < 250


@pytest.mark.parametrize("tol", [1e-4, 1e-6])
@pytest.mark.parametrize("push", [
    lambda t, p: [-500.0 * max(p[0] - 0.3, 0.0), 0.0], lambda t, p: [30.0 * max(t - 0.537, 0.0), 0.0],
], ids=["one-sided spring", "ramp"])  # fmt: skip
def test_functions_of_a_problem_may_bend_too(push, tol):
    """A pendulum of length 1, compared with DOP853 on its angle: errors of v were up to 890 tolerances."""
    pendulum = pc.HessenbergProblem(
        U=lambda t, p, v: v, F=lambda t, p, v: np.array([0.0, -9.81]) + push(t, p), G=lambda t, p, v: p[:, None],
        R=lambda t, p: np.array([0.5 * (p @ p - 1.0)]), R_p=lambda t, p: p[None], R_t=lambda t, p: np.zeros(1),
    )  # fmt: skip

    def along(t, y):
        p = np.array([np.sin(y[0]), -np.cos(y[0])])
        return y[1], np.array([-p[1], p[0]]) @ (np.array([0.0, -9.81]) + push(t, p))

    start = [np.sin(1.2), -np.cos(1.2)]
    sol = pc.integrate(pendulum, (0.0, 1.2), start, [0.0, 0.0], rtol=tol, atol=tol, method="Radau")
    right = solve_ivp(along, (0.0, 1.2), [1.2, 0.0], "DOP853", sol.t, rtol=1e-10, atol=1e-10, max_step=2e-3).y
    v = right[1] * np.array([np.cos(right[0]), np.sin(right[0])])
    assert np.abs(sol.v - v.T).max() < 10.0 * tol * np.abs(v).max()


def test_order_one_where_everything_is_driven():
    """Its velocity is exact after the projection only: judged before, it took 5 million steps."""
    moved = pc.Drive("motor", "crank", pc.Motion(start=0.2, speed=1.0, amplitude=0.3, frequency=2.0))
    mech = pc.load("crank_rocker").with_loops(moved)
    sol = pc.simulate(mech, (0.0, 0.1), rtol=1e-2, atol=1e-2, order=1, max_steps=3000, method="Radau")
    assert sol.success, sol.message


@pytest.mark.parametrize("speed", [0.0, 1.0])
@pytest.mark.parametrize("force", [
    pc.JointFriction({"rail": 200.0}, 1e-6), lambda t, q, v: -200.0 * np.tanh(v / 1e-6),
], ids=["JointFriction", "user's"])  # fmt: skip
def test_friction_that_holds_a_body_takes_long_steps(force, speed):
    """It is not resolved: its force oscillates between the stages while the velocity is zero within the tolerance."""
    mech, options = sliding_mass(force), {"rtol": 1e-7, "atol": 1e-7, "max_steps": 200}
    sol = pc.simulate(mech, (0.0, 1.0), v0=[speed], method="Radau", **options)
    assert sol.success and sol.nsteps < 60
    braking = 0.5 * speed**2 / 190.0
    assert abs(sol.q[-1, 0] - braking) < 2e-7 and abs(sol.v[-1, 0]) < 1e-7


@pytest.mark.parametrize(("tol", "most"), [(1e-4, 1e-2), (1e-6, 1e-4)])
def test_rows_within_steps_where_friction_holds_a_joint(tol, most):
    """Small errors of its velocity make large accelerations at the ends of a step: forces were wrong by 12 %."""
    mech = pc.load("five_bar").add_forces(pc.JointFriction({"right_distal": 3.0}, 2e-3))
    t = np.linspace(0.02, 0.3, 300)
    fine, run = (
        pc.simulate(mech, (0.0, 0.3), method=method, rtol=rtol, atol=rtol, t_eval=t)
        for method, rtol in (("BDF", 1e-8), ("Radau", tol))
    )
    ours, theirs = (loop_forces(of.system, t, of.q, of.v, of.lam) for of in (run, fine))
    assert np.abs(ours - theirs).max() < most * np.abs(theirs).max()
    assert np.abs(run.v - fine.v).max() < 10 * tol


def test_smooth_forces_are_evaluated_at_the_stages_only():
    smooth = [
        pc.JointDamping([1.0, 1.0, 1.0]), pc.JointSpring("crank", 1.0), pc.JointTorque({"crank": pc.Motion(0.0, 1.0)}),
        pc.Servo("crank", 0.0, 1.0, 1.0), pc.Wrench("coupler", (1.0, 0.0, 0.0)),
        pc.Piecewise(pc.JointDamping([1.0, 1.0, 1.0]), period=0.1),
    ]  # fmt: skip
    sharp = [lambda t, q, v: -v, pc.JointFriction([1.0, 1.0, 1.0]), {"crank": np.sin}]
    mech, q = pc.load("four_bar"), pc.assemble(pc.load("four_bar")).q
    assert not MechanismSystem(replace(mech, forces=smooth), q).sharp
    assert all(MechanismSystem(replace(mech, forces=[force]), q).sharp for force in sharp)


def gripper(crank, lift):
    """A parallelogram of 7 cm on a hoist; both are moved, so that no velocity is free."""
    model = pin.Model()

    def add(parent, joint, at, name):
        index = model.addJoint(parent, joint, pin.SE3(np.eye(3), np.array(at)), name)
        inertia = pin.Inertia(0.05, np.array([0.0, 0.0, -0.03]), 2e-5 * np.eye(3))
        model.appendBodyToJoint(index, inertia, pin.SE3.Identity())
        model.addFrame(pin.Frame(f"{name}_f", index, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
        return index

    hoist = add(0, pin.JointModelPZ(), (0.0, 0.0, 0.5), "hoist")
    arm = add(hoist, pin.JointModelRY(), (0.022, 0.0, 0.0), "crank")
    add(arm, pin.JointModelRY(), (0.0, 0.0, -0.071), "pad")
    add(hoist, pin.JointModelRY(), (0.041, 0.0, 0.008), "bar")
    ends = {"xyz1": (0.0, 0.0, -0.071), "xyz2": (0.019, 0.0, 0.008), "axis": (0.0, 1.0, 0.0)}
    loops = [
        pc.Loop("end", "hinge", "bar_f", "pad_f", **ends),
        pc.Drive("grip", "crank", pc.Motion(start=crank)),
        pc.Drive("lift", "hoist", lift),
    ]
    return pc.Mechanism(model, loops, guess={"crank": crank, "pad": -crank, "bar": crank})


@pytest.mark.parametrize("span", [(0.0, 0.7), (0.7, 0.0)], ids=["forwards", "backwards"])
@pytest.mark.parametrize("crank", [-0.65, 0.2, 0.5])
def test_rounding_of_short_levers_is_no_error_where_all_velocities_are_determined(crank, span):
    mech = gripper(crank, pc.Motion(start=0.1, amplitude=0.1, frequency=0.4))
    sol = pc.simulate(mech, span, method="Radau", max_steps=400)
    assert sol.success, sol.message
    lift = 0.1 + 0.1 * np.sin(0.8 * np.pi * sol.t)
    exact = np.column_stack((lift, *(np.full_like(lift, angle) for angle in (crank, -crank, crank))))
    assert np.abs(sol.q - exact).max() < 1e-12


@pytest.mark.parametrize("crank", [-0.5, 0.5])
def test_the_verdict_of_a_lift_by_a_table_is_not_refused_for_rounding(crank):
    sol = pc.simulate(gripper(crank, ([0.0, 0.5], [0.0, 0.2])), (0.0, 0.7), method="Radau")
    assert sol.success, sol.message
    assert not sol.check().error_missing
