"""Words of SDF: numbers, flags and poses from the texts of elements. FormatErrors do not know the file yet."""

from __future__ import annotations

import logging
import math
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from ...errors import FormatError
from ..reading import bound, finite, near, shown

INFINITE = 1e16
"""Limits from here on mean none, as in libsdformat."""

_TRUE, _FALSE = ("true", "1"), ("false", "0")
_log = logging.getLogger(__name__)


def vector(node: Element | None, tag: str, element: str, default: tuple[float, ...]) -> tuple[float, ...]:
    """The finite numbers of a child element, as many as the default that stands in for it."""
    found = None if node is None else node.find(tag)
    if found is None:
        return default
    text = found.text or ""
    numbers = [finite(word) for word in text.split()]
    if len(numbers) != len(default) or None in numbers:
        what = "a finite number" if len(default) == 1 else f"{len(default)} finite numbers"
        reason = f"{shown(text.strip())} is not {what}{bound(*text.split())}"
        raise FormatError(reason, element=f"{element}: {tag}")
    return tuple(numbers)


def number(node: Element | None, tag: str, element: str, default: float = 0.0) -> float:
    """The finite number of a child element."""
    return vector(node, tag, element, (default,))[0]


def limit(node: Element | None, tag: str, element: str, default: float) -> float:
    """A limit, which may be infinite."""
    found = None if node is None else node.find(tag)
    text = str(default) if found is None else (found.text or "").strip()
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if math.isnan(value):
        raise FormatError(f"{shown(text)} is not a number", element=f"{element}: {tag}")
    return math.copysign(math.inf, value) if abs(value) >= INFINITE else value


def flag(node: Element, tag: str, element: str, default: bool = False) -> bool:
    """The truth value of a child element."""
    found = node.find(tag)
    return default if found is None else truth(found.text or "", f"{element}: {tag}")


def truth(text: str, element: str) -> bool:
    """A truth value of SDF: true, false, 1 or 0."""
    word = text.strip().lower()
    if word not in (*_TRUE, *_FALSE):
        raise FormatError(f"{shown(text.strip())} is neither true nor false", element=element)
    return word in _TRUE


def word(node: Element, tag: str, element: str) -> str:
    """The text of a child element that must be there."""
    found = node.find(tag)
    text = "" if found is None else (found.text or "").strip()
    if not text:
        raise FormatError(f"<{tag}> is missing" if found is None else f"<{tag}> is empty", element=element)
    return text


def pose(node: Element | None, element: str) -> tuple[pin.SE3, str]:
    """The `<pose>` of an element, and the frame that it is relative to (empty: the default one).

    x y z in m, then roll pitch yaw in rad, or degrees, or a quaternion x y z w, which is normalised.
    """
    found = None if node is None else node.find("pose")
    if found is None:
        return pin.SE3.Identity(), ""
    element = f"{element}: pose"
    style = found.get("rotation_format", "euler_rpy")
    if style not in ("euler_rpy", "quat_xyzw"):
        raise FormatError(f"the rotation_format {shown(style)} is neither euler_rpy nor quat_xyzw", element=element)
    count = 6 if style == "euler_rpy" else 7
    text = found.text or ""
    numbers = [finite(each) for each in text.split()] or [0.0] * 6 + [1.0] * (count - 6)
    if len(numbers) != count or None in numbers:
        reason = f"{shown(text.strip())} is not {count} finite numbers{bound(*text.split())}"
        raise FormatError(reason, element=element)
    turn = np.array(numbers[3:])
    if style == "euler_rpy":
        rotation = pin.rpy.rpyToMatrix(np.radians(turn) if truth(found.get("degrees", "false"), element) else turn)
    else:
        largest = np.abs(turn).max()
        if largest == 0:
            raise FormatError("the quaternion is zero", element=element)
        turn = turn / largest  # no overflow of the norm
        rotation = pin.Quaternion(turn / np.linalg.norm(turn)).toRotationMatrix()
    # before version 1.7 the attribute was called frame
    return pin.SE3(rotation, np.array(numbers[:3])), found.get("relative_to") or found.get("frame") or ""


def tell_unknown(node: Element, known: tuple[str, ...], element: str) -> None:
    """Warn of child elements that have no effect here because nobody knows them: most likely misspelt."""
    for tag in dict.fromkeys(child.tag for child in node):
        if tag not in known:
            _log.warning("%s: the element <%s> is not known and has no effect%s", element, tag, near(tag, known))
