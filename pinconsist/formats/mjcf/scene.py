"""What an MJCF file says."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...errors import FormatError
from ..reading import RobotFile
from .actuators import actuated, refuse_tendons
from .bodies import BodyReader
from .document import document, sections
from .equality import closures
from .settings import Defaults, compiler, option
from .shapes import geometry
from .tree import build
from .values import vector


def read(path: Path, name: str, *, package_dirs=()) -> RobotFile:
    """What an MJCF file says.

    The active equality constraints close the scene. Joints have MuJoCo's values: ``ref`` where the bodies stand as the
    file places them. Assembly starts at the first keyframe, else there.

    Limits, contacts, sensors and solver settings have no effect, and actuators give names only. What else would move
    the bodies in MuJoCo and is not computed here is refused.
    """
    with np.errstate(all="ignore"):  # what is not finite is found and named
        return _read(path, name, package_dirs)


def _read(path, name, package_dirs):
    root = document(path)
    compiling, options, defaults = compiler(root), option(root), Defaults(root)
    bodies = BodyReader(root, compiling, defaults).bodies
    tree = build(bodies, compiling, options, name)
    if tree.model.nv == 0:
        raise FormatError("nothing can move: no body has a joint")
    refuse_tendons(root, defaults)
    return RobotFile(
        model=tree.model,
        loops=closures(root, tree, defaults, options),
        forces=tree.forces,
        guess=_guess(root, tree),
        actuated=actuated(root, tree, defaults),
        geometry=geometry(root, bodies, tree.names, compiling, defaults, (*package_dirs, path.parent)),
    )


def _guess(root, tree):
    """The first keyframe, else the reference; quaternions change from MuJoCo's order w, x, y, z to x, y, z, w."""
    model, values = tree.model, tree.reference
    key = next((key for key in sections(root, "keyframe") if "qpos" in key.attrib), None)
    if key is not None:
        values = vector(key.attrib, "qpos", f"key {key.get('name', '1')!r}", model.nq)
    guess = {}
    for joint, start, size in zip(model.names, model.idx_qs, model.nqs, strict=True):
        value = values[start : start + size]
        if key is not None and size in (4, 7):
            value = np.concatenate((value[:-4], value[-3:], value[-4:-3]))
        if size:  # not the universe
            guess[joint] = value
    return guess
