"""What an MJCF file sets for the whole scene: compiler, option, and the classes of defaults."""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np

from ...errors import FormatError
from ..reading import near, shown
from .document import check_attributes
from .values import TURNS, flag, keyword, number, vector

MAIN = "main"
_FLAGS = ("gravity", "spring", "damper", "frictionloss", "equality", "constraint", "passive")
_GRAVITY = (0.0, 0.0, -9.81)
ACTUATORS = (
    "general", "motor", "position", "velocity", "intvelocity", "orientation", "pid", "damper", "cylinder", "muscle",
    "adhesion", "dcmotor", "plugin",
)  # fmt: skip
_PARTIAL = {"size", "stiffness", "damping"}
_CHECKED = ("joint", "geom", "site", "equality")
_IN_DEFAULTS = (*_CHECKED, "default", "mesh", "texture", "material", "camera", "light", "pair", "tendon", *ACTUATORS)


@dataclass(frozen=True)
class Compiler:
    """The ``<compiler>`` sections, the later ones in force."""

    degrees: bool
    eulerseq: str
    inertiafromgeom: str
    inertiagroups: tuple[float, float]
    boundmass: float
    boundinertia: float
    totalmass: float
    balanceinertia: bool
    autolimits: bool
    alignfree: bool
    meshdir: str
    strippath: bool

    def angle(self, value):
        """An angle, or several, of the file in rad."""
        return np.radians(value) if self.degrees else value


def compiler(root: Element) -> Compiler:
    """The compiler's settings, those that are not given at their defaults."""
    given = {}
    for node in root.findall("compiler"):
        check_attributes(node, "compiler")
        given |= node.attrib
    here = "compiler"
    if keyword(given, "coordinate", here, ("local", "global")) == "global":
        raise FormatError("global coordinates cannot be read; MuJoCo up to 2.3.3 converts such a file", element=here)
    eulerseq = given.get("eulerseq", "xyz")
    if len(eulerseq) != 3 or not set(eulerseq.lower()) <= set("xyz"):
        raise FormatError(f"eulerseq={shown(eulerseq)} is not three letters of x, y, z, X, Y, Z", element=here)
    groups = vector(given, "inertiagrouprange", here, 2, (0.0, 5.0))
    return Compiler(
        degrees=keyword(given, "angle", here, ("degree", "radian")) == "degree",
        eulerseq=eulerseq,
        inertiafromgeom=keyword(given, "inertiafromgeom", here, ("auto", "true", "false")),
        inertiagroups=(groups[0], groups[1]),
        boundmass=number(given, "boundmass", here, least=0.0),
        boundinertia=number(given, "boundinertia", here, least=0.0),
        totalmass=number(given, "settotalmass", here, default=-1.0),
        balanceinertia=flag(given, "balanceinertia", here),
        autolimits=flag(given, "autolimits", here, default=True),
        alignfree=flag(given, "alignfree", here),
        meshdir=given.get("meshdir", given.get("assetdir", "")),
        strippath=flag(given, "strippath", here),
    )


@dataclass(frozen=True)
class Option:
    """What acts on the whole scene: gravity, m/s², and the kinds of effects that are switched off."""

    gravity: tuple[float, float, float]
    disabled: frozenset[str]


def option(root: Element) -> Option:
    """The ``<option>`` sections, the later ones in force. Fluids are refused, solvers' settings have no effect."""
    given, flags = {}, {}
    for node in root.findall("option"):
        given |= node.attrib
        for child in node.findall("flag"):
            flags |= child.attrib
    for key, what in (("density", "lift and drag"), ("viscosity", "viscous forces")):
        if number(given, key, "option"):
            raise FormatError(f"{what} of a fluid are not computed here; set {key}=0", element="option")
    off = {key for key in _FLAGS if keyword(flags, key, "option: flag", ("enable", "disable")) == "disable"}
    off |= {"spring", "damper"} if "passive" in off else set()  # of older versions
    gravity = np.zeros(3) if "gravity" in off else vector(given, "gravity", "option", 3, _GRAVITY)
    return Option(tuple(gravity), frozenset(off))


class Defaults:
    """The classes of defaults: what an element says where it is silent itself."""

    def __init__(self, root: Element):
        self._classes: dict[str, dict[str, dict[str, str]]] = {MAIN: {}}
        for section in root.findall("default"):
            if section.get("class", MAIN) != MAIN:
                raise FormatError("the outermost class can only be called 'main'", element=_element(section))
            self._add(section, MAIN)
            self._add_inner(section)

    def _add_inner(self, section):
        waiting = [(child, MAIN) for child in section.findall("default")]
        while waiting:
            section, parent = waiting.pop()
            name = section.get("class", "")
            if not name:
                raise FormatError("it has no class", element=f"default in class {parent!r}")
            if name in self._classes:
                raise FormatError("another class has this name", element=_element(section))
            self._classes[name] = dict(self._classes[parent])
            self._add(section, name)
            waiting += [(child, name) for child in section.findall("default")]

    def _add(self, section, name):
        known = self._classes[name]
        for node in section:
            element = f"{_element(section)}: {node.tag}"
            if node.tag not in _IN_DEFAULTS:
                raise FormatError(f"this element is not known{near(node.tag, _IN_DEFAULTS)}", element=element)
            if node.tag in _CHECKED:
                check_attributes(node, element, "default equality" if node.tag == "equality" else None)
                if "name" in node.attrib:
                    raise FormatError("defaults have no name", element=element)
            known[node.tag] = _merged(known.get(node.tag, {}), node.attrib, element)

    def check(self, name: str, element: str) -> str:
        """The name itself; FormatError where there is no such class."""
        if name not in self._classes:
            raise FormatError(f"there is no class {shown(name)}{near(name, self._classes)}", element=element)
        return name

    def of(self, node: Element, element: str, inherited: str = MAIN, kind: str | None = None) -> dict[str, str]:
        """All attributes of an element, its own and those of its class."""
        name = self.check(node.get("class", inherited), element)
        return _merged(self._classes[name].get(kind or node.tag, {}), node.attrib, element)


def _merged(base, own, element):
    """Attributes over others. One way to write an orientation replaces another."""
    turns = [key for key in (*TURNS, "quat") if key in own]
    if len(turns) > 1:
        raise FormatError(f"several orientations are given: {', '.join(turns)}", element=element)
    others = [key for key in TURNS if key in base]
    if turns == ["quat"] and others:
        raise FormatError(
            f"whether its quat or the {others[0]} of its class counts differs among versions of MuJoCo; write the "
            f"orientation as {others[0]} here",
            element=element,
        )
    if turns:
        base = {key: value for key, value in base.items() if key not in TURNS}
    merged = base | own
    for key in _PARTIAL & base.keys() & own.keys():  # the first few numbers may be given, the others stay
        words = own[key].split()
        merged[key] = " ".join(words + base[key].split()[len(words) :])
    return merged


def _element(section):
    return f"default {section.get('class', MAIN)!r}"
