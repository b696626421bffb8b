"""Known derivatives of the equations: by inertial parameters, by gravity, and by numbers of one force.

Such a parameter changes only f = M a + nle - τ, which is linear in masses, first moments and inertias about joints, and
in gravity. Each part returns r_θ at a state, ``force(model, data, t, q, v, a)``; ``hand_over(rates, column, weight)``
adds it to compiled rates. For other parameters, r_θ is a weighted sum of residuals of mechanisms; :class:`Known` makes
a part usable in their place, as a system with f = r_θ and zero rows.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin

from ..errors import InputError
from ..mechanism.forces.held import BoundHeld, Given, columns_of
from ..mechanism.forces.piecewise import BoundPiecewise
from ..mechanism.motion import AHEAD, CENTRAL, difference_step
from ..mechanism.parameters import Parameter, part_at, records_of, with_number

OF_STEPS = {-1: -1 / 2, 1: 1 / 2}
BEHIND, SECOND_BEHIND = {-m: -weight for m, weight in AHEAD.items()}, {0: 3 / 2, -1: -2.0, -2: 1 / 2}
SIDES = (CENTRAL, OF_STEPS), (AHEAD, {0: -3 / 2, 1: 2.0, 2: -1 / 2}), (BEHIND, SECOND_BEHIND)
"""Weights by offset, of fourth and of second order: central, and one-sided for values near a bound."""
CLOSE = 0.1  # relative to the step of other parameters: most forces are linear in their numbers, and all are smooth


@dataclass
class Inertial:
    """The derivative by inertial parameters of a body: `rates` of its ten numbers in Pinocchio's regressor."""

    joint: int
    rates: np.ndarray

    def force(self, model, data, t, q, v, a):
        columns = slice(10 * self.joint - 10, 10 * self.joint)
        return pin.computeJointTorqueRegressor(model, data, q, v, a)[:, columns] @ self.rates

    def hand_over(self, rates, column, weight) -> None:
        rates.add_inertia(column, weight, self.joint, self.rates)


@dataclass
class Gravity:
    """The derivative by gravity in a direction."""

    rates: np.ndarray

    def force(self, model, data, t, q, v, a):
        still, there = np.zeros(model.nv), model.copy()
        there.gravity = pin.Motion(self.rates, np.zeros(3))
        return pin.rnea(there, data, q, still, still)

    def hand_over(self, rates, column, weight) -> None:
        rates.add_gravity(column, weight, self.rates)


@dataclass
class Pull:
    """The torques of one force in which a number is slightly larger or smaller."""

    bound: Any

    def force(self, model, data, t, q, v, a):
        return -self.bound.torque(t, q, v)

    def hand_over(self, rates, column, weight) -> None:
        self.side_of(rates, column, weight)
        rates.act(column, [0], [column])

    def side_of(self, rates, key, weight) -> None:
        """Add it to the forces with this key."""
        self.bound.hand_over(rates)
        rates.close(key, weight)


@dataclass
class Nodes:
    """The derivative by values of a table: that by all of them at once, from weighted `sides`, times hat functions."""

    times: tuple
    sides: list[tuple[float, Pull]]
    nodes: list[int]

    def one(self, i):
        return replace(self, nodes=[self.nodes[i]])

    def force(self, model, data, t, q, v, a):
        """r_θ for a single value."""
        hat = np.interp(t, self.times, np.arange(len(self.times)) == self.nodes[0])
        return hat * sum(weight * side.force(model, data, t, q, v, a) for weight, side in self.sides)

    def hand_over(self, rates, columns, weight) -> None:
        columns = np.atleast_1d(columns).tolist()
        rates.set_times(columns[0], self.times)
        for own, side in self.sides:
            side.side_of(rates, columns[0], weight * own)
        rates.act(columns[0], self.nodes, columns)


def unit_torque(nv, column) -> Pull:
    """A torque of one at one of the velocities."""
    unit = Given(nv)
    unit.give(np.eye(nv)[column])
    return Pull(unit)


@dataclass
class HeldNodes:
    """The derivative by torques of a table that are held: `nodes` are pairs (entry, velocity) of the `table`."""

    table: BoundHeld
    nv: int
    nodes: list[tuple[int, int]]

    def one(self, i):
        return replace(self, nodes=[self.nodes[i]])

    def force(self, model, data, t, q, v, a):
        """r_θ for a single torque."""
        ((entry, column),) = self.nodes
        return -self.table.share_of(entry, t) * (np.arange(self.nv) == column)

    def hand_over(self, rates, columns, weight) -> None:
        columns = np.atleast_1d(columns).tolist()
        for velocity in sorted({velocity for _, velocity in self.nodes}):
            own = [(entry, k) for (entry, where), k in zip(self.nodes, columns, strict=True) if where == velocity]
            key = own[0][1]
            rates.set_held(key, self.table.table)
            unit_torque(self.nv, velocity).side_of(rates, key, weight)
            rates.act(key, *map(list, zip(*own, strict=True)))


class Known:
    """One of these parts as a system, with zero rows as many as in the system `like`; `data` is shared."""

    def __init__(self, part, like, data):
        self.part, self.model, self.nv, self.nc = part, like.model, like.nv, like.nc
        self.data = data

    def evaluate(self, t, p, v, a):
        """f, Φ, G and ρ at a state."""
        zero = np.zeros(self.nc)
        return self.part.force(self.model, self.data, t, p, v, a), zero, np.zeros((self.nv, self.nc)), zero

    def acceleration_bias(self, t, p, v):
        return np.zeros(self.nc)


def parts_of(parameter: Parameter, system, step) -> list[tuple[float, Any]]:
    """Pairs (weight, part) whose sum is the derivative by a parameter; empty if it is not known.

    Forces jump where those of the `system` do.
    """
    if parameter.part is None:
        return []
    kind, *where = parameter.part(parameter.value)
    if kind == "nodes":
        return [(1.0, _nodes(system, *where))]
    if kind == "held":
        return _held(system, *where)
    step = CLOSE * step
    for _, weights in SIDES:
        changes = {m * step: weight / step for m, weight in weights.items()}
        try:
            each = [(weight, parameter.part(parameter.value + change)) for change, weight in changes.items()]
        except InputError:  # at a bound
            continue
        if kind == "force":
            return [(weight, Pull(_bound(record, system))) for weight, (_, record) in each]
        rates = sum(weight * part[-1] for weight, part in each)
        return [(1.0, Gravity(rates) if kind == "gravity" else Inertial(each[0][1][1], rates))]
    return []


def _bound(record, system):
    bound = record.bind(system.model)
    bound.set_breakpoints(system.breakpoints)
    if isinstance(bound, BoundPiecewise):
        bound.on_steps(None, *system.steps_from)
    return bound


def _held(system, label, nodes):
    """The derivative by torques of a table; not known if the run goes backwards through it."""
    *_, record = records_of(system.mechanism)[label]
    table = system.forces[label]
    if not table.in_order:
        return []
    columns = columns_of(system.model, record.joints, "HeldTorque")
    return [(1.0, HeldNodes(table, system.nv, [(row, int(columns[column])) for row, column in nodes]))]


def _nodes(system, record, path, nodes) -> Nodes:
    """The derivative of a record's force by values of the table at a path."""
    table, sides = part_at(record, path), []
    step = CLOSE * difference_step(max(map(abs, table.values)))
    for m, weight in OF_STEPS.items():
        moved = replace(table, values=tuple(value + m * step for value in table.values))
        sides.append((weight / step, Pull(_bound(with_number(record, path, moved), system))))
    return Nodes(table.times, sides, nodes)
