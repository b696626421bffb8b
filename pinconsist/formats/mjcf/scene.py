"""An MJCF file → Mechanism."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from ...errors import FormatError, InputError
from ...mechanism.geometry import Geometry
from ...mechanism.mechanism import Mechanism
from .. import loopfile
from ..closure import closed_by
from .actuators import actuated, refuse_tendons
from .bodies import BodyReader
from .document import document, sections
from .equality import closures
from .settings import Defaults, compiler, option
from .shapes import geometry
from .tree import build
from .values import vector


def load(path: Path, name: str, *, loops, closure, free_flyer, package_dirs) -> Mechanism:
    """See :func:`pinconsist.load`.

    The active equality constraints close the scene, and the loops of a loop file that is given. Joints have MuJoCo's
    values: ``ref`` where the bodies stand as the file places them. Assembly starts at the first keyframe, else there.

    Limits, contacts, sensors and solver settings have no effect, and actuators give names only. What else would move
    the bodies in MuJoCo and is not computed here is refused.
    """
    if free_flyer:
        raise InputError("free_flyer= is not for MJCF, which says itself what floats: give the body a <freejoint/>")
    record = loopfile.beside_scene(loops, "MJCF")
    try:
        with np.errstate(all="ignore"):  # what is not finite is found and named
            scene = _read(path, name, package_dirs)
    except FormatError as error:
        raise FormatError(error.reason, path=error.path or path, element=error.element) from error.__cause__
    model = record.settings.applied(scene.model, loops)
    loopfile.check(record, model, loops)
    closures_ = closed_by((*scene.loops, *record.loops), closure)
    try:
        return Mechanism(
            model,
            closures_,
            (*scene.forces, *record.forces),
            name=name,
            guess=scene.guess | record.guess,
            actuated=tuple(dict.fromkeys((*scene.actuated, *record.actuated))),
            geometry=scene.geometry,
            duration=record.duration,
        )
    except InputError as error:
        raise FormatError(str(error), path=path) from error


@dataclass(frozen=True)
class _Scene:
    """What a file says: model, closures, forces, joint → value from where assembly starts, motorised joints, shapes."""

    model: pin.Model
    loops: tuple
    forces: tuple
    guess: dict[str, np.ndarray]
    actuated: tuple[str, ...]
    geometry: Geometry


def _read(path, name, package_dirs):
    root = document(path)
    compiling, options, defaults = compiler(root), option(root), Defaults(root)
    bodies = BodyReader(root, compiling, defaults).bodies
    tree = build(bodies, compiling, options, name)
    if tree.model.nv == 0:
        raise FormatError("nothing can move: no body has a joint")
    refuse_tendons(root, defaults)
    return _Scene(
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
