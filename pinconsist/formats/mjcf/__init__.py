"""MJCF files: MuJoCo compiles them (``pip install 'pinconsist[mjcf]'``), and the compiled model is converted.

Supported are bodies with any number of hinge, slide, ball and free joints; inertias and sites; connect, weld, joint and
tendon equalities; damping, dry friction, springs and armature of joints and of fixed tendons, springs and dampers of
tendons between two sites; gravity and gravity compensation. So are motor,
position, velocity and general actuators of joints, with affine gain and bias, gear and limits. Their controls are those
of the first keyframe if there is one; otherwise they are zero, and a position actuator holds ``ref``.

Joint limits, limits of tendons and contacts are counted; sensors and solver settings have no effect. Anything else that
acts on the bodies in MuJoCo is refused by name. (Pinocchio's own reader takes only the first body of the world, and
makes composite joints, whose derivatives are wrong.)

MuJoCo itself opens no files: includes are expanded here, attached models are passed as separate texts, and both must be
in the folder of the scene. The scene is compiled twice, with different stand-ins for its meshes; if this changes an
inertia, the mesh files are read.
"""

import logging
import os
import re
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from itertools import pairwise
from math import prod
from pathlib import Path, PurePosixPath
from xml.etree.ElementTree import Element, tostring

import numpy as np
import pinocchio as pin

from ...errors import FormatError, MissingExtraError
from ...mechanism.checks import places
from ..grammar import Known, count_unknown
from ..ignored import Ignored
from ..reading import RobotFile, asking_for, finite, located, log_left_out, parsed, read_bytes, short_repr, text
from ..urdf import add_visual, fixed_links
from .ignored import colliding, counted
from .model import Tree, pose

_VISIBLE = 2  # the last group of geoms that is shown, as in MuJoCo's viewers
_SPHERE, _CAPSULE, _CYLINDER, _BOX, _MESH = 2, 3, 5, 6, 7
_GREY = (0.5, 0.5, 0.5, 1.0)
_log = logging.getLogger(__name__)


def read(path: Path, name: str, folders, *, ignore=()) -> RobotFile:
    """Read an MJCF file; `ignore` names elements to leave out, by tag or name, with what refers to them.

    The active equality constraints become loops. Joint positions are those of MuJoCo: ``ref`` in the configuration of
    the file. Assembly starts at the first keyframe or, without one, in that configuration.
    """
    try:
        with np.errstate(all="ignore"):  # numbers that are not finite are reported by Tree
            source = Source(path, folders, ignore)
            compiled, stand_ins = source.compiled()
            tree = Tree(compiled, name)
            closures, actuators = tuple(tree.closures()), tuple(tree.actuators())
            forces = (*tree.forces(), *(made for _, made in actuators if made is not None))
    except RecursionError:
        raise FormatError("elements are nested too deeply") from None
    start = tree.configuration(compiled.key_qpos[0] if compiled.nkey else compiled.qpos0)
    joints = (*tree.joints, *tree.tendons)
    guess = {joint: start[places(tree.model, i)[0]] for i, joint in enumerate(joints, start=1)}
    shapes = _visible(compiled, stand_ins, tree.bodies, source.meshes)
    actuated = tuple(joint for joint, _ in actuators if joint)
    ignored = (*counted(compiled, tree.off).lines(), *source.ignored.lines())
    solids, planes = colliding(compiled, tree)
    return RobotFile(
        tree.model, shapes, closures, forces=forces, guess=guess, actuated=actuated, ignored=ignored,
        solids=solids, planes=planes,
    )  # fmt: skip


@dataclass(frozen=True)
class SolverSettings:
    """How an MJCF file has MuJoCo solve: step, s, name of the integrator, other options, and equalities by loop."""

    timestep: float
    integrator: str
    options: dict
    equalities: dict  # loop → (solref, solimp)


SOLVING = ("solver", "iterations", "tolerance", "ls_iterations", "ls_tolerance", "impratio")


def solver_settings(path, folders=()) -> SolverSettings:
    """The settings of the solver in an MJCF file; FormatError for a file that cannot be read."""
    import mujoco

    path = Path(path)
    m, _ = Source(path, [*folders, path.parent]).compiled()
    kinds = [mujoco.mjtEq(int(kind)).name.removeprefix("mjEQ_").lower() for kind in m.eq_type]
    names = [m.eq(e).name or f"{kind}{e + 1}" for e, kind in enumerate(kinds)]
    equalities = {
        name: (tuple(m.eq_solref[e].tolist()), tuple(m.eq_solimp[e].tolist())) for e, name in enumerate(names)
    }
    integrator = mujoco.mjtIntegrator(int(m.opt.integrator)).name.removeprefix("mjINT_")
    integrator = {"EULER": "Euler", "RK4": "RK4"}.get(integrator, integrator.lower())
    options = {key: getattr(m.opt, key) for key in SOLVING}
    return SolverSettings(float(m.opt.timestep), integrator, options, equalities)


def _visible(m, stand_ins, bodies, meshes) -> str:
    """The visible shapes as URDF, without planes, height fields, ellipsoids, and meshes outside the folder."""
    robot, links = fixed_links(bodies)  # all fixed to the world: the frames of the model give their poses
    for g in np.flatnonzero((m.geom_group <= _VISIBLE) & ((m.geom_type == _MESH) | ~stand_ins)):
        colour = m.geom_rgba[g]
        if m.geom_matid[g] >= 0 and np.array_equal(colour, _GREY):
            colour = m.mat_rgba[m.geom_matid[g]]
        rgba = " ".join(f"{value:.7g}" for value in colour)  # MuJoCo stores colours in single precision
        for shape in _shapes(m, g, meshes):
            add_visual(links[bodies[m.geom_bodyid[g]]], *shape, rgba)
    return tostring(robot, encoding="unicode")


def _shapes(m, g, meshes):
    """The shapes of a geom, three for a capsule: (place in the body, name, sizes)."""
    kind, place, (a, b, c) = m.geom_type[g], pose(m.geom_pos[g], m.geom_quat[g]), m.geom_size[g]
    if kind == _SPHERE:
        yield place, "sphere", {"radius": text(a)}
    elif kind == _BOX:
        yield place, "box", {"size": text(2 * a, 2 * b, 2 * c)}
    elif kind in (_CYLINDER, _CAPSULE):
        yield place, "cylinder", {"radius": text(a), "length": text(2 * b)}
        for end in (-b, b) if kind == _CAPSULE else ():
            yield place * pin.SE3(np.eye(3), np.array([0.0, 0.0, end])), "sphere", {"radius": text(a)}
    elif kind == _MESH:
        i = m.geom_dataid[g]
        file = m.paths[m.mesh_pathadr[i] :].partition(b"\0")[0].decode() if m.mesh_pathadr[i] >= 0 else ""
        mesh = meshes[int(file.partition(".")[0])] if file else None
        if mesh is None or not mesh.path:
            reason = "its file is outside the scene's folder" if mesh else "it has no file"
            _log.warning("mesh %r: not shown, %s", m.mesh(i).name, reason)
            return
        given = (mesh.node.get("refquat", "1 0 0 0"), mesh.node.get("refpos", "0 0 0"))
        quat, pos = ([finite(word) or 0.0 for word in words.split()] for words in given)
        back, scale = pin.Quaternion(*quat).normalized().toRotationMatrix().T, m.mesh_scale[i]
        place = place * pose(m.mesh_pos[i], m.mesh_quat[i]).inverse()  # undo MuJoCo's shift to the centre of mass
        place = place * pin.SE3(back, -scale * (back @ pos))
        yield place, "mesh", {"filename": mesh.path, "scale": text(*scale)}


MOST_FILES = 200
MOST_ELEMENTS = 100_000  # with all copies
_MOST_USERS = 3  # named in a message
MOST_NESTED = 10  # files, each included by the one before
_LEFT_OUT = {"size", "custom", "deformable", "texture", "skin", "layer", "sensor"}
_IGNORED = "fusestatic discardvisual strippath meshdir texturedir assetdir fuse texture content_type".split()
"""Elements and attributes to remove: they have no effect here, but name files, take memory or hide shapes."""
_FORMER = "apirate collision mpr_iterations mpr_tolerance exactmeshinertia".split()
"""Attributes of earlier versions of MuJoCo, of rendering, contacts and solvers, which later ones refuse."""
_STRUCTURE = "compiler option size default worldbody body joint freejoint inertial include attach model asset".split()
_REFERENCES = "joint joint1 joint2 tendon tendon1 tendon2 actuator site site1 site2 flex objname".split()
_COUNTS = {"replicate": "count", "composite": "count", "mesh": "params"}
_MAIN = "scene.xml"
_CORNERS = "v 0 0 0\nv {} 0 0\nv 0 {} 0\nv 0 0 {}\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
_STAND_INS = tuple(_CORNERS.format(*edges).encode() for edges in ((10, 10, 10), (20, 30, 50)))
_INERTIAS = ("body_mass", "body_inertia", "body_ipos", "body_iquat", "body_pos", "body_quat")
_log = logging.getLogger(__name__)


@dataclass(eq=False)
class Mesh:
    """A mesh file: its element, its path from the folder of the scene (empty if it must not be read), its content."""

    node: Element
    path: str
    place: Path
    content: bytes | None = None
    suffix: str = ".obj"


class Source:
    """The texts and mesh files that MuJoCo compiles. Of `folders`, which may hold meshes, the last is the scene's.

    In the compiled model the file name of a mesh begins with its index in ``meshes``.
    """

    def __init__(self, path: Path, folders, ignore=()):
        self.meshes: list[Mesh] = []
        self.ignored = Ignored()
        self._ignore, self._gone = set(ignore), set()  # names to leave out, and those of what was left out
        self._folders = [Path(os.path.abspath(each)) for each in folders]
        self._texts: dict[str, list[Element]] = {}  # all elements of a text
        self._files: dict[Element, Path] = {}  # outermost elements → their file
        self._homes: dict[Element, Path] = {}  # meshes → the folder of the file that was included
        self._opened = 0
        root, file = _parsed(path), Path(os.path.abspath(path))
        if root.tag != "mujoco":
            hint = "; a URDF needs the ending .urdf" if root.tag == "robot" else ""
            raise FormatError(
                f"the root element of an MJCF file is <mujoco>, this is <{root.tag}>{hint}{_users(path)}", path=path
            )  # fmt: skip
        self._files[root], self._main = path, file
        self._add(_MAIN, root, (file,))

    def _add(self, name, root, files) -> float:
        """Add a text, after the models that it attaches; return its number of elements.

        The last of the files is that of the text; each file includes or attaches the next one.
        """
        self._include(root, files)
        if root.find("body") is not None:  # MuJoCo ignores it silently
            raise FormatError(f"<body> belongs in <worldbody>{_users(files[0])}", path=self._files[root])
        count_unknown(root, _schema(), self.ignored)
        _as_today(root)
        keys = root.findall("keyframe/key") if name == _MAIN else []
        keys = [key for key in keys if "qpos" in key.attrib] or [key for key in keys if "ctrl" in key.attrib]
        for section in root.findall("keyframe"):
            section[:] = [key for key in section if key in keys[:1] or key.tag != "key"]
        compiler = {key: value for node in root.findall("compiler") for key, value in node.attrib.items()}
        models, sizes = {}, {}
        self._leave_out(root)
        for node in list(root.iter()):
            if node.tag in ("flex", "flexcomp"):
                cure = f"ignore=[{node.tag!r}] loads the scene without them"
                raise FormatError(
                    f"flexible bodies are not supported; {cure}", path=self._files[root], element=node.tag
                )
            node[:] = [child for child in node if child.tag not in _LEFT_OUT]
            if node.tag == "model":
                inner, text = self._open(node, files), f"{self._opened}.xml"
                models[node.get("name")] = self._add(text, *inner)
                node.set("file", text)
            else:
                self._clean(node, compiler, files[-1].parent)
        self._texts[name] = list(root.iter())
        for node in reversed(self._texts[name]):
            sizes[node] = _copies(node, models) * (1 + sum(map(sizes.get, node)))
            node.text, node.tail = "\n" if len(node) else None, None
            for child in node[:-1]:
                child.tail = "\n"  # each element begins a line
        if sizes[root] > MOST_ELEMENTS:
            raise FormatError(f"more than {MOST_ELEMENTS:,} elements, with all copies", path=self._files[root])
        return sizes[root]

    def _leave_out(self, root):
        """Remove the elements that `ignore` names by tag or name, and those that refer to one by its name."""
        searching = bool(self._ignore)
        while searching:  # what refers to an element may come before it
            found = [(node, child) for node in root.iter() for child in node if self._is_left_out(child)]
            for node, child in found:
                self._gone |= {child.get("name")} - {None, ""}
                log_left_out(child.tag, child.get("name", ""))
                node.remove(child)
            searching = bool(found)

    def _is_left_out(self, child) -> bool:
        if child.tag in _STRUCTURE:
            return False
        names = {child.tag, child.get("name", "")}
        return bool(names & self._ignore or self._gone & {child.get(key) for key in _REFERENCES})

    def _clean(self, node, compiler, folder):
        """Remove the file names from an element; the file of a mesh is added to ``meshes``."""
        node.attrib = {key: value for key, value in node.attrib.items() if key not in _IGNORED}
        if given := node.attrib.pop("file", "").replace("\\", "/"):
            node.attrib.setdefault("name", PurePosixPath(given).stem)
        if node.tag == "hfield":  # it has no mass
            node.attrib = {"name": node.get("name", ""), "size": "1 1 1 1", "nrow": "2", "ncol": "2"}
        elif node.tag == "mesh" and given:
            given = PurePosixPath(given).name if compiler.get("strippath") == "true" else given
            place = os.path.join(folder, compiler.get("meshdir", compiler.get("assetdir", "")), given)
            beside = os.path.normpath(os.path.join(self._homes.get(node, folder), given))  # where MuJoCo looks next
            place = beside if os.path.isfile(beside) and not os.path.isfile(place) else place
            path = os.path.relpath(place, self._folders[-1])
            inside = any(_inside(place, each) for each in self._folders)
            self.meshes.append(Mesh(node, path if inside or not path.startswith("..") else "", Path(place)))

    def _include(self, root, files):
        """Replace the includes below an element by the contents of the files that they name."""
        for node in list(root.iter()):
            for child in node.findall("include"):
                included, chain = self._open(child, files)
                for mesh in included.iter("mesh"):
                    self._homes[mesh] = chain[-1].parent
                self._include(included, chain)
                place = list(node).index(child)
                node[place : place + 1] = list(included)

    def _open(self, node, files):
        """The root element of the file that an element names, and the chain of files up to it."""
        name, folder = node.get("file", ""), self._folders[-1]
        reason = "there is no such file" if name else "attribute 'file' is missing"
        for start in (folder, files[-1].parent) if name else ():
            found = Path(os.path.normpath(start / name))
            if not any(_inside(found, each) for each in self._folders):
                reason = f"it is outside the folder of the scene; {asking_for(found, folder)}"
                break
            if os.path.isfile(found):
                self._opened += 1
                if found in files or len(files) > MOST_NESTED or self._opened > MOST_FILES:
                    reason = f"it includes itself, or there are over {MOST_FILES} files or {MOST_NESTED} levels of them"
                    break
                root = _parsed(found)
                self._files |= dict.fromkeys((root, *root), found)
                return root, (*files, found)
        raise FormatError(reason, path=files[-1], element=f"{node.tag} {short_repr(name)}")

    def compiled(self):
        """The mjModel, and for each geom whether its size is that of a stand-in; FormatError with MuJoCo's message."""
        for needed in (False, True):
            for mesh in self.meshes if needed else ():
                places = [os.path.normpath(folder / mesh.path) for folder in self._folders if mesh.path]
                allowed = [Path(file) for file in places if any(_inside(file, folder) for folder in self._folders)]
                file = next((file for file in allowed if os.path.isfile(file)), None)
                if file is not None:
                    mesh.content, mesh.suffix = read_bytes(file), file.suffix.lower()
            model = self._compiled(_STAND_INS[0])
            other = self._compiled(_STAND_INS[1]) if self.meshes else model
            differences = [np.nan_to_num(getattr(model, key) - getattr(other, key)) for key in _INERTIAS]
            bodies = np.flatnonzero(np.column_stack(differences).any(axis=1))
            if not bodies.size:
                return model, np.any(model.geom_size != other.geom_size, axis=1)
        missing = [mesh.path or mesh.node.get("name") for mesh in self.meshes if mesh.content is None]
        names = ", ".join(missing[:6]) + ", …" * (len(missing) > 6)
        reason = f"its inertia depends on meshes whose files are not in the folder of the scene: {names}"
        body = f"body {model.body(bodies[0]).name or bodies[0].item()!r}"
        elsewhere = next((mesh.place for mesh in self.meshes if not mesh.path and os.path.isfile(mesh.place)), None)
        if elsewhere is not None:
            raise FormatError(f"{reason}; {asking_for(elsewhere, self._folders[-1])}", element=body)
        raise FormatError(f"{reason}. Give the body an <inertial>, or these geoms mass=0", element=body)

    def _compiled(self, stand_in):
        try:
            import mujoco
        except ImportError:
            need = "MJCF files are compiled by MuJoCo; install it with: pip install 'pinconsist[mjcf]'"
            raise MissingExtraError(need) from None
        assets = {}
        for number, mesh in enumerate(self.meshes):  # MuJoCo caches meshes by these names
            content = mesh.content or stand_in
            name = f"{number}.{sha256(content).hexdigest()}{mesh.suffix}"
            mesh.node.set("file", name)
            assets[name] = content
        lines: list[Element] = []
        for name, nodes in self._texts.items():  # every element has a line number of its own, which MuJoCo reports
            assets[name] = b"\n" * len(lines) + tostring(nodes[0], encoding="us-ascii")
            lines += nodes
        before = mujoco.get_mju_user_warning()
        mujoco.set_mju_user_warning(lambda text: _log.warning("MuJoCo: %s", text))  # the default writes a file
        try:
            return mujoco.MjModel.from_xml_string(assets.pop(_MAIN).decode(), assets)
        except (ValueError, mujoco.FatalError, mujoco.UnexpectedError) as error:
            message, _, where = re.sub("(XML )?Error: |Schema violation: ", "", str(error)).partition("\nElement")
            line = re.search(r"line (\d+)", where)
            file, element = self._place(lines[int(line[1]) - 1]) if line else ("", "")
            advice = _users(self._main)
            if not advice and message.startswith("unrecognized"):
                version = mujoco.__version__
                advice = f"; MuJoCo {version} does not read it: an older one may, and its mj_saveLastXML writes it anew"
            raise FormatError(" ".join(message.split()) + advice, path=file, element=element) from error
        finally:
            mujoco.set_mju_user_warning(before)

    def _place(self, node):
        """The file of an element, and its name in messages."""
        parents = {child: each for nodes in self._texts.values() for each in nodes for child in each}
        line, words = [node], []
        while line[-1] in parents:
            line.append(parents[line[-1]])
        for each, parent in pairwise(line):
            alike = [one for one in (line[-1].iter() if each.tag == "body" else parent) if one.tag == each.tag]
            label = f"{each.tag} {each.get('name') or alike.index(each) + 1!r}"
            words.append(each.tag if parent is line[-1] else label)
            if each.tag == "body":
                break
        return next(self._files[each] for each in line if each in self._files), ": ".join(reversed(words))


@cache
def _schema() -> dict[str, Known]:
    """The elements and attributes of MJCF, as MuJoCo prints them; its compiler overlooks some in a ``<frame>``."""
    import mujoco

    try:
        text = mujoco.mj_printSchema(False, False)
    except (AttributeError, TypeError):  # older versions
        return {}
    found: dict[str, tuple[set, set]] = {}
    above: list[str] = []
    for line in text.replace("(world)body", "body").splitlines():
        match = re.match(r"( *)([\w-]+) \([!*?R]\)(.*)", line)
        if match:
            level, tag, words = len(match[1]) // 3, match[2], match[3]
            above[level:] = [tag]
            found.setdefault(tag, (set(), set()))
            if level:
                found[above[level - 1]][1].add(tag)
        else:
            words = line
        if above:
            found[above[-1]][0].update(words.split())
    found.setdefault("frame", (set("pos quat axisangle xyaxes zaxis euler childclass".split()), set()))
    found.setdefault("replicate", (set("count offset euler sep".split()), set()))
    moving = {"frame", "replicate", "body"}
    found["mujoco"][1].add("worldbody")
    inside = found["body"][1] | moving | {"composite", "flexcomp", "plugin", "attach"}
    found["worldbody"] = (set(), inside)
    for tag in moving:
        found[tag][1].update(inside)
    return {tag: Known(attributes, inside | {"include"}) for tag, (attributes, inside) in found.items()}


def _as_today(root) -> None:
    """Remove what MuJoCo no longer has, or never had: former options, and joints of Bullet that are fixed."""
    for node in root.iter():
        if node.tag in ("option", "compiler"):
            known = _schema().get(node.tag, Known()).attributes
            node.attrib = {key: each for key, each in node.attrib.items() if key in known or key not in _FORMER}
        for joint in [each for each in node.findall("joint") if node.tag == "body" and each.get("type") == "fixed"]:
            node.remove(joint)


def _copies(node, models) -> float:
    """How many copies of an element MuJoCo makes; for a generated mesh, about the number of its vertices."""
    numbers = [max(1.0, finite(word) or 1.0) for word in node.get(_COUNTS.get(node.tag, ""), "").split()]
    if node.tag == "mesh":
        return max(numbers, default=1.0) ** 2  # the vertices form a grid
    return models.get(node.get("model"), 1.0) if node.tag == "attach" else prod(numbers)


def _users(path) -> str:
    """The end of a message about a file that is a part of others: which of them include it."""
    found = []
    for folder in (path.parent, path.parent.parent):
        for other in sorted(folder.glob("*.xml"))[:MOST_FILES]:
            if other != path and len(found) < _MOST_USERS and _includes(other, path):
                found.append(str(other.relative_to(path.parent)) if folder == path.parent else f"../{other.name}")
    return f"; load {' or '.join(found)}, which includes it" if found else ""


def _includes(other, path) -> bool:
    try:
        named = re.findall(r"<include\s[^>]*?file\s*=\s*[\"']([^\"']+)", other.read_text(errors="replace"))
    except OSError:
        return False
    return any(os.path.normpath(other.parent / name) == os.path.normpath(path) for name in named)


def _parsed(path):
    with located(path):
        return parsed(read_bytes(path))


def _inside(path, folder) -> bool:
    """Whether a path, and the file that it resolves to, lie in a folder."""
    return all(Path(form(path)).is_relative_to(form(folder)) for form in (os.path.abspath, os.path.realpath))
