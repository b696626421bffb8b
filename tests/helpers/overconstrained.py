"""Mechanisms that can move only because some of their loops follow from others, and the same with rounded numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin

import pinconsist as pc
from helpers.scenes import add_body, at


def parallelogram(longer=0.0, kind="hinge"):
    """A coupler on three cranks of 1 m, 1 m apart, the last of which is longer; angles about +y, hanging at π/2."""
    model = pin.Model()

    def rod(parent, name, x, length):
        inertia = np.diag([1e-3, length**2 / 12, length**2 / 12])
        return add_body(model, parent, pin.JointModelRY(), at(x, 0), name, 1.0, (length / 2, 0, 0), inertia)

    first = rod(0, "a", 0.0, 1.0)
    rod(first, "coupler", 1.0, 2.0)
    rod(0, "b", 1.0, 1.0)
    rod(0, "c", 2.0, 1.0)
    axis = {"axis": (0, 1, 0)} if kind == "hinge" else {}
    loops = [
        pc.Loop("at b", kind, "coupler", "b", xyz1=(1.0, 0, 0), xyz2=(1.0, 0, 0), **axis),
        pc.Loop("at c", kind, "coupler", "c", xyz1=(2.0, 0, 0), xyz2=(1.0 + longer, 0, 0), **axis),
    ]
    guess = {"a": 0.6, "b": 0.6, "c": 0.6, "coupler": -0.6}
    return pc.Mechanism(model, loops, name="parallelogram", guess=guess, actuated=("a",))


def wrist(off=0.0, radius=0.1):
    """A spherical 3-RRR: three motors, all axes through one point; with joints displaced by up to `off` in each axis.

    Its anchors close the loops in the zero configuration.
    """
    rng, model, ends = np.random.default_rng(0), pin.Model(), []

    def along(direction):
        across = np.cross(direction, (0.3, 0.5, 0.8))
        across /= np.linalg.norm(across)
        return np.column_stack((direction, across, np.cross(direction, across)))

    def axis(leg, turn, height):
        angle, reach = turn + 2 * np.pi * leg / 3, np.sqrt(1 - height**2)
        return np.array([reach * np.cos(angle), reach * np.sin(angle), height])

    for leg in range(3):
        parent, pose = 0, pin.SE3.Identity()
        for name, place in (("motor", (0.0, -0.5)), ("elbow", (0.9, 0.1)), ("platform", (0.3, 0.6))):
            if name == "platform" and leg:
                continue
            e = axis(leg, *place)
            here = pin.SE3(along(e), radius / 2 * e + off * rng.uniform(-1, 1, 3))
            body = f"{name}{leg + 1}", 0.2, (0.0, 0.02, 0.01), 1e-3 * np.diag([1.0, 1.2, 1.1])
            parent, pose = add_body(model, parent, pin.JointModelRX(), pose.actInv(here), *body), here
        ends.append(pose)
    loops = []
    for leg in (1, 2):
        e = axis(leg, 0.3, 0.6)
        tip = pin.SE3(along(e), radius * e)
        fields = {"axis": (1, 0, 0)}
        for end, pose in ((1, ends[0]), (2, ends[leg])):
            anchor = pose.actInv(tip)
            fields |= {f"xyz{end}": tuple(anchor.translation), f"rpy{end}": tuple(pin.rpy.matrixToRpy(anchor.rotation))}
        loops.append(pc.Loop(f"leg{leg + 1}", "hinge", "platform1", f"elbow{leg + 1}", **fields))
    return pc.Mechanism(model, loops, name="wrist", actuated=("motor1", "motor2", "motor3"))


def rounded(mechanism, digits):
    """The same mechanism with the positions and angles of all joints and anchors rounded to `digits` decimals."""
    model = mechanism.model.copy()
    for j in range(1, model.njoints):
        place = model.jointPlacements[j]
        rpy = np.round(pin.rpy.matrixToRpy(place.rotation), digits)
        model.jointPlacements[j] = pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.round(place.translation, digits))
    fields = ("xyz1", "rpy1", "xyz2", "rpy2")
    loops = [
        replace(loop, **{field: tuple(np.round(getattr(loop, field), digits)) for field in fields})
        if isinstance(loop, pc.Loop)
        else loop
        for loop in mechanism.loops
    ]
    return replace(mechanism, model=model, loops=loops)


def turned(mechanism):
    """The same mechanism with the tree and its ground anchors rotated and displaced, so that no number is round."""
    model = mechanism.model.copy()
    move = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.5, 0.7), np.array([0.1234567891, 0.2, -1 / 3]))
    for j in range(1, model.njoints):
        if model.parents[j] == 0:
            model.jointPlacements[j] = move * model.jointPlacements[j]
    for i, frame in enumerate(model.frames):
        if frame.parentJoint == 0 and i:
            model.frames[i].placement = move * frame.placement
    model.gravity.linear = move.rotation @ model.gravity.linear
    loops = []
    for loop in mechanism.loops:
        for end in "12" if isinstance(loop, pc.Loop) else "":
            if getattr(loop, f"frame{end}") == "universe":
                place = move * getattr(loop, f"placement{end}")
                rpy = tuple(pin.rpy.matrixToRpy(place.rotation))
                loop = replace(loop, **{f"xyz{end}": tuple(place.translation), f"rpy{end}": rpy})
        loops.append(loop)
    return replace(mechanism, model=model, loops=loops)
