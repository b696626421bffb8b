"""Scenes by name or path."""

from __future__ import annotations

import logging
import os
from dataclasses import replace
from pathlib import Path

from ..errors import FormatError, InputError
from ..mechanism.loops import ROW_NAMES
from ..mechanism.mechanism import Mechanism
from .reading import alike

log = logging.getLogger(__name__)

CLOSURES = tuple(kind for kind in ROW_NAMES if kind != "distance")
_READABLE = "what can be read now is URDF (.urdf), with a loop file (.yaml) beside it or given by loops="


def load(source, *, loops=None, closure=None, free_flyer=False, package_dirs=()) -> Mechanism:
    """A mechanism from a built-in name, a file or a folder.

    Parameters
    ----------
    source : str or path-like
        A name of :func:`models`; or a ``.urdf`` file; or a folder that holds one.
    loops : path-like, optional
        The loop file. Without it: ``<stem>.yaml`` or ``.yml`` beside the URDF, else ``robot.yaml`` or ``.yml``
        there, else no loops (a plain tree).
    closure : {"point", "frame", "hinge"}, optional
        Close every loop of the file in this way instead; loops that hold a distance stay as they are.
    free_flyer : bool
        Let the root link float freely instead of fixing it to the ground.
    package_dirs : sequence of path-like
        Folders in which mesh files are looked for, before the folder of the URDF.

    Returns
    -------
    Mechanism
        Its ``continuous`` joints are plain revolute joints, one angle that counts its turns.

    Raises
    ------
    InputError
        Unknown name or impossible option.
    FormatError
        A file that cannot be read as a scene; names the file and the element.
    """
    from . import loopfile, urdf  # the parsers are not needed to import the package

    if closure is not None and closure not in CLOSURES:
        raise InputError(f"closure={closure!r} is not one of {', '.join(CLOSURES)}")
    if not (loops is None or isinstance(loops, (str, os.PathLike))):
        raise InputError(f"loops= needs the path of a loop file, got {type(loops).__name__}")
    if isinstance(package_dirs, (str, os.PathLike)):
        package_dirs = (package_dirs,)
    path, name = _find(source)
    loop_path = _loop_file(path) if loops is None else Path(loops)
    record = loopfile.LoopFile() if loop_path is None else loopfile.read(loop_path)
    if loop_path is None:
        _tell_overlooked(path)
    model, geometry = urdf.read(
        path, name=name, joint_types=record.joint_types, free_flyer=free_flyer, package_dirs=package_dirs
    )
    loopfile.check(record, model, loop_path)
    closures = record.loops
    if closure is not None:
        closures = tuple(loop if loop.kind == "distance" else replace(loop, kind=closure) for loop in closures)
    try:
        return Mechanism(model, closures, name=name, guess=record.guess, actuated=record.actuated, geometry=geometry)
    except InputError as error:
        raise FormatError(str(error), path=loop_path or path) from error


def models() -> dict[str, str]:
    """The built-in models: name → one line of description."""
    from . import loopfile

    return {path.stem: loopfile.read(_loop_file(path)).description for path in _built_in().values()}


def _built_in():
    package = Path(__file__).resolve().parents[1]
    folder = package / "models" if (package / "models").is_dir() else package.parent / "models"  # wheel, checkout
    return {path.stem: path for path in sorted(folder.glob("*.urdf"))}


def _find(source):
    """The URDF file of a source, and the mechanism's name."""
    if not isinstance(source, (str, os.PathLike)):
        raise InputError(f"load needs a model's name or a path, got {type(source).__name__}")
    built_in = _built_in()
    if isinstance(source, str) and source in built_in:
        return built_in[source], source
    path = Path(source)
    if os.path.isdir(path):
        found = sorted(path.glob("*.urdf"))
        if len(found) != 1:
            names = ": " + ", ".join(each.name for each in found) if found else ""
            raise FormatError(f"a folder with one .urdf file is needed, this has {len(found)}{names}", path=path)
        path = found[0]
    elif path.suffix.lower() != ".urdf":
        is_name = isinstance(source, str) and not path.suffix and len(path.parts) == 1 and not os.path.exists(path)
        if is_name:
            listed = ", ".join(built_in)
            raise InputError(
                f"there is no built-in model and no file {source!r}{alike(source, built_in)}. Built in are: {listed}"
            )
        raise FormatError(f"files of kind {path.suffix or 'without suffix'!r} cannot be read; {_READABLE}", path=path)
    name = path.stem if path.stem != "robot" else path.resolve().parent.name
    return path, name


def _tell_overlooked(path):
    """Warn of YAML files beside a robot without a loop file: most likely one of them was meant."""
    others = sorted(each.name for each in (*path.parent.glob("*.yaml"), *path.parent.glob("*.yml")))
    if others:
        log.warning(
            "%s has no loop file (%s.yaml or robot.yaml) and is read as a plain tree; name one by loops= if it is %s",
            path, path.stem, " or ".join(others),
        )  # fmt: skip


def _loop_file(path):
    candidates = (
        path.with_suffix(".yaml"),
        path.with_suffix(".yml"),
        path.parent / "robot.yaml",
        path.parent / "robot.yml",
    )
    return next((each for each in candidates if os.path.isfile(each)), None)
