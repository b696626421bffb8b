"""Simulation: a run as an object."""

import numpy as np
import pytest

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
    [{}, {"backend": "python"}, {"method": "BDF"}, {"step": 1e-3, "max_order": 5}, {"events": lambda *y: 1.0}],
)
def test_steps_are_those_of_a_sampled_run(mech, options):
    count = 3 if "backend" in options else 10
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


def test_a_copy_goes_on_alike_and_leaves_the_first_alone(mech):
    sim = stepped(pc.Simulation(mech), 5)
    before, other = sim.state, sim.copy()
    there = other.step(DT)
    assert sim.state is not there
    np.testing.assert_array_equal(sim.state.q, before.q)
    np.testing.assert_allclose(there.q, sim.step(DT).q, atol=1e-10)
    assert other.solution().t[0] == before.t


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
    for arguments in ((0.0,), (-1.0,), (np.nan,), (DT, {"crnk": 1.0}), (DT, [1.0]), (DT, {"crank": np.nan})):
        with pytest.raises(pc.InputError):
            sim.step(*arguments)
    with pytest.raises(pc.InputError, match="method"):
        pc.Simulation(mech, method="RK4")
    sim.step(DT, [1.0, 0.0, 0.0])
