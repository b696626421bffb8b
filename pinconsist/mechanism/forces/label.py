"""The names by which reports speak of forces."""

from __future__ import annotations

from collections.abc import Mapping

MOST_NAMED = 3


def label(kind: str, joints) -> str:
    """A kind of force and the joints it names, where they are few: "damping crank, rocker"; else the kind alone."""
    if isinstance(joints, Mapping) and 0 < len(joints) <= MOST_NAMED:
        return f"{kind} {', '.join(joints)}"
    return kind


def unused(wanted: str, taken) -> str:
    """`wanted`, or "wanted 2", "wanted 3", … where that is taken."""
    found, count = wanted, 1
    while found in taken:
        count += 1
        found = f"{wanted} {count}"
    return found
