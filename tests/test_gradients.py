"""Derivatives of runs by parameters, against differences of reference runs that know nothing of them."""

import copy
import pickle
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import scenes
from helpers.extras import skips_missing_extras
from helpers.gradients import SCENES, bricard, crank_rocker, hits, slider_crank

import pinconsist as pc
from benchmarks.gradient_reference import SIX, differences, reference, worst
from pinconsist.engine.norms import EPS
from pinconsist.gradients.leg import legs_of
from pinconsist.gradients.prepare import prepared
from pinconsist.gradients.starts import Start
from pinconsist.run.propagator import _known_rates

TIGHT = {"rtol": 1e-8, "atol": 1e-8}
ROBOTS = Path(__file__).resolve().parents[2] / "shared" / "robots"


@pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.__name__)
def test_motion_and_multipliers_against_differences_of_reference_runs(scene):
    mech, names, until, v0 = scene()
    times = np.linspace(0.0, until, 6)
    exact = differences(mech, names, times, None, v0)
    coarse, fine = (
        pc.sensitivities(mech, names, (0.0, until), None, v0, t_eval=times, rtol=tol, atol=tol) for tol in (1e-3, 1e-8)
    )
    assert len(fine._legs) == (2 if scene is bricard else 1)  # a change of rows
    before, after = (worst((found.dq, found.dv, found.dlam), exact) for found in (coarse, fine))
    assert max(after) < 1e-7 and max(before) < 0.1  # here ends the reference
    assert sum(after) < 0.1 * sum(before) or scene is slider_crank  # where nothing is free to be integrated


def test_a_real_robot_that_floats_with_sixteen_loops():
    """Some rows nearly depend on others: of their multipliers, 1e7, the joint forces Jᵀ dλ have a meaning."""
    with skips_missing_extras():
        mech = pc.load("cassie", free_flyer=True)
    spin, times = {"left-knee-op": 3.0, "right-knee-op": -2.0}, np.linspace(0, 0.02, 3)
    noise = 1e-4  # of the reference's forces; its loops close to 1e-9, so that its steps are long and its order is six
    for name, relative, of_forces in (("left-knee-op_speed", 0.5, 1e-5), ("mass:left-foot-op", 0.1, noise)):
        exact = differences(mech, [name], times, None, spin, relative, SIX)
        found = pc.sensitivities(mech, [name], (0.0, 0.02), None, spin, t_eval=times, **TIGHT)
        rows, q = found._legs[0].system.loop_rows, found.solution.q
        forces = [
            np.array([rows(p)[1].T @ lam for p, lam in zip(q, each, strict=True)]) for each in (found.dlam, exact[2])
        ]
        dq, dv, df = worst((found.dq, found.dv, forces[0]), (*exact[:2], forces[1]))
        assert dq < 5e-7 and dv < 5e-7 and df < of_forces


@pytest.mark.skipif(not ROBOTS.is_dir(), reason="the public robots are not beside the repository")
def test_robots_that_float_with_loops_of_whole_poses():
    mech, v0 = pc.load(ROBOTS / "cassie_like", free_flyer=True), {"motor_knee": 2.0}
    names, times = ["motor_knee_speed", "mass:motor_knee"], np.linspace(0.0, 0.05, 3)
    exact = differences(mech, names, times, None, v0, relative=1e-3)
    coarse, fine = (
        worst((found.dq, found.dv, found.dlam), exact)
        for found in (
            pc.sensitivities(mech, names, (0.0, 0.05), None, v0, t_eval=times, rtol=tol, atol=tol, order=k)
            for tol, k in ((1e-2, 5), (1e-8, None))  # at order 9 both have the error of the reference
        )
    )
    assert fine[0] < 5e-7 and fine[1] < 5e-7 and fine[2] < 1e-5
    assert sum(fine) < 0.1 * sum(coarse)


def residuals_of(system, t, p, v, a, lam):
    f, phi, G, rho = system.evaluate(t, p, v, a)
    return np.concatenate((f - G @ lam, phi, rho))


KINDS = {
    "andrews": ["mass:beta", "com:phi[0]", "mass:phi", "gravity[0]", "stiffness:D-stage", "torque beta.beta"],
    "crank_rocker": ["damping:rocker", "friction:rocker", "stiffness:crank", "motor.control.values[1]", "motor.gear"],
    "delta_robot": ["inertia:platform_roll[xz]", "com:platform_roll[2]", "servo leg1_arm.frequency", "gravity[0]"],
    "spherical": ["com:second[1]", "inertia:second[xy]", "mass:second"],
}


@pytest.mark.parametrize("scene", KINDS)
def test_known_derivatives_of_the_equations_are_those_of_differences(scene):
    """Of the torques of bodies, gravity and forces, from mechanisms with other numbers."""
    mech = scenes.spherical_chain() if scene == "spherical" else pc.load(scene)
    if scene == "crank_rocker":
        table = {"motor": ([0.1, 0.25, 0.4], [1.0, 2.0, -3.0])}
        mech = mech.add_forces(pc.JointSpring("crank", 0.5), pc.Actuator("motor", "crank")).with_control(table)
    rng = np.random.default_rng(3)
    run = prepared(mech, KINDS[scene], (0.0, 1e-3), None, None, None, None, (), None, 1e-5, 1e-5, {})
    _, (leg, *_), variants, *_ = run
    system = leg.system
    p, (v, a) = system.integrate(leg.start.p0, 0.1 * rng.normal(size=system.nv)), rng.normal(size=(2, system.nv))
    lam = rng.normal(size=system.nc)
    nv, known = system.nv, variants.residuals(system)
    columns = _known_rates(known).columns(0.3, p, v, a, len(known)).T
    for name, variant, terms, at_once in zip(KINDS[scene], variants, known, columns, strict=True):
        assert variant.parts
        beside = variant.derivative(lambda side: residuals_of(side.index1(system).system, 0.3, p, v, a, lam))
        ours = sum(weight * residuals_of(each.system, 0.3, p, v, a, lam) for weight, each in terms)
        np.testing.assert_allclose(ours[:nv], at_once, atol=1e-9 * np.abs(at_once).max(), err_msg=name)
        assert np.abs(beside).max() > 1e-8, name
        rounding = 2.0 * EPS * np.abs(residuals_of(system, 0.3, p, v, a, lam)).max() / variant.step
        np.testing.assert_allclose(ours, beside, atol=2e-7 * np.abs(beside).max() + rounding, err_msg=name)


def test_the_derivative_of_the_start_by_loops_is_that_of_assembled_states():
    mech, names = pc.load("crank_rocker"), ["anchor:rocker_ground.xyz2[0]", "length:coupler", "crank", "crank_speed"]
    start = {"crank": 0.7}
    run = prepared(mech, names, (0.0, 1e-3), start, {"crank": 12.0}, None, None, (), None, 1e-5, 1e-5, {})
    _, (leg, *_), variants, base, *_ = run
    by_loops = Start(base, leg.system)
    assert by_loops.implicit
    for variant in variants:
        q, v = (variant.derivative(lambda side, i=i: side.assembled[i]) for i in (0, 1))
        ours = by_loops.rate(variant)
        np.testing.assert_allclose(ours, np.concatenate((q, v)), atol=1e-8 * (1.0 + np.abs(v).max()))


def test_the_start_by_a_mass_where_loops_leave_velocities_free():
    """Joints that are not named move with least energy, which depends on masses; here from a guess with open loops."""
    mech = scenes.four_bar(floating=True)
    mech = replace(mech, guess=mech.configuration({"crank": 0.4, "coupler": 0.1}, base=mech.guess))
    options = {"v0": {"crank": 2.0}, "t_eval": [0.0]}
    found = pc.sensitivities(mech, ["mass:coupler"], (0.0, 0.01), **options)
    exact = differences(mech, ["mass:coupler"], [0.0], None, options["v0"])
    assert np.abs(exact[1]).max() > 1e-2
    np.testing.assert_allclose(found.dq[0], exact[0][0], atol=1e-9)
    np.testing.assert_allclose(found.dv[0], exact[1][0], atol=1e-8 * np.abs(exact[1]).max())


def test_commands_of_the_run_act_in_its_derivatives():
    mech, options = pc.load("four_bar").add_forces(pc.Actuator("motor", "crank")), {"rtol": 1e-6, "atol": 1e-8}
    names, control = ["motor.gear", "mass:coupler"], {"motor": 5.0}
    exact = pc.sensitivities(mech.with_control(control), names, (0.0, 0.05), **options).dq
    found = pc.sensitivities(mech, names, (0.0, 0.05), control=control, **options).dq
    np.testing.assert_array_equal(found, exact)
    built = pc.sensitivities(
        lambda theta: mech.with_parameters({"motor.gear": theta[0]}), [1.0], (0.0, 0.05), control=control, **options
    )
    np.testing.assert_allclose(built.dq[..., 0], exact[..., 0], atol=1e-7 * np.abs(exact).max())


def test_event_times_and_what_comes_after_a_jump():
    mech, _, _, v0 = crank_rocker()
    span, times, theta = (0.0, 0.2), np.linspace(0.0, 0.2, 5), np.array([1.4, 1.0])

    def build(theta):
        return mech.with_parameters({"mass:coupler": theta[0]})

    found = pc.sensitivities(build, theta, span, None, v0, events=hits, t_eval=times, **TIGHT)
    assert len(found._legs) == 2 and [len(t) for t in found.solution.t_events] == [1, 3]
    step, runs = 1e-2, []
    for i in (0, 1):
        change = 0.0
        for m, weight in {-2: 1 / 12, -1: -2 / 3, 1: 2 / 3, 2: -1 / 12}.items():
            beside = theta.copy()
            beside[i] += m * step
            sol = pc.simulate(build(beside), span, None, v0, events=hits(beside), t_eval=times, rtol=1e-12, atol=1e-12)
            row = (sol.q.ravel(), sol.v.ravel(), sol.lam.ravel(), *sol.t_events)
            change = change + weight / step * np.concatenate(row)
        runs.append(change)
    parts = found.dq, found.dv, found.dlam, *found.event_times
    for i, change in enumerate(runs):
        at = 0
        for part in parts:
            ours = part[..., i].ravel()
            exact = change[at : at + len(ours)]
            assert np.abs(ours - exact).max() < 1e-6 * np.abs(exact).max()
            at += len(ours)


def test_rows_at_a_jump_and_between_steps():
    mech, names, _, v0 = crank_rocker()
    found = pc.sensitivities(mech, names, (0.0, 0.2), None, v0, events=hits([0, 0]))
    t, sol = found.solution.t, found.solution
    (jump,) = np.flatnonzero(np.diff(t) == 0.0)
    assert found.dv.shape == (len(t), 3, 4) and found.dlam.shape == (len(t), sol.lam.shape[1], 4)
    assert not np.allclose(found.dv[jump], found.dv[jump + 1], rtol=1e-3)
    np.testing.assert_array_equal(found.at(t[jump])[1], found.dv[jump])  # before it
    for part, rows in zip(found.at(t[:jump:7]), (found.dq, found.dv, found.dlam), strict=True):
        np.testing.assert_allclose(part, rows[:jump:7], atol=1e-9 * np.abs(rows).max())
    with pytest.raises(pc.InputError, match="the run covers t"):
        found.at(0.3)


def test_steps_of_differences_are_short_enough_at_the_end_of_the_run():
    """By the frequency of a curve, the longer it has run the more it bends."""
    mech, _, _, _ = slider_crank()
    found = pc.sensitivities(mech, ["motor.frequency"], (0.0, 0.6), method="Radau", rtol=1e-9, atol=1e-9)
    t = found.solution.t
    exact = 0.4 * 2.0 * np.pi * t * np.cos(2.0 * np.pi * 1.3 * t + 0.2)
    assert np.abs(found.dq[:, 0, 0] - exact).max() < 5e-9 * np.abs(exact).max()


def test_backwards_in_time():
    mech, names, _, v0 = crank_rocker()
    times = np.linspace(0.0, -0.1, 4)
    exact = differences(mech, names, times, None, v0)
    found = pc.sensitivities(mech, names, (0.0, -0.1), None, v0, t_eval=times, **TIGHT)
    assert max(worst((found.dq, found.dv, found.dlam), exact)) < 1e-5


def test_a_parameter_at_its_bound_is_moved_to_one_side():
    mech, v0 = pc.load("crank_rocker"), {"crank": 12.0}
    times = np.linspace(0.0, 0.1, 3)
    found = pc.sensitivities(mech, ["damping:rocker"], (0.0, 0.1), None, v0, t_eval=times, **TIGHT)
    small = [reference(mech.with_parameters({"damping:rocker": d}), None, v0, times)[1][0] for d in (0.0, 5e-4, 1e-3)]
    exact = (-3 * small[0] + 4 * small[1] - small[2]) / 1e-3
    np.testing.assert_allclose(found.dq[..., 0], exact, atol=2e-6 * np.abs(exact).max())


def test_refusals():
    mech, span = pc.load("crank_rocker"), (0.0, 0.01)

    def refused(match, *arguments, **options):
        with pytest.raises(pc.InputError, match=match):
            pc.sensitivities(*arguments, span, **options)

    refused("another kind of mechanism", lambda th: mech if th[0] == 1 else pc.load("four_bar"), [1.0])
    refused("must return a Mechanism", lambda th: None, [1.0])
    refused("no parameter 'mass:coupla'; similar: mass:coupler", mech, ["mass:coupla"])
    refused("is a mode of BDF", mech, ["mass:coupler"], consistency="exact", step=1e-3)
    refused("'sampled' uses the state", mech, ["mass:coupler"], forces=[pc.Sampled(1e-2, lambda t, q, v: 0 * v)])
    stairs = lambda th: mech.with_parameters({"mass:coupler": np.round(th[0], 3)})  # noqa: E731
    refused("not smooth in the parameter 'm'", stairs, [1.0006], names=["m"])
    refused("needs one for each of the 1 parameters", lambda th: mech, [1.0], names=["a", "b"])


def test_lengths_of_an_overconstrained_loop_are_refused():
    with pytest.raises(pc.InputError, match=r"hinge5.*cannot vary alone|parts redundant loops|cannot vary alone"):
        pc.sensitivities(pc.load("bricard"), ["anchor:hinge5.xyz2[0]"], (0.0, 0.1))


def test_an_event_that_only_grazes_zero_is_refused():
    mech, v0 = pc.load("crank_rocker"), {"crank": 12.0}
    event = pc.Event(lambda t, q, v, lam: (q[0] - 1.0) ** 3, name="cubic")
    with pytest.raises(pc.InputError, match=r"'cubic' at t = .* only grazes zero"):
        pc.sensitivities(mech, ["mass:coupler"], (0.0, 0.15), v0=v0, events=[event])


def test_legs_begin_where_runs_begin():
    sol = pc.simulate(pc.load("crank_rocker"), (0.0, 0.05), v0={"crank": 12.0}, dense_output=True)
    (leg,) = legs_of(sol.sol)
    assert leg.span == (0.0, 0.05) and len(leg.t) == sol.nsteps


def test_at_the_end_of_python_nothing_is_left_over():
    """Users' functions see the derivatives of runs that have called them."""
    script = """
import numpy as np, pinconsist as pc
def push(t, q, v):
    return np.array([-np.sin(t), 0.0, 0.0])
mech = pc.load("crank_rocker").add_forces(pc.Torque(push))
names = "mass:coupler", "length:coupler"
found = pc.sensitivities(mech, names, (0.0, 0.01), v0={"crank": 12.0})
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0 and "leaked" not in done.stderr, done.stderr


def test_user_defined_forces_and_a_short_description():
    mech, v0 = pc.load("crank_rocker"), {"crank": 12.0}

    def build(theta):
        return mech.add_forces(pc.Torque(lambda t, q, v: np.array([-theta[0] * np.sin(t), 0.0, 0.0])))

    found = pc.sensitivities(build, [2.0], (0.0, 0.02), v0=v0, names=["push"], rtol=1e-6)
    ends = [pc.simulate(build([x]), (0.0, 0.02), v0=v0, rtol=1e-10, atol=1e-12).q[-1] for x in (2.1, 1.9)]
    np.testing.assert_allclose(found.dq[-1, :, 0], (ends[0] - ends[1]) / 0.2, rtol=1e-4)
    assert repr(found) == f"Sensitivities of crank_rocker by push: {len(found.dq)} rows"


def test_copies_have_the_rows():
    found = pc.sensitivities(pc.load("crank_rocker"), ["mass:coupler"], (0.0, 0.05))
    for twin in (pickle.loads(pickle.dumps(found)), copy.deepcopy(found)):
        np.testing.assert_array_equal(twin.dq, found.dq)
        np.testing.assert_array_equal(twin.dlam, found.dlam)
        with pytest.raises(pc.InputError, match="only the rows of the run"):
            twin.at(0.01)


@pytest.mark.parametrize("method", ["BDF", "ImplicitEuler"])
def test_other_methods_are_refused(method):
    with pytest.raises(pc.InputError, match=f"steps of Radau IIA.*not method='{method}'; omit method="):
        pc.sensitivities(pc.load("crank_rocker"), ["mass:coupler"], (0.0, 0.05), method=method)
