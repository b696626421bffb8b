"""Descriptions of a mechanism: text, HTML with a small picture, and digests to compare mechanisms."""

import dataclasses
import functools
import hashlib
from collections.abc import Mapping
from html import escape

import numpy as np
import pinocchio as pin

from .checks import workspace
from .forces import bound_forces
from .names import position_names, position_units
from .rows import AnchoredRows, LoopRows

WIDTH = 100  # characters of a line
SIZE, MARGIN = 320.0, 24.0  # pixels
LEVEL_SLOPE = 0.05  # sine of the slope below which a plane counts as horizontal and is seen from above


def text_of(mechanism) -> str:
    """Name and sizes, then one line each with the names of joints, loops, forces and motors, shortened if long."""
    model = mechanism.model
    loops = [f"{loop.name} ({loop.kind})" for loop in mechanism.loops]
    head = f"{mechanism.name}: {_counted(mechanism.joints, 'joint')} (nq {model.nq}, nv {model.nv})"
    head += f", {_counted(loops, 'loop')} ({mechanism.nc} rows)" if loops else ""
    parts = {
        "joints": mechanism.joints,
        "loops": loops,
        "forces": bound_forces(model, mechanism.forces),
        "contacts": [f"{each.name} ({each.kind})" for each in mechanism.contacts],
        "motors": mechanism.actuated,
        "ignored": mechanism.ignored,
    }
    lines = [f"  {what:<8} {_cut(list(names))}" for what, names in parts.items() if names]
    return "\n".join([head, *lines])


def _counted(names, what) -> str:
    return f"{len(names)} {what}{'s' * (len(names) != 1)}"


def _cut(names) -> str:
    shown = len(names)
    while shown > 1 and len(", ".join(names[:shown])) > WIDTH:
        shown -= 1
    return ", ".join(names[:shown]) + (f", … ({len(names)})" if shown < len(names) else "")


def html_of(mechanism) -> str:
    """A picture, a table of the joints, with guess and limits, and a list of loops and forces."""
    model, rows, names, units = mechanism.model, [], position_names(mechanism.model), position_units(mechanism.model)
    motors = set(mechanism.actuated)
    kinds = [joint.shortname().removeprefix("JointModel") for joint in model.joints[1:] for _ in range(joint.nq)]
    for name, unit, kind, value, *ends in zip(
        names, units, kinds, mechanism.guess, model.lowerPositionLimit, model.upperPositionLimit, strict=True
    ):
        limits = " … ".join(f"{end:.4g}" for end in ends) if np.isfinite(ends).any() and ends[0] < ends[1] else ""
        motor = "motor" if name.partition("[")[0] in motors else ""
        rows.append((name, kind, f"{value:.5g} {unit}", limits, motor))
    loops = [f"{loop.kind} {loop.name}" for loop in mechanism.loops]
    parts = {
        "loops": loops,
        "forces": bound_forces(model, mechanism.forces),
        "contacts": [f"{each.kind} {each.name}" for each in mechanism.contacts],
        "ignored": mechanism.ignored,
    }
    lists = "".join(f"<p>{what}: {escape(', '.join(each))}</p>" for what, each in parts.items() if each)
    table = _table(("joint", "kind", "guess", "limits", ""), rows)
    return f"<b>{escape(mechanism.name)}</b><br/>{svg_of(mechanism)}{table}{lists}"


def _table(heads, rows) -> str:
    lines = ["".join(f"<th>{head}</th>" for head in heads)]
    lines += ["".join(f"<td>{escape(cell)}</td>" for cell in row) for row in rows]
    return "<table>" + "".join(f"<tr>{line}</tr>" for line in lines) + "</table>"


def svg_of(mechanism) -> str:
    """An SVG picture of the guess: lines between joints, circles at loop anchors, motorised joints filled.

    The view is normal to the plane of largest extent; the vertical points up if possible.
    """
    model, data, motors = mechanism.model, workspace(mechanism.model), set(mechanism.actuated)
    pin.forwardKinematics(model, data, mechanism.guess)
    joints = [np.array(data.oMi[i].translation) for i in range(model.njoints)]
    lines = [(joints[model.parents[i]], joints[i], "body") for i in range(1, model.njoints) if model.parents[i]]
    anchors, tips = [], set(range(1, model.njoints)) - set(model.parents)
    for closure in LoopRows.of(mechanism).closures:
        if isinstance(closure, AnchoredRows):
            ends = (closure.joint1, closure.place1), (closure.joint2, closure.place2)
            places = [data.oMi[joint].act(place.translation) for joint, place in ends]
            lines += [(joints[joint], at, "body") for (joint, _), at in zip(ends, places, strict=True) if joint]
            lines.append((*places, "loop"))
            anchors += places
            tips -= {closure.joint1, closure.joint2}
    for i in sorted(tips):  # the last body of a branch is drawn to its centre of mass
        lines.append((joints[i], data.oMi[i].act(model.inertias[i].lever), "body"))
    points = np.array([*joints[1:], *anchors, *(end for line in lines for end in line[:2])])
    middle, axes = _plane(points)
    flat = (points - middle) @ axes.T
    scale = (SIZE - 2 * MARGIN) / max(np.ptp(flat, axis=0).max(), 1e-9)
    low, (width, height) = flat.min(axis=0), scale * np.ptp(flat, axis=0) + 2 * MARGIN

    def at(point):
        x, y = scale * (axes @ (point - middle) - low) + MARGIN
        return f"{x:.1f}", f"{height - y:.1f}"

    drawn = []
    for start, end, kind in lines:
        (x1, y1), (x2, y2) = at(start), at(end)
        style = 'stroke="#c33" stroke-dasharray="4 3"' if kind == "loop" else 'stroke="#567" stroke-width="4"'
        drawn.append(f'<line x1="{x1}" y1="{y1}" x2="{x2}" y2="{y2}" stroke-linecap="round" {style}/>')
    for place in anchors:
        x, y = at(place)
        drawn.append(f'<circle cx="{x}" cy="{y}" r="5" fill="none" stroke="#c33" stroke-width="2"/>')
    for name, place in zip(mechanism.joints, joints[1:], strict=True):
        (x, y), fill = at(place), "#e90" if name in motors else "#fff"
        drawn.append(
            f'<circle cx="{x}" cy="{y}" r="4" fill="{fill}" stroke="#234"><title>{escape(name)}</title></circle>'
        )
    heads = f'xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{height:.0f}"'
    return f"<svg {heads} role='img' aria-label='the mechanism'>{''.join(drawn)}</svg>"


def _plane(points):
    """The middle of points, and two unit vectors, (2, 3), of the plane of largest extent, the second one upwards."""
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    normal = np.linalg.svd(points - points.mean(axis=0))[2][2]
    up = np.array([0.0, 0.0, 1.0]) - normal[2] * normal
    if np.linalg.norm(up) < LEVEL_SLOPE:  # seen from above
        up = np.array([0.0, 1.0, 0.0]) - normal[1] * normal
    up /= np.linalg.norm(up)
    right = np.cross(up, normal)
    return middle, np.array([right if right @ np.ones(3) > 0.0 else -right, up])


def digests(mechanism) -> dict[str, str]:
    """SHA-256 of ``model`` (as this version of Pinocchio writes it), ``loops``, ``forces``, ``guess``, ``contacts``.

    User-defined functions and objects are identified only by their names.
    """
    parts = {"model": mechanism.model.saveToString()}
    parts |= {name: repr(_plain(getattr(mechanism, name))) for name in ("loops", "forces", "guess", "contacts")}
    return {name: hashlib.sha256(text.encode()).hexdigest() for name, text in parts.items()}


def _plain(value):
    """An equivalent of `value` with the same `repr` in every process."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = [field.name for field in dataclasses.fields(value)]
        return type(value).__name__, [(name, _plain(getattr(value, name))) for name in fields]
    if isinstance(value, Mapping):
        return [(key, _plain(each)) for key, each in value.items()]
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if value is None or isinstance(value, str | bool | int | float):
        return value
    if isinstance(value, functools.partial):
        return "partial", _plain(value.func), _plain(value.args), _plain(value.keywords)
    named = value if hasattr(value, "__qualname__") else type(value)
    return f"{named.__module__}.{named.__qualname__}"
