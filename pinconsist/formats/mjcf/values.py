"""Words of MJCF: numbers, keywords and poses from attributes. FormatErrors do not know the file yet."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pinocchio as pin

from ...errors import FormatError
from ..reading import bound, finite, near, shown

TURNS = ("axisangle", "xyaxes", "zaxis", "euler")
"""Ways to write an orientation beside ``quat``."""
_AXES = dict(zip("xyz", np.eye(3), strict=True))
_SHORTEST = 1e-7  # of a vector that gives a direction; MuJoCo's own bound


def vector(attributes: Mapping[str, str], key: str, element: str, count, default=None) -> np.ndarray | None:
    """The numbers of an attribute: `count` of them, or (least, most); the default where it is not there."""
    given = attributes.get(key)
    if given is None:
        return None if default is None else np.array(default, dtype=float)
    least, most = (count, count) if isinstance(count, int) else count
    values = [finite(word) for word in given.split()]
    if not least <= len(values) <= most or None in values:
        size = str(most) if least == most else f"{least} to {most}"
        what = "a finite number" if most == 1 else f"{size} finite numbers"
        raise FormatError(f"{key}={shown(given)} is not {what}{bound(*given.split())}", element=element)
    return np.array(values)


def number(attributes: Mapping[str, str], key: str, element: str, default: float = 0.0, least: float = -math.inf):
    """The one number of an attribute."""
    value = float(vector(attributes, key, element, 1, (default,))[0])
    if value < least:
        raise FormatError(f"{key}={value:g} is less than {least:g}", element=element)
    return value


def keyword(attributes: Mapping[str, str], key: str, element: str, words: tuple[str, ...]) -> str:
    """One of several words; the first where the attribute is not there."""
    word = attributes.get(key, words[0])
    if word not in words:
        raise FormatError(f"{key}={shown(word)} is not one of {', '.join(words)}", element=element)
    return word


def flag(attributes: Mapping[str, str], key: str, element: str, default: bool = False) -> bool:
    """``true`` or ``false``."""
    return keyword(attributes, key, element, ("true", "false") if default else ("false", "true")) == "true"


def named(names: Mapping, attributes: Mapping[str, str], key: str, element: str):
    """What an attribute refers to by its name."""
    name = attributes.get(key, "")
    if name not in names:
        raise FormatError(f"there is no {key.rstrip('12')} {shown(name)}{near(name, names)}", element=element)
    return names[name]


def direction(values: np.ndarray, what: str, element: str) -> np.ndarray:
    """A vector at unit length."""
    length = np.linalg.norm(values)
    if not length > _SHORTEST:
        raise FormatError(f"the {what} is the zero vector, or nearly", element=element)
    return values / length


def pose(attributes: Mapping[str, str], compiler, element: str) -> pin.SE3:
    """Position and orientation of an element, in its parent."""
    return pin.SE3(orientation(attributes, compiler, element), vector(attributes, "pos", element, 3, (0.0, 0.0, 0.0)))


def orientation(attributes: Mapping[str, str], compiler, element: str) -> np.ndarray:
    """The rotation matrix of an element, from whichever attribute gives it."""
    if (values := vector(attributes, "axisangle", element, 4)) is not None:
        return pin.AngleAxis(
            compiler.angle(values[3]), direction(values[:3], "axis of axisangle", element)
        ).toRotationMatrix()
    if (values := vector(attributes, "xyaxes", element, 6)) is not None:
        x = direction(values[:3], "x axis", element)
        y = direction(values[3:] - (x @ values[3:]) * x, "y axis, made normal to x,", element)
        return np.column_stack((x, y, np.cross(x, y)))
    if (values := vector(attributes, "zaxis", element, 3)) is not None:
        return turned_z(direction(values, "z axis", element))
    if (values := vector(attributes, "euler", element, 3)) is not None:
        return _euler(compiler.angle(values), compiler.eulerseq)
    return rotation(vector(attributes, "quat", element, 4, (1.0, 0.0, 0.0, 0.0)), f"{element}: quat")


def rotation(wxyz: np.ndarray, element: str) -> np.ndarray:
    """The rotation matrix of a quaternion in MuJoCo's order."""
    return pin.Quaternion(*direction(wxyz, "quaternion", element)).toRotationMatrix()


def turned_z(z: np.ndarray) -> np.ndarray:
    """The least rotation that takes the z axis to a unit vector."""
    across = np.array([-z[1], z[0], 0.0])
    size = np.linalg.norm(across)
    axis = across / size if size > 1e-10 else np.array([1.0, 0.0, 0.0])
    return pin.AngleAxis(math.atan2(size, z[2]), axis).toRotationMatrix()


def _euler(angles, sequence):
    turned = np.eye(3)
    for angle, axis in zip(angles, sequence, strict=True):
        turn = pin.AngleAxis(angle, _AXES[axis.lower()]).toRotationMatrix()
        turned = turned @ turn if axis.islower() else turn @ turned  # small letters turn with the frame
    return turned
