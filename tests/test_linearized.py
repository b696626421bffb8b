"""Discrete linearisations of steps against differences of steps, closed forms, and each other; quick resets."""

import numpy as np
import pinocchio as pin
import pytest
from scipy.linalg import expm

import pinconsist as pc
from pinconsist.mechanism.closing import LoopSolver, newton
from pinconsist.run.propagator import Propagator
from pinconsist.run.steppers import RadauStepper

TIGHT = {"rtol": 1e-11, "atol": 1e-12}
H = 0.01


def start(mech, seed=0):
    rng = np.random.default_rng(seed)
    assembly = pc.assemble(mech, v0=rng.uniform(-1, 1, mech.nv))
    return assembly.q, assembly.v


def closed(mech, q, v, columns, change):
    """The closed state with other values of the coordinates and of their velocities, the others following."""
    d, solver, free = len(columns), LoopSolver(mech), np.ones(mech.nv, bool)
    free[columns] = False
    moved, far = np.zeros(mech.nv), solver.rows(q)[1]
    others = np.flatnonzero(free)
    moved[columns] = change[:d]
    moved[others] = np.linalg.lstsq(far[:, others], -far[:, columns] @ change[:d], rcond=1e-9)[0]
    q = newton(solver.rows, mech.model, solver.loop_rows.turns, pin.integrate(mech.model, q, moved), 0.5, free)
    J, v = solver.rows(q)[1], v.copy()
    v[columns] += change[d:]
    v[others] = np.linalg.lstsq(J[:, others], -J[:, columns] @ v[columns], rcond=1e-9)[0]
    return q, v


def ended(mech, q, v, control):
    sim = pc.Simulation(mech, q, v, **TIGHT)
    state = sim.step(H, control=control)
    return state.q, state.v, sim.lam


def difference(mech, plus, minus, by):
    """(dx, dλ) of two ends."""
    dq = pin.difference(mech.model, minus[0], plus[0])
    return np.concatenate((dq, plus[1] - minus[1])) / by, (plus[2] - minus[2]) / by


@pytest.mark.parametrize("name", ["four_bar", "five_bar", "delta_robot", "stewart_platform", "bricard", "slider_crank"])
def test_steps_of_loops_against_differences(name):
    mech = pc.load(name)
    q, v = start(mech)
    motors = [mech.columns(joint).start for joint in (mech.actuated or mech.joints[:1])]
    control = np.zeros(mech.nv)
    control[motors] = 0.3
    sim = pc.Simulation(mech, q, v, **TIGHT)
    sim.step(H, control=control)
    found = sim.linearized()
    columns, d = found._columns, len(found.coordinates)
    assert d == pc.assemble(mech, q).mobility
    eps, rows = 1e-4, np.concatenate((columns, mech.nv + columns))
    lam = found.lam_x @ found._extended
    for k, unit in enumerate(np.eye(2 * d)):
        sides = [ended(mech, *closed(mech, q, v, columns, sign * eps * unit), control) for sign in (1, -1)]
        dx, dlam = difference(mech, *sides, 2 * eps)
        np.testing.assert_allclose(found.A_reduced[:, k], dx[rows], atol=2e-7 * np.abs(found.A_reduced).max())
        np.testing.assert_allclose(lam[:, k], dlam, atol=1e-6 * np.abs(lam).max())
    for k, joint in enumerate(found.inputs):
        push = 0.01 * mech.velocity({joint: 1.0})
        dx, dlam = difference(mech, ended(mech, q, v, control + push), ended(mech, q, v, control - push), 0.02)
        np.testing.assert_allclose(found.B[:, k], dx, atol=1e-7 * np.abs(found.B).max())
        np.testing.assert_allclose(found.lam_u[:, k], dlam, atol=1e-6 * max(np.abs(found.lam_u).max(), 1.0))


def test_steps_that_newton_does_not_find_are_made_once_more(monkeypatch):
    mech = pc.load("five_bar")
    sim = pc.Simulation(mech, v0={"left_crank": 3.0}, **TIGHT)
    sim.step(H, {"left_crank": 0.5})
    A, B = sim.linearized()

    def unsolved(*_):
        raise pc.PinconsistError("the step of Radau IIA could not be repeated")

    monkeypatch.setattr(RadauStepper, "steps_since", lambda *_: None)
    monkeypatch.setattr(Propagator, "solved", unsolved)
    again = sim.linearized()
    np.testing.assert_allclose(again.A, A, atol=1e-9 * np.abs(A).max())
    np.testing.assert_allclose(again.B, B, atol=1e-9 * np.abs(B).max())


@pytest.mark.parametrize("name", ["five_bar", "delta_robot", "stewart_platform"])
def test_the_steps_of_a_run_are_linearised_as_steps_solved_to_rounding(name, monkeypatch):
    """At the default tolerances: a sample of several steps, and one of a single step, before which a torque jumps."""
    mech = pc.load(name)
    sim = pc.Simulation(mech, *start(mech))
    for dt, push in ((0.1, 0.0), (1e-3, 0.4), (1e-3, 0.4)):
        sim.step(dt, control={mech.actuated[0]: push})
        made = sim._stepper.steps_since(sim._before[0])
        assert (len(made.t) > 1) == (dt > 0.01)
        A, B = sim.linearized()
        with monkeypatch.context() as patch:
            patch.setattr(RadauStepper, "steps_since", lambda *_: None)
            solved = sim.linearized()
        np.testing.assert_allclose(solved.A, A, atol=1e-7 * np.abs(A).max())
        np.testing.assert_allclose(solved.B, B, atol=1e-7 * np.abs(B).max())


@pytest.mark.parametrize("name", ["free", "ball", "planar", "unbounded", "revolute", "prismatic", "translation"])
def test_joints_of_all_types_against_differences(name):
    """A tree: each direction of the state can vary by itself."""
    makers = {
        "free": pin.JointModelFreeFlyer, "ball": pin.JointModelSpherical, "planar": pin.JointModelPlanar,
        "unbounded": pin.JointModelRUBZ, "revolute": pin.JointModelRY, "prismatic": pin.JointModelPX,
        "translation": pin.JointModelTranslation,
    }  # fmt: skip
    model = pin.Model()
    inertia = pin.Inertia(1.5, np.array([0.1, 0.05, -0.1]), np.diag([0.02, 0.03, 0.04]))
    joint = model.addJoint(0, makers[name](), pin.SE3.Identity(), "joint")
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    child = model.addJoint(joint, pin.JointModelRX(), pin.SE3(np.eye(3), np.array([0.2, 0, 0])), "child")
    model.appendBodyToJoint(child, inertia, pin.SE3.Identity())
    mech = pc.Mechanism(model)
    rng = np.random.default_rng(3)
    q = pin.integrate(model, pin.neutral(model), rng.uniform(-1, 1, mech.nv))
    v, u = rng.uniform(-2, 2, mech.nv), rng.uniform(-1, 1, mech.nv)
    sim = pc.Simulation(mech, q, v, **TIGHT)
    sim.step(H, control=u)
    A, B = sim.linearized()
    eps = 1e-4
    for k, unit in enumerate(eps * np.eye(2 * mech.nv)):
        sides = [
            ended(mech, pin.integrate(model, q, sign * unit[: mech.nv]), v + sign * unit[mech.nv :], u)
            for sign in (1, -1)
        ]
        np.testing.assert_allclose(A[:, k], difference(mech, *sides, 2 * eps)[0], atol=1e-7)
    for k, unit in enumerate(0.01 * np.eye(mech.nv)):
        sides = [ended(mech, q, v, u + sign * unit) for sign in (1, -1)]
        np.testing.assert_allclose(B[:, k], difference(mech, *sides, 0.02)[0], atol=1e-9)


def oscillator():
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    model.appendBodyToJoint(joint, pin.Inertia(2.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    forces = [pc.JointSpring("slide", 50.0), pc.JointDamping({"slide": 3.0})]
    return pc.Mechanism(model, forces=forces, actuated=["slide"])


def test_an_oscillator_is_the_matrix_exponential():
    sim = pc.Simulation(oscillator(), {"slide": 0.1}, {"slide": -0.4}, **TIGHT)
    sim.step(0.3, control={"slide": 2.0})
    A, B = sim.linearized()
    F = np.array([[0, 1, 0], [-25, -1.5, 0.5], [0, 0, 0]])
    exact = expm(0.3 * F)
    np.testing.assert_allclose(A, exact[:2, :2], atol=1e-9)
    np.testing.assert_allclose(B, exact[:2, 2:], atol=1e-9)


def test_a_step_of_several_and_of_the_last_control():
    """The control of the last step counts, not that of the ones before; many steps inside are a product."""
    mech = pc.load("five_bar")
    q, v = start(mech)
    sim = pc.Simulation(mech, q, v, rtol=1e-9, atol=1e-10, max_step=0.002)
    sim.step(0.01, control={"left_crank": 3.0})
    sim.step(0.01, control={"left_crank": -1.0})
    whole = sim.linearized()
    parts = pc.Simulation(mech, *sim_state_before(mech, q, v), rtol=1e-9, atol=1e-10)
    parts.step(0.004, control={"left_crank": -1.0})
    A1, B1 = parts.linearized()
    A2, B2 = parts.linearized(0.006)
    np.testing.assert_allclose(whole.A, A2 @ A1, atol=1e-6)
    np.testing.assert_allclose(whole.B, A2 @ B1 + B2, atol=1e-7)


def sim_state_before(mech, q, v):
    sim = pc.Simulation(mech, q, v, rtol=1e-9, atol=1e-10, max_step=0.002)
    state = sim.step(0.01, control={"left_crank": 3.0})
    return state.q, state.v


def test_commands_of_actuators():
    mech = pc.load("four_bar").add_forces(pc.Actuator("servo", "crank", (30.0, 0, 0), (0, -30.0, -2.0), gear=2.0))
    q, v = start(mech)
    sim = pc.Simulation(mech, q, v, **TIGHT)
    sim.step(H, control={"servo": -1.5})
    found = sim.linearized()
    assert found.inputs == ("servo",)
    sides = [ended(mech, q, v, {"servo": -1.5 + change}) for change in (0.01, -0.01)]
    np.testing.assert_allclose(found.B[:, 0], difference(mech, *sides, 0.02)[0], atol=1e-9)
    both = sim.linearized(inputs=["servo", "rocker"])
    assert both.inputs == ("servo", "rocker") and both.B.shape == (2 * mech.nv, 2)


def test_an_actuator_at_its_limit_has_no_effect():
    motor = pc.Actuator("motor", "crank", control_range=(-1.0, 1.0))
    sim = pc.Simulation(pc.load("four_bar").add_forces(motor))
    sim.step(H, control={"motor": 5.0})
    assert not sim.linearized().B.any()
    sim.step(H, control={"motor": 0.5})
    assert sim.linearized().B.any()


def test_a_frame_and_the_tip_of_differences():
    mech = pc.load("five_bar")
    q, v = start(mech)
    sim = pc.Simulation(mech, q, v, **TIGHT)
    sim.step(H, control={"left_crank": 0.5})
    by_x, by_u = sim.linearized().frame("left_tip")

    def tip(u):
        sim = pc.Simulation(mech, q, v, **TIGHT)
        sim.step(H, control={"left_crank": u})
        return sim.solution().frame("left_tip").position[-1]

    np.testing.assert_allclose(by_u[:3, 0], (tip(0.6) - tip(0.4)) / 0.2, atol=1e-8)
    assert by_x.shape == (6, 2 * mech.nv)
    with pytest.raises(pc.InputError, match="left_tp"):
        sim.linearized().frame("left_tp")


def test_a_linearisation_changes_nothing():
    mech = pc.load("five_bar")
    one, two = pc.Simulation(mech), pc.Simulation(mech)
    for k in range(5):
        control = {"left_crank": 0.1 * k}
        one.step(H, control=control)
        two.step(H, control=control)
        one.linearized()
    assert np.array_equal(one.state.q, two.state.q) and one.solution().nsteps == two.solution().nsteps
    other = one.copy()
    with pytest.raises(pc.InputError, match="no step to linearise"):
        other.linearized()
    other.linearized(H)


def law(t, q, v):
    return [-v[0]]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"method": "BDF"}, "steps of Radau are linearised"),
        ({"forces": [pc.Sampled(0.01, law, joints="crank")]}, "control= of step"),
    ],
)
def test_refusals(options, words):
    sim = pc.Simulation(pc.load("four_bar"), **options)
    sim.step(0.005)
    with pytest.raises(pc.InputError, match=words):
        sim.linearized()


def test_unknown_inputs():
    sim = pc.Simulation(pc.load("four_bar"))
    with pytest.raises(pc.InputError, match="no actuator or joint 'crnk'"):
        sim.linearized(H, inputs=["crnk"])


@pytest.mark.parametrize("name", ["four_bar", "delta_robot", "stewart_platform", "bricard"])
def test_a_reset_to_a_state_is_a_new_simulation(name):
    mech = pc.load(name)
    q, v = start(mech, 5)
    used, fresh = pc.Simulation(mech), pc.Simulation(mech, q, v, t0=2.0)
    for k in range(5):
        used.step(H, control=np.full(mech.nv, 0.1 * k))
    state = used.reset(q, v, 2.0)
    assert state.t == 2.0 and np.array_equal(state.q, q) and not used.events
    for k in range(3):
        for sim in (used, fresh):
            sim.step(H, control=np.full(mech.nv, 0.05 * k))
    np.testing.assert_allclose(used.state.q, fresh.state.q, atol=1e-7)
    one, two = used.solution(), fresh.solution()
    assert one.t[0] == 2.0 and one.nsteps <= two.nsteps + 1
    np.testing.assert_allclose(one.lam[-1], two.lam[-1], atol=1e-5 * np.abs(two.lam).max())
    assert one.check().ok


def test_a_reset_forgets_what_was_held():
    mech = pc.load("four_bar").add_forces(pc.Actuator("motor", "crank"))
    q, v = start(mech)
    sim, other = pc.Simulation(mech, q, v), pc.Simulation(mech, q, v)
    sim.step(H, control={"motor": 3.0, "rocker": 1.0})
    sim.reset(q, v)
    for each in (sim, other):
        each.step(H)
    np.testing.assert_allclose(sim.state.v, other.state.v, atol=1e-9)


def test_a_reset_to_an_open_state_closes_it():
    mech = pc.load("four_bar")
    sim = pc.Simulation(mech)
    state = sim.reset(mech.guess + 0.05)
    assert np.abs(LoopSolver(mech).rows(state.q)[0]).max() < 1e-9
    assert sim.reset({"crank": -0.8}).q[0] == pytest.approx(-0.8)


def test_parameters_of_a_simulation():
    mech = pc.load("four_bar")
    sim = pc.Simulation(mech)
    sim.step(0.1, control={"crank": 1.0})
    before = sim.state
    state = sim.set_parameters({"mass:coupler": 3.0})
    assert state.t == before.t and np.array_equal(state.q, before.q)
    sim.step(0.1)  # under the same torque
    changed = mech.with_parameters({"mass:coupler": 3.0})
    other = pc.Simulation(changed, before.q, before.v, t0=before.t)
    other.step(0.1, control={"crank": 1.0})
    np.testing.assert_allclose(sim.state.q, other.state.q, atol=1e-8)
    sim.set_parameters({"anchor:coupler_rocker.xyz2[0]": 0.01})
    assert np.abs(LoopSolver(sim.mechanism).rows(sim.state.q)[0]).max() < 1e-9
    with pytest.raises(pc.InputError, match="mas:coupler"):
        sim.set_parameters({"mas:coupler": 3.0})
