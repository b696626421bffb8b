"""Robots by name whose files come with other pip packages."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from ..errors import MissingExtraError

_CASSIE = "cassie_description/robots"
ROBOTS = {
    name: f"{_CASSIE}/{name}.sdf"
    for name in ("cassie", "cassie_reduced", "cassie_simple", "cassie_v2", "cassie_wo_gearbox_spring")
}
"""Name → file of the pip package example-robot-data."""

_PACKAGE, _SHARE = "example-robot-data", "cmeel.prefix/share"


def robot_file(name: str) -> tuple[Path, Path]:
    """The file of a robot, and the folder in which its meshes are looked for.

    Raises
    ------
    MissingExtraError
        The package is not installed, or does not hold the file.
    """
    try:
        share = Path(str(distribution(_PACKAGE).locate_file(_SHARE)))
    except PackageNotFoundError:
        raise MissingExtraError(
            f"the files of {name!r} come with the pip package {_PACKAGE}, which is not installed: "
            "pip install 'pinconsist[robots]'"
        ) from None
    path = share / _PACKAGE / "robots" / ROBOTS[name]
    if not path.is_file():
        raise MissingExtraError(f"the pip package {_PACKAGE} is installed, but does not hold {path}; version 6 does")
    return path, share
