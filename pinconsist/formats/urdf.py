"""URDF files.

Everything is checked in our own code before Pinocchio sees it, so that whatever is wrong with a file is a FormatError
that names the file and the element. ``continuous`` joints become plain revolute joints, one angle that counts its
turns (nq = nv), where Pinocchio would store a cosine and a sine; a limit that the file does not give is infinite.
``<mimic>`` becomes a coupling of two joints, ``<loop_joint>`` a loop.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import tostring

import pinocchio as pin

from ..errors import FormatError
from ..mechanism.constraints.coupling import Coupling
from ..mechanism.constraints.loops import Loop
from ..mechanism.geometry import Geometry
from .joints import replaced
from .loop_joints import loop_joints
from .mimic import couplings
from .reading import near, read_bytes
from .urdf_tree import checked
from .xml_reading import MAX_BYTES, parsed

_ROOT_JOINT = "root_joint"
_AS_WRITTEN = {"FIXED": "fixed", "UNBOUNDED": "continuous"}
"""Joints that are replaced by another type in the URDF text."""


@dataclass(frozen=True)
class UrdfScene:
    """What a URDF file says.

    Attributes
    ----------
    model : pin.Model
        The tree.
    geometry : Geometry
        Its shapes.
    loops : tuple of Loop
        Its ``<loop_joint>`` elements.
    couplings : tuple of Coupling
        Its ``<mimic>`` elements.
    """

    model: pin.Model
    geometry: Geometry
    loops: tuple[Loop, ...]
    couplings: tuple[Coupling, ...]


def read(path, *, name="", joint_types=None, free_flyer=False, package_dirs=(), content=None) -> UrdfScene:
    """A model, its shapes and what closes it from a URDF file.

    Parameters
    ----------
    path : path-like
        The file.
    name : str
        Name of the model; the stem of the file if empty.
    joint_types : dict[str, str], optional
        Joints to replace: name → type, see :mod:`pinconsist.formats.joints`.
    free_flyer : bool
        Let the root link float freely, by a joint ``root_joint``, instead of fixing it to the ground.
    package_dirs : sequence of path-like
        Folders in which mesh files are looked for, before the folder of the file.
    content : bytes, optional
        The text, where it does not stand in a file; messages then speak of `path`.

    Raises
    ------
    FormatError
        The file cannot be read as a scene.
    """
    path = Path(path)
    content = read_bytes(path, MAX_BYTES) if content is None else content
    try:
        raw = parsed(content)
        robot, unlimited = checked(raw, name or path.stem)
        loops, coupled = loop_joints(raw), couplings(raw)
        types = dict(joint_types or {})
        for joint, kind in types.items():
            if kind in _AS_WRITTEN:
                _retype(robot, joint, kind)
        text = tostring(robot, encoding="unicode")
        model = _built(text, free_flyer, robot)
        for joint, side in unlimited:
            if model.existJointName(joint) and types.get(joint) != "UNBOUNDED":  # not one that was fixed
                vector = model.lowerPositionLimit if side == "lower" else model.upperPositionLimit
                vector[model.idx_qs[model.getJointId(joint)]] = -float("inf") if side == "lower" else float("inf")
        types = {joint: kind for joint, kind in types.items() if kind not in _AS_WRITTEN}
        model = replaced(model, types) if types else model
    except FormatError as error:
        raise FormatError(error.reason, path=path, element=error.element) from error.__cause__
    folders = tuple(str(Path(folder).resolve()) for folder in (*package_dirs, path.parent))
    return UrdfScene(model, Geometry(text, folders), loops, coupled)


def _retype(robot, name, kind):
    joints = {joint.get("name"): joint for joint in robot.findall("joint")}
    if name not in joints:
        raise FormatError(f"there is no joint of this name to replace{near(name, joints)}", element=f"joint {name!r}")
    if kind == "UNBOUNDED" and joints[name].get("type") != "revolute":
        raise FormatError("only a revolute joint can be made unbounded", element=f"joint {name!r}")
    joints[name].set("type", _AS_WRITTEN[kind])


def _built(text, free_flyer, robot):
    names = [joint.get("name") for joint in robot.findall("joint") if joint.get("type") != "fixed"]
    if free_flyer and any(joint.get("name") == _ROOT_JOINT for joint in robot.findall("joint")):
        raise FormatError("a free-flyer adds a joint of this name; rename the file's", element=f"joint {_ROOT_JOINT!r}")
    if not (names or free_flyer):
        raise FormatError("nothing can move: the model has no joint that is not fixed (a free-flyer would move it)")
    try:
        root = (pin.JointModelFreeFlyer(), _ROOT_JOINT) if free_flyer else ()
        return pin.buildModelFromXML(text, *root)
    except Exception as error:  # Boost.Python may raise any kind
        raise FormatError(f"Pinocchio cannot build the model: {error}") from error
