"""Equilibria, linearisations, modes and inverse dynamics, against closed forms, hand calculation and scipy."""

import pickle

import numpy as np
import pinocchio as pin
import pytest
from helpers import scenes, zoo
from scipy.optimize import brentq

import pinconsist as pc
from pinconsist.mechanism.system import MechanismSystem
from pinconsist.paper.index1 import acceleration

G = 9.81


def slider(*masses):
    """Sliders one after the other along a vertical line; q are their distances."""
    model, last = pin.Model(), 0
    for i, mass in enumerate(masses):
        last = scenes.add_body(model, last, pin.JointModelPZ(), scenes.at(0, 0), f"z{i}", mass, (0, 0, 0), 0.1)
    return model


def differences(function, x, step=1e-3):
    """Sixth-order central differences, columns."""
    columns = []
    for unit in np.eye(len(x)):
        f = {i: function(x + i * step * unit) for i in (-3, -2, -1, 1, 2, 3)}
        columns.append((45 * (f[1] - f[-1]) - 9 * (f[2] - f[-2]) + (f[3] - f[-3])) / (60 * step))
    return np.column_stack(columns)


# --- equilibrium


def test_a_pendulum_hangs_and_stands():
    mech = pc.load("planar_pendulum")
    hanging = pc.equilibrium(mech)
    assert hanging.q[0] == pytest.approx(np.pi / 2, abs=1e-14) and hanging.stable and not hanging.neutral
    np.testing.assert_allclose(hanging.stiffness, [G / 2])
    with pytest.raises(ValueError, match="read-only"):
        hanging.q[0] = 0.0
    upright = pc.equilibrium(mech, {"pendulum": -1.3}, stable=False)
    assert upright.q[0] == pytest.approx(-np.pi / 2, abs=1e-14) and not upright.stable
    np.testing.assert_allclose(upright.stiffness, [-G / 2])
    assert "unstable" in str(upright) and "stable equilibrium, smallest stiffness 4.905" in str(hanging)
    left = pc.equilibrium(mech, upright.q)  # a start that balances, but would not stay
    assert left.stable and np.sin(left.q[0]) == pytest.approx(1.0)
    assert pickle.loads(pickle.dumps(left)).q == left.q


def test_a_constant_torque_lifts_a_pendulum():
    for torque in (1.0, 4.0, 4.9):
        found = pc.equilibrium(pc.load("planar_pendulum"), forces=[{"pendulum": -torque}])
        assert np.cos(found.q[0]) == pytest.approx(torque / (G / 2), abs=1e-12) and found.stable
    with pytest.raises(pc.EquilibriumError, match=r"pendulum.*spring") as caught:  # more than the weight can hold
        pc.equilibrium(pc.load("planar_pendulum"), forces=[{"pendulum": -5.0}])
    assert caught.value.names == ("pendulum",) and caught.value.residual > 0.09 and caught.value.q.shape == (1,)


def chain_by_hand(n, span):
    """(angles below the horizontal, pull) of n rods of 1 m and 1 kg that hang between two points `span` apart.

    The horizontal pull H is the same everywhere, the vertical force falls by a weight a rod; a rod points along the
    mean of the forces at its ends.
    """
    upright = G * (n / 2 - 0.5 - np.arange(n))

    def excess(pull):
        return np.sum(pull / np.hypot(pull, upright)) - span

    pull = brentq(excess, 1e-6, 1e4, xtol=1e-13)
    return np.arctan2(upright, pull), pull


@pytest.mark.parametrize("n", [3, 4, 9, 30])
def test_a_hanging_chain(n):
    angles, pull = chain_by_hand(n, 0.6 * n)
    found = pc.equilibrium(pc.load(f"chain_{n}"))
    np.testing.assert_allclose(np.cumsum(found.q), angles, atol=1e-11)
    assert found.stable and len(found.stiffness) == n - 2
    force = found.reaction("end").force[0]  # on body 2, the ground: it is drawn inwards and down
    np.testing.assert_allclose(force, [-pull, 0, -n * G / 2], atol=1e-10 * n * G)
    np.testing.assert_allclose(found.reaction("end").moment, 0, atol=1e-10 * n * G)


def test_a_ring_of_rods_stands_by_a_drive():
    """A four-bar whose crank is held: the motor carries the slope of the weight's energy along the crank's motion."""
    plain, angle = pc.load("four_bar"), -0.7
    held = plain.add_loops(pc.Drive("hold", "crank", lambda t: angle + t))
    found = pc.equilibrium(held, t=0.2)
    assert found.q[0] == pytest.approx(-0.5, abs=1e-15) and len(found.stiffness) == 0 and found.stable
    assert str(found).startswith("rigid")
    linkage = zoo.FourBar()

    def weight(crank):
        x = follow(linkage, linkage.T @ found.q, crank)
        return linkage.bias(x, np.zeros(3)) @ leverage(linkage, x)

    assert found.reaction("hold").torque[0] == pytest.approx(weight(-0.5), rel=1e-12)


def follow(linkage, x, crank):
    """Absolute angles of a linkage of :mod:`zoo` at a crank angle, on the branch of x."""
    x = np.array(x)
    x[0] = crank
    for _ in range(30):
        x[1:] -= np.linalg.solve(linkage.jacobian(x)[:, 1:], linkage.constraint(x))
    return x


def leverage(linkage, x):
    """dx/dcrank."""
    C = linkage.jacobian(x)
    return np.concatenate(([1.0], -np.linalg.solve(C[:, 1:], C[:, 0])))


def crank_acceleration(linkage, start, crank, rate):
    """The four-bar's equation of motion in the crank's angle alone."""
    x = follow(linkage, start, crank)
    k = leverage(linkage, x)
    C, xd = linkage.jacobian(x), k * rate
    kd = np.concatenate(([0.0], -np.linalg.solve(C[:, 1:], linkage.jacobian_rate(x, xd) @ k)))
    M, b = linkage.mass(x), linkage.bias(x, xd)
    return -k @ (M @ kd * rate + b) / (k @ M @ k)


def test_a_four_bar_has_its_equilibria_where_the_reduced_equation_has():
    linkage, mech = zoo.FourBar(), pc.load("four_bar")
    for stable, sign in ((True, -1), (False, 1)):
        found = pc.equilibrium(mech, stable=stable)
        start = linkage.T @ found.q
        assert abs(crank_acceleration(linkage, start, found.q[0], 0.0)) < 1e-12
        slope = differences(lambda x, s=start: np.array([crank_acceleration(linkage, s, x[0], 0.0)]), found.q[:1])
        assert found.stable == stable and np.sign(slope[0, 0]) == sign


def test_redundant_rows_and_frames_that_turn_in_space():
    """Bricard's mechanism (five rows of rank four), a chain of balls on two distances, a top at its pivot."""
    for mech in (pc.load("bricard"), scenes.spherical_chain(), scenes.heavy_top()):
        found = pc.equilibrium(mech)
        gravity = pin.computeGeneralizedGravity(mech.model, mech.model.createData(), found.q)
        J = MechanismSystem(mech, found.q).loop_rows(found.q)[1]
        np.testing.assert_allclose(J.T @ found.lam, gravity, atol=1e-11)
        shortest = np.linalg.lstsq(J.T, gravity, rcond=1e-10)[0]
        np.testing.assert_allclose(found.lam, shortest, atol=1e-10)
    assert found.neutral == ("top",) and not found.stable and found.stiffness[0] == 0.0  # the spin of the top
    np.testing.assert_allclose(found.stiffness[1:], 15 * G)
    assert "neutral" in str(found) and "nothing resists top" in str(found)


def test_a_massless_link_between_two_springs():
    """Two springs in series carry one weight; the mass matrix is singular."""
    mech = pc.Mechanism(
        slider(0.0, 2.0), forces=[pc.JointSpring("z0", 300.0), pc.JointSpring("z1", 600.0)], name="series"
    )
    found = pc.equilibrium(mech)
    np.testing.assert_allclose(found.q, [-2 * G / 300, -2 * G / 600], rtol=1e-13)
    np.testing.assert_allclose(found.stiffness, [300, 600])
    assert found.stable


def test_what_runs_away_is_an_error_that_says_so():
    with pytest.raises(pc.EquilibriumError, match=r"19\.6 N·m \(or N\) remain unbalanced at z0") as caught:
        pc.equilibrium(pc.Mechanism(slider(2.0)))
    again = pickle.loads(pickle.dumps(caught.value))
    assert (str(again), again.names, again.residual) == (str(caught.value), ("z0",), caught.value.residual)


def test_without_forces_everything_is_an_equilibrium():
    model = slider(1.0, 1.0)
    model.gravity.setZero()
    found = pc.equilibrium(pc.Mechanism(model), [0.3, -0.2])
    np.testing.assert_array_equal(found.q, [0.3, -0.2])
    assert found.iterations == 0 and found.neutral == ("z0", "z1") and not found.stable


def test_an_equilibrium_at_a_singular_position_is_refused():
    """A parallelogram under a sideways weight comes to rest in line, where its motion branches."""
    with pytest.raises(pc.SingularSystemError, match="singular configuration"):
        pc.equilibrium(pc.load("n_four_bar_1").with_gravity([G, 0, 0]), {"crank0": 1.3})


def test_arguments():
    mech = pc.load("four_bar")
    for call in (pc.equilibrium, pc.linearize, lambda m, **o: pc.inverse_dynamics(m, [0.0], **o)):
        with pytest.raises(pc.InputError, match="needs a Mechanism"):
            call("four_bar")
        with pytest.raises(pc.InputError, match="forces= needs a sequence"):
            call(mech, forces=3)
    for call in (pc.equilibrium, pc.linearize):
        with pytest.raises(pc.InputError, match="t has a number that is not finite"):
            call(mech, t=np.nan)
        with pytest.raises(pc.InputError, match="no joint 'carnk'"):
            call(mech, {"carnk": 1.0})


# --- linearisation and modes


def test_one_and_two_pendulums():
    one = pc.linearize(pc.load("planar_pendulum")).modes()
    np.testing.assert_allclose(one.frequencies, [np.sqrt(1.5 * G)], rtol=1e-13)
    np.testing.assert_allclose(one.hertz, one.frequencies / (2 * np.pi))
    np.testing.assert_array_equal(one.damping_ratios, [0.0])
    two = pc.linearize(pc.load("double_pendulum"))
    # absolute angles: M = [[4/3, 1/2], [1/2, 1/3]], K = g diag(3/2, 1/2)
    squares = G * (3 + 6 * np.array([-1, 1]) / np.sqrt(7))
    np.testing.assert_allclose(two.modes().frequencies, np.sqrt(squares), rtol=1e-13)
    assert two.coordinates == ("upper", "lower")
    np.testing.assert_allclose(two.mass, [[8 / 3, 5 / 6], [5 / 6, 1 / 3]], rtol=1e-14)
    np.testing.assert_allclose(two.stiffness, G * np.array([[2, 0.5], [0.5, 0.5]]), rtol=1e-13)
    shapes = two.modes().shapes
    assert np.isrealobj(shapes) and np.abs(shapes).max(axis=0).tolist() == [1.0, 1.0]
    for square, shape in zip(squares, shapes.T, strict=True):
        np.testing.assert_allclose(two.stiffness @ shape, square * two.mass @ shape, atol=1e-11)


def test_a_standing_pendulum_falls():
    modes = pc.linearize(pc.load("planar_pendulum"), {"pendulum": -np.pi / 2}).modes()
    rate = np.sqrt(1.5 * G)
    assert sorted(modes.eigenvalues.real) == pytest.approx([-rate, rate]) and not modes.eigenvalues.imag.any()
    assert sorted(modes.damping_ratios) == [-1.0, 1.0]


@pytest.mark.parametrize("d", [0.1, 1.0, 5.0])
def test_damping_ratios(d):
    """I s² + d s + k = 0, oscillating or not."""
    inertia, stiffness = 1 / 3, G / 2
    linear = pc.linearize(pc.load("planar_pendulum"), forces=[pc.JointDamping({"pendulum": d})])
    modes, roots = linear.modes(), np.roots([inertia, d, stiffness])
    roots = sorted(roots[roots.imag >= 0], key=abs)
    np.testing.assert_allclose(modes.eigenvalues, roots, rtol=1e-9)
    if d < 2:
        np.testing.assert_allclose(modes.damping_ratios, d / (2 * np.sqrt(inertia * stiffness)), rtol=1e-9)
    np.testing.assert_allclose(sorted(np.linalg.eigvals(linear.A), key=abs)[-1].real, roots[-1].real, rtol=1e-9)


def test_a_hanging_four_bar_against_the_reduced_equation_and_a_simulation():
    mech, linkage = pc.load("four_bar"), zoo.FourBar()
    linear = pc.linearize(mech)
    start = linkage.T @ linear.q
    assert linear.coordinates == ("crank",) and linear.Z[0, 0] == 1.0
    np.testing.assert_allclose(linkage.T @ linear.Z[:, 0], leverage(linkage, start), rtol=1e-12)

    def reduced(state):
        return np.array([state[1], crank_acceleration(linkage, start, *state)])

    np.testing.assert_allclose(linear.A, differences(reduced, np.array([linear.q[0], 0.0])), atol=1e-9)
    (frequency,) = linear.modes().frequencies
    aside = pc.simulate(
        mech, (0.0, 10.0), linear.q + 1e-4 * linear.Z[:, 0], rtol=1e-9, atol=1e-12,
        events=pc.Event(lambda t, q, v, lam: q[0] - linear.q[0]),
    )  # fmt: skip
    periods = np.diff(aside.t_events[0][::2])
    np.testing.assert_allclose(periods, 2 * np.pi / frequency, rtol=1e-6)


def test_a_driven_state_of_the_four_bar():
    """Not at rest: curvature of the constraints and gyroscopic terms; the reduced equation again."""
    linkage = zoo.FourBar()
    linear = pc.linearize(pc.load("four_bar"), {"crank": -0.4}, {"crank": 3.0})
    start = linkage.T @ linear.q

    def reduced(state):
        return np.array([state[1], crank_acceleration(linkage, start, *state)])

    state = np.array([linear.q[0], 3.0])
    assert linear.a[0] == pytest.approx(reduced(state)[1], rel=1e-12)
    np.testing.assert_allclose(linear.A, differences(reduced, state), rtol=1e-9, atol=1e-9)


MOVING = {
    "five_bar": (lambda: pc.load("five_bar"), {"left_crank": 2.0, "right_crank": -1.0}),
    "bricard": (lambda: pc.load("bricard"), {"hinge0": 2.0}),
    "andrews": (lambda: pc.load("andrews"), {"beta": 50.0}),
    "spherical_chain": (scenes.spherical_chain, np.array([0.5, -1.0, 0.3, 1.0, 0.4, -0.6])),
    "heavy_top": (scenes.heavy_top, np.array([0, 0, 0, 3.0, 15.0, -4.6])),
}


def column_of(mech, coordinate):
    """Of v, by the name of a coordinate: "hinge", or "ball[2]" of a joint that has several."""
    joint, _, number = coordinate.rstrip("]").partition("[")
    return np.arange(mech.nv)[mech.columns(joint)][int(number or 0)]


def test_of_equally_good_coordinates_the_first_is_taken():
    """Bricard's hinges 0, 2 and 4 turn alike by symmetry; rounding must not choose among them."""
    linear = pc.linearize(pc.load("bricard"))
    np.testing.assert_allclose(np.abs(linear.Z[::2]), 1.0, rtol=1e-12)
    assert linear.coordinates == ("hinge0",)


@pytest.mark.parametrize("name", MOVING)
def test_a_moving_state_against_differences_of_the_nonlinear_motion(name):
    """y'' of neighbouring motions, seen from the moving state, by differencing what the full equations give."""
    build, v = MOVING[name]
    mech = build()
    linear = pc.linearize(mech, mech.guess, v)
    model, n = mech.model, len(linear.coordinates)
    index = np.array([column_of(mech, name) for name in linear.coordinates])
    np.testing.assert_array_equal(linear.Z[index], np.eye(n))  # set, not computed
    system, rest = MechanismSystem(mech, linear.q), np.setdiff1d(np.arange(mech.nv), index)
    first, second = pin.ArgumentPosition.ARG0, pin.ArgumentPosition.ARG1

    def neighbour(y):
        dq = linear.Z @ y
        for _ in range(30):
            q = pin.integrate(model, linear.q, dq)
            phi, J = system.loop_rows(q)
            J = J @ pin.dIntegrate(model, linear.q, dq, second)
            dq[rest] -= np.linalg.lstsq(J[:, rest], phi, rcond=1e-10)[0]
        return pin.integrate(model, linear.q, dq)

    def seen_acceleration(state):
        y, rate = np.split(state, 2)
        q = neighbour(y)
        rows = np.vstack((system.loop_rows(q)[1], pin.dDifference(model, linear.q, q, second)[index]))
        seen = rate - (pin.dDifference(model, linear.q, q, first) @ linear.v)[index]
        v = np.linalg.lstsq(rows, np.concatenate((np.zeros(mech.nc), seen)), rcond=1e-10)[0]
        a, _ = acceleration(MechanismSystem(mech, q), 0.0, q, v)

        def relative(s):
            q0, q1 = pin.integrate(model, linear.q, s * linear.v), pin.integrate(model, q, s * v)
            speed = pin.dDifference(model, q0, q1, second) @ (v + s * a)
            return (speed + pin.dDifference(model, q0, q1, first) @ (linear.v + s * linear.a))[index]

        return differences(lambda x: relative(x[0]), np.zeros(1))[:, 0]

    expected = differences(seen_acceleration, np.zeros(2 * n), 3e-3)
    np.testing.assert_allclose(linear.A[n:], expected, atol=3e-9 * np.abs(expected).max())


def test_reduced_stiffness_is_the_curvature_of_the_energy():
    """Weight and springs along the closed configurations, by second differences of the energy alone."""
    mech = scenes.spherical_chain()
    spring = pc.SpringDamper("end", stiffness=40.0, length=0.3, xyz1=(0.1, 0.2, 0.0), xyz2=(1.0, -0.2, -0.4))
    bound, model, data = spring.bind(mech.model), mech.model, mech.model.createData()
    linear = pc.linearize(mech, forces=[spring])
    system, n = MechanismSystem(mech, linear.q), len(linear.coordinates)

    def energy(y):
        dq = linear.Z @ y
        for _ in range(30):  # back onto the loops, across Z
            q = pin.integrate(model, linear.q, dq)
            phi, J = system.loop_rows(q)
            dq -= np.linalg.lstsq(J, phi, rcond=1e-10)[0]
        q = pin.integrate(model, linear.q, dq)
        return pin.computePotentialEnergy(model, data, q) + bound.stored(q, np.zeros(model.nv))[0]

    gradient = differences(lambda y: np.array([energy(y)]), np.zeros(n), 1e-2)
    np.testing.assert_allclose(gradient, 0, atol=1e-8)
    hessian = differences(lambda x: differences(lambda y: np.array([energy(y)]), x, 1e-2)[0], np.zeros(n), 1e-2)
    np.testing.assert_allclose(linear.stiffness, hessian, atol=1e-7)
    np.testing.assert_allclose(linear.stiffness, linear.stiffness.T, atol=1e-10)


@pytest.mark.parametrize("spin", [150.0, 190.0, 215.0, 300.0])
def test_a_sleeping_top(spin):
    """Upright and spinning: A s² - i C Ω s - m g l = 0 for the tilt in space, which turns by -iΩ in the body's axes.

    It is stable above Ω = 2 sqrt(A m g l)/C = 202 rad/s.
    """
    across, along, load = 0.234375 + 15.0, 0.46875, 15 * G
    mech, q = scenes.heavy_top(), np.zeros(7)
    q[3:] = pin.Quaternion(pin.rpy.rpyToMatrix(np.pi / 2, 0, 0)).coeffs()  # its axis y upwards
    modes = pc.linearize(mech, q, np.array([0, 0, 0, 0, spin, 0])).modes()
    in_space = np.roots([across, -1j * along * spin, -load])
    expected = in_space - 1j * spin
    expected = np.where(expected.imag < 0, expected.conj(), expected)
    found = modes.eigenvalues[1:]  # the first is zero: the angle of the spin itself
    assert modes.eigenvalues[0] == 0 and len(found) == 2
    key = [lambda s: (round(s.imag, 6), round(s.real, 6))] * 2
    np.testing.assert_allclose(sorted(found, key=key[0]), sorted(expected, key=key[1]), rtol=1e-7)
    assert (np.abs(modes.eigenvalues.real).max() > 1e-3) == (spin < 202)


def test_massless_parts_follow_without_delay():
    """k₁ and k₂ in series on one mass: one finite frequency, one infinite."""
    forces = [pc.JointSpring("z0", 300.0), pc.JointSpring("z1", 600.0)]
    linear = pc.linearize(pc.Mechanism(slider(0.0, 2.0), forces=forces))
    modes = linear.modes()
    np.testing.assert_allclose(modes.frequencies, [np.sqrt(200 / 2.0)], rtol=1e-12)
    np.testing.assert_allclose(modes.shapes[:, 0], [1.0, 0.5], rtol=1e-12)
    assert modes.massless == 1 and "1 more without inertia" in str(modes)
    with pytest.raises(pc.SingularSystemError, match="no inertia"):
        linear.A  # noqa: B018


@pytest.mark.parametrize("d", [1.0, 30.0, 1000.0])
def test_massless_parts_with_a_damper_are_of_first_order(d):
    """(k₁ + d s) and k₂ in series on a mass: m s² (k₁ + k₂ + d s) + k₂ (k₁ + d s) = 0, of third order."""
    k1, k2, m = 300.0, 600.0, 2.0
    forces = [pc.JointSpring("z0", k1), pc.JointSpring("z1", k2), pc.JointDamping({"z0": d})]
    modes = pc.linearize(pc.Mechanism(slider(0.0, m), forces=forces)).modes()
    roots = np.roots([m * d, m * (k1 + k2), k2 * d, k1 * k2])
    np.testing.assert_allclose(modes.eigenvalues, sorted(roots[roots.imag >= 0], key=abs), rtol=1e-8)
    assert modes.massless == 0


def test_what_nothing_resists_has_the_eigenvalue_zero():
    model = slider(1.0, 1.0)
    model.gravity.setZero()
    coupled = pc.Mechanism(model, forces=[pc.JointSpring("z1", 50.0)])
    free = pc.linearize(coupled).modes()
    np.testing.assert_allclose(free.frequencies, [0, 10.0], atol=1e-12)
    assert np.isnan(free.damping_ratios[0])
    braked = pc.linearize(coupled, forces=[pc.JointDamping({"z0": 0.3})]).modes()
    assert np.count_nonzero(braked.eigenvalues == 0) == 1 and (braked.eigenvalues[1:].real < 0).all()
    rubbed = pc.linearize(coupled, forces=[pc.JointDamping({"z1": 0.3})]).modes()  # the centre still runs freely
    assert np.count_nonzero(rubbed.eigenvalues == 0) == 1 and len(rubbed.eigenvalues) == 2
    loose = pc.Mechanism(slider(1.0, 0.0), forces=[pc.JointSpring("z0", 50.0)])
    with pytest.raises(pc.SingularSystemError, match="no inertia, damping or stiffness"):
        pc.linearize(loose).modes()


def test_a_pendulum_whose_pivot_is_shaken():
    """A constraint of one's own that moves: L a'' = -g sin a - X'' cos a, with a from the vertical."""
    length, w = 0.8, 3.0
    model = pin.Model()
    x = scenes.add_body(model, 0, pin.JointModelPX(), scenes.at(0, 0), "x", 0.0, (0, 0, 0), 0.0)
    scenes.add_body(model, x, pin.JointModelPZ(), scenes.at(0, 0), "z", 1.3, (0, 0, 0), 0.0)

    def gap(t, q):
        return [((q[0] - 0.2 * np.sin(w * t)) ** 2 + q[1] ** 2 - length**2) / (2 * length)]

    mech = pc.Mechanism(model, [pc.Constraint("rod", gap, 1)], name="shaken", actuated=["x"])
    for t, angle, rate in ((0.0, 0.0, 0.0), (0.4, 0.5, 1.7)):
        pivot, speed, jerk = 0.2 * np.sin(w * t), 0.2 * w * np.cos(w * t), -0.2 * w**2 * np.sin(w * t)
        q = [pivot + length * np.sin(angle), -length * np.cos(angle)]
        v = [speed + length * np.cos(angle) * rate, length * np.sin(angle) * rate]
        linear = pc.linearize(mech, q, v, t=t)
        assert linear.coordinates == ("x",)
        # y = L sin a: from a'' as a function of a and a' to y'' as one of y and y'

        def reduced(state, t=t, pivot=pivot, jerk=jerk):
            y, rate = state
            a = np.arcsin(y / length)
            turn = rate / (length * np.cos(a))
            bend = -(G * np.sin(a) + jerk * np.cos(a)) / length
            return np.array([rate, length * (np.cos(a) * bend - np.sin(a) * turn**2)])

        state = np.array([length * np.sin(angle), length * np.cos(angle) * rate])
        np.testing.assert_allclose(linear.a[0] - jerk, reduced(state)[1], rtol=1e-7, atol=1e-7)
        np.testing.assert_allclose(linear.A, differences(reduced, state), rtol=1e-6, atol=1e-6)


def test_two_geared_pendulums():
    """Both weights act on one coordinate: (I₁ + r² I₂) w² = K₁ + r² K₂."""
    model, turn = pin.Model(), pin.JointModelRY()
    for name in ("one", "two"):
        scenes.add_body(model, 0, turn, scenes.at(0, 0), name, 1.0, (0, 0, -0.5), 1 / 12)
    mech = pc.Mechanism(model, [pc.Coupling("gears", "two", "one", ratio=-2.5)], actuated=["one"])
    (frequency,) = pc.linearize(mech).modes().frequencies
    assert frequency == pytest.approx(np.sqrt(1.5 * G), rel=1e-12)  # equal rods swing as one
    heavy = pc.linearize(mech, forces=[pc.JointSpring("two", 4.0)])
    np.testing.assert_allclose(heavy.mass, [[(1 + 2.5**2) / 3]], rtol=1e-13)
    np.testing.assert_allclose(heavy.stiffness, [[G / 2 * (1 + 2.5**2) + 4.0 * 2.5**2]], rtol=1e-12)


def test_friction_at_rest_is_a_stiff_damper():
    linear = pc.linearize(pc.load("planar_pendulum"), forces=[pc.JointFriction({"pendulum": 0.2}, width=0.05)])
    np.testing.assert_allclose(linear.damping, [[4.0]], rtol=1e-9)


# --- inverse dynamics


def test_a_pendulum_lifted_along_a_curve():
    mech, w = pc.load("planar_pendulum"), 3.0
    driven = mech.with_loops(pc.Drive("motor", "pendulum", pc.Motion(amplitude=0.8, frequency=w / (2 * np.pi))))
    found = pc.inverse_dynamics(driven, np.linspace(0, 2, 9), forces=[pc.JointDamping({"pendulum": 0.7})])
    angle, rate, growth = 0.8 * np.sin(w * found.t), 0.8 * w * np.cos(w * found.t), -0.8 * w**2 * np.sin(w * found.t)
    np.testing.assert_allclose(found.q[:, 0], angle, atol=1e-14)
    np.testing.assert_allclose(found.torques["motor"], growth / 3 - G / 2 * np.cos(angle) + 0.7 * rate, atol=1e-11)
    np.testing.assert_array_equal(found.reaction("motor").torque, found.torques["motor"])


@pytest.mark.parametrize("crank", [1.0, -2.6])
def test_a_slider_crank_against_a_tight_simulation(crank):
    plain = pc.load("slider_crank")
    drive = pc.Drive("motor", "crank", lambda t: crank + 2 * t + 3 * t**2, lambda t: 2 + 6 * t, lambda t: 6.0)
    driven = plain.add_loops(drive)
    times = np.linspace(0, 1.5, 7)
    found = pc.inverse_dynamics(driven, times, {"crank": crank})
    sol = pc.simulate(driven, (0.0, 1.5), {"crank": crank}, rtol=1e-10, atol=1e-10, t_eval=times)
    np.testing.assert_allclose(found.q, sol.q, atol=1e-9)
    np.testing.assert_allclose(found.v, sol.v, atol=1e-8)
    np.testing.assert_allclose(found.lam, sol.lam, atol=1e-6 * np.abs(sol.lam).max())
    np.testing.assert_allclose(found.torques["motor"], sol.reaction("motor").torque, atol=1e-6 * np.abs(sol.lam).max())


def test_few_times_far_apart_stay_on_the_branch():
    """Ten turns between two times: every joint counts the same turns as with many times between."""
    driven = pc.load("jansen_leg")
    far, near = pc.inverse_dynamics(driven, [0.0, 10.25]), pc.inverse_dynamics(driven, np.linspace(0, 10.25, 300))
    np.testing.assert_allclose(far.q[-1], near.q[-1], atol=1e-11)
    np.testing.assert_allclose(far.lam[-1], near.lam[-1], atol=1e-8)
    assert far.q[-1, driven.columns("crank")] == pytest.approx(20.5 * np.pi)


def test_three_arms_determine_a_delta_robot():
    plain = pc.load("delta_robot")
    drives = [
        pc.Drive(f"motor{i}", f"leg{i}_arm", pc.Motion(start=0.3, amplitude=0.2, frequency=1.0, phase=2.1 * i))
        for i in (1, 2, 3)
    ]
    driven = plain.add_loops(*drives)
    times = np.linspace(0, 0.5, 6)
    found = pc.inverse_dynamics(driven, times)
    sol = pc.simulate(driven, (0.0, 0.5), rtol=1e-9, atol=1e-9, t_eval=times)
    for drive in drives:
        torque = sol.reaction(drive.name).torque
        np.testing.assert_allclose(found.torques[drive.name], torque, atol=1e-5 * np.abs(torque).max())
    power = sum(found.torques[drive.name] * found.v[:, plain.columns(drive.joint)][:, 0] for drive in drives)
    assert np.abs(power).max() > 0.1  # it does work
    with pytest.raises(pc.SingularSystemError, match="do not determine the motion of") as caught:
        pc.inverse_dynamics(plain.add_loops(*drives[:2]), times)
    assert "leg3_arm" in caught.value.names and "leg1_arm" not in caught.value.names


def test_drives_that_do_not_fit():
    plain = pc.load("four_bar")
    with pytest.raises(pc.InputError, match="no driven joint"):
        pc.inverse_dynamics(plain, [0.0])
    rocker = pc.Drive("push", "rocker", lambda t: plain.guess[2] + t)
    with pytest.raises(pc.AssemblyError, match=r"cannot follow the drives beyond t = 0\.136") as caught:
        pc.inverse_dynamics(plain.add_loops(rocker), [0.0, 0.5])
    assert caught.value.q.shape == (3,)
    both = (pc.Drive("a", "crank", lambda t: -1.0 + 0 * t), pc.Drive("b", "rocker", lambda t: plain.guess[2] + 0 * t))
    with pytest.raises(
        pc.SingularSystemError, match=r"the drives a, b are more than the motions that the loops leave free"
    ):
        pc.inverse_dynamics(plain.add_loops(*both), [0.0])
    for times in ([], [[0.0, 1.0]], [0.0, np.inf]):
        with pytest.raises(pc.InputError, match="times"):
            pc.inverse_dynamics(plain.add_loops(rocker), times)


def one_body(*joints):
    """A body on joints one after the other, the massless ones before the last."""
    model, last = pin.Model(), 0
    for i, joint in enumerate(joints):
        last = model.addJoint(last, joint, pin.SE3.Identity(), f"j{i}")
    model.appendBodyToJoint(
        last, pin.Inertia(1.3, np.array([0.05, 0.1, -0.2]), np.diag([0.1, 0.2, 0.15])), scenes.at(0, 0)
    )
    return pc.Mechanism(model)


def test_joints_whose_axes_turn_with_themselves():
    """Pinocchio's derivatives of rnea are wrong for these; the same joints built of hinges have the answers."""
    x, y = np.eye(3)[:2]
    together = pin.JointModelComposite()
    for joint in (pin.JointModelRX(), pin.JointModelRY()):
        together.addJoint(joint)
    hinges = pc.linearize(one_body(pin.JointModelRX(), pin.JointModelRY()), [0.4, 0.7], [1.0, -2.0])
    for joint in (pin.JointModelUniversal(x, y), together):
        found = pc.linearize(one_body(joint), [0.4, 0.7], [1.0, -2.0])
        for name in ("mass", "damping", "stiffness", "a"):
            np.testing.assert_allclose(getattr(found, name), getattr(hinges, name), atol=1e-10)
    hanging = [
        pc.linearize(one_body(joint)).modes() for joint in (pin.JointModelSpherical(), pin.JointModelSphericalZYX())
    ]
    np.testing.assert_allclose(hanging[0].hertz, hanging[1].hertz, atol=1e-9)
