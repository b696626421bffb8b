"""Every type of joint of Pinocchio: derivatives of the equations and of what follows from them, against differences."""

import numpy as np
import pytest
from helpers.joint_types import JOINTS, chain, of_pinocchio, state

import pinconsist as pc
from pinconsist.analysis.variations import TangentSpace, closed_near
from pinconsist.engine.index1 import Index1
from pinconsist.engine.systems import compiled_system
from pinconsist.mechanism.lie import difference, integrate
from pinconsist.mechanism.motion import first
from pinconsist.mechanism.names import velocity_names
from pinconsist.mechanism.parameters import parameter
from pinconsist.mechanism.system import MechanismSystem

KINDS = pytest.mark.parametrize("kind", JOINTS)


def along(function, n, step=2e-3):
    """The derivatives of ``function(x)`` at x = 0, (…, n)."""
    return np.stack([first(lambda s, e=e: function(s * e), step) for e in np.eye(n)], axis=-1)


def close_to(found, exact, tolerance):
    np.testing.assert_allclose(found, exact, rtol=0, atol=tolerance * (1.0 + np.abs(exact).max()))


def test_no_type_is_left_out():
    tried = {joint.shortname() for joint in JOINTS.values()}
    assert tried == of_pinocchio() - {"JointModelMimic"}


@KINDS
def test_matrices_of_the_equations(kind):
    """∂f/∂q and ∂f/∂v of inertia, weights, springs, dampers and wrenches."""
    mech = chain(kind)
    q, v = state(mech)
    system, a = MechanismSystem(mech, q), np.cos(np.arange(mech.nv))

    def f(x, w):
        return np.array(system.evaluate(0.0, x, w, a)[0])

    by_q = along(lambda xi: f(integrate(mech.model, q, xi), v), mech.nv)
    by_v = along(lambda dv: f(q, v + dv), mech.nv, 1.0)
    c = 0.3
    M, f_v, f_q = system.matrices(0.0, q, v, a)
    close_to(f_q, by_q, 1e-10)
    close_to(f_v, by_v, 1e-10)
    twin = compiled_system(MechanismSystem(mech, q))
    np.testing.assert_allclose(twin.evaluate(0.0, q, v, a)[0], f(q, v), rtol=0, atol=1e-11)
    twin.evaluate(0.0, q, v, a)
    close_to(twin.linearize(0.0, q, v, a, c), M + c * by_v + c * c * by_q, 1e-10)


@KINDS
def test_accelerations_of_loops(kind):
    """J̇ v, against differences of J v along the motion."""
    mech = chain(kind)
    q, v = state(mech)
    system = MechanismSystem(mech, q)
    exact = first(lambda s: system.constraint(0.0, integrate(mech.model, q, s * v), v)[1].copy(), 2e-3)
    close_to(system.acceleration_bias(0.0, q, v), exact, 1e-9)
    close_to(compiled_system(system).dynamics(0.0, q, v)[3], exact, 1e-9)


def accelerations(mech, q, v):
    system = MechanismSystem(mech, q)
    return Index1(system).acceleration(0.0, q, v)[0]


@KINDS
def test_linearization_about_a_moving_state(kind):
    """Against differences of accelerations in the free coordinates."""
    mech = chain(kind)
    if mech.model.nq != mech.model.nv:
        pytest.skip("the variations are expressed in moving frames")
    q, v = state(mech)
    small = pc.linearize(mech, q, v)
    columns = [list(velocity_names(mech.model)).index(name) for name in small.coordinates]
    system = MechanismSystem(mech, q)

    def free_acceleration(x, rates):
        x = closed_near(system, 0.0, x)
        w = TangentSpace(system, x).Z[:, np.argsort(np.argsort(columns))] @ rates
        return accelerations(mech, x, w)[columns]

    n = len(columns)
    by_y = along(lambda y: free_acceleration(q + small.Z @ y, v[columns]), n)
    by_rate = along(lambda r: free_acceleration(q, v[columns] + r), n, 0.5)
    close_to(-np.linalg.solve(small.mass, small.stiffness), by_y, 1e-6)
    close_to(-np.linalg.solve(small.mass, small.damping), by_rate, 1e-8)


@KINDS
def test_rates_of_the_map_from_motors(kind):
    """Ȧ v of the motors, against differences of A along the motion."""
    mech = chain(kind)
    q, v = state(mech)
    act = pc.Actuation(mech, ["arm", "joint", "tip", "branch"], q)
    v = act.velocity(q, np.cos(np.arange(len(act.motors))))
    system = MechanismSystem(mech, q)

    def motion(s):
        return act.jacobian(closed_near(system, 0.0, integrate(mech.model, q, s * v))) @ v[act._columns]

    close_to(act.jacobian_rate(q, v), first(motion, 2e-3), 1e-8)


@KINDS
def test_derivatives_of_driven_motions(kind):
    """Of inverse dynamics, with a joint of this type that follows the arm."""
    mech = chain(kind, loops=False)
    columns, neutral = mech.columns("joint"), mech.guess

    def follows(t, q):
        xi = difference(mech.model, neutral, q)
        return xi[columns] - 0.3 * xi[0] * np.cos(np.arange(columns.stop - columns.start))

    count = columns.stop - columns.start
    drives = [
        pc.Drive(f"{joint}_motor", joint, pc.Motion(0.1, 0.5 + 0.2 * i, 0.3, 1.1, 0.2 * i))
        for i, joint in enumerate(("arm", "tip", "branch", "end"))
    ]
    mech = mech.with_loops(*drives, pc.Constraint("follows", follows, count))

    def solve(mech):
        found = pc.inverse_dynamics(mech, [0.0, 0.15])
        return {"a": found.a, "lam": found.lam}

    names = ["mass:joint", "arm_motor.speed", "gravity[1]"]
    found = pc.inverse_dynamics(mech, [0.0, 0.15]).derivatives(names)
    for i, name in enumerate(names):
        value = parameter(mech, name).value
        sides = [solve(mech.with_parameters({name: value + m * 1e-3})) for m in (1, -1, 2, -2)]
        for part in sides[0]:
            one, other, far, behind = (side[part] for side in sides)
            close_to(found[part][..., i], (8.0 * (one - other) - (far - behind)) / 12e-3, 1e-6)


@KINDS
def test_gradients_of_runs(kind):
    """Forwards and backwards, against differences of runs at a tight tolerance."""
    mech = chain(kind)
    q, v = state(mech)
    names = ["mass:joint", "anchor:rod.xyz1[0]"]
    span = (0.0, 0.1)
    options = {"rtol": 1e-8, "atol": 1e-9}

    def end(t, q, v, lam):
        return np.sin(q).sum() + v @ np.cos(np.arange(len(v))) + 0.1 * lam[0]

    def value(name, change):
        there = mech.with_parameters({name: parameter(mech, name).value + change})
        sol = pc.simulate(there, span, q, v, method="Radau", rtol=1e-12, atol=1e-12)
        return end(span[1], sol.q[-1], sol.v[-1], sol.lam[-1])

    back = pc.gradient(mech, names, span, q, v, terminal=end, **options)
    forward = pc.sensitivities(mech, names, span, q, v, **options)
    sol = forward.solution
    number = along(lambda x: end(0.0, integrate(mech.model, sol.q[-1], x), sol.v[-1], sol.lam[-1]), mech.nv, 1e-3)
    by_v = np.cos(np.arange(mech.nv))
    total = number @ forward.dq[-1] + by_v @ forward.dv[-1] + 0.1 * forward.dlam[-1, 0]
    exact = [first(lambda s, n=name: value(n, s), 2e-3) for name in names]
    np.testing.assert_allclose(back.gradient, total, rtol=1e-7, atol=1e-7 * np.abs(total).max())
    np.testing.assert_allclose(total, exact, rtol=1e-5, atol=1e-5 * np.abs(exact).max())
