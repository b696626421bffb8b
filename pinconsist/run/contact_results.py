"""What the contacts of a run did: their modes, impacts, gaps and forces."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from itertools import groupby
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from ..engine.index1 import Index1
from ..engine.norms import largest
from ..engine.systems import blank_system, compiled_system
from ..errors import InputError
from ..mechanism.breakpoints import jump_offset
from ..mechanism.checks import near, read_only
from ..mechanism.contacts import DistanceElement, PlaneElement, contact_units
from ..mechanism.mode_system import CLOSED, OPEN, SLIP, STICK, Mode, ModeSystem, first_rows
from ..mechanism.rows import LoopRows
from ..mechanism.system import MechanismSystem


class ContactMode(NamedTuple):
    """A time in which a contact did the same.

    Its name, which for a stop includes the side; ``open``, ``closed``, ``stick`` or ``slip``; begin and end, s.
    """

    contact: str
    mode: str
    t_begin: float
    t_end: float


class ContactImpact(NamedTuple):
    """An impact.

    Its time, s; impulses, N s or N m s, by contact, with the tangential ones where there is friction; speeds of
    approach before it, m/s or rad/s; the energy that was lost, J; and whether it was no collision, but the sudden end
    of sliding where friction lets no accelerations exist.
    """

    t: float
    impulses: dict
    speeds: dict
    energy_lost: float
    jam: bool = False


@dataclass(frozen=True)
class ContactMotion:
    """A contact at the rows of a solution.

    Attributes
    ----------
    name, t : str, ndarray
        Its name, and the times, s.
    gap : ndarray, shape (n,)
        m or rad; of a joint with two stops that to the nearer one, 0 for dry friction.
    force : ndarray
        Of a stop or dry friction the torque or force on the joint, N·m or N, of a pin the torque on body 2 of its loop
        about the axis of anchor 1, N·m, and of a rope or strut the tension
        or pressure, N, shape (n,); of a point on a plane the force on the body, N, in world axes, shape (n, 3).
    slip : ndarray, shape (n, k)
        Velocities along the tangents, m/s or rad/s.
    mode : list of str
        ``open``, ``closed``, ``stick`` or ``slip``.
    """

    name: str
    t: np.ndarray
    gap: np.ndarray
    force: np.ndarray
    slip: np.ndarray
    mode: list[str]


@dataclass(frozen=True)
class ContactHistory:
    """The modes of all elements from each of the times ``starts`` on, and the impacts."""

    names: tuple[str, ...] = ()  # of the elements
    starts: tuple[float, ...] = ()
    tables: tuple[tuple[Mode, ...], ...] = ()
    impacts: tuple[ContactImpact, ...] = ()
    still: float = 0.0

    @staticmethod
    def of(trajectory) -> ContactHistory | None:
        if not trajectory.periods:
            return None
        starts, tables = [], []
        for period in trajectory.periods:
            if tables and tables[-1] == period.system.modes and starts[-1] != period.t:
                continue  # of several at one time each has its row
            starts.append(float(period.t))
            tables.append(period.system.modes)
        impacts = tuple(trajectory.impacts)
        names = tuple(each.name for each in trajectory.periods[0].system.elements)
        return ContactHistory(names, tuple(starts), tuple(tables), impacts, trajectory.periods[-1].system.still)

    def plain(self) -> dict:
        """As plain data."""
        tables = [[list(map(_plain, mode)) for mode in table] for table in self.tables]
        impacts = [[_plain(each) for each in impact] for impact in self.impacts]
        return {"names": self.names, "starts": self.starts, "tables": tables, "impacts": impacts, "still": self.still}

    @staticmethod
    def recorded(data) -> ContactHistory | None:
        """The history that :meth:`plain` described; TypeError, KeyError or ValueError for anything else."""
        if data is None:
            return None
        tables = tuple(
            tuple(Mode(str(kind), tuple(at), tuple(direction)) for kind, at, direction in table)
            for table in data["tables"]
        )
        impacts = tuple(ContactImpact(*each) for each in data["impacts"])
        return ContactHistory(tuple(data["names"]), tuple(data["starts"]), tables, impacts, float(data["still"]))

    @staticmethod
    def joined(parts) -> ContactHistory | None:
        """The history of successive runs, each with the time at which it ends; None for runs without contacts."""
        if not parts or parts[0][0] is None:
            return None
        starts, tables, impacts = [], [], []
        for part, end in parts:
            count = sum(start <= end for start in part.starts)
            continued = bool(tables) and _laws(tables[-1]) == _laws(part.tables[0])
            starts += part.starts[continued:count]
            tables += part.tables[continued:count]
            impacts += [each for each in part.impacts if each.t <= end]
        first = parts[0][0]
        return ContactHistory(
            first.names, tuple(starts), tuple(tables), tuple(impacts), max(part.still for part, _ in parts)
        )

    def of_rows(self, t) -> np.ndarray:
        """The index of the table that holds at each row: of several rows at a time of change, the later ones."""
        t, starts = np.asarray(t, float), np.array(self.starts)
        found = np.searchsorted(starts, t, side="right") - 1
        times = np.unique(starts[1:])
        ends = [[np.searchsorted(of, times, side) for side in ("left", "right")] for of in (t, starts)]
        for low, high, first, last in np.transpose([*ends[0], *ends[1]]):
            rows, changes = np.arange(low, high), np.arange(first, last)
            if len(rows) < 2:
                continue
            before = [changes[0] - 1] * max(1, len(rows) - len(changes))
            found[rows] = [*before, *changes[len(changes) - len(rows) + len(before) :]]
        return np.maximum(found, 0)

    def of_sided_rows(self, t) -> np.ndarray:
        """The same, of rows whose times were shifted to their sides of the changes, see ``sided``."""
        t, starts = np.asarray(t, float), np.array(self.starts)
        after = np.searchsorted(starts, t)
        before = starts[np.maximum(after - 1, 0)]
        behind = starts[np.minimum(after, len(starts) - 1)]
        nearest = np.where(np.abs(t - before) <= np.abs(behind - t), before, behind)
        near = np.abs(nearest - t) <= 2.0 * jump_offset(t)
        _, groups, sizes = np.unique(nearest[near], return_inverse=True, return_counts=True)
        several = np.zeros(len(t), bool)
        several[near] = sizes[groups] > 1
        return self.of_rows(np.where(several, nearest, t))

    def modes(self, end) -> list[ContactMode]:
        """The time that each element spends in each mode, those of zero length left out."""
        found, times = [], [*self.starts, end]
        for i, name in enumerate(self.names):
            begin, kind = times[0], self.tables[0][i].kind
            for k in range(1, len(self.tables) + 1):
                other = self.tables[k][i].kind if k < len(self.tables) else ""
                if other != kind:
                    if times[k] > begin:
                        found.append(ContactMode(name, kind, begin, times[k]))
                    begin, kind = times[k], other
        return sorted(found, key=lambda each: each.t_begin)

    def at(self, t) -> tuple[str, ...]:
        """What each element does at a time."""
        return tuple(mode.kind for mode in self.tables[self.index(t)])

    def laws(self, t) -> tuple:
        """The laws of friction at a time: what each element does and, along a line, in which direction it slides."""
        return _laws(self.tables[self.index(t)])

    def index(self, t) -> int:
        """The table that holds at a time, of two at a time of change the later one."""
        return max(bisect_right(self.starts, t) - 1, 0)


def _laws(table) -> tuple:
    """What each element does and, along a line, in which direction it slides."""
    return tuple((mode.kind, mode.direction if len(mode.direction) == 1 else ()) for mode in table)


def _plain(value):
    """Numbers, texts and mappings for JSON."""
    if isinstance(value, dict):
        return {name: _plain(each) for name, each in value.items()}
    return value.tolist() if isinstance(value, np.ndarray) else list(value) if isinstance(value, tuple) else value


class EquationsInModes:
    """The equations of a mechanism with contacts, in the mode of each time."""

    def __init__(self, mechanism, history):
        self._mechanism, self._history, self._base = mechanism, history, None
        self._known: dict[tuple, tuple[Index1, int]] = {}

    def at(self, t, q, v, table=None) -> Index1:
        """The equations near a state, in the mode of its time, or that of a `table` of the history.

        What slides does so in the direction of the velocity; if it is too slow to have one, in that of the last call.
        """
        index1 = self._near(t, q, self._history.index(t) if table is None else table)
        index1.compiled.aim(t, q, v)
        return index1

    def _near(self, t, q, table) -> Index1:
        modes = self._history.tables[table]
        known, of = self._known.get(modes, (None, table))
        shares = known is not None and known.system.redundant and table != of
        if known is not None and not shares and known.system.reselected(q) is None:
            return known
        if self._base is None or known is not None:
            self._base = MechanismSystem(self._mechanism, q, t)
        known = Index1(mode_system(self._base, modes, t, q, self._history.still))
        self._known[modes] = known, table
        return known


def mode_system(base, modes, t, q, still) -> ModeSystem:
    """The equations in one mode at a position in it."""
    elements, v = base.mechanism.contact_elements, np.zeros(base.nv)
    every = all_rows(elements, base.model, base.workspace)
    J = np.vstack((compiled_system(base).dynamics(t, q, v)[2], every.evaluate(t, q, v, v)[2]))
    return ModeSystem(base, elements, every, modes, J, still)


def all_rows(elements, model, owner=None):
    """A compiled system with all rows of these elements, without loops and forces, with the workspace of an `owner`."""
    every = blank_system(model, owner)
    for element in elements:
        element.add(every)
    return every


def row_units(mechanism) -> list[str]:
    """The unit of each row of :attr:`Mechanism.row_labels`: of contacts that of their joint, or m."""
    units = list(LoopRows.of(mechanism).units)
    for element in mechanism.contact_elements:
        units += [element.unit(mechanism.model)] * element.size
    return units


def contact_motion(solution, mechanism, name, rows=None) -> ContactMotion:
    """What :meth:`Solution.contact` returns; `rows` are those of :func:`rows_of`, if they are known."""
    elements, names = mechanism.contact_elements, [each.name for each in mechanism.contacts]
    of = [i for i, each in enumerate(elements) if name in (each.name, each.record.name)]
    if not of:
        there = f"the contacts are {', '.join(names)}" if names else "it has no contacts"
        raise InputError(f"{mechanism.name}: no contact {name!r}{near(name, names)}; {there}")
    firsts = mechanism.nc + first_rows(elements)
    phi, rates = rows or rows_of(mechanism, solution.t, solution.q, solution.v)
    gap, force, slip = _measured(solution, mechanism, elements, of, firsts, phi, rates)
    kinds = [[table[i].kind for i in of] for table in solution.contacts.tables]
    table = solution.contacts.of_rows(solution.t)
    mode = [next((kind for kind in kinds[k] if kind != OPEN), OPEN) for k in table]
    return ContactMotion(name, solution.t, read_only(gap), read_only(force), read_only(slip), mode)


KINDS = (OPEN, CLOSED, STICK, SLIP)


def contact_columns(solution, mechanism):
    """(name, unit, values) of the columns of contacts in tables."""
    if solution.contacts is None or not mechanism.contacts:
        return
    rows = rows_of(mechanism, solution.t, solution.q, solution.v)
    for record in mechanism.contacts:
        found = contact_motion(solution, mechanism, record.name, rows)
        of_gap, of_force = contact_units(mechanism, record.name)
        if record.has_gap:
            yield f"gap.{record.name}", of_gap, found.gap
        if found.force.ndim == 1:
            yield f"force.{record.name}", of_force, found.force
        else:
            yield from ((f"force.{record.name}.{axis}", of_force, found.force[:, k]) for k, axis in enumerate("xyz"))
        codes = "; ".join(f"{k} {kind}" for k, kind in enumerate(KINDS))
        yield f"mode.{record.name}", codes, np.array([float(KINDS.index(kind)) for kind in found.mode])


def rows_of(mechanism, t, q, v):
    """Positions and rates of all rows of the contacts at several states, (n, m) each."""
    elements = mechanism.contact_elements
    none = np.zeros((len(t), int(first_rows(elements)[-1])))
    return all_rows(elements, mechanism.model).residuals(t, q, v, none)[:2]


def _measured(solution, mechanism, elements, of, firsts, phi, rates):
    n, nc = len(solution.t), mechanism.nc
    gaps = [phi[:, firsts[i] - nc] for i in of if elements[i].pushes]
    gap = np.min(gaps, axis=0) if gaps else np.zeros(n)
    element = elements[of[0]]
    own = slice(firsts[of[0]], firsts[of[0] + 1])
    slip = rates[:, own.start - nc + element.pushes : own.stop - nc]
    if isinstance(element, PlaneElement):
        force, data = np.empty((n, 3)), mechanism.model.createData()
        for k, q in enumerate(solution.q):
            pin.forwardKinematics(mechanism.model, data, q)
            turn = data.oMi[element.joint1].rotation[None]
            force[k] = element.force(solution.lam[k : k + 1, own], None, None, turn)[0]
    elif isinstance(element, DistanceElement) or not element.pushes:
        force = solution.lam[:, own.start].copy()
    else:
        force = sum(elements[i].sign * solution.lam[:, firsts[i]] for i in of)
    return gap, force, slip


def measured_in_modes(mechanism, history, states):
    """What :func:`~pinconsist.run.accuracy.measured` returns, of a run with contacts.

    The columns of Φ and of the hidden residual are those of the loops and then of the contacts: of closed gaps their
    sizes, of tangents that stick their motion, and of open gaps what is below zero.
    """
    equations, rows, acting = EquationsInModes(mechanism, history), [], 0.0
    tables = history.of_sided_rows(states[0])
    for part in np.split(np.arange(len(tables)), 1 + np.flatnonzero(np.diff(tables))):
        t, q, v, lam = (column[part] for column in states)
        found, exact, systems = [], [], []
        for state in zip(t, q, v, strict=True):
            index1 = equations.at(*state, tables[part[0]])
            system = index1.system
            systems.append(system)
            still = np.zeros(len(state[2]))
            exact.append(index1.acceleration(*state)[1])
            gap, J = system.loop_rows(state[1], state[0])
            acting = max(acting, largest(index1.compiled.evaluate(*state, still)[0]))
            acting = max(acting, largest(system.weights(*state[1:])))
            _, phi, R, rates = system.every.evaluate(*state, still)
            gaps, hidden = _violations(system, phi, rates)
            hidden = np.concatenate((J @ state[2] + system.rows.time_rate(*state[:2]), hidden))
            found.append((np.concatenate((gap, gaps)), hidden, np.vstack((J, R))))
        theirs = np.empty_like(lam)
        first = 0
        for system, group in groupby(systems):  # they differ where other rows of the loops are kept
            own = slice(first, first + len(list(group)))
            theirs[own] = system.full_multipliers(q[own], np.array(exact[own]), v=v[own])
            first = own.stop
        rows += [
            (gaps, hidden, every.T @ ours, every.T @ exactly)
            for (gaps, hidden, every), ours, exactly in zip(found, lam, theirs, strict=True)
        ]
    return *(np.array(column) for column in zip(*rows, strict=True)), None, acting


def too_slow(mechanism, history, t, q, v) -> np.ndarray:
    """Mask of the rows at which some contact slides so slowly that the direction of its friction is not known."""
    elements = mechanism.contact_elements
    firsts, found = first_rows(elements), np.zeros(len(t), bool)
    rates = rows_of(mechanism, t, q, v)[1]
    for row, table in enumerate(history.of_sided_rows(t)):
        for i, (element, mode) in enumerate(zip(elements, history.tables[table], strict=True)):
            slip = rates[row, firsts[i] + element.pushes : firsts[i + 1]]
            found[row] |= mode.kind == SLIP and len(slip) == 2 and np.linalg.norm(slip) <= history.still
    return found


def _violations(system, phi, rates):
    """What the rows of the contacts violate, as positions and as velocities."""
    gaps, hidden = np.zeros(len(phi)), np.zeros(len(phi))
    for i, (element, mode) in enumerate(zip(system.elements, system.modes, strict=True)):
        first, last = system.firsts[i], system.firsts[i + 1]
        if element.pushes:
            gaps[first] = min(phi[first], 0.0) if mode.kind == OPEN else phi[first]
            hidden[first] = 0.0 if mode.kind == OPEN else rates[first]
        if mode.kind == STICK:
            own = slice(first + element.pushes, last)
            gaps[own], hidden[own] = phi[own] - mode.at, rates[own]
    return gaps, hidden
