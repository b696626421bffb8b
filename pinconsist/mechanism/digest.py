"""Whether two mechanisms are the same, by short texts that a file can hold."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
from collections.abc import Mapping

import numpy as np


def digests(mechanism) -> dict[str, str]:
    """SHA-256 of ``model`` (as this version of Pinocchio writes it), ``loops``, ``forces`` and ``guess``.

    User-defined functions and objects are identified by their names alone.
    """
    parts = {"model": mechanism.model.saveToString()}
    parts |= {name: repr(_plain(getattr(mechanism, name))) for name in ("loops", "forces", "guess")}
    return {name: hashlib.sha256(text.encode()).hexdigest() for name, text in parts.items()}


def _plain(value):
    """An equivalent of `value` that has the same `repr` in every process."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = [field.name for field in dataclasses.fields(value)]
        return type(value).__name__, [(name, _plain(getattr(value, name))) for name in fields]
    if isinstance(value, Mapping):
        return [(key, _plain(each)) for key, each in value.items()]
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if value is None or isinstance(value, str | bool | int | float):
        return value
    if isinstance(value, functools.partial):
        return "partial", _plain(value.func), _plain(value.args), _plain(value.keywords)
    named = value if hasattr(value, "__qualname__") else type(value)
    return f"{named.__module__}.{named.__qualname__}"
