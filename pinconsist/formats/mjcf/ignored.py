"""What acts on the bodies of a compiled MJCF model in MuJoCo, but not here, counted."""

import numpy as np

from ...mechanism.file_laws import COLLIDING, FLOOR, FREE_FRICTION, PAIR, WATCHED
from ..ground import Plane, Solid
from ..ignored import Ignored
from .model import pose

_PLANE, _HFIELD = 0, 1
_FREE = 0  # a kind of joint
_KINDS = {2: "sphere", 3: "capsule", 4: "ellipsoid", 5: "cylinder", 6: "box", 7: "mesh"}


def colliding(m, tree) -> tuple[tuple[Solid, ...], tuple[Plane, ...]]:
    """The geoms that may touch a plane of the world, or z = 0 if there is none, and these planes."""
    if {"contact", "constraint"} & tree.off:
        return (), ()
    floors = [g for g in range(m.ngeom) if m.geom_type[g] == _PLANE and m.body_weldid[m.geom_bodyid[g]] == 0]
    solids, planes = {}, []
    for floor in floors:
        frame = tree.model.frames[tree.model.getFrameId(tree.bodies[m.geom_bodyid[floor]])]
        place = frame.placement * pose(m.geom_pos[floor], m.geom_quat[floor])
        normal = place.rotation[:, 2]
        planes.append(Plane(tuple(normal.tolist()), float(normal @ place.translation)))
        for g in np.flatnonzero(_meets(m, m.geom_contype[floor], m.geom_conaffinity[floor])):
            friction = float(max(m.geom_friction[[g, floor], 0])) if max(m.geom_condim[[g, floor]]) > 1 else 0.0
            solids[g] = _solid(m, g, tree.bodies, friction)
    if not floors:
        for g in np.flatnonzero(_meets(m, 1, 1)):  # the bits that a plane has by default
            solids[g] = _solid(m, g, tree.bodies, float(m.geom_friction[g, 0]))
    return tuple(solids.values()), tuple(planes)


def _solid(m, g, bodies, friction) -> Solid:
    """A geom, on the link of its body."""
    kind = _KINDS.get(int(m.geom_type[g]), "height field")
    a, b, c = map(float, m.geom_size[g])
    sizes = {"sphere": (a,), "capsule": (a, b), "box": (a, b, c)}.get(kind, ())
    return Solid(bodies[m.geom_bodyid[g]], pose(m.geom_pos[g], m.geom_quat[g]), kind, sizes, friction)


def _meets(m, contype, conaffinity) -> np.ndarray:
    """Which geoms collide with a floor, by its bits and theirs, and are on bodies that are not welded to the world."""
    fit = (m.geom_contype & conaffinity) | (contype & m.geom_conaffinity)
    return (fit != 0) & (m.body_weldid[m.geom_bodyid] != 0)


def counted(m, off) -> Ignored:
    """The contacts and limits of a compiled model; `off` are the parts that its options disable."""
    ignored = Ignored()
    if "constraint" in off:
        return ignored
    if "contact" not in off:
        ignored.add(PAIR, m.npair)
        for kind, touching in zip(m.geom_type, _touching(m), strict=True):
            if touching:
                ignored.add(FLOOR if kind in (_PLANE, _HFIELD) else COLLIDING)
    if "limit" not in off:
        ignored.add(WATCHED, int(np.count_nonzero(m.jnt_limited)))
        ignored.add("limited tendon", int(np.count_nonzero(m.tendon_limited)))
    if "frictionloss" not in off:
        rubs = m.dof_frictionloss[m.jnt_dofadr] * (m.jnt_type == _FREE)
        ignored.add(FREE_FRICTION, int(np.count_nonzero(rubs)))
    ignored.add("plugin", m.nplugin)
    return ignored


def _touching(m) -> np.ndarray:
    """Whether each geom may touch another one: their bits fit, and their bodies are neither one nor neighbours."""
    weld, found = m.body_weldid[m.geom_bodyid], np.zeros(m.ngeom, bool)
    above = m.body_weldid[m.body_parentid[weld]]
    for g in range(m.ngeom):
        fit = (m.geom_contype[g] & m.geom_conaffinity) | (m.geom_contype & m.geom_conaffinity[g])
        apart = weld != weld[g]
        neighbours = ((above == weld[g]) & (weld[g] != 0)) | ((weld == above[g]) & (above[g] != 0))
        found[g] = np.any((fit != 0) & apart & ~neighbours)
    return found
