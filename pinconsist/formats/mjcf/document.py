"""An MJCF file as one XML document, its includes in their places, and what may stand in it.

Every element that has an effect here is checked against the names that MuJoCo knows, as MuJoCo does: a misspelt
attribute would otherwise leave its default in force, unseen. Source: "XML Reference" of the MuJoCo documentation.
"""

from __future__ import annotations

import os
from pathlib import Path
from xml.etree.ElementTree import Element

from ...errors import FormatError
from ..reading import near, parsed, read_bytes, shown

MOST_FILES = 200
_READ = ("compiler", "option", "default", "asset", "worldbody", "equality", "tendon", "actuator", "keyframe")
_WITHOUT_EFFECT = ("size", "statistic", "visual", "extension", "custom", "deformable", "contact", "sensor")
_HOMES = {"body": "worldbody", "freejoint": "worldbody", "inertial": "worldbody"}
_HOMES |= {"worldbody": "mujoco", "connect": "equality", "weld": "equality"}
"""Where elements stand that would be missed if they were lost."""
_TURN = "quat axisangle xyaxes zaxis euler"
_COMMON_GEOM = f"name class type group size material rgba fromto user mesh pos {_TURN}"
_COMMON_EQUALITY = "name class active solref solimp"
_ATTRIBUTES = {
    "compiler": """autolimits boundmass boundinertia settotalmass balanceinertia strippath coordinate angle fitaabb
        eulerseq meshdir texturedir assetdir discardvisual usethread fusestatic inertiafromgeom alignfree
        inertiagrouprange saveinertial savecanonical savecompiled conflict passthrough exactmeshinertia
        convexhull""",
    "body": f"name childclass mocap gravcomp sleep simple fuse user pos {_TURN}",
    "frame": f"name childclass pos {_TURN}",
    "inertial": f"pos mass diaginertia fullinertia {_TURN}",
    "joint": """name class type group pos axis springdamper limited actuatorfrclimited actuatorgravcomp solreflimit
        solimplimit solreffriction solimpfriction stiffness range actuatorfrcrange margin ref springref springyield
        armature damping frictionloss user""",
    "freejoint": "name group align",
    "geom": f"""contype conaffinity condim priority friction mass density shellinertia solmix solref solimp margin gap
        fluidshape fluidcoef hfield fitscale surfacevel adhesion castshadow {_COMMON_GEOM}""",
    "site": _COMMON_GEOM,
    "connect": f"body1 body2 anchor site1 site2 {_COMMON_EQUALITY}",
    "weld": f"body1 body2 anchor relpose torquescale site1 site2 {_COMMON_EQUALITY}",
    "equality joint": f"joint1 joint2 polycoef {_COMMON_EQUALITY}",
    "default equality": "active solref solimp",
}
_INSIDE = {"body": None, "frame": None, "geom": ("plugin",), "compiler": ("lengthrange",)}
"""What may stand in an element beside nothing; None is checked elsewhere."""
_ATTRIBUTES = {tag: frozenset(names.split()) for tag, names in _ATTRIBUTES.items()}


def document(path: Path) -> Element:
    """The ``<mujoco>`` element of a file, with every ``<include>`` replaced by what it names.

    Included files are looked for in the folder of the file, then in that of the including file, and never outside of
    the former; each may be included once, as in MuJoCo.

    Raises
    ------
    FormatError
        A file that cannot be read or is no MJCF; names the file.
    """
    path = Path(path)
    root = _parsed(path)
    if root.tag != "mujoco":
        hint = "; a URDF needs the ending .urdf" if root.tag == "robot" else ""
        raise FormatError(f"the root element of an MJCF file is <mujoco>, this is <{root.tag}>{hint}", path=path)
    main = Path(os.path.abspath(path))
    _expand(root, main, main.parent, {main})
    for section in root:
        _check_section(section, path)
    return root


def _check_section(section, path):
    known = (*_READ, *_WITHOUT_EFFECT)
    if section.tag not in known:
        raise FormatError(f"this element is not known{near(section.tag, known)}", path=path, element=section.tag)
    for tag, home in _HOMES.items():
        if section.tag != home and section.find(f".//{tag}") is not None:
            raise FormatError(f"<{tag}> belongs in <{home}>", path=path, element=section.tag)


def _expand(root, file, folder, seen):
    """Replace the includes below an element of a file."""
    for node in list(root.iter()):
        if any(child.tag == "include" for child in node):
            parts = [_included(child, file, folder, seen) if child.tag == "include" else [child] for child in node]
            node[:] = [each for part in parts for each in part]


def _included(node, file, folder, seen):
    """What stands in the file that an include names."""
    name = node.get("file", "")
    try:
        path = _located(name, folder, file.parent)
        if path in seen:
            raise FormatError("the file is included twice, or includes itself")
        if len(seen) >= MOST_FILES:
            raise FormatError(f"more than {MOST_FILES} files are included")
    except FormatError as error:
        raise FormatError(error.reason, path=file, element=f"include {shown(name)}") from error
    seen.add(path)
    root = _parsed(path)
    _expand(root, path, folder, seen)
    return list(root)


def _located(name, folder, nearby):
    if not name:
        raise FormatError("attribute 'file' is missing")
    for start in (folder, nearby):
        found = Path(os.path.normpath(start / name))
        if not (found.is_relative_to(folder) and found.resolve().is_relative_to(folder.resolve())):
            raise FormatError(f"it climbs out of the folder of the scene, {folder}; only files in there are included")
        if found.is_file():
            return found
    raise FormatError("there is no such file")


def _parsed(path):
    try:
        return parsed(read_bytes(path))
    except FormatError as error:
        raise FormatError(error.reason, path=path) from error.__cause__


def sections(root: Element, tag: str):
    """The children of all sections of this name, in their order."""
    return [child for section in root.findall(tag) for child in section]


def check_attributes(node: Element, element: str, kind: str | None = None) -> None:
    """FormatError for what MuJoCo does not know in this kind of element: an attribute, or an element inside."""
    known, inside = _ATTRIBUTES[kind or node.tag], _INSIDE.get(node.tag, ())
    for child in node:
        if inside is not None and child.tag not in inside:
            raise FormatError(f"no element {child.tag!r} can stand in it", element=element)
    for key in node.attrib:
        if key not in known:
            raise FormatError(f"the attribute {key!r} is not known{near(key, known)}", element=element)
