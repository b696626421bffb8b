"""What all readers of files share."""

from __future__ import annotations

import hashlib
import math
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from ..errors import FormatError
from ..mechanism.names import near as alike

LARGEST = 1e30
"""No number of a scene is larger, but for limits: products of some such numbers still have room in a float."""

_read: ContextVar[list | None] = ContextVar("files read", default=None)


@contextmanager
def files_read():
    """Within the block, the list of (path, SHA-256) of the files that are read."""
    found = []
    before = _read.set(found)
    try:
        yield found
    finally:
        _read.reset(before)


def read_bytes(path: Path, limit: int) -> bytes:
    """The content of a regular file of at most `limit` bytes, or FormatError."""
    try:
        if not path.exists():
            raise FormatError("no such file", path=path)
        if not path.is_file():
            raise FormatError("a file is needed, this is a folder or a device", path=path)
        with path.open("rb") as file:
            content = file.read(limit + 1)
    except (OSError, ValueError) as error:
        if isinstance(error, FormatError):
            raise
        raise FormatError(f"cannot be read: {error}", path=path) from error
    if len(content) > limit:
        raise FormatError(f"more than {limit // 1_000_000} MB, which is too large for a file of this kind", path=path)
    if (noted := _read.get()) is not None:
        noted.append((path.absolute(), hashlib.sha256(content).hexdigest()))
    return content


def near(name: object, names) -> str:
    """The end of a message about an unknown name: what it may have meant, or what there is."""
    names = sorted(set(names))
    listed = f"; there are: {', '.join(names[:12])}{', …' if len(names) > 12 else ''}" if names else ""
    return alike(name, names) or listed


def shown(value: object) -> str:
    """A value of a file for a message, cut to a readable length."""
    try:
        text = repr(value)
    except ValueError:  # Python does not write out integers of thousands of digits
        text = "a very long number"
    return text if len(text) <= 80 else text[:77] + "…"


def finite(value: object, largest: float = LARGEST) -> float | None:
    """A number from a number or its text; None where it is neither, not finite, or larger than any scene needs."""
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        return None
    try:
        number = float(value)
    except (ValueError, OverflowError):
        return None
    return number if math.isfinite(number) and abs(number) <= largest else None


def bound(*values: object) -> str:
    """The end of a message about values that are no finite numbers: the largest there may be, if that is the reason."""
    immense = any(finite(value) is None and finite(value, math.inf) is not None for value in values)
    return f" (they go up to {LARGEST:g})" if immense else ""
