"""Helpers for all file readers: size limits, safe XML, numbers, and errors that name the file and the element."""

import difflib
import hashlib
import logging
import math
import re
from collections.abc import Iterable
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, ParseError
from xml.parsers import expat

from ..errors import CONTROLS, FormatError, InputError
from ..mechanism.checks import near as resembling

DRAKE = "{http://drake.mit.edu}"  # the namespace of Drake's extensions
LARGEST = 1e30  # of a scene's numbers, except limits: products of several of them still fit into a float
MAX_XML_BYTES = 50_000_000
_CLOSES = re.compile(
    r"loop|clos(ed|ure|ing)|constraint|equality|bushing|weld|coupl|mimic|gearbox|spring_damper|detachable|attach_?links?",
    re.IGNORECASE,
)
_log = logging.getLogger(__name__)

_read: ContextVar[list | None] = ContextVar("files read", default=None)


@dataclass(frozen=True)
class RobotFile:
    """The content of a robot's file, in any format."""

    model: Any  # pin.Model, the tree
    shapes: str  # a URDF text with the shapes of the links
    loops: tuple = ()
    couplings: tuple = ()  # in the mechanism they follow all loops
    forces: tuple = ()
    guess: dict = field(default_factory=dict)  # joint → value, the initial guess of the assembly
    actuated: tuple[str, ...] = ()  # motorised joints
    ignored: tuple[str, ...] = ()  # what has no effect, counted
    solids: tuple = ()  # collision shapes, see ground.py
    planes: tuple = ()  # of the world


@contextmanager
def files_read():
    """Return the list of (path, SHA-256) of all files that are read within the block."""
    before = _read.set(found := [])
    try:
        yield found
    finally:
        _read.reset(before)


@contextmanager
def located(path="", element: str = "", prefix: str = ""):
    """Add file and element to a FormatError that lacks them; convert an InputError to one, without its `prefix`."""
    try:
        yield
    except FormatError as error:
        where = {"path": error.path or path or "", "element": error.element or element}
        raise FormatError(error.reason, **where) from error.__cause__
    except InputError as error:
        raise FormatError(str(error).removeprefix(prefix), path=path or "", element=element) from error


def read_bytes(path: Path, limit: int = MAX_XML_BYTES) -> bytes:
    """The content of a regular file of at most `limit` bytes, or FormatError."""
    try:
        if not path.is_file():
            reason = "this is a folder or a device, not a file" if path.exists() else "no such file"
            raise FormatError(reason, path=path)
        with path.open("rb") as file:
            content = file.read(limit + 1)
    except FormatError:
        raise
    except (OSError, ValueError) as error:
        raise FormatError(f"cannot be read: {error}", path=path) from error
    if len(content) > limit:
        raise FormatError(f"more than {limit // 1_000_000} MB, which is too large for a file of this kind", path=path)
    note_read(path, hashlib.sha256(content).hexdigest())
    return content


FOLDERS_ABOVE = 4  # folders above that of a scene, in which its other files may be
SHALLOW = 3  # parts of the path of a folder that is not offered, as it holds too much


def asking_for(path, folder) -> str:
    """The end of a message about a file outside of the folder of a scene: how to have it read."""
    path, folder = Path(path).absolute(), Path(folder).absolute()
    above = [
        each for each in list(folder.parents)[:FOLDERS_ABOVE] if path.is_relative_to(each) and len(each.parts) > SHALLOW
    ]
    home = (above or [path.parent])[0]
    return f"only files there are read, and in package_dirs=[{str(home)!r}] (--package-dir)"


def note_read(path: Path, digest: str) -> None:
    """Add a file to those of :func:`files_read`."""
    noted = _read.get()
    if noted is not None:
        noted.append((path.absolute(), digest))


def near(name: object, names) -> str:
    """The end of a message about an unknown name: similar names, or all existing ones."""
    names = sorted(set(names))
    listed = f"; available: {', '.join(names[:12])}{', …' if len(names) > 12 else ''}" if names else ""
    return resembling(name, names) or listed


def require_known(name: object, names, reason: str, element: str = "") -> None:
    """Raise FormatError with this reason, and similar names, if a name is not one of `names`."""
    if name not in names:
        raise FormatError(f"{reason}{near(name, names)}", element=element)


def short_repr(value: object) -> str:
    """A value of a file for a message, shortened to a readable length."""
    try:
        text = repr(value)
    except ValueError:  # Python does not write out integers of thousands of digits
        text = "a very long number"
    return text if len(text) <= 80 else text[:77] + "…"


def finite(value: object, largest: float = LARGEST) -> float | None:
    """A number, or a text converted to a number; None if it is not finite or larger than any scene needs."""
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        return None
    try:
        number = float(value)
    except (ValueError, OverflowError):
        return None
    return number if math.isfinite(number) and abs(number) <= largest else None


def bound(*values: object) -> str:
    """The end of a message about values that are not valid numbers: the upper bound, if that is the reason."""
    immense = any(finite(value) is None and finite(value, math.inf) is not None for value in values)
    return f" (the largest is {LARGEST:g})" if immense else ""


def floats(text: str, count: int, element: str, label: str = "", largest: float = LARGEST) -> tuple[float, ...]:
    """The `count` finite numbers in a text, or a FormatError whose message starts with `label`."""
    words = text.split()
    values = tuple(value for word in words if (value := finite(word, largest)) is not None)
    if not len(values) == len(words) == count:
        what = "a finite number" if count == 1 else f"{count} finite numbers"
        raise FormatError(f"{label}{short_repr(text)} is not {what}{bound(*words)}", element=element)
    return values


def finite_numbers(values: list, count: int, given: object, element: str, label: str = "") -> tuple[float, ...]:
    """The `count` finite numbers in a list, or a FormatError with what is `given` whose message starts with `label`."""
    found = tuple(number for value in values if (number := finite(value)) is not None)
    if not len(found) == len(values) == count:
        raise FormatError(f"{label}{short_repr(given)} is not {count} finite numbers", element=element)
    return found


_DECLARATION = re.compile(rb"<\?xml\s.*?\?>", re.DOTALL)


def parsed(content: bytes) -> Element:
    """The root element of an XML document; FormatError if it is invalid or has document types or entities."""
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import fromstring

    try:
        root = fromstring(content, forbid_dtd=True)
    except DefusedXmlException as error:
        raise FormatError(f"document types and entities are refused for safety ({type(error).__name__})") from error
    except (ParseError, ValueError, LookupError) as error:  # the last two: encodings
        if "unbound prefix" in str(error) and (bound := _with_prefixes_bound(content)) != content:
            return parsed(bound)
        plain = _without_comments(content)
        if plain == content and "declaration not at start" in str(error):  # below a comment or an empty line
            plain = _DECLARATION.sub(b"", content, count=1)
        if plain != content:
            return parsed(plain)
        raise FormatError(f"not well-formed XML: {error}") from error
    for element in root.iter():
        for key, value in element.items():
            if CONTROLS.search(value):
                raise FormatError(f"{key}={short_repr(value)} has control characters", element=f"<{element.tag}>")
        space, _, tag = str(element.tag).rpartition("}")
        if "drake" in space:  # declared in several ways, or not at all
            element.tag = DRAKE + tag
    return root


def _without_comments(content: bytes) -> bytes:
    """The document from its first ``<`` to its last ``>``, without comments and ``<!`` without a name; same lines.

    Elsewhere comments may have ``--`` inside; TinyXML skips the others, and what follows the end, and needs no space
    between two attributes.
    """

    def lines(match):
        return b"\n" * match[0].count(b"\n")

    start = max(content.find(b"<"), 0)
    inner = re.sub(rb"(?s)<!--.*?-->|<![^\[A-Za-z][^>]*>", lines, content[start : content.rfind(b">") + 1])
    inner = re.sub(rb"(=\s*(?:\"[^\"<>]*\"|'[^'<>]*'))(?=[A-Za-z_])", rb"\1 ", inner)
    return b"\n" * content[:start].count(b"\n") + inner


def _with_prefixes_bound(content: bytes) -> bytes:
    """The document with undeclared prefixes, such as ``drake:``, declared in its root; many files need it."""
    used = re.findall(rb"(?:<|\s(?=[\w.:-]+\s*=))([A-Za-z_][\w.-]*):", content)  # of tags and of attributes
    prefixes = set(used) - {b"xml", b"xmlns"} - set(re.findall(rb"xmlns:([\w.-]+)", content))
    root = next((m for m in re.finditer(rb"(?s)<!--.*?-->|<\?.*?\?>|<([A-Za-z_][\w.:-]*)", content) if m[1]), None)
    if root is None:
        return content
    names = b"".join(b' xmlns:%b="%b"' % (prefix, prefix) for prefix in sorted(prefixes))
    return content[: root.end()] + names + content[root.end() :]


def shown(tag: str) -> str:
    """A tag in messages: without its namespace, unless that is Drake's."""
    space, _, short = tag.rpartition("}")
    return f"drake:{short}" if "drake" in space else short


def text(*values: float) -> str:
    """Numbers as an XML attribute, without loss of digits."""
    # other parsers fail on subnormal numbers, which mean zero here
    return " ".join(repr(float(value)) if abs(value) > 1e-300 else "0" for value in values)


class Node:
    """An XML element and its name in messages; a missing element is false, and all its values are defaults."""

    def __init__(self, xml: Element | None, name: str = ""):
        self.xml, self.name = xml, name

    def __bool__(self):
        return self.xml is not None

    def error(self, reason: str) -> FormatError:
        return FormatError(reason, element=self.name)

    def get(self, key: str, default: str | None = ""):
        return default if self.xml is None else self.xml.get(key, default)

    def text(self) -> str:
        return ((self.xml.text if self else "") or "").strip()

    def child(self, tag: str, required: bool = False):
        found = None if self.xml is None else self.xml.find(tag)
        if found is None and required:
            raise self.error(f"<{tag}> is missing")
        return self._inside(found, tag)

    def children(self, tag: str) -> list:
        return [] if self.xml is None else [self._inside(each, tag) for each in self.xml.findall(tag)]

    def solid(self):
        """The first child of ``<geometry>``, named by its tag."""
        found = self.child("geometry/*").xml
        return self._inside(found, "nothing" if found is None else str(found.tag))

    def named(self, tag: str) -> dict:
        """The children with this tag by their names, which must be present and unique."""
        found = {}
        for number, each in enumerate(self.children(tag), start=1):
            name = each.get("name")
            if not name.strip():
                raise FormatError("it has no name", element=f"{tag} number {number}")
            each.name = f"{tag} {name!r}"
            if name in found:
                raise each.error(f"two {tag}s have this name")
            found[name] = each
        return found

    def numbers(self, key: str, count: int = 1, default=None, largest: float = LARGEST) -> tuple[float, ...]:
        """The finite numbers of an attribute, which is required if there is no default."""
        given = self.get(key, None)
        if given is None and default is None:
            raise self.error(f"attribute {key!r} is missing")
        return default if given is None else floats(given, count, self.name, f"{key}=", largest)

    def number(self, key: str, default: float | None = None, largest: float = LARGEST) -> float:
        """The finite number of an attribute, which is required if there is no default."""
        return self.numbers(key, 1, None if default is None else (default,), largest)[0]

    def _inside(self, xml, tag):
        tag = shown(tag)
        return type(self)(xml, f"{self.name}: {tag}" if self.name else tag)


def closing(elements: Iterable[Element], known: Iterable[str]) -> list[tuple[str, Element]]:
    """(tag, element) of unknown elements that seem to join bodies, by their tags; includes misspelt ``loop_joint``.

    Without them the robot would come apart, see :func:`refuse`. Plugins are judged by their names and files, as those
    of Gazebo that join bodies are. Other unknown elements are counted, see :mod:`.ignored`.
    """
    found = []
    for element in elements:
        space, _, tag = str(element.tag).rpartition("}")
        tag = f"drake:{tag}" if "drake" in space else tag  # messages omit other namespaces
        if tag == "plugin":
            words = re.sub(r"open_?loop", "", f"{element.get('name', '')} {element.get('filename', '')}")
            if _CLOSES.search(words):
                found.append((f"plugin {element.get('name', '').rpartition('::')[2]}", element))
            continue
        like = (
            tag == "drake:joint"
            or _CLOSES.search(tag)
            or difflib.get_close_matches(tag.lower(), ["loop_joint"], cutoff=0.8)
        )
        if like and tag not in known:
            found.append((tag, element))
    return found


def refuse(found: Iterable[tuple[str, Element]], root: Element, content, advice: str) -> None:
    """Raise FormatError for the first (tag, element) of `found`."""
    for tag, element in found:
        name = element.get("name", "")
        raise FormatError(
            f"the extension <{tag}> is not supported, and without it the mechanism would be different: it closes a "
            f"loop or joins bodies; {advice}. "
            f"ignore=[{tag!r}] loads the file without it",
            element=f"line {_line(content, root, element)}, {tag}{f' {name!r}' if name else ''}",
        )


def log_left_out(tag: str, name: str) -> None:
    _log.info("<%s> %s: left out because of ignore=", tag, name)


def _line(content, root: Element, element: Element) -> int:
    """The line of an element, found by its number among those of its tag and name."""
    wanted = str(element.tag).rpartition("}")[2], element.get("name")
    alike = [each for each in root.iter() if (str(each.tag).rpartition("}")[2], each.get("name")) == wanted]
    lines, parser = [], expat.ParserCreate()

    def start(tag, attributes):
        if (tag.rpartition(":")[2], attributes.get("name")) == wanted:
            lines.append(parser.CurrentLineNumber)

    parser.StartElementHandler = start
    parser.Parse(content, True)
    place = next(i for i, each in enumerate(alike) if each is element)
    return lines[min(place, len(lines) - 1)] if lines else 0
