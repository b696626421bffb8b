"""The numbers in a record, addressed by paths."""

import dataclasses
from collections.abc import Mapping
from dataclasses import replace

from ..errors import InputError


def path_of(record, label, name) -> tuple:
    """The path to the number with this name in a record; its last word is enough if it is unique."""
    numbers = numbers_of(record)
    found = [path for path in numbers if ".".join(path) == name] or [path for path in numbers if path[-1] == name]
    if len(found) == 1:
        return found[0]
    there = ", ".join(".".join(path) for path in found or numbers) or "none"
    raise InputError(f"{label!r} has {'several numbers' if found else 'no number'} {name!r}; it has {there}")


def numbers_of(record) -> list[tuple]:
    """The paths to all numbers in a record and its parts."""
    if _is_number(record):
        return [()]
    return [(name, *path) for name, part in _parts(record).items() for path in numbers_of(part)]


def has_number(record, path) -> bool:
    """Whether there is a number at a path."""
    return _is_number(part_at(record, path))


def with_number(record, path, value):
    """The record with another number at a path."""
    if not path:
        return value
    name, *rest = path
    changed = with_number(_parts(record).get(name), rest, value)
    if isinstance(record, tuple):
        return (*record[: int(name)], changed, *record[int(name) + 1 :])
    return replace(record, **{name: changed}) if dataclasses.is_dataclass(record) else {**record, name: changed}


def _is_number(record) -> bool:
    return isinstance(record, float | int) and not isinstance(record, bool)


def part_at(record, path):
    """The part at a path, or None."""
    for name in path:
        record = _parts(record).get(name)
    return record


def _parts(record) -> dict:
    """The parts of a tuple, a mapping or a record, by name."""
    if isinstance(record, tuple):
        return {str(i): part for i, part in enumerate(record)}
    if not dataclasses.is_dataclass(record):
        return dict(record) if isinstance(record, Mapping) else {}
    parts = {each.name: (getattr(record, each.name), each.type) for each in dataclasses.fields(record)}
    return {name: 0.0 if part is None and kind == "float | None" else part for name, (part, kind) in parts.items()}
