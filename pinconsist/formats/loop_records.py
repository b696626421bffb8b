"""The records under ``loops`` in a loop file: loop closures, couplings and drives.

A closure has the fields of :class:`~pinconsist.mechanism.constraints.loop.Loop`, ``kind: coupling`` those of
:class:`~pinconsist.mechanism.constraints.coupling.Coupling`, and ``kind: drive`` a joint and the fields of a
:class:`~pinconsist.mechanism.constraints.motion.Motion`::

    loops:
      - {name: tip, kind: hinge, frame1: coupler_tip, frame2: rocker_tip, axis: [0, 1, 0]}
      - {name: gears, kind: coupling, joint: wheel, other: crank, ratio: -2.5}
      - {name: motor, kind: drive, joint: crank, start: -1.0, speed: 3.0, amplitude: 0.2, frequency: 1.5}
"""

from __future__ import annotations

import dataclasses

from ..errors import FormatError
from ..mechanism.constraints.coupling import Coupling
from ..mechanism.constraints.drive import Drive
from ..mechanism.constraints.loop import ROW_NAMES, Loop
from ..mechanism.constraints.motion import Motion
from .reading import shown
from .records import known_keys, mapping, motion, name, record_of

KINDS = (*ROW_NAMES, "coupling", "drive")
_MOTION = tuple(each.name for each in dataclasses.fields(Motion))


def loop_record(number: int, entry):
    """The Loop, Coupling or Drive of the record at place `number`, counted from 1; FormatError where it is none."""
    entry = mapping(entry, loop_element(number), "name, kind, frame1")
    given = entry.get("name")
    element = loop_element(number, given)
    for key in ("name", "kind"):
        if entry.get(key) is None:
            raise FormatError(f"{key!r} is missing", element=element)
        name(entry[key], f"{element}: {key}")
    kind = entry["kind"]
    if kind not in KINDS:
        raise FormatError(f"unknown kind {shown(kind)}; known are {', '.join(KINDS)}", element=element)
    if kind in ROW_NAMES:
        return record_of(Loop, entry, element, f"loop {given!r}: ")
    rest = {key: value for key, value in entry.items() if key != "kind"}
    if kind == "coupling":
        return record_of(Coupling, rest, element, f"coupling {given!r}: ")
    return _drive(rest, element)


def loop_element(number: int, given=None) -> str:
    """By what name messages speak of the loop at place `number`, with the name that its record gives."""
    return f"loop {number} {given!r}" if isinstance(given, str) else f"loop {number}"


def _drive(entry, element):
    joint = entry.get("joint")
    if joint is None:
        raise FormatError("'joint' is missing", element=element)
    known_keys(entry, ("name", "joint", *_MOTION), element)
    curve = motion({key: value for key, value in entry.items() if key in _MOTION}, element)
    return Drive(entry["name"], name(joint, f"{element}: joint"), curve)
