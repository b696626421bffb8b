"""Scenes by name or path."""

from __future__ import annotations

import os
from collections.abc import Iterable
from importlib import import_module
from pathlib import Path

from ..errors import FormatError, InputError
from ..mechanism.mechanism import Mechanism
from .beside import loop_file
from .closure import check_closure
from .reading import alike
from .robots import ROBOTS, robot_file

_READERS = {".urdf": "urdf_scene", ".sdf": "sdf.scene", ".xml": "mjcf.scene", ".mjcf": "mjcf.scene"}
"""Suffix → the module whose ``load`` reads such a file; imported when it is needed."""
_READABLE = (
    "what can be read is URDF (.urdf), with a loop file (.yaml) beside it or given by loops=, "
    "SDF (.sdf) and MJCF (.xml)"
)


def load(source, *, loops=None, closure=None, free_flyer=False, package_dirs=()) -> Mechanism:
    """A mechanism from a built-in name, a file, a folder or an object of Pinocchio's.

    Parameters
    ----------
    source : str, path-like, pin.Model or RobotWrapper
        A name of :func:`models`, with a number for ``<n>``; or a ``.urdf``, ``.sdf`` or MJCF ``.xml`` file; or a folder
        that holds one ``.urdf``; or a model as it stands in memory; or a robot of the pip package example-robot-data:
        ``"cassie"``, ``"cassie_v2"``, ``"cassie_reduced"``, ``"cassie_simple"``, ``"cassie_wo_gearbox_spring"``, named
        like their files.
    loops : path-like or sequence, optional
        The loop file. Without it: ``<stem>.yaml`` or ``.yml`` beside the URDF, else ``robot.yaml`` or ``.yml``
        there, else what the URDF says itself: ``<loop_joint>`` elements, or pairs of frames with closing names
        (:mod:`pinconsist.formats.loop_joints`, :mod:`pinconsist.formats.closing_frames`), else none (a plain tree).
        SDF and MJCF files close their loops themselves (:mod:`pinconsist.formats.sdf`,
        :mod:`pinconsist.formats.mjcf`); a loop file beside them is not looked for.
        Of a model in memory, a sequence of Pinocchio's constraint models and of Loop, Drive and Coupling records.
    closure : {"point", "frame", "hinge", ...}, optional
        Close every loop in this way instead (a kind of :class:`~pinconsist.Loop`); loops that hold a distance stay
        as they are.
    free_flyer : bool
        Let the root link of a file float freely instead of fixing it to the ground, where it stands. SDF files too
        are fixed by default, though a model that nothing ties to the world floats in SDF: so one scene in two formats
        is one mechanism, as with Pinocchio's own readers. Not for MJCF, which says itself what floats.
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
    MissingExtraError
        The files of a robot are not installed; names the pip package that brings them.
    FormatError
        A file that cannot be read as a scene; names the file and the element.
    """
    check_closure(closure)
    if isinstance(package_dirs, (str, os.PathLike)):
        package_dirs = (package_dirs,)
    package_dirs = tuple(package_dirs) if isinstance(package_dirs, Iterable) else (package_dirs,)
    if not all(isinstance(folder, (str, os.PathLike)) for folder in package_dirs):
        raise InputError(f"package_dirs= needs folders, got {package_dirs!r}")
    if not isinstance(source, (str, os.PathLike)):
        from . import pinocchio_model

        if free_flyer:
            raise InputError("free_flyer= is for files; a model in memory has its root joint already")
        return pinocchio_model.read(source, loops=() if loops is None else loops, closure=closure)
    if not (loops is None or isinstance(loops, (str, os.PathLike))):
        raise InputError(
            f"loops= needs the path of a loop file, got {type(loops).__name__}; records go by load(…).with_loops(…)"
        )
    options = {"loops": loops, "closure": closure, "free_flyer": free_flyer, "package_dirs": package_dirs}
    if written := _member(source):
        from . import urdf_scene

        return urdf_scene.load(Path(f"{source}.urdf"), source, written=written, **options)
    if isinstance(source, str) and source in ROBOTS:
        (path, share), name = robot_file(source), source
        options["package_dirs"] = (*package_dirs, share)
    else:
        path, name = _find(source)
    return import_module(f".{_READERS[path.suffix.lower()]}", __package__).load(path, name, **options)


def models() -> dict[str, str]:
    """The built-in models.

    Returns
    -------
    dict[str, str]
        Name → one line of description; ``<n>`` in a name stands for a number of your choice.

    Raises
    ------
    FormatError
        A damaged installation: a loop file among the models that cannot be read.
    """
    from . import families, loopfile

    files = {path.stem: loopfile.read(loop_file(path)).description for path in _built_in().values()}
    return files | families.listed()


def is_built_in(source) -> bool:
    """Whether `source` is a name by which :func:`load` knows a scene, and no path."""
    from . import families

    return isinstance(source, str) and (source in _built_in() or source in ROBOTS or families.found(source) is not None)


def _member(source):
    from . import families

    return families.member(source) if isinstance(source, str) else None


def _built_in():
    package = Path(__file__).resolve().parents[1]
    folder = package / "models" if (package / "models").is_dir() else package.parent / "models"  # wheel, checkout
    return {path.stem: path for path in sorted(folder.glob("*.urdf"))}


def _find(source):
    """The URDF file of a source, and the mechanism's name."""
    from . import families

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
    elif path.suffix.lower() not in _READERS:
        is_name = isinstance(source, str) and not path.suffix and len(path.parts) == 1 and not os.path.exists(path)
        if is_name:
            names = (*built_in, *families.listed())
            raise InputError(
                f"there is no built-in model and no file {source!r}{alike(source, (*names, *ROBOTS))}. "
                f"Built in are: {', '.join(names)}"
            )
        raise FormatError(f"files of kind {path.suffix or 'without suffix'!r} cannot be read; {_READABLE}", path=path)
    name = path.stem if path.stem not in ("robot", "model") else path.resolve().parent.name
    return path, name
