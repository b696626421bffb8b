"""Mechanisms that touch, and chains with random stops, friction and a floor."""

import numpy as np
import pinocchio as pin

import pinconsist as pc
from benchmarks.linkages import add_body, add_frame, at

G = 9.81


def ball(restitution=0.0, **options):
    """A mass of 1 kg on a vertical rail, with a stop at z = 0."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -G])
    add_body(model, 0, pin.JointModelPZ(), at(0, 0), "z", 1.0, (0, 0, 0), 0.1)
    return pc.Mechanism(model, contacts=[pc.Stop("z", lower=0.0, restitution=restitution)], name="ball", **options)


def pendulum(lower, upper, restitution):
    """A rod of 2 kg on a hinge, between two stops."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -G])
    add_body(model, 0, pin.JointModelRY(), at(0, 0), "hinge", 2.0, (0, 0, -0.5), 0.1)
    stops = [pc.Stop("hinge", lower, upper, restitution=restitution)]
    return pc.Mechanism(model, contacts=stops, name="pendulum")


def block(*contacts, slope=0.0, forces=()):
    """A mass of 1 kg that moves along x and z, with gravity turned by `slope`; the frame z is at its centre."""
    model = pin.Model()
    model.gravity.linear = G * np.array([np.sin(slope), 0.0, -np.cos(slope)])
    x = add_body(model, 0, pin.JointModelPX(), at(0, 0), "x", 0.0, (0, 0, 0), 0.0)
    add_body(model, x, pin.JointModelPZ(), at(0, 0), "z", 1.0, (0, 0, 0), 0.1)
    return pc.Mechanism(model, forces=forces, contacts=contacts, name="block")


def puck(*contacts, slope=0.0):
    """A mass of 1 kg that moves along x, y and z."""
    model = pin.Model()
    model.gravity.linear = G * np.array([np.sin(slope), 0.0, -np.cos(slope)])
    add_body(model, 0, pin.JointModelTranslation(), at(0, 0), "puck", 1.0, (0, 0, 0), 0.1)
    return pc.Mechanism(model, contacts=contacts, name="puck")


def box(width, height, *, friction=0.8, restitution=0.0):
    """A box of 1 kg in the plane, with contacts at its lower corners."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -G])
    inertia = np.diag([0.0, (width**2 + height**2) / 12.0, 0.0])
    x = add_body(model, 0, pin.JointModelPX(), at(0, 0), "x", 0.0, (0, 0, 0), 0.0)
    z = add_body(model, x, pin.JointModelPZ(), at(0, 0), "z", 0.0, (0, 0, 0), 0.0)
    turn = add_body(model, z, pin.JointModelRY(), at(0, 0), "turn", 1.0, (0, 0, 0), inertia)
    for name, side in (("left", -0.5), ("right", 0.5)):
        add_frame(model, turn, name, (side * width, 0.0, -0.5 * height))
    contacts = [pc.Contact(name, name, friction=friction, restitution=restitution) for name in ("left", "right")]
    return pc.Mechanism(model, contacts=contacts, name="box", guess={"z": 0.5 * height})


def table(legs, friction=0.5, height=0.5):
    """A free body of 2 kg on points at (x, y, -height)."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -G])
    add_body(model, 0, pin.JointModelFreeFlyer(), at(0, 0), "table", 2.0, (0, 0, 0), np.diag([0.1, 0.1, 0.2]))
    for i, (x, y) in enumerate(legs):
        add_frame(model, 1, f"leg{i}", (x, y, -height))
    contacts = [pc.Contact(f"leg{i}", f"leg{i}", friction=friction) for i in range(len(legs))]
    return pc.Mechanism(model, contacts=contacts, name="table", guess={"table": [0, 0, height, 0, 0, 0]})


def random_chain(seed):
    """A chain of 2 to 5 joints with random stops, dry friction, a loop, points above a floor; q and v at the start."""
    rng = np.random.default_rng(seed)
    n, planar, closed = int(rng.integers(2, 6)), rng.random() < 0.5, rng.random() < 0.3
    turning = [pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ]
    sliding = [pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ]
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -G])
    parent, place, joints = 0, pin.SE3(np.eye(3), np.array([0.0, 0.0, 1.2])), []
    for i in range(n):
        turns = rng.random() < 0.75
        kinds = turning if turns else sliding
        kind = kinds[1 if turns else 2 * int(rng.integers(2))] if planar else kinds[int(rng.integers(3))]
        way = np.array([0.0, 0.0, -rng.uniform(0.2, 0.5)])
        way = way if planar else pin.exp3(rng.uniform(-0.5, 0.5, 3)) @ way
        joint = model.addJoint(parent, kind(), place, f"j{i}")
        inertia = pin.Inertia(rng.uniform(0.3, 2.0), 0.5 * way, np.diag(rng.uniform(0.01, 0.05, 3)))
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
        add_frame(model, joint, f"tip{i}", way)
        joints.append(f"j{i}")
        parent, place = joint, pin.SE3(np.eye(3), way)
    q, v, contacts = rng.uniform(-0.3, 0.3, n), rng.uniform(-1.5, 1.5, n), []
    for joint, x in zip(joints, q, strict=True):
        if rng.random() < 0.7:
            low, high = x - rng.uniform(0.02, 0.4), x + rng.uniform(0.02, 0.4)
            contacts.append(pc.Stop(joint, low, high, restitution=rng.choice([0.0, 0.3, 0.8])))
        if rng.random() < 0.4:
            kinetic = rng.uniform(0.1, 2.0)
            contacts.append(pc.DryFriction(joint, (kinetic * rng.choice([1.0, 1.3]), kinetic)))
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    tips = [data.oMf[model.getFrameId(f"tip{i}")].translation for i in range(n)]
    floor = min(tip[2] for tip in tips) - rng.uniform(0.0, 0.15) - 1e-3
    loops = []
    if closed and n >= 4:
        shift = np.zeros(3) if planar else np.array([0.5, 0.3, 0.2])
        kind = {"kind": "point"} if planar else {"kind": "distance", "length": float(np.linalg.norm(shift))}
        loops.append(pc.Loop("loop", frame1=f"tip{n - 1}", frame2="universe", xyz2=tuple(tips[-1] + shift), **kind))
    for i in range(n):
        if rng.random() < 0.4:
            friction, restitution = rng.choice([0.0, 0.3, 0.8]), rng.choice([0.0, 0.5])
            contacts.append(pc.Contact(f"c{i}", f"tip{i}", offset=floor, friction=friction, restitution=restitution))
    return pc.Mechanism(model, loops, contacts=contacts, name=f"chain {seed}"), q, v


def random_slide(seed):
    """A puck, a body on three legs, or a box, that slides and turns on a floor or falls on it; q and v at the start."""
    rng = np.random.default_rng(seed)
    kind, slope = rng.integers(3), rng.choice([0.0, 0.2])
    turned = rng.uniform(-0.3, 0.3)
    legs = [
        [(0.0, 0.0)],
        [(0.4 * np.cos(angle), 0.4 * np.sin(angle)) for angle in turned + np.array([0.0, 2.1, 4.2])],
        [(x, y) for x in (0.3, -0.3) for y in (0.25, -0.25)],
    ][kind]
    height = 0.2 if kind else 0.0
    friction, restitution = rng.choice([0.1, 0.3, 0.6]), rng.choice([0.0, 0.4])
    model = pin.Model()
    model.gravity.linear = G * np.array([np.sin(slope), 0.0, -np.cos(slope)])
    add_body(model, 0, pin.JointModelFreeFlyer(), at(0, 0), "body", 2.0, (0, 0, 0), np.diag([0.1, 0.1, 0.2]))
    for i, (x, y) in enumerate(legs):
        add_frame(model, 1, f"leg{i}", (x, y, -height))
    contacts = [pc.Contact(f"leg{i}", f"leg{i}", friction=friction, restitution=restitution) for i in range(len(legs))]
    pose = pin.SE3(np.eye(3), np.array([0.0, 0.0, height]))
    if rng.random() < 0.5:  # it falls
        pose = pin.SE3(pin.exp3(0.05 * rng.normal(size=3)), np.array([0.0, 0.0, height + 0.03]))
        pose.translation[2] -= min(0.0, *(pose.act(np.array([x, y, -height]))[2] for x, y in [*legs, (0.0, 0.0)]))
    v = [*rng.uniform(-1.5, 1.5, 2), 0.0, 0.0, 0.0, rng.uniform(-4.0, 4.0) * (kind > 0)]
    return pc.Mechanism(model, contacts=contacts, name=f"slide {seed}"), pin.SE3ToXYZQUAT(pose), np.array(v)
