"""SDF files (sdformat.org), read without libsdformat, which the pip builds of Pinocchio do not include.

Versions 1.4 to 1.12 of the specification are supported. A file is converted as follows:

* Links and joints form a graph. A spanning tree of it becomes the model, and the remaining joints close loops
  (``graph`` explains which, and how). At q = 0 all bodies have the poses of the file, and all loops are closed.
* A link without ``<inertial>`` has 1 kg and 1 kg·m², the defaults of the specification.
* In SDF a model without a joint to the world floats. Here its root link is fixed at its pose unless
  ``load(..., free_flyer=True)`` lets it float, as for URDF files. If nothing else moves it floats; so do links that no
  joint connects to the world if others of their model are connected to it. ``<static>`` models never move.
* If a file has a single model, links, joints and frames are known by their names, otherwise as ``model::name``. Before
  version 1.7 a link and a joint may have the same name: the joint is then called ``name_joint``; and a link may be
  called ``world``: it is the ground.
* Damping and friction of a ball joint act about all its axes. Position limits are kept in the model, without effect.
* Gazebo's joint controllers become forces (:mod:`.joints`), and Drake's ``gear_ratio`` and ``rotor_inertia`` of a joint
  the armature. ``DetachableJoint``, mimic plugins (``gazebo``) and Drake's constraints (``drake``) act, as do
  links without gravity, and models are included (:mod:`.includes`). Contacts, limits, other plugins and extensions are
  counted (``Mechanism.ignored``); sensors and lights have no effect. Kinematic links do not move. Elements that would
  change the motion and cannot be converted are refused: fluid added mass, plugins and extensions that join bodies.
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

from ...errors import FormatError, warn
from ...mechanism.file_laws import COLLISIONS, FLOOR, STATIC, WATCHED
from ...mechanism.forces import JointSpring, Wrench
from .. import drake, gazebo
from ..closures import Closure
from ..extensions import Names, left_out, sorted_records
from ..grammar import SDF, count_unknown
from ..graph import JointGraph, build, couplings
from ..ground import Plane, Solid
from ..ignored import Ignored
from ..plausible import inertias_of, warn_of_inertias
from ..reading import DRAKE, RobotFile, closing, finite, parsed, read_bytes, refuse, short_repr, text
from ..urdf import INERTIA, SHAPES, add_visual, checked, fixed_links, symmetric
from .auto import write_inertias
from .document import INFINITE, WORLD, Body, Document, join
from .includes import Includes
from .joints import LAWS, add_armature, controllers, read_joints

_DEFAULT_INERTIA = dict(zip(INERTIA, (1.0, 0.0, 0.0, 1.0, 0.0, 1.0), strict=True))  # kg·m²
_LINK = ("pose", "inertial", "collision", "visual", "sensor", "projector", "audio_sink", "audio_source", "battery")
_LINK += ("light", "particle_emitter", "gravity", "enable_wind", "self_collide", "kinematic", "must_be_base_link")
_LINK += ("velocity_decay",)
_HOLDERS = ("world", "model", "joint", "axis", "axis2")
WITHOUT = "ignore=['{}'] loads the scene without it"
_SYSTEMS = ("Physics", "Sensors", "Contact")
"""Plugins of a world that run Gazebo itself."""
_log = logging.getLogger(__name__)


def read(path: Path, name: str, folders, *, free_flyer=False, ignore=(), content=None, floats=False) -> RobotFile:
    """Read an SDF file. Links and `<frame>` elements become frames of the model; a free-flyer is ``root_joint``.

    With `floats`, everything floats that no joint connects to the world.
    """
    content = read_bytes(path) if content is None else content
    raw, ignored = parsed(content), Ignored()
    if raw.tag == "gazebo":  # SDF 1.0 to 1.2
        raw.tag = "sdf"
    left_out([("", each) for tag in (*_HOLDERS, "inertial") for each in raw.iter(tag)], ignore)
    Includes(path, folders, ignored, ignore).expand(raw, Path(os.path.abspath(path)))
    _refuse_foreign(raw, content)
    drake_joints(raw)
    document = Document(raw)
    folders = [Path(folder).resolve() for folder in folders]
    write_inertias(document, lambda shape: _mesh_file(shape, folders))
    joints = read_joints(document)
    robot = checked(in_urdf(document, folders), name)
    graph = JointGraph(document, joints)
    floating = graph.roots if free_flyer or floats else _floating(document, graph)
    if floating and not (free_flyer or floats):
        warn(f"{path}: no joint connects {', '.join(map(repr, floating))} to the world: it floats")
    elif len(graph.roots) > 1 and not floats:
        warn(f"{path}: no joints connect {', '.join(map(repr, graph.roots))} to each other or to the world")
    if free_flyer and not graph.roots:
        raise FormatError("nothing can float: all links are connected to the world; omit free_flyer")
    model, guess = build(document, graph, inertias(document), name, floating)
    warn_of_inertias(path, inertias_of(robot, model))
    weights = weightless(document, model, ignored)
    motions = [motion for joint in graph.joints for motion in zip(joint.parts, joint.axes, strict=False)]
    springs = [JointSpring(part, axis.stiffness, axis.reference) for part, axis in motions if axis.stiffness]
    shapes = tostring(robot, encoding="unicode")
    add_armature(joints, model)
    loops, followers, forces = sorted_records(_joined(document, model, ignored))
    loops = tuple(_moving(loops, model, ignored))
    acting = controllers(document, joints, model)
    ignored = _ignored(raw, ignored).lines()
    solids, planes = _colliding(document, model)
    return RobotFile(
        model, shapes, (*graph.loops(), *loops), (*couplings(joints), *followers),
        forces=(*springs, *weights, *forces, *acting), guess=guess,
        actuated=tuple(dict.fromkeys(force.joint for force in acting)), ignored=ignored, solids=solids, planes=planes,
    )  # fmt: skip


def _floating(document: Document, graph: JointGraph) -> list[str]:
    """The roots that float although nobody asked: nothing else moves, or the world holds others of their model."""
    if all(joint.kind == "fixed" for joint in graph.joints):
        return graph.roots

    def model(body):
        return document.bodies[body].scope.partition("::")[0]

    held = {model(body) for joint in graph.joints for body, other in ((joint.parent, joint.child),
            (joint.child, joint.parent)) if other == WORLD}  # fmt: skip
    return [root for root in graph.roots if model(root) in held]


def _refuse_foreign(raw: Element, content) -> None:
    """Raise FormatError for unsupported extensions that close loops; see :func:`refuse`."""
    known = ("mimic", "gearbox_ratio", "gearbox_reference_body", "drake:joint", "drake:mimic", *drake.TAGS)
    found = [each for tag in _HOLDERS for holder in raw.iter(tag) for each in closing(holder, known)]
    found = [(tag, element) for tag, element in found if not gazebo.reads(element)]
    refuse(found, raw, content, "write it as a <joint> or <mimic> of SDF")


def drake_joints(raw: Element) -> None:
    """Replace ``<drake:joint>`` and ``<drake:mimic>`` by the elements of SDF that mean the same; see ``drake``."""
    for element in (each for model in list(raw.iter("model")) for each in model.findall(DRAKE + "joint")):
        for each in element.iter():
            each.tag = str(each.tag).removeprefix(DRAKE)
        kind = element.get("type", "")
        if kind not in drake.TYPES:
            reason = f"type {kind[:40]!r} is not one of {', '.join(drake.TYPES)}"
            raise FormatError(reason, element=f"drake:joint {element.get('name')!r}")
        axes = {"universal": ("1 0 0", "0 1 0"), "screw": ("0 0 1",)}.get(kind, ())
        for tag, axis in zip(("axis", "axis2"), axes, strict=False):
            if element.find(tag) is None:
                SubElement(SubElement(element, tag), "xyz").text = axis
    for joint in raw.iter("joint"):
        for holder in (joint, *joint.findall("axis")):
            for mimic in holder.findall(DRAKE + "mimic"):
                holder.remove(mimic)
                axis = holder if holder.tag == "axis" else joint.find("axis")
                own = SubElement(joint if axis is None else axis, "mimic", joint=mimic.get("joint", ""))
                for key, default in (("multiplier", "1"), ("offset", "0")):
                    given = mimic.get(key) or mimic.findtext(DRAKE + key) or default
                    SubElement(own, key).text = given


def _joined(document, model, ignored):
    """The loops, couplings and forces of plugins and Drake's elements of the models of a file."""
    links, joints = list(document.bodies), list(model.names)[1:]
    frames = {}
    for name, (body, pose) in document.frames.items():
        frames[name] = body, pose if body == WORLD else document.bodies[body].pose.actInv(pose)
    for full, node in document.models.items():
        scope = document.short(join(full, ""))
        own = _Scoped(node.get("name"), links, joints, frames, scope, list(document.models))
        yield from drake.joined(node, own, ignored)
        yield from gazebo.joined(node, own, ignored)


def _moving(loops, model, ignored):
    """The loops without those that join bodies which do not move."""
    for loop in loops:
        ends = [model.frames[model.getFrameId(each)].parentJoint if model.existFrame(each) else 0
                for each in (loop.frame1, loop.frame2)]  # fmt: skip
        if ends[0] == ends[1] and isinstance(loop, Closure):
            ignored.add("weld of bodies that do not move")
        else:
            yield loop


class _Scoped(Names):
    """Names of one model: relative to it, or full."""

    def __init__(self, title, links, joints, frames, scope, models):
        super().__init__(title, links, joints, frames)
        self._scope, self._models = scope, [model.rpartition("::")[2] for model in models]

    def link(self, name, element):
        own = self._scope + name.strip()
        return own if own in self.links else super().link(name, element)

    def joint(self, name, element):
        own = self._scope + name.strip()
        return own if own in self.joints else super().joint(name, element)

    def place(self, name, element):
        return super().place(self._scope + name if self._scope + name in self.frames else name, element)


def _ignored(raw: Element, ignored: Ignored) -> Ignored:
    """Add what has no effect in a parsed file; misspelt elements of SDF itself are logged one by one."""
    for holder in (each for tag in ("world", "model") for each in raw.iter(tag)):
        for plugin in holder.findall("plugin"):
            if plugin.get("name", "").rpartition("::")[2] not in (*LAWS, *_SYSTEMS) and not gazebo.reads(plugin):
                ignored.add_plugin(plugin)
        ignored.add("gripper", len(holder.findall("gripper")))
        ignored.add("actor", len(holder.findall("actor")))
        ignored.add_unknown([each for each in holder if "}" in str(each.tag)], drake.TAGS)
    ground = [link for link in raw.iter("link") if link.get("name") == WORLD]
    ignored.add(f"link {WORLD!r}, which is the ground", len(ground))
    static = [model for model in raw.iter("model") if model.findtext("static", "").strip() in ("1", "true")]
    fixed = {link for model in static for link in model.iter("link")}
    for link in raw.iter("link"):
        shapes = link.findall("collision")
        floors = sum(shape.find("geometry/plane") is not None for shape in shapes)
        ignored.add(STATIC if link in fixed else COLLISIONS, len(shapes) - floors)
        ignored.add(FLOOR, floors)
        ignored.add("link in the wind", link.findtext("enable_wind", "").strip() in ("1", "true"))
        ignored.add_unknown([each for each in link if "}" in str(each.tag)], (), "links")
    for joint in raw.iter("joint"):
        limits = joint.findall("axis/limit") + joint.findall("axis2/limit")
        bounded = any(
            abs(finite(limit.findtext(end), INFINITE) or 0.0) < INFINITE
            for limit in limits for end in ("lower", "upper") if finite(limit.findtext(end), INFINITE) is not None
        )  # fmt: skip
        ignored.add(WATCHED, bounded and joint.get("type") not in ("continuous", "fixed", "ball"))
        ignored.add("joint <physics>", joint.find("physics/ode") is not None)
        extensions = [each for each in joint if "}" in str(each.tag)]
        ignored.add_unknown(extensions, (DRAKE + "rotor_inertia", DRAKE + "gear_ratio"), "joints")
    count_unknown(raw, SDF, ignored)
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


def weightless(document: Document, model: pin.Model, ignored: Ignored) -> tuple[Wrench, ...]:
    """The forces that carry the weights of links on which gravity does not act; without any, gravity is zero."""
    pulled, free = [], []
    for name, body in document.bodies.items():
        if any(body.node.child("velocity_decay").value(tag) for tag in ("linear", "angular")):
            warn(f"{body.node.name}: velocity_decay has no effect")
        if not body.static:
            (pulled if body.node.flag("gravity", True) else free).append(name)
    if free and not pulled:
        model.gravity.linear = np.zeros(3)
        return ()
    found, own = [], inertias(document)
    for name in free:
        frame = model.frames[model.getFrameId(name)]
        if frame.parentJoint and own[name].mass:
            force = tuple((-own[name].mass * model.gravity.linear).tolist())
            found.append(Wrench(name, force, xyz=tuple(own[name].lever.tolist())))
    return tuple(found)


def _inertial(out, node):
    if node.child("fluid_added_mass"):
        raise node.error(f"fluid_added_mass is not supported; {WITHOUT.format('fluid_added_mass')}")
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
        try:
            sizes["filename"] = _mesh(uri, folders, solid.child("uri"))
        except FormatError as error:  # it is only not shown
            _log.warning("%s: left out, %s", solid.name, error.reason)
            return
    place = _place(node, body, document)
    material = node.child("material")
    colour = (material.child("diffuse").text() or material.child("ambient").text()).split()
    add_visual(link, place, kind, sizes, " ".join([*colour, "1"] if len(colour) == 3 else colour))


def _colliding(document: Document, model: pin.Model) -> tuple[tuple[Solid, ...], tuple[Plane, ...]]:
    """The collision shapes of links, and the planes of those that do not move."""
    solids, planes = [], []
    for name, body in document.bodies.items():
        moves = model.existFrame(name) and model.frames[model.getFrameId(name)].parentJoint > 0
        for node in body.node.children("collision"):
            solid = node.solid()
            kind = solid.xml.tag if solid else "nothing"
            place = _place(node, body, document)
            friction = node.child("surface").child("friction").child("ode").value("mu", 1.0)
            if kind == "plane" and not moves:
                normal = (body.pose * place).rotation @ np.array(solid.values("normal", (0.0, 0.0, 1.0)))
                offset = float(normal @ (body.pose * place).translation) / np.linalg.norm(normal)
                planes.append(Plane(tuple(normal.tolist()), offset, friction))
                continue
            sizes: tuple[float, ...] = ()
            if kind in ("sphere", "capsule"):
                sizes = (solid.value("radius", 1.0), 0.5 * solid.value("length", 1.0))[: 1 + (kind == "capsule")]
            elif kind == "box":
                sizes = tuple(0.5 * size for size in solid.values("size", (1.0, 1.0, 1.0)))
            solids.append(Solid(name, place, kind, sizes, friction))
    return tuple(solids), tuple(planes)


def _place(node, body: Body, document: Document) -> pin.SE3:
    """The pose of a shape in the axes of its link."""
    place, relative_to = node.pose()
    if not relative_to:
        return place
    base = document.resolve(body.scope, relative_to, f"{node.name}: pose")
    return body.pose.actInv(document.pose(base) * place)


def _mesh_file(shape, folders) -> Path:
    """The file of a mesh whose volume is needed."""
    uri = shape.word("uri")
    name = _mesh(uri, folders, shape.child("uri")).rpartition("://")[2]
    for folder in folders:
        for start in (folder, folder.parent):
            if (start / name).is_file() and (start / name).resolve().is_relative_to(folder):
                return start / name
    raise shape.error(f"the inertia depends on the mesh {short_repr(uri)}, which is not in the folder of the scene")


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
