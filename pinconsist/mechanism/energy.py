"""The energy of a solution: stored energy, the power and work of each force, and the error of the balance."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from .forces import bound_forces, unused
from .forces.held import sided
from .rows import KeptRows, LoopRows, Workspace

UNCERTAIN = 1e-4  # work_error from which states between the rows are used
PARTS = (1, 2, 4, 8)  # of a step, each with a formula
NODES, WEIGHTS = np.polynomial.legendre.leggauss(6)  # exact up to degree 11: for steps of Radau of high order


def _weights_without(left_out):
    """Weights of the formula at the same nodes but one, exact up to degree 4, with which the first is compared."""
    nodes = np.delete(NODES, left_out)
    powers = np.arange(len(nodes))
    integrals = (1.0 + (-1.0) ** powers) / (powers + 1.0)  # of xⁿ from -1 to 1
    weights = np.linalg.solve(np.vander(nodes, increasing=True).T, integrals)
    return np.insert(weights, left_out, 0.0)


FEWER = _weights_without(2)
EVENTS = "events"  # key in ``work`` of the energy change in the jumps at events


@dataclass(frozen=True, eq=False, repr=False)
class Energy:
    """Energies, J, and powers, W, of the n rows of a solution; arrays have shape (n,).

    Attributes
    ----------
    t : ndarray
        Times, s.
    kinetic, potential, elastic, total : ndarray
        Kinetic energy of bodies and rotors; gravitational energy; energy of all springs, the sum of ``stored``; the sum
        of the three.
    stored : dict[str, ndarray]
        Elastic energy of each spring.
    power : dict[str, ndarray]
        Power of each force, positive if it increases ``total``: τ·v without the rate of the stored energy (for a
        spring with damper this is the power of the damper, which is negative). For each drive and each constraint that
        depends on time, -λ·Φ_t; for a drive this is motor torque times speed. The sum is d(total)/dt.
    work : dict[str, ndarray]
        Integral of each power from the first row on: by a cubic spline through the rows or, if there are too few, by
        Gauss quadrature at states between them. ``"events"`` is the change of energy in the jumps at events.
    error : ndarray
        ``total`` minus its first value minus all work.
    """

    t: np.ndarray
    kinetic: np.ndarray
    potential: np.ndarray
    elastic: np.ndarray
    total: np.ndarray
    stored: dict[str, np.ndarray]
    power: dict[str, np.ndarray]
    work: dict[str, np.ndarray]
    error: np.ndarray
    _terms: float
    _by_states: float | None = None  # the uncertainty of the work if states between the rows were used, J

    @property
    def balance_error(self) -> float:
        """The largest ``error`` relative to the exchanged energy.

        The exchanged energy is the sum of the largest kinetic energy, the ranges of potential and elastic energy and
        the largest work of each force. If hardly anything moves, it is a hundred-thousandth of the stored and
        gravitational energies: the error then consists of rounding and tolerances only.
        """
        return float(np.abs(self.error).max() / self.exchanged)

    @property
    def work_error(self) -> float:
        """Uncertainty of the work of all forces due to the small number of rows, relative like ``balance_error``.

        It is the largest change of this work if every second row is left out and, where jumps isolate a step, if its
        power is that at one of its ends. With states between the rows, it is the difference of two formulas.
        """
        if self._by_states is not None:
            return self._by_states / self.exchanged
        n, doubled = len(self.t), np.diff(self.t) == 0.0  # the ends of the pieces between events stay
        kept = np.ones(n, dtype=bool)
        kept[1:-1] = (np.arange(1, n - 1) % 2 == 0) | doubled[:-1] | doubled[1:]
        power = sum(self.power.values(), np.zeros(n))[:, None]
        change = integrals(self.t, power)[kept] - integrals(self.t[kept], power[kept])
        alone = ~doubled & np.append(True, doubled[:-1]) & np.append(doubled[1:], True)
        ends = np.cumsum(np.where(alone, 0.5 * np.abs(np.diff(self.t) * np.diff(power[:, 0])), 0.0))
        return float((np.abs(change).max() + ends.max(initial=0.0)) / self.exchanged)

    @property
    def exchanged(self) -> float:
        """The exchanged energy, J, see :attr:`balance_error`."""
        exchanged = self.kinetic.max() + np.ptp(self.potential) + np.ptp(self.elastic)
        exchanged += sum(np.abs(work).max() for work in self.work.values())
        return max(exchanged, 1e-5 * self._terms) or 1.0

    def __str__(self):
        parts = {"kinetic": self.kinetic, "potential": self.potential, "elastic": self.elastic, "total": self.total}
        width = max(len(name) for name in (*parts, *(f"work of {name}" for name in self.work)))
        lines = [f"{'energy, J':{width}} {'start':>12} {'end':>12}"]
        lines += [f"{name:{width}} {values[0]:12.5g} {values[-1]:12.5g}" for name, values in parts.items()]
        lines += [f"{f'work of {name}':{width}} {'':12} {values[-1]:12.5g}" for name, values in self.work.items()]
        return "\n".join([*lines, f"{'balance error':{width}} {'':12} {self.error[-1]:12.2g}"])

    __repr__ = __str__


def energy_of(solution, mechanism, workspace=None, system=None, found=None) -> Energy:
    """Measure the energies and powers of a solution of a mechanism.

    `system` has its rows and forces, and `found` is the result of :func:`measure`, if known.
    """
    workspace, rows = workspace or Workspace(mechanism.model), system.rows if system else LoopRows.of(mechanism)
    forces = system.forces if system else bound_forces(mechanism.model, mechanism.forces)
    t, q, v, n = solution.t, solution.q, solution.v, len(solution.t)
    columns = measure(forces, sided(t), q, v, workspace) if found is None else found
    kinetic, potential, terms, *columns = np.ascontiguousarray(columns.T)
    power = dict(zip(forces, columns[::2], strict=True))
    energies = dict(zip(forces, columns[1::2], strict=True))
    stored = {label: energies[label] for label, force in forces.items() if force.stores}
    _add_drives(power, rows, t, q, solution.lam, workspace)
    _add_friction(power, mechanism, sided(t), q, v, solution.lam, workspace)
    elastic = sum(stored.values(), np.zeros(n))
    total = kinetic + potential + elastic
    done, acts = np.zeros((len(power), n)), [k for k, each in enumerate(power.values()) if each.any()]
    if acts:
        done[acts] = integrals(t, np.column_stack([*power.values()])[:, acts]).T
    work, error = dict(zip(power, done, strict=True)), total - total[0] - done.sum(axis=0)
    jumps = _jumps(solution, forces, total, workspace)
    error -= jumps
    if jumps.any():
        work[unused(EVENTS, power)] = jumps
    return Energy(
        t=t, kinetic=kinetic, potential=potential, elastic=elastic, total=total, stored=stored, power=power, work=work,
        error=error, _terms=max(np.abs(total).max(), elastic.max(), terms[0]),
    )  # fmt: skip


def _add_drives(power, rows, t, q, lam, workspace):
    """The power of each constraint that depends on time."""
    if rows.moving:
        power_of_rows = -lam[:, : rows.nc] * _time_rates(rows, t, q, workspace)
        for closure in rows.closures:
            if closure.moving:
                name = closure.loop.name
                power[unused(name, power)] = power_of_rows[:, rows.slices[name]].sum(axis=1)


def _add_friction(power, mechanism, t, q, v, lam, workspace):
    """The power of the friction of each contact."""
    elements = mechanism.contact_elements
    if not any(element.tangents for element in elements):
        return
    compiled, first = workspace.compiled(), 0
    for element in elements:
        element.add(compiled)
    rates = compiled.residuals(t, q, v, np.zeros((len(t), compiled.nc)))[1]
    power_of_rows = lam[:, mechanism.nc :] * rates
    for element in elements:
        if element.tangents:
            own = power_of_rows[:, first + element.pushes : first + element.size]
            power[unused(element.record.name, power)] = own.sum(axis=1)
        first += element.size


def refined(energy, mechanism, states, workspace) -> Energy:
    """The same energies with the work by states between the rows: ``states(times)`` returns (q, v, λ).

    Where steps are so long that a formula does not follow the power, each is divided.
    """
    found = energy
    for parts in PARTS:
        found = _divided(energy, mechanism, states, workspace, parts)
        if found.work_error <= UNCERTAIN:
            break
    return found


def _divided(energy, mechanism, states, workspace, parts) -> Energy:
    t = energy.t
    rows = LoopRows.of(mechanism)
    forces = bound_forces(mechanism.model, mechanism.forces)
    steps = np.diff(t) / parts
    long = np.flatnonzero(steps)
    places = (np.arange(parts)[:, None] + 0.5 * (1.0 + NODES)).ravel()  # in parts of a step
    times = (t[long, None] + places * steps[long, None]).ravel()
    q, v, lam = states(times)
    power = dict(zip(forces, measure(forces, times, q, v, workspace).T[3::2], strict=True))
    _add_drives(power, rows, times, q, lam, workspace)
    _add_friction(power, mechanism, times, q, v, lam, workspace)
    work, error = dict(energy.work), energy.error + sum(energy.work[label] for label in power)
    change = np.zeros(len(long))
    for label, values in power.items():
        values = values.reshape(len(long), -1)
        pieces = np.zeros(len(t))
        pieces[long + 1] = 0.5 * steps[long] * (values @ np.tile(WEIGHTS, parts))
        work[label] = np.cumsum(pieces)
        error = error - work[label]
        change += 0.5 * steps[long] * (values @ np.tile(WEIGHTS - FEWER, parts))
    return replace(energy, work=work, error=error, _by_states=float(np.abs(change).sum()))


def total_power(forces, t, q, v, workspace, found=None):
    """Power of all forces together without the rate of stored energy, W, shape (n,); `found` as in `energy_of`."""
    columns = measure(forces, t, q, v, workspace) if found is None else found
    return columns[:, 3::2].sum(axis=1)


def _jumps(solution, forces, total, workspace):
    """What events and impacts have added to the energy up to each row."""
    t = solution.t
    doubled = t[1:] == t[:-1]  # events leave two rows at one time, unless the rows are those of t_eval
    jumps = np.append(0.0, np.cumsum(np.where(doubled, np.diff(total), 0.0)))
    times, added = np.zeros(0), np.zeros(0)
    if solution._changes:
        times, (before, after) = event_energies(solution, forces, workspace)[:2]
        added = after - before
    if solution.contacts is not None:
        impacts = [each for each in solution.contacts.impacts if each.t > t[0]]  # the first row is after the others
        times = np.append(times, [each.t for each in impacts])
        added = np.append(added, [-each.energy_lost for each in impacts])
    between = ~np.isin(times, t[1:][doubled])
    if between.any():
        sign = 1.0 if t[-1] >= t[0] else -1.0
        jumps += (sign * t[:, None] >= sign * times[between]) @ added[between]
    return jumps


def event_energies(solution, forces, workspace):
    """Of each change of the state by an event: its time; the energy before and after; the kinetic energy before."""
    times = np.array([each.t for each in solution._changes])
    q = np.array([state for each in solution._changes for state in (each.p_before, each.p_after)])
    v = np.array([state for each in solution._changes for state in (each.v_before, each.v_after)])
    twice = np.repeat(times, 2)
    columns = measure(forces, twice, q, v, workspace)
    energy = columns[:, 0] + columns[:, 1] + columns[:, 4::2].sum(axis=1)
    return times, energy.reshape(-1, 2).T, columns[::2, 0]


def measure(forces, t, q, v, workspace):
    """Energies and powers as columns.

    They are the kinetic energy, including that of rotors, the potential energy, the sum of the absolute values that its
    terms may have, and the power and elastic energy of each force.
    """
    return workspace.compiled().energies(t, q, v, alone(forces, workspace))


def alone(forces, workspace) -> list:
    """A compiled system for each force, with nothing else."""
    return [_system_of(force, workspace) for force in forces.values()]


def _system_of(force, workspace):
    compiled = workspace.compiled()
    force.hand_over(compiled)
    return compiled


def torques_of(force, t, q, v, workspace):
    """τ of a force of :func:`bound_forces` at several states, shape (n, nv)."""
    return _system_of(force, workspace).torques(t, q, v)


def _time_rates(rows, t, q, workspace):
    """Φ_t of all rows of the loops: the hidden residual at rest."""
    compiled = workspace.compiled()
    KeptRows(rows, np.arange(rows.nc)).hand_over(compiled)
    return compiled.residuals(t, q, np.zeros((len(t), rows.model.nv)), np.zeros((len(t), rows.nc)))[1]


def integrals(t, powers):
    """∫ powers dt up to each row, shape (n, k), piecewise between events."""
    pieces, steps = np.zeros(powers.shape), np.diff(t)
    for start, stop in pairwise([0, *(np.flatnonzero(steps == 0.0) + 1), len(t)]):
        if stop - start > 1:
            h, y = np.abs(steps[start : stop - 1, None]), powers[start:stop]
            slope = _slopes(h, y)
            pieces[start + 1 : stop] = h / 2 * (y[:-1] + y[1:]) + h**2 / 12 * (slope[:-1] - slope[1:])
    return np.cumsum(pieces, axis=0) * (1.0 if t[-1] >= t[0] else -1.0)


def _slopes(h, y):
    """Slopes of the cubic spline (not-a-knot) through `y`, (n, k), at its knots; `h`, (n - 1, 1), are their distances.

    SciPy's ``CubicSpline`` takes several times as long, which was a fifth of a certificate.
    """
    from scipy.linalg.lapack import dgtsv

    if (n := len(y)) < 4:
        return np.gradient(y, np.append(0.0, np.cumsum(h)), axis=0, edge_order=n - 1)
    mean, a, b = np.diff(y, axis=0) / h, h[:-1], h[1:]
    both = a + b
    first = ((a[0] + 2.0 * both[0]) * b[0] * mean[0] + a[0] ** 2 * mean[1]) / both[0]
    last = ((b[-1] + 2.0 * both[-1]) * a[-1] * mean[-1] + b[-1] ** 2 * mean[-2]) / both[-1]
    below, above = np.append(b, both[-1]), np.append(both[0], a)
    middle = np.concatenate((b[0], 2.0 * both[:, 0], a[-1]))
    return dgtsv(below, middle, above, np.vstack((first, 3.0 * (b * mean[:-1] + a * mean[1:]), last)))[3]
