"""What is taken as true: the motion by two methods that share no formula of a step, and the forces at given states."""

from __future__ import annotations

from dataclasses import dataclass
from math import floor, log10
from types import SimpleNamespace
from typing import Any

import numpy as np

from ..errors import InputError, PinconsistError, warn
from ..mechanism.energy import energy_of
from ..mechanism.lie import difference
from ..mechanism.names import velocity_names, velocity_units
from ..mechanism.reactions import reactions, undetermined
from ..mechanism.rows import LoopRows
from ..run.accuracy import Equations, loop_forces
from ..run.simulation import simulate

METHODS = {"Radau": (1e-10, 1e-12), "BDF": (3e-10, 1e-11)}  # tolerances; tighter ones are rounding to BDF
ROWS = 100  # at least; up to ten times as many
AGREED = 1e-3  # of the forces: the two methods must agree to a tenth of the smallest error that is asked for
RANK, RANK_OF_GAP = 1e-9, 10.0  # least singular value of rows that are not redundant, relative; the same per m of gap
FEWEST = 10  # rows before they part


@dataclass(frozen=True)
class Reference:
    """The true motion at even times.

    ``agreement`` has the largest differences of the two methods: joints, rad or m, and forces, relative to their rms.
    ``alone`` says why there is only one method, ``until`` until when they agree.
    """

    sol: Any
    loads: np.ndarray
    agreement: tuple[float, float]
    alone: str
    until: float

    @property
    def t(self):
        return self.sol.t


def even_times(span) -> np.ndarray:
    """The times of the rows: every power of ten, s, of which the span has at least 100."""
    start, end = span
    spacing = 10.0 ** floor(log10((end - start) / ROWS) + 1e-9)
    return start + spacing * np.arange(floor((end - start) / spacing + 1e-9) + 1)


def reference_of(mechanism, times, q0, v0) -> Reference:
    """The motion by Radau IIA and by BDF; only up to where they agree."""
    span = float(times[0]), float(times[-1])
    sol = _run(mechanism, span, q0, v0, "Radau")
    if not sol.success:
        raise InputError(f"{mechanism.name}: there is no motion to compare with: {sol.message}")
    true = sol.at(times)
    loads = loop_forces(true.system, true.t, true.q, true.v, true.lam)
    try:
        other = _run(mechanism, span, q0, v0, "BDF")
        reason = "" if other.success else other.message
    except PinconsistError as error:
        reason = str(error)
    if reason:
        warn(f"{mechanism.name}: the reference is by Radau IIA alone, as BDF failed: {reason}")
        return Reference(true, loads, (np.nan, np.nan), reason, span[1])
    other = other.at(times)
    theirs = loop_forces(other.system, other.t, other.q, other.v, other.lam)
    sizes = np.maximum(np.linalg.norm(loads, axis=1), rms(loads) or 1.0)  # near singular configurations they are large
    apart = np.linalg.norm(theirs - loads, axis=1) / sizes
    kept = len(times) if (apart <= AGREED).all() else int(np.argmax(apart > AGREED))
    if kept < FEWEST:
        raise InputError(
            f"{mechanism.name}: two methods at tight tolerances diverge after {times[max(kept - 1, 0)]:g} s, so "
            "that no motion can be called true: choose another start, a shorter time or add damping"
        )
    if kept < len(times):
        warn(f"{mechanism.name}: from t = {times[kept]:g} s on no two methods agree (chaos); the time before is judged")
    rows = slice(kept)
    off = max(np.abs(difference(mechanism.model, a, b)).max() for a, b in zip(true.q[rows], other.q[rows], strict=True))
    true = sol.at(times[rows])
    return Reference(true, loads[rows], (float(off), float(apart[rows].max())), "", float(times[rows][-1]))


def _run(mechanism, span, q0, v0, method):
    rtol, atol = METHODS[method]
    return simulate(mechanism, span, q0, v0, method=method, rtol=rtol, atol=atol)


class Measure:
    """Measures states of any simulator against a reference."""

    def __init__(self, mechanism, reference: Reference):
        self.mechanism, self.reference, self.model = mechanism, reference, mechanism.model
        self.rows = LoopRows.of(mechanism)
        sol = reference.sol
        doubtful = undetermined(mechanism, sol.t, sol.q)
        self.left_out = tuple(doubtful)
        self.loops = [loop.name for loop in mechanism.anchored_loops if loop.name not in doubtful]
        self._equations = Equations(mechanism, sol)
        self.true = self.forces(sol.t, sol.q, reference.loads)
        self.size = rms(self.true[1:]) or 1.0
        self.energy = self._energy(sol.t, sol.q, sol.v)
        kinetic = self._energies(sol.t, sol.q, sol.v).kinetic
        self.exchanged = float(np.ptp(kinetic)) or float(np.abs(kinetic).max()) or 1.0
        units = np.array(velocity_units(self.model))
        self._turning, self._names = units == "rad", np.array(velocity_names(self.model))

    def forces(self, t, q, loads) -> np.ndarray:
        """The forces of k loops on their bodies 2 in world axes, N, side by side, (n, 3 k); without any, joint forces.

        They are what the joint forces `loads` (n, nv) of all loops together say, at minimum norm where redundant loops
        share a load.
        """
        if not self.loops:
            return loads
        lam = np.empty((len(t), self.rows.nc))
        for i, row in enumerate(zip(t, q, loads, strict=True)):
            lam[i] = self._multipliers(*row)
        found = reactions(self.mechanism, self.loops, t, q, lam)
        return np.hstack([each.force for each in found if each.force is not None])

    def _multipliers(self, t, q, load) -> np.ndarray:
        """λ of smallest norm. In open loops, redundant rows have small directions along which λ means nothing."""
        phi, J = self.rows.at(q, t)
        return np.linalg.lstsq(J.T, load, rcond=max(RANK, RANK_OF_GAP * float(np.abs(phi).max())))[0]

    def at_states(self, t, q, v):
        """The true joint forces of the loops at states, (n, nv), and the closed configurations nearest to them.

        Loops that are open are closed first, and velocities projected onto them. Where that fails, the forces are NaN,
        and the configuration is the open one.
        """
        closed, loads = np.array(q), np.full(np.shape(v), np.nan)
        for i, (at, *state) in enumerate(zip(t, q, v, strict=True)):
            try:
                index1 = self._equations.at(at, state[0])
                closed[i], moving = index1.projected(at, *state)
                lam = index1.system.full_multipliers(closed[i], index1.acceleration(at, closed[i], moving)[1])
                loads[i] = self.rows.at(closed[i], at)[1].T @ lam
            except PinconsistError:
                continue
        return loads, closed

    def joints(self, rows, q):
        """Largest errors of turning joints, rad, and of sliding ones, m, and the joint with the largest."""
        true = self.reference.sol.q[rows]
        off = np.abs([difference(self.model, a, b) for a, b in zip(true, q, strict=True)]).max(axis=0)
        turn, slide = (float(off[mask].max(initial=0.0)) for mask in (self._turning, ~self._turning))
        return turn, slide, str(self._names[int(np.argmax(off))])

    def gaps(self, t, q) -> tuple[float, float]:
        """Largest gap of a loop, m, and largest tilt, rad."""
        phi = np.abs([self.rows.at(state, at)[0] for at, state in zip(t, q, strict=True)])
        found = [0.0, 0.0]
        for loop in self.mechanism.anchored_loops:
            part = self.rows.slices[loop.name]
            turns = self.rows.turns[part]
            for k, mask in enumerate((~turns, turns)):
                found[k] = max(found[k], float(np.linalg.norm(phi[:, part][:, mask], axis=1).max(initial=0.0)))
        return found[0], found[1]

    def energy_error(self, rows, t, q, v) -> float:
        """Largest error of the energy, relative to the largest change of the kinetic energy."""
        return float(np.abs(self._energy(t, q, v) - self.energy[rows]).max() / self.exchanged)

    def _energy(self, t, q, v):
        return self._energies(t, q, v).total

    def _energies(self, t, q, v):
        states = SimpleNamespace(t=t, q=q, v=v, lam=np.zeros((len(t), self.rows.nc)), contacts=None, _changes=())
        return energy_of(states, self.mechanism)


def rms(values) -> float:
    """Root of the mean square of the rows' norms."""
    values = np.asarray(values)
    return float(np.sqrt((values**2).sum() / max(len(values), 1)))
