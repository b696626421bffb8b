"""The terms of the compiled method compared with those in Python."""

from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest

from pinconsist import _core
from pinconsist._core import compiled
from pinconsist._core.compiled_gradient import CompiledStagePropagator
from pinconsist._core.compiled_system import CompiledIndex1, compiled_system
from pinconsist.dae.index1 import Index1, solve_acceleration
from pinconsist.gradients.linear import row_gradients
from pinconsist.gradients.stage_leg import StagePropagator
from pinconsist.mechanism.rank import null_space
from pinconsist.mechanism.system import MechanismSystem

needs_twin = pytest.mark.skipif(_core.load()[0] is None, reason=_core.load()[1])
needs_both = pytest.mark.parametrize("backend", ["python", pytest.param("compiled", marks=needs_twin)])
LOOSE = {"rtol": 5e-3, "atol": 5e-5}  # errors far above rounding, which step-size control amplifies


def with_switches(**given):
    """Runs have these switches of the compiled method within the block."""

    def stepper_for(system, method, backend):
        switches = replace(method.switches, **given)
        return compiled.stepper_for(system, replace(method, switches=switches), backend)

    return patch("pinconsist.simulation.stepper_for", stepper_for)


def twin_of(system):
    return compiled_system(system)


def assert_same(a, b, size=1e-12):
    """Assert equality up to rounding of the largest number."""
    a, b = np.asarray(a), np.asarray(b)
    np.testing.assert_allclose(a, b, atol=size * (1.0 + np.abs(a).max(initial=0.0)), rtol=0)


def compare_terms(mech, q, t=0.3, seed=0):
    """Compare residuals, matrix, accelerations and projections of both, with all kept rows."""
    system, rng = MechanismSystem(mech, q, t), np.random.default_rng(seed)
    twin = twin_of(MechanismSystem(mech, q, t))
    assert twin.nc == system.nc
    v, a, c = rng.normal(size=system.nv), rng.normal(size=system.nv), 0.07
    f, phi, G, rho = (np.array(part) for part in system.evaluate(t, q, v, a))
    A = np.empty((system.nv, system.nv))
    system.linearize(t, q, v, a, np.zeros(system.nc), c, A)
    for ours, theirs in zip(
        (f, phi, G.T, rho, A), (*twin.evaluate(t, q, v, a), twin.linearize(t, q, v, a, c)), strict=True
    ):
        assert_same(ours, theirs)
    projection = _core.load()[0].Projection(twin)
    start_state = Index1(system).state(t, q, v)
    assert projection.project(t, q, v)[2] == ""
    for ours, theirs in zip(start_state[1:3], projection.project(t, q, v), strict=False):
        assert_same(ours, theirs, 1e-10)
    for ours, theirs in zip(solve_acceleration(system, t, q, v), projection.acceleration(t, q, v)[:2], strict=True):
        assert_same(ours, theirs, 1e-10)
    compare_row_gradients(system, twin, t, q, v)
    compare_multipliers(system, twin, t, *start_state[1:3])


class Still(list):
    """Parameters that do not change the equations."""

    beside, known = {}, ()


def compare_multipliers(system, twin, t, p, v):
    """Compare the multipliers and their derivatives at a state on the constraints, along them."""
    J = np.array(system.evaluate(t, p, v, v)[2]).T
    H, Z = row_gradients(system, t, p, v, np.zeros(system.nc))[1], null_space(J)
    ways = np.block([[Z, np.zeros_like(Z)], [-np.linalg.pinv(J) @ H @ Z, Z]])
    still, state = Still([[]] * ways.shape[1]), (np.array([t]), p[None], v[None])
    both = StagePropagator(system, still), CompiledStagePropagator(CompiledIndex1(system, twin), still)
    (lam, ours), (other, theirs) = (way.multipliers(*state, np.ascontiguousarray(ways.T)[None]) for way in both)
    assert_same(lam, other, 1e-10)
    assert_same(ours, theirs, 1e-7)


def compare_row_gradients(system, twin, t, q, v):
    """Compare the derivatives of constraint forces and of the hidden constraint, unless they are differences."""
    lam = np.cos(np.arange(system.nc))
    known = twin.row_gradients(t, q, v, lam) or row_gradients(system, t, q, v, lam)
    for ours, theirs in zip(row_gradients(system, t, q, v, lam), known, strict=True):
        assert_same(ours, theirs, 3e-9)
