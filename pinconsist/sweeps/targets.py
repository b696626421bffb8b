"""What can be varied in a scene, by name: starts, torques, gravity, settings, and the numbers of loops and forces."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace

from ..errors import InputError
from ..mechanism.checks import near
from ..mechanism.forces import bound_forces, model_forces
from ..mechanism.mechanism import Mechanism

SETTINGS = ("rtol", "atol", "step", "until")
AXES = {f"gravity.{axis}": i for i, axis in enumerate("xyz")}
OPTIONAL = "float | None"


@dataclass
class Run:
    """What `simulate` is to be called with; targets change it."""

    mechanism: Mechanism
    until: float
    q0: dict = field(default_factory=dict)
    v0: dict = field(default_factory=dict)
    torques: dict = field(default_factory=dict)
    options: dict = field(default_factory=dict)


def target(mechanism: Mechanism, name: str) -> Callable[[Run, float], None]:
    """How a number is put under a name into a run.

    Parameters
    ----------
    mechanism : Mechanism
    name : str
        A joint of one degree of freedom (its initial position, rad or m), ``<joint>_speed`` (its initial velocity),
        ``<joint>_torque`` (a constant torque on it beside the scene's forces); ``<loop or force>.<number>``, by the
        names of the scene file, such as ``gear.ratio``, ``motor.speed``, ``spring crank.stiffness``; ``gravity.x``,
        ``gravity.y``, ``gravity.z`` (m/s²); ``rtol``, ``atol``, ``step``, ``until``.

    Returns
    -------
    callable
        ``put(run, value)``.

    Raises
    ------
    InputError
        Nothing has this name.
    """
    for joint, kind in ((name, "q0"), (name.removesuffix("_speed"), "v0"), (name.removesuffix("_torque"), "torques")):
        if joint in mechanism.joints and (kind == "q0" or joint != name):
            columns = mechanism.columns(joint)
            if columns.stop - columns.start != 1:
                raise InputError(f"{name} cannot be varied: joint {joint!r} has several degrees of freedom")
            return lambda run, value: getattr(run, kind).__setitem__(joint, value)
    if name in SETTINGS:
        return lambda run, value: _set(run, name, value)
    if name in AXES:
        return lambda run, value: _pull(run, AXES[name], value)
    for label, (place, i) in _records(mechanism).items():
        if name.startswith(f"{label}."):
            path = _path(getattr(mechanism, place)[i], label, name[len(label) + 1 :])
            return lambda run, value: _change(run, place, i, path, value)
    raise InputError(_unknown(mechanism, name))


def _set(run, name, value):
    if name == "until":
        run.until = value
    else:
        run.options[name] = value


def _pull(run, axis, value):
    gravity = run.mechanism.model.gravity.linear.copy()
    gravity[axis] = value
    run.mechanism = run.mechanism.with_gravity(gravity)


def _change(run, place, i, path, value):
    records = list(getattr(run.mechanism, place))
    records[i] = _with(records[i], path, value)
    run.mechanism = replace(run.mechanism, **{place: records})


def _records(mechanism) -> dict:
    """Name → where the record stands, of all loops and forces, the longest names first."""
    own = len(model_forces(mechanism.model))
    labels = list(bound_forces(mechanism.model, mechanism.forces))[own:]
    found = {label: ("forces", i) for i, label in enumerate(labels)}
    found |= {loop.name: ("loops", i) for i, loop in enumerate(mechanism.loops)}
    return dict(sorted(found.items(), key=lambda item: -len(item[0])))


def _path(record, label, name) -> tuple:
    """The way to the number of this name in a record; its last word will do where there is one such number."""
    numbers = list(_numbers(record))
    whole = [path for path in numbers if ".".join(path) == name]
    short = [path for path in numbers if path[-1] == name]
    if len(found := whole or short) == 1:
        return found[0]
    there = ", ".join(".".join(path) for path in found or numbers) or "none"
    raise InputError(f"{label!r} has {'several numbers' if found else 'no number'} {name!r}; it has {there}")


def _numbers(record) -> Iterator[tuple]:
    """The ways to all numbers in a record, its mappings and the records in it."""
    if dataclasses.is_dataclass(record):
        for each in dataclasses.fields(record):
            value = getattr(record, each.name)
            if value is None and each.type == OPTIONAL:
                yield (each.name,)
            yield from ((each.name, *path) for path in _numbers(value))
    elif isinstance(record, Mapping):
        for key, value in record.items():
            yield from ((key, *path) for path in _numbers(value))
    elif isinstance(record, tuple):
        for i, value in enumerate(record):
            yield from ((str(i), *path) for path in _numbers(value))
    elif isinstance(record, float | int) and not isinstance(record, bool):
        yield ()


def _with(record, path, value):
    """The record with another number at the end of a way."""
    if not path:
        return value
    first, *rest = path
    if dataclasses.is_dataclass(record):
        return replace(record, **{first: _with(getattr(record, first), rest, value)})
    if isinstance(record, Mapping):
        return {**record, first: _with(record[first], rest, value)}
    i = int(first)
    return (*record[:i], _with(record[i], rest, value), *record[i + 1 :])


def _unknown(mechanism, name) -> str:
    known = [*mechanism.joints, *(f"{joint}_speed" for joint in mechanism.joints), *AXES, *SETTINGS]
    records = _records(mechanism)
    known += [f"{label}.{path[-1]}" for label, (place, i) in records.items()
              for path in _numbers(getattr(mechanism, place)[i])]  # fmt: skip
    joints = ", ".join(mechanism.joints[:12]) + (", …" if len(mechanism.joints) > 12 else "")
    named = ", ".join([*records][:12]) + (", …" if len(records) > 12 else "")
    return (
        f"{mechanism.name} has nothing named {name!r} that could be varied{near(name, known)}. There "
        f"are the joints {joints} (JOINT, JOINT_speed, JOINT_torque), the numbers of {named or 'no loop or force'} "
        f"(NAME.NUMBER), {', '.join(AXES)}, {', '.join(SETTINGS)}"
    )
