"""Several runs of one mechanism, advanced together."""

import runpy
from pathlib import Path

import numpy as np
import pytest
from helpers.changed_numbers import CHANGES
from helpers.changed_numbers import scene as with_springs

import pinconsist as pc
from pinconsist.mechanism.parameters import parameter

N = 5


def alone(mech, q0, v0, torques, dt, **options):
    """The state that a Simulation reaches under these torques, a row for each step."""
    sim = pc.Simulation(mech, **options)
    sim.reset(q0, v0)
    for torque in torques:
        state = sim.step(dt, torque)
    return state, sim.lam


@pytest.fixture(scope="module", params=["crank_rocker", "stewart_platform"])
def scene(request):
    """A mechanism, states on its constraints and torques (steps, N, nv)."""
    mech = pc.load(request.param)
    sol = pc.simulate(mech, (0.0, 0.3), t_eval=np.linspace(0.0, 0.3, N), dense_output=True)
    starts = [pc.assemble(mech, q, v) for q, v in zip(sol.q, sol.v, strict=True)]
    rng = np.random.default_rng(1)
    torques = rng.uniform(-1.0, 1.0, (6, N, mech.nv))
    torques[2] = torques[1]
    return mech, np.array([each.q for each in starts]), np.array([each.v for each in starts]), torques


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("options", [{}, {"rtol": 1e-3, "atol": 1e-3}])
def test_each_run_is_that_of_a_simulation_of_its_own_bit_for_bit(scene, threads, options):
    mech, q, v, torques = scene
    sims = pc.Simulations(mech, N, q, v, threads=threads, **options)
    for each in torques:
        states = sims.step(1e-3, each)
    for i in range(N):
        expected, lam = alone(mech, q[i], v[i], torques[:, i], 1e-3, **options)
        np.testing.assert_array_equal(states.q[i], expected.q)
        np.testing.assert_array_equal(states.v[i], expected.v)
        np.testing.assert_array_equal(sims.lam[i], lam)
    np.testing.assert_allclose(states.t, 6e-3, rtol=1e-12)


def test_some_runs_begin_anew_and_the_others_go_on():
    mech = pc.load("five_bar")
    sims = pc.Simulations(mech, 3)
    for _ in range(4):
        sims.step(0.01)
    before = sims.state
    after = sims.reset(np.array([False, True, False]))
    np.testing.assert_array_equal(after.q[[0, 2]], before.q[[0, 2]])
    np.testing.assert_array_equal(after.q[1], pc.assemble(mech).q)
    assert after.t.tolist() == [before.t[0], 0.0, before.t[2]]
    for _ in range(4):
        states = sims.step(0.01)
    np.testing.assert_array_equal(states.q[1], before.q[1])
    assert states.t[0] == pytest.approx(0.08)


def test_parameters_by_run():
    mech = pc.load("crank_rocker")
    masses = np.array([0.5, 1.0, 4.0])
    sims = pc.Simulations(mech, 3, v0={"crank": 5.0})
    sims.set_parameters({"mass:coupler": masses, "gravity[2]": -1.0})
    for _ in range(10):
        states = sims.step(0.02)
    for i, mass in enumerate(masses):
        own = mech.with_parameters({"mass:coupler": mass, "gravity[2]": -1.0})
        exact = pc.simulate(own, (0.0, 0.2), v0={"crank": 5.0}, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(states.q[i], exact.q[-1], atol=1e-6)


def test_torques_by_name_for_all_runs_and_for_each():
    mech = pc.load("crank_rocker").with_gravity((0.0, 0.0, 0.0))
    sims = pc.Simulations(mech, 2)
    for _ in range(3):
        states = sims.step(0.01, {"crank": 1.0})
    np.testing.assert_array_equal(states.q[0], states.q[1])
    for _ in range(3):
        states = sims.step(0.01, {"crank": np.array([1.0, -1.0])})
    assert states.v[0, 0] > states.v[1, 0]
    zero = pc.Simulations(mech, 2)
    for _ in range(6):
        zero.step(0.01)
    np.testing.assert_allclose(zero.state.v, 0.0, atol=1e-12)


def test_commands_of_actuators_stay_until_others_come():
    mech = pc.load("crank_rocker").add_forces(pc.Actuator("motor", "crank", gain=(2.0, 0.0, 0.0)))
    sims, both = pc.Simulations(mech, 2), [pc.Simulation(mech), pc.Simulation(mech)]
    for commands in ([0.0, 1.0], [0.5, 1.0], None, [0.5, -1.0]):
        states = sims.step(0.01, None if commands is None else {"motor": np.array(commands)})
        for i, sim in enumerate(both):
            state = sim.step(0.01, None if commands is None else {"motor": commands[i]})
            np.testing.assert_array_equal(states.q[i], state.q)


def test_contacts_and_functions_of_the_user_run_one_after_another():
    mech = pc.load("four_bar").add_forces(lambda t, q, v: -0.1 * v)
    sims = pc.Simulations(mech, 2)
    sim = pc.Simulation(mech)
    for _ in range(3):
        states, state = sims.step(0.01, {"crank": 0.2}), sim.step(0.01, {"crank": 0.2})
    np.testing.assert_array_equal(states.q, np.tile(state.q, (2, 1)))


def test_a_run_that_fails_stands_still_and_the_others_go_on():
    mech = pc.load("crank_rocker")
    sims = pc.Simulations(mech, 2)
    for _ in range(2):
        sims.step(0.01)
    with np.errstate(all="ignore"):
        for _ in range(3):
            states = sims.step(0.01, {"crank": np.array([1e300, 0.0])})
    assert sims.failed.tolist() == [True, False] and sims.messages[0]
    assert states.t[1] == pytest.approx(0.05) and states.t[0] < 0.05
    assert np.isfinite(states.q).all()
    sims.reset([0])
    assert not sims.failed.any()
    assert sims.step(0.01).t[0] == pytest.approx(0.01)


def test_bad_arguments():
    mech = pc.load("four_bar")
    for n in 0, 1.5, True, "2":
        with pytest.raises(pc.InputError, match="n must be a positive whole number"):
            pc.Simulations(mech, n)
    with pytest.raises(pc.InputError, match="a row for each of 2 runs"):
        pc.Simulations(mech, 2, np.zeros((3, 3)))
    sims = pc.Simulations(mech, 2)
    with pytest.raises(pc.InputError, match="no joint 'crnk'"):
        sims.step(0.01, {"crnk": 1.0})
    with pytest.raises(pc.InputError, match=r"needs the shape \(2,\) or \(\), got \(3,\)"):
        sims.step(0.01, {"crank": np.zeros(3)})
    with pytest.raises(pc.InputError, match="not finite"):
        sims.step(0.01, np.full((2, 3), np.nan))
    with pytest.raises(pc.InputError, match="dt must be a positive"):
        sims.step(0.0)
    with pytest.raises(pc.InputError, match="which must be a mask of 2 booleans, or indices from 0 to 1"):
        sims.reset([2])
    with pytest.raises(pc.InputError, match="no parameter 'mass:crnk'"):
        sims.set_parameters({"mass:crnk": 1.0})


def test_the_environments_of_the_example_are_those_of_one_crank():
    gymnasium = pytest.importorskip("gymnasium")
    path = Path(__file__).parents[1] / "examples" / "23_gymnasium.py"
    example = runpy.run_path(str(path))
    cranks, n = example["Cranks"](3), 3
    assert isinstance(cranks, gymnasium.vector.VectorEnv)
    cranks.reset(seed=3)
    singles = [example["Crank"]() for _ in range(n)]
    for single, target in zip(singles, cranks.targets, strict=True):
        single.reset(seed=0)
        single.target = target
    rng = np.random.default_rng(0)
    for k in range(50):
        actions = rng.uniform(-1.0, 1.0, (n, 1))
        found, rewards, _, ended, _ = cranks.step(actions)
        for i, single in enumerate(singles):
            expected, reward, *_ = single.step(actions[i])
            np.testing.assert_allclose(found[i], expected, atol=1e-12)
            assert rewards[i] == pytest.approx(reward, abs=1e-12)
        assert ended.all() == (k == 49)
    cranks.step(np.zeros((n, 1)))
    np.testing.assert_allclose(cranks.sims.state.t, 0.02)


def test_actuators_may_have_the_names_of_joints():
    mech = pc.load("crank_rocker").add_forces(pc.Actuator("crank", "crank"))
    sims, sim = pc.Simulations(mech, 2), pc.Simulation(mech)
    for _ in range(3):
        states = sims.step(0.01, {"crank": np.array([0.5, 0.2])})
        state = sim.step(0.01, {"crank": 0.5})
    assert not sims.failed.any(), sims.messages
    assert np.array_equal(states.q[0], state.q)


def test_a_change_of_parameters_keeps_the_torques_that_are_held():
    sims, sim = pc.Simulations(pc.load("crank_rocker"), 1), pc.Simulation(pc.load("crank_rocker"))
    for torque in (1.0, 2.0, 3.0):
        sims.step(0.01, {"crank": torque})
        sim.step(0.01, {"crank": torque})
    sims.set_parameters({"mass:coupler": 1.5})
    sim.set_parameters({"mass:coupler": 1.5})
    assert np.array_equal(sims.lam[0], sim.lam)
    assert np.array_equal(sims.step(0.01).q[0], sim.step(0.01).q)
    with pytest.raises(pc.InputError, match="needs a mapping"):
        sims.set_parameters(["mass:coupler"])


IN_PLACE = {name: value for name, value in CHANGES.items() if name not in ("gravity[2]", "length:left_distal")}


@pytest.mark.parametrize("threads", [1, 2])
def test_parameters_of_a_run_give_the_same_numbers_whatever_the_other_runs_are(threads):
    mech = with_springs()
    start = pc.assemble(mech)
    shares = np.array([1.0, 0.2, 0.6, 0.0, 0.9])
    anchors = {name: shares * value for name, value in IN_PLACE.items() if name.startswith(("tip", "anchor"))}
    values = {name: (0.5 + shares) * value for name, value in IN_PLACE.items()} | anchors
    together = pc.Simulations(mech, 5, start.q, threads=threads)
    backwards = pc.Simulations(mech, 5, start.q, threads=1)
    together.step(0.01)  # a run of other parameters before does not matter
    together.reset(None, start.q)
    together.set_parameters(values)
    backwards.set_parameters({name: numbers[::-1] for name, numbers in values.items()})
    for _ in range(5):
        states, others = together.step(0.02, {"left_crank": 0.3}), backwards.step(0.02, {"left_crank": 0.3})
    np.testing.assert_array_equal(states.q, others.q[::-1])
    np.testing.assert_array_equal(states.v, others.v[::-1])
    np.testing.assert_array_equal(together.lam, backwards.lam[::-1])
    for i in range(5):
        sim = pc.Simulation(mech, start.q)
        sim.set_parameters({name: float(numbers[i]) for name, numbers in values.items()})
        for _ in range(5):
            state = sim.step(0.02, {"left_crank": 0.3})
        np.testing.assert_array_equal(states.q[i], state.q)
        np.testing.assert_array_equal(together.lam[i], sim.lam)
    assert len({row.tobytes() for row in states.q}) == 5


def test_a_change_of_parameters_of_some_runs_back_and_forth_leaves_nothing():
    mech = with_springs()
    sims, fresh = pc.Simulations(mech, 2), pc.Simulations(mech, 2)
    start = sims.state
    sims.set_parameters(IN_PLACE, [0])
    sims.step(0.01)
    sims.set_parameters({name: parameter(mech, name).value for name in IN_PLACE}, [0])
    sims.reset(None, start.q, start.v)
    for _ in range(3):
        states, expected = sims.step(0.01), fresh.step(0.01)
    np.testing.assert_array_equal(states.q, expected.q)


def test_runs_with_other_numbers_of_stages_share_a_stepper():
    mech = pc.load("crank_rocker")
    speeds = np.array([0.0, 3.0, 20.0, 80.0])
    starts = [pc.assemble(mech, v0={"crank": speed}) for speed in speeds]
    q, v = np.array([each.q for each in starts]), np.array([each.v for each in starts])
    options = {"rtol": 1e-9, "atol": 1e-11}
    sims = pc.Simulations(mech, 4, q, v, threads=1, **options)
    for _ in range(25):
        states = sims.step(0.02)
    orders = set()
    for i in range(4):
        sim = pc.Simulation(mech, **options)
        sim.reset(q[i], v[i])
        for _ in range(25):
            state = sim.step(0.02)
        np.testing.assert_array_equal(states.q[i], state.q)
        orders.update(sim.solution().order.tolist())
    assert orders == {9, 13}


@pytest.mark.parametrize("name", ["crank_rocker", "delta_robot", "stewart_platform"])
def test_a_run_that_begins_anew_remembers_nothing(name):
    mech = pc.load(name)
    start = pc.Simulation(mech).state
    used, fresh = pc.Simulation(mech), pc.Simulation(mech)
    for _ in range(20):
        used.step(0.02)
    used.reset(start.q, start.v)
    fresh.reset(start.q, start.v)
    for _ in range(3):
        state, expected = used.step(0.002), fresh.step(0.002)
    np.testing.assert_array_equal(state.q, expected.q)
    np.testing.assert_array_equal(state.v, expected.v)


def test_runs_whose_parameters_cannot_be_changed_in_place_go_on_alone():
    mech = pc.load("crank_rocker")
    sims = pc.Simulations(mech, 3, v0={"crank": 5.0}, threads=1)
    sims.step(0.01, {"crank": 0.4})
    before = sims.state
    sims.set_parameters({"gravity[2]": -1.0}, [1])
    sims.step(0.01)
    states = sims.step(0.01)
    own = mech.with_parameters({"gravity[2]": -1.0})
    sim = pc.Simulation(own, before.q[1], before.v[1], t0=float(before.t[1]))
    sim.step(0.01, {"crank": 0.4})
    np.testing.assert_allclose(states.q[1], sim.step(0.01).q, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(states.q[0], states.q[2])
    assert not np.array_equal(states.q[0], states.q[1])
    assert sims.mechanism.model.gravity.linear[2] == mech.model.gravity.linear[2]


def test_runs_whose_loops_cannot_be_closed_are_not_changed():
    sims = pc.Simulations(with_springs(), 2)
    before = sims.state
    with pytest.raises(pc.AssemblyError):
        sims.set_parameters({"tip.xyz2[0]": 5.0})
    np.testing.assert_array_equal(sims.state.q, before.q)
    np.testing.assert_array_equal(sims.step(0.01).q, pc.Simulations(with_springs(), 2).step(0.01).q)
