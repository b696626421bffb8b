"""SDF files (sdformat.org), read without libsdformat, which the pip builds of Pinocchio do not include.

Versions 1.4 to 1.12 of the specification are supported. A file is converted as follows:

* Links and joints form a graph. A spanning tree of it becomes the model, and the remaining joints close loops
  (:mod:`..graph` explains which, and how). At q = 0 all bodies have the poses of the file, and all loops are closed.
* A link without ``<inertial>`` has 1 kg and 1 kg·m², the defaults of the specification.
* In SDF a model without a joint to the world floats. Here its root link is fixed at its pose unless
  ``load(..., free_flyer=True)`` lets it float, as for URDF files. ``<static>`` models never move.
* If a file has a single model, links, joints and frames are known by their names, otherwise as ``model::name``. Before
  version 1.7 a link and a joint may have the same name: the joint is then called ``name_joint``.
* Damping and friction of a ball joint act about all its axes. Position limits are kept in the model, without effect.
* Gazebo's joint controllers become forces (:mod:`.joints`), and Drake's ``gear_ratio`` and ``rotor_inertia`` of a joint
  the armature. Contacts, limits, other plugins and extensions are counted (``Mechanism.ignored``); sensors
  and lights have no effect. Elements that would change the motion and cannot be converted are refused: ``<include>``,
  kinematic links, inertias computed from shapes, fluid added mass, gravity on some of the links only, plugins and
  extensions that join bodies.
* A screw joint becomes Pinocchio's helical joint. A universal joint becomes two hinges, ``name_axis`` and
  ``name_axis2``, with a massless body between them, because ``computeRNEADerivatives`` is wrong for Pinocchio's own
  universal joint.
"""

import logging
import os
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np
import pinocchio as pin

from ...errors import FormatError
from ...mechanism.checks import warn
from ...mechanism.forces import JointSpring
from ..extensions import left_out
from ..graph import JointGraph, build, couplings
from ..ignored import COLLISIONS, LIMITS, Ignored
from ..plausible import inertias_of, warn_of_inertias
from ..reading import DRAKE, RobotFile, closing, finite, parsed, read_bytes, refuse, short_repr, text
from ..urdf import INERTIA, SHAPES, add_visual, checked, fixed_links, symmetric
from .document import INFINITE, Body, Document
from .joints import LAWS, add_armature, controllers, read_joints

_DEFAULT_INERTIA = dict(zip(INERTIA, (1.0, 0.0, 0.0, 1.0, 0.0, 1.0), strict=True))  # kg·m²
_LINK = ("pose", "inertial", "collision", "visual", "sensor", "projector", "audio_sink", "audio_source", "battery")
_LINK += ("light", "particle_emitter", "gravity", "enable_wind", "self_collide", "kinematic", "must_be_base_link")
_LINK += ("velocity_decay",)
_HOLDERS = ("world", "model", "joint", "axis", "axis2")
_SYSTEMS = ("Physics", "Sensors", "Contact")
"""Plugins of a world that run Gazebo itself."""
_log = logging.getLogger(__name__)


def read(path: Path, name: str, folders, *, free_flyer=False, ignore=(), content=None) -> RobotFile:
    """Read an SDF file. Links and `<frame>` elements become frames of the model; a free-flyer is ``root_joint``."""
    content = read_bytes(path) if content is None else content
    raw = parsed(content)
    left_out([("", each) for tag in _HOLDERS for each in raw.iter(tag)], ignore)
    holders = [each for tag in _HOLDERS for each in raw.iter(tag)]
    own = ("mimic", "gearbox_ratio", "gearbox_reference_body")
    found = [each for holder in holders for each in closing(holder, own)]
    refuse(found, raw, content, "write it as a <joint> or <mimic> of SDF")
    document = Document(raw)
    joints = read_joints(document)
    robot = checked(in_urdf(document, [Path(folder).resolve() for folder in folders]), name)
    graph = JointGraph(document, joints)
    if len(graph.roots) > 1:
        warn(f"{path}: no joints connect {', '.join(map(repr, graph.roots))} to each other or to the world")
    if free_flyer and not graph.roots:
        raise FormatError("nothing can float: all links are connected to the world; omit free_flyer")
    model, guess = build(document, graph, inertias(document), name, free_flyer)
    warn_of_inertias(path, inertias_of(robot, model))
    if weightless(document):
        model.gravity.linear = np.zeros(3)
    motions = [motion for joint in graph.joints for motion in zip(joint.parts, joint.axes, strict=False)]
    springs = [JointSpring(part, axis.stiffness, axis.reference) for part, axis in motions if axis.stiffness]
    shapes, loops = tostring(robot, encoding="unicode"), tuple(graph.loops())
    add_armature(joints, model)
    acting = controllers(document, joints, model)
    return RobotFile(
        model, shapes, loops, tuple(couplings(joints)), forces=(*springs, *acting), guess=guess,
        actuated=tuple(dict.fromkeys(force.joint for force in acting)), ignored=_ignored(raw).lines(),
    )  # fmt: skip


def _ignored(raw: Element) -> Ignored:
    """What has no effect in a parsed file; misspelt elements of SDF itself are logged one by one."""
    ignored = Ignored()
    for holder in (each for tag in ("world", "model") for each in raw.iter(tag)):
        for plugin in holder.findall("plugin"):
            if plugin.get("name", "").rpartition("::")[2] not in (*LAWS, *_SYSTEMS):
                ignored.add_plugin(plugin)
        ignored.add("gripper", len(holder.findall("gripper")))
        ignored.add("actor", len(holder.findall("actor")))
        ignored.add_unknown([each for each in holder if "}" in str(each.tag)], ())
    static = [model for model in raw.iter("model") if model.findtext("static", "").strip() in ("1", "true")]
    fixed = {link for model in static for link in model.iter("link")}
    for link in raw.iter("link"):
        shapes = link.findall("collision")
        floors = sum(shape.find("geometry/plane") is not None for shape in shapes)
        ignored.add(f"static {COLLISIONS}" if link in fixed else COLLISIONS, len(shapes) - floors)
        ignored.add("floor", floors)
        ignored.add("link in the wind", link.findtext("enable_wind", "").strip() in ("1", "true"))
        ignored.add_unknown([each for each in link if "}" in str(each.tag)], (), "links")
    for joint in raw.iter("joint"):
        limits = joint.findall("axis/limit") + joint.findall("axis2/limit")
        bounded = any(
            abs(finite(limit.findtext(end), INFINITE) or 0.0) < INFINITE
            for limit in limits for end in ("lower", "upper") if finite(limit.findtext(end), INFINITE) is not None
        )  # fmt: skip
        ignored.add(LIMITS, bounded and joint.get("type") not in ("continuous", "fixed", "ball"))
        ignored.add("joint <physics>", joint.find("physics/ode") is not None)
        extensions = [each for each in joint if "}" in str(each.tag)]
        ignored.add_unknown(extensions, (DRAKE + "rotor_inertia", DRAKE + "gear_ratio"), "joints")
    return ignored


def in_urdf(document: Document, folders: list[Path]) -> Element:
    """A raw `<robot>` with the links of a file, their inertias and shapes; all links are fixed to the first one."""
    robot, links = fixed_links(document.bodies)
    for name, body in document.bodies.items():
        body.node.warn_unknown(_LINK)
        _inertial(SubElement(links[name], "inertial"), body.node.child("inertial"))
        for visual in body.node.children("visual"):
            visual.name += f" {visual.get('name')!r}"
            _visual(links[name], visual, body, document, folders)
    return robot


def inertias(document: Document) -> dict[str, pin.Inertia]:
    """Link → its inertia in its own frame, with the same numbers as in :func:`in_urdf`."""
    found = {}
    for name, body in document.bodies.items():
        node = body.node.child("inertial")
        own = pin.Inertia.Zero()  # its constructor refuses what is negative by rounding
        own.mass = node.value("mass", 1.0)
        own.inertia = symmetric([node.child("inertia").value(key, each) for key, each in _DEFAULT_INERTIA.items()])
        found[name] = node.pose()[0].act(own)
    return found


def weightless(document: Document) -> bool:
    """Whether gravity acts on none of the moving links; FormatError if it acts on some of them only."""
    pulled, free = [], []
    for name, body in document.bodies.items():
        if body.node.flag("kinematic"):
            raise body.node.error("kinematic links, which a program moves, are not supported")
        if any(body.node.child("velocity_decay").value(tag) for tag in ("linear", "angular")):
            warn(f"{body.node.name}: velocity_decay has no effect")
        if not body.static:
            (pulled if body.node.flag("gravity", True) else free).append((name, body.node))
    if pulled and free:
        raise free[0][1].error(
            f"gravity is off for this link, but on for {pulled[0][0]!r}; it can be switched off only for all links"
        )
    return bool(free)


def _inertial(out, node):
    if node.truth(node.get("auto", "false")):
        raise node.error("inertias computed from shapes (auto) are not supported; give their values")
    if node.child("fluid_added_mass"):
        raise node.error("fluid_added_mass is not supported")
    SubElement(out, "mass", value=text(node.value("mass", 1.0)))
    inertia = node.child("inertia")
    SubElement(out, "inertia", {key: text(inertia.value(key, each)) for key, each in _DEFAULT_INERTIA.items()})


def _visual(link, node, body: Body, document, folders):
    solid = node.solid()
    kind = solid.xml.tag if solid else "nothing"
    sizes = {key: text(*solid.values(key, (1.0,) * count)) for key, count in SHAPES.get(kind, {}).items()}
    if kind == "mesh":
        uri = solid.word("uri")
        if uri.startswith(("http://", "https://")):
            _log.warning("%s: uri: left out, nothing is downloaded: %s", solid.name, short_repr(uri))
            return
        sizes["filename"] = _mesh(uri, folders, solid.child("uri"))
    place, relative_to = node.pose()
    if relative_to:
        base = document.resolve(body.scope, relative_to, f"{node.name}: pose")
        place = body.pose.actInv(document.pose(base) * place)
    material = node.child("material")
    colour = (material.child("diffuse").text() or material.child("ambient").text()).split()
    add_visual(link, place, kind, sizes, " ".join([*colour, "1"] if len(colour) == 3 else colour))


def _mesh(uri, folders, node):
    """The file name of a mesh as URDF writes it; FormatError if it is outside the folders."""
    scheme, _, rest = uri.rpartition("://")
    if scheme in ("model", "package"):
        inside = not os.path.normpath(rest).startswith((os.pardir, os.sep))
    elif scheme in ("", "file"):
        targets = [Path(os.path.normpath(folder / rest)) for folder in folders]
        inside = any(target.is_relative_to(folder) for target in targets for folder in folders)
    else:
        raise node.error(f"the scheme of {short_repr(uri)} is not one of model, package, file")
    if "\0" in uri or not inside:
        reason = "is outside the folder of the scene; pass the folders of its meshes as package_dirs="
        raise node.error(f"{short_repr(uri)} {reason}")
    return f"package://{rest}" if scheme == "model" else uri
