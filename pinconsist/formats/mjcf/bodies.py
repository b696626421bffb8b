"""The elements below ``<worldbody>`` as plain records: bodies and what they hold, with frames resolved."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from xml.etree.ElementTree import Element

import pinocchio as pin

from ...errors import FormatError
from ..reading import near
from .document import check_attributes
from .geoms import Geom, geom, site
from .joints import Joint, joint
from .settings import MAIN, Compiler, Defaults
from .values import flag, number, pose

WORLD = "world"
_CONTENT = ("body", "frame", "inertial", "joint", "freejoint", "geom", "site")
_WITHOUT_EFFECT = ("camera", "light")
_REFUSED = {
    "replicate": "copies are not made here",
    "composite": "composite objects are not made here",
    "flexcomp": "flexible bodies are not computed here",
    "attach": "other models are not attached here",
    "plugin": "what a plugin does is not known here",
}
_log = logging.getLogger(__name__)


@dataclass
class Body:
    """A body, its place in its parent, and what it holds; the first body is the world."""

    name: str
    element: str
    parent: int
    place: pin.SE3
    gravcomp: float = 0.0
    inertial: dict[str, str] | None = None
    joints: list[Joint] = field(default_factory=list)
    geoms: list[Geom] = field(default_factory=list)
    sites: dict[str, pin.SE3] = field(default_factory=dict)


class BodyReader:
    """Reads all bodies: each before its children, and with all its descendants in one run.

    Attributes
    ----------
    bodies : list of Body

    Raises
    ------
    FormatError
        Unknown or refused elements, names that stand twice, values that are wrong.
    """

    def __init__(self, root: Element, compiler: Compiler, defaults: Defaults):
        self._compiler, self._defaults = compiler, defaults
        self._names = {"body": {WORLD}, "joint": set(), "geom": set(), "site": set()}
        self.bodies = [Body(WORLD, "worldbody", 0, pin.SE3.Identity())]
        waiting = []
        for section in root.findall("worldbody"):
            if section.attrib:
                raise FormatError("it cannot have attributes", element="worldbody")
            waiting = self._fill(0, section, MAIN) + waiting
        while waiting:
            waiting += self._body(*waiting.pop())

    def _body(self, node, parent, frame, inherited):
        """Add a body; return its children."""
        name, element = self._name(node, None, len(self.bodies))
        if flag(node.attrib, "mocap", element):
            _log.warning("%s: nothing moves a mocap body here; it stays fixed", element)
        place = frame * pose(self._defaults.of(node, element), self._compiler, element)
        inherited = self._defaults.check(node.get("childclass", inherited), element)
        self.bodies.append(Body(name, element, parent, place, number(node.attrib, "gravcomp", element)))
        return self._fill(len(self.bodies) - 1, node, inherited)

    def _fill(self, index, node, inherited):
        """Put into a body what stands in its element; return its child bodies, the last first."""
        body, children = self.bodies[index], []
        for child, frame, its_class in self._contents(node, body, inherited):
            if child.tag == "body":
                children.append((child, index, frame, its_class))
            elif child.tag == "inertial":
                self._inertial(child, body, frame)
            else:
                self._part(child, body, frame, its_class)
        return children[::-1]

    def _contents(self, node, body, inherited):
        """What stands in a body's element and in its frames: (element, place of its frame, class it inherits)."""
        waiting = [(child, pin.SE3.Identity(), inherited) for child in reversed(node)]
        while waiting:
            child, frame, its_class = waiting.pop()
            element = f"{body.element}: {child.tag}"
            if child.tag == "frame":
                element += f" {child.get('name', '')!r}"
                check_attributes(child, element)
                frame = frame * pose(self._defaults.of(child, element), self._compiler, element)
                its_class = self._defaults.check(child.get("childclass", its_class), element)
                waiting += [(each, frame, its_class) for each in reversed(child)]
            elif child.tag in _CONTENT:
                yield child, frame, its_class
            elif child.tag in _REFUSED:
                raise FormatError(
                    f"{_REFUSED[child.tag]}; MuJoCo can save the compiled scene with plain bodies", element=element
                )
            elif child.tag not in _WITHOUT_EFFECT:
                raise FormatError(f"this element is not known{near(child.tag, _CONTENT)}", element=element)

    def _inertial(self, node, body, frame):
        element = f"{body.element}: inertial"
        if body.name == WORLD:
            raise FormatError("the world has no inertia", element=element)
        if body.inertial is not None:
            raise FormatError("it stands twice", element=element)
        if frame != pin.SE3.Identity():
            raise FormatError(
                "whether the frame around it counts differs among versions of MuJoCo; put it outside", element=element
            )
        check_attributes(node, element)
        body.inertial = self._defaults.of(node, element)

    def _part(self, node, body, frame, inherited):
        """A joint, geom or site."""
        kept = {"geom": body.geoms, "site": body.sites}.get(node.tag, body.joints)
        name, element = self._name(node, body, len(kept) + 1)
        if node.tag == "geom":
            body.geoms.append(geom(self._defaults.of(node, element, inherited), frame, self._compiler, element))
        elif node.tag == "site":
            place = site(self._defaults.of(node, element, inherited), frame, self._compiler, element)
            if name:
                body.sites[name] = place
        else:
            given = {"type": "free"} | node.attrib  # no defaults
            if node.tag == "joint":
                given = self._defaults.of(node, element, inherited)
            new = joint(name, given, frame, self._compiler, element)
            _check_company(new, body)
            body.joints.append(new)

    def _name(self, node, body, number):
        """The name of an element, empty if it has none, and how messages call it."""
        kind = node.tag.removeprefix("free")
        name = node.get("name", "")
        element = f"{kind} {name!r}" if name else f"{kind} {number}"
        if body is not None:
            element = f"{body.element}: {element}"
        check_attributes(node, element)
        if name in self._names[kind]:
            raise FormatError(f"another {kind} has this name", element=element)
        if name == "universe":
            raise FormatError("'universe' is the name of the ground here; give it another", element=element)
        if name:
            self._names[kind].add(name)
        return name, element


def _check_company(new, body):
    """Refuse joints that MuJoCo does not have in one body, or in this one."""
    kinds = [each.kind for each in body.joints]
    if body.name == WORLD:
        raise FormatError("the world has no joints", element=new.element)
    if "free" in kinds or (new.kind == "free" and (kinds or body.parent)):
        raise FormatError("a free joint stands alone, in a body that hangs on the world", element=new.element)
    if "ball" in kinds and new.kind in ("ball", "hinge"):
        raise FormatError("no rotation may follow a ball joint in one body", element=new.element)
