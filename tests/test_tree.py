"""The compiled part's own trees of bodies, built from the numbers of a Pinocchio model: all joints of Pinocchio."""

import resource
import sys

import numpy as np
import pinocchio as pin
import pytest
from helpers.pinocchio_joints import JOINTS, tree_with
from helpers.twin import assert_same

from pinconsist import engine
from pinconsist.engine import tree
from pinconsist.engine.systems import blank_system


def test_the_list_has_every_joint_of_pinocchio():
    abstract = {"", "Mimic"}  # mechanisms refuse the latter
    assert (
        set(JOINTS)
        == {name.removeprefix("JointModel") for name in dir(pin) if name.startswith("JointModel")} - abstract
    )


@pytest.mark.parametrize("name", JOINTS)
def test_the_dynamics_are_those_of_pinocchio(name):
    """Inverse dynamics against rnea of the library; the mass matrix, positions and differences likewise."""
    model, rng = tree_with(JOINTS[name]()), np.random.default_rng(5)
    data, twin = model.createData(), blank_system(model)
    for _ in range(3):
        q = pin.integrate(model, pin.neutral(model), rng.uniform(-0.6, 0.6, model.nv))
        v, a = rng.normal(size=(2, model.nv))
        assert_same(twin.evaluate(0.0, q, v, a)[0], pin.rnea(model, data, q, v, a))
        M, bias, _, _ = twin.dynamics(0.0, q, v)
        assert_same(M, pin.crba(model, data, q))
        assert_same(bias, pin.rnea(model, data, q, v, 0.0 * v))
        xi = 0.3 * rng.normal(size=model.nv)
        assert_same(twin.chart_points(q[None], xi[None])[0], pin.integrate(model, q, xi))


def test_a_tree_is_built_once_and_workspaces_belong_to_data():
    model = tree_with(pin.JointModelRZ())
    module, data = engine.required(), model.createData()
    first = tree.workspace(module, model, data)
    assert tree.workspace(module, model, data) is first
    assert tree.workspace(module, model) is not first
    count = len(tree._trees)
    blank_system(model)
    assert len(tree._trees) == count


def test_a_workspace_of_a_long_chain_is_small():
    """Pinocchio's own Data is of size O(n³): 4 × 8 n³ bytes and more, 1 GB for 320 joints."""
    model = pin.Model()
    parent = 0
    for k in range(320):
        parent = model.addJoint(parent, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([0.1, 0, 0])), f"joint {k}")
        model.appendBodyToJoint(parent, pin.Inertia.Random(), pin.SE3.Identity())
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    blank_system(model)
    unit = 1 if sys.platform == "darwin" else 1024
    assert (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * unit < 100e6
