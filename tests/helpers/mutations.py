"""Mutations of valid files for fuzz tests: changed elements, attributes, keys and numbers, and cut texts."""

from __future__ import annotations

import re
from copy import deepcopy
from random import Random
from xml.etree.ElementTree import Element, ParseError, fromstring, tostring

import yaml

TEXTS = (
    "", " ", "0", "-1", "1", "nan", "inf", "-inf", "1e400", "1e308", "-1e200", "1e-320", "1e16", "0 0 0", "1 2",
    "1 2 3 4", "1 0 0", "nan 0 0", "1e308 1e308 1e308", "x", "true", "false", "none", "universe", "world", "ground",
    "__model__", "../../../etc/passwd", "package://../../x.stl", "é😀", "\u202e", "a" * 5000, "${pi}", "%s %d", "{0}",
    "a::b", "'", '"', "fixed", "floating", "planar", "ball", "hinge", "free", "revolute", "-0.0", "1_000", "١٢٣",
)  # fmt: skip
VALUES = (
    None, True, False, 0, -1, 1, 10**30, -(10**400), float("nan"), float("inf"), 1e308, 1e-320, "", "x", "nan", [], [1],
    [1, 2, 3], [0, 0, 0], ["a"], [[1]], {}, {"a": 1}, {1: 2}, "hinge", "point", "distance", "coupling", "drive",
    "universe", "a" * 5000,
)  # fmt: skip


def mutated_text(text: str, rng: Random) -> bytes:
    """Cut, duplicate, drop or change bytes at a random place."""
    content = bytearray(text.encode())
    for _ in range(rng.randint(1, 3)):
        place = rng.randrange(len(content) + 1)
        length = rng.choice((1, 1, 5, 50, len(content)))
        kind = rng.choice(("cut", "drop", "double", "byte", "insert"))
        if kind == "cut":
            del content[place:]
        elif kind == "drop":
            del content[place : place + length]
        elif kind == "double":
            content[place:place] = content[place : place + length]
        elif kind == "insert":
            content[place:place] = rng.choice((b"<", b">", b"\x00", b"&", b'"', b"<!--", b"\n", b"- ", b": ", b"\xff"))
        elif place < len(content):
            content[place] = rng.randrange(256)
    return bytes(content)


def mutated_xml(text: str, rng: Random) -> bytes:
    """One to four changes of elements and attributes; sometimes of the text itself."""
    if rng.random() < 0.15:
        return mutated_text(text, rng)
    root = fromstring(text)
    for _ in range(rng.randint(1, 4)):
        _change_xml(root, rng)
    try:
        return tostring(root, encoding="utf-8")
    except (ParseError, ValueError, TypeError):
        return mutated_text(text, rng)


def _change_xml(root: Element, rng: Random):
    nodes = list(root.iter())
    node, other = rng.choice(nodes), rng.choice(nodes)
    kinds = "delete double move tag attribute attribute attribute name drop swap add text"
    kind = rng.choice(kinds.split())
    parents = {child: parent for parent in nodes for child in parent}
    values = [value for each in nodes for value in each.attrib.values()]
    if kind == "delete" and node in parents:
        parents[node].remove(node)
    elif kind == "double" and node in parents:
        parents[node].insert(rng.randrange(len(parents[node]) + 1), deepcopy(node))
    elif kind == "move" and node in parents and node not in _line(other, parents):
        parents[node].remove(node)
        other.append(node)
    elif kind == "tag":
        node.tag = rng.choice([each.tag for each in nodes] + ["x"])
    elif kind == "attribute" and node.attrib:
        node.set(rng.choice(sorted(node.attrib)), rng.choice(TEXTS) if rng.random() < 0.6 else rng.choice(values))
    elif kind == "name" and node.attrib:
        key = rng.choice(sorted(node.attrib))
        node.set(rng.choice(sorted({name for each in nodes for name in each.attrib})), node.attrib.pop(key))
    elif kind == "drop" and node.attrib:
        node.attrib.pop(rng.choice(sorted(node.attrib)))
    elif kind == "swap":
        node.attrib, other.attrib = other.attrib, node.attrib
        node.text, other.text = other.text, node.text
    elif kind == "add" and node.attrib is not None:
        node.set(rng.choice(sorted({name for each in nodes for name in each.attrib} | {"x"})), rng.choice(TEXTS))
    elif kind == "text" and (node.text or "").strip():
        node.text = rng.choice(TEXTS)


def _line(node, parents):
    while node is not None:
        yield node
        node = parents.get(node)


def mutated_yaml(text: str, rng: Random) -> bytes:
    """One to four changes of keys and values; sometimes of the text itself."""
    if rng.random() < 0.2:
        return mutated_text(text, rng)
    record = yaml.safe_load(text)
    for _ in range(rng.randint(1, 4)):
        record = _change_plain(record, rng)
    return yaml.safe_dump(record, allow_unicode=True, sort_keys=False).encode()


def _change_plain(record, rng: Random):
    """The record, changed at a random place."""
    holders = [record] if isinstance(record, dict | list) else []
    for holder in holders:
        inside = holder.values() if isinstance(holder, dict) else holder
        holders += [each for each in inside if isinstance(each, dict | list)]
    filled = [holder for holder in holders if holder]
    if not filled:
        return deepcopy(rng.choice(VALUES))
    holder = rng.choice(filled)
    keys = list(holder) if isinstance(holder, dict) else list(range(len(holder)))
    key, kind = rng.choice(keys), rng.choice(("value", "value", "delete", "rename", "double", "swap"))
    if kind == "value":
        holder[key] = deepcopy(rng.choice(VALUES))
    elif kind == "delete":
        del holder[key]
    elif kind == "rename" and isinstance(holder, dict):
        holder[rng.choice((*keys, "x", 1, "name", "kind", "joint"))] = holder.pop(key)
    elif kind == "double" and isinstance(holder, list):
        holder.append(deepcopy(holder[key]))
    elif kind == "swap":
        other = rng.choice(keys)
        holder[key], holder[other] = holder[other], holder[key]
    return record


WORDS = re.compile(r'"[^"\n]*"|[\w.+-]+|[^\s\w]')


def mutated_words(text: str, rng: Random) -> bytes:
    """One to four changes of words, numbers, strings and brackets; sometimes of the text itself."""
    if rng.random() < 0.15:
        return mutated_text(text, rng)
    head, _, body = text.partition("\n")
    for _ in range(rng.randint(1, 4)):
        words = list(WORDS.finditer(body))
        if not words:
            break
        one, other = rng.choice(words), rng.choice(words)
        kind = rng.choice(("swap", "value", "value", "delete", "double"))
        new = {"swap": other[0], "value": rng.choice(TEXTS), "delete": "", "double": f"{one[0]} {one[0]}"}[kind]
        body = body[: one.start()] + new + body[one.end() :]
    return f"{head}\n{body}".encode(errors="replace")
