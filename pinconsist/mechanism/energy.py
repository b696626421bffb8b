"""The energy of a solution: what is stored, what each force brings in, and whether the balance holds."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicSpline

from .forces import bound_forces, unused
from .rows import LoopRows

EVENTS = "events"  # where ``work`` has what the jumps at events change


@dataclass(frozen=True, eq=False, repr=False)
class Energy:
    """Energies, J, and powers, W, of the n rows of a solution; arrays have shape (n,).

    Attributes
    ----------
    t : ndarray
        Times, s.
    kinetic, potential, elastic, total : ndarray
        Of the bodies and rotors; in the field of gravity; in all springs, the sum of ``stored``; the sum of the three.
    stored : dict[str, ndarray]
        Elastic energy of each spring.
    power : dict[str, ndarray]
        What each force brings into ``total``, positive where it makes it grow: τ·v, without what a spring stores (so
        that of a spring its damper is left, and of a damper the power is negative). Of each drive, and of each
        constraint that moves, -λ·Φ_t: of a drive, motor torque times speed. All add up to d(total)/dt.
    work : dict[str, ndarray]
        Integral of each power from the first row on, by a cubic spline through the rows, which limits what can be
        seen where rows are few. ``"events"`` is what jumps at events changed.
    error : ndarray
        ``total`` less its first value less all work.
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

    @property
    def balance_error(self) -> float:
        """The largest ``error`` over the largest kinetic energy (at rest, a millionth of the weights' energies)."""
        scale = max(self.kinetic.max(), 1e-6 * self._terms) or 1.0  # at rest there is only rounding
        return float(np.abs(self.error).max() / scale)

    def __str__(self):
        parts = {"kinetic": self.kinetic, "potential": self.potential, "elastic": self.elastic, "total": self.total}
        width = max(len(name) for name in (*parts, *(f"work of {name}" for name in self.work)))
        lines = [f"{'energy, J':{width}} {'start':>12} {'end':>12}"]
        lines += [f"{name:{width}} {values[0]:12.5g} {values[-1]:12.5g}" for name, values in parts.items()]
        lines += [f"{f'work of {name}':{width}} {'':12} {values[-1]:12.5g}" for name, values in self.work.items()]
        return "\n".join([*lines, f"{'balance error':{width}} {'':12} {self.error[-1]:12.2g}"])

    __repr__ = __str__


def energy_of(solution, mechanism) -> Energy:
    """Measure the energies and powers of a solution of a mechanism."""
    model, data = mechanism.model, mechanism.model.createData()
    forces, rows = bound_forces(model, mechanism.forces), LoopRows(model, mechanism.loops)
    springs = {label: force.stored for label, force in forces.items() if hasattr(force, "stored")}
    movers = {}
    for closure in rows.closures:
        if closure.moving:
            movers[unused(closure.loop.name, (*forces, *movers))] = rows.slices[closure.loop.name]
    t, n = solution.t, len(solution.t)
    kinetic, potential = np.zeros((2, n))
    power = {name: np.zeros(n) for name in (*forces, *movers)}
    stored = {label: np.zeros(n) for label in springs}
    for i, (time, q, v, lam) in enumerate(zip(t, solution.q, solution.v, solution.lam, strict=True)):
        kinetic[i] = pin.computeKineticEnergy(model, data, q, v)  # rotor inertia included
        potential[i] = pin.computePotentialEnergy(model, data, q)
        for label, force in forces.items():
            power[label][i] = force.torque(time, q, v) @ v
            if label in springs:
                stored[label][i], rate = springs[label](q, v)
                power[label][i] += rate
        if movers:
            brought = -lam * rows.time_rate(time, q)
            for name, part in movers.items():
                power[name][i] = brought[part].sum()
    elastic = sum(stored.values(), np.zeros(n))
    total = kinetic + potential + elastic
    work = {name: _integral(t, values) for name, values in power.items()}
    error = total - total[0] - sum(work.values(), np.zeros(n))
    change = np.diff(total, prepend=total[:1])
    jumps = np.cumsum(np.where(np.diff(t, prepend=np.nan) == 0.0, change, 0.0))  # events leave two rows at one time
    if jumps.any():
        work[unused(EVENTS, power)] = jumps
    return Energy(
        t=t, kinetic=kinetic, potential=potential, elastic=elastic, total=total, stored=stored, power=power, work=work,
        error=error - jumps, _terms=max(np.abs(total).max(), elastic.max(), _weights(model, data, solution.q[0])),
    )  # fmt: skip


def _weights(model, data, q) -> float:
    """The sizes of what the potential energy is the sum of, added up, J."""
    pin.forwardKinematics(model, data, q)
    bodies = zip(data.oMi, model.inertias, strict=True)
    heights = [inertia.mass * np.linalg.norm(pose.act(inertia.lever)) for pose, inertia in bodies]
    return float(sum(heights) * np.linalg.norm(model.gravity.linear))


def _integral(t, power):
    """∫ power dt up to each row, piecewise between events."""
    work, cuts = np.zeros(len(t)), [0, *(np.flatnonzero(np.diff(t) == 0.0) + 1), len(t)]
    for start, stop in pairwise(cuts):
        if start:
            work[start:] = work[start - 1]
        if stop - start > 1:
            sign = 1.0 if t[stop - 1] > t[start] else -1.0
            spline = CubicSpline(sign * t[start:stop], sign * power[start:stop]).antiderivative()
            work[start:stop] += spline(sign * t[start:stop]) - spline(sign * t[start])
    return work
