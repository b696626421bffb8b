"""Simulation: a run as an object."""

import copy
import pickle
import threading

import numpy as np
import pinocchio as pin
import pytest
from helpers.scenes import add_body, at

import pinconsist as pc

DT = 5e-3


def torque(t, v):
    return 5.0 * (1.0 + np.sin(40.0 * t) - v[0])


def stepped(sim, count):
    for _ in range(count):
        sim.step(DT, {"crank": torque(sim.state.t, sim.state.v)})
    return sim


@pytest.fixture(scope="module")
def mech():
    return pc.load("crank_rocker")


@pytest.mark.parametrize(
    "options",
    [{}, {"method": "BDF"}, {"step": 1e-3, "order": 5}, {"events": lambda *y: 1.0}],
)
def test_steps_are_those_of_a_sampled_run(mech, options):
    count = 10
    sim = stepped(pc.Simulation(mech, **options), count)
    controller = pc.Sampled(DT, lambda t, q, v: torque(t, v), "crank")
    sol = pc.simulate(mech, (0.0, count * DT), forces=[controller], method="Radau", rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(sim.state.t, count * DT, rtol=1e-12)
    np.testing.assert_allclose(sim.state.q, sol.q[-1], atol=1e-8)
    np.testing.assert_allclose(sim.state.v, sol.v[-1], atol=1e-6)
    np.testing.assert_allclose(sim.lam, sol.lam[-1], atol=1e-5)
    mine = sim.solution()
    assert mine.t[-1] == sim.state.t
    certificate = mine.check(error=True)
    assert certificate.force < 1e-8
    assert certificate.energy_error < 1e-3
    assert certificate.error.q < 1e-7
    assert len(mine.held["control"]) == count


def test_controllers_and_steps_of_one_rate_keep_step(mech):
    """Times that are added up differ from multiples of the period by rounding; no step is made between them."""
    count, law = 40, pc.Sampled(1e-3, lambda t, q, v: torque(t, v), "crank")
    sim = pc.Simulation(mech, forces=[law], rtol=1e-3)
    for _ in range(count):
        sim.step(1e-3)
    sol = pc.simulate(mech, (0.0, count * 1e-3), forces=[law], method="Radau", rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(sim.state.q, sol.q[-1], atol=1e-7)
    found = sim.solution()
    assert found.nsteps <= count + 2
    assert len(found.held["sampled crank"]) == count
    assert found.check(error=False).force < 1e-8


@pytest.mark.parametrize("options", [{}, {"method": "BDF"}, {"step": 1e-3}])
def test_what_is_asked_between_steps_changes_nothing(mech, options):
    """The rows are the same, those where torques jump as well, whether they are asked for once or after each step."""
    plain, asked = stepped(pc.Simulation(mech, **options), 5).solution(), pc.Simulation(mech, **options)
    for _ in range(5):
        stepped(asked, 1)
        assert asked.lam.shape == (mech.nc,)
        assert not asked.state.q.flags.writeable
    asked = asked.solution()
    assert np.count_nonzero(np.diff(plain.t) == 0.0) == 4
    for name in ("t", "q", "v", "lam", "order"):
        np.testing.assert_array_equal(getattr(asked, name), getattr(plain, name))


def test_a_copy_goes_on_alike_and_leaves_the_first_alone(mech):
    sim = stepped(pc.Simulation(mech), 5)
    before, other = sim.state, sim.copy()
    there = other.step(DT)
    assert sim.state is not there
    np.testing.assert_array_equal(sim.state.q, before.q)
    np.testing.assert_allclose(there.q, sim.step(DT).q, atol=1e-10)
    assert other.solution().t[0] == before.t


@pytest.mark.parametrize("options", [{}, {"method": "BDF"}])
def test_what_is_asked_before_the_first_step(mech, options):
    sim = pc.Simulation(mech, **options)
    assert len(sim.solution().t) == 1
    for run in (pc.Simulation(mech, **options), sim.copy()):
        np.testing.assert_allclose(run.lam, sim.lam, rtol=1e-9, atol=1e-9)
    sim.step(DT)
    sim.reset()
    assert len(sim.solution().t) == 1


@pytest.mark.parametrize("options", [{}, {"method": "BDF"}])
def test_a_copy_goes_on_with_what_a_controller_holds_and_has_measured(mech, options):
    """Its torques act 8 ms after the samples."""
    law = pc.Sampled(0.01, lambda t, q, v: [30.0 - v[0]], "crank", delay=8e-3)
    sim = pc.Simulation(mech, forces=[law], **options)
    sim.step(9e-3)
    sim.step(2e-3)
    copy = sim.copy()
    for run in (sim, copy):
        for _ in range(4):
            run.step(7e-3)
    np.testing.assert_allclose(copy.state.v, sim.state.v, rtol=1e-5)


@pytest.mark.parametrize("options", [{}, {"method": "BDF"}])
def test_a_refused_call_forgets_no_jump(mech, options):
    sim = pc.Simulation(mech, forces=[pc.HeldTorque([0.0, 0.01], [0.0, 50.0], "crank")], **options)
    sim.step(0.01)
    with pytest.raises(pc.InputError, match="crnk"):
        sim.step(0.01, {"crnk": 0.0})
    sim.step(0.01)
    sol = sim.solution()
    assert (sol.t == 0.01).sum() == 2 and sol.check(error=False).force < 1e-6


def test_reset_begins_a_new_run(mech):
    sim = stepped(pc.Simulation(mech), 4)
    state = sim.reset({"crank": 0.5}, {"crank": 1.0}, t0=2.0)
    assert state.t == 2.0
    np.testing.assert_allclose([state.q[0], state.v[0]], [0.5, 1.0], atol=1e-12)
    sim.step(DT)
    sol = pc.simulate(mech, (2.0, 2.0 + DT), {"crank": 0.5}, {"crank": 1.0}, method="Radau")
    np.testing.assert_allclose(sim.state.q, sol.q[-1], atol=1e-9)
    assert sim.solution().t[0] == 2.0


def test_events_and_their_end(mech):
    sim = pc.Simulation(mech, events=pc.Event(lambda t, q, v, lam: q[0] - 1e-3, terminal=True))
    while not sim.events[0]:
        sim.step(DT, {"crank": 20.0})
    assert abs(sim.state.q[0] - 1e-3) < 1e-9
    assert sim.events[0] == [sim.state.t]
    with pytest.raises(pc.InputError, match="ended"):
        sim.step(DT)
    assert sim.solution().status == 1
    sim.reset()
    sim.step(DT)


def test_what_cannot_be_is_refused(mech):
    sim = pc.Simulation(mech)
    for dt in (0.0, -1.0, np.nan, np.inf, None, "1", 1e-3j, [DT], np.array([DT])):
        with pytest.raises(pc.InputError, match="dt"):
            sim.step(dt)
    sim.step(0.12)
    with pytest.raises(pc.InputError, match="too small to differ from zero"):
        sim.step(1e-17)
    for control in ({"crnk": 1.0}, [1.0], {"crank": np.nan}):
        with pytest.raises(pc.InputError):
            sim.step(DT, control)
    for t0 in (np.nan, None, "1", [1.0]):
        with pytest.raises(pc.InputError, match="t0"):
            sim.reset(t0=t0)
    with pytest.raises(pc.InputError, match="method"):
        pc.Simulation(mech, method="RK4")
    sim.step(DT, [1.0, 0.0, 0.0])


PENDULUM = pin.Model()
for name in ("hip", "knee"):
    add_body(PENDULUM, PENDULUM.njoints - 1, pin.JointModelRY(), at(0.0, 0.0), name, 1.0, (0.0, 0.0, -0.3), 0.02)
ACTUATORS = [
    pc.Actuator("up", "hip", gain=(30.0, 0, 0), bias=(0, -30.0, -2.0), control=lambda t: 0.2 * t, force_range=(-4, 4)),
    pc.Actuator("both", {"hip": 1.0, "knee": -2.0}, gear=3.0, control_range=(-1, 1)),
]


@pytest.mark.parametrize("options", [{}, {"method": "BDF"}])
def test_actuators_are_commanded_by_name(options, tmp_path):
    """A command of the run's own until the first one that is given, then what is held; as an equal law of time does."""
    arm, given = pc.Mechanism(PENDULUM, forces=ACTUATORS, name="arm"), [{}, {"up": 0.3}, {"both": 0.4, "knee": 0.2}, {}]
    close = {"max_step": 1e-3}  # rows, for the work of a torque that saturates between them
    sim = pc.Simulation(arm, {"hip": 0.1}, rtol=1e-10, atol=1e-12, **close, **options)
    for control in given:
        sim.step(0.01, control)
    up, both = ([0.0, 0.2 * 0.01, 0.3, 0.3, 0.3], [0.0, 0.0, 0.0, 0.4, 0.4])
    q, v = [0.1, 0.0], [0.0, 0.0]
    for i, knee in enumerate((0.0, 0.0, 0.2, 0.0)):
        before = up[i : i + 2] if i == 0 else [up[i + 1]] * 2
        control = {"up": ([0.01 * i, 0.01 * (i + 1)], before), "both": both[i + 1]}
        span = 0.01 * i, 0.01 * (i + 1)
        sol = pc.simulate(arm, span, q, v, control=control, forces=[{"knee": knee}], rtol=1e-9, atol=1e-11)
        q, v = sol.q[-1], sol.v[-1]
    np.testing.assert_allclose(sim.state.q, q, atol=1e-8)
    copy, mine = sim.copy(), sim.solution()
    np.testing.assert_allclose(copy.step(0.01).q, sim.step(0.01).q, atol=1e-9)
    assert mine.held["up"].shape == (1, 2) and mine.check(error=True).energy_error < 1e-4
    np.testing.assert_allclose(mine.torque("both")[-1], np.array([3.0, -6.0]) * 0.4)
    mine.save(tmp_path / "run.npz")
    again = pc.Solution.load(tmp_path / "run.npz")
    assert again.check(sim.mechanism, error=False).force < 1e-8
    np.testing.assert_allclose(again.torque("up", sim.mechanism), mine.torque("up"), atol=1e-12)
    with pytest.raises(pc.InputError, match="no actuator or joint 'upp'; similar: up"):
        sim.step(0.01, {"upp": 1.0})
    for wrong, message in (({"up": np.nan}, "finite"), ({"up": "high"}, "number"), ({"hip": [1.0, 2.0]}, "hip")):
        with pytest.raises(pc.InputError, match=message):
            sim.step(0.01, wrong)


def test_copies_of_the_standard_library_are_runs_of_their_own():
    """``copy.copy`` shared the rows and the torque that was held."""
    sim, alone = (pc.Simulation(pc.load("crank_rocker"), v0={"crank": 1.0}) for _ in range(2))
    for each in (sim, alone):
        each.step(0.01)
    for other in (copy.copy(sim), copy.deepcopy(sim)):
        other.step(0.02, {"crank": 50.0})
    np.testing.assert_array_equal(sim.step(0.01).q, alone.step(0.01).q)
    kind = type("Gym", (pc.Simulation,), {})
    assert type(kind(pc.load("crank_rocker")).copy()) is kind
    with pytest.raises(pc.InputError, match="cannot be pickled"):
        pickle.dumps(sim)


def test_work_of_torques_at_large_times():
    """At 1e9 s the offset that tells times apart was as long as a period."""
    work = []
    for t0 in (0.0, 1e9):
        sim = pc.Simulation(pc.load("crank_rocker"), v0={"crank": 1.0}, t0=t0)
        for k in range(20):
            sim.step(1e-4, {"crank": 5.0 * (-1.0) ** k})
        work.append(sim.solution().energy().work["control"][-1])
    rounded = np.spacing(1e9) / 1e-4  # of a hold; largest work of one: 5e-4 J
    assert work[1] == pytest.approx(work[0], abs=20 * rounded * 5e-4)


@pytest.mark.parametrize("method", ["Radau", "BDF"])
@pytest.mark.parametrize("law", [False, True])
def test_one_run_belongs_to_one_thread_at_a_time(method, law):
    """Each call either makes its whole step or is refused; the process once ended, or steps were lost."""
    forces = [lambda t, q, v: -0.1 * v] if law else []
    sim = pc.Simulation(pc.load("four_bar"), v0={"crank": 3.0}, forces=forces, method=method)
    made, refused = [], []

    def work():
        for _ in range(100):
            try:
                made.append(sim.step(1e-3).t)
            except pc.InputError as error:
                refused.append(str(error))

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(made) + len(refused) == 400 and all("another thread" in each for each in refused)
    assert sim.state.t == pytest.approx(1e-3 * len(made), abs=1e-12)
    alone = pc.simulate(pc.load("four_bar"), (0.0, sim.state.t), v0={"crank": 3.0}, forces=forces, method=method)
    np.testing.assert_allclose(sim.state.q, alone.q[-1], atol=1e-5)


def test_a_law_may_read_the_state_but_not_step_its_own_run():
    seen = []

    def law(t, q, v):
        seen.append(sim.state.t)
        for use in (lambda: sim.step(1e-3), sim.solution, sim.copy, sim.reset, lambda: sim.lam):
            with pytest.raises(pc.InputError, match="in use"):
                use()
        return 0.0 * v

    sim = pc.Simulation(pc.load("four_bar"), forces=[law])
    assert sim.step(1e-3).t == 1e-3 and seen


def test_runs_of_their_own_in_threads_are_those_without_threads():
    mech, found = pc.load("four_bar"), {}

    def work(speed):
        sim = pc.Simulation(mech, v0={"crank": speed})
        for _ in range(100):
            state = sim.step(1e-3)
        found[speed] = (*found.get(speed, ()), (*state.q, *state.v, *sim.lam))

    speeds = [1.0, 2.0, 3.0, 4.0]
    threads = [threading.Thread(target=work, args=(speed,)) for speed in speeds]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for speed in speeds:
        work(speed)
        assert found[speed][0] == found[speed][1]


@pytest.mark.parametrize("kind", [KeyboardInterrupt, ValueError])
def test_what_a_force_raises_once_is_not_lost(kind):
    raising = []

    def force(t, q, v):
        if raising:
            raise raising.pop()
        return np.zeros(3)

    sim = pc.Simulation(pc.load("four_bar").add_forces(pc.Torque(force)))
    sim.step(0.01)
    sim.step(0.01)
    raising.append(kind("once"))
    with pytest.raises((KeyboardInterrupt, pc.UserFunctionError)):
        sim.step(0.01)
