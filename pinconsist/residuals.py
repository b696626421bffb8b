"""Residuals of the rows of a run in the constraints and in the differential equation."""

import os

import numpy as np

from ._core import load
from ._core.compiled_system import CompiledIndex1, blank_system, compiled_system
from .dae.index1 import Index1, solve_acceleration
from .dae.norms import largest
from .mechanism.energy import compiled_forces
from .mechanism.system import MechanismSystem

A_THREAD = 200  # rows that justify one more thread, and its pin.Data, which has several arrays of nv³ numbers
THREADS = 4  # at most


def measured(system, states, workspace):
    """Φ, the hidden residual, Jᵀλ (G λ) and that of the differential equation at rows `states`, (t, q, v, λ).

    After these come the energies as :func:`~pinconsist.mechanism.energy.measure` returns them, or None, and the largest
    of the other acting forces.
    """
    if workspace is not None and (found := _compiled(system, states, workspace)) is not None:
        return found
    rows, acting = [], 0.0  # also used if the equations have no solution: the error says why
    for t, p, v, lam in zip(*states, strict=True):
        exact = solve_acceleration(system, t, p, v)[1]
        f, gap, G, _ = system.evaluate(t, p, v, np.zeros(system.nv))
        hidden, weights, exact = system.constraint(t, p, system.rate(t, p, v))[1], f, G @ exact
        if workspace is not None:
            gap, J = system.loop_rows(p, t)
            hidden, weights, G = J @ v + system.rows.time_rate(t, p), system.weights(p, v), J.T
        rows.append((gap, hidden, G @ lam, exact))
        acting = max(acting, largest(f), largest(weights))
    return *(np.array(column) for column in zip(*rows, strict=True)), None, acting


def _compiled(system, states, workspace):
    """What :func:`measured` returns, computed in C++; None if that is not built, or the equations have no solution.

    The rows are divided between threads, each with its own system, if no Python function is called.
    """
    if (twin := workspace.compiled()) is None:
        return None
    rows, systems = system.all_rows(), []

    def add(twin):
        rows.hand_over(twin)
        system.hand_over_forces(twin)
        forces = compiled_forces(system.forces, workspace)
        systems.append((twin, list(forces.values())))
        return list(forces)

    labels = add(twin)
    if not twin.calls_python:
        for _ in range(min(THREADS, _processors(), len(states[0]) // max(A_THREAD, system.nv**2 // 10)) - 1):
            add(blank_system(system.model, system.model.createData()))
    if (found := load()[0].certified(systems, system.kept, *states)) is None:
        return None
    *residuals, energies, acting = found
    return *residuals, (labels, energies), acting


def _processors() -> int:
    """Number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def accelerations(mechanism, t, q, v):
    """Accelerations of the equations of motion at several states, shape (n, nv)."""
    found, index1 = np.empty(v.shape), None
    for row, *state in zip(found, t, q, v, strict=True):
        other = MechanismSystem(mechanism, state[1], state[0]) if index1 is None else index1.system.reselected(state[1])
        if other is not None:
            compiled = load()[0] is not None
            index1 = CompiledIndex1(other, compiled_system(other)) if compiled else Index1(other)
        row[:] = index1.acceleration(*state)[0]
    return found


def loop_forces(system, t, q, v, lam):
    """Jᵀλ (G λ) at each row."""
    states = t, q, v, lam
    if not isinstance(system, MechanismSystem):
        return np.array([system.evaluate(t, p, v, 0.0 * v)[2] @ lam for t, p, v, lam in zip(*states, strict=True)])
    if (twin := blank_system(system.model, system.data)) is not None:
        system.all_rows().hand_over(twin)
        return twin.residuals(*states)[2]
    return np.array([system.loop_rows(p, t)[1].T @ lam for t, p, _, lam in zip(*states, strict=True)])
