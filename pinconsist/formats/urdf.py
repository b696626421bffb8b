"""URDF files.

A file is checked completely before it is passed to Pinocchio, so that every error in it becomes a FormatError that
names the file and the element. Only what a simulation or a replay needs (links, joints, shapes) is copied, and every
number is written anew, so that Pinocchio's parsers never see unchecked input. ``continuous`` joints become plain
revolute joints with one angle that counts turns (nq = nv), where Pinocchio would store a cosine and a sine. Limits
that are missing in the file are infinite. For loops and motors see :mod:`pinconsist.formats.urdf_loops`.
"""

import logging
import math
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np
import pinocchio as pin

from ..errors import FormatError, warn
from ..mechanism.file_laws import COLLISIONS, WATCHED
from .drake import joints_in_urdf
from .extensions import LOOP_TAGS, WORLDS, left_out, sorted_records
from .grammar import URDF, count_unknown
from .ground import solids_of_urdf
from .ignored import Ignored
from .joints import AS_WRITTEN, replaced
from .plausible import angles_of, inertias_of, limits_of, warn_of_degrees, warn_of_inertias, warn_of_limits
from .reading import LARGEST, Node, RobotFile, parsed, read_bytes, require_known, text
from .urdf_extensions import HARMLESS, ROBOT, count_extensions, springs, weightless_links
from .urdf_loops import X_AXIS, ZERO, cut_loops, joined, refuse_foreign, transmissions

JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
UNLIMITED = 1e300  # stands for a missing limit
INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
ROOT_JOINT = "root_joint"
DEEPEST = 2000  # links in a row: Pinocchio's parser is recursive, and ends the process at 4,000 with a stack of 8 MB
_LINK = ("inertial", "visual", "collision")
_JOINT = ("origin", "parent", "child", "axis", "limit", "dynamics", "mimic", "calibration", "safety_controller")

# defaults for missing limits, as Pinocchio requires all four
_LIMIT = {"lower": (-UNLIMITED,), "upper": (UNLIMITED,), "effort": (UNLIMITED,), "velocity": (UNLIMITED,)}
SHAPES = {"box": {"size": 3}, "cylinder": {"radius": 1, "length": 1}, "sphere": {"radius": 1}, "mesh": {"scale": 3}}
"""Shape → its attributes, and the number of values of each."""
_log = logging.getLogger(__name__)


def read(path: Path, name: str, folders, *, free_flyer=False, ignore=(), joint_types=None, content=None) -> RobotFile:
    """Read a URDF file, or a text given as `content`; a free-flyer is a joint ``root_joint``.

    `joint_types` are the joints to replace: name → type, see :mod:`pinconsist.formats.joints`. `ignore` names elements
    that :func:`~pinconsist.formats.reading.refuse` would refuse.
    """
    content = read_bytes(path) if content is None else content
    raw = without_namespace(parsed(content))
    left_out(_holders(raw), ignore)
    if "mimic" in ignore:
        left_out((("", joint) for joint in raw.iter("joint")), ["mimic"])
    refuse_foreign(raw, content)
    types = joints_in_urdf(raw) | dict(joint_types or {})
    true_loops = cut_loops(raw)
    robot = checked(raw, name)
    warn_of_limits(path, limits_of(robot))
    warn_of_degrees(path, angles_of(robot))
    ignored = _ignored(raw)
    joints = {joint.get("name"): joint for joint in robot.findall("joint")}
    for joint in [joint for joint, kind in types.items() if kind in AS_WRITTEN]:
        element = f"joint {joint!r}"
        require_known(joint, joints, "there is no joint of this name to replace", element)
        if types[joint] == "UNBOUNDED" and joints[joint].get("type") != "revolute":
            raise FormatError("only a revolute joint can be made unbounded", element=element)
        joints[joint].set("type", AS_WRITTEN[types.pop(joint)])
    urdf = tostring(robot, encoding="unicode")
    kinds = {name: joint.get("type") for name, joint in joints.items()}
    free_flyer = free_flyer or _floats(path, robot, kinds)
    model = _built(urdf, free_flyer, kinds)
    for limits in (model.lowerPositionLimit, model.upperPositionLimit):
        limits[:] = np.where(np.abs(limits) < UNLIMITED, limits, np.copysign(np.inf, limits))
    warn_of_inertias(path, inertias_of(robot, model))
    model = replaced(model, types) if types else model
    motors = transmissions(raw, model, UNLIMITED)
    actuated = tuple(dict.fromkeys(joint for motor in motors for joint in motor.arms))
    loops, followers, more = sorted_records(joined(raw, model, ignored))
    forces = (*motors, *springs(raw, model), *weightless_links(raw, model), *more)
    if true_loops:
        names = ", ".join(repr(loop.name) for loop in true_loops)
        warn(f"{path}: links are children of two joints; the tree is cut at {names}, which close the loops")
    about = {"actuated": actuated, "ignored": ignored.lines(), "solids": solids_of_urdf(robot)}
    return RobotFile(model, urdf, (*true_loops, *loops), followers, forces, **about)


def _holders(raw):
    """(prefix of tags, element) of everything that has extensions."""
    yield "", raw
    for tag in ("gazebo", "mujoco"):
        yield from ((f"{tag}/", each) for each in raw.findall(tag))


def _ignored(raw: Element) -> Ignored:
    """What has no effect in a parsed ``<robot>``: each element is known by its tag, or counted."""
    ignored = Ignored()
    ignored.add_unknown(raw, ROBOT)
    for link in raw.findall("link"):
        ignored.add(COLLISIONS, len(link.findall("collision")))
        ignored.add_unknown(link, (*_LINK, *HARMLESS), "links")
    for joint in raw.findall("joint"):
        limit = joint.find("limit")
        bounded = joint.get("type") in ("revolute", "prismatic") and limit is not None
        ignored.add(WATCHED, bounded and any(limit.get(end) for end in ("lower", "upper")))
        ignored.add("safety controller", joint.find("safety_controller") is not None)
        ignored.add_unknown(joint, (*_JOINT, *HARMLESS), "joints")
    count_extensions(raw, ignored)
    count_unknown(raw, URDF, ignored)
    return ignored


def _floats(path, robot, kinds) -> bool:
    """Whether a robot floats although nobody asked: none of its joints moves, and it has a mass and no ground."""
    if not set(kinds.values()) <= {"fixed"}:
        return False
    children = {joint.find("child").get("link") for joint in robot.findall("joint")}
    root = next(link.get("name") for link in robot.findall("link") if link.get("name") not in children)
    if root in WORLDS:
        raise FormatError(f"nothing can move: all joints are fixed, and the link {root!r} is the ground")
    if not any(float(mass.get("value")) for mass in robot.iter("mass")):
        raise FormatError("nothing can move: all joints are fixed, and no link has a mass")
    warn(f"{path}: no joint of it moves, and its link {root!r} floats")
    return True


def _built(urdf, free_flyer, kinds):
    if free_flyer and ROOT_JOINT in kinds:
        raise FormatError("a free-flyer adds a joint of this name; rename this one", element=f"joint {ROOT_JOINT!r}")
    try:
        return pin.buildModelFromXML(urdf, *((pin.JointModelFreeFlyer(), ROOT_JOINT) if free_flyer else ()))
    except Exception as error:  # Boost.Python may raise any kind
        raise FormatError(f"Pinocchio cannot build the model: {error}") from error


def without_namespace(raw: Element) -> Element:
    """The same element without its default namespace, and those of elements that close loops, which mean nothing."""
    namespace = raw.tag[: raw.tag.find("}") + 1]
    for node in raw.iter():
        node.tag = node.tag.removeprefix(namespace)
    for node in raw:
        space, _, tag = node.tag.rpartition("}")
        if space and "drake" not in space and tag in (*LOOP_TAGS, "coupling"):
            for each in node.iter():
                each.tag = each.tag.rpartition("}")[2]
    return raw


def checked(raw: Element, name: str) -> Element:
    """A clean `<robot>` from a parsed file; FormatError for the first error, with its element."""
    if raw.tag != "robot":
        raise FormatError(f"the root element of a URDF is <robot>, this is <{raw.tag}>")
    top, robot = Node(raw), Element("robot", name=name)
    colours = {node.get("name"): _colour(node) for node in top.children("material")}
    links, joints = top.named("link"), top.named("joint")
    if not links:
        raise FormatError("there is no link")
    for found in (links, joints):
        if "universe" in found:
            raise found["universe"].error("'universe' is the name of the ground here; rename this element")
    for link, node in links.items():
        out = SubElement(robot, "link", name=link)
        if inertial := node.child("inertial"):
            _inertial(SubElement(out, "inertial"), inertial)
        for tag in ("visual", "collision"):
            for shape in node.children(tag):
                _shape(out, tag, shape, colours)
    if "world" not in links and any(node.child("parent").get("link") == "world" for node in joints.values()):
        robot.insert(0, Element("link", name="world"))  # as Drake and PyBullet have it
        links = {"world": Node(robot[0], "link 'world'")} | links
    for joint, node in joints.items():
        _joint(robot, joint, node, links)
    _check_tree(robot, links, robot.findall("joint"))
    return robot


def fixed_links(names) -> tuple[Element, dict[str, Element]]:
    """A `<robot>` whose links are all fixed to the first one, and the links by their names."""
    robot = Element("robot", name="scene")
    links = {name: SubElement(robot, "link", name=name) for name in names}
    first, *others = links
    for name in others:
        joint = SubElement(robot, "joint", name=f"{name} mount", type="fixed")
        SubElement(joint, "parent", link=first)
        SubElement(joint, "child", link=name)
    return robot, links


def origin(out: Element, place: pin.SE3) -> None:
    SubElement(out, "origin", xyz=text(*place.translation), rpy=text(*pin.rpy.matrixToRpy(place.rotation)))


def add_visual(link: Element, place: pin.SE3, kind: str, sizes: dict[str, str], rgba: str = "") -> None:
    """Add a shape to a link. Its material is named after its colour: parsers merge materials of the same name."""
    out = SubElement(link, "visual")
    origin(out, place)
    SubElement(SubElement(out, "geometry"), kind, sizes)
    if rgba:
        SubElement(SubElement(out, "material", name=rgba), "color", rgba=rgba)


def _inertial(out, node):
    _origin(out, node)
    mass = node.child("mass", required=True).number("value")
    if mass < 0:
        raise node.error(f"the mass is negative: {mass:g} kg")
    SubElement(out, "mass", value=text(mass))
    inertia = node.child("inertia")
    if mass and not inertia:
        warn(f"{node.name}: <inertia> is missing, and it is a point of {mass:g} kg")
    values = [inertia.number(key, None if inertia else 0.0) for key in INERTIA]
    SubElement(out, "inertia", {key: text(value) for key, value in zip(INERTIA, values, strict=True)})


def symmetric(values) -> np.ndarray:
    """The matrix of the six numbers of `INERTIA`."""
    xx, xy, xz, yy, yz, zz = values
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _shape(link, tag, node, colours):
    solid = node.solid()
    kind = solid.xml.tag if solid else ""
    if kind not in SHAPES:
        _log.warning("%s: left out, its geometry is not one of %s", node.name, ", ".join(SHAPES))
        return
    default = (1.0, 1.0, 1.0) if kind == "mesh" else None
    if kind == "mesh" and len(solid.get("scale").split()) == 1:  # the same for all axes, in other programs
        solid.xml.set("scale", " ".join(solid.get("scale").split() * 3))
    sizes = {key: solid.numbers(key, count, default) for key, count in SHAPES[kind].items()}
    attributes = {key: text(*size) for key, size in sizes.items()}
    if kind == "mesh":
        attributes["filename"] = solid.get("filename")
        if not attributes["filename"]:
            raise solid.error("attribute 'filename' is missing")
    elif min(map(min, sizes.values())) < 0:
        raise solid.error("a size is negative")
    out = SubElement(link, tag)
    _origin(out, node)
    SubElement(SubElement(out, "geometry"), kind, attributes)
    material = node.child("material")
    if material and tag == "visual" and (colour := _colour(material) or colours.get(material.get("name"))):
        SubElement(SubElement(out, "material", name=colour), "color", rgba=colour)


def _colour(material):
    colour = material.child("color")
    return text(*colour.numbers("rgba", 4)) if colour else None


def _joint(robot, name, node, links):
    kind = node.get("type")
    if kind not in JOINT_TYPES:
        raise node.error(f"type {kind!r} is not one of {', '.join(JOINT_TYPES)}")
    joint = SubElement(robot, "joint", name=name, type="revolute" if kind == "continuous" else kind)
    _origin(joint, node)
    ends = [node.child(end, required=True).get("link") for end in ("parent", "child")]
    for end, link in zip(("parent", "child"), ends, strict=True):
        require_known(link, links, f"its {end} link {link!r} does not exist", node.name)
        SubElement(joint, end, link=link)
    if ends[0] == ends[1]:
        raise node.error(f"parent and child are the same link {ends[0]!r}")
    if kind in ("fixed", "floating"):
        return
    axis = node.child("axis").numbers("xyz", 3, X_AXIS)
    length = math.hypot(*axis)
    if length == 0:
        raise node.error("the axis is the zero vector")
    axis = tuple(each / length for each in axis)
    if kind == "planar" and axis != (0.0, 0.0, 1.0):  # Pinocchio ignores the axis of a planar joint
        raise node.error('planar joints must have <axis xyz="0 0 1"/>, motion in the x-y plane')
    SubElement(joint, "axis", xyz=text(*axis))
    if dynamics := node.child("dynamics"):
        _copy(joint, dynamics, "dynamics", {"damping": (0.0,), "friction": (0.0,)})
    if kind != "planar":
        _copy(joint, node.child("limit"), "limit", _LIMIT, math.inf)
    if kind == "continuous":
        joint.find("limit").attrib |= {"lower": text(-UNLIMITED), "upper": text(UNLIMITED)}


def _floating(robot, link) -> Element:
    """Add a floating joint between the ground and a link."""
    joint = SubElement(robot, "joint", name=ROOT_JOINT, type="floating")
    SubElement(joint, "parent", link=WORLDS[0])
    SubElement(joint, "child", link=link)
    return joint


def _check_tree(robot, links, joints):
    joint_of, children = {}, {}
    for joint in joints:
        parent, link = joint.find("parent").get("link"), joint.find("child").get("link")
        if link in joint_of:
            advice = "A URDF is a tree: keep one of them and close the loop by a <loop_joint> or in a loop file"
            two = f"{joint_of[link]!r} and {joint.get('name')!r}"
            raise links[link].error(f"it is the child of two joints, {two}. {advice}")
        joint_of[link] = joint.get("name")
        children.setdefault(parent, []).append(link)
    roots = [link for link in links if link not in joint_of]
    if len(roots) == 2 and WORLDS[0] in roots:  # what is not joined to the world floats, as Drake has it
        roots.remove(WORLDS[0])
        warn(f"the link {roots[0]!r} is not joined to the link 'world', and floats")
        joints += [_floating(robot, roots[0])]
        roots = [WORLDS[0]]
        children.setdefault(WORLDS[0], []).append(joints[-1].find("child").get("link"))
    if len(roots) > 1:
        raise FormatError(f"the links {roots[0]!r} and {roots[1]!r} both have no parent; connect them by a joint")
    depths = dict.fromkeys(roots, 1)
    for link in roots:  # the list grows
        inner = children.get(link, ())
        roots += inner
        depths |= dict.fromkeys(inner, depths[link] + 1)
        if depths[link] > DEEPEST:
            raise links[link].error(
                f"more than {DEEPEST:,} links hang on each other in a row, too many for Pinocchio's reader of URDF; an "
                "SDF file may have more"
            )
    if len(roots) < len(links):
        loose = next(link for link in links if link not in roots)
        raise links[loose].error("its parents do not lead to a root: the links form a cycle")


def _origin(out, node):
    if origin := node.child("origin"):
        _copy(out, origin, "origin", {"xyz": ZERO, "rpy": ZERO})


def _copy(out, node, tag, defaults, largest=LARGEST):
    """Copy an element's numeric attributes; each has as many numbers as its default."""
    numbers = {key: node.numbers(key, len(default), default, largest) for key, default in defaults.items()}
    SubElement(out, tag, {key: text(*each) for key, each in numbers.items()})
