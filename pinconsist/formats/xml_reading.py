"""What the readers of XML files share: safe parsing, and numbers from attributes."""

from __future__ import annotations

from xml.etree.ElementTree import Element, ParseError

from defusedxml import DefusedXmlException
from defusedxml.ElementTree import fromstring

from ..errors import FormatError
from .reading import LARGEST, bound, finite, shown

MAX_BYTES = 50_000_000
"""No scene's file is larger."""


def parsed(content: bytes) -> Element:
    """The root element of an XML document without document types and entities, or FormatError."""
    try:
        return fromstring(content, forbid_dtd=True)
    except DefusedXmlException as error:
        raise FormatError(f"document types and entities are refused for safety ({type(error).__name__})") from error
    except (ParseError, ValueError, LookupError) as error:  # the last two: encodings
        raise FormatError(f"not well-formed XML: {error}") from error


def child(node: Element, tag: str, element: str) -> Element:
    """The first child of this tag; FormatError names `element` where there is none."""
    found = node.find(tag)
    if found is None:
        raise FormatError(f"<{tag}> is missing", element=element)
    return found


def named(node: Element, tag: str) -> dict[str, Element]:
    """The children of this tag by their names, which must be there and differ."""
    found = {}
    for number, each in enumerate(node.findall(tag), start=1):
        name = each.get("name", "")
        element = f"{tag} {name!r}"
        if not name.strip():
            raise FormatError("it has no name", element=f"{tag} number {number}")
        if name in found:
            raise FormatError(f"two {tag}s have this name", element=element)
        found[name] = each
    return found


def numbers(node: Element, key: str, element: str, count: int = 1, default=None, largest=LARGEST) -> tuple[float, ...]:
    """The finite numbers of an attribute; without a default it must be there."""
    given = node.get(key)
    if given is None:
        if default is None:
            raise FormatError(f"attribute {key!r} is missing", element=element)
        return default
    values = [finite(word, largest) for word in given.split()]
    if len(values) != count or None in values:
        what = "a finite number" if count == 1 else f"{count} finite numbers"
        raise FormatError(f"{key}={shown(given)} is not {what}{bound(*given.split())}", element=element)
    return tuple(values)


def text(*values: float) -> str:
    """Numbers as an attribute, exactly."""
    # numbers below the smallest normal one trip other parsers, and mean zero
    return " ".join(repr(float(value)) if abs(value) > 1e-300 else "0" for value in values)
