"""What the start of a run evaluates, and what it takes over from earlier ones."""

import subprocess
import sys
import warnings

import numpy as np
import pytest

import pinconsist as pc
from pinconsist.mechanism import rows as rows_module

FIRST_RUN = """
import sys
import pinconsist as pc
sol = pc.simulate(pc.load("four_bar"), (0.0, 0.1))
assert sol.success
print([name for name in ("scipy", "importlib.metadata", "zipfile") if name in sys.modules])
"""


def unknown(name):
    """A mechanism of which no start is known."""
    mech = pc.load(name)
    return mech.with_loops(*mech.loops)


def test_a_known_start_is_that_of_a_mechanism_of_which_nothing_is_known():
    mech, fresh = pc.load("delta_robot"), unknown("delta_robot")
    q, v = pc.assemble(mech).q, np.linspace(-1.0, 1.0, mech.nv)
    first, second, other = (pc.assemble(each, q, v) for each in (mech, mech, fresh))
    for one in first, second:
        np.testing.assert_array_equal(one.q, other.q)
        np.testing.assert_array_equal(one.v, other.v)
        assert one.gaps == other.gaps and one.rank == other.rank and one.redundant == other.redundant
    first.q[:] = 0.0  # the arrays are the caller's
    np.testing.assert_array_equal(pc.assemble(mech, q, v).q, second.q)


def test_the_velocity_of_a_start_is_projected_with_the_masses_of_its_mechanism():
    mech = pc.load("crank_rocker")
    q, v = pc.assemble(mech).q, np.array([1.0, 2.0, 3.0])
    pc.assemble(mech, q, v)
    heavy = mech.with_parameters({"mass:coupler": 50.0})
    expected = pc.assemble(heavy.with_loops(*heavy.loops), q, v).v
    np.testing.assert_allclose(pc.assemble(heavy, q, v).v, expected, rtol=1e-12)
    assert np.abs(pc.assemble(mech, q, v).v - expected).max() > 1e-3


def test_a_start_with_a_warning_warns_again():
    mech = pc.load("four_bar")
    for _ in range(2):
        with pytest.warns(UserWarning, match="do not close with"):
            pc.assemble(mech, {"crank": 0.3, "rocker": 2.0})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pc.assemble(mech)


def test_mechanisms_with_other_forces_share_the_tree():
    mech = pc.load("four_bar")
    other = mech.add_forces(pc.JointDamping({"crank": 1.0}))
    assert other.model is mech.model
    assert mech.with_gravity((0.0, 0.0, -1.0)).model is not mech.model


def test_a_known_start_needs_no_workspace_of_pinocchio(monkeypatch):
    mech = pc.load("stewart_platform")
    first = pc.simulate(mech, (0.0, 0.01))

    def forbidden(model):
        raise AssertionError("Pinocchio's data are O(nv³)")

    monkeypatch.setattr(rows_module, "workspace", forbidden)
    again = pc.simulate(mech, (0.0, 0.01))
    np.testing.assert_array_equal(again.q, first.q)


def test_a_first_run_imports_nothing_that_it_does_not_use():
    done = subprocess.run([sys.executable, "-c", FIRST_RUN], capture_output=True, text=True, timeout=120)
    assert done.stdout.strip() == "[]", done.stderr
    assert "leaked" not in done.stderr


def test_large_matrices_are_factorised_by_lapack_when_it_was_not_there_before():
    code = "import pinconsist as pc; print(pc.simulate(pc.load('chain_40'), (0.0, 0.1), method='BDF').success)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.stdout.strip() == "True", done.stderr
