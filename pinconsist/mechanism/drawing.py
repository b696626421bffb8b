"""A mechanism as a small picture, SVG: lines from joint to joint, circles where loops close, motors filled."""

from __future__ import annotations

from html import escape

import numpy as np
import pinocchio as pin

from .rows import LoopRows

SIZE, MARGIN = 320.0, 24.0  # pixels
LEVEL = 0.05  # rad or so: a plane that is level by less is seen from above


def svg_of(mechanism) -> str:
    """The mechanism in its guess, seen across the plane in which it is largest; heights point up where they can."""
    model, data, motors = mechanism.model, mechanism.model.createData(), set(mechanism.actuated)
    pin.forwardKinematics(model, data, mechanism.guess)
    joints = [np.array(data.oMi[i].translation) for i in range(model.njoints)]
    lines = [(joints[model.parents[i]], joints[i], "body") for i in range(1, model.njoints) if model.parents[i]]
    anchors = []
    for closure in LoopRows.of(mechanism).closures:
        if hasattr(closure, "joint1"):
            ends = (closure.joint1, closure.place1), (closure.joint2, closure.place2)
            places = [data.oMi[joint].act(place.translation) for joint, place in ends]
            lines += [(joints[joint], at, "body") for (joint, _), at in zip(ends, places, strict=True) if joint]
            lines.append((*places, "loop"))
            anchors += places
    tips = set(range(1, model.njoints)) - set(model.parents) - {j for each in _carriers(mechanism) for j in each}
    for i in sorted(tips):  # a last body ends at its centre of mass
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


def _carriers(mechanism):
    """The joints that carry the anchors of each loop."""
    closures = LoopRows.of(mechanism).closures
    return [(each.joint1, each.joint2) for each in closures if hasattr(each, "joint1")]


def _plane(points):
    """The middle of points, and two unit vectors of the plane in which they are widest, (2, 3), the second upwards."""
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    normal = np.linalg.svd(points - points.mean(axis=0))[2][2]
    up = np.array([0.0, 0.0, 1.0]) - normal[2] * normal
    if np.linalg.norm(up) < LEVEL:  # seen from above
        up = np.array([0.0, 1.0, 0.0]) - normal[1] * normal
    up /= np.linalg.norm(up)
    right = np.cross(up, normal)
    return middle, np.array([right if right @ np.ones(3) > 0.0 else -right, up])
