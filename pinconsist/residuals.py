"""What a run is measured by: its rows in the constraints and in the differential equation."""

from __future__ import annotations

import numpy as np

from ._core.compiled_system import blank_system
from .dae.index1 import solve_acceleration
from .dae.norms import largest
from .mechanism.rows import Workspace
from .mechanism.system import MechanismSystem


def residuals(system, t, q, v, lam, workspace):
    """Φ, the hidden residual and Jᵀλ (G λ) of all rows."""
    if workspace is not None and (twin := workspace.compiled()) is not None:
        system.hand_over_all_rows(twin)
        return twin.residuals(t, q, v, lam)
    rows = []
    for state in zip(t, q, v, lam, strict=True):
        time, p, rate, multipliers = state
        if workspace is None:
            _, gap, G, _ = system.evaluate(time, p, rate, np.zeros(system.nv))
            hidden = system.constraint(time, p, system.rate(time, p, rate))[1]
        else:
            gap, J = system.loop_rows(p, time)
            G, hidden = J.T, J @ rate + system.rows.time_rate(time, p)
        rows.append((gap, hidden, G @ multipliers))
    return tuple(np.array(column) for column in zip(*rows, strict=True))


def loop_forces(system, t, q, v, lam):
    """Jᵀλ (G λ) of rows."""
    workspace = Workspace(system.model, blank_system, system.data) if isinstance(system, MechanismSystem) else None
    return residuals(system, t, q, v, lam, workspace)[2]


def exact_forces(system, t, q, v, workspace):
    """Jᵀλ (G λ) of the differential equation, and the largest of the other forces that act with it."""
    done, forces, acting = 0, [], 0.0
    if workspace is not None and (twin := workspace.compiled()) is not None:
        system.hand_over(twin)
        exact, acting, failed = twin.exact_forces(t, q, v)
        if failed < 0:
            return exact, acting
        done, forces = failed, list(exact[:failed])  # the equations say below why they have no solution there
    for time, p, rate in zip(t[done:], q[done:], v[done:], strict=True):
        lam = solve_acceleration(system, time, p, rate)[1]
        f, _, G, _ = system.evaluate(time, p, rate, np.zeros(system.nv))
        weights = f if workspace is None else system.weights(p, rate)
        acting = max(acting, largest(f), largest(weights))
        forces.append(G @ lam)
    return np.array(forces).reshape(len(t), system.nv), acting
