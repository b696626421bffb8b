"""The compiled part's own trees of bodies, built from the numbers of a Pinocchio model: all joints of Pinocchio."""

import resource
import sys

import numpy as np
import pinocchio as pin
import pytest
from helpers.twin import assert_same

from pinconsist import engine
from pinconsist.engine import tree
from pinconsist.engine.systems import blank_system

TILTED = np.array([2.0, -3.0, 6.0]) / 7.0


def composite():
    joint = pin.JointModelComposite(3)
    joint.addJoint(pin.JointModelRY(), pin.SE3.Identity())
    joint.addJoint(pin.JointModelPrismaticUnaligned(*TILTED), pin.SE3.Random())
    joint.addJoint(pin.JointModelRZ(), pin.SE3.Random())
    return joint


def continuous():
    """Only the URDF parser makes one with another axis than x."""
    axis = " ".join(map(str, TILTED))
    inertia = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    links = f'<link name="base"/><link name="arm">{inertia}</link>'
    joint = (
        f'<joint name="hinge" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="{axis}"/></joint>'
    )
    return pin.buildModelFromXML(f'<robot name="one">{links}{joint}</robot>').joints[1].extract()


JOINTS = {
    "HelicalUnaligned": lambda: pin.JointModelHelicalUnaligned(*TILTED, 0.3),
    "HX": lambda: pin.JointModelHX(0.2),
    "HY": lambda: pin.JointModelHY(-0.4),
    "HZ": lambda: pin.JointModelHZ(0.1),
    "PrismaticUnaligned": lambda: pin.JointModelPrismaticUnaligned(*TILTED),
    "RevoluteUnaligned": lambda: pin.JointModelRevoluteUnaligned(*TILTED),
    "RevoluteUnboundedUnaligned": continuous,
    "Universal": lambda: pin.JointModelUniversal(*TILTED, *np.array([3.0, 2.0, 0.0]) / np.sqrt(13.0)),
    "Ellipsoid": lambda: pin.JointModelEllipsoid(0.3, 0.5, 0.7),
    "Composite": composite,
}
OTHERS = "FreeFlyer PX PY PZ Planar RUBX RUBY RUBZ RX RY RZ Spherical SphericalZYX Translation".split()
JOINTS |= {name: getattr(pin, f"JointModel{name}") for name in OTHERS}


def test_the_list_has_every_joint_of_pinocchio():
    abstract = {"", "Mimic"}  # mechanisms refuse the latter
    assert (
        set(JOINTS)
        == {name.removeprefix("JointModel") for name in dir(pin) if name.startswith("JointModel")} - abstract
    )


def tree_with(joint):
    """A hinge, a body on the joint, and a slider on that; at a random pose."""
    pin.seed(3)
    model = pin.Model()
    parent = 0
    for each in (pin.JointModelRX(), joint, pin.JointModelPY()):
        parent = model.addJoint(parent, each, pin.SE3.Random(), f"joint {parent}")
        model.appendBodyToJoint(parent, pin.Inertia.Random(), pin.SE3.Random())
    model.armature = np.linspace(0.1, 0.5, model.nv)
    model.gravity.linear = np.array([1.0, 2.0, -9.0])
    return model


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
