"""Parameters that are changed in place during a run: the same steps as those of a simulation built anew."""

import numpy as np
import pytest
from helpers.changed_numbers import CHANGES, scene

import pinconsist as pc

TIGHT = {"rtol": 1e-10, "atol": 1e-12}  # two runs then differ by less than what is compared
IN_PLACE = [name for name in CHANGES if not name.startswith(("gravity", "length:left_distal"))]


def steps(sim, n=5):
    for _ in range(n):
        sim.step(2e-3, control={"left_crank": 0.2})
    return sim.state


def moved(mech):
    sim = pc.Simulation(mech, v0={"left_crank": 1.0}, **TIGHT)
    return sim, steps(sim)


def compared(sim, values, state):
    """The next steps are those of a new simulation from the state that `set_parameters` returned."""
    begun = sim.set_parameters(values)
    assert begun.t == state.t
    other = pc.Simulation(sim.mechanism.with_forces(*sim.mechanism.forces[:-1]), begun.q, begun.v, t0=begun.t, **TIGHT)
    mine, theirs = steps(sim), steps(other)
    np.testing.assert_allclose(mine.q, theirs.q, rtol=0, atol=1e-9)
    np.testing.assert_allclose(mine.v, theirs.v, rtol=0, atol=1e-8)
    np.testing.assert_allclose(sim.lam, other.lam, rtol=0, atol=1e-7)
    return other


@pytest.mark.parametrize("name", CHANGES)
def test_one_number(name):
    sim, state = moved(scene())
    compared(sim, {name: CHANGES[name]}, state)
    assert (sim._numbers is not None) == (name in IN_PLACE)


def test_many_numbers_and_back():
    sim, state = moved(scene())
    compared(sim, {name: CHANGES[name] for name in IN_PLACE}, state)
    before = {"mass:left_distal": 0.31, "stiffness:spring left_tip": 40.0, "tip.xyz2[0]": 0.0}
    compared(sim, before, sim.state)


def test_what_is_read_afterwards_has_the_numbers():
    """Solutions, linearisations, copies and new starts do not see those of before."""
    sim, state = moved(scene())
    original = sim.mechanism
    other = compared(sim, {"mass:left_distal": 0.7, "stiffness:spring left_tip": 60.0}, state)
    sol = sim.solution()
    assert sol.check().ok
    assert sol.mechanism.model.inertias[2].mass == 0.7
    sim.set_parameters({"mass:left_distal": 0.9})  # does not change what was returned
    assert sol.check().ok and sol.mechanism.model.inertias[2].mass == 0.7
    sim.set_parameters({"mass:left_distal": 0.7})
    sim.reset(*other.state[1:], t0=other.state.t)
    steps(sim), steps(other)
    for mine, theirs in zip(sim.linearized(), other.linearized(), strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=0, atol=1e-8 * np.abs(theirs).max())
    np.testing.assert_allclose(steps(sim.copy()).q, steps(other.copy()).q, rtol=0, atol=1e-9)
    sim.reset({"left_crank": -2.1})
    other.reset({"left_crank": -2.1})
    np.testing.assert_allclose(steps(sim).q, steps(other).q, rtol=0, atol=1e-9)
    assert original.model.inertias[2].mass != 0.7
    assert pc.simulate(original, (0.0, 0.02)).check().ok


def test_controls_are_held_on():
    sim = pc.Simulation(scene())
    sim.step(1e-3, control={"left_crank": 2.0})
    sim.set_parameters({"mass:left_distal": 0.31})
    free = sim.copy()
    free.step(0.05, control={"left_crank": 0.0})
    assert np.abs(sim.step(0.05).q - free.state.q).max() > 1e-3


def test_impossible_numbers_change_nothing():
    sim, _ = moved(scene())
    sim.set_parameters({"mass:left_distal": 0.5})
    for wrong in ({"mass:left_distal": -1.0}, {"stiffness:spring left_tip": np.inf}, {"damping:left_crank": -1.0}):
        with pytest.raises(pc.InputError):
            sim.set_parameters({"com:right_distal[0]": 0.3, **wrong})
    with pytest.raises(pc.InputError, match="no parameter 'mass:left_dista'; similar"):
        sim.set_parameters({"mass:left_dista": 1.0})
    with pytest.raises(pc.AssemblyError):
        sim.set_parameters({"tip.xyz2[0]": 5.0})
    compared(sim, {"mass:left_distal": 0.5}, sim.state)


def test_anchors_move_the_state_onto_the_loops():
    sim, _ = moved(scene())
    state = sim.set_parameters({"tip.xyz2[0]": 0.01, "tip.xyz1[2]": -0.01})
    q, v = state.q, state.v
    solver = pc.Simulation(sim.mechanism, q, v, **TIGHT)
    np.testing.assert_allclose(solver.state.q, q, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ["delta_robot", "stewart_platform"])
def test_other_mechanisms(name):
    mech = pc.load(name)
    joint = mech.joints[-1]
    sim = pc.Simulation(mech, **TIGHT)
    sim.step(0.01)
    begun = sim.set_parameters({f"mass:{joint}": 1.7})
    other = pc.Simulation(mech.with_parameters({f"mass:{joint}": 1.7}), begun.q, begun.v, t0=begun.t, **TIGHT)
    np.testing.assert_allclose(sim.step(0.01).q, other.step(0.01).q, rtol=0, atol=1e-10)


def test_a_first_change_that_is_refused_leaves_the_run_as_it_was():
    sim, other = pc.Simulation(pc.load("five_bar")), pc.Simulation(pc.load("five_bar"))
    sim.step(0.01)
    other.step(0.01)
    with pytest.raises(pc.InputError, match="mass:nobody"):
        sim.set_parameters({"mass:nobody": 1.0})
    assert np.array_equal(sim.step(0.01).q, other.step(0.01).q)
    assert np.array_equal(sim.solution().t, other.solution().t)


def test_two_names_of_one_number_change_one_number():
    mech = pc.load("five_bar").add_forces(pc.JointDamping({"left_crank": 0.1}))
    sim, other = pc.Simulation(mech), pc.Simulation(mech)
    for name, value in (
        ("damping:left_crank", 0.2),
        ("damping left_crank.left_crank", 0.3),
        ("damping:left_crank", 0.4),
    ):
        sim.set_parameters({name: value})
    other.set_parameters({"damping:left_crank": 0.4})
    np.testing.assert_allclose(sim.step(0.1).v, other.step(0.1).v, rtol=1e-12)
    assert sim.mechanism.forces[0].coefficients == {"left_crank": 0.4}
