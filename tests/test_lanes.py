"""States evaluated at once, by each instruction set that this processor has, and runs of Radau with them."""

import numpy as np
import pinocchio as pin
import pytest
from helpers.pinocchio_joints import JOINTS, tree_with
from helpers.twin import assert_same, compare_at_once, instruction_set, with_switches

import pinconsist as pc
from pinconsist import engine
from pinconsist.engine.systems import blank_system

SETS = engine.required().instruction_sets()
ONE_BY_ONE = {"Universal", "Ellipsoid", "Composite", "SphericalZYX"}  # their axes depend on their positions


@pytest.mark.parametrize("name", JOINTS)
def test_the_joints(name):
    model = tree_with(JOINTS[name]())
    q = pin.integrate(model, pin.neutral(model), np.linspace(-0.5, 0.4, model.nv))
    assert compare_at_once(blank_system(model), model, 0.0, q) == (name not in ONE_BY_ONE)


@pytest.mark.parametrize("number", [1, 2, 3, 7, 8, 9])
def test_any_number_of_states(number):
    model = tree_with(pin.JointModelSpherical())
    assert compare_at_once(blank_system(model), model, 0.0, pin.neutral(model), number)


@pytest.mark.parametrize("name", SETS)
def test_sines_of_large_angles(name):
    """A pendulum's weight has the moment of the sine of its angle."""
    model = pin.Model()
    model.appendBodyToJoint(
        model.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), "hinge"),
        pin.Inertia(1.0, np.array([0.0, 0.0, -1.0]), 0.1 * np.eye(3)),
        pin.SE3.Identity(),
    )
    angles = np.array([0.0, 1e-9, 0.7, np.pi / 2, -np.pi, 3e3, -4.5e5, 6e5, 1e12]).reshape(-1, 1)
    with instruction_set(name):
        f = blank_system(model).evaluate_at_once(np.zeros(9), angles, 0 * angles, 0 * angles)[0]
    np.testing.assert_allclose(f, -model.gravity981[2] * np.sin(angles), atol=1e-14)


def test_a_mechanism_far_away_is_as_accurate():
    """Moments are about a point of the mechanism, not about a distant origin."""
    model, rng = pin.Model(), np.random.default_rng(1)
    parent = 0
    for joint in (pin.JointModelFreeFlyer(), pin.JointModelRX(), pin.JointModelRY()):
        parent = model.addJoint(parent, joint, pin.SE3(np.eye(3), rng.normal(size=3)), f"joint {parent}")
        model.appendBodyToJoint(parent, pin.Inertia.Random(), pin.SE3.Random())
    q, v, a = pin.neutral(model), *rng.normal(size=(2, model.nv))
    system = blank_system(model)
    for name in SETS:
        with instruction_set(name):
            far = q + np.concatenate([[1e6, -2e6, 3e6], np.zeros(model.nq - 3)])
            here, there = (system.evaluate_at_once(np.zeros(1), x[None], v[None], a[None]) for x in (q, far))
        for near, distant in zip(here, there, strict=True):
            assert_same(near, distant)


SCENES = {
    "crank_rocker": 1.0, "andrews": 0.01, "delta_robot": 0.3, "stewart_platform": 0.2, "bricard": 0.3, "chain_8": 0.3,
}  # fmt: skip


@pytest.mark.parametrize("name", SCENES)
def test_a_run_does_not_depend_on_the_instructions(name):
    mech, span = pc.load(name), (0.0, SCENES[name])
    with with_switches(lanes=False, few_derivatives=False):
        alone = pc.simulate(mech, span, method="Radau", rtol=1e-9, atol=1e-9)
    found = []
    for each in (*SETS, SETS[0]):
        with instruction_set(each):
            found.append(pc.simulate(mech, span, method="Radau", rtol=1e-9, atol=1e-9))
    sol = found[0]
    assert sol.success and abs(sol.nsteps - alone.nsteps) <= 1 + 0.02 * alone.nsteps
    np.testing.assert_allclose(sol.q[-1], alone.q[-1], atol=1e-8)
    np.testing.assert_allclose(sol.lam[-1], alone.lam[-1], atol=1e-6 * (1.0 + np.abs(alone.lam).max()))
    for other in found[1:]:  # bit for bit
        np.testing.assert_array_equal(sol.q, other.q)
        np.testing.assert_array_equal(sol.lam, other.lam)


def test_an_instruction_set_that_is_not_there():
    with pytest.raises(ValueError, match="no instruction set sse9"):
        engine.required().use_instruction_set("sse9")
