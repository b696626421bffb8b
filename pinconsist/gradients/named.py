"""Parameters by name, as functions of their values."""

from collections.abc import Mapping

import numpy as np

from ..errors import InputError
from ..mechanism.checks import coordinates
from ..mechanism.numbers import part_at
from ..mechanism.parameters import Parameter, parameter

SPEED = "_speed"


def named_start(mechanism, names, q0, v0):
    """(build, names, theta, q0, v0) of a mechanism and names of its parameters, as functions of theta."""
    if isinstance(names, str) or not all(isinstance(name, str) for name in names):
        raise InputError(f"of a mechanism, parameters are given by their names, got {names!r}")
    names = tuple(names)
    places = {joint + SPEED: ("v0", joint, v0) for joint in mechanism.joints}
    places |= {joint: ("q0", joint, q0) for joint in mechanism.joints}
    starts = {i: places[name] for i, name in enumerate(names) if name in places}
    own = {i: name for i, name in enumerate(names) if i not in starts}
    parameters, theta = _parameters(mechanism, own), np.empty(len(names))
    for columns, each in parameters:
        theta[columns] = each.value
    for i, start in starts.items():
        theta[i] = _value_of_start(mechanism, names[i], *start)

    def started(which, given):
        ours = {i: joint for i, (place, joint, _) in starts.items() if place == which}
        if not ours:
            return given
        return lambda values: {**(given or {}), **{joint: float(values[i]) for i, joint in ours.items()}}

    build = Named(mechanism, parameters, np.array([*own], int), theta)
    return build, names, theta, started("q0", q0), started("v0", v0)


class Named:
    """``build(theta)`` of a mechanism and `parameters` of it, with their indices in theta; `own` are all of these."""

    def __init__(self, mechanism, parameters, own, theta):
        self.mechanism, self.parameters, self._own = mechanism, parameters, own
        self._last = theta[own], mechanism

    def __call__(self, values):
        wanted = values[self._own]
        if not np.array_equal(wanted, self._last[0]):  # parameters of the start leave the mechanism the same object
            built = self.mechanism
            for columns, each in self.parameters:
                if np.any(values[columns] != each.value):
                    built = each.put(built, values[columns])
            self._last = wanted, built
        return self._last[1]


def _parameters(mechanism, names: Mapping[int, str]) -> list:
    """(index, parameter) of `names`, by their indices; of values of one table (indices, all of them)."""
    tables: dict[str, list[int]] = {}
    for i, name in names.items():
        stem, _, node = name.rpartition("[")
        tables.setdefault(stem if node[:-1].isdecimal() else name, []).append(i)
    found: list = []
    for members in tables.values():
        each = [names[i] for i in members]
        first = parameter(mechanism, each[0])
        kind, *where = first.part(first.value) if first.part and len(set(each)) == len(each) > 1 else ("",)
        if kind == "nodes":
            found.append((np.array(members), _together(mechanism, each, *where[:2])))
        else:
            found += zip(members, (first, *(parameter(mechanism, name) for name in each[1:])), strict=True)
    return found


def _together(mechanism, names, record, path) -> Parameter:
    """The values of these names in the table at a path of a record."""
    table = part_at(record, path)
    nodes = [int(name[name.rindex("[") + 1 : -1]) for name in names]
    for node, name in zip(nodes, names, strict=True):
        if node >= len(table.values):
            parameter(mechanism, name)  # says what there is
    now = np.array(table.values)[nodes]

    def put(mechanism, values):
        for i in np.flatnonzero(values != now):
            mechanism = parameter(mechanism, names[i]).put(mechanism, values[i])
        return mechanism

    return Parameter(names[0], now, put, lambda _: ("nodes", record, path, nodes))


def _value_of_start(mechanism, name, which, joint, given) -> float:
    """Of a parameter of the start, which is given as a mapping."""
    columns = mechanism.columns(joint)
    if columns.stop - columns.start != 1:
        raise InputError(f"{name} cannot be a parameter: joint {joint!r} has several degrees of freedom")
    if not (given is None or isinstance(given, Mapping)):
        raise InputError(f"{name} is a parameter: give {which}= as a mapping joint name → value, not an array")
    value = 0.0 if which == "v0" else coordinates(mechanism.model, joint, mechanism.guess)[0]
    return float((given or {}).get(joint, value))
