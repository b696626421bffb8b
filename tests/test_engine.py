"""The compiled method in use: users' functions that raise or call back, interrupts, threads, lifetimes."""

import dataclasses
import gc
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from helpers.bodies import mixed_tree
from helpers.forces import FORCES
from helpers.twin import LOOSE, assert_same, with_switches
from scipy.integrate import solve_ivp

import pinconsist as pc
from pinconsist import engine
from pinconsist.engine import tree
from pinconsist.run import steppers
from pinconsist.run.control import Switches

ROOT = Path(__file__).resolve().parents[1]
OFF = dict.fromkeys((switch.name for switch in dataclasses.fields(Switches)), False)


def test_radau_without_switches_is_as_accurate():
    """Derivatives at two stages, where stages are evaluated one by one, and iterations that are left out where the last
    steps promise it, cost no accuracy; neither do all stages at once."""
    mech, run = pc.load("crank_rocker"), {"v0": {"crank": 12.0}, "method": "Radau", "order": 9}
    tight = pc.simulate(mech, (0.0, 1.0), rtol=1e-12, atol=1e-12, **run).q[-1]
    fast = pc.simulate(mech, (0.0, 1.0), **run)
    with with_switches(lanes=False):
        alone = pc.simulate(mech, (0.0, 1.0), **run)
    with with_switches(**OFF):
        plain = pc.simulate(mech, (0.0, 1.0), **run)
    assert alone.njev < 0.6 * plain.njev and max(fast.nfev, alone.nfev) < plain.nfev
    assert all(np.abs(sol.q[-1] - tight).max() < 1e-5 for sol in (fast, alone, plain))


def test_what_a_users_force_raises_leaves_what_was_reached():
    def late(t, q, v):
        if t > 0.7:
            raise ValueError("too late")
        return np.zeros(3)

    sol = pc.simulate(pc.load("four_bar"), (0.0, 1.0), forces=[late])
    assert sol.status == -1 and "too late" in sol.message and 0.3 < sol.t[-1] <= 0.7


def test_a_force_that_is_not_finite_is_named():
    def broken(t, q, v):
        return np.full(3, np.nan if t > 0.2 else 0.0)

    sol = pc.simulate(pc.load("four_bar"), (0.0, 1.0), forces=[broken], step=1e-2)
    assert sol.status == -1 and "not finite" in sol.message and "broken" in sol.message


def test_redundant_loops_share_their_load():
    """A loop that stands there three times: each takes a third, as the multipliers of smallest norm do."""
    mech = pc.load("four_bar")
    (loop,) = mech.loops
    mech = mech.with_loops(loop, dataclasses.replace(loop, name="b"), dataclasses.replace(loop, name="c"))
    sol = pc.simulate(mech, (0.0, 0.5), **LOOSE)
    assert not sol.system.dropped_are_zero
    a, b, c = np.split(sol.lam, 3, axis=1)
    assert_same(a, b, 1e-9)
    assert_same(a, c, 1e-9)


def test_other_threads_run_and_an_interrupt_comes_through():
    """During a stretch Python is free: a thread counts, and Ctrl-C ends the run within a tenth of a second."""
    mech, ticks, done = pc.load("crank_rocker"), [], threading.Event()

    def count():
        while not done.is_set():
            ticks.append(time.monotonic())
            time.sleep(1e-3)

    thread = threading.Thread(target=count)
    thread.start()
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.setitimer(signal.ITIMER_REAL, 0.3)
    previous = signal.signal(signal.SIGALRM, lambda *_: signal.raise_signal(signal.SIGINT))
    try:
        begun = time.monotonic()
        sol = pc.simulate(mech, (0.0, 1e4))
        took = time.monotonic() - begun
    finally:
        signal.signal(signal.SIGALRM, previous)
        done.set()
        thread.join()
    assert sol.status == 1 and "interrupted" in sol.message and sol.nsteps > 1000
    assert took < 3.0  # the interrupt comes after 0.3 s; what is over is the machine's load
    assert sum(begun < tick < begun + took for tick in ticks) > 20


def test_a_missing_compiled_part_is_told(monkeypatch, tmp_path):
    monkeypatch.setattr(engine, "find_spec", lambda name: None)
    monkeypatch.setattr(engine, "FOLDER", tmp_path / "pinconsist" / "engine")
    assert "was installed without its compiled part" in engine.trouble()
    (tmp_path / "CMakeLists.txt").touch()
    sources = engine.trouble()  # an installed pinconsist may well have its compiled part
    assert str(tmp_path) in sources and "another folder" in sources and f"-m pip install -e {tmp_path}" in sources


def test_a_compiled_part_that_is_older_than_its_sources_is_told_and_not_used(monkeypatch):
    if not (ROOT / "CMakeLists.txt").is_file():
        pytest.skip("not a checkout")
    assert engine.trouble() == ""
    monkeypatch.setattr(engine, "digest_of", lambda folder: "of other sources")
    assert "is older than its sources" in engine.trouble() and "-m pip install -e" in engine.trouble()
    engine.required.cache_clear()
    try:
        with pytest.raises(pc.PinconsistError, match="older than its sources"):
            pc.simulate(pc.load("four_bar"), (0.0, 0.1))
    finally:
        engine.required.cache_clear()


def test_trouble_is_told_at_import(tmp_path):
    """By a copy of the sources beside an installed package."""
    shutil.copytree(ROOT / "pinconsist", tmp_path / "pinconsist", ignore=shutil.ignore_patterns("*.so", "__pycache__"))
    (tmp_path / "CMakeLists.txt").touch()
    code = "import sys; sys.path.insert(0, '.'); import pinconsist; print(pinconsist.__file__)"
    command = [sys.executable, "-S", "-c", code]  # without the installed packages
    run = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=True)
    assert run.stdout.startswith(str(tmp_path)) and "without its compiled part" in run.stderr


def test_what_a_called_back_function_raises_leaves_what_was_reached():
    def late(t, p, v):
        if t > 0.5:
            raise ValueError("too late")
        return np.zeros(2)

    problem = pc.HessenbergProblem(
        U=lambda t, p, v: v, F=late, G=lambda t, p, v: p[:, None], R=lambda t, p: np.array([(p @ p - 1.0) / 2])
    )
    sol = pc.integrate(problem, (0.0, 1.0), [1.0, 0.0], [0.0, 1.0], method="BDF", step=0.01, order=2)
    assert sol.status == -1 and "too late" in sol.message and 0.2 < sol.t[-1] <= 0.5


def test_a_solution_holds_no_compiled_system():
    """It would keep the user's functions alive in a cycle that the garbage collector does not see."""
    sol = pc.simulate(pc.load("four_bar"), (0.0, 0.2), forces=[lambda t, q, v: -0.1 * v])
    compiled_kinds = tuple(getattr(engine.required(), name) for name in ("System", "Projection", "Stepper"))
    assert not any(isinstance(value, compiled_kinds) for value in vars(sol.system).values())


@pytest.mark.parametrize("given", [np.zeros(0), np.zeros(2), np.zeros(4), None, "x"], ids=repr)
def test_what_a_force_object_returns_is_checked(given):
    class Own:
        def torque(self, t, q, v):
            return given

        def derivatives(self, t, q, v):
            return None, None

    with pytest.raises(pc.InputError, match="torque of 'Own'"):
        pc.simulate(pc.load("four_bar"), (0.0, 0.1), forces=[Own()])


class OwnError(BaseException):
    """No Exception: nobody may take it for a failure of the step."""


@pytest.mark.parametrize("raised", [GeneratorExit, OwnError])  # SystemExit: test_signals.py
def test_what_is_no_failure_passes_through(raised):
    def leave(t, q, v):
        if t > 0.1:
            raise raised("out")
        return np.zeros(3)

    with pytest.raises(raised, match="out"):
        pc.simulate(pc.load("four_bar"), (0.0, 1.0), forces=[leave])


def test_an_interrupt_inside_a_users_force_keeps_what_was_reached():
    """In the run: its functions of time are sampled before."""
    fastest = np.abs(pc.simulate(pc.load("four_bar"), (0.0, 0.5)).v).max()

    def interrupted(t, q, v):
        if np.abs(v).max() > fastest:
            raise KeyboardInterrupt
        return np.zeros(3)

    sol = pc.simulate(pc.load("four_bar"), (0.0, 1.0), forces=[interrupted])
    assert sol.status == 1 and "interrupted" in sol.message and 0.2 < sol.t[-1] <= 0.5


RETURNED = {
    "whole numbers": lambda x: np.round(10 * x).astype(int),
    "single precision": lambda x: np.float32(x),
    "every other number": lambda x: np.repeat(x, 2)[::2],
    "reversed": lambda x: x[::-1],
    "read-only": lambda x: np.broadcast_to(x[0], 3),
}


class OwnForce:
    """A force object that shapes what it returns."""

    def __init__(self, shape):
        self.shape = shape

    def torque(self, t, q, v):
        return self.shape(np.array([0.3, -0.2, 0.1]))

    def derivatives(self, t, q, v):
        return np.asfortranarray(np.zeros((3, 3))), np.zeros((3, 6))[:, ::2]


@pytest.mark.parametrize("name", RETURNED)
def test_arrays_of_any_layout_are_understood(name):
    shape, scene = RETURNED[name], pc.load("four_bar")
    plain = pc.simulate(scene, (0.0, 0.3), forces=[OwnForce(lambda x: np.array(shape(x), float))])
    other = pc.simulate(scene, (0.0, 0.3), forces=[OwnForce(shape)])
    np.testing.assert_array_equal(other.lam, plain.lam)


@pytest.mark.parametrize("inside", ["run", "thread", "garbage collection"])
def test_a_force_may_simulate_the_same_mechanism(inside):
    mech, calls = pc.load("four_bar"), []

    def nested():
        pc.simulate(mech, (0.0, 0.01))

    def alone(t, q, v):
        return -0.1 * v

    def disturbed(t, q, v):
        calls.append(t)
        if len(calls) % 20 == 0:
            if inside == "thread":
                thread = threading.Thread(target=nested)
                thread.start()
                thread.join()
            elif inside == "run":
                nested()
            else:
                gc.collect()
        return -0.1 * v

    runs = [pc.simulate(mech, (0.0, 0.3), forces=[law], **LOOSE) for law in (alone, disturbed)]
    np.testing.assert_array_equal(runs[0].lam, runs[1].lam)


def test_threads_on_one_mechanism_do_not_meet():
    mech, found = pc.load("crank_rocker"), []

    def run():
        found.append(pc.simulate(mech, (0.0, 2.0)))

    threads = [threading.Thread(target=run) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    alone = pc.simulate(mech, (0.0, 2.0))
    assert len(found) == 4
    for sol in found:
        np.testing.assert_array_equal(sol.lam, alone.lam)


def test_a_solution_outlives_its_mechanism():
    mech = pc.load("bricard")
    sol = pc.simulate(mech, (0.0, 0.5), dense_output=True)
    middle = sol.sol(0.25)
    del mech
    gc.collect()
    for a, b in zip(middle, sol.sol(0.25), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("span", [(0.0, 1e-13), (5.0, 5.0 + 1e-15), (-1e-300, 1e-300), (1e6, 1e6 + 0.1), (0.1, 0.0)])
def test_strange_spans_end_alike(span):
    runs = [pc.simulate(pc.load("four_bar"), span, method=method, **LOOSE) for method in ("BDF", "Radau")]
    assert [run.status for run in runs] == [0, 0]
    assert [run.t[-1] for run in runs] == [span[1]] * 2


def test_the_argument_backend_has_no_effect_and_says_so():
    mech = pc.load("four_bar")
    plain = pc.simulate(mech, (0.0, 0.1))
    with pytest.warns(UserWarning, match="backend= is deprecated"):
        asked = pc.simulate(mech, (0.0, 0.1), backend="python")
    np.testing.assert_array_equal(asked.lam, plain.lam)
    with pytest.warns(UserWarning, match="backend="):
        pc.Simulation(mech, backend="auto")
    problem = pc.paper.reference_problem("problem51")
    with pytest.warns(UserWarning, match="backend="):
        pc.integrate(problem.system, (problem.t0, problem.t0 + 0.1), problem.p0, problem.v0, backend="compiled")


CALLED_BACK = {"steps": {"step": 1e-2, "order": 3, "method": "Radau"}, "BDF": {}, "Radau": {"method": "Radau"}}


@pytest.mark.parametrize("how", CALLED_BACK)
def test_a_mechanism_that_is_called_back_as_any_other_system_moves_the_same(how, monkeypatch):
    """On manifolds, too: charts, rows and forces then come from Python."""
    mech = pc.Mechanism(
        mixed_tree(), [pc.Loop("rope", "distance", "arm", "raft", length=1.0)], [FORCES["spring-damper"]]
    )
    options = {"rtol": 1e-8, "atol": 1e-9} | CALLED_BACK[how]
    native = pc.simulate(mech, (0.0, 0.1), **options)
    monkeypatch.setattr(steppers, "compiled_system", lambda system: engine.required().CallbackSystem(system))
    called_back = pc.simulate(mech, (0.0, 0.1), **options)
    assert native.success and called_back.success
    within = 1e-12 if how == "steps" else 1e-6
    for name in ("q", "v", "lam"):
        assert_same(getattr(native, name)[-1], getattr(called_back, name)[-1], within)


@pytest.mark.parametrize("since", [0.0, 1e-3])
def test_a_force_that_stops_the_start_is_named(since):
    mech = pc.load("four_bar").add_forces({"crank": lambda t: np.nan if t > since else 0.0})
    with pytest.raises(pc.PinconsistError, match=r"not finite.*'torque crank'"):
        pc.simulate(mech, (0.0, 1.0), method="BDF", step=0.01)


def test_a_stiff_damper_between_two_hinged_bodies_starts():
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
        sol = pc.simulate(mech, (0.0, 0.1), None, v0, method="BDF", rtol=tol, atol=tol)
        assert sol.success and sol.check(error=False).position < 1e-12
        errors.append(np.abs(sol.v[-1, [5, 11]] - exact).max() / np.abs(exact).max())
    slopes = np.diff(np.log10(errors)) / -2.0  # local errors add up: tol^(5/6)
    assert errors[-1] < 1e-4 and (slopes > 0.6).all(), errors


def test_the_workspace_of_data_is_found_again_though_they_hold_a_nan():
    """Pinocchio compares data by their numbers; what is built for each is built once, and goes with them."""
    model = pc.load("four_bar").model
    gc.collect()  # those of earlier tests
    data, before = model.createData(), len(tree._workspaces)
    data.oMi[1].translation[:] = np.nan
    assert data != data
    first = tree.workspace(engine.required(), model, data)
    assert tree.workspace(engine.required(), model, data) is first and len(tree._workspaces) == before + 1
    assert tree.workspace(engine.required(), model, model.createData()) is not first
    del data
    gc.collect()
    assert len(tree._workspaces) == before
