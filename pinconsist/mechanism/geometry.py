"""Where the shapes of a scene come from."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Geometry:
    """Where the shapes of a scene come from; nothing is loaded until something is shown.

    Attributes
    ----------
    urdf : str
        The URDF text, already checked.
    package_dirs : tuple of str
        Folders in which mesh files are looked for.
    """

    urdf: str
    package_dirs: tuple[str, ...] = ()
