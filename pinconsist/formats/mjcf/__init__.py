"""MJCF files: MuJoCo compiles them (``pip install 'pinconsist[mjcf]'``), and the compiled model is converted.

Supported are bodies with any number of hinge, slide, ball and free joints; inertias and sites; connect, weld and joint
equalities; damping, dry friction, springs and armature of joints; gravity and gravity compensation. So are motor,
position, velocity and general actuators of joints, with affine gain and bias, gear and limits. Their controls are those
of the first keyframe if there is one; otherwise they are zero, and a position actuator holds ``ref``.

Joint limits, contacts, sensors and solver settings have no effect. Anything else that acts on the bodies in MuJoCo is
refused by name. (Pinocchio's own reader takes only the first body of the world, and makes composite joints, whose
derivatives are wrong.)
"""

import logging
from pathlib import Path
from xml.etree.ElementTree import tostring

import numpy as np
import pinocchio as pin

from ...errors import FormatError
from ...mechanism.checks import places
from ..reading import RobotFile, finite, text
from ..urdf import add_visual, fixed_links
from .model import Tree, pose
from .source import Source

_VISIBLE = 2  # the last group of geoms that is shown, as in MuJoCo's viewers
_SPHERE, _CAPSULE, _CYLINDER, _BOX, _MESH = 2, 3, 5, 6, 7
_GREY = (0.5, 0.5, 0.5, 1.0)
_log = logging.getLogger(__name__)


def read(path: Path, name: str, folders) -> RobotFile:
    """Read an MJCF file.

    The active equality constraints become loops. Joint positions are those of MuJoCo: ``ref`` in the configuration of
    the file. Assembly starts at the first keyframe or, without one, in that configuration.
    """
    try:
        with np.errstate(all="ignore"):  # numbers that are not finite are reported by Tree
            source = Source(path, folders)
            compiled, stand_ins = source.compiled()
            tree = Tree(compiled, name)
            closures, actuators = tuple(tree.closures()), tuple(tree.actuators())
            forces = (*tree.forces(), *(made for _, made in actuators if made is not None))
    except RecursionError:
        raise FormatError("elements are nested too deeply") from None
    start = tree.configuration(compiled.key_qpos[0] if compiled.nkey else compiled.qpos0)
    guess = {joint: start[places(tree.model, i)[0]] for i, joint in enumerate(tree.joints, start=1)}
    shapes = _visible(compiled, stand_ins, tree.bodies, source.meshes)
    actuated = tuple(joint for joint, _ in actuators if joint)
    return RobotFile(tree.model, shapes, closures, forces=forces, guess=guess, actuated=actuated)


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
