"""Closed chains made by chance, each from its seed, against scipy's DOP853 on the index-1 equations."""

from __future__ import annotations

from functools import partial

import numpy as np
import pinocchio as pin

from pinconsist import Loop, Mechanism, PinconsistError, reference_solution
from pinconsist.mechanism.system import MechanismSystem

from ..linkages import add_frame
from .case import EITHER, RTOL, Case, Figure, certified, largest, solved

UNTIL = 0.3
FAMILY = "random chain"
KINDS = {"point": 3, "hinge": 5, "distance": 1, "universal": 4, "cylinder": 4, "slider": 5, "plane": 3, "frame": 6}
AXIS, ACROSS = (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)
JOINTS = {
    "revolute": lambda rng: pin.JointModelRevoluteUnaligned(_direction(rng)),
    "prismatic": lambda rng: pin.JointModelPrismaticUnaligned(_direction(rng)),
    "unbounded": lambda rng: pin.JointModelRUBZ(),
    "spherical": lambda rng: pin.JointModelSpherical(),
}
SHARES = (0.6, 0.15, 0.1, 0.15)


def cases(count=100, seed=0):
    """Yield the cases: seeds from `seed` on."""
    for number in range(seed, seed + count):
        mech, q, v = random_chain(number)
        loops = ", ".join(loop.kind for loop in mech.loops)
        what = f"seed {number}: {len(mech.joints)} joints, {mech.nv} freedoms, closed by {loops}"
        yield Case(FAMILY, what, partial(_against_scipy, mech, q, v), EITHER)


def random_chain(seed):
    """(mechanism, q, v): a closed configuration, and a velocity that need not be on the loops.

    One in three is planar, with the redundant rows that a closure in space has there.
    """
    rng = np.random.default_rng(seed)
    planar = rng.random() < 1 / 3
    model = pin.Model()
    last = 0
    for i in range(rng.integers(3, 9)):
        branches = [0, *list(model.supports[last])[1:]] if last else [0]
        parent = last if rng.random() < 0.8 else int(rng.choice(branches))  # depth-first: only along the last branch
        kind = "revolute" if planar else rng.choice(list(JOINTS), p=SHARES)
        joint = pin.JointModelRY() if planar else JOINTS[kind](rng)
        last = model.addJoint(parent, joint, _placement(rng, planar), f"{kind}{i}")
        model.appendBodyToJoint(last, _body(rng), pin.SE3.Identity())
        add_frame(model, last, f"body{i}")
    q = pin.integrate(model, pin.neutral(model), rng.uniform(-1.5, 1.5, model.nv))
    return Mechanism(model, _loops(rng, model, q, planar), name=f"chain {seed}"), q, rng.normal(0.0, 2.0, model.nv)


def _loops(rng, model, q, planar):
    """Closures that are closed at `q` and leave at least one freedom."""
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    free, loops = model.nv - 1, []
    for number in range(rng.integers(1, 4)):
        frame1 = f"body{model.njoints - 2}" if not loops else f"body{rng.integers(model.njoints - 1)}"
        frame2 = "universe" if rng.random() < 0.5 else f"body{rng.integers(model.njoints - 1)}"
        kinds = ("point", "hinge", "distance", "cylinder") if planar else tuple(KINDS)
        costs = {kind: min(KINDS[kind], 2) if planar else KINDS[kind] for kind in kinds}
        possible = [kind for kind in kinds if costs[kind] <= free]
        if not possible or frame1 == frame2:
            continue
        kind = str(rng.choice(possible))
        free -= costs[kind]
        loops.append(_loop(rng, model, data, f"loop{number}", kind, frame1, frame2, planar))
    if not loops:  # a frame met itself
        loops.append(_loop(rng, model, data, "loop", "distance", f"body{model.njoints - 2}", "universe", planar))
    return loops


def _loop(rng, model, data, name, kind, frame1, frame2, planar):
    anchor1 = pin.SE3.Identity() if planar else _placement(rng, planar)
    anchor1.translation = _offset(rng, planar)
    pose1, pose2 = (data.oMf[model.getFrameId(frame)] for frame in (frame1, frame2))
    anchor2 = pose2.actInv(pose1 * anchor1)
    options = {}
    if kind == "distance":
        anchor2.translation = anchor2.translation + 2 * _offset(rng, planar)
        options["length"] = float(np.linalg.norm((pose2 * anchor2).translation - (pose1 * anchor1).translation))
    if kind in ("hinge", "cylinder", "slider", "plane", "universal"):
        options["axis"] = AXIS
    if kind == "universal":
        options["axis2"] = ACROSS
    angles1, angles2 = (pin.rpy.matrixToRpy(anchor.rotation) for anchor in (anchor1, anchor2))
    return Loop(name, kind, frame1, frame2, anchor1.translation, angles1, anchor2.translation, angles2, **options)


def _against_scipy(mech, q, v, by):
    sol = solved(by, mech, UNTIL, q, v)
    figures = certified(sol, position=1e-8, energy_error=1e-4)
    try:
        rows, peer = (
            reference_solution(mech, 0.0, sol.q[0], sol.v[0], [0.0, UNTIL], rtol=tol, atol=tol) for tol in (1e-11, RTOL)
        )
    except PinconsistError:  # then the solution's own residuals must do
        return figures + certified(sol, force=1e-3)
    names = ("error of q", "error of v, relative", "error of Jᵀλ, relative")
    errors = _errors(mech, sol, rows), _errors(mech, peer, rows)
    return figures + [
        Figure(name, error, max(least, 100 * of_peer))
        for name, error, of_peer, least in zip(names, *errors, (1e-5, 1e-4, 1e-3), strict=True)
    ]


def _errors(mech, rows, reference):
    """Of the last row, in q, v and Jᵀλ; the last two relative to the reference's size, or to 1."""
    q, v = reference.q[-1], reference.v[-1]
    system = MechanismSystem(mech, q)
    forces = [system.loop_rows(each.q[-1])[1].T @ each.lam[-1] for each in (rows, reference)]
    return (
        largest(pin.difference(mech.model, q, rows.q[-1])),
        largest(rows.v[-1] - v) / max(1.0, largest(v)),
        largest(forces[0] - forces[1]) / max(1.0, largest(forces[1])),
    )


def _direction(rng):
    direction = rng.normal(size=3)
    return direction / np.linalg.norm(direction)


def _offset(rng, planar):
    return rng.uniform(-0.7, 0.7, 3) * (1.0, 0.0 if planar else 1.0, 1.0)


def _placement(rng, planar):
    turn = np.eye(3) if planar else pin.exp3(rng.normal(size=3))
    return pin.SE3(turn, _offset(rng, planar))


def _body(rng):
    """0.3 to 3 kg within some 0.3 m."""
    mass, axes = 10.0 ** rng.uniform(-0.5, 0.5), rng.normal(0.0, 0.15, (3, 3))
    second = mass * (axes @ axes.T + 1e-3 * np.eye(3))
    return pin.Inertia(mass, rng.uniform(-0.2, 0.2, 3), np.trace(second) * np.eye(3) - second)
