"""The compiled twin: equal to the Python method in every term, step and counter; what happens around it."""

import dataclasses
import logging
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from helpers.bodies import mixed_tree, random_state
from helpers.forces import FORCES
from helpers.loops import KINDS, PAIRS, closed_gap, loop_open_by
from helpers.twin import LOOSE, assert_same, compare_row_gradients, compare_terms, needs_twin, twin_of, with_switches

import pinconsist as pc
from pinconsist import _core
from pinconsist._core import compiled, compiled_system
from pinconsist.dae.index1 import solve_acceleration
from pinconsist.dae.tuning import Switches
from pinconsist.mechanism.system import MechanismSystem

SCENES = {  # name → duration, s
    "four_bar": 1.0,
    "crank_rocker": 0.5,
    "andrews": 5e-3,
    "bricard": 2.0,
    "delta_robot": 0.2,
    "five_bar": 0.6,
    "flyball_governor": 0.5,
    "jansen_leg": 0.4,
    "planar_pendulum": 1.0,
    "slider_crank": 1.0,
    "stewart_platform": 0.05,
    "chain_40": 0.3,  # Newton matrices are kept, LAPACK factorises; accelerations carry rounding times cond(M)
}
ALIKE = 20  # steps that both make alike: 12 of the first size, and the first ones that the control chooses
OFF = dict.fromkeys((switch.name for switch in dataclasses.fields(Switches)), False)


@needs_twin
@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
@pytest.mark.parametrize("kind", KINDS)
def test_every_loop_kind_between_every_kind_of_joint(kind, pair):
    model, rng = mixed_tree(), np.random.default_rng(2)
    q, _ = random_state(model, rng)
    compare_terms(pc.Mechanism(model, [loop_open_by(model, q, kind, *pair, closed_gap(kind, rng))]), q)


@needs_twin
@pytest.mark.parametrize("name", FORCES)
def test_every_force(name):
    model = mixed_tree()
    q, _ = random_state(model, np.random.default_rng(3))
    compare_terms(pc.Mechanism(model, forces=[FORCES[name]]), q)


MOTION = pc.Motion(0.1, 0.7, 0.3, 1.4, 0.2)
RECORDS = {
    "drive": pc.Drive("motor", "hinge", MOTION),
    "drive of an unbounded joint": pc.Drive("motor", "turn", MOTION),
    "drive by a function": pc.Drive("motor", "hinge", np.sin, np.cos, lambda t: -np.sin(t)),
    "coupling": pc.Coupling("gear", "hinge", "slide", -1.5, 0.2),
    "coupling with powers": pc.Coupling("cam", "hinge", "slide", 0.5, 0.1, (0.3, -0.2, 0.7)),
    "constraint": pc.Constraint("own", lambda t, q: np.array([q[0] * q[1] - 0.1 * t]), 1),
}


@needs_twin
@pytest.mark.parametrize("name", RECORDS)
def test_every_other_record(name):
    """Their rows are open at a random configuration; Φ, J and their derivatives are compared there all the same."""
    model, t = mixed_tree(), 0.3
    q, v = random_state(model, np.random.default_rng(4))
    system = MechanismSystem(pc.Mechanism(model, [RECORDS[name]]), q, t)
    twin = twin_of(system)
    for ours, theirs in zip(system.constraint(t, q, v), twin.evaluate(t, q, v, 0 * v)[1::2], strict=True):
        assert_same(ours, theirs)
    assert_same(system.evaluate(t, q, v, 0 * v)[2].T, twin.evaluate(t, q, v, 0 * v)[2])
    a, lam = solve_acceleration(system, t, q, v)
    for ours, theirs in zip((a, lam), _core.load()[0].Projection(twin).acceleration(t, q, v)[:2], strict=True):
        assert_same(ours, theirs, 1e-10)
    if twin.calls_python:
        assert twin.row_gradients(t, q, v, lam) is None
    else:
        compare_row_gradients(system, twin, t, q, v)


@needs_twin
@pytest.mark.parametrize("name", ["servo with a motion", "torque of a motion", "drive"])
def test_motions_stay_in_compiled_code(name):
    model = mixed_tree()
    force = {
        "servo with a motion": pc.Servo("hinge", MOTION, 20.0, 3.0),
        "torque of a motion": pc.JointTorque({"slide": MOTION}),
    }
    loops = [RECORDS["drive"]] if name == "drive" else []
    mech = pc.Mechanism(model, loops, [force[name]] if name in force else [])
    q, _ = random_state(model, np.random.default_rng(5))
    assert not twin_of(MechanismSystem(mech, q)).calls_python
    compare_terms(mech, pc.assemble(mech, q, t=0.3).q if loops else q)


def both(mech, *t_span, **options):
    """Runs on both, the compiled one with all switches off; with one first step: its estimate may be near rounding."""
    if "step" not in options:
        first_step = abs(pc.simulate(mech, t_span, backend="python", **options).h[0])
        options |= {"first_step": 0.999 * first_step}
    options |= {"dense_output": True}
    with with_switches(**OFF):
        return [pc.simulate(mech, t_span, backend=backend, **options) for backend in ("python", "compiled")]


def assert_equal_runs(ours, theirs, size=1e-8):
    """The same method: the same choices until rounding has a say, and answers that are equal as far as they can be.

    Some choices compare numbers that rounding reaches, such as whether Newton looks at a residual once more or whether
    a step passes the error test; every change of step enlarges the differences (of 1e-16 at first) by about a hundred.
    """
    assert theirs.method["backend"] == "compiled" and ours.method["backend"] == "python"
    assert ours.status == theirs.status
    for name in ("nsteps", "nfev", "njev", "nlu"):  # a rejection that only one has costs it about 10 residuals
        a, b = getattr(ours, name), getattr(theirs, name)
        assert abs(a - b) <= 0.15 * max(a, b), name
    for reason in ours.rejected:
        assert abs(ours.rejected[reason] - theirs.rejected[reason]) <= 2
    # the start and the first choices: 1 % is less than what any other constant of the step control makes of them
    np.testing.assert_array_equal(ours.order[:ALIKE], theirs.order[:ALIKE])
    np.testing.assert_allclose(ours.h[:ALIKE], theirs.h[:ALIKE], rtol=0.01)
    alike = len(ours.h) == len(theirs.h) and np.array_equal(ours.order, theirs.order)
    if alike and np.allclose(ours.t, theirs.t, rtol=0, atol=2 * size):  # at several rad/s q is apart by 10 size
        for name, factor in {"q": 10, "v": 1e3, "lam": 1e4}.items():
            assert_same(getattr(ours, name), getattr(theirs, name), factor * size)
    else:
        assert_equal_within_tolerance(ours, theirs)


def assert_equal_within_tolerance(ours, theirs):
    """At the same times, in the norm of the error test: in each step of each run it let pass an error of 1 at most."""
    times = np.linspace(ours.t[0], min(ours.t[-1], theirs.t[-1], key=abs), 30)
    for a, b in list(zip(ours.sol(times), theirs.sol(times), strict=True))[:2]:
        size = np.abs(a).max(axis=0)
        apart = np.sqrt(np.mean(((a - b) / (LOOSE["atol"] + LOOSE["rtol"] * size)) ** 2, axis=1))
        assert apart.max() <= ours.nsteps + theirs.nsteps


@needs_twin
@pytest.mark.parametrize("name", [name for name in SCENES if name != "chain_40"])  # whose steps rounding decides
def test_same_steps_orders_and_counters(name):
    ours, theirs = both(pc.load(name), 0.0, SCENES[name], **LOOSE)
    assert ours.success and ours.nsteps > 15
    assert_equal_runs(ours, theirs, 1e-8)


@needs_twin
@pytest.mark.parametrize("name", SCENES)
def test_same_numbers_with_a_fixed_step(name):
    """Where nothing is left to choose, no rounding can part them."""
    ours, theirs = both(pc.load(name), 0.0, SCENES[name], step=SCENES[name] / 50)
    assert ours.success and ours.nsteps == 50
    assert_equal_runs(ours, theirs, 1e-7 if name == "chain_40" else 1e-12)


@needs_twin
@pytest.mark.parametrize(
    "options",
    [
        {"step": 1e-3, "max_order": 3},
        {"step": 1e-3, "max_order": 2, "consistency": "initial"},
        {"step": 1e-3, "method": "ImplicitEuler", "consistency": "exact"},
        {"max_order": 3, "max_step": 2e-3, **LOOSE},
        {"rtol": (1e-4, 1e-3), "atol": (1e-5, np.array([1e-4, 1e-5, 1e-4]))},
        {"max_steps": 20, **LOOSE},
        {"step": 1e-2, "method": "Radau", "max_order": 1},
        {"step": 1e-2, "method": "Radau", "max_order": 5},
    ],
    ids=str,
)
def test_same_for_every_method(options):
    ours, theirs = both(pc.load("crank_rocker"), 0.0, 0.2, v0={"crank": 10.0}, **options)
    assert_equal_runs(ours, theirs)
    assert ours.message == theirs.message


@needs_twin
@pytest.mark.parametrize("name", ["crank_rocker", "andrews", "bricard", "jansen_leg", "stewart_platform"])
def test_radau_makes_the_same_steps(name):
    ours, theirs = both(pc.load(name), 0.0, SCENES[name], method="Radau", **LOOSE)
    assert ours.success
    assert_equal_runs(ours, theirs)


@needs_twin
def test_radau_chooses_the_same_stages_and_runs_the_same_backwards():
    mech = pc.load("four_bar")
    for span, rtol in ((0.0, 1.0), 1e-8), ((0.3, 0.0), 1e-4):
        ours, theirs = both(mech, *span, method="Radau", rtol=rtol, atol=1e-8)
        assert_equal_runs(ours, theirs)
        assert (np.unique(ours.order[1:]).tolist() == [9, 13]) == (rtol == 1e-8)


@needs_twin
def test_radau_is_the_same_on_manifolds_and_called_back(monkeypatch):
    model = mixed_tree()
    mech = pc.Mechanism(model, [pc.Loop("rope", "distance", "arm", "raft", length=1.0)], [FORCES["spring-damper"]])
    ours, theirs = both(mech, 0.0, 0.1, method="Radau", **LOOSE)
    assert_equal_runs(ours, theirs)
    monkeypatch.setattr(compiled_system, "compiled_system", lambda system: _core.load()[0].CallbackSystem(system))
    assert_equal_runs(*both(mech, 0.0, 0.05, method="Radau", **LOOSE))


@needs_twin
def test_radau_without_switches_is_as_accurate():
    """Derivatives at two stages, and iterations that are left out where the last steps promise it, cost no accuracy."""
    mech, run = pc.load("crank_rocker"), {"v0": {"crank": 12.0}, "method": "Radau", "max_order": 9}
    tight = pc.simulate(mech, (0.0, 1.0), rtol=1e-12, atol=1e-12, **run).q[-1]
    fast = pc.simulate(mech, (0.0, 1.0), **run)
    with with_switches(**OFF):
        plain = pc.simulate(mech, (0.0, 1.0), **run)
    assert fast.njev < 0.6 * plain.njev and fast.nfev < plain.nfev
    assert np.abs(fast.q[-1] - tight).max() < 1e-5 > np.abs(plain.q[-1] - tight).max()


@needs_twin
def test_same_backwards():
    mech = pc.load("four_bar")
    assert_equal_runs(*both(mech, 1.0, 0.0, **LOOSE))


@needs_twin
def test_same_on_manifolds_and_with_python_in_the_middle():
    """A free body on a spring with a user's own force; what Python is given are arrays of its own."""
    model, kept = mixed_tree(), []

    def push(t, q, v):
        kept.append(v)
        return -0.3 * v * np.abs(v)

    forces = [pc.Torque(push), FORCES["spring-damper"], FORCES["local wrench"]]
    mech = pc.Mechanism(model, [pc.Loop("rope", "distance", "arm", "raft", length=1.0)], forces)
    assert_equal_runs(*both(mech, 0.0, 0.2, **LOOSE))
    kept.clear()
    pc.simulate(mech, (0.0, 0.2), backend="compiled")
    assert len({array.ctypes.data for array in kept}) == len(kept)


@needs_twin
def test_same_errors_on_long_runs():
    """Step by step the two part, as rounding grows; their errors against a tight run do not."""
    mech = pc.load("crank_rocker")
    times = np.linspace(0.1, 2.0, 39)
    tight = pc.simulate(mech, (0.0, 2.0), rtol=1e-11, atol=1e-12, t_eval=times, backend="python")
    errors = []
    for run in (
        pc.simulate(mech, (0.0, 2.0), rtol=1e-7, atol=1e-8, t_eval=times, backend=backend)
        for backend in ("python", "compiled")
    ):
        errors.append(
            [np.sqrt(np.mean((getattr(run, name) - getattr(tight, name)) ** 2)) for name in ("q", "v", "lam")]
        )
    ratios = np.divide(*errors)
    assert (ratios > 0.5).all() and (ratios < 2.0).all(), errors


@needs_twin
@with_switches(**OFF)
def test_output_is_the_same():
    mech, times = pc.load("four_bar"), np.linspace(0.0, 0.3, 7)
    seen = ([], [])
    event = pc.Event(lambda t, q, v, lam: v[0] + 1.0, name="fast")
    for rows, backend in zip(seen, ("python", "compiled"), strict=True):

        def keep(*row, rows=rows):
            rows.append(row)

        wishes = {"events": event, "dense_output": True, "callback": keep}
        wishes |= {"backend": backend, "first_step": 0.01, **LOOSE}
        sol = pc.simulate(mech, (0.0, 0.3), **wishes)
        rows.append((sol.t_events[0], *sol.sol(times)))
        del wishes["events"], wishes["callback"]
        rows.append(pc.simulate(mech, (0.0, 0.3), **wishes).sol(times))
        rows.append(pc.simulate(mech, (0.0, 0.3), **wishes | {"dense_output": False, "t_eval": times}).q)
    assert len(seen[0]) == len(seen[1])
    for ours, theirs in zip(*seen, strict=True):
        for a, b in zip(ours, theirs, strict=True):
            assert_same(a, b, 1e-7)


@needs_twin
def test_what_a_users_force_raises_leaves_what_was_reached():
    def late(t, q, v):
        if t > 0.7:
            raise ValueError("too late")
        return np.zeros(3)

    for backend in ("python", "compiled"):
        sol = pc.simulate(pc.load("four_bar"), (0.0, 1.0), forces=[late], backend=backend)
        assert sol.status == -1 and "too late" in sol.message and 0.3 < sol.t[-1] <= 0.7


@needs_twin
def test_a_force_that_is_not_finite_is_named():
    def broken(t, q, v):
        return np.full(3, np.nan if t > 0.2 else 0.0)

    sol = pc.simulate(pc.load("four_bar"), (0.0, 1.0), forces=[broken], step=1e-2, backend="compiled")
    assert sol.status == -1 and "not finite" in sol.message and "broken" in sol.message


@needs_twin
def test_redundant_loops_share_their_load_in_both():
    """A loop that stands there three times: each takes a third, as the multipliers of smallest norm do."""
    mech = pc.load("four_bar")
    (loop,) = mech.loops
    mech = mech.with_loops(loop, dataclasses.replace(loop, name="b"), dataclasses.replace(loop, name="c"))
    ours, theirs = both(mech, 0.0, 0.5, **LOOSE)
    assert not ours.system.dropped_are_zero
    assert_equal_runs(ours, theirs)
    a, b, c = np.split(theirs.lam, 3, axis=1)
    assert_same(a, b, 1e-9)
    assert_same(a, c, 1e-9)


@needs_twin
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
        sol = pc.simulate(mech, (0.0, 1e4), backend="compiled")
        took = time.monotonic() - begun
    finally:
        signal.signal(signal.SIGALRM, previous)
        done.set()
        thread.join()
    assert sol.status == 1 and "interrupted" in sol.message and sol.nsteps > 1000
    assert took < 3.0  # the interrupt comes after 0.3 s; what is over is the machine's load
    assert sum(begun < tick < begun + took for tick in ticks) > 20


def test_without_the_compiled_part_python_runs_and_says_so_once(monkeypatch, caplog):
    why = "pinconsist was installed without its compiled part (no C++ compiler was found)"
    monkeypatch.setattr(compiled, "load", lambda: (None, why))
    compiled._warn_once.cache_clear()
    mech = pc.load("four_bar")
    with caplog.at_level(logging.WARNING, "pinconsist"):
        runs = [pc.simulate(mech, (0.0, 0.05)) for _ in range(2)]
    assert [run.method["backend"] for run in runs] == [f"python ({why})"] * 2
    assert len([record for record in caplog.records if why in record.getMessage()]) == 1
    with pytest.raises(pc.InputError, match="no C\\+\\+ compiler"):
        pc.simulate(mech, (0.0, 0.05), backend="compiled")


def test_sources_without_their_compiled_part_say_where_they_are(tmp_path):
    """Nor that no compiler was found: an installed pinconsist may well have its compiled part."""
    plain = _core._absent(tmp_path)
    (tmp_path / "CMakeLists.txt").touch()
    sources = _core._absent(tmp_path)
    assert "no C++ compiler was found" in plain and "no C++ compiler" not in sources
    assert str(tmp_path) in sources and "another folder" in sources and f"-m pip install -e {tmp_path}" in sources


SCRIPT = """
import logging, warnings
warnings.simplefilter("ignore")
{before}
import pinconsist as pc
for _ in range(2):
    pc.simulate(pc.load("four_bar"), (0.0, 0.01))
"""
STALE = "import pinconsist._core; pinconsist._core.INTERFACE = -1"
FORGOTTEN = "import sys; sys.modules['pinconsist._core.twin'] = None"


@pytest.mark.parametrize("state", [
    FORGOTTEN, f"{FORGOTTEN}; logging.disable(logging.WARNING)", pytest.param(STALE, marks=needs_twin),
])  # fmt: skip
def test_a_script_without_the_compiled_part_is_told_once_with_the_command(state, tmp_path):
    """Also where warnings are filtered and nobody listens to the log, as in scripts and benchmarks."""
    run = subprocess.run(
        [sys.executable, "-c", SCRIPT.format(before=state)], capture_output=True, text=True, cwd=tmp_path, check=True
    )
    assert run.stdout == "" and run.stderr.count("fifty times slower") == 1 == len(run.stderr.splitlines())
    assert f"{sys.executable} -m pip install " in run.stderr


def test_an_application_that_listens_has_the_slow_method_in_its_log_only(tmp_path):
    listens = f"{FORGOTTEN}; logging.basicConfig(filename='app.log')"
    run = subprocess.run(
        [sys.executable, "-c", SCRIPT.format(before=listens)], capture_output=True, text=True, cwd=tmp_path, check=True
    )
    assert run.stderr == "" and (tmp_path / "app.log").read_text().count("fifty times slower") == 1


def refused(monkeypatch, owner, name, value):
    """Why the compiled part is not loaded where something else is there than it was built for."""
    _core.load.cache_clear()
    monkeypatch.setattr(owner, name, value)
    try:
        module, why = _core.load()
    finally:
        monkeypatch.undo()
        _core.load.cache_clear()
    assert module is None
    return why


@needs_twin
def test_a_compiled_part_of_another_version_is_named_and_not_used(monkeypatch):
    why = refused(monkeypatch, _core, "INTERFACE", -1)
    assert "not have the version of the Python code" in why and "twin." in why and "install pinconsist again" in why


@pytest.mark.parametrize("backend", ["python", "fortran"])
def test_only_known_backends(backend):
    if backend == "python":
        assert pc.simulate(pc.load("four_bar"), (0.0, 0.1), backend=backend).method["backend"] == "python"
    else:
        with pytest.raises(pc.InputError, match="unknown backend 'fortran'"):
            pc.simulate(pc.load("four_bar"), (0.0, 0.1), backend=backend)


@needs_twin
@pytest.mark.parametrize("name", ["problem51", "problem52"])
def test_general_problems_are_called_back(name):
    """The compiled method, with forecasts, asks less often than Python and reaches the same answer."""
    problem = pc.paper.reference_problem(name)
    span, ours = (problem.t0, problem.t0 + 1.0), []
    for backend in ("python", "compiled"):
        sol = pc.integrate(problem.system, span, problem.p0, problem.v0, rtol=1e-7, atol=1e-7, backend=backend)
        assert sol.success and sol.method["backend"] == backend
        exact = np.array([problem.exact(t)[2] for t in sol.t])
        ours.append((sol.nfev / sol.nsteps, np.abs(sol.lam - exact).max()))
    (python_work, python_error), (compiled_work, compiled_error) = ours
    assert compiled_work < 0.7 * python_work
    assert compiled_error < 2.0 * python_error < 1e-3


@needs_twin
@pytest.mark.parametrize("options", [{"step": 1e-2, "max_order": 3}, LOOSE], ids=str)
def test_called_back_systems_make_the_same_steps(options):
    """Problem 5.2 has U, F and G of the general form; a mechanism as any other system has charts."""
    problem = pc.paper.reference_problem("problem52")

    with with_switches(**OFF):
        runs = [
            pc.integrate(problem.system, (1.0, 2.0), problem.p0, problem.v0, backend=backend, **options)
            for backend in ("python", "compiled")
        ]
    assert_equal_runs(*runs)


@needs_twin
def test_a_called_back_mechanism_makes_the_same_steps_on_manifolds(monkeypatch):
    model = mixed_tree()
    mech = pc.Mechanism(model, [pc.Loop("rope", "distance", "arm", "raft", length=1.0)], [FORCES["spring-damper"]])
    with with_switches(kept_derivatives=False):  # a system that is called back keeps none
        first = 0.999 * pc.simulate(mech, (0.0, 0.2), backend="compiled", **LOOSE).h[0]
        native = pc.simulate(mech, (0.0, 0.2), backend="compiled", first_step=first, **LOOSE)
        monkeypatch.setattr(compiled_system, "compiled_system", lambda system: _core.load()[0].CallbackSystem(system))
        called_back = pc.simulate(mech, (0.0, 0.2), backend="compiled", first_step=first, **LOOSE)
    assert_same(native.q[-1], called_back.q[-1], 1e-6)
    assert abs(native.nsteps - called_back.nsteps) <= 2


@needs_twin
def test_what_a_called_back_function_raises_leaves_what_was_reached():
    def late(t, p, v):
        if t > 0.5:
            raise ValueError("too late")
        return np.zeros(2)

    problem = pc.HessenbergProblem(
        U=lambda t, p, v: v, F=late, G=lambda t, p, v: p[:, None], R=lambda t, p: np.array([(p @ p - 1.0) / 2])
    )
    sol = pc.integrate(problem, (0.0, 1.0), [1.0, 0.0], [0.0, 1.0], backend="compiled", step=0.01, max_order=2)
    assert sol.status == -1 and "too late" in sol.message and 0.2 < sol.t[-1] <= 0.5


@needs_twin
def test_a_solution_holds_no_compiled_system():
    """It would keep the user's functions alive in a cycle that the garbage collector does not see."""
    sol = pc.simulate(pc.load("four_bar"), (0.0, 0.2), forces=[lambda t, q, v: -0.1 * v])
    assert sol.method["backend"] == "compiled" and "compiled" in sol.summary()
    compiled_kinds = tuple(getattr(_core.load()[0], name) for name in ("System", "Projection", "Stepper"))
    assert not any(isinstance(value, compiled_kinds) for value in vars(sol.system).values())


@needs_twin
@pytest.mark.parametrize("given", [np.zeros(0), np.zeros(2), np.zeros(4), None, "x"], ids=repr)
def test_what_a_force_object_returns_is_checked(given):
    class Own:
        def torque(self, t, q, v):
            return given

        def derivatives(self, t, q, v):
            return None, None

    for backend in ("python", "compiled"):
        with pytest.raises(pc.InputError, match="torque of 'Own'"):
            pc.simulate(pc.load("four_bar"), (0.0, 0.1), forces=[Own()], backend=backend)


@needs_twin
def test_a_motion_of_the_users_own_is_asked_in_python():
    class Jump(pc.Motion):
        def __call__(self, t):
            return super().__call__(t) + 0.1

    mech = pc.load("four_bar").add_forces(pc.Servo("crank", Jump(), 20.0, 1.0))
    assert twin_of(MechanismSystem(mech, mech.guess)).calls_python
