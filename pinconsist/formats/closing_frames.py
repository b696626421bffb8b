"""Frames that are named as the two ends of a loop, read where nothing else says how a robot is closed.

=============================== =================================== ===========================================
names                           written by                          closed as
=============================== =================================== ===========================================
closing_x_1, closing_x_2        onshape-to-robot                    point: the exporter does not write the kind of
                                                                    its mate; the axis of its hinges is the frames' z
closedloopX_A, closedloopX_B    the collection                      frame (its default), or point where the name
                                example-parallel-robots             says 3D: closedloop3D_1A, closedloop2_A_3D
=============================== =================================== ===========================================

``load(..., closure=...)`` chooses otherwise for all of them.
"""

from __future__ import annotations

import logging
import re

from ..mechanism.constraints.loops import Loop

_ONSHAPE = re.compile(r"(closing_.+)_([12])")
_COLLECTION = re.compile(r"(closedloop.*?)_?([AB])(_?[36]D)?", re.IGNORECASE)
_log = logging.getLogger(__name__)


def loops(model, path, closure=None) -> tuple[Loop, ...]:
    """The loops between the pairs of closing frames of a model; what was assumed is logged.

    Parameters
    ----------
    model : pin.Model
    path : path-like
        The file, for the log.
    closure : str, optional
        As for :func:`pinconsist.load`: only a hinge takes the exporter's axis.
    """
    pairs = {}
    for frame in model.frames:
        onshape, collection = _ONSHAPE.fullmatch(frame.name), _COLLECTION.fullmatch(frame.name)
        if onshape:
            pairs.setdefault((onshape[1], "closing"), {})[onshape[2]] = frame.name
        elif collection:
            pairs.setdefault((collection[1] + (collection[3] or ""), "closedloop"), {})[collection[2].upper()] = (
                frame.name
            )
    found = []
    for (name, family), ends in pairs.items():
        if len(ends) < 2:
            _log.warning("%s: the frame %r closes nothing, there is no other to pair it with", path, *ends.values())
            continue
        frame1, frame2 = (ends[side] for side in sorted(ends))
        if family == "closing":
            kind, axis = ("hinge", (0.0, 0.0, 1.0)) if closure == "hinge" else ("point", None)
            found.append(Loop(name, kind, frame1, frame2, axis=axis))
        else:
            found.append(Loop(name, "point" if "3D" in name.upper() else "frame", frame1, frame2))
    if found:
        listed = ", ".join(f"{loop.name} ({loop.kind})" for loop in found)
        _log.warning(
            "%s has no loop file; loops are closed between frames with closing names: %s. "
            "closure= or a loop file says otherwise", path, listed,
        )  # fmt: skip
    return tuple(found)
