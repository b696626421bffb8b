"""Other numbers by names, without building what does not depend on them: equal to a mechanism built anew."""

import pickle
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from helpers.changed_numbers import CHANGES, scene

import pinconsist as pc
from pinconsist.mechanism.closing import LoopSolver
from pinconsist.mechanism.system import MechanismSystem


def anew(mech):
    """The same numbers in a mechanism that shares nothing with another one."""
    model = pin.Model(pickle.loads(pickle.dumps(mech.model)))
    return replace(mech, model=model, loops=tuple(mech.loops), forces=tuple(mech.forces))


def motion(mech):
    """Φ, J and accelerations at a state that is not closed."""
    q, v = np.array([-2.1, 0.7, -1.0, -0.4]), np.array([0.3, -1.0, 0.8, 0.2])
    solver = LoopSolver(mech)
    system = MechanismSystem(mech, q, 0.0, solver)
    phi, J = solver.rows(q)
    force = system.weights(q, v) - system.torque(0.0, q, v)
    return np.concatenate((phi, J.ravel(), force, system.mass_matrix(q).ravel()))


@pytest.mark.parametrize("name", CHANGES)
def test_one_number(name):
    mech = scene()
    motion(mech)  # builds what may be shared
    other = mech.with_parameters({name: CHANGES[name]})
    np.testing.assert_array_equal(motion(other), motion(anew(other)))
    assert np.abs(motion(other) - motion(mech)).max() > 1e-6
    np.testing.assert_array_equal(motion(mech), motion(scene()))


def test_all_of_them_in_turn_and_at_once():
    mech = scene()
    motion(mech)
    at_once, one_by_one = mech.with_parameters(CHANGES), mech
    for name, value in CHANGES.items():
        one_by_one = one_by_one.with_parameters({name: value})
    np.testing.assert_array_equal(motion(at_once), motion(one_by_one))
    np.testing.assert_array_equal(motion(at_once), motion(anew(at_once)))
    np.testing.assert_array_equal(motion(pickle.loads(pickle.dumps(at_once))), motion(at_once))


def test_impossible_numbers_are_refused():
    mech = scene()
    for name, value in {
        "mass:left_distal": -1.0,
        "damping:left_crank": -0.1,
        "stiffness:spring right_crank": np.nan,
    }.items():
        with pytest.raises(pc.InputError):
            mech.with_parameters({name: value})


def test_damping_that_the_model_did_not_have():
    """It is one more force; names stay those of the records."""
    mech = pc.load("four_bar")
    damped = mech.with_parameters({"damping:crank": 0.2})
    assert damped.model.damping[0] == 0.2
    again = damped.with_parameters({"damping:crank": 0.0})
    assert pc.simulate(again, (0.0, 0.05)).q[-1] == pytest.approx(pc.simulate(mech, (0.0, 0.05)).q[-1], abs=1e-12)
