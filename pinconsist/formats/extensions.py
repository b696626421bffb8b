"""Elements by which other programs close loops and that no reader here knows: a robot without them would come apart.

They are refused, with file and line, unless ``load(..., ignore=[...])`` names them: by tag, or by name. Whatever else
is unknown in a file (sensors, plugins, contact parameters) has no part in the motion and is left out.
"""

from __future__ import annotations

import difflib
import logging
import re
from collections.abc import Iterable
from xml.etree.ElementTree import Element
from xml.parsers import expat

from ..errors import FormatError

_CLOSES = re.compile(r"loop|clos(ed|ure|ing)|constraint|equality|bushing|weld|coupl|mimic|gearbox", re.IGNORECASE)
_log = logging.getLogger(__name__)


def tag_of(element: Element) -> str:
    """The tag without its namespace, which is shown as a prefix where it is Drake's."""
    space, _, tag = str(element.tag).rpartition("}")
    return f"drake:{tag}" if "drake" in space else tag


def closing(elements: Iterable[Element], known: Iterable[str]) -> list[tuple[str, Element]]:
    """(tag, element) of those that close a loop by their tag, or whose tag is ``loop_joint`` misspelt."""
    tags = [(tag_of(element), element) for element in elements]
    return [
        (tag, element)
        for tag, element in tags
        if tag not in known
        and (_CLOSES.search(tag) or difflib.get_close_matches(tag.lower(), ["loop_joint"], cutoff=0.8))
    ]


def refuse(found: Iterable[tuple[str, Element]], ignore, root: Element, content, advice: str) -> None:
    """Raise FormatError for the first of the (tag, element) `found` that `ignore` does not name."""
    for tag, element in found:
        name = element.get("name", "")
        if {tag, tag.rpartition(":")[2], tag.rpartition("/")[2], name} & set(ignore):
            _log.info("<%s> %s: left out, as ignore= says", tag, name)
            continue
        raise FormatError(
            f"<{tag}> is an extension that is not read, so that what it joins would come apart; {advice}. "
            f"ignore=[{tag!r}] (--ignore {tag}) loads the file without",
            element=f"line {_line(content, root, element)}, {tag}{f' {name!r}' if name else ''}",
        )


def _line(content, root: Element, element: Element) -> int:
    """The line on which an element of a document starts."""
    lines, parser = [], expat.ParserCreate()
    parser.StartElementHandler = lambda *_: lines.append(parser.CurrentLineNumber)
    parser.Parse(content, True)
    return lines[next(i for i, each in enumerate(root.iter()) if each is element)]
