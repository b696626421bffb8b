"""ROS packages, which ``$(find NAME)`` and ``package://NAME`` mean."""

import re
from pathlib import Path

DEEPEST = 4  # folders above a file in which a package is searched for, and below a folder that is given
ABOVE = 3  # … and which of them may be packages by their names alone
MOST_PACKAGES, MOST_FOLDERS = 500, 2_000
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
    beside = [each for folder in own[:1] for each in _below(folder.parent, 0)]
    given = [Path(folder).resolve() for folder in folders]
    given += [each for folder in given for each in _below(folder, 0 if folder == around[0] else DEEPEST)]
    for folder in named:  # a copy of a package, which has lost its package.xml
        found.setdefault(folder.name, folder)
    for folder in (*given, *beside):
        if (folder / "package.xml").is_file():
            found.setdefault(_package_name(folder), folder)
        found.setdefault(folder.name, folder)
    return found


def _below(folder, deepest) -> list[Path]:
    """The packages in a folder and in the folders there, as ROS searches its paths; none is in another package."""
    found, waiting, seen = [], [(folder, 0)], 0
    while waiting and seen < MOST_FOLDERS and len(found) < MOST_PACKAGES:
        here, depth = waiting.pop(0)
        inner = _inside(here)
        seen += 1
        packages = [each for each in inner if (each / "package.xml").is_file()]
        found += packages
        if depth < deepest:
            waiting += [(each, depth + 1) for each in inner if each not in packages]
    return found


def _inside(folder) -> list[Path]:
    """The folders in a folder."""
    try:
        return [each for each in sorted(folder.iterdir()) if each.is_dir() and not each.name.startswith(".")]
    except OSError:
        return []


def _package_name(folder) -> str:
    match = _NAME.search((folder / "package.xml").read_bytes()[:100_000])
    return match[1].decode() if match else folder.name
