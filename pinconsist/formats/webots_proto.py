"""PROTO nodes of Webots: nodes with parameters, from files beside a world, written out.

A PROTO is searched for where ``EXTERNPROTO`` says; else, and if this is not in the scene's folders, by its name beside
the file, in ``protos/`` there or in the folder above, and in ``package_dirs``. Nothing is downloaded. One whose text
is a program (``%{ … }%``, ``%< … >%``) is not run, and left as it is.
"""

import os
import re
from dataclasses import dataclass, field
from pathlib import Path

from ..errors import FormatError
from .reading import read_bytes, short_repr

DEEPEST, MOST = 30, 5_000
PROJECTS = ("worlds", "protos")  # folders of a project, whose other folders may be read, too
CONVERT = 'In Webots, "Convert to Base Node(s)" writes it out'


class Is(str):
    """The name of a parameter, where a PROTO has its value."""


@dataclass
class Proto:
    """A PROTO: the values of its parameters, and its first node, which has the parameters in its fields."""

    name: str
    parameters: dict
    body: object = None  # Vrml
    scope: "Scope | None" = None
    is_program: bool = False


@dataclass
class Scope:
    """Where the PROTOs of a file are: paths by name, and those that are defined in it."""

    file: Path
    paths: dict[str, str] = field(default_factory=dict)
    own: dict[str, Proto] = field(default_factory=dict)
    version: tuple[int, str] = (2022, "b")


class Protos:
    """Writes out the PROTO nodes of a world; `parse` reads a file: text → nodes, version, scope."""

    def __init__(self, path: Path, folders, parse, known):
        self._parse, self._known, self._count = parse, frozenset(known), 0
        here = Path(os.path.abspath(path)).parent
        project = next((each.parent for each in (here, *here.parents[:4]) if each.name in PROJECTS), here)
        self._folders = [here, project, *(Path(os.path.abspath(folder)) for folder in folders)]
        self._files: dict[Path, Scope] = {}
        self.missing: dict[str, str] = {}  # name → where it would be
        self.programs: set[str] = set()

    def written_out(self, nodes, scope: Scope) -> list:
        return [self._expanded(node, scope, 0) for node in nodes]

    def _expanded(self, node, scope, depth):
        """The node without PROTOs, in its fields, too."""
        if depth > DEEPEST:
            raise FormatError(f"PROTO nodes are nested more than {DEEPEST} deep: does one contain itself?")
        made = type(node)(node.type, node.label)
        for key, value in node.items():
            made[key] = self._value(value, scope, depth)
        proto = None if node.type in self._known else self._find(node.type, scope)
        if proto is None:
            return made
        if proto.is_program:
            self.programs.add(node.type)
            return made
        self._count += 1
        if self._count > MOST:
            raise FormatError(f"more than {MOST:,} PROTO nodes")
        inside = self._expanded(_filled(proto.body, {**proto.parameters, **made}), proto.scope, depth + 1)
        inside.label = made.label or inside.label
        return inside

    def _value(self, value, scope, depth):
        if isinstance(value, list):
            return [self._value(each, scope, depth) for each in value]
        return self._expanded(value, scope, depth + 1) if hasattr(value, "nodes") else value

    def _find(self, name, scope) -> Proto | None:
        if name in scope.own:
            return scope.own[name]
        if name in self.missing or not re.fullmatch(r"[\w.+-]+", name):
            return None
        file = next((file for file in self._places(name, scope) if file.is_file() and self._inside(file)), None)
        if file is None:
            self.missing[name] = scope.paths.get(name, "")
            return None
        return self.read(file).own.get(name)

    def _places(self, name, scope):
        """Where the file of a PROTO may be."""
        given = scope.paths.get(name, "")
        if given and "://" not in given:
            yield Path(os.path.normpath(scope.file.parent / given))
        for folder in (scope.file.parent, scope.file.parent.parent, *self._folders):
            yield folder / f"{name}.proto"
            yield folder / "protos" / f"{name}.proto"

    def _inside(self, file) -> bool:
        real = [Path(form(file)) for form in (os.path.abspath, os.path.realpath)]
        folders = [Path(form(folder)) for folder in self._folders for form in (os.path.abspath, os.path.realpath)]
        return all(any(each.is_relative_to(folder) for folder in folders) for each in real)

    def read(self, file: Path) -> Scope:
        """The PROTOs of a file."""
        if file not in self._files:
            text = read_bytes(file).decode("utf-8", errors="replace")
            self._files[file] = Scope(file)  # one that contains itself
            if _is_program(text):
                self._files[file].own[file.stem] = Proto(file.stem, {}, is_program=True)
            else:
                self._files[file] = self._parse(text, file)[2]
        return self._files[file]


def _is_program(text) -> bool:
    plain = re.sub(r'"(?:[^"\\]|\\.)*"|#[^\n]*', "", text)
    return "%<" in plain or "%{" in plain


def _filled(value, given):
    """A value with the parameters that it names."""
    if isinstance(value, Is):
        if value not in given:
            raise FormatError(f"IS {str(value)[:40]}: the PROTO has no such parameter")
        return given[value]
    if isinstance(value, list):
        found = []
        for each in value:
            filled = _filled(each, given)
            found += filled if isinstance(each, Is) and isinstance(filled, list) else [filled]
        return found
    if not hasattr(value, "nodes"):
        return value
    made = type(value)(value.type, value.label)
    for key, each in value.items():
        made[key] = _filled(each, given)
    return made


def name_of(path: str) -> str:
    """The name of the PROTO that an EXTERNPROTO names by its file."""
    if not path.lower().endswith(".proto"):
        raise FormatError(f"EXTERNPROTO {short_repr(path)} is not the path of a .proto file")
    return path.replace("\\", "/").rpartition("/")[2][: -len(".proto")]
