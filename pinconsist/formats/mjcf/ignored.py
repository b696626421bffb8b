"""What acts on the bodies of a compiled MJCF model in MuJoCo, but not here, counted."""

import numpy as np

from ..ignored import LIMITS, Ignored

_PLANE, _HFIELD = 0, 1


def counted(m, off) -> Ignored:
    """The contacts and limits of a compiled model; `off` are the parts that its options disable."""
    ignored = Ignored()
    if "constraint" in off:
        return ignored
    if "contact" not in off:
        ignored.add("contact pair", m.npair)
        for kind, touching in zip(m.geom_type, _touching(m), strict=True):
            if touching:
                ignored.add("floor" if kind in (_PLANE, _HFIELD) else "colliding geom")
    if "limit" not in off:
        ignored.add(LIMITS, int(np.count_nonzero(m.jnt_limited)))
        ignored.add("limited tendon", int(np.count_nonzero(m.tendon_limited)))
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
