"""An SDF file → Mechanism. What is carried over, and how, stands at the head of :mod:`pinconsist.formats.sdf`."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree.ElementTree import tostring

import numpy as np
import pinocchio as pin

from ...errors import FormatError, InputError
from ...mechanism.constraints.coupling import Coupling
from ...mechanism.constraints.loops import Loop
from ...mechanism.forces import JointSpring
from ...mechanism.geometry import Geometry
from ...mechanism.mechanism import Mechanism
from .. import loopfile
from ..closure import closed_by
from ..reading import read_bytes
from ..urdf_tree import checked
from ..xml_reading import MAX_BYTES, parsed
from .closing import Net, closures
from .couplings import couplings
from .model import build
from .shapes import in_urdf, inertias, weightless
from .tree import read_tree

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class SdfScene:
    """What an SDF file says.

    Attributes
    ----------
    model : pin.Model
        The tree; links are frames of it, and so are `<frame>` elements.
    geometry : Geometry
        Its shapes.
    loops : tuple of Loop
        Named by the joints that close them; all are closed at q = 0.
    couplings : tuple of Coupling
        Gearboxes and `<mimic>` elements.
    springs : tuple of JointSpring
        Of joints with a `<spring_stiffness>`.
    guess : dict
        Where floating roots stand, and the `<initial_position>` of joints.
    """

    model: pin.Model
    geometry: Geometry
    loops: tuple[Loop, ...] = ()
    couplings: tuple[Coupling, ...] = ()
    springs: tuple[JointSpring, ...] = ()
    guess: dict = field(default_factory=dict)


def load(path: Path, name: str, *, loops, closure, free_flyer, package_dirs) -> Mechanism:
    """See :func:`pinconsist.load`. A loop file beside an SDF file is read only if `loops` names it."""
    record = loopfile.beside_scene(loops, "SDF")
    scene = read(path, name=name, free_flyer=free_flyer, package_dirs=package_dirs)
    model = record.settings.applied(scene.model, loops)
    loopfile.check(record, model, loops)
    try:
        return Mechanism(
            model,
            (*closed_by((*scene.loops, *record.loops), closure), *scene.couplings),
            (*scene.springs, *record.forces),
            name=name,
            guess=scene.guess | record.guess,
            actuated=record.actuated,
            geometry=scene.geometry,
            duration=record.duration,
        )
    except InputError as error:
        raise FormatError(str(error), path=path) from error


def read(path, *, name="", free_flyer=False, package_dirs=()) -> SdfScene:
    """The model, the loops and the shapes of an SDF file.

    Parameters
    ----------
    path : path-like
        The file.
    name : str
        Name of the model; the stem of the file if empty.
    free_flyer : bool
        Let what no joint ties to the world float, by a joint ``root_joint``, instead of fixing it where it stands.
    package_dirs : sequence of path-like
        Folders in which mesh files are looked for, before the folder of the file.

    Raises
    ------
    FormatError
        The file cannot be read as a scene.
    """
    path = Path(path)
    content = read_bytes(path, MAX_BYTES)
    folders = tuple(Path(folder).resolve() for folder in (*package_dirs, path.parent))
    name = name or path.stem
    try:
        scene = read_tree(parsed(content))
        robot, _ = checked(in_urdf(scene, folders), name)
        net = Net(scene)
        if len(net.roots) > 1:
            _log.warning("%s: no joints tie %s together or to the world", path, ", ".join(map(repr, net.roots)))
        model, guess = build(scene, net, inertias(scene, robot), name, free_flyer)
        if weightless(scene):
            model.gravity.linear = np.zeros(3)
        motions = [motion for joint in net.joints for motion in zip(joint.parts, joint.axes, strict=False)]
        springs = [JointSpring(part, axis.stiffness, axis.reference) for part, axis in motions if axis.stiffness]
        guess |= {part: axis.initial for part, axis in motions if axis.initial and model.existJointName(part)}
        geometry = Geometry(tostring(robot, encoding="unicode"), tuple(map(str, folders)))
        return SdfScene(
            model, geometry, tuple(closures(net, scene)), tuple(couplings(scene.joints)), tuple(springs), guess
        )
    except FormatError as error:
        raise FormatError(error.reason, path=path, element=error.element) from error.__cause__
    except InputError as error:  # numbers that overflow on the way
        raise FormatError(str(error), path=path) from error
