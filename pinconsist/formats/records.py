"""The records under ``loops``, ``forces`` and ``contacts`` in a loop file, read and written.

A loop closure has the fields of :class:`~pinconsist.Loop`, ``kind: coupling`` those of :class:`~pinconsist.Coupling`,
and ``kind: drive`` a joint and the fields of a :class:`~pinconsist.Motion`, or those of a :class:`~pinconsist.Curve`
under ``curve``::

    loops:
      - {name: tip, kind: hinge, frame1: coupler_tip, frame2: rocker_tip, axis: [0, 1, 0]}
      - {name: gears, kind: coupling, joint: wheel, other: crank, ratio: -2.5}
      - {name: motor, kind: drive, joint: crank, start: -1.0, speed: 3.0, amplitude: 0.2, frequency: 1.5}
      - {name: lift, kind: drive, joint: slider, curve: {law: step5, times: [0, 0.5, 1], values: [0, 0.2, 0]}}

A force has ``kind`` and the fields of its record in :mod:`pinconsist.mechanism.forces`::

    forces:
      - {kind: damping, coefficients: {crank: 0.1, ball: [0.1, 0.1, 0.2]}}
      - {kind: friction, coefficients: {crank: 0.5}, width: 1.0e-5}
      - {kind: spring, joint: crank, stiffness: 20.0, rest: 0.3}
      - {kind: spring-damper, frame1: tip, stiffness: 500.0, length: 0.4, damping: 2.0, xyz2: [0, 0, 1]}
      - {kind: bushing, frame1: engine, frame2: hull, stiffness: [1.0e5, 1.0e5, 2.0e5, 100, 100, 100]}
      - {kind: torque, torques: {crank: 2.0, rocker: {amplitude: 3.0, frequency: 0.5}}}
      - {kind: servo, joint: crank, target: {start: 0.1, speed: 2.0}, stiffness: 100.0, damping: 5.0}
      - {kind: wrench, frame: tip, force: [0, 0, -10], axes: world}

A contact has ``kind`` and the fields of its record in :mod:`pinconsist.mechanism.contacts`::

    contacts:
      - {kind: stop, joint: boom, upper: 0.9, restitution: 0.2}
      - {kind: rope, name: sling, frame1: hook, frame2: load, length: 1.5}
      - {kind: contact, name: heel, frame: foot, xyz: [0, 0, -0.26], friction: [0.8, 0.6]}
      - {kind: dry-friction, joint: elbow, friction: [1.3, 1.0]}

Where code takes a number or a function of time, a file takes a number, the fields of a Motion (with ``law: sine`` or
without), or those of a Curve: a ``law`` (``spline``, ``step5``, ``cycloid`` or ``table``), ``times`` and ``values``.
"""

import dataclasses
from collections.abc import Mapping

import numpy as np

from ..errors import FormatError, InputError
from ..mechanism import forces as laws
from ..mechanism.contacts import CONTACTS
from ..mechanism.curve import LAWS, Curve
from ..mechanism.forces.actuators import Table
from ..mechanism.joint_constraints import Coupling, Drive, JointConstraint
from ..mechanism.loops import LOOP_KINDS, Loop
from ..mechanism.motion import Motion
from ..mechanism.names import by_joint
from .reading import bound, finite, located, near, short_repr

LOOPS = {kind: Loop for kind in LOOP_KINDS} | {"coupling": Coupling, "drive": Drive}
FORCES = {"damping": laws.JointDamping, "friction": laws.JointFriction, "spring": laws.JointSpring}
FORCES |= {"spring-damper": laws.SpringDamper, "bushing": laws.Bushing, "torque": laws.JointTorque, "servo": laws.Servo}
FORCES |= {"wrench": laws.Wrench, "actuator": laws.Actuator}
_MOTION = tuple(each.name for each in dataclasses.fields(Motion))
_CODE_ONLY = "Callable | None"  # annotation of fields that a file cannot hold


def loop_record(number: int, entry):
    """The Loop, Coupling or Drive of record `number`, counted from 1; FormatError if it is invalid."""
    entry = dict(mapping(entry, loop_element(number), "name, kind, frame1"))
    given = entry.get("name")
    element = loop_element(number, given)
    kind = _kind(entry, LOOPS, element)
    if kind in LOOP_KINDS:
        return record_of(Loop, entry | {"kind": kind}, element, f"loop {given!r}: ")
    if kind == "coupling":
        return record_of(Coupling, entry, element, f"coupling {given!r}: ")
    known_keys(entry, ("name", "joint", "curve", *_MOTION), element)
    names = [name(_field(entry, key, element), f"{element}: {key}") for key in ("name", "joint")]
    given = {key: entry[key] for key in entry if key in _MOTION}
    if (curve := entry.get("curve")) is not None:
        if given:
            raise FormatError(f"{next(iter(given))!r} belongs under 'curve' here", element=element)
        given, element = mapping(curve, f"{element}: curve", "law, times, values"), f"{element}: curve"
    return Drive(*names, motion(given, element))


def force_record(number: int, entry):
    """The force of record `number`, counted from 1; FormatError if it is invalid."""
    entry = dict(mapping(entry, force_element(number), "kind, joint, stiffness"))
    kind = _kind(entry, FORCES, force_element(number))
    return record_of(FORCES[kind], entry, f"force {number} ({kind})")


def contact_record(number: int, entry):
    """The contact of record `number`, counted from 1; FormatError if it is invalid."""
    entry = dict(mapping(entry, f"contact {number}", "kind, joint, upper"))
    kind = _kind(entry, CONTACTS, f"contact {number}")
    element = f"contact {number} ({kind})"
    return record_of(CONTACTS[kind], entry, element, f"{kind} {entry.get('name') or entry.get('joint')!r}: ")


def loop_element(number: int, given=None) -> str:
    """The name that messages use for loop `number`, which includes the name in its record."""
    return f"loop {number} {given!r}" if isinstance(given, str) else f"loop {number}"


def force_element(number: int, force=None) -> str:
    """The name that messages use for force `number`."""
    kinds = [kind for kind, make in FORCES.items() if isinstance(force, make)]
    return f"force {number} ({kinds[0]})" if kinds else f"force {number}"


def loop_entries(mechanism) -> list[dict]:
    """The records under ``loops`` as plain data; InputError for user-defined functions and constraints."""
    entries = []
    for loop in mechanism.loops:
        what = f"{mechanism.name}: {loop.kind} {loop.name!r}"
        if not isinstance(loop, Loop | JointConstraint):
            reason = "is a user-defined function, which a file cannot store; remove it by with_loops()"
            raise InputError(f"{what} {reason}")
        entry = {"name": loop.name, "kind": loop.kind} | _fields(loop, what)
        if isinstance(loop, Drive) and isinstance(loop.curve, Motion):
            entry |= entry.pop("curve")
        entries.append(entry)
    return entries


def force_entries(mechanism) -> list[dict]:
    """The records under ``forces`` as plain data; InputError for user-defined forces and functions."""
    entries = []
    for force in mechanism.forces:
        what = f"{mechanism.name}: the force {laws.label_of(force)!r}"
        kind = next((kind for kind, make in FORCES.items() if type(force) is make), None)
        if kind is None:
            raise InputError(f"{what} is a user-defined function, which a file cannot store; leave it out")
        field = next((each.name for each in dataclasses.fields(force) if each.type.startswith("Mapping")), None)
        if field and not isinstance(values := getattr(force, field), Mapping):  # one number for each velocity
            shares = {joint: share for joint, share in by_joint(mechanism, values).items() if np.any(share)}
            force = dataclasses.replace(force, **{field: shares})
        entries.append({"kind": kind} | _fields(force, what))
    return entries


def contact_entries(mechanism) -> list[dict]:
    """The records under ``contacts`` as plain data."""
    return [{"kind": each.kind} | _fields(each, f"{each.kind} {each.name!r}") for each in mechanism.contacts]


def _fields(record, what):
    """The fields of a record that differ from their defaults."""
    return {
        each.name: _plain(value, f"{what}: {each.name}")
        for each in dataclasses.fields(record)
        if (value := getattr(record, each.name)) != each.default
    }


def _plain(value, what):
    if isinstance(value, Motion):
        return _fields(value, what) or {"start": 0.0}
    if isinstance(value, Curve):
        return {"law": value.law, "times": list(value.times), "values": list(value.values)}
    if isinstance(value, Table):
        return {"law": "table", "times": list(value.times), "values": list(value.values)}
    if isinstance(value, Mapping):
        return {joint: _plain(each, f"{what}: {joint}") for joint, each in value.items()}
    if isinstance(value, str):
        return value
    if callable(value):
        raise InputError(
            f"{what} is a user-defined function, which a file cannot store; it can store a Motion or a Curve"
        )
    return [float(each) for each in value] if isinstance(value, tuple) else float(value)


def record_of(make, entry: dict, element: str, prefix: str = ""):
    """The record of class `make` from a mapping, or FormatError; a key without a value counts as missing.

    The annotations of its fields determine how they are read. If a message of the class starts with `prefix`, this is
    removed.
    """
    fields = {each.name: each for each in dataclasses.fields(make) if each.type != _CODE_ONLY}
    known_keys(entry, fields, element)
    values = {
        key: _value(_field(entry, key, element), field.type, f"{element}: {key}")
        for key, field in fields.items()
        if field.default is dataclasses.MISSING or entry.get(key) is not None
    }
    with located(element=element, prefix=prefix):
        return make(**values)


def motion(value, element: str) -> Motion | Curve:
    """The Motion or the Curve of a mapping; FormatError if it is neither."""
    law = value.get("law", "sine" if value and not {"times", "values"} & set(value) else None)
    if law == "sine":
        value = {key: each for key, each in value.items() if key != "law"}
    elif law is not None:
        if law not in LAWS:
            raise FormatError(f"unknown law {short_repr(law)}; choose from sine, {', '.join(LAWS)}", element=element)
        return record_of(Curve, value, element, "curve: ")
    if not value:
        raise FormatError(f"a motion needs one or more of {', '.join(_MOTION)}", element=element)
    if law is None:
        raise FormatError(f"'law' is missing; choose from {', '.join(LAWS)}", element=element)
    return record_of(Motion, value, element)


def known_keys(entry: dict, keys, element: str) -> None:
    """Raise FormatError, with similar keys, for a key that is not one of `keys`."""
    for key in entry:
        if key not in keys:
            raise FormatError(f"the key {short_repr(key)} is not known{near(key, keys)}", element=element)


def mapping(value, element: str, example: str) -> dict:
    """A mapping, or FormatError with an example of its keys."""
    if not isinstance(value, dict):
        raise FormatError(f"keys such as {example} are needed, not {short_repr(value)}", element=element)
    return value


def name(value, element: str) -> str:
    if not isinstance(value, str) or not value:
        raise FormatError(
            f"a name is needed, not {short_repr(value)} (quote names that look like numbers)", element=element
        )
    if not value.isprintable():  # a terminal would execute control characters in a message
        raise FormatError(f"the name {short_repr(value)} has unprintable characters", element=element)
    return value


def items(record: dict, key: str) -> list:
    """The list under a key, empty if there is none, or FormatError."""
    value = record.get(key)
    if not isinstance(value, list | None):
        raise FormatError(f"a list is needed, not {short_repr(value)}", element=key)
    return value or []


def number(value, element: str) -> float:
    if (result := finite(value)) is None:
        raise FormatError(f"a finite number is needed, not {short_repr(value)}{bound(value)}", element=element)
    return result


def numbers(value, element: str, count: int = 0) -> tuple[float, ...]:
    """A list of finite numbers, three if `count` is 3, or FormatError."""
    if not isinstance(value, list) or count not in (0, len(value)):
        what = "three numbers are" if count == 3 else "a list of numbers is"
        raise FormatError(f"{what} needed, not {short_repr(value)}", element=element)
    return tuple(number(each, element) for each in value)


def amount(value, element: str, kind: str = "tuple"):
    """A finite number, or a list of numbers or a Motion if the annotation `kind` includes a tuple or a function."""
    if isinstance(value, dict) and "Callable" in kind:
        return motion(value, element)
    return numbers(value, element) if isinstance(value, list) and "tuple" in kind else number(value, element)


def _value(value, kind, element):
    """A field's value from plain data, according to the annotation of the field."""
    if kind == "str" or (kind.startswith("str") and not isinstance(value, dict)):
        return name(value, element)
    if kind.startswith("tuple"):
        return numbers(value, element, count=3 * ("float, float, float" in kind))
    if "Mapping" not in kind:
        return amount(value, element, kind)
    if not isinstance(value, dict) or not value:
        raise FormatError(f"a mapping of joint names to numbers is needed, not {short_repr(value)}", element=element)
    return {name(joint, element): amount(each, f"{element}: {joint}", kind) for joint, each in value.items()}


def _field(entry, key, element):
    if (value := entry.get(key)) is None:
        raise FormatError(f"{key!r} is missing", element=element)
    return value


def _kind(entry, kinds, element):
    kind = _field(entry, "kind", element)
    if kind not in tuple(kinds):
        raise FormatError(f"unknown kind {short_repr(kind)}; choose from {', '.join(kinds)}", element=element)
    return entry.pop("kind")
