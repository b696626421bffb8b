"""Names that a user may have meant."""

from __future__ import annotations

import difflib


def similar(name, names) -> list[str]:
    """Up to four of `names` that resemble a name."""
    return difflib.get_close_matches(str(name), sorted(set(names)), n=4, cutoff=0.5)


def near(name, names) -> str:
    """``"; near it: …"`` for the end of a message; empty where nothing resembles."""
    found = ", ".join(similar(name, names))
    return f"; near it: {found}" if found else ""
