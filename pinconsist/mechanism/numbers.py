"""The numbers in a record, by their paths."""

import dataclasses
from collections.abc import Mapping
from dataclasses import replace

from ..errors import InputError


def path_of(record, label, name) -> tuple:
    """The path to the number of this name in a record; its last word is enough where there is one such number."""
    path = tuple(name.split("."))
    if has_number(record, path):
        return path
    numbers = numbers_of(record)
    found = [path for path in numbers if path[-1] == name]
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
    changed = with_number(_part(record, name), rest, value)
    if isinstance(record, tuple):
        return (*record[: int(name)], changed, *record[int(name) + 1 :])
    return replace(record, **{name: changed}) if dataclasses.is_dataclass(record) else {**record, name: changed}


def _is_number(record) -> bool:
    return isinstance(record, float | int) and not isinstance(record, bool)


def part_at(record, path):
    """What there is at a path, or None."""
    for name in path:
        record = _part(record, name)
    return record


def _part(record, name):
    if isinstance(record, tuple):
        return record[int(name)] if name.isdecimal() and int(name) < len(record) else None
    if not dataclasses.is_dataclass(record):
        return record.get(name) if isinstance(record, Mapping) else None
    field = record.__dataclass_fields__.get(name)
    return None if field is None else _of_field(getattr(record, name), field)


def _parts(record) -> dict:
    if isinstance(record, tuple):
        return {str(i): part for i, part in enumerate(record)}
    if not dataclasses.is_dataclass(record):
        return dict(record) if isinstance(record, Mapping) else {}
    return {each.name: _of_field(getattr(record, each.name), each) for each in dataclasses.fields(record)}


def _of_field(part, field):
    return 0.0 if part is None and field.type == "float | None" else part
