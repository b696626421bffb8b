"""A URDF that an SDF file includes, as a ``<model>``: its links, joints and frames, and what Gazebo and Drake add.

A link stands at its joint, whose origin is relative to its parent. What closes loops in URDF alone (``<loop_joint>``,
true loops, loop files) is refused: such a file is loaded by itself.
"""

from xml.etree.ElementTree import Element, SubElement

from ...errors import FormatError
from ..extensions import LOOP_TAGS
from ..ignored import Ignored
from ..reading import DRAKE
from ..urdf import INERTIA, checked, without_namespace

VERSION = "1.11"
_MOVING = ("revolute", "continuous", "prismatic", "planar")
_TEXTS = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",)}


def model_of(raw: Element, ignored: Ignored) -> Element:
    """The ``<model>`` of a parsed ``<robot>``; FormatError for one that is not a tree."""
    raw = without_namespace(raw)
    for tag in (*LOOP_TAGS, "coupling", DRAKE + "joint"):
        found = raw.find(tag)
        if found is not None:
            name = tag.removeprefix(DRAKE)
            raise FormatError(
                f"an included URDF cannot have a <{name}>; load it by itself", element=found.get("name", "")
            )
    robot = checked(raw, raw.get("name", "robot"))
    links = {link.get("name") for link in robot.findall("link")}

    def renamed(name):
        """Links and joints of SDF have one space of names."""
        return f"{name}_joint" if name in links else name

    kinds = {renamed(joint.get("name")): joint.get("type") for joint in raw.findall("joint")}
    follows = {renamed(joint.get("name")): joint.find("mimic") for joint in raw.findall("joint")}
    for joint in robot.findall("joint"):
        joint.set("name", renamed(joint.get("name")))
    for mimic in (each for each in follows.values() if each is not None):
        mimic.set("joint", renamed(mimic.get("joint", "")))
    model = Element("model", name=raw.get("name", "robot"))
    above = {joint.find("child").get("link"): joint for joint in robot.findall("joint")}
    for link in robot.findall("link"):
        if link.get("name") != "world":
            _link(model, link, above.get(link.get("name")))
    for joint in robot.findall("joint"):
        if joint.get("type") != "floating":
            _joint(model, joint, kinds.get(joint.get("name"), joint.get("type")), follows.get(joint.get("name")))
    for frame in raw.findall("frame"):
        made = SubElement(model, "frame", name=frame.get("name", ""), attached_to=frame.get("link", ""))
        SubElement(made, "pose").text = f"{frame.get('xyz', '0 0 0')} {frame.get('rpy', '0 0 0')}"
    model.extend(each for each in raw if str(each.tag).startswith(DRAKE))
    model.extend(each for holder in raw.findall("gazebo") if not holder.get("reference") for each in holder)
    ignored.add("transmission", len(raw.findall("transmission")))
    ignored.add("<gazebo reference>", sum(bool(each.get("reference")) for each in raw.findall("gazebo")))
    return model


def _pose(out, origin, relative_to=""):
    text = "0 0 0 0 0 0" if origin is None else f"{origin.get('xyz')} {origin.get('rpy')}"
    SubElement(out, "pose", {"relative_to": relative_to} if relative_to else {}).text = text


def _link(model, link, joint):
    out = SubElement(model, "link", name=link.get("name"))
    if joint is not None and joint.get("type") == "floating":
        _pose(out, joint.find("origin"), joint.find("parent").get("link").replace("world", "__model__"))
    elif joint is not None:
        _pose(out, None, joint.get("name"))
    inertial, given = SubElement(out, "inertial"), link.find("inertial")
    _pose(inertial, None if given is None else given.find("origin"))
    SubElement(inertial, "mass").text = "0" if given is None else given.find("mass").get("value")
    inertia = SubElement(inertial, "inertia")
    for key in INERTIA:
        SubElement(inertia, key).text = "0" if given is None else given.find("inertia").get(key)
    for tag in ("visual", "collision"):
        for number, shape in enumerate(link.findall(tag), start=1):
            _shape(SubElement(out, tag, name=f"{tag} {number}"), shape)


def _shape(out, shape):
    _pose(out, shape.find("origin"))
    (solid,) = shape.find("geometry")
    made = SubElement(SubElement(out, "geometry"), solid.tag)
    for key in _TEXTS.get(solid.tag, ()):
        SubElement(made, key).text = solid.get(key)
    if solid.tag == "mesh":
        SubElement(made, "uri").text = solid.get("filename")
        SubElement(made, "scale").text = solid.get("scale")
    colour = shape.find("material/color")
    if colour is not None:
        SubElement(SubElement(out, "material"), "diffuse").text = colour.get("rgba")


def _joint(model, joint, kind, follows):
    out = SubElement(model, "joint", name=joint.get("name"), type=kind)
    parent = joint.find("parent").get("link")
    _pose(out, joint.find("origin"), "" if parent == "world" else parent)
    if parent == "world":
        out.find("pose").set("relative_to", "__model__")
    for end in ("parent", "child"):
        SubElement(out, end).text = joint.find(end).get("link")
    if kind not in _MOVING or kind == "planar":
        return
    axis = SubElement(out, "axis")
    SubElement(axis, "xyz").text = joint.find("axis").get("xyz")
    for tag in ("limit", "dynamics"):
        given = joint.find(tag)
        made = SubElement(axis, tag)
        for key, value in {} if given is None else given.items():
            if kind != "continuous" or key not in ("lower", "upper"):
                SubElement(made, key).text = value
    if follows is not None:
        made = SubElement(axis, "mimic", joint=follows.get("joint", ""))
        for key, default in (("multiplier", "1"), ("offset", "0")):
            SubElement(made, key).text = follows.get(key, default)
