"""Records of a loop file: mappings whose keys are the fields of one of the package's own records."""

from __future__ import annotations

import dataclasses

from ..errors import FormatError, InputError
from ..mechanism.constraints.motion import Motion
from .reading import bound, finite, near, shown


def record_of(make, entry: dict, element: str, prefix: str = ""):
    """The record that a mapping of a file stands for; a key without a value counts as missing.

    Parameters
    ----------
    make : type
        A dataclass; the annotations of its fields say how they are read.
    entry : dict
        Field → plain data.
    element : str
        By what name messages speak of the record.
    prefix : str
        What the record's own messages begin with, to be left out.

    Raises
    ------
    FormatError
        Unknown or missing keys, values of the wrong kind, or what the record itself refuses.
    """
    fields = {each.name: each for each in dataclasses.fields(make) if each.type not in NOT_IN_FILES}
    known_keys(entry, fields, element)
    given = {}
    for key, field in fields.items():
        value = entry.get(key)
        if value is not None:
            given[key] = READERS[field.type](value, f"{element}: {key}")
        elif field.default is dataclasses.MISSING:
            raise FormatError(f"{key!r} is missing", element=element)
    try:
        return make(**given)
    except InputError as error:
        raise FormatError(str(error).removeprefix(prefix), element=element) from error


def known_keys(entry: dict, keys, element: str) -> None:
    """Raise FormatError for a key that is none of `keys`, with what it may have meant."""
    for key in entry:
        if key not in keys:
            raise FormatError(f"the key {shown(key)} is not known{near(key, keys)}", element=element)


def mapping(value, element: str, example: str) -> dict:
    """A mapping, or FormatError with an example of its keys."""
    if not isinstance(value, dict):
        raise FormatError(f"keys such as {example} are needed, not {shown(value)}", element=element)
    return value


def name(value, element: str) -> str:
    """A name, or FormatError."""
    if not isinstance(value, str) or not value:
        raise FormatError(f"a name is needed, not {shown(value)} (quote names that look like numbers)", element=element)
    if not value.isprintable():  # messages show it, and a terminal would obey it
        raise FormatError(f"the name {shown(value)} has characters that cannot be printed", element=element)
    return value


def number(value, element: str) -> float:
    """A finite number, or FormatError."""
    result = finite(value)
    if result is None:
        raise FormatError(f"a finite number is needed, not {shown(value)}{bound(value)}", element=element)
    return result


def numbers(value, element: str) -> tuple[float, ...]:
    """A list of finite numbers, or FormatError."""
    if not isinstance(value, list):
        raise FormatError(f"a list of numbers is needed, not {shown(value)}", element=element)
    return tuple(number(each, element) for each in value)


def number_or_numbers(value, element: str):
    """A finite number or a list of them, or FormatError."""
    return numbers(value, element) if isinstance(value, list) else number(value, element)


def motion(value, element: str) -> Motion:
    """A Motion from the mapping of its fields, of which there is at least one, or FormatError."""
    if not value:
        keys = ", ".join(each.name for each in dataclasses.fields(Motion))
        raise FormatError(f"a motion needs one or more of {keys}", element=element)
    return record_of(Motion, value, element)


def _triple(value, element):
    if not isinstance(value, list) or len(value) != 3:
        raise FormatError(f"three numbers are needed, not {shown(value)}", element=element)
    return numbers(value, element)


def _number_or_motion(value, element):
    return motion(value, element) if isinstance(value, dict) else number(value, element)


def _amounts(value, element, read=number_or_numbers):
    if not isinstance(value, dict) or not value:
        raise FormatError(f"joint names with a number each are needed, not {shown(value)}", element=element)
    return {name(joint, element): read(each, f"{element}: {joint}") for joint, each in value.items()}


def _torques(value, element):
    def torque(value, element):
        return motion(value, element) if isinstance(value, dict) else number_or_numbers(value, element)

    return _amounts(value, element, torque)


READERS = {
    "str": name,
    "float": number,
    "float | None": number,
    "float | Callable": _number_or_motion,
    "tuple[float, ...]": numbers,
    "tuple[float, float, float]": _triple,
    "tuple[float, float, float] | None": _triple,
    "tuple[float, float, float] | Callable": _triple,
    "Mapping[str, float | tuple] | tuple[float, ...]": _amounts,
    "Mapping[str, float | tuple | Callable] | tuple[float, ...]": _torques,
}
"""How a field is read, by its annotation; what is left out here cannot stand in a file."""
NOT_IN_FILES = ("Callable | None",)
