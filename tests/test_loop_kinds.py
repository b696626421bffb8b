"""Every loop kind as a simulation: the same scene with a tree joint, motions in closed form, reduced equations."""

import pickle

import numpy as np
import pinocchio as pin
import pytest
from helpers.bodies import frame_pose, mixed_tree, random_state
from helpers.held_bodies import AXIS, AXIS2, JOINTS, LENGTH, E, as_loop, as_tree, free_state, joint_wrench, own_fields
from scipy.integrate import solve_ivp

import pinconsist as pc
from pinconsist.engine.systems import blank_system
from pinconsist.mechanism.loops import LOOP_KINDS
from pinconsist.mechanism.rows import KeptRows, LoopRows

TIGHT = {"rtol": 1e-9, "atol": 1e-9}
G = 9.81


@pytest.mark.parametrize("kind", JOINTS)
def test_loop_moves_its_body_as_the_tree_joint_does(kind):
    """A free body held to a swinging arm by a loop against the same body on tree joints: motion and reaction."""
    tree, rng, times = as_tree(kind), np.random.default_rng(1), np.linspace(0.0, 0.5, 6)
    q = pin.integrate(tree.model, pin.neutral(tree.model), rng.uniform(-0.4, 0.4, tree.nv))
    v = rng.uniform(-2.0, 2.0, tree.nv)
    q0, v0 = free_state(tree, q, v)
    loop = as_loop(kind)
    assembly = pc.assemble(loop, q0, v0)
    assert assembly.rank == assembly.rows == len(loop.loops[0].rows) and assembly.mobility == tree.nv
    assert assembly.moved < 1e-12 and np.abs(assembly.v - v0).max() < 1e-11
    sol = pc.simulate(loop, (0.0, 0.5), q0, v0, t_eval=times, **TIGHT)
    reference = pc.simulate(tree, (0.0, 0.5), q, v, t_eval=times, **TIGHT)
    assert sol.success and reference.success
    reaction = sol.reaction("held")
    for i in range(len(times)):
        q, v = free_state(tree, reference.q[i], reference.v[i])
        gap = frame_pose(loop.model, sol.q[i], "body_end").actInv(frame_pose(tree.model, reference.q[i], "body"))
        assert np.abs(pin.log6(gap).vector).max() < 1e-7 and abs(sol.q[i, 0] - q[0]) < 1e-7
        np.testing.assert_allclose(sol.v[i], v, atol=1e-6)
        force, moment = joint_wrench(tree, reference.q[i], reference.v[i])
        np.testing.assert_allclose(reaction.force[i], force, atol=1e-6 * 9.81 * 1.3)
        np.testing.assert_allclose(reaction.moment[i], moment, atol=1e-6 * 9.81 * 1.3)


def rotor(kind, world_axis, **fields):
    """A free body whose anchor is its centre of mass, held to the ground by axes that are oblique in every frame."""
    model = pin.Model()
    free = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    inertia = pin.Inertia(2.0, np.zeros(3), np.diag([0.3, 0.3, 0.3]))
    model.appendBodyToJoint(free, inertia, pin.SE3.Identity())
    model.addFrame(pin.Frame("end", free, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    rpy = (0.4, -0.3, 0.9)
    axis = tuple(pin.rpy.rpyToMatrix(*rpy).T @ world_axis)
    return pc.Mechanism(model, [pc.Loop("held", kind, "universe", "end", rpy1=rpy, rpy2=rpy, axis=axis, **fields)])


@pytest.mark.parametrize("kind", ["hinge", "cylinder", "plane"])
def test_turns_without_end_about_its_axis(kind):
    """Twelve turns: the axis is held, the angle about it is free (and no logarithm may wrap)."""
    mech, spin = rotor(kind, np.array([0.0, 0.0, 1.0])), 37.0
    push = 0.5 if kind == "plane" else 0.0
    sol = pc.simulate(mech, (0.0, 2.0), None, [push, 0, 0, 0, 0, spin], rtol=1e-11, atol=1e-11)
    assert sol.success and np.abs(sol.v[:, 5] - spin).max() < 1e-7
    fall = -0.5 * G * sol.t**2 if kind == "cylinder" else 0 * sol.t
    np.testing.assert_allclose(sol.q[:, :3], np.column_stack((push * sol.t, 0 * sol.t, fall)), atol=1e-7)
    half = np.array([np.arctan2(q[5], q[6]) for q in sol.q])
    np.testing.assert_allclose(np.sin(half - 0.5 * spin * sol.t), 0, atol=1e-7)
    weight = 0.0 if kind == "cylinder" else 2.0 * G
    np.testing.assert_allclose(sol.reaction("held").force, [[0, 0, weight]] * len(sol.t), atol=1e-6)
    assert np.abs(sol.reaction("held").moment).max() < 1e-6


def test_slides_down_an_incline():
    axis = np.array([np.cos(0.6), 0.0, -np.sin(0.6)])
    sol = pc.simulate(rotor("slider", axis), (0.0, 1.5), **TIGHT)
    np.testing.assert_allclose(sol.q[:, :3], np.outer(0.5 * G * np.sin(0.6) * sol.t**2, axis), atol=1e-8)
    force = 2.0 * G * np.cos(0.6) * np.array([np.sin(0.6), 0, np.cos(0.6)])
    np.testing.assert_allclose(sol.reaction("held").force, [force] * len(sol.t), atol=1e-6)


@pytest.mark.parametrize("kind", ["slider", "cylinder", "plane", "universal"])
def test_closes_from_far_away_and_never_upside_down(kind):
    """From random guesses; axes that end antiparallel would be a false solution."""
    mech, rng = as_loop(kind), np.random.default_rng(3)
    for _ in range(10):
        guess = pin.integrate(mech.model, pin.neutral(mech.model), rng.uniform(-3, 3, mech.nv))
        assembly = pc.assemble(mech, guess)
        loop, q = mech.loops[0], assembly.q
        gap = (frame_pose(mech.model, q, "arm_end") * loop.placement1).actInv(
            frame_pose(mech.model, q, "body_end") * loop.placement2
        )
        a = gap.rotation @ AXIS2 / np.linalg.norm(AXIS2) if kind == "universal" else gap.rotation @ E
        assert E @ a == pytest.approx(0.0 if kind == "universal" else 1.0, abs=1e-9)
        off = {"slider": np.cross(E, gap.translation), "cylinder": np.cross(E, gap.translation)}
        off |= {"plane": E @ gap.translation, "universal": gap.translation}
        assert np.abs(off[kind]).max() < 1e-9


@pytest.mark.parametrize(
    "kind", [each for each in LOOP_KINDS.values() if each.free is not None], ids=lambda kind: kind.name
)
def test_motions_that_a_kind_leaves_free_keep_it_closed(kind):
    """One at a time, and all others open it."""
    axes = {"axis": (2.0, 0.0, 0.0), "axis2": (0.0, 3.0, 0.0)}
    loop = pc.Loop("held", kind.name, "universe", "end", **{field: axes[field] for field in kind.fields})
    model = rotor("hinge", E).model
    assert len(kind.rows) + len(kind.free) == 6
    for k, direction in enumerate(("transX", "transY", "transZ", "rotX", "rotY", "rotZ")):
        motion = pin.exp6(pin.Motion(0.3 * (np.arange(6) == k)))
        phi = LoopRows(model, [loop]).at(pin.SE3ToXYZQUAT(motion))[0]
        assert (np.abs(phi).max() < 1e-14) == (direction in kind.free), direction


def two_bodies(gap):
    """Two masses on rails 0.3 m apart that a loop cannot bring together."""
    model = pin.Model()
    for name, place in (("left", pin.SE3.Identity()), ("right", gap)):
        joint = model.addJoint(0, pin.JointModelPX(), place, name)
        model.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Identity())
        model.addFrame(pin.Frame(f"{name}_end", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    return model


@pytest.mark.parametrize("kind", JOINTS)
def test_reanchoring_moves_only_what_the_loop_holds(kind):
    gap = pin.SE3(pin.exp3(np.array([0.2, -0.3, 0.25])), np.array([0.1, 0.3, -0.2]))
    loop = pc.Loop("held", kind, "left_end", "right_end", **own_fields(kind, AXIS, AXIS2, 0.1))
    mech = pc.Mechanism(two_bodies(gap), [loop])
    with pytest.raises(pc.AssemblyError, match=r"'held'.* cannot close|loops cannot close.*'held'"):
        pc.assemble(mech.with_loops(loop, pc.Loop("rails", "frame", "universe", "left_end")))
    with pytest.warns(UserWarning, match="'held'"):
        moved = mech.reanchored()
    q = pc.assemble(moved).q
    new = moved.loops[0]
    shift = loop.placement2.inverse() * new.placement2
    before = frame_pose(mech.model, q, "left_end").actInv(frame_pose(mech.model, q, "right_end"))
    d, across = before.translation, before.rotation @ shift.translation
    parallel = {"slider": 0.0, "cylinder": 0.0, "plane": 1.0}.get(kind)
    if parallel == 0.0:  # no shift along the axis, in which the loop is free
        assert abs(E @ across) < 1e-9
    if parallel == 1.0:
        assert np.abs(np.cross(E, across)).max() < 1e-9 and abs(E @ (d + across)) < 1e-9
    if kind in ("hinge", "cylinder", "plane", "universal"):  # the least turn: nothing about the axis itself
        turn = pin.log3(before.rotation @ shift.rotation @ before.rotation.T)
        a = before.rotation @ (np.array(AXIS2) / np.linalg.norm(AXIS2) if kind == "universal" else E)
        assert abs(turn @ a) < 1e-9 and np.linalg.norm(turn) > 1e-3
    assert pc.assemble(moved).largest_gap[1] < 1e-10


# --- couplings ---------------------------------------------------------------------------------------------------


def wheels(first, second, inertias=(0.5, 0.2)):
    model = pin.Model()
    for name, joint, inertia in (("pinion", first, inertias[0]), ("wheel", second, inertias[1])):
        index = model.addJoint(0, joint, pin.SE3.Identity(), name)
        model.appendBodyToJoint(index, pin.Inertia(inertia, np.zeros(3), np.eye(3) * inertia), pin.SE3.Identity())
    return model


REVOLUTE, UNBOUNDED, SLIDING = pin.JointModelRZ(), pin.JointModelRUBZ(), pin.JointModelPX()
PAIRS = {
    "gears": (REVOLUTE, REVOLUTE, -3.7),
    "unbounded follows": (UNBOUNDED, REVOLUTE, -3.7),
    "unbounded leads": (REVOLUTE, UNBOUNDED, 0.37),
    "unbounded both, up": (UNBOUNDED, UNBOUNDED, -3.0),
    "unbounded both, down": (UNBOUNDED, UNBOUNDED, 1.0 / 49.0),
    "rack on pinion": (SLIDING, REVOLUTE, 0.05),
    "rack on unbounded": (SLIDING, UNBOUNDED, 0.05),
}


@pytest.mark.parametrize("pair", PAIRS)
def test_gear_pair_has_the_reduced_motion(pair):
    """τ on the wheel; one degree of freedom by hand, over several turns and so across every wrap."""
    (first, second, ratio), torque, offset = PAIRS[pair], 1.7, 0.3
    gear = pc.Coupling("gear", "pinion", "wheel", ratio, offset)
    mech = pc.Mechanism(wheels(first, second), [gear], [{"wheel": torque}])
    acceleration = torque / (0.2 + ratio**2 * 0.5)
    q0 = {"wheel": 0.1, "pinion": offset + 0.1 * ratio}
    sol = pc.simulate(mech, (0.0, np.sqrt(30 / acceleration)), q0, {"wheel": 0.5}, rtol=1e-8, atol=1e-8)
    angle = 0.1 + 0.5 * sol.t + 0.5 * acceleration * sol.t**2
    assert sol.success and angle[-1] - angle[0] > 2 * np.pi
    for joint, expected in (("wheel", angle), ("pinion", offset + ratio * angle)):
        start = mech.model.idx_qs[index := mech.joint_index(joint)]
        if mech.model.nqs[index] == 2:
            np.testing.assert_allclose(sol.q[:, start : start + 2].T, [np.cos(expected), np.sin(expected)], atol=1e-6)
        else:
            np.testing.assert_allclose(sol.q[:, start], expected, atol=1e-6)
    np.testing.assert_allclose(sol.lam[:, 0], 0.5 * ratio * acceleration, atol=1e-5 * torque)  # on the pinion
    reaction = sol.reaction("gear")
    assert reaction.force is None and reaction.moment is None
    np.testing.assert_allclose(reaction.torque, sol.lam[:, 0], atol=0)
    np.testing.assert_allclose(reaction.joint_forces, np.outer(reaction.torque, [1.0, -ratio]), atol=1e-12)


def test_cam_of_higher_degree_against_its_reduced_equation():
    """s = 0.05 + 0.1 φ - 0.2 φ² + 0.06 φ³ lifts a mass: one equation for φ, by scipy."""
    model, m, inertia = wheels(pin.JointModelPZ(), REVOLUTE), 0.5, 0.2
    coupling = pc.Coupling("cam", "pinion", "wheel", 0.1, 0.05, (-0.2, 0.06))
    law = np.polynomial.Polynomial([0.05, 0.1, -0.2, 0.06])
    slope, bend = law.deriv(), law.deriv(2)

    def reduced(t, y):
        phi, w = y
        return w, -m * slope(phi) * (bend(phi) * w**2 + G) / (inertia + m * slope(phi) ** 2)

    sol = pc.simulate(pc.Mechanism(model, [coupling]), (0.0, 2.0), {"wheel": 0.4}, {"wheel": 1.5}, **TIGHT)
    reference = solve_ivp(reduced, (0.0, 2.0), [sol.q[0, 1], 1.5], "DOP853", t_eval=sol.t, rtol=1e-12, atol=1e-12)
    phi, w = reference.y
    np.testing.assert_allclose(sol.q[:, 1], phi, atol=1e-7)
    np.testing.assert_allclose(sol.q[:, 0], law(phi), atol=1e-7)
    lift = slope(phi) * reduced(0, (phi, w))[1] + bend(phi) * w**2
    np.testing.assert_allclose(sol.lam[:, 0], m * (lift + G), atol=2e-6)
    assert sol.check(error=False).force < 1e-5 and sol.energy().balance_error < 1e-7


COUPLINGS = {
    "itself": (lambda: pc.Coupling("gear", "a", "a"), "gear.*'a' cannot follow itself"),
    "name": (lambda: pc.Coupling("gear", "a", 3), "coupling 'gear': other must be a name, got 3"),
    "ratio": (lambda: pc.Coupling("gear", "a", "b", float("nan")), "ratio has a number that is not finite: nan"),
    "ratio text": (lambda: pc.Coupling("gear", "a", "b", "2"), "ratio must be a number, got '2'"),
    "higher": (lambda: pc.Coupling("gear", "a", "b", higher=2.0), "higher must be a sequence of numbers, got 2.0"),
    "higher NaN": (
        lambda: pc.Coupling("gear", "a", "b", higher=(1, float("inf"))),
        "higher has a number that is not finite",
    ),
    "joint": (
        lambda: pc.Mechanism(mixed_tree(), [pc.Coupling("gear", "hinge", "slid")]),
        "coupling 'gear': the model has no joint 'slid'; similar: slide",
    ),
    "ball": (
        lambda: pc.Mechanism(mixed_tree(), [pc.Coupling("gear", "ball", "slide")]),
        "joint 'ball' has 3 degrees of freedom; only joints with one can be coupled",
    ),
    "both wrap": (
        lambda: pc.Mechanism(wheels(UNBOUNDED, UNBOUNDED), [pc.Coupling("gear", "pinion", "wheel", 17 / 31)]),
        "ratio 0.548387 is neither a whole.*plain revolute joint",
    ),
    "powers of a wrapped angle": (
        lambda: pc.Mechanism(wheels(REVOLUTE, UNBOUNDED), [pc.Coupling("cam", "pinion", "wheel", higher=(0.1,))]),
        "'wheel' stores cosine and sine.*powers are not unique",
    ),
}


@pytest.mark.parametrize("case", COUPLINGS)
def test_bad_couplings_are_named(case):
    call, message = COUPLINGS[case]
    with pytest.raises(pc.InputError, match=message):
        call()


def test_couplings_that_contradict_each_other_do_not_close():
    model = wheels(REVOLUTE, REVOLUTE)
    pair = [pc.Coupling("up", "pinion", "wheel", 2.0), pc.Coupling("down", "pinion", "wheel", 2.0, 0.5)]
    with pytest.raises(pc.AssemblyError, match="'up'"):
        pc.assemble(pc.Mechanism(model, pair))


# --- a user's own Φ ----------------------------------------------------------------------------------------------

K = 1.4  # 1/m, of the parabola
A, OMEGA = 0.1, 3.0  # its shaking, m and rad/s


def parabola(t, q):
    return [q[1] - 0.5 * K * q[0] ** 2]


def parabola_jacobian(t, q):
    return [[-K * q[0], 1.0]]


def shaken(t, q):
    return [q[1] - 0.5 * K * q[0] ** 2 - A * np.sin(OMEGA * t)]


def shaken_rate(t, q):
    return [-A * OMEGA * np.cos(OMEGA * t)]


def bead(**fields):
    """A bead of 0.8 kg in the x-z plane."""
    model = pin.Model()
    slide = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "x")
    bead = model.addJoint(slide, pin.JointModelPZ(), pin.SE3.Identity(), "z")
    model.appendBodyToJoint(bead, pin.Inertia(0.8, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
    return pc.Mechanism(model, [pc.Constraint("wire", size=1, **fields)])


BEADS = {
    "wire": {"function": parabola},
    "wire, still": {"function": parabola, "moving": False},
    "wire with J": {"function": parabola, "jacobian": parabola_jacobian},
    "wire with J, still": {"function": parabola, "jacobian": parabola_jacobian, "moving": False},
    "shaken": {"function": shaken},
    "shaken with J": {"function": shaken, "jacobian": parabola_jacobian},
    "shaken with rate": {"function": shaken, "rate": shaken_rate},
    "shaken with both": {"function": shaken, "jacobian": parabola_jacobian, "rate": shaken_rate},
}


@pytest.mark.parametrize("given", BEADS)
def test_bead_on_a_wire_of_ones_own(given):
    """(1 + k²x²) ẍ + k² x ẋ² + (g + s̈) k x = 0 by scipy, where s is the wire's shaking; λ = m (z̈ + g)."""
    amplitude = A if "shaken" in given else 0.0

    def reduced(t, y):
        x, u = y
        lift = -amplitude * OMEGA**2 * np.sin(OMEGA * t)
        return u, -K * x * (K * u**2 + G + lift) / (1 + K**2 * x**2)

    sol = pc.simulate(bead(**BEADS[given]), (0.0, 0.8), {"x": 0.9, "z": 0.5}, {"x": -0.7}, **TIGHT)
    x0, u0 = sol.q[0, 0], -0.7
    reference = solve_ivp(reduced, (0.0, 0.8), [x0, u0], "DOP853", t_eval=sol.t, rtol=1e-12, atol=1e-12)
    x, u = reference.y
    assert sol.success and x0 == pytest.approx(0.9, abs=0.2)
    np.testing.assert_allclose(sol.q[:, 0], x, atol=1e-7)
    z_rate = K * x * u + amplitude * OMEGA * np.cos(OMEGA * sol.t)
    np.testing.assert_allclose(sol.v, np.column_stack((u, z_rate)), atol=1e-6)
    bend = K * u**2 + K * x * reduced(sol.t, (x, u))[1] - amplitude * OMEGA**2 * np.sin(OMEGA * sol.t)
    np.testing.assert_allclose(sol.lam[:, 0], 0.8 * (G + bend), atol=1e-5)
    assert sol.check(error=False).position < 1e-9 and sol.energy().balance_error < 1e-5
    joint_forces = sol.reaction("wire").joint_forces
    np.testing.assert_allclose(joint_forces, sol.lam * np.column_stack((-K * sol.q[:, 0], 0 * x + 1)), atol=1e-9)


class HeldDistance:
    """The `distance` kind as a user would write it, on a free body: (|p|² - L²)/(2 L) of the anchors' positions."""

    def __init__(self, mech):
        self.model, self.loop = mech.model, mech.loops[0]

    def __call__(self, t, q):
        ends = (frame_pose(self.model, q, "arm_end") * self.loop.placement1).actInv(
            frame_pose(self.model, q, "body_end") * self.loop.placement2
        )
        return [(ends.translation @ ends.translation - LENGTH**2) / (2 * LENGTH)]


def test_ones_own_constraint_on_a_manifold_is_the_built_in_kind():
    mech = as_loop("distance")
    own = mech.with_loops(pc.Constraint("held", HeldDistance(mech), 1, moving=False))
    rng = np.random.default_rng(4)
    start = pc.assemble(mech, pin.integrate(mech.model, pin.neutral(mech.model), rng.uniform(-0.5, 0.5, mech.nv)))
    times = np.linspace(0.0, 0.1, 3)
    options = {"rtol": 1e-8, "atol": 1e-8, "t_eval": times}
    sol, reference = (pc.simulate(each, (0.0, 0.1), start.q, {"arm": 2.0}, **options) for each in (own, mech))
    np.testing.assert_allclose(sol.q, reference.q, atol=1e-9)
    np.testing.assert_allclose(sol.lam, reference.lam, atol=1e-7)


def test_difference_quotients_do_not_make_steps_small(caplog):
    """Where rounding in J is as large as the tolerance, steps had to pass by chance: 3000 of them and more."""
    mech = as_loop("distance")
    own = mech.with_loops(pc.Constraint("held", HeldDistance(mech), 1, moving=False))
    start = pc.assemble(mech)
    exact, sol = (
        pc.simulate(each, (0.0, 0.1), start.q, {"arm": 2.0}, rtol=1e-10, atol=1e-12, max_steps=300, method="BDF")
        for each in (mech, own)
    )
    assert sol.success and sol.nsteps < 1.5 * exact.nsteps
    assert "without a jacobian give about 4e-10; pass one, or use method='Radau'" in caplog.text
    np.testing.assert_allclose(sol.q[-1], exact.q[-1], atol=1e-9)
    np.testing.assert_allclose(sol.v[-1], exact.v[-1], rtol=0, atol=4e-9 * np.abs(exact.v).max())


@pytest.mark.parametrize("given", ["function", "function, jacobian and rate"])
def test_derivatives_of_ones_own_constraint(given):
    """J, Φ_t and the bias against differences taken here, for joints on manifolds too."""
    model, t = mixed_tree(), 0.7
    q, v = random_state(model, np.random.default_rng(5))

    def phi(t, q):
        p = frame_pose(model, q, "wheel").translation
        return np.array([p @ p * np.cos(2 * t), np.sin(p[0] + t) - 0.3 * p[2]])

    def evaluate(rows, t, q):
        return rows.at(q, t)

    def central(f, step=1e-4):
        return (f(-2 * step) - 8 * f(-step) + 8 * f(step) - f(2 * step)) / (12 * step)

    rows = plain = LoopRows(model, [pc.Constraint("own", phi, 2, rows=("size", "wave"))])
    assert rows.labels == [("own", "size"), ("own", "wave")]
    if "rate" in given:
        own = pc.Constraint("own", phi, 2, lambda t, q: evaluate(plain, t, q)[1], rate=plain.time_rate)
        rows = LoopRows(model, [own])
    value, J = evaluate(rows, t, q)
    np.testing.assert_allclose(value, phi(t, q), atol=0)
    by_q = [central(lambda s, e=e: phi(t, pin.integrate(model, q, s * e))) for e in np.eye(model.nv)]
    np.testing.assert_allclose(J, np.column_stack(by_q), atol=1e-9)
    np.testing.assert_allclose(rows.time_rate(t, q), central(lambda s: phi(t + s, q)), atol=1e-9)

    def velocity(s):
        there = pin.integrate(model, q, s * v)
        return evaluate(rows, t + s, there)[1] @ v + rows.time_rate(t + s, there)

    bias = rows.acceleration_bias(t, q, v)
    np.testing.assert_allclose(bias, central(velocity), atol=1e-7)


def test_multiplier_of_a_constraint_that_moves_has_full_order_from_the_first_step():
    """Fixed steps of BDF-3, no derivatives given; the wire starts in mid-motion."""
    errors = []
    for step in (1 / 100, 1 / 200):
        sol = pc.simulate(bead(function=shaken), (0.4, 1.4), {"x": 0.9}, {"x": -0.7}, step=step, order=3, method="BDF")
        x, u = sol.q[:, 0], sol.v[:, 0]
        lift = -A * OMEGA**2 * np.sin(OMEGA * sol.t)
        bend = K * u**2 - K * x * K * x * (K * u**2 + G + lift) / (1 + K**2 * x**2) + lift
        errors.append(np.abs(sol.lam[:, 0] - 0.8 * (G + bend)).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(3.0, abs=0.3)


def raising(t, q):
    raise ZeroDivisionError("no wire")


OWN = {
    "function": (lambda: pc.Constraint("wire", 3, 1), "constraint 'wire': function must be a function of"),
    "jacobian": (lambda: pc.Constraint("wire", parabola, 1, jacobian=1), "jacobian must be a function of"),
    "size": (lambda: pc.Constraint("wire", parabola, 0), "size must be a positive whole number, got 0"),
    "rows": (lambda: pc.Constraint("wire", parabola, 1, rows=("a", "b")), "rows needs 1 names"),
    "step": (lambda: pc.Constraint("wire", parabola, 1, step=-1.0), "step must be greater than 0, got -1"),
    "rate at rest": (
        lambda: pc.Constraint("wire", shaken, 1, rate=shaken_rate, moving=False),
        "contradicts moving=False",
    ),
    "wrong size": (lambda: pc.assemble(bead(function=lambda t, q: q)), r"'wire'.* shape \(2,\) at t = 0; it must ret"),
    "NaN": (lambda: pc.assemble(bead(function=lambda t, q: [np.nan])), "'wire': its function.*not finite at t = 0"),
    "text": (
        lambda: pc.assemble(bead(function=lambda t, q: ["a"])),
        "'wire': its function did not return real numbers",
    ),
    "complex": (lambda: pc.assemble(bead(function=lambda t, q: 1j * q[:1])), "'wire'.*did not return real numbers"),
    "ragged": (lambda: pc.assemble(bead(function=lambda t, q: [[1], [2, 3]])), "'wire'.*did not return real numbers"),
    "J": (
        lambda: pc.assemble(bead(function=parabola, jacobian=lambda t, q: q)),
        r"'wire': its jacobian.*must return \(1, 2\), one column for each joint velocity",
    ),
    "promise": (lambda: pc.simulate(bead(function=shaken, moving=False), (0.0, 1.0)), "moving=False, but Φ changes"),
}


@pytest.mark.parametrize("case", OWN)
def test_bad_constraints_of_ones_own_are_named(case):
    call, message = OWN[case]
    with pytest.raises(pc.InputError, match=message):
        call()


def test_an_exception_in_ones_own_constraint_is_told_with_its_cause():
    with pytest.raises(
        pc.UserFunctionError, match="constraint 'wire': its function raised ZeroDivisionError"
    ) as caught:
        pc.simulate(bead(function=raising), (0.0, 1.0))
    assert isinstance(caught.value.__cause__, ZeroDivisionError)


def test_functions_get_arrays_that_they_cannot_change():
    with pytest.raises(pc.UserFunctionError, match="read-only"):
        pc.assemble(bead(function=lambda t, q: q.fill(0.0)))


# --- all of them together ----------------------------------------------------------------------------------------


def everything():
    """A tree with all kinds of joints and all kinds of records among its loops, in no particular order."""
    model, rng = mixed_tree(), np.random.default_rng(6)
    q, v = random_state(model, rng)
    records = [
        pc.Loop("rod", "distance", "arm", "puck", length=0.8),
        pc.Loop("ball", "point", "arm", "wheel"),
        pc.Coupling("gear", "hinge", "turn", 2.0, 0.1),
        pc.Loop("pin", "hinge", "raft", "puck", axis=AXIS),
        pc.Loop("weld", "frame", "raft", "arm0"),
        pc.Constraint("own", _own, 1, moving=False),
        pc.Loop("cross", "universal", "arm", "universe", axis=AXIS, axis2=AXIS2),
        pc.Drive("motor", "slide", np.sin, np.cos),
        pc.Loop("rail", "slider", "universe", "wheel", axis=(0, 0, 1)),
        pc.Loop("table", "plane", "puck", "arm", axis=(0, 1, 0)),
        pc.Loop("post", "cylinder", "arm0", "puck", axis=AXIS),
    ]
    return pc.Mechanism(model, records, guess=q), q, v


def _own(t, q):
    return [q[0] ** 2 + np.sin(q[1])]


def test_fast_and_exact_rows_stand_in_their_order():
    """Where the rows are those of d, or no anchor has any, KeptRows and LoopRows agree also while loops are open."""
    mech, q, _ = everything()
    rows, rng = LoopRows(mech.model, mech.loops), np.random.default_rng(7)
    phi, J = rows.at(q, 0.3)
    open_too = [i for i, (_, row) in enumerate(rows.labels) if row[:4] not in ("tilt", "rx", "ry", "rz")]
    for _ in range(30):
        kept = np.sort(rng.choice(open_too, rng.integers(1, len(open_too) + 1), replace=False))
        compiled = blank_system(mech.model)
        KeptRows(rows, kept).hand_over(compiled)
        own_phi, own_J = compiled.rows(q, 0.3)
        np.testing.assert_allclose(own_phi, phi[kept], atol=1e-13)
        np.testing.assert_allclose(own_J, J[kept], atol=1e-13)


def test_every_record_pickles_with_its_mechanism():
    mech, q, v = everything()
    copy = pickle.loads(pickle.dumps(mech))
    assert [loop.name for loop in copy.loops] == [loop.name for loop in mech.loops]
    assert copy.row_labels == mech.row_labels and copy.nc == mech.nc == 34
    for one, other in zip(*(_rows_at(each, q, v) for each in (mech, copy)), strict=True):
        np.testing.assert_array_equal(one, other)
    assert [loop.kind for loop in mech.anchored_loops] == [
        "distance", "point", "hinge", "frame", "universal", "slider", "plane", "cylinder",
    ]  # fmt: skip


def _rows_at(mech, q, v):
    rows = LoopRows(mech.model, mech.loops)
    return *rows.at(q, 0.2), rows.time_rate(0.2, q), rows.acceleration_bias(0.2, q, v)


AXES = {
    "slider": (lambda: pc.Loop("rail", "slider", "a"), "loop 'rail': a slider needs its axis"),
    "cylinder": (lambda: pc.Loop("rail", "cylinder", "a"), "a cylinder needs its axis"),
    "plane": (lambda: pc.Loop("table", "plane", "a", axis=(0, 0, 0)), "the plane axis is the zero vector"),
    "universal": (lambda: pc.Loop("cross", "universal", "a", axis=(1, 0, 0)), "needs its axis2"),
    "axis2": (lambda: pc.Loop("cross", "universal", "a", axis=(1, 0, 0), axis2=(0, 0, 0)), "universal axis2 is the"),
    "axis2 text": (
        lambda: pc.Loop("c", "universal", "a", axis=(1, 0, 0), axis2="x"),
        "axis2 must be a sequence of numbers",
    ),
}


@pytest.mark.parametrize("case", AXES)
def test_missing_axes_are_named(case):
    call, message = AXES[case]
    with pytest.raises(pc.InputError, match=message):
        call()


def test_whether_ones_own_constraint_moves_is_seen_unless_it_is_said():
    def at_time(*state):
        return [state[1][0] - state[0]]

    still = pc.Constraint("own", lambda t, q: [q[0]], 1)
    assert not still.moving
    assert pc.Constraint("own", lambda t, q: [q[0] - t], 1).moving
    assert pc.Constraint("own", at_time, 1).moving
    assert pc.Constraint("own", lambda t, q: [q[0]], 1, moving=True).moving
    assert pc.Constraint("own", lambda t, q: [q[0]], 1, rate=lambda t, q: [0.0]).moving


@pytest.mark.parametrize(
    "given",
    [
        (
            "jacobian",
            lambda t, q: [[2.0, 0.0, 0.0]],
            r"column 0 of its jacobian is \[2\.\], which is not the derivative .* \[1\.\]",
        ),
        ("jacobian", lambda t, q: [[1.0, 1e-2, 0.0]], "column 1 of its jacobian is"),
        (
            "rate",
            lambda t, q: [1.0],
            r"rate at t = 0 is \[1\.\], which is not the derivative .* differences give \[-1\.\]",
        ),
    ],
)
def test_derivatives_of_ones_own_constraint_that_are_wrong_are_refused(given):
    field, function, message = given
    linkage = pc.load("four_bar")
    own = pc.Constraint("own", lambda t, q: [q[0] + 1.0 - t], 1, **{field: function})
    with pytest.raises(pc.InputError, match=message):
        pc.simulate(linkage.add_loops(own), (0.0, 0.1))
