"""The scenes of ``python -m benchmarks work-precision``, each with its start and its time span."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from pinconsist import AssemblyError, InputError, JointSpring, Loop, Mechanism, assemble, load, reference_problem
from pinconsist.formats.catalogue import is_built_in

from .problem import Problem

BUSHING, DAMPER = 1e7, 1e4  # N/m, N·s/m
STARTS = {  # span in s, start, velocities
    "andrews": ((0.0, 0.03), None, None, "Andrews' squeezing mechanism"),
    "crank_rocker": ((0.0, 5.0), {"crank": 0.0}, {"crank": 12.0}, "crank at 12 rad/s"),
    "bricard": ((0.0, 1.2), None, None, "from rest, until just before the rows that are kept are a poor choice"),
    "pendulum": ((0.0, 5.0), None, None, "point mass on a rod of constant length, from rest"),
}
OTHERS = ((0.0, 1.0), None, None, "from rest")
CHAINS = ((0.0, 0.1), None, None, "from rest")  # ever more links whip ever faster


def problem_of(name: str, until: float | None = None) -> Problem:
    """A scene by name, or any mechanism by name or path: released from rest for 1 s (chains: 0.1 s), or `until`.

    A file whose loops cannot close as written has them closed as points.

    Raises
    ------
    InputError, FormatError, AssemblyError
        As for loading and assembling.
    """
    if name == "problem51":
        given = reference_problem(name)
        span, about = (0.0, 1.0), "Arévalo (2008), problem 5.1"
        return Problem(name, about, given.system, (0.0, until or span[1]), given.p0, given.v0)
    span, q0, v0, about = STARTS.get(name, CHAINS if name.startswith("chain_") else OTHERS)
    if name == "stiff_four_bar":
        mechanism = stiff_four_bar()
        span, v0 = (0.0, 2.0), {"crank": 12.0}  # four turns; the reference follows so far
        about = (
            f"crank-rocker, its coupler cut by a bushing of {BUSHING:g} N/m with {DAMPER:g} N·s/m, crank at 12 rad/s"
        )
    elif name == "pendulum":
        mechanism = _pendulum()
    else:
        mechanism = load(name)
    try:
        assembly = assemble(mechanism, q0, v0)
    except AssemblyError:
        if is_built_in(name) or name in STARTS:
            raise
        mechanism, about = load(name, closure="point"), f"{about}; does not close as written: loops closed as points"
        assembly = assemble(mechanism, q0, v0)
    label = name if is_built_in(name) or name in STARTS else Path(name).stem
    if until is not None and not until > 0:
        raise InputError(f"a scene must run for a positive number of seconds, got {until:g}")
    return Problem(label, about, mechanism, (0.0, until or span[1]), assembly.q, assembly.v)


def stiff_four_bar() -> Mechanism:
    """The crank-rocker with a stiff slider in the middle of its coupler."""
    mass, model = 2.0, pin.Model()  # kg/m
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    crank, coupler, rocker, ground = 0.25, 0.70, 0.60, 0.80
    original = load("crank_rocker")
    parts = (
        ("crank", pin.JointModelRY(), 0.0, crank),
        ("coupler", pin.JointModelRY(), crank, coupler / 2),
        ("bushing", pin.JointModelPX(), coupler / 2, coupler / 2),
        ("rocker", pin.JointModelRY(), coupler / 2, rocker),
    )
    parent = 0
    for name, joint, offset, length in parts:
        parent = model.addJoint(parent, joint, pin.SE3(np.eye(3), np.array([offset, 0.0, 0.0])), name)
        m = mass * length
        inertia = np.diag([1e-4 * m, m * length**2 / 12, m * length**2 / 12])
        body = pin.Inertia(m, np.array([length / 2, 0.0, 0.0]), inertia)
        model.appendBodyToJoint(parent, body, pin.SE3.Identity())
    tip = pin.SE3(np.eye(3), np.array([rocker, 0.0, 0.0]))
    model.addFrame(pin.Frame("tip", parent, 0, tip, pin.FrameType.OP_FRAME))
    damping = np.zeros(model.nv)
    damping[2] = DAMPER
    model.damping = damping
    pivot = Loop("pivot", "point", "tip", "universe", xyz2=(ground, 0.0, 0.0))
    angles = dict(zip(original.joints, original.guess, strict=True))
    return Mechanism(model, [pivot], [JointSpring("bushing", BUSHING)], name="stiff_four_bar", guess=angles)


def _pendulum() -> Mechanism:
    """A point mass of 1 kg on two sliders, 1 m from the origin, at rest at the origin's height."""
    mechanism = reference_problem("problem51").system
    circle = replace(mechanism.loops[0], name="rod")
    model = mechanism.model.copy()
    model.gravity.linear = np.array([0.0, -9.81, 0.0])
    return Mechanism(model, [circle], name="pendulum", guess=[-1.0, 0.0])
