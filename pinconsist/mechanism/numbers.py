"""The numbers in a record, by their paths."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

from ..errors import InputError


def path_of(record, label, name) -> tuple:
    """The path to the number of this name in a record; its last word is enough where there is one such number."""
    numbers = list(numbers_of(record))
    found = [path for path in numbers if ".".join(path) == name] or [path for path in numbers if path[-1] == name]
    if len(found) == 1:
        return found[0]
    there = ", ".join(".".join(path) for path in found or numbers) or "none"
    raise InputError(f"{label!r} has {'several numbers' if found else 'no number'} {name!r}; it has {there}")


def numbers_of(record) -> dict[tuple, tuple[float, Callable]]:
    """Path → (value, function that returns the record with another one), of all numbers in a record and its parts."""
    if isinstance(record, float | int) and not isinstance(record, bool):
        return {(): (record, lambda value: value)}
    parts = dict(record) if isinstance(record, Mapping) else {}
    if isinstance(record, tuple):
        parts = {str(i): part for i, part in enumerate(record)}
    elif dataclasses.is_dataclass(record):
        kinds = {each.name: each.type for each in dataclasses.fields(record)}
        parts = {name: getattr(record, name) for name in kinds}
        parts |= {name: 0.0 for name, part in parts.items() if part is None and kinds[name] == "float | None"}

    def put(name, change, value):
        changed = {name: change(value)}
        if dataclasses.is_dataclass(record):
            return replace(record, **changed)
        return tuple((parts | changed).values()) if isinstance(record, tuple) else parts | changed

    return {
        (name, *path): (found, partial(put, name, change))
        for name, part in parts.items()
        for path, (found, change) in numbers_of(part).items()
    }
