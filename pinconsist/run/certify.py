"""The residuals of a solution, evaluated independently of the integration: what its certificate says."""

from dataclasses import replace
from typing import Any

import numpy as np

from ..engine.norms import largest
from ..mechanism.branches import branch_times
from ..mechanism.custom import Constraint
from ..mechanism.energy import energy_of, event_energies
from ..mechanism.forces.actuators import saturated
from ..mechanism.forces.held import sided
from ..mechanism.names import beyond_limits
from ..mechanism.reactions import States, shared_loads, undetermined
from ..mechanism.rows import Workspace
from ..mechanism.system import MechanismSystem
from .accuracy import OFF, above, accelerations, global_error, measured, work_of
from .certificate import OPEN_LOOP, Certificate
from .contact_results import row_units, too_slow
from .impact_errors import impact_errors

UNCLEAR = 0.1 * OFF  # an energy balance that is off by more may be so because rows are few
ROUNDED = 1e-6  # of the largest multiplier: smaller ones may be the error of the run


def _not_finite(solution) -> str:
    """The first number of the rows that is not finite, with its time; empty if all are."""
    for name in ("q", "v", "lam"):
        rows, columns = np.nonzero(~np.isfinite(getattr(solution, name)))
        if len(rows):
            return f"{name}[{columns[0]}] at t = {solution.t[rows[0]]:.6g} s"
    return ""


def _shared(solution, mechanism, system, workspace) -> dict[str, tuple[str, ...]]:
    """What :attr:`Certificate.not_unique` is."""
    t, q, v, lam = solution.t, solution.q, solution.v, solution.lam
    if system.base.nc == system.rows.nc:
        return {}

    def motion(rows):
        return v[rows], accelerations(mechanism, solution, sided(t)[rows], q[rows], v[rows])

    return shared_loads(States(mechanism, t, q, lam, workspace, motion))


def _sides(system, t, q, v):
    """The times of rows on the sides of jumps to which they belong."""
    return sided(t, len(t) > 1 and system.jumps_at(t[-1], q[-1], v[-1]))


def certify(solution, mechanism=None, finer=None, missing="") -> Certificate:
    """The certificate of a solution; `mechanism` is needed if the solution does not have its system.

    `finer` is a :class:`~pinconsist.run.accuracy.FinerRun`, or None, and `missing` why.
    """
    system: Any = None if solution.system is None else solution.system.base
    if unknown := _not_finite(solution):
        return Certificate(*(np.nan, unknown, np.nan, np.nan, np.nan, None, None), not_finite=unknown)
    if mechanism is not None:
        system = MechanismSystem(mechanism, solution.q[0], solution.t[0])
    elif isinstance(system, MechanismSystem):
        mechanism = system.mechanism
    workspace = None if mechanism is None else Workspace(system.model, system.workspace)
    made = 1 + np.flatnonzero(solution.order > 0)  # by the method's own steps; with t_eval all rows count
    compared = made if len(made) else slice(None)
    t, q, v = solution.t, solution.q, solution.v
    sides = _sides(system, t, q, v)
    states = sides, q, v, solution.lam
    phi, rho, forces, exact, found, acting = measured(system, states, workspace, solution.contacts)
    phi, exact = np.abs(phi), exact[compared]
    error = np.abs(forces[compared] - exact)
    if solution.contacts is not None:  # friction without a direction
        error[too_slow(mechanism, solution.contacts, sides, q, v)[compared]] = 0.0
    scale = max(largest(exact), acting) or 1.0
    position, where, units = _widest(solution, mechanism, system, phi, rho)
    energy = None if mechanism is None else energy_of(solution, mechanism, workspace, system, found)
    seen = _seen(solution, finer)
    impacts, apart = None, False
    if finer is not None and solution.contacts is not None:
        impacts, apart = impact_errors(solution, finer)
    balance, work_error = 0.0, 0.0
    if energy is not None:
        balance, work_error = _balance(solution, energy, finer, lambda: solution.energy(mechanism))
    return Certificate(
        position=position,
        position_at=where,
        units=(units[0], units[1] and f"{units[1]}/s"),
        speed=float(largest(v)),
        velocity=float(largest(rho)),
        force=float(np.max(error, initial=0.0) / scale),
        force_first=float(np.max(error[:1], initial=0.0) / scale),
        energy_error=None if energy is None else balance,
        work_error=work_error,
        energy=None if energy is None else energy.total,
        undetermined={} if mechanism is None else undetermined(mechanism, t, q, system.rows),
        not_unique={} if mechanism is None else _shared(solution, mechanism, system, workspace),
        beyond_limits=() if mechanism is None else beyond_limits(mechanism, *seen[:2]),
        corrected_by=0.0 if mechanism is None else mechanism.corrected_by,
        fixed_step=solution.method.get("step") is not None,
        ended_early=solution.status < 0,
        saturated={} if mechanism is None else saturated(mechanism, *seen[:3]),
        error=None if finer is None else global_error(solution, finer, apart),
        error_missing=missing,
        added=_added(solution, energy, system),
        branches=_branches(solution, system, finer) if finer is not None or missing else (),
        pulling={} if mechanism is None else _pulling(mechanism, system.rows, seen[0], seen[3]),
        not_modelled=() if mechanism is None else mechanism.ignored,
        impacts=impacts,
        impacts_of_run=0 if solution.contacts is None else len(solution.contacts.impacts),
    )


def _widest(solution, mechanism, system, phi, rho) -> tuple[float, str, tuple[str, str]]:
    """The largest gap, its row and time, and the units of it and of the largest residual of the velocities."""
    if not phi.size:
        return 0.0, "", ("", "")
    i, row = np.unravel_index(np.argmax(phi), phi.shape)
    position, when = float(phi[i, row]), f"at t = {solution.t[i]:.6g} s"
    if mechanism is None:
        return position, f"{system.describe_row(row)} {when}", ("", "")
    if position > OPEN_LOOP and row < mechanism.nc:  # rows for steps are exact near closed loops only
        row = np.argmax(gaps := np.abs(system.loop_rows(solution.q[i], solution.t[i])[0]))
        position = float(gaps[row])
    units, (name, label) = row_units(mechanism), mechanism.row_labels[row]
    what = "loop" if row < mechanism.nc else "contact"
    return position, f"{what} {name!r} row {label} {when}", (units[row], units[np.argmax(np.abs(rho)) % rho.shape[1]])


def _seen(solution, finer):
    """t, q, v and λ of the rows and, in long steps between them, of the finer run."""
    rows = solution.t, solution.q, solution.v, solution.lam
    if finer is None:
        return rows
    both = [np.concatenate(pair) for pair in zip(rows, (finer.t, finer.q, finer.v, finer.lam), strict=True)]
    order = np.argsort(both[0] if solution.t[-1] >= solution.t[0] else -both[0], kind="stable")
    return [column[order] for column in both]


def _pulling(mechanism, rows, t, lam) -> dict[str, float]:
    """What :attr:`Certificate.pulling` is; multipliers that are rounding do not count."""
    found = {}
    for loop in mechanism.loops:
        if isinstance(loop, Constraint) and loop.unilateral:
            its = lam[:, rows.slices[loop.name]].min(axis=1)
            pulls = np.flatnonzero(its < -ROUNDED * largest(lam))
            if len(pulls):
                found[loop.name] = float(t[pulls[0]])
    return found


def _added(solution, energy, system) -> dict[str, float]:
    """What :attr:`Certificate.added` is."""
    found: dict[str, float] = {}
    if energy is None or not any(each.altered for each in solution._changes):
        return found
    _, (before, after), kinetic = event_energies(solution, system.forces, Workspace(system.model))
    gains = (after - before) * (1.0 if solution.t[-1] >= solution.t[0] else -1.0)
    for each, gain, size in zip(solution._changes, gains, kinetic, strict=True):
        if each.altered and gain > OFF * energy.exchanged:
            found[each.name] = max(found.get(each.name, 0.0), float(gain / size) if size else np.inf)
    return found


def _branches(solution, system, finer) -> tuple[float, ...]:
    if not isinstance(system, MechanismSystem):
        return ()
    return branch_times(system, solution.t, solution.q) if finer is None else branch_times(system, finer.t, finer.q)


def _balance(solution, energy, finer, by_states):
    """The error of the energy balance, and that of the work in it.

    Where rows are few, the work is that along the finer run if nothing jumps, or ``by_states()``, which returns the
    energies with the work by states between the rows.
    """
    balance = energy.balance_error
    if not above(balance, UNCLEAR):
        return balance, 0.0
    smooth = solution.contacts is None and not solution._changes and not (np.diff(solution.t) == 0.0).any()
    if finer is not None and smooth:
        total = energy.total[finer.rows]
        work, uncertain = work_of(finer)
        balance = replace(energy, error=total - total[0] - work).balance_error
        return balance, replace(energy, error=uncertain).balance_error if above(balance, UNCLEAR) else 0.0
    energy = by_states()
    return energy.balance_error, energy.work_error
