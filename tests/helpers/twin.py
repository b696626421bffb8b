"""The terms of the equations in C++ compared with Pinocchio's, and their derivatives with differences."""

from contextlib import contextmanager
from dataclasses import replace
from unittest.mock import patch

import numpy as np

from helpers.reference import ByPinocchio
from pinconsist import engine
from pinconsist.engine.index1 import Index1
from pinconsist.engine.systems import compiled_system
from pinconsist.mechanism.lie import integrate
from pinconsist.mechanism.rank import null_space
from pinconsist.mechanism.system import MechanismSystem
from pinconsist.paper.index1 import acceleration, projected
from pinconsist.run import steppers
from pinconsist.run.propagator import Propagator

LOOSE = {"rtol": 5e-3, "atol": 5e-5}  # errors far above rounding, which step-size control amplifies
SMALL = 1e-4  # step of differences of fourth order
DIFFERENCES = {-2: 1 / 12, -1: -2 / 3, 1: 2 / 3, 2: -1 / 12}


def with_switches(**given):
    """Runs have these switches of the compiled method within the block."""

    def stepper_for(system, method):
        switches = replace(method.switches, **given)
        return steppers.stepper_for(system, replace(method, switches=switches))

    return patch("pinconsist.run.simulation.stepper_for", stepper_for)


@contextmanager
def with_constants(**values):
    """Runs have these constants of the method within the block."""
    module = engine.required()
    before = {name: module.constant(name) for name in values}
    try:
        for name, value in values.items():
            module.set_constant(name, value)
        yield
    finally:
        for name, value in before.items():
            module.set_constant(name, value)


@contextmanager
def instruction_set(name):
    """Stages are evaluated by these instructions within the block."""
    engine.required().use_instruction_set(name)
    try:
        yield
    finally:
        engine.required().use_instruction_set("")


def twin_of(system):
    return compiled_system(system)


def assert_same(a, b, size=1e-12):
    """Assert equality up to rounding of the largest number."""
    a, b = np.asarray(a), np.asarray(b)
    np.testing.assert_allclose(a, b, atol=size * (1.0 + np.abs(a).max(initial=0.0)), rtol=0)


def compare_terms(mech, q, t=0.3, seed=0):
    """Compare residuals, matrix, accelerations and projections of both, with all kept rows."""
    system, rng = ByPinocchio(mech, q, t), np.random.default_rng(seed)
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
    compare_at_once(twin, mech.model, t, q)
    projection = engine.required().Projection(twin)
    start_state = projected(system, t, q, v)
    assert projection.project(t, q, v)[2] == ""
    for ours, theirs in zip((start_state.p, start_state.v), projection.project(t, q, v), strict=False):
        assert_same(ours, theirs, 1e-10)
    for ours, theirs in zip(acceleration(system, t, q, v), projection.acceleration(t, q, v)[:2], strict=True):
        assert_same(ours, theirs, 1e-10)
    compare_row_gradients(system, twin, t, q, v)
    compare_multipliers(system, twin, t, start_state.p, start_state.v)


def compare_at_once(twin, model, t, q, number=5):
    """Compare f, Φ, J, M, D and K of several states, by each instruction set, with those of one state after another.

    Returns whether the mechanism is one that is evaluated so.
    """
    rng = np.random.default_rng(9)
    times = t + 0.1 * np.arange(number)
    states = [(integrate(model, q, 0.1 * rng.normal(size=model.nv)), *rng.normal(size=(2, model.nv))) for _ in times]
    p, v, a = (np.array(part) for part in zip(*states, strict=True))
    for name in engine.required().instruction_sets():
        with instruction_set(name):
            found = twin.evaluate_at_once(times, p, v, a)
        if found is None:
            return False
        for i, (f, phi, J, *matrices) in enumerate(zip(*found, strict=True)):
            at = times[i], p[i], v[i], a[i]
            for ours, theirs in zip(twin.evaluate(*at), (f, phi, J.reshape(twin.nc, len(f))), strict=False):
                assert_same(ours, theirs)
            M, D, K = (matrix.reshape(len(f), -1) for matrix in matrices)
            for c in (0.0, 1.0, -1.0):
                assert_same(twin.linearize(*at, c), M + c * (D + c * K))
    return True


class Still(list):
    """Parameters that do not change the equations."""

    beside, known = {}, ()


def compare_multipliers(system, twin, t, p, v):
    """Compare the derivatives of the multipliers at a state, along the constraints, with differences."""
    J, n = np.array(system.evaluate(t, p, v, v)[2]).T, system.nv
    H, Z = row_gradients(system, t, p, v, np.zeros(system.nc))[1], null_space(J)
    ways = np.block([[Z, np.zeros_like(Z)], [-np.linalg.pinv(J) @ H @ Z, Z]])
    propagator = Propagator(Index1(system, twin), Still([[]] * ways.shape[1]))
    lam, found = propagator.multipliers(np.array([t]), p[None], v[None], np.ascontiguousarray(ways.T)[None])
    assert_same(acceleration(system, t, p, v)[1], lam[0], 1e-10)

    def beside(way, size):
        return acceleration(system, t, system.integrate(p, size * way[:n]), v + size * way[n:])[1]

    for way, own in zip(ways.T, found[0], strict=True):
        exact = sum(weight * beside(way, i * SMALL) for i, weight in DIFFERENCES.items()) / SMALL
        assert_same(exact, own, 1e-6)


def row_gradients(system, t, p, v, lam):
    """∂(G λ)/∂ξ and ∂ρ/∂ξ by differences."""
    F, H = np.zeros((system.nv, system.nx)), np.zeros((system.nc, system.nx))
    for column, unit in enumerate(np.eye(system.nx)):
        for i, weight in DIFFERENCES.items():
            there = system.integrate(p, i * SMALL * unit)
            _, _, G, rho = system.evaluate(t, there, v, np.zeros(system.nv))
            F[:, column] += weight / SMALL * (np.array(G) @ lam)
            H[:, column] += weight / SMALL * np.array(rho)
    return F, H


def compare_row_gradients(system, twin, t, q, v):
    """Compare the derivatives of constraint forces and of the hidden constraint with differences."""
    lam = np.cos(np.arange(system.nc))
    known = twin.row_gradients(t, q, v, lam)
    if known is None:
        return
    for ours, theirs in zip(row_gradients(system, t, q, v, lam), known, strict=True):
        assert_same(ours, theirs, 1e-8)
