"""ROS packages, which ``$(find NAME)`` and ``package://NAME`` mean."""

import re
from pathlib import Path

DEEPEST = 4  # folders above a file in which a package is searched for
ABOVE = 3  # … and which of them may be packages by their names alone
MOST_PACKAGES = 200
_NAME = re.compile(rb"<name>\s*([\w.-]+)\s*</name>")


def packages_of(path: Path, folders) -> dict[str, Path]:
    """ROS packages by their names: those that hold the file, those beside them, and those in the folders.

    A package has the name that its ``package.xml`` gives, and that of its folder.
    """
    found: dict[str, Path] = {}
    around = [path.resolve().parent, *list(path.resolve().parent.parents)[:DEEPEST]]
    own = [folder for folder in around if (folder / "package.xml").is_file()]
    named = [folder for folder in around[1:ABOVE] if folder not in own and folder.parent != folder]
    for folder in own:
        found.setdefault(_package_name(folder), folder)
        found.setdefault(folder.name, folder)
    beside = [each for folder in own[:1] for each in _inside(folder.parent)]
    given = [Path(folder).resolve() for folder in folders]
    given += [each for folder in given for each in _inside(folder)]
    for folder in named:  # a copy of a package, which has lost its package.xml
        found.setdefault(folder.name, folder)
    for folder in (*given, *beside):
        if (folder / "package.xml").is_file():
            found.setdefault(_package_name(folder), folder)
        found.setdefault(folder.name, folder)
    return found


def _inside(folder):
    """The folders in a folder that are packages."""
    try:
        inner = [each for each in sorted(folder.iterdir())[:MOST_PACKAGES] if (each / "package.xml").is_file()]
    except OSError:
        return []
    return inner


def _package_name(folder) -> str:
    match = _NAME.search((folder / "package.xml").read_bytes()[:100_000])
    return match[1].decode() if match else folder.name
