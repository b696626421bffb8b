"""All joints of Pinocchio, and a tree with one of them."""

import numpy as np
import pinocchio as pin

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
