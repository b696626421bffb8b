"""Kept rows do not depend on the size of a mechanism, and a loop that opens is never a success."""

import numpy as np
import pinocchio as pin
import pytest
from scenes import n_four_bar

import pinconsist as pc
from pinconsist.mechanism.rank import independent_rows, row_scales


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e3])
def test_the_choice_of_rows_is_the_same_at_every_size(size):
    rng = np.random.default_rng(3)
    J = rng.standard_normal((5, 3))
    turns = np.array([False, False, False, True, True])
    scaled = np.where(turns[:, None], J, size * J)
    np.testing.assert_array_equal(independent_rows(scaled, turns), independent_rows(J, turns))


def test_rounding_is_not_scaled_up():
    J = np.diag([2.0, 1e-16, 3.0])
    assert independent_rows(J, np.array([False, False, False])).tolist() == [0, 2]
    assert independent_rows(np.diag([1e-16, 1.0, 0.5]), np.array([False, True, True])).tolist() == [1, 2]
    np.testing.assert_array_equal(row_scales(np.zeros((2, 2)), np.array([False, True])), [1.0, 1.0])


def test_an_opened_loop_is_seen_beside_a_drive(monkeypatch):
    """A parallelogram started in line (and the check of the start switched off), with an unrelated driven joint."""
    plain = n_four_bar(1)
    model = plain.model.copy()
    model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "fan")
    mech = pc.Mechanism(model, [*plain.loops, pc.Drive("fan", "fan", lambda t: 0.01 * t)])
    monkeypatch.setattr("pinconsist.mechanism.system.NEARBY", 0.0)
    sol = pc.simulate(mech, (0.0, 1.0), np.array([-np.pi / 2, np.pi / 2, -np.pi / 2, 0.0]))
    assert not sol.success and "gape by" in sol.message and "'B1'" in sol.message


def test_a_reference_whose_loops_open_is_none(monkeypatch):
    monkeypatch.setattr("pinconsist.mechanism.system.NEARBY", 0.0)
    in_line = np.array([-np.pi / 2, np.pi / 2, -np.pi / 2])
    with pytest.raises(pc.PinconsistError, match="no reference: the loops gape"):
        pc.reference_solution(n_four_bar(1), 0.0, in_line, np.zeros(3), [0.5, 1.0], rtol=1e-8)
