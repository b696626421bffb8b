"""A URDF file and what closes it → Mechanism."""

from __future__ import annotations

from pathlib import Path

from ..errors import FormatError, InputError
from ..mechanism.mechanism import Mechanism
from . import closing_frames, loopfile, urdf
from .beside import loop_file, tell_overlooked
from .closure import closed_by


def load(path: Path, name: str, *, loops, closure, free_flyer, package_dirs, written=None) -> Mechanism:
    """See :func:`pinconsist.load`.

    Loops come from ``<loop_joint>`` elements and from the loop file; where there is neither, from frames with closing
    names. A scene of :mod:`pinconsist.formats.families` is `written` and stands in no file.
    """
    content, record = written or (None, loopfile.LoopFile())
    loop_path = Path(loops) if loops is not None else None if written else loop_file(path)
    record = record if loop_path is None else loopfile.read(loop_path)
    scene = urdf.read(
        path, name=name, joint_types=record.joint_types, free_flyer=free_flyer, package_dirs=package_dirs,
        content=content,
    )  # fmt: skip
    model = record.settings.applied(scene.model, loop_path)
    model = loopfile.told_apart((*scene.loops, *record.loops, *record.forces), model)
    loopfile.check(record, model, loop_path)
    closures = (*scene.loops, *record.loops)
    if loop_path is None and not closures:
        closures = closing_frames.loops(model, path, closure)
        if not closures:
            tell_overlooked(path)
    closures = closed_by(closures, closure)
    try:
        return Mechanism(
            model,
            (*closures, *scene.couplings),
            record.forces,
            name=name,
            guess=record.guess,
            actuated=record.actuated,
            geometry=scene.geometry,
            duration=record.duration,
        )
    except InputError as error:
        raise FormatError(str(error), path=loop_path or path) from error
