"""Every derivative against finite differences, at open configurations, on a tree with every kind of joint."""

from itertools import combinations

import numpy as np
import pinocchio as pin
import pytest
from helpers.bodies import differences, frame_pose, mixed_tree, random_state
from helpers.held_bodies import AXIS, AXIS2, E
from helpers.loops import KINDS, PAIRS, closed_gap, loop_of, loop_open_by

import pinconsist as pc
from pinconsist.engine.charts import chart_matrix
from pinconsist.engine.systems import blank_system
from pinconsist.mechanism import loops as loop_records
from pinconsist.mechanism.rows import KeptRows, LoopRows
from pinconsist.mechanism.system import MechanismSystem

TRANSLATIONAL = {"distance": 1, "slider": 2, "cylinder": 2, "plane": 1}  # leading rows without rotation; else 3


def evaluate(rows, q):
    return rows.at(q)


def along_motion(model, rows, q, v, step=1e-4):
    """d(J v)/dt of the motion with constant joint velocities v (q ⊕ t v moves with v at all times)."""
    at = [evaluate(rows, pin.integrate(model, q, s * step * v))[1] @ v for s in (-2, -1, 1, 2)]
    return (at[0] - 8 * at[1] + 8 * at[2] - at[3]) / (12 * step)


def bias_of(rows, q, v):
    return rows.acceleration_bias(0.0, q, v)


@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
@pytest.mark.parametrize("kind", KINDS)
def test_loop_jacobian_is_the_derivative_of_the_gap(kind, pair):
    model, rng = mixed_tree(), np.random.default_rng(1)
    rows = LoopRows(model, [loop_of(kind, *pair)])
    for _ in range(4):
        q, _ = random_state(model, rng)
        phi, J = evaluate(rows, q)
        assert np.abs(phi).max() > 1e-2 and J.shape == (len(loop_records.LOOP_KINDS[kind].rows), model.nv)
        expected = differences(lambda x, q=q: evaluate(rows, pin.integrate(model, q, x))[0], np.zeros(model.nv))
        np.testing.assert_allclose(J, expected, atol=1e-9 * (1 + np.abs(J).max()))


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 3.0, 3.1, np.pi - 0.01])
@pytest.mark.parametrize("kind", ["frame", "hinge"])
def test_rotational_rows_from_closed_to_nearly_turned_over(kind, angle):
    """Φ = log R or the chord 2 sin(angle/2), and J, up to 10 mrad from a half turn."""
    model, rng = mixed_tree(), np.random.default_rng(2)
    axis = np.array(AXIS) / np.linalg.norm(AXIS)
    turned_about = np.cross(axis, rng.normal(size=3)) if kind == "hinge" else rng.normal(size=3)
    turn = angle * turned_about / np.linalg.norm(turned_about)
    q, _ = random_state(model, rng)
    gap = pin.SE3(pin.exp3(turn), np.array([0.3, -0.1, 0.2]))
    rows = LoopRows(model, [loop_open_by(model, q, kind, "arm", "wheel", gap)])
    phi, J = evaluate(rows, q)
    np.testing.assert_allclose(phi[:3], gap.translation, atol=1e-12)
    if kind == "frame":
        np.testing.assert_allclose(phi[3:], turn, atol=1e-9)
    else:
        assert np.linalg.norm(phi[3:]) == pytest.approx(2 * np.sin(angle / 2), abs=1e-10)
        np.testing.assert_allclose(pin.skew(axis) @ turn @ turn, 0, atol=1e-12)
    # near a half turn pin.log3 carries 1e-11 of rounding, and the chord bends within the remaining angle
    step = 5e-4 if kind == "frame" else min(1e-4, 0.004 * (np.pi - angle))
    expected = differences(lambda x: evaluate(rows, pin.integrate(model, q, x))[0], np.zeros(model.nv), step)
    np.testing.assert_allclose(J, expected, atol=5e-8 * (1 + np.abs(J).max()))


@pytest.mark.parametrize("kind", KINDS)
def test_rows_are_the_documented_ones(kind):
    """Φ from the poses of the two anchors, as the table of loops.py has it."""
    model, rng = mixed_tree(), np.random.default_rng(3)
    q, _ = random_state(model, rng)
    loop = loop_of(kind, "raft", "arm")
    gap = (frame_pose(model, q, "raft") * loop.placement1).actInv(frame_pose(model, q, "arm") * loop.placement2)
    d, R = gap.translation, gap.rotation
    phi, _ = evaluate(LoopRows(model, [loop]), q)
    u1 = np.cross(E, [1.0, 0.0, 0.0])  # x is the coordinate axis farthest from E
    u1 /= np.linalg.norm(u1)
    across = np.array([u1, np.cross(E, u1)])
    angle, turned_about = np.arccos(E @ R @ E), np.cross(E, R @ E)
    chord = 2 * np.sin(angle / 2) * across @ turned_about / np.linalg.norm(turned_about)
    a = R @ AXIS2 / np.linalg.norm(AXIS2)
    expected = {
        "point": [d],
        "frame": [d, pin.log3(R)],
        "hinge": [d, chord],
        "distance": [[(d @ d - 0.49) / 1.4]],
        "slider": [across @ d, pin.log3(R)],
        "cylinder": [across @ d, chord],
        "plane": [[E @ d], chord],
        "universal": [d, [E @ a]],
    }[kind]
    np.testing.assert_allclose(phi, np.concatenate(expected), atol=1e-13)


@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
@pytest.mark.parametrize("kind", KINDS)
def test_acceleration_bias_of_open_loops_is_exact_in_the_translational_rows(kind, pair):
    model, rng = mixed_tree(), np.random.default_rng(4)
    rows = LoopRows(model, [loop_of(kind, *pair)])
    translational = slice(0, TRANSLATIONAL.get(kind, 3))
    if kind == "universal":  # its last row is no logarithm either
        translational = slice(0, 4)
    for _ in range(3):
        q, v = random_state(model, rng)
        expected = along_motion(model, rows, q, v)[translational]
        tolerance = 1e-8 * (1 + np.abs(expected).max())
        np.testing.assert_allclose(bias_of(rows, q, v)[translational], expected, atol=tolerance)


@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
@pytest.mark.parametrize("kind", KINDS)
def test_acceleration_bias_of_closed_loops_is_exact_in_all_rows(kind, pair):
    """Also for velocities off the constraints, wherever the loop may have slid and turned."""
    model, rng = mixed_tree(), np.random.default_rng(5)
    for _ in range(2):
        q, v = random_state(model, rng)
        rows = LoopRows(model, [loop_open_by(model, q, kind, *pair, closed_gap(kind, rng))])
        assert np.abs(evaluate(rows, q)[0]).max() < 1e-13
        expected = along_motion(model, rows, q, v)
        np.testing.assert_allclose(bias_of(rows, q, v), expected, atol=1e-8 * (1 + np.abs(expected).max()))


@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
@pytest.mark.parametrize("kind", KINDS)
def test_kept_rows_are_the_exact_rows_where_the_loop_is_closed(kind, pair):
    """Every selection of rows; and their Φ has J for its derivative there, which is what Newton needs."""
    model, rng = mixed_tree(), np.random.default_rng(11)
    q, _ = random_state(model, rng)
    rows = LoopRows(model, [loop_open_by(model, q, kind, *pair, closed_gap(kind, rng))])
    exact = evaluate(rows, q)
    for kept in (kept for n in range(1, rows.nc + 1) for kept in combinations(range(rows.nc), n)):
        compiled = blank_system(model)
        KeptRows(rows, np.array(kept)).hand_over(compiled)

        def at(x, compiled=compiled):
            return compiled.rows(pin.integrate(model, q, x))

        phi, J = at(np.zeros(model.nv))
        np.testing.assert_allclose(phi, exact[0][list(kept)], atol=1e-13)
        np.testing.assert_allclose(J, exact[1][list(kept)], atol=1e-12)
        if len(kept) in (1, rows.nc):
            slope = differences(lambda x, at=at: np.array(at(x)[0]), np.zeros(model.nv))
            np.testing.assert_allclose(J, slope, atol=1e-9 * (1 + np.abs(J).max()))


@pytest.mark.parametrize("count", [1, 2, 5])
def test_loops_together_are_the_loops_one_by_one(count):
    model, rng = mixed_tree(), np.random.default_rng(6)
    points = [loop_of("point", *pair) for pair in PAIRS[:count]]
    kinds = ("hinge", "point", "distance", "frame", "point")
    mixed = [loop_of(kind, *pair) for kind, pair in zip(kinds, PAIRS, strict=True)]
    for loops in (points, mixed[:count]):
        q, v = random_state(model, rng)
        together = LoopRows(model, loops)
        phi, J = evaluate(together, q)
        singles = [LoopRows(model, [loop]) for loop in loops]
        np.testing.assert_allclose(phi, np.concatenate([evaluate(each, q)[0] for each in singles]), atol=1e-14)
        np.testing.assert_allclose(J, np.concatenate([evaluate(each, q)[1] for each in singles]), atol=1e-14)
        bias = np.concatenate([bias_of(each, q, v) for each in singles])
        np.testing.assert_allclose(bias_of(together, q, v), bias, atol=1e-14)
    general = LoopRows(model, [*points, loop_of("frame", "arm", "puck")])
    phi, J = evaluate(LoopRows(model, points), q)
    np.testing.assert_allclose(evaluate(general, q)[0][: 3 * count], phi, atol=1e-14)
    np.testing.assert_allclose(evaluate(general, q)[1][: 3 * count], J, atol=1e-14)


@pytest.mark.parametrize("kinds", [("point",), ("point", "point"), ("distance",), ("frame",), ("hinge", "point")])
def test_returned_rows_survive_the_next_evaluation(kinds):
    model, rng = mixed_tree(), np.random.default_rng(7)
    rows = LoopRows(model, [loop_of(kind, *pair) for kind, pair in zip(kinds, PAIRS, strict=False)])
    first, second = random_state(model, rng)[0], random_state(model, rng)[0]
    phi, J = rows.at(first)
    kept_phi, kept_J = phi.copy(), J.copy()
    other_phi, _ = rows.at(second)
    assert np.abs(other_phi - kept_phi).max() > 1e-3
    np.testing.assert_array_equal(phi, kept_phi)
    np.testing.assert_array_equal(J, kept_J)


def spring(t, q, v):
    return np.cos(t) - 3.0 * np.sin(q) * v**2 - np.roll(q, 1) * v


def spring_gradient(t, q, v):
    by_q = -3.0 * np.diag(np.cos(q) * v**2) - np.roll(np.eye(len(q)), 1, axis=0) * v[:, None]
    by_v = -6.0 * np.diag(np.sin(q) * v) - np.diag(np.roll(q, 1))
    return by_q, by_v


def newton_matrix(system, t, p, v, a, lam, c):
    rho = system.evaluate(t, p, v, a)[3]
    A = np.full((system.nv, system.nv), np.nan)
    W = np.array(system.linearize(t, p, v, a, lam, c, A))
    np.testing.assert_allclose(rho, system.constraint(t, p, system.rate(t, p, v))[1], atol=1e-12)
    return A, W


@pytest.mark.parametrize("c", [1e-3, 0.05, -0.02])
def test_newton_matrix_of_a_vector_like_mechanism(c):
    """A and W against differences of c f and Φ/c along v → (p = ψ + c v, a = (v - ψ_v)/c)."""
    model = pc.load("crank_rocker").model.copy()
    model.damping[:] = [0.3, 0.0, 1.2]
    model.upperDryFrictionLimit[:] = [0.0, 0.4, 0.0]
    model.armature[:] = [0.1, 0.0, 0.3]
    (loop,) = pc.load("crank_rocker").loops
    forces = [pc.Torque(spring, spring_gradient), np.array([1.0, 2.0, 3.0])]
    mech = pc.Mechanism(model, [loop], forces=forces)
    start = pc.assemble(pc.Mechanism(model, [loop]), {"crank": 0.7})
    system = MechanismSystem(mech, start.q)
    rng = np.random.default_rng(8)
    psi_v, t, v = rng.normal(size=3), 0.4, rng.normal(size=3)
    psi = start.q - c * v  # the loop is closed where the matrix is taken

    def residuals(v):
        f, phi, *_ = system.evaluate(t, psi + c * v, v, (v - psi_v) / c)
        return np.concatenate((c * f, phi / c))

    expected = differences(residuals, v, 1e-5)
    p, a = psi + c * v, (v - psi_v) / c
    A, W = newton_matrix(system, t, p, v, a, np.zeros(system.nc), c)
    np.testing.assert_allclose(A, expected[:3], atol=1e-7 * (1 + np.abs(A).max()))
    np.testing.assert_allclose(W, expected[3:], atol=1e-8 * (1 + np.abs(A).max()))


@pytest.mark.parametrize("kinds", [("frame",), ("point", "hinge"), ("point", "point"), ()])
def test_newton_matrix_on_a_manifold(kinds):
    """The same for every kind of joint, in the chart centred at the position (ξ = 0 there), with the loops closed."""
    model, rng, c, t = mixed_tree(), np.random.default_rng(9), 0.01, 0.0
    model.damping[:] = rng.uniform(0, 1, model.nv)
    base, v = random_state(model, rng)
    pairs = zip(kinds, PAIRS, strict=False)
    closed = [loop_open_by(model, base, kind, *pair, pin.SE3.Identity()) for kind, pair in pairs]
    mech = pc.Mechanism(model, closed, guess=base)
    system = MechanismSystem(mech, mech.guess)
    psi, psi_v = -c * v, rng.normal(size=model.nv)

    def residuals(v):
        p, _ = system.position(t, base, psi, c, v)
        f, phi, *_ = system.evaluate(t, p, v, (v - psi_v) / c)
        return np.concatenate((c * f, phi / c))

    expected = differences(residuals, v, 1e-4)
    a = (v - psi_v) / c
    A, W = newton_matrix(system, t, base, v, a, np.zeros(system.nc), c)
    np.testing.assert_allclose(A, expected[: model.nv], atol=1e-7 * (1 + np.abs(A).max()))
    np.testing.assert_allclose(W, expected[model.nv :], atol=1e-8 * (1 + np.abs(A).max()))


def test_chart_rate_is_the_derivative_of_the_chart():
    model, rng = mixed_tree(), np.random.default_rng(10)
    system = MechanismSystem(pc.Mechanism(model), pin.neutral(model))
    base, _ = random_state(model, rng)
    p, v = system.integrate(base, rng.uniform(-0.5, 0.5, model.nv)), rng.normal(size=model.nv)
    expected = differences(lambda s: system.difference(base, pin.integrate(model, p, s[0] * v)), np.zeros(1))[:, 0]
    np.testing.assert_allclose(chart_matrix(system, system.difference(base, p)) @ v, expected, atol=1e-9)


@pytest.mark.parametrize("turn", [1e-9, 3e-4, 1e-3, 0.1, 2.5])
def test_chart_rate_has_all_digits(turn):
    """T is the inverse of the mean of Ad exp(-s ξ) over 0 < s < 1; Pinocchio's dDifference is 5e-7 off near 1e-3."""
    model = pin.Model()
    model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "free")
    system = MechanismSystem(pc.Mechanism(model), pin.neutral(model))
    xi = np.array([0.3, -0.7, 0.5, *(turn * np.array([2.0, -1.0, 2.0]) / 3.0)])
    s, weights = np.polynomial.legendre.leggauss(12)
    actions = [pin.exp6(pin.Motion(-0.5 * (1.0 + x) * xi)).toActionMatrix() for x in s]
    mean = np.tensordot(0.5 * weights, actions, 1)
    np.testing.assert_allclose(chart_matrix(system, xi) @ mean, np.eye(6), atol=1e-12)


class Moving:
    """A made-up problem (2 positions, 2 velocities, 1 row) in which everything depends on everything."""

    def U(t, p, v):
        return np.array([v[0] + 0.3 * v[1] * np.sin(p[0] + t), (2 + np.cos(p[1])) * v[1] + 0.1 * t * v[0]])

    def F(t, p, v):
        return np.array([np.sin(t) * p[0] - v[1] ** 2, p[0] * p[1] + np.cos(v[0])])

    def G(t, p, v):
        return np.array([[p[0] + 0.1 * v[1]], [2 * p[1] + t]])

    def R(t, p):
        return np.array([p[0] ** 2 / 2 + p[1] ** 2 - np.sin(2 * t) * p[0] - 1])

    def R_p(t, p):
        return np.array([[p[0] - np.sin(2 * t), 2 * p[1]]])

    def R_t(t, p):
        return np.array([-2 * np.cos(2 * t) * p[0]])

    def U_p(t, p, v):
        return np.array([[0.3 * v[1] * np.cos(p[0] + t), 0], [0, -np.sin(p[1]) * v[1]]])

    def U_v(t, p, v):
        return np.array([[1, 0.3 * np.sin(p[0] + t)], [0.1 * t, 2 + np.cos(p[1])]])

    def gamma(t, p, v):
        """d(R_p U + R_t)/dt with v held."""
        U, (s, c) = Moving.U(t, p, v), (np.sin(2 * t), np.cos(2 * t))
        U_t = np.array([0.3 * v[1] * np.cos(p[0] + t), 0.1 * v[0]])
        R_pp, R_pt, R_tt = np.diag([1.0, 2.0]), np.array([-2 * c, 0.0]), 4 * s * p[0]
        R_p = Moving.R_p(t, p)[0]
        return np.array([U @ R_pp @ U + 2 * R_pt @ U + R_tt + R_p @ (U_t + Moving.U_p(t, p, v) @ U)])


DERIVATIVES = {
    "all": ("R_p", "R_t", "U_p", "U_v"),
    "no R_t": ("R_p", "U_p", "U_v"),
    "no R_p": ("U_p", "U_v"),
    "R_t alone": ("R_t",),
    "no U": ("R_p", "R_t"),
    "none": (),
}


@pytest.mark.parametrize("given", DERIVATIVES)
def test_hessenberg_problem_derivatives(given):
    """ρ, γ, W and A of the general form, with and without derivatives by the user."""
    t, p, v, a, c = 0.7, np.array([0.6, -0.8]), np.array([1.2, -0.5]), np.array([0.3, 0.9]), 0.03
    lam = np.array([13.0])
    functions = {name: getattr(Moving, name) for name in DERIVATIVES[given]}
    problem = pc.HessenbergProblem(Moving.U, Moving.F, Moving.G, Moving.R, **functions).at(t, p, v)
    rate = Moving.U(t, p, v)
    np.testing.assert_allclose(
        problem.constraint(t, p, rate)[1], Moving.R_p(t, p) @ rate + Moving.R_t(t, p), atol=1e-11
    )
    np.testing.assert_allclose(problem.acceleration_bias(t, p, v), Moving.gamma(t, p, v), atol=1e-9)
    psi, psi_v = p - c * rate, v - c * a

    def residuals(v):
        at, _ = problem.position(t, p, psi, c, v)
        np.testing.assert_allclose(at, psi + c * Moving.U(t, at, v), atol=1e-15)  # the implicit equation is solved
        f, phi, G, _ = problem.evaluate(t, at, v, (v - psi_v) / c)
        return np.concatenate((c * (f - G @ lam), phi / c))

    expected = differences(residuals, v)
    A, W = newton_matrix(problem, t, p, v, a, lam, c)
    np.testing.assert_allclose(A, expected[:2], atol=2e-7)
    np.testing.assert_allclose(W, expected[2:], atol=2e-7)


@pytest.mark.parametrize("speed", [1e3, 1e6])
@pytest.mark.parametrize("given", ["none", "all"])
def test_differences_stay_good_on_fast_motions(given, speed):
    """The spacing shrinks as the motion grows faster, or the points of a difference would lie far apart."""
    t, p, v = 0.7, np.array([0.6, -0.8]), speed * np.array([1.2, -0.5])
    functions = {name: getattr(Moving, name) for name in DERIVATIVES[given]}
    problem = pc.HessenbergProblem(Moving.U, Moving.F, Moving.G, Moving.R, **functions).at(t, p, v)
    rate = Moving.U(t, p, v)
    rho, gamma = problem.constraint(t, p, rate)[1], problem.acceleration_bias(t, p, v)
    np.testing.assert_allclose(rho, Moving.R_p(t, p) @ rate + Moving.R_t(t, p), rtol=1e-11)
    np.testing.assert_allclose(gamma, Moving.gamma(t, p, v), rtol=1e-9)
