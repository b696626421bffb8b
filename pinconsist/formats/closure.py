"""``closure=`` of load: all loops of a scene closed in one way."""

from __future__ import annotations

from dataclasses import replace

from ..errors import InputError

CLOSURES = ("point", "frame", "hinge")


def check_closure(closure) -> None:
    """Raise InputError for what is no way to close a loop."""
    if closure is not None and closure not in CLOSURES:
        raise InputError(f"closure={closure!r} is not one of {', '.join(CLOSURES)}")


def closed_by(loops, closure) -> tuple:
    """The points, frames and hinges, closed in another way where one is given; other kinds and records stay."""
    if closure is None:
        return tuple(loops)
    return tuple(_closed(loop, closure) if loop.kind in CLOSURES else loop for loop in loops)


def _closed(loop, closure):
    return replace(loop, kind=closure, axis=loop.axis if closure == "hinge" else None)
