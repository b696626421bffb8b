"""The terms of the equations in C++ against Pinocchio's: every loop kind, force and joint."""

import numpy as np
import pinocchio as pin
import pytest
from helpers.bodies import mixed_tree, placement, random_state
from helpers.forces import FORCES
from helpers.loops import KINDS, PAIRS, closed_gap, loop_open_by
from helpers.reference import ByPinocchio
from helpers.twin import assert_same, compare_row_gradients, compare_terms, twin_of

import pinconsist as pc
from pinconsist import engine
from pinconsist.mechanism.system import MechanismSystem
from pinconsist.paper.index1 import acceleration


@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
@pytest.mark.parametrize("kind", KINDS)
def test_every_loop_kind_between_every_kind_of_joint(kind, pair):
    model, rng = mixed_tree(), np.random.default_rng(2)
    q, _ = random_state(model, rng)
    compare_terms(pc.Mechanism(model, [loop_open_by(model, q, kind, *pair, closed_gap(kind, rng))]), q)


@pytest.mark.parametrize("name", FORCES)
def test_every_force(name):
    model = mixed_tree()
    q, _ = random_state(model, np.random.default_rng(3))
    compare_terms(pc.Mechanism(model, forces=[FORCES[name]]), q)


MOTION = pc.Motion(0.1, 0.7, 0.3, 1.4, 0.2)
RECORDS = {
    "drive": pc.Drive("motor", "hinge", MOTION),
    "drive of an unbounded joint": pc.Drive("motor", "turn", MOTION),
    "drive by a function": pc.Drive("motor", "hinge", np.sin, np.cos, lambda t: -np.sin(t)),
    "coupling": pc.Coupling("gear", "hinge", "slide", -1.5, 0.2),
    "coupling of sums": pc.Coupling("tendon", "turn", {"hinge": 0.5, "slide": -2.0}, 0.7, 0.2, (0.4,)),
    "coupling with powers": pc.Coupling("cam", "hinge", "slide", 0.5, 0.1, (0.3, -0.2, 0.7)),
    "constraint": pc.Constraint("own", lambda t, q: np.array([q[0] * q[1] - 0.1 * t]), 1),
}


@pytest.mark.parametrize("name", RECORDS)
def test_every_other_record(name):
    """Their rows are open at a random configuration; Φ, J and their derivatives are compared there all the same."""
    model, t = mixed_tree(), 0.3
    q, v = random_state(model, np.random.default_rng(4))
    system = ByPinocchio(pc.Mechanism(model, [RECORDS[name]]), q, t)
    twin = twin_of(system)
    for ours, theirs in zip(system.constraint(t, q, v), twin.evaluate(t, q, v, 0 * v)[1::2], strict=True):
        assert_same(ours, theirs)
    assert_same(system.evaluate(t, q, v, 0 * v)[2].T, twin.evaluate(t, q, v, 0 * v)[2])
    a, lam = acceleration(system, t, q, v)
    for ours, theirs in zip((a, lam), engine.required().Projection(twin).acceleration(t, q, v)[:2], strict=True):
        assert_same(ours, theirs, 1e-10)
    if name == "constraint":
        assert twin.row_gradients(t, q, v, lam) is None
    else:
        compare_row_gradients(system, twin, t, q, v)


@pytest.mark.parametrize("name", ["servo with a motion", "torque of a motion", "drive"])
def test_motions_stay_in_compiled_code(name):
    model = mixed_tree()
    force = {
        "servo with a motion": pc.Servo("hinge", MOTION, 20.0, 3.0),
        "torque of a motion": pc.JointTorque({"slide": MOTION}),
    }
    loops = [RECORDS["drive"]] if name == "drive" else []
    mech = pc.Mechanism(model, loops, [force[name]] if name in force else [])
    q, _ = random_state(model, np.random.default_rng(5))
    assert not twin_of(MechanismSystem(mech, q)).calls_python
    compare_terms(mech, pc.assemble(mech, q, t=0.3).q if loops else q)


def test_a_motion_of_the_users_own_is_asked_in_python():
    class Jump(pc.Motion):
        def __call__(self, t):
            return super().__call__(t) + 0.1

    mech = pc.load("four_bar").add_forces(pc.Servo("crank", Jump(), 20.0, 1.0))
    assert twin_of(MechanismSystem(mech, mech.guess)).calls_python


AXIS = np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0)


def composite(*joints):
    rng, joint = np.random.default_rng(7), pin.JointModelComposite()
    for part in joints:
        joint.addJoint(part, placement(rng))
    return joint


JOINTS = {
    "helical": lambda: pin.JointModelHZ(0.3),
    "unaligned helical": lambda: pin.JointModelHelicalUnaligned(AXIS, 0.3),
    "unaligned revolute": lambda: pin.JointModelRevoluteUnaligned(AXIS),
    "unaligned prismatic": lambda: pin.JointModelPrismaticUnaligned(AXIS),
    "universal": lambda: pin.JointModelUniversal(np.eye(3)[0], np.eye(3)[2]),
    "spherical ZYX": pin.JointModelSphericalZYX,
    "translation": pin.JointModelTranslation,
    "composite of vectors": lambda: composite(
        pin.JointModelRX(), pin.JointModelPY(), pin.JointModelRZ(), pin.JointModelSphericalZYX()
    ),
    "composite with a sphere": lambda: composite(pin.JointModelSpherical(), pin.JointModelPX()),
    "composite with a plane": lambda: composite(pin.JointModelPlanar(), pin.JointModelRUBX()),
}


@pytest.mark.parametrize("name", JOINTS)
def test_terms_of_rarer_joints(name):
    """Two of them in a chain that a point closes, with a spring across it and a wrench at its end."""
    rng, model = np.random.default_rng(1), pin.Model()

    def body(parent, joint, called):
        index = model.addJoint(parent, joint, placement(rng), called)
        model.appendBodyToJoint(index, pin.Inertia(1.3, 0.2 * rng.normal(size=3), np.diag([0.1, 0.2, 0.25])), pin.SE3())
        model.addFrame(pin.Frame(f"on {called}", index, 0, placement(rng), pin.FrameType.OP_FRAME))
        return index

    last = body(body(body(0, JOINTS[name](), "first"), pin.JointModelRY(), "hinge"), JOINTS[name](), "last")
    body(0, pin.JointModelSpherical(), "ball")
    assert last == 3
    q, _ = random_state(model, rng)
    loop = loop_open_by(model, q, "point", "on last", "on ball", closed_gap("point", rng))
    forces = [
        pc.SpringDamper("on last", "on ball", 30.0, 0.3, damping=2.0),
        pc.Wrench("on last", force=(1.0, 2.0, 3.0), moment=(0.1, 0.2, 0.3)),
    ]
    compare_terms(pc.Mechanism(model, [loop], forces), q)
