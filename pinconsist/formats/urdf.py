"""URDF files.

Everything is checked in our own code before Pinocchio sees it, so that whatever is wrong with a file is a FormatError
that names the file and the element. ``continuous`` joints become plain revolute joints, one angle that counts its
turns (nq = nv), where Pinocchio would store a cosine and a sine; a limit that the file does not give is infinite.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import ParseError, tostring

import pinocchio as pin
from defusedxml import DefusedXmlException
from defusedxml.ElementTree import fromstring

from ..errors import FormatError
from ..mechanism.mechanism import Geometry
from .joints import replaced
from .reading import near, read_bytes
from .urdf_tree import checked

MAX_BYTES = 50_000_000
_ROOT_JOINT = "root_joint"


def read(path, *, name="", joint_types=None, free_flyer=False, package_dirs=()) -> tuple[pin.Model, Geometry]:
    """A model and its shapes from a URDF file.

    Parameters
    ----------
    path : path-like
        The file.
    name : str
        Name of the model; the stem of the file if empty.
    joint_types : dict[str, str], optional
        Joints to replace: name → SPHERICAL, FIXED or UJOINT_AB, see :mod:`pinconsist.formats.joints`.
    free_flyer : bool
        Let the root link float freely, by a joint ``root_joint``, instead of fixing it to the ground.
    package_dirs : sequence of path-like
        Folders in which mesh files are looked for, before the folder of the file.

    Raises
    ------
    FormatError
        The file cannot be read as a scene.
    """
    path = Path(path)
    content = read_bytes(path, MAX_BYTES)
    try:
        robot, unlimited = checked(_parsed(content), name or path.stem)
        types = dict(joint_types or {})
        _fix(robot, [joint for joint in types if types[joint] == "FIXED"])
        text = tostring(robot, encoding="unicode")
        model = _built(text, free_flyer, robot)
        for joint, side in unlimited:
            if model.existJointName(joint):  # not one that was fixed
                vector = model.lowerPositionLimit if side == "lower" else model.upperPositionLimit
                vector[model.idx_qs[model.getJointId(joint)]] = -float("inf") if side == "lower" else float("inf")
        types = {joint: kind for joint, kind in types.items() if kind != "FIXED"}
        model = replaced(model, types) if types else model
    except FormatError as error:
        raise FormatError(error.reason, path=path, element=error.element) from error.__cause__
    return model, Geometry(text, tuple(str(Path(folder).resolve()) for folder in (*package_dirs, path.parent)))


def _parsed(content):
    try:
        return fromstring(content, forbid_dtd=True)
    except DefusedXmlException as error:
        raise FormatError(f"document types and entities are refused for safety ({type(error).__name__})") from error
    except (ParseError, ValueError, LookupError) as error:  # the last two: encodings
        raise FormatError(f"not well-formed XML: {error}") from error


def _fix(robot, names):
    joints = {joint.get("name"): joint for joint in robot.findall("joint")}
    for name in names:
        if name not in joints:
            raise FormatError(f"there is no joint of this name to fix{near(name, joints)}", element=f"joint {name!r}")
        joints[name].set("type", "fixed")


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
