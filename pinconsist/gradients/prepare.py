"""The run to be differentiated, and its parameters: by names, or as arguments of a function."""

import inspect
import re
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..errors import InputError, PinconsistError
from ..mechanism.checks import coordinates, finite_array, require_no_contacts
from ..mechanism.mechanism import Mechanism, with_added_forces
from ..mechanism.parameters import Parameter, parameter, part_at, records_of
from ..run.events import as_events
from ..run.simulation import simulate
from .jumps import refuse_jumps, refuse_moving_jumps
from .laws import refuse_black_boxes
from .leg import legs_of
from .variants import OfRun, Side, variants_of

SPEED = "_speed"


def prepared(build, theta, t_span, q0, v0, names, steps, forces, events, rtol, atol, options):
    """(solution, legs, variants, base, names, theta): the run, and its parameters with the mechanisms they need."""
    control = options.pop("control", None)
    if isinstance(build, Mechanism):
        mechanism, control = build if control is None else build.with_control(control), None
        build, names, theta, q0, v0 = named_start(mechanism, theta, q0, v0)
    theta = np.atleast_1d(finite_array(theta, "theta"))
    names = _names(names, theta)
    if steps is not None and len(steps) != len(theta):
        raise InputError(f"steps= needs one for each of the {len(theta)} parameters, got {len(steps)}")
    method = options.pop("method", None)
    if method not in (None, "Radau"):
        raise InputError(
            "derivatives are propagated along steps of Radau IIA, which depend on the state alone, not "
            f"method={method!r}; omit method="
        )
    of_run = OfRun()
    make = _maker(build, t_span[0], of_run, q0, v0, forces, events, control)
    base = make(theta)
    require_no_contacts(base.mechanism, "a differentiated run", ", whose modes would change")
    solution = simulate(
        base.mechanism, t_span, base.q0, base.v0, method="Radau", events=base.events, rtol=rtol, atol=atol,
        **{**options, "dense_output": True},
    )  # fmt: skip
    if solution.sol is None:
        raise PinconsistError(f"the run itself failed: {solution.message}")
    of_run.take(solution.sol.curves[0].system, t_span[0], t_span[1] < t_span[0])  # of all its systems
    legs = legs_of(solution.sol, base.index1)
    for leg in legs:
        leg.system.differentiate_forces()
    refuse_jumps(solution, legs, base)
    first = legs[0].start
    state, parameters = (first.p0, first.v0), getattr(build, "parameters", ())
    end = legs[-1].span[1]  # where time-dependent terms have changed most
    variants = variants_of(make, theta, names, steps, base, legs[0].system, end, *state, parameters)
    refuse_moving_jumps(variants, legs[0].system, t_span[0], end, t_span[1], *state)
    return solution, legs, variants, base, names, theta


def _names(names, theta):
    if theta.ndim != 1 or not len(theta):
        raise InputError(f"theta must be a vector with at least one number, got shape {theta.shape}")
    names = tuple(names) if names is not None else tuple(f"theta[{i}]" for i in range(len(theta)))
    if len(names) != len(theta):
        raise InputError(f"names= needs one for each of the {len(theta)} parameters, got {len(names)}")
    return names


def _maker(build, t, of_run, q0, v0, forces, events, control=None):
    """``make(theta) -> Side``; the same mechanism for the same object that `build` returns."""
    made: dict = {}

    def make(values) -> Side:
        mechanism = build(values.copy())
        if not isinstance(mechanism, Mechanism):
            raise InputError(f"build(theta) must return a Mechanism, it returned a {type(mechanism).__name__}")
        if id(mechanism) not in made:
            commanded = mechanism if control is None else mechanism.with_control(control)
            acting = with_added_forces(commanded, forces, "sensitivities")
            refuse_black_boxes(acting)
            made[id(mechanism)] = mechanism, acting
        acting = made[id(mechanism)][1]
        starts = [value(values.copy()) if callable(value) else value for value in (q0, v0)]
        return Side(
            acting,
            starts[0],
            starts[1],
            t,
            of_run,
            as_events(_of_theta(events, values), acting),
        )

    return make


def _of_theta(events, values):
    """The events; if they are a function of theta, its value."""
    if callable(events) and len(inspect.signature(events).parameters) == 1:
        return events(values.copy())
    return events


def named_start(mechanism, names, q0, v0):
    """(build, names, theta, q0, v0) of a mechanism and names of its parameters, as functions of theta."""
    if isinstance(names, str) or not all(isinstance(name, str) for name in names):
        raise InputError(f"the parameters of a mechanism must be given by their names, got {names!r}")
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
    """``build(theta)`` for `parameters` of a mechanism, with their indices in theta; `own` are all these indices."""

    def __init__(self, mechanism, parameters, own, theta):
        self.mechanism, self.parameters, self._own = mechanism, parameters, own
        self._last = theta[own], mechanism

    def __call__(self, values):
        wanted = values[self._own]
        if not np.array_equal(wanted, self._last[0]):  # with other initial values only, return the same object
            built = self.mechanism
            for columns, each in self.parameters:
                if np.any(values[columns] != each.value):
                    built = each.put(built, values[columns])
            self._last = wanted, built
        return self._last[1]


def _parameters(mechanism, names: Mapping[int, str]) -> list:
    """(index, parameter) of each of the `names`; for values of the same table, one (indices, parameter)."""
    tables: dict[str, list[int]] = {}
    for i, name in names.items():
        tables.setdefault(_stem(name), []).append(i)
    found: list = []
    for members in tables.values():
        each = [names[i] for i in members]
        first = parameter(mechanism, each[0])
        kind, *where = first.part(first.value) if first.part and len(set(each)) == len(each) > 1 else ("",)
        if kind == "nodes":
            found.append((np.array(members), _together(mechanism, each, *where[:2])))
        elif kind == "held":
            found.append((np.array(members), _held_together(mechanism, each, where[0])))
        else:
            found += zip(members, (first, *(parameter(mechanism, name) for name in each[1:])), strict=True)
    return found


def _stem(name) -> str:
    """The name without numbers in brackets at its end."""
    return re.sub(r"(\[\d+\])+$", "", name)


def _held_together(mechanism, names, label: str) -> Parameter:
    """One parameter for all torques with these names in a table of held torques."""
    *_, record = records_of(mechanism)[label]
    numbers = [[int(number) for number in re.findall(r"\d+", name[len(_stem(name)) :])] for name in names]
    nodes = [(row, *(column or [0])) for row, *column in numbers]
    table = np.asarray(record.torques)
    for node, name in zip(nodes, names, strict=True):
        if len(node) != 2 or not (node[0] < table.shape[0] and node[1] < table.shape[1]):
            parameter(mechanism, name)  # raises an error that lists the numbers
    places = tuple(np.array(nodes).T)
    now = table[places]

    def put(mechanism, values):
        place, i, own = records_of(mechanism)[label]
        torques = np.array(own.torques)
        torques[places] = values
        records = list(getattr(mechanism, place))
        records[i] = replace(own, torques=torques)
        return replace(mechanism, **{place: records})

    return Parameter(names[0], now, put, lambda _: ("held", label, nodes))


def _together(mechanism, names, record, path) -> Parameter:
    """One parameter for all values with these names in the table at a path of a record."""
    table = part_at(record, path)
    nodes = [int(name[name.rindex("[") + 1 : -1]) for name in names]
    for node, name in zip(nodes, names, strict=True):
        if node >= len(table.values):
            parameter(mechanism, name)  # raises an error that lists the numbers
    now = np.array(table.values)[nodes]

    def put(mechanism, values):
        for i in np.flatnonzero(values != now):
            mechanism = parameter(mechanism, names[i]).put(mechanism, values[i])
        return mechanism

    return Parameter(names[0], now, put, lambda _: ("nodes", record, path, nodes))


def _value_of_start(mechanism, name, which, joint, given) -> float:
    """The value of a parameter that is an initial value, given as a mapping."""
    columns = mechanism.columns(joint)
    if columns.stop - columns.start != 1:
        raise InputError(f"{name} cannot be a parameter: joint {joint!r} has several degrees of freedom")
    if not (given is None or isinstance(given, Mapping)):
        raise InputError(f"{name} is a parameter: pass {which}= as a mapping joint name → value, not as an array")
    value = 0.0 if which == "v0" else coordinates(mechanism.model, joint, mechanism.guess)[0]
    return float((given or {}).get(joint, value))
