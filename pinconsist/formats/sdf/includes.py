"""``<include>`` in SDF: the models of other files, put where they are included.

A ``<model>`` is put there as a model of its own, or with ``merge="true"`` its elements: then a frame
``_merged__NAME__model__`` stands for that of the model. A URDF that is included becomes a model (:mod:`.of_urdf`).
``model://NAME`` is a folder NAME with a ``model.config``, or a ``model.sdf``, beside the file, in the folder above, in
``models/`` of one of these, or in ``package_dirs``; ``package://NAME`` is a ROS package (:mod:`..packages`); other URIs
are paths from the folder of the file. Nothing is read from elsewhere. The models ``sun`` and ``ground_plane`` of
Gazebo, which never move, need no files.
"""

import os
from copy import deepcopy
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

from ...errors import FormatError
from ...mechanism.file_laws import FLOOR
from ..ignored import Ignored
from ..packages import packages_of
from ..reading import located, parsed, read_bytes, short_repr
from .of_urdf import VERSION as URDF_AS
from .of_urdf import model_of

VERSION = "included version"  # the attribute of an included model that has the version of its file
MOST_FILES, DEEPEST = 1000, 20
_WITHOUT_BODIES = ("sun", "ground_plane", "ground plane", "asphalt_plane", "gas_station_floor")
FRAMES = (1, 7)  # the version from which names are unique, and poses and axes may be relative to named frames
_OVERRIDES = ("static", "pose", "placement_frame")


def numbers_of(version: str) -> tuple[int, ...]:
    """The numbers of a version of a file that is included."""
    return tuple(int(word) for word in version.split(".") if word.isdigit())


class Includes:
    """Expands the includes of one file; `folders` are those of :func:`pinconsist.formats.sdf.read`."""

    def __init__(self, path: Path, folders, ignored: Ignored, ignore):
        self._path, self._ignored, self._ignore, self._read = path, ignored, set(ignore), 0
        self._folders = [Path(folder) for folder in folders]
        self.packages: list[Path] = []  # of which files were read
        here = Path(os.path.abspath(path)).parent
        self._roots = [Path(os.path.realpath(folder)) for folder in (here, *folders)]
        around = (here, here.parent, *(Path(folder) for folder in folders))
        self._models = [inner for folder in around for inner in (folder, folder / "models")]

    def expand(self, holder: Element, file: Path, depth: int = 0) -> None:
        """Replace the includes below a world or model by models."""
        if depth > DEEPEST:
            raise FormatError(f"includes are nested more than {DEEPEST} deep: does a model include itself?")
        for node in list(holder.iter()):
            for child in [each for each in node if each.tag == "include"]:
                place = list(node).index(child)
                model = self._included(child, file, depth)
                node.remove(child)
                if model is not None:
                    merged = child.get("merge", "false").strip() in ("true", "1")
                    node[place:place] = merged_elements(model) if merged else [model]

    def _included(self, include, file, depth) -> Element | None:
        uri = (include.findtext("uri") or "").strip()
        name = (include.findtext("name") or "").strip()
        element = f"include {short_repr(uri)}"
        last = uri.rstrip("/").rpartition("/")[2].lower()
        if {uri, name, last} & self._ignore:
            self._ignored.add(f"include of {last[:40]!r} (left out)")
            return None
        if last in _WITHOUT_BODIES:
            self._ignored.add(FLOOR, last != "sun")
            return None
        with located(element=element):
            source = self.find(uri, file)
            self._read += 1
            if self._read > MOST_FILES:
                raise FormatError(f"more than {MOST_FILES} files are included")
            root = parsed(read_bytes(source))
            if root.tag.rpartition("}")[2] == "robot":
                models, version = [model_of(root, self._ignored)], URDF_AS
            else:
                models, version = root.findall("model"), root.get("version", "1.6")
            if len(models) != 1:
                raise FormatError(f"{source.name} has {len(models)} models; one is needed")
            model = deepcopy(models[0])
            self.expand(model, source, depth + 1)
        model.set(VERSION, version)
        if name:
            model.set("name", name)
        for tag in _OVERRIDES:
            given = include.find(tag)
            if given is None:
                continue
            if tag == "placement_frame":
                model.set(tag, (given.text or "").strip())
                continue
            for own in model.findall(tag):
                model.remove(own)
            SubElement(model, tag, given.attrib).text = given.text
        for plugin in include.findall("plugin"):
            model.append(plugin)
        return model

    def find(self, uri: str, file: Path) -> Path:
        """The file of a model; FormatError if it is not there, or outside of the folders."""
        scheme, mark, rest = uri.partition("://")
        scheme, rest = (scheme, rest) if mark else ("", uri)
        if scheme not in ("", "model", "file", "package"):
            raise FormatError(f"nothing is downloaded; put the model beside the file, {_advice(uri)}")
        starts = self._models if scheme in ("model", "package") else (file.parent, *self._models)
        places = [(start, rest) for start in starts] if rest else []
        if scheme == "package":
            places += self._in_package(*rest.partition("/")[::2], file)
        outside = False
        for start, inner in places:
            found = Path(os.path.normpath(start / inner))
            if not any(found.exists() for found in (found, found / "model.sdf")):
                continue
            inside = _within(found, self._roots) or (scheme == "model" and ".." not in rest and start in self._models)
            if not inside or not _within(Path(os.path.realpath(found)), [*self._roots, Path(os.path.realpath(start))]):
                outside = True
                continue
            return found if found.is_file() else _of_folder(found)
        if outside:
            raise FormatError(
                f"it is outside the folder of the scene; pass its folder as package_dirs=, {_advice(uri)}"
            )
        raise FormatError(f"there is no such model beside the file; pass its folder as package_dirs=, {_advice(uri)}")

    def _in_package(self, name, inner, file) -> list[tuple[Path, str]]:
        """The folder of a ROS package, whose files may be read, and the path in it."""
        folder = packages_of(file, self._folders).get(name)
        if folder is None:
            return []
        self.packages.append(folder)
        self._roots.append(Path(os.path.realpath(folder)))
        return [(folder, inner)]


def merged_elements(model: Element) -> list[Element]:
    """The elements of a model that is merged into the one that includes it; a frame stands for that of the model."""
    name = f"_merged__{model.get('name')}__model__"
    element = f"include {model.get('name', '')[:60]!r}"
    if model.get("placement_frame"):
        raise FormatError("a merged model cannot have a placement_frame; give its <pose>", element=element)
    links = [each.get("name", "") for tag in ("link", "model") for each in model.findall(tag)]
    if not links:
        raise FormatError("a model that has no link cannot be merged; include it without merge=", element=element)
    if (version := numbers_of(model.get(VERSION, ""))) < FRAMES:
        _as_of_today(model, version, links)
    frame = Element("frame", name=name, attached_to=model.get("canonical_link") or links[0])
    pose = model.find("pose")
    place = SubElement(frame, "pose", {} if pose is None else pose.attrib)
    place.text = "0 0 0 0 0 0" if pose is None else pose.text
    if not place.get("relative_to"):
        place.set("relative_to", "__model__")
    parts = [each for each in model if each.tag not in ("pose", "static", "self_collide", "allow_auto_disable")]
    for each in parts:
        own = each.find("pose")
        if each.tag in ("link", "model") or (each.tag == "frame" and not each.get("attached_to")):
            own = SubElement(each, "pose") if own is None else own
            if not own.get("relative_to"):
                own.set("relative_to", name)
        for inner in each.iter() if each.tag != "model" else ():
            for key in ("relative_to", "expressed_in", "attached_to"):
                if inner.get(key) == "__model__":
                    inner.set(key, name)
            if inner.tag in ("parent", "child") and (inner.text or "").strip() == "__model__":
                inner.text = name
    return [frame, *parts]


def _as_of_today(model: Element, version, links) -> None:
    """Say in the present version what an older one means by the axes of joints, and by names that links have, too."""
    for joint in model.findall("joint"):
        if joint.get("name") in links:
            joint.set("name", f"{joint.get('name')}_joint")
        for axis in (each for tag in ("axis", "axis2") for each in joint.findall(tag)):
            flag, xyz = axis.find("use_parent_model_frame"), axis.find("xyz")
            of_model = version < (1, 5) or (flag is not None and (flag.text or "").strip() in ("1", "true"))
            if flag is not None:
                axis.remove(flag)
            if of_model:
                xyz = SubElement(axis, "xyz") if xyz is None else xyz
                xyz.set("expressed_in", xyz.get("expressed_in") or "__model__")


def _advice(uri):
    return f"or ignore=[{uri!r}] loads the scene without it"


def _within(path, roots) -> bool:
    return any(path.is_relative_to(root) for root in roots)


def _of_folder(folder: Path) -> Path:
    """The file of the highest version that ``model.config`` names, or ``model.sdf``."""
    config = folder / "model.config"
    if not config.is_file():
        return folder / "model.sdf"
    named = [
        (each.get("version", "0"), (each.text or "").strip()) for each in parsed(read_bytes(config)).findall("sdf")
    ]
    named = [(version, name) for version, name in named if name and "/" not in name and ".." not in name]
    if not named:
        return folder / "model.sdf"
    return folder / max(named, key=lambda each: [int(word) if word.isdigit() else 0 for word in each[0].split(".")])[1]
