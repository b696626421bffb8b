"""The one-step method by which a run begins: the compiled one against scipy's, and where it cannot go on."""

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

import pinconsist as pc
from pinconsist import _core
from pinconsist._core.compiled import stepper_for
from pinconsist._core.compiled_system import CompiledIndex1, compiled_system
from pinconsist.dae.index1 import Index1
from pinconsist.dae.stepper import Stepper
from pinconsist.errors import PinconsistError, SingularSystemError
from pinconsist.mechanism.assembly import assemble
from pinconsist.mechanism.system import MechanismSystem
from pinconsist.options import method_of

needs_twin = pytest.mark.skipif(_core.load()[0] is None, reason=_core.load()[1])
SCENES = {"crank_rocker": {"crank": 12.0}, "stewart_platform": None, "planar_pendulum": None}


def run_of(kind, mech, v0=None, t_end=1.0, **options):
    begin = assemble(mech, None, v0)
    system = MechanismSystem(mech, begin.q)
    index1 = CompiledIndex1(system, compiled_system(system)) if kind == "compiled" else Index1(system)
    return index1.one_step(begin.q, 0.0, begin.q, begin.v, t_end, 1e-8, 1e-8, **options)


@needs_twin
@pytest.mark.parametrize("t_end", [0.02, -0.02])
@pytest.mark.parametrize("scene", SCENES)
def test_the_compiled_one_is_scipys(scene, t_end):
    scipys, ours = (run_of(k, pc.load(scene), SCENES[scene], t_end, dense=True) for k in ("scipy", "compiled"))
    while not scipys.finished:
        scipys.step()
        ours.step()
        assert ours.evaluations == scipys.evaluations and ours.finished == scipys.finished
        # what error estimates leave of rounding moves the steps, by parts of the tolerance
        assert ours.t == pytest.approx(scipys.t, rel=1e-6) and ours.step_size == pytest.approx(
            scipys.step_size, rel=1e-5
        )
    assert ours.t == t_end
    np.testing.assert_allclose(ours.y, scipys.y, atol=1e-10 * (1.0 + np.abs(scipys.y).max()))
    times = np.linspace(0.0, t_end, 17)
    samples = scipys.sample(times)
    np.testing.assert_allclose(ours.sample(times), samples, atol=1e-10 * (1.0 + np.abs(samples).max()))


@needs_twin
@pytest.mark.parametrize("first_step", [None, 1e-5])
@pytest.mark.parametrize("t_end", [1.0, -0.01])
@pytest.mark.parametrize("scene", SCENES)
def test_the_compiled_history_is_the_one_of_python(scene, t_end, first_step):
    mech = pc.load(scene)
    at = assemble(mech, None, SCENES[scene])
    method = method_of((0.0, t_end), "BDF", None, None, 1e-6, 1e-8, "every-step", first_step, np.inf, None, "auto")
    stepper = stepper_for(MechanismSystem(mech, at.q), method, "compiled")
    states = stepper.begin(0.0, at.q, at.v, t_end)
    h, plain = Stepper._history(stepper, 0.0, at.q, at.v, t_end)
    assert stepper.h == pytest.approx(h, rel=1e-6) and len(states) == len(plain) == 7
    for one, other in zip(states, plain, strict=True):
        for mine, theirs in zip(one, other, strict=True):
            np.testing.assert_allclose(mine, theirs, atol=1e-6 * (1.0 + np.abs(theirs).max(initial=0.0)))


@needs_twin
def test_the_largest_step_is_kept():
    run = run_of("compiled", pc.load("planar_pendulum"), max_step=0.03)
    while not run.finished:
        run.step()
        assert run.step_size <= 0.03 * (1.0 + 1e-12)


@pytest.mark.parametrize("kind", ["scipy", pytest.param("compiled", marks=needs_twin)])
def test_equations_without_a_solution_are_named(kind):
    model = pin.Model()
    model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "weightless")
    with pytest.raises(SingularSystemError, match="singular at t = 0"):
        run_of(kind, pc.Mechanism(model, [])).step()


@pytest.mark.parametrize("kind", ["scipy", pytest.param("compiled", marks=needs_twin)])
def test_a_pole_ends_it(kind):
    def away(t, q, v):
        return np.where(np.abs(v) < 1e6, v**2, np.nan)

    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slider")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    run = run_of(kind, pc.Mechanism(model, [], [pc.Torque(away)]), {"slider": 1.0}, 2.0)
    with pytest.raises(PinconsistError, match=r"from t = 0\.99999"):
        while not run.finished:
            run.step()


@pytest.mark.parametrize("backend", ["auto", "python"])
@pytest.mark.parametrize("since", [0.0, 1e-3])
def test_a_force_that_stops_the_start_is_named(since, backend):
    mech = pc.load("four_bar").add_forces({"crank": lambda t: np.nan if t > since else 0.0})
    with pytest.raises(PinconsistError, match=r"from t = .*not finite at t = .*'torque crank'"):
        pc.simulate(mech, (0.0, 1.0), step=0.01, backend=backend)


@pytest.mark.parametrize("kind", ["scipy", pytest.param("compiled", marks=needs_twin)])
def test_a_state_outlives_the_next_step(kind):
    run = run_of(kind, pc.load("crank_rocker"), {"crank": 12.0})
    before = run.y
    kept = before.copy()
    run.step()
    run.step()
    np.testing.assert_array_equal(before, kept)


@pytest.mark.parametrize("backend", ["auto", "python"])
def test_a_stiff_damper_between_two_hinged_bodies_starts(backend):
    """A first try goes so far that bodies fly off and a trial stage is singular: a shorter one follows."""
    model = pin.Model()
    for i in range(2):
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), f"body{i}")
        inertia = pin.Inertia(1.0, np.array([0.5, 0.0, 0.0]), np.diag([0.01, 0.1, 0.1]))
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
        for name, x in (("hub", 0.0), ("tip", 1.0)):
            place = pin.SE3(np.eye(3), np.array([x, 0.0, 0.0]))
            model.addFrame(pin.Frame(f"{name}{i}", joint, 0, place, pin.FrameType.OP_FRAME))
    loops = [pc.Loop(f"hinge{i}", "hinge", "universe", f"hub{i}", xyz1=(1.5 * i, 0, 0), axis=(0, 0, 1)) for i in (0, 1)]
    strut = pc.SpringDamper("tip0", "tip1", stiffness=8e5, length=1.0, damping=4e4)
    v0 = np.zeros(12)
    v0[[5, 11]] = 6.0

    def two_angles(t, y):
        a, b, va, vb = y
        tips = np.array([np.cos(a), np.sin(a)]), np.array([1.5 + np.cos(b), np.sin(b)])
        moves = np.array([-np.sin(a), np.cos(a)]), np.array([-np.sin(b), np.cos(b)])
        line = tips[1] - tips[0]
        length = np.linalg.norm(line)
        u = line / length
        tension = 8e5 * (length - 1.0) + 4e4 * u @ (moves[1] * vb - moves[0] * va)
        return [va, vb, tension * u @ moves[0] / 0.35, -tension * u @ moves[1] / 0.35]  # 0.35 kg m² about each hinge

    exact = solve_ivp(two_angles, (0.0, 0.1), [0.0, 0.0, 6.0, 6.0], "Radau", rtol=1e-10, atol=1e-10).y[2:, -1]
    mech, errors = pc.Mechanism(model, loops, [strut]), []
    for tol in (1e-3, 1e-5, 1e-7):
        sol = pc.simulate(mech, (0.0, 0.1), None, v0, rtol=tol, atol=tol, backend=backend)
        assert sol.success and sol.check(error=False).position < 1e-12
        errors.append(np.abs(sol.v[-1, [5, 11]] - exact).max() / np.abs(exact).max())
    slopes = np.diff(np.log10(errors)) / -2.0  # local errors add up: tol^(5/6)
    assert errors[-1] < 1e-4 and (slopes > 0.6).all(), errors
