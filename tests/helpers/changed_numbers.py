"""A mechanism, and other values of its parameters of each kind."""

import pinconsist as pc


def scene():
    spring = pc.SpringDamper("left_tip", stiffness=40.0, length=0.2, damping=0.3)
    on_joints = pc.JointSpring("right_crank", 3.0), pc.JointDamping({"left_crank": 0.1})
    return pc.load("five_bar").add_forces(spring, *on_joints)


CHANGES = {
    "mass:left_distal": 0.7,
    "com:left_distal[0]": 0.11,
    "inertia:right_distal[yy]": 0.02,
    "gravity[2]": -3.0,
    "damping:left_crank": 0.4,
    "stiffness:spring left_tip": 55.0,
    "length:spring left_tip": 0.3,
    "stiffness:right_crank": 5.0,
    "tip.xyz2[0]": 0.003,
    "anchor:tip.xyz1[2]": -0.004,
    "length:left_distal": 0.27,
}
