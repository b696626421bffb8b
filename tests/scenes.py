"""Benchmark mechanisms built as a user would build them, from rigid bodies, joints, loops and springs."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

import pinconsist as pc

ANDREWS_Q0 = (
    -0.0617138900142764496, 0.0, 0.455279819163070380, 0.222668390165885885,
    0.487364979543842550, -0.222668390165885885, 1.23054744454982119,
)  # fmt: skip
# absolute angles (β, Θ, γ, Φ, δ, Ω, ε) and their rates at t = 0.03 s; multipliers there
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


def at(x, y, z=0.0):
    return pin.SE3(np.eye(3), np.array([x, y, z], dtype=float))


def add_body(model, parent, joint, place, name, mass, com, inertia):
    """A joint with one body; `com` (3,) and inertia about it: a number (every axis alike) or a 3×3 matrix."""
    index = model.addJoint(parent, joint, place, name)
    inertia = np.diag([inertia, inertia, inertia]) if np.isscalar(inertia) else np.asarray(inertia)
    model.appendBodyToJoint(index, pin.Inertia(mass, np.array(com, float), inertia), pin.SE3.Identity())
    return index


def add_point(model, joint, name, x, y, z=0.0):
    model.addFrame(pin.Frame(name, joint, 0, at(x, y, z), pin.FrameType.OP_FRAME))


def andrews():
    """Andrews' squeezing mechanism: seven bodies in the x-y plane, three loops, one spring, a motor torque.

    Joint angles are the benchmark's (β, Θ, γ, Φ, δ, Ω, ε) in another order: Φ and Ω follow the bodies they hang on.
    """
    d, da, e, ea, rr, ra = 0.028, 0.0115, 0.02, 0.01421, 0.007, 0.00092
    ss, sa, sb, sc, sd = 0.035, 0.01874, 0.01043, 0.018, 0.02
    ta, tb, u, ua, ub, zf, zt, fa = 0.02308, 0.00916, 0.04, 0.01228, 0.00449, 0.02, 0.04, 0.01421
    A, B, C = (-0.06934, -0.00227), (-0.03635, 0.03273), (0.014, 0.072, 0.0)
    model, turn = pin.Model(), pin.JointModelRZ()
    model.gravity.setZero()
    k1 = add_body(model, 0, turn, at(0, 0), "beta", 0.04325, (ra, 0, 0), 2.194e-6)
    k2 = add_body(model, k1, turn, at(rr, 0), "theta", 0.00365, (-da, 0, 0), 4.410e-7)
    k3 = add_body(model, 0, turn, at(*B), "gamma", 0.02373, (sb, -sa, 0), 5.255e-6)
    k5 = add_body(model, 0, turn, at(*A), "delta", 0.07050, (ta, tb, 0), 1.169e-5)
    k4 = add_body(model, k5, turn, at(zt, 0), "phi", 0.00706, (0, -(e - ea), 0), 5.667e-7)
    k7 = add_body(model, 0, turn, at(*A), "epsilon", 0.05498, (-ub, -ua, 0), 1.912e-5)
    k6 = add_body(model, k7, turn, at(0, -u), "omega", 0.00706, (zf - fa, 0, 0), 5.667e-7)
    add_point(model, k2, "E2", -d, 0)
    add_point(model, k3, "E3", 0, -ss)
    add_point(model, k3, "D", sd, -sc)
    add_point(model, k4, "E4", 0, -e)
    add_point(model, k6, "E6", zf, 0)
    loops = [pc.Loop(f"E{i}", "point", "E2", f"E{i}") for i in (3, 4, 6)]
    spring = pc.SpringDamper("D", "universe", stiffness=4530.0, length=0.07785, xyz2=C)
    motor = np.zeros(7)
    motor[0] = 0.033
    guess = dict(zip(("beta", "theta", "gamma", "phi", "delta", "omega", "epsilon"), ANDREWS_Q0, strict=True))
    return pc.Mechanism(model, loops, [spring, motor], name="andrews", guess=guess)


ANDREWS_ORDER = [0, 1, 2, 4, 3, 6, 5]  # the benchmark's order of the mechanism's columns


def bricard():
    """A04 Bricard: five rods of 1 m and 1 kg (boxes 1 × 0.1 × 0.1), six hinges, redundant at all times."""
    points = np.array([(0, 0, 0), (1, 0, 0), (1, -1, 0), (1, -1, 1), (0, -1, 1), (0, 0, 1)], float)
    axes = "yzxyzx"
    model = pin.Model()
    model.gravity.linear = np.array([0, -9.81, 0])
    joints = {"x": pin.JointModelRX, "y": pin.JointModelRY, "z": pin.JointModelRZ}
    last = 0
    for i in range(5):
        along = points[i + 1] - points[i]
        inertia = np.eye(3) * (1 + 0.01) / 12 - np.outer(along, along) * (1.01 - 0.02) / 12
        place = at(*(points[i] - (points[i - 1] if i else 0)))
        last = add_body(model, last, joints[axes[i]](), place, f"hinge{i}", 1.0, along / 2, inertia)
        add_point(model, last, f"P{i + 1}", *along)
    loop = pc.Loop("hinge5", "hinge", "P5", "universe", xyz2=(0, 0, 1), axis=(1, 0, 0))
    return pc.Mechanism(model, [loop], name="bricard")


def n_four_bar(n):
    """A02: n four-bars of rods 1 m, 1 kg side by side, 2n + 1 rods; vertical at q = 0, gravity along -y."""
    model, turn = pin.Model(), pin.JointModelRZ()
    model.gravity.linear = np.array([0, -9.81, 0])
    inertia, loops = 1.0 / 12, []
    cranks = [add_body(model, 0, turn, at(0, 0), "crank0", 1.0, (0, 0.5, 0), inertia)]
    last, length = cranks[0], (0, 1)
    for i in range(n):  # the coupler chain hangs on the first crank, each further crank closes a loop
        last = add_body(model, last, turn, at(*length), f"coupler{i}", 1.0, (0.5, 0, 0), inertia)
        length = (1, 0)
        add_point(model, last, f"B{i + 1}", 1, 0)
    add_point(model, cranks[0], "B0", 0, 1)
    for i in range(1, n + 1):
        crank = add_body(model, 0, turn, at(i, 0), f"crank{i}", 1.0, (0, 0.5, 0), inertia)
        add_point(model, crank, f"C{i}", 0, 1)
        loops.append(pc.Loop(f"B{i}", "point", f"B{i}", f"C{i}"))
    return pc.Mechanism(model, loops, name=f"{n}-four-bar")


def heavy_top():
    """A free body held at its pivot by a point loop: a top on SO(3) with its multipliers."""
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


def car_axis():
    """(problem, p0, v0): the car axis of the IVP test set, a constraint that moves."""
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
