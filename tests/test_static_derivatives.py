"""Derivatives of equilibria, driven motions and linearisations by parameters, against differences of solutions."""

import numpy as np
import pytest
from helpers import scenes

import pinconsist as pc
from pinconsist.mechanism.parameters import parameter


def differences(solve, mech, name):
    """Of fourth order, of what ``solve(mechanism)`` returns, by the names of its parts."""
    value = parameter(mech, name).value
    step = 1e-3 * max(abs(value), 0.1)
    found = [solve(mech.with_parameters({name: value + m * step})) for m in (1, -1, 2, -2)]
    return {k: (8 * (a - b) - (c - d)) / (12 * step) for k in found[0] for a, b, c, d in [[one[k] for one in found]]}


def compare(solve, mech, names, derivatives, tolerance=1e-8):
    assert derivatives.names == tuple(names)
    for i, name in enumerate(names):
        for part, exact in differences(solve, mech, name).items():
            found = derivatives[part][..., i]
            np.testing.assert_allclose(found, exact, atol=tolerance * (1e-3 + np.abs(exact).max()), err_msg=name)


def at_rest(q0):
    def solve(mech):
        found = pc.equilibrium(mech, q0)
        return {"q": found.q, "lam": found.lam}

    return solve


def test_of_an_equilibrium():
    mech = pc.load("crank_rocker").add_forces(pc.JointSpring("crank", 3.0))
    found = pc.equilibrium(mech, {"crank": 0.5})
    names = ["mass:coupler", "stiffness:crank", "anchor:rocker_ground.xyz2[0]", "length:coupler", "gravity[2]"]
    compare(at_rest(found.q), mech, names, found.derivatives(names))


def test_of_an_equilibrium_with_redundant_rows():
    mech = pc.load("bricard").add_forces(pc.JointSpring("hinge1", 5.0))
    found, names = pc.equilibrium(mech), ["mass:hinge2", "stiffness:hinge1", "gravity[2]"]
    assert len(found.lam) > pc.assemble(mech).rank
    compare(at_rest(found.q), mech, names, found.derivatives(names), 1e-7)
    with pytest.raises(pc.InputError, match=r"'anchor:hinge5.*cannot vary alone"):
        found.derivatives(["anchor:hinge5.xyz2[0]"])


def test_of_an_equilibrium_with_rotations_in_space():
    mech = scenes.spherical_chain()
    found, names = pc.equilibrium(mech), ["mass:second", "end.length"]

    def forces(mech):
        return {"lam": pc.equilibrium(mech, found.q).lam}

    try:
        derivatives = found.derivatives(names)
    except pc.SingularSystemError as error:
        assert "nothing resists" in str(error)  # a chain that turns about itself
    else:
        compare(forces, mech, names, derivatives, 1e-6)


def test_by_a_function_of_several_numbers_and_at_a_bound():
    mech = pc.load("crank_rocker").add_forces(pc.JointSpring("crank", 3.0))
    found = pc.equilibrium(mech, {"crank": 0.5})
    names = ["mass:coupler", "stiffness:crank"]
    built = found.derivatives(lambda theta: mech.with_parameters(dict(zip(names, theta, strict=True))), [1.4, 3.0])
    named = found.derivatives(names)
    np.testing.assert_allclose(built["q"], named["q"], rtol=1e-9)
    damped = found.derivatives(["damping:rocker"])  # zero: it cannot be less
    assert np.abs(damped["q"]).max() < 1e-12


def test_what_nothing_resists_has_no_derivative():
    mech = pc.load("crank_rocker").with_gravity([0.0, 0.0, 0.0])
    with pytest.raises(pc.SingularSystemError, match="nothing resists"):
        pc.equilibrium(mech).derivatives(["mass:coupler"])


def test_of_driven_motions():
    mech = pc.load("slider_crank")
    mech = mech.add_loops(pc.Drive("motor", "crank", pc.Motion(-1.0, 3.0, 0.4, 1.3, 0.2)))
    times, names = np.linspace(0.0, 0.3, 4), ["motor.amplitude", "length:rod", "mass:rod"]

    def solve(mech):
        found = pc.inverse_dynamics(mech, times)
        parts = {name: getattr(found, name) for name in ("q", "v", "a", "lam")}
        return {**parts, "torques.motor": found.torques["motor"]}

    compare(solve, mech, names, pc.inverse_dynamics(mech, times).derivatives(names))


@pytest.mark.parametrize("start", [{}, {"q0": {"crank": 0.7}, "v0": {"crank": 3.0}}])
def test_of_a_linearisation(start):
    mech, names = pc.load("crank_rocker"), ["mass:coupler", "length:coupler", "gravity[2]"]

    def solve(mech):
        found = pc.linearize(mech, **start)
        return {name: getattr(found, name) for name in ("mass", "damping", "stiffness")}

    compare(solve, mech, names, pc.linearize(mech, **start).derivatives(names), 1e-6)
