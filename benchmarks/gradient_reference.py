"""Derivatives of reference runs: differences of DOP853 on the index-1 equations at 1e-13."""

import numpy as np
from scipy.integrate import solve_ivp

from pinconsist import PinconsistError
from pinconsist.engine.charts import chart_point
from pinconsist.engine.index1 import Index1
from pinconsist.gradients.prepare import named_start
from pinconsist.mechanism.assembly import assembled
from pinconsist.mechanism.closing import LoopSolver
from pinconsist.mechanism.system import MechanismSystem
from pinconsist.paper.index1 import right_hand_side

FOUR = {-2: 1 / 12, -1: -2 / 3, 1: 2 / 3, 2: -1 / 12}  # of fourth order
SIX = {-3: -1 / 60, -2: 3 / 20, -1: -3 / 4, 1: 3 / 4, 2: -3 / 20, 3: 1 / 60}  # of sixth: for longer steps
PIECES = 8  # of an interval between rows, after which constraint rows may be chosen anew


def reference(mech, q0, v0, times):
    """q, v and λ of all rows at `times`, (n, nq), (n, nv), (n, nc)."""
    solver = LoopSolver(mech, times[0])
    start = assembled(solver, q0, v0)
    system = MechanismSystem(mech, start.q, times[0], solver)
    index1, t, p, v, rows = Index1(system), times[0], start.q, start.v, []
    rows.append((p, v, system.full_multipliers(p, index1.state(t, p, v)[3])))
    for end in times[1:]:
        for stop in np.linspace(t, end, 2 if system.dropped_are_zero else PIECES + 1)[1:]:
            t, p, v, lam = _followed(index1, t, p, v, stop)
            full = system.full_multipliers(p, lam)
            if (fresh := system.reselected(p)) is not None:
                system, index1 = fresh, Index1(fresh)
        rows.append((p, v, full))
    return system, tuple(map(np.array, zip(*rows, strict=True)))


def _followed(index1, t, p, v, end):
    """(t, p, v, λ) at `end`, from a state on the constraints; no joint may turn by more than half a turn."""
    system = index1.system
    y0 = np.concatenate((p if system.vector_like else np.zeros(system.nx), v))
    f = right_hand_side(system, p, index1.acceleration)
    run = solve_ivp(f, (t, end), y0, "DOP853", rtol=1e-13, atol=1e-14)
    if not run.success:
        raise PinconsistError(run.message)
    y = run.y[:, -1]
    return index1.state(end, chart_point(system, p, y[: system.nx]), y[system.nx :])


def differences(mech, names, times, q0=None, v0=None, relative=3e-4, weights=FOUR):
    """dq, dv and dλ by parameters of these names, at `times`; `relative` are steps over values, of all or of each."""
    build, _, theta, q0, v0 = named_start(mech, names, q0, v0)

    def run(values):
        starts = (start(values) if callable(start) else start for start in (q0, v0))
        return reference(build(values), *starts, times)

    system, (middle, _, _) = run(theta)

    def rows(values):
        q, v, lam = run(values)[1]
        return np.array([system.difference(*pair) for pair in zip(middle, q, strict=True)]), v, lam

    return slopes(rows, theta, relative * np.maximum(np.abs(theta), 0.1), weights)


def slopes(function, theta, steps, weights=FOUR):
    """Derivatives of the arrays that a function of theta returns, by differences; the parameter is the last index."""
    found = []
    for unit in np.eye(len(theta)) * steps:
        parts = [[weight / unit.max() * part for part in function(theta + m * unit)] for m, weight in weights.items()]
        found.append([sum(each) for each in zip(*parts, strict=True)])
    return [np.stack(part, axis=-1) for part in zip(*found, strict=True)]


def worst(found, exact):
    """The largest error of dq, dv and dλ over their largest value, of the worst parameter, each."""
    return [
        float(np.max(np.abs(one - other).max(axis=(0, 1)) / np.abs(other).max(axis=(0, 1))))
        for one, other in zip(found, exact, strict=True)
    ]
