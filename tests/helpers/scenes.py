"""Reference values of built-in scenes that are benchmarks, and further mechanisms, built from bodies and joints."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

import pinconsist as pc
from benchmarks.linkages import add_body, add_frame, at

# the benchmark's angles (β, Θ, γ, Φ, δ, Ω, ε) and their rates at t = 0.03 s; multipliers there
ANDREWS_END = (
    15.8107711951532, -15.7563710584113, 0.0408222401196, -0.5347301163421,
    0.5244099658800, 0.5347301163421, 1.0480807410419,
)  # fmt: skip
ANDREWS_RATES = (
    1139.92030225908, -1424.37929517752, 11.0329119104851, 19.2933741047986,
    0.57356991482255, -19.2933741047986, 0.32317914924508,
)  # fmt: skip
ANDREWS_LAMBDA = (
    199.175348104540, -29.7553099749337, 23.0665436116230, 31.4527252757789, 22.6424947863949, 11.6173923525987,
)  # fmt: skip


def add_point(model, joint, name, x, y, z=0.0):
    add_frame(model, joint, name, (x, y, z))


ANDREWS_JOINTS = ("beta", "theta", "gamma", "phi", "delta", "omega", "epsilon")
"""In the benchmark's order."""


def on_stage(model, q, frame):
    """Pose of a frame in the axes of the link `stage`, which are those of the benchmark."""
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return data.oMf[model.getFrameId("stage")].actInv(data.oMf[model.getFrameId(frame)])


def slider(mass=2.0, gravity=0.0):
    """A block on a rail along z."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -gravity])
    slide = add_body(model, 0, pin.JointModelPZ(), pin.SE3.Identity(), "slide", mass, (0, 0, 0), 1.0)
    add_point(model, slide, "block", 0, 0)
    return pc.Mechanism(model, name="slider")


def heavy_top():
    """A free body held at its pivot by a point loop: a top on SO(3) with multipliers."""
    model = pin.Model()
    model.gravity.linear = np.array([0, 0, -9.81])
    free = pin.JointModelFreeFlyer()
    add_body(model, 0, free, pin.SE3.Identity(), "top", 15.0, (0, 1, 0), np.diag([0.234375, 0.46875, 0.234375]))
    add_point(model, 1, "pivot", 0, 0, 0)
    return pc.Mechanism(model, [pc.Loop("pivot", "point", "universe", "pivot")], name="heavy_top")


def spherical_chain():
    """Two spherical joints in a chain, closed to the ground by a ball at each of two points: two loops on SO(3)."""
    model = pin.Model()
    first = add_body(
        model, 0, pin.JointModelSpherical(), at(0, 0), "first", 1.0, (0.4, 0.05, 0), np.diag([0.02, 0.09, 0.1])
    )
    second = add_body(
        model, first, pin.JointModelSpherical(), at(0.8, 0), "second", 1.5, (0.3, 0, 0.1), np.diag([0.05, 0.1, 0.12])
    )
    add_point(model, second, "end", 0.7, 0, 0.1)
    add_point(model, first, "elbow", 0.5, 0.2, 0)
    loops = [
        pc.Loop("end", "distance", "universe", "end", xyz1=(0.9, 0.6, 0.3), length=0.75),
        pc.Loop("elbow", "distance", "universe", "elbow", xyz1=(0.2, -0.5, 0.6), length=0.9),
    ]
    return pc.Mechanism(model, loops, name="spherical_chain")


def sliding_mass(*forces):
    """1 kg on a rail, pushed by 10 N."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "rail")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    return pc.Mechanism(model, forces=[pc.JointTorque({"rail": 10.0}), *forces])


def held_mass(rows):
    """A unit mass held by constraints R = `rows` p, shape (nc, 3)."""
    return pc.HessenbergProblem(
        U=lambda t, p, v: v,
        F=lambda t, p, v: np.zeros(3),
        G=lambda t, p, v: rows.T,
        R=lambda t, p: rows @ p,
        R_p=lambda t, p: rows,
    )


def car_axis():
    """(problem, p0, v0): the car axis of the IVP test set, with a time-dependent constraint."""
    eps, M, L, L0, r, omega, g = 1e-2, 10.0, 1.0, 0.5, 0.1, 10.0, 1.0
    K = M * eps**2 / 2

    def road(t):
        y = r * np.sin(omega * t)
        return np.sqrt(L**2 - y**2), y

    def F(t, p, v):
        (xl, yl, xr, yr), (xb, yb) = p, road(t)
        left, right = np.hypot(xl, yl), np.hypot(xr - xb, yr - yb)
        a, b = (L0 - left) / left, (L0 - right) / right
        return np.array([a * xl, a * yl - K * g, b * (xr - xb), b * (yr - yb) - K * g]) / K

    def G(t, p, v):
        (xl, yl, xr, yr), (xb, yb) = p, road(t)
        dx, dy = 2 * (xl - xr), 2 * (yl - yr)
        return np.array([[xb, dx], [yb, dy], [0, -dx], [0, -dy]]) / K

    def R(t, p):
        (xl, yl, xr, yr), (xb, yb) = p, road(t)
        return np.array([xl * xb + yl * yb, (xl - xr) ** 2 + (yl - yr) ** 2 - L**2])

    def R_p(t, p):
        (xl, yl, xr, yr), (xb, yb) = p, road(t)
        dx, dy = 2 * (xl - xr), 2 * (yl - yr)
        return np.array([[xb, yb, 0, 0], [dx, dy, -dx, -dy]])

    def R_t(t, p):
        xb, yb = road(t)
        yd = r * omega * np.cos(omega * t)
        return np.array([-p[0] * yb * yd / xb + p[1] * yd, 0.0])

    problem = pc.HessenbergProblem(U=lambda t, p, v: v, F=F, G=G, R=R, R_p=R_p, R_t=R_t)
    return problem, np.array([0, 0.5, 1, 0.5]), np.array([-0.5, 0, -0.5, 0])


CAR_AXIS_END = (
    (0.04934557842755629, 0.4969894602303324, 1.041742524885400, 0.3739110272652214),
    (-0.07705836840321485, 0.007446866596327776, 0.01755681574942899, 0.7703410437794031),
    (-0.00473688659085, -0.00110468033126),
)


LINKS = {"crank": -1.0, "coupler": 0.6742791460587038, "rocker": -1.4133851241635729}


def rod(model, parent, joint, place, name, length):
    """A rod of 1 kg/m along x, thick enough to have inertia about its axis."""
    inertia = np.diag([1e-3 * length, length**3 / 12, length**3 / 12])
    index = add_body(model, parent, joint, place, name, length, (length / 2, 0, 0), inertia)
    add_point(model, index, f"{name}_tip", length, 0)
    return index


def four_bar(turn=pin.JointModelRY, floating=False):
    """Crank 1 m, coupler 2 m, rocker 1.5 m on 2.2 m; the ground link may itself float."""
    model, ground = pin.Model(), 0
    if floating:
        inertia = np.diag([0.2, 1.0, 1.1])
        ground = add_body(model, 0, pin.JointModelFreeFlyer(), at(0, 0), "ground", 3.0, (1.1, 0, 0.1), inertia)
    crank = rod(model, ground, turn(), at(0, 0), "crank", 1.0)
    rod(model, crank, turn(), at(1, 0), "coupler", 2.0)
    rod(model, ground, turn(), at(2.2, 0), "rocker", 1.5)
    loop = pc.Loop("pin", "hinge", "coupler_tip", "rocker_tip", axis=(0, 1, 0))
    return pc.Mechanism(model, [loop], name="four_bar", guess=LINKS)
